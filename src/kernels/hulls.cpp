// Distance to a union of hulls of two or three balls, its creases filled.
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

struct Foot {
    double distance;  // to the hull, negative inside
    Vector normal;
    double radius;  // of the ball that is nearest
};

struct Rod {  // hull of two balls
    Vector start, axis;
    double length, first, slope, tangent;

    Rod() = default;
    Rod(const double *one, const double *two) : start(read(one)), first(one[3]) {
        const Vector along = read(two) - start;
        length = norm_of(along);
        axis = length > 0 ? (1 / length) * along : Vector{0, 0, 1};
        slope = length > 0 ? (one[3] - two[3]) / length : 0;
        const double cosine = 1 - slope * slope;
        tangent = cosine > 0 ? slope / std::sqrt(cosine) : slope * std::numeric_limits<double>::infinity();
    }
    static double norm_of(Vector a) { return std::sqrt(dot(a, a)); }
    void at(Vector x, Foot &best) const {
        const Vector out = x - start;
        const double along = dot(out, axis);
        const double away = std::sqrt(std::max(dot(out, out) - along * along, 0.0));
        double place = std::abs(slope) < 1 ? along - away * tangent : (slope > 0 ? 0 : length);
        place = std::min(std::max(place, 0.0), length);
        const Vector spoke = out - place * axis;
        const double far = norm_of(spoke), radius = first - slope * place, distance = far - radius;
        if (distance < best.distance)
            best = {distance, far > 0 ? (1 / far) * spoke : Vector{1, 0, 0}, radius};
    }
};

struct Hull {
    Rod rods[3];
    int count;
    bool flat;  // it has two flat faces, each touching all three balls
    Vector corner, u, v, lean, up;
    double rise, uu, uv, vv, radius[3];
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
    Foot at(Vector x) const {
        Foot best{std::numeric_limits<double>::infinity(), {1, 0, 0}, 0};
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
};

std::vector<Hull> hulls_of(const double *balls, const std::int64_t *parts, std::int64_t count) {
    std::vector<Hull> hulls;
    hulls.reserve(count);
    for (std::int64_t i = 0; i < count; i++) hulls.emplace_back(balls, parts + 3 * i);
    return hulls;
}

struct Found {
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
    std::vector<Foot> feet;
    std::vector<int> close, here;  // hulls near the point, and near the place

    Body(const std::vector<Hull> &all, const double *widths, const double *standing, double carved, double looked)
        : hulls(all), blend(widths), apart(standing), carve(carved), reach(looked), count(int(all.size())),
          least(count), level(count), feet(count), close(count) {
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
                found = std::min(found, feet[close[c]].distance);
        return found - feet[j].distance;
    }
    int nearest_of(Vector x) {
        int first = here[0], winner;
        for (const int i : here) {
            least[i] = hulls[i].least(x);
            if (least[i] < least[first]) first = i;
        }
        feet[first] = hulls[first].at(x);
        winner = first;
        some = 0;
        for (const int i : here) {
            if (i != first && least[i] >= feet[winner].distance + reach) continue;
            if (i != first) feet[i] = hulls[i].at(x);
            if (feet[i].distance < feet[winner].distance) winner = i;
            close[some++] = i;
        }
        return winner;
    }
    void carve_out() {
        for (int a = 0; a < some; a++) {
            const int i = close[a];
            level[i] = feet[i].distance;
            for (int b = 0; b < some && carve > 0; b++) {
                const int j = close[b];
                if (apart[i * count + j] <= 0 || carve - feet[j].distance <= level[i]) continue;
                const double wide = std::min(std::max(joint(i, j) / (0.4 * carve), 0.0), 1.0);
                if (wide > 0) level[i] = std::max(level[i], wide * carve - feet[j].distance);
            }
        }
    }
    void fill_creases(Found &found) const {
        for (int a = 0; a < some; a++)
            for (int b = 0; b < a; b++) {
                const int i = close[a], j = close[b];
                const double full = blend[i * count + j], between = std::abs(level[i] - level[j]);
                const double most = full - between, lowest = std::min(level[i], level[j]);
                if (most <= 0 || lowest - most * most / (4 * full) >= found.distance) continue;
                const double width = full * 0.5 * (1 - dot(feet[i].normal, feet[j].normal)), over = width - between;
                if (over <= 0) continue;
                const double joined = lowest - over * over / (4 * width);
                if (joined >= found.distance) continue;
                const double share = over / (2 * width);
                const bool lower = level[i] < level[j];
                found.distance = joined;
                found.gradient = (lower ? 1 - share : share) * feet[i].normal +
                                 (lower ? share : 1 - share) * feet[j].normal;
                found.bend = std::min(found.bend, 0.25 * full * full / width);
            }
    }
    Found look(Vector x) {
        const int winner = nearest_of(x);
        const double infinity = std::numeric_limits<double>::infinity();
        Found found{infinity, feet[winner].radius, infinity, {0, 0, 0}, winner};
        carve_out();
        for (int a = 0; a < some; a++) {
            const int i = close[a];
            if (level[i] < found.distance)
                found.distance = level[i], found.gradient = feet[i].normal, found.bend = feet[i].radius;
            if (apart[winner * count + i] > 0 && feet[i].distance < found.facing && joint(winner, i) > 0)
                found.facing = feet[i].distance;
        }
        fill_creases(found);
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

}  // namespace

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
                const Found found = body.look(read(points + 3 * p));
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
            Found found = body.look(x);
            for (std::int64_t step = 0; step < steps.most && std::abs(found.distance) > steps.on_skin; step++) {
                const double square = std::max(dot(found.gradient, found.gradient), 0.1), slope = std::sqrt(square);
                const double far = std::min(std::max(found.distance / slope, -steps.longest), steps.longest);
                x = x - far / slope * found.gradient;
                found = body.look(x);
            }
            if (std::abs(found.distance) > steps.on_skin) {  // it jumps from side to side of a crease
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
