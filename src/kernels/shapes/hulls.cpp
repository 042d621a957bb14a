// Distance to a union of hulls of two or three balls, its edges filled.
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "kernels.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

struct Vector {
    double x, y, z;
};
Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Vector operator*(double s, Vector a) { return {s * a.x, s * a.y, s * a.z}; }
double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
double length(Vector a) { return std::sqrt(dot(a, a)); }
Vector cross(Vector a, Vector b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
Vector read(const double *p) { return {p[0], p[1], p[2]}; }
void write(Vector a, double *p) { p[0] = a.x, p[1] = a.y, p[2] = a.z; }

struct Projection {
    double distance;  // to the hull, negative inside
    Vector normal;
    double radius;  // of the ball that is nearest
};

struct Rod {  // hull of two balls
    Vector start, axis;
    double length, first, taper, tangent;

    Rod() = default;
    Rod(const double *one, const double *two) : start(read(one)), first(one[3]) {
        const Vector along = read(two) - start;
        length = norm_of(along);
        axis = length > 0 ? (1 / length) * along : Vector{0, 0, 1};
        taper = length > 0 ? (one[3] - two[3]) / length : 0;
        const double cosine = 1 - taper * taper;
        tangent = cosine > 0 ? taper / std::sqrt(cosine) : taper * std::numeric_limits<double>::infinity();
    }
    static double norm_of(Vector a) { return std::sqrt(dot(a, a)); }
    void at(Vector x, Projection &best) const {
        const Vector out = x - start;
        const double along = dot(out, axis);
        const double away = std::sqrt(std::max(dot(out, out) - along * along, 0.0));
        double place = std::abs(taper) < 1 ? along - away * tangent : (taper > 0 ? 0 : length);
        place = std::min(std::max(place, 0.0), length);
        const Vector spoke = out - place * axis;
        const double far = norm_of(spoke), radius = first - taper * place, distance = far - radius;
        if (distance < best.distance)
            best = {distance, far > 0 ? (1 / far) * spoke : Vector{1, 0, 0}, radius};
    }
};

struct Hull {
    Rod rods[3];
    int count;
    bool flat;  // it has two flat faces, each touching all three balls
    Vector corner, u, v, lean, up;
    double rise, uu = 0, uv = 0, vv = 0, radius[3];
    Vector middle;
    double reach;

    Hull(const double *balls, const std::int64_t *part) {
        const double *one = balls + 4 * part[0], *two = balls + 4 * part[1];
        count = part[2] < 0 ? 1 : 3;
        rods[0] = Rod(one, two);
        const double *three = part[2] < 0 ? two : balls + 4 * part[2];
        flat = false;
        middle = 0.5 * (read(one) + read(two));
        if (count == 3) {
            rods[1] = Rod(two, three);
            rods[2] = Rod(three, one);
            middle = 1.0 / 3 * (read(one) + read(two) + read(three));
            corner = read(one);
            u = read(two) - corner;
            v = read(three) - corner;
            uu = dot(u, u), uv = dot(u, v), vv = dot(v, v);
            const double determinant = uu * vv - uv * uv;
            if (determinant > 1e-9 * uu * vv) {
                const double p = one[3] - two[3], q = one[3] - three[3];
                lean = (p * vv - q * uv) / determinant * u + (q * uu - p * uv) / determinant * v;
                const double square = dot(lean, lean);
                flat = square < 1;
                rise = std::sqrt(std::max(1 - square, 0.0));
                const Vector normal = cross(u, v);
                up = 1 / length(normal) * normal;
            }
            radius[0] = one[3], radius[1] = two[3], radius[2] = three[3];
        }
        reach = std::max(length(read(one) - middle) + one[3],
                         std::max(length(read(two) - middle) + two[3], length(read(three) - middle) + three[3]));
    }
    double least(Vector x) const { return length(x - middle) - reach; }
    Projection at(Vector x) const {
        Projection best{std::numeric_limits<double>::infinity(), {1, 0, 0}, 0};
        if (flat) {
            const Vector out = x - corner;
            const double height = dot(out, up);
            const Vector normal = lean + (height < 0 ? -rise : rise) * up;
            const Vector centre = out - std::abs(height) / rise * normal;
            const double a = dot(centre, u), b = dot(centre, v), determinant = uu * vv - uv * uv;
            const double s = (a * vv - b * uv) / determinant, t = (b * uu - a * uv) / determinant;
            if (s >= 0 && t >= 0 && s + t <= 1) {
                const double ball = (1 - s - t) * radius[0] + s * radius[1] + t * radius[2];
                return {std::abs(height) / rise - ball, normal, ball};
            }
        }
        for (int k = 0; k < count; k++) rods[k].at(x, best);
        return best;
    }
    // Shares of its balls in the ball with this centre
    void shares(Vector centre, double *share) const {
        const double determinant = uu * vv - uv * uv;
        if (count == 3 && determinant > 1e-9 * uu * vv) {
            const double a = dot(centre - corner, u), b = dot(centre - corner, v);
            share[1] = (a * vv - b * uv) / determinant, share[2] = (b * uu - a * uv) / determinant;
            share[0] = 1 - share[1] - share[2];
            return;
        }
        double least = std::numeric_limits<double>::infinity();
        for (int k = 0; k < count; k++) {  // three balls in a row
            const double along = std::min(std::max(dot(centre - rods[k].start, rods[k].axis), 0.0), rods[k].length);
            const double off = length(centre - rods[k].start - along * rods[k].axis);
            if (off >= least) continue;
            least = off;
            share[0] = share[1] = share[2] = 0;
            share[(k + 1) % 3] = rods[k].length > 0 ? along / rods[k].length : 0;
            share[k] = 1 - share[(k + 1) % 3];
        }
    }
};

std::vector<Hull> hulls_of(const double *balls, const std::int64_t *parts, std::int64_t count) {
    std::vector<Hull> hulls;
    hulls.reserve(count);
    for (std::int64_t i = 0; i < count; i++) hulls.emplace_back(balls, parts + 3 * i);
    return hulls;
}

struct ContactArrays {
    double distance, bend, facing;
    Vector gradient;
    int nearest;
};

// A union of hulls, seen from one point after the other; each thread has its own
struct Body {
    const std::vector<Hull> &hulls;
    const double *blend, *apart;
    double carve, reach;
    int count, some = 0;
    std::vector<double> least, level;
    std::vector<Projection> projections;
    std::vector<int> close, here;  // hulls near the point, and near the place

    Body(const std::vector<Hull> &all, const double *widths, const double *standing, double carved, double looked)
        : hulls(all), blend(widths), apart(standing), carve(carved), reach(looked), count(int(all.size())),
          least(count), level(count), projections(count), close(count) {
        for (int i = 0; i < count; i++) here.push_back(i);
    }

    // Look at points within a ball from now on
    void narrow(Vector middle, double radius) {
        double best = std::numeric_limits<double>::infinity();
        for (int i = 0; i < count; i++) best = std::min(best, least[i] = hulls[i].at(middle).distance);
        here.clear();
        for (int i = 0; i < count; i++)
            if (least[i] < best + reach + 2 * radius + 1e-9) here.push_back(i);
    }

    // Distance of the nearest hull that joins hulls i and j; they stand apart where j is nearer
    double joint(int i, int j) const {
        double found = std::numeric_limits<double>::infinity();
        for (int c = 0; c < some; c++)
            if (blend[i * count + close[c]] > 0 && blend[j * count + close[c]] > 0)
                found = std::min(found, projections[close[c]].distance);
        return found - projections[j].distance;
    }
    int nearest_of(Vector x) {
        int first = here[0], winner;
        for (const int i : here) {
            least[i] = hulls[i].least(x);
            if (least[i] < least[first]) first = i;
        }
        projections[first] = hulls[first].at(x);
        winner = first;
        some = 0;
        for (const int i : here) {
            if (i != first && least[i] >= projections[winner].distance + reach) continue;
            if (i != first) projections[i] = hulls[i].at(x);
            if (projections[i].distance < projections[winner].distance) winner = i;
            close[some++] = i;
        }
        return winner;
    }
    void carve_out() {
        for (int a = 0; a < some; a++) {
            const int i = close[a];
            level[i] = projections[i].distance;
            for (int b = 0; b < some && carve > 0; b++) {
                const int j = close[b];
                if (apart[i * count + j] <= 0 || carve - projections[j].distance <= level[i]) continue;
                const double wide = std::min(std::max(joint(i, j) / (0.4 * carve), 0.0), 1.0);
                if (wide > 0) level[i] = std::max(level[i], wide * carve - projections[j].distance);
            }
        }
    }
    void fill_edges(ContactArrays &found) const {
        for (int a = 0; a < some; a++)
            for (int b = 0; b < a; b++) {
                const int i = close[a], j = close[b];
                const double full = blend[i * count + j], between = std::abs(level[i] - level[j]);
                const double most = full - between, lowest = std::min(level[i], level[j]);
                if (most <= 0 || lowest - most * most / (4 * full) >= found.distance) continue;
                const double width = full * 0.5 * (1 - dot(projections[i].normal, projections[j].normal)), over = width - between;
                if (over <= 0) continue;
                const double joined = lowest - over * over / (4 * width);
                if (joined >= found.distance) continue;
                const double share = over / (2 * width);
                const bool lower = level[i] < level[j];
                found.distance = joined;
                found.gradient = (lower ? 1 - share : share) * projections[i].normal +
                                 (lower ? share : 1 - share) * projections[j].normal;
                found.bend = std::min(found.bend, 0.25 * full * full / width);
            }
    }
    ContactArrays look(Vector x) {
        const int winner = nearest_of(x);
        const double infinity = std::numeric_limits<double>::infinity();
        ContactArrays found{infinity, projections[winner].radius, infinity, {0, 0, 0}, winner};
        carve_out();
        for (int a = 0; a < some; a++) {
            const int i = close[a];
            if (level[i] < found.distance)
                found.distance = level[i], found.gradient = projections[i].normal, found.bend = projections[i].radius;
            if (apart[winner * count + i] > 0 && projections[i].distance < found.facing && joint(winner, i) > 0)
                found.facing = projections[i].distance;
        }
        fill_edges(found);
        return found;
    }
};

constexpr std::int64_t together = 64;  // points that are looked at one after the other, often near each other

void narrow_to(Body &body, const double *points, std::int64_t start, std::int64_t end) {
    Vector middle{0, 0, 0};
    double square = 0;
    for (std::int64_t p = start; p < end; p++) middle = middle + read(points + 3 * p);
    middle = 1.0 / double(end - start) * middle;
    for (std::int64_t p = start; p < end; p++) {
        const Vector away = read(points + 3 * p) - middle;
        square = std::max(square, dot(away, away));
    }
    body.narrow(middle, std::sqrt(square));
}

struct Touched {  // a hull near a point, and where this touches it
    int hull = -1;
    double distance = std::numeric_limits<double>::infinity();
    Vector normal{1, 0, 0};
    double share[3] = {0, 0, 0};
};

constexpr int looked_at = 3;  // hulls for each point

// The nearest hulls, the nearest first
void nearest_hulls(const std::vector<Hull> &hulls, Vector x, Touched *near) {
    double radius[looked_at];
    for (int i = 0; i < int(hulls.size()); i++) {
        if (hulls[i].least(x) >= near[looked_at - 1].distance) continue;
        const Projection closest = hulls[i].at(x);
        if (closest.distance >= near[looked_at - 1].distance) continue;
        int place = looked_at - 1;
        for (; place > 0 && near[place - 1].distance > closest.distance; place--)
            near[place] = near[place - 1], radius[place] = radius[place - 1];
        near[place].hull = i, near[place].distance = closest.distance, near[place].normal = closest.normal;
        radius[place] = closest.radius;
    }
    for (int k = 0; k < looked_at && near[k].hull >= 0; k++)
        hulls[near[k].hull].shares(x - (near[k].distance + radius[k]) * near[k].normal, near[k].share);
}

// Hold a point that touches a surface facing away from the camera against the front of the same ball, or its rim beside it
bool hold_before(Vector x, Vector sight, double facing, const double *balls, const std::int64_t *part, Touched &closest) {
    if (dot(closest.normal, sight) >= facing) return false;
    Vector centre{0, 0, 0};
    double radius = 0;
    for (int k = 0; k < 3 && part[k] >= 0; k++) {
        centre = centre + closest.share[k] * read(balls + 4 * part[k]);
        radius += closest.share[k] * balls[4 * part[k] + 3];
    }
    const Vector out = x - centre, across = out - dot(out, sight) * sight;
    const double wide = length(across);
    if (wide < radius) {
        closest.normal = 1 / radius * (across + std::sqrt(radius * radius - wide * wide) * sight);
        closest.distance = dot(closest.normal, out) - radius;
    } else {
        closest.normal = wide > 0 ? 1 / wide * across : Vector{1, 0, 0};
        closest.distance = wide - radius;
    }
    return true;
}

void add_gradients(const Touched &closest, double weight, const std::int64_t *part, double *gradients) {
    for (int k = 0; k < 3 && part[k] >= 0; k++) {
        double *own = gradients + 4 * part[k];
        const double by = -weight * closest.share[k];
        own[0] += by * closest.normal.x, own[1] += by * closest.normal.y, own[2] += by * closest.normal.z, own[3] += by;
    }
}

}  // namespace

void hull_gaps(const double *points, std::int64_t n, const double *balls, std::int64_t some, const std::int64_t *parts,
               std::int64_t count, const double *blend, const double *camera, double facing, double *distance,
               double *gradients, std::int64_t *hull) {
    const std::vector<Hull> hulls = hulls_of(balls, parts, count);
#pragma omp parallel for schedule(static)
    for (std::int64_t p = 0; p < n; p++) {
        const Vector x = read(points + 3 * p);
        Touched near[looked_at];
        nearest_hulls(hulls, x, near);
        std::fill(gradients + 4 * some * p, gradients + 4 * some * (p + 1), 0.0);
        distance[p] = std::numeric_limits<double>::quiet_NaN(), hull[p] = 0;
        if (near[0].hull < 0) continue;  // the point is NaN
        int chosen = 0, other = 0;
        if (camera) {
            const Vector away = read(camera) - x, sight = 1 / length(away) * away;
            bool turned = false;
            for (int k = 0; k < looked_at && near[k].hull >= 0; k++)
                if (hold_before(x, sight, facing, balls, parts + 3 * near[k].hull, near[k])) turned |= k == 0;
            for (int k = 1; turned && k < looked_at; k++)
                if (std::abs(near[k].distance) < std::abs(near[chosen].distance)) chosen = k;
        }
        const Touched &own = near[chosen];
        double share = 0;
        distance[p] = own.distance;
        other = chosen;
        for (int k = 0; k < looked_at; k++) {
            if (k == chosen || near[k].hull < 0) continue;
            const double width = blend[own.hull * count + near[k].hull] * 0.5 * (1 - dot(own.normal, near[k].normal));
            const double step = near[k].distance - own.distance, over = width - std::abs(step);
            if (over <= 0) continue;
            const double joined = std::min(near[k].distance, own.distance) - over * over / (4 * width);
            if (joined >= distance[p]) continue;
            distance[p] = joined, other = k;
            share = step >= 0 ? over / (2 * width) : 1 - over / (2 * width);
        }
        add_gradients(own, 1 - share, parts + 3 * own.hull, gradients + 4 * some * p);
        if (share > 0) add_gradients(near[other], share, parts + 3 * near[other].hull, gradients + 4 * some * p);
        hull[p] = own.hull;
    }
}

void hull_distances(const double *points, std::int64_t n, const double *balls, const std::int64_t *parts,
                    std::int64_t count, double *out) {
    const std::vector<Hull> hulls = hulls_of(balls, parts, count);
#pragma omp parallel for schedule(static)
    for (std::int64_t p = 0; p < n; p++)
        for (std::int64_t i = 0; i < count; i++) out[p * count + i] = hulls[i].at(read(points + 3 * p)).distance;
}

void blended_distance(const double *points, std::int64_t n, const double *balls, const std::int64_t *parts,
                      std::int64_t count, const double *blend, const double *apart, double carve, double reach,
                      double *distance, double *gradient, double *bend, double *facing, std::int64_t *nearest) {
    const std::vector<Hull> hulls = hulls_of(balls, parts, count);
#pragma omp parallel
    {
        Body body(hulls, blend, apart, carve, reach);
#pragma omp for schedule(dynamic, 4)
        for (std::int64_t block = 0; block < (n + together - 1) / together; block++) {
            const std::int64_t end = std::min(n, (block + 1) * together);
            narrow_to(body, points, block * together, end);
            for (std::int64_t p = block * together; p < end; p++) {
                const ContactArrays found = body.look(read(points + 3 * p));
                distance[p] = found.distance;
                write(found.gradient, gradient + 3 * p);
                bend[p] = found.bend;
                facing[p] = found.facing;
                nearest[p] = found.nearest;
            }
        }
    }
}

void project_on_hulls(double *points, std::int64_t n, const double *balls, const std::int64_t *parts,
                      std::int64_t count, const double *blend, const double *apart, double reach, Steps steps) {
    const std::vector<Hull> hulls = hulls_of(balls, parts, count);
#pragma omp parallel
    {
        Body body(hulls, blend, apart, 0, reach);
#pragma omp for schedule(dynamic, 64)
        for (std::int64_t p = 0; p < n; p++) {
            Vector x = read(points + 3 * p);
            ContactArrays found = body.look(x);
            for (std::int64_t step = 0; step < steps.most && std::abs(found.distance) > steps.on_surface; step++) {
                const double square = std::max(dot(found.gradient, found.gradient), 0.1), taper = std::sqrt(square);
                const double far = std::min(std::max(found.distance / taper, -steps.longest), steps.longest);
                x = x - far / taper * found.gradient;
                found = body.look(x);
            }
            if (std::abs(found.distance) > steps.on_surface) {  // it jumps from side to side of an edge
                const double side = found.distance > 0 ? 1 : -1;
                Vector far = x - side * steps.stride * found.gradient;
                const bool through = side * body.look(far).distance < 0;
                for (std::int64_t step = 0; through && step < steps.halvings; step++) {
                    const Vector middle = 0.5 * (x + far);
                    (side * body.look(middle).distance > 0 ? x : far) = middle;
                }
            }
            write(x, points + 3 * p);
        }
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
