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

}  // namespace

void hull_distances(const double *points, std::int64_t n, const double *balls, const std::int64_t *parts,
                    std::int64_t count, double *out) {
    const std::vector<Hull> hulls = hulls_of(balls, parts, count);
#pragma omp parallel for schedule(static)
    for (std::int64_t p = 0; p < n; p++)
        for (std::int64_t i = 0; i < count; i++) out[p * count + i] = hulls[i].at(read(points + 3 * p)).distance;
}

void blended_distance(const double *points, std::int64_t n, const double *balls, const std::int64_t *parts,
                      std::int64_t count, const double *blend, const double *apart, double carve,
                      double reach, double *distance, double *gradient, double *bend, double *facing, std::int64_t *nearest) {
    const std::vector<Hull> hulls = hulls_of(balls, parts, count);
#pragma omp parallel
    {
        std::vector<double> least(count), level(count);
        std::vector<Foot> feet(count);
        std::vector<int> close(count);
#pragma omp for schedule(dynamic, 256)
        for (std::int64_t p = 0; p < n; p++) {
            const Vector x = read(points + 3 * p);
            int first = 0;
            for (int i = 0; i < count; i++) {
                least[i] = hulls[i].least(x);
                if (least[i] < least[first]) first = i;
            }
            feet[first] = hulls[first].at(x);
            double best = feet[first].distance;
            int some = 0;
            for (int i = 0; i < count; i++) {
                if (i != first && least[i] >= best + reach) continue;
                if (i != first) feet[i] = hulls[i].at(x);
                best = std::min(best, feet[i].distance);
                close[some++] = i;
            }
            // Distance of the nearest hull that joins hulls i and j; they stand apart where j is nearer
            const auto joint = [&](int i, int j) {
                double found = std::numeric_limits<double>::infinity();
                for (int c = 0; c < some; c++)
                    if (blend[i * count + close[c]] > 0 && blend[j * count + close[c]] > 0)
                        found = std::min(found, feet[close[c]].distance);
                return found - feet[j].distance;
            };
            int winner = first;
            double across = std::numeric_limits<double>::infinity();
            for (int a = 0; a < some; a++) {
                const int i = close[a];
                level[i] = feet[i].distance;
                for (int b = 0; b < some && carve > 0; b++) {
                    const int j = close[b];
                    if (apart[i * count + j] <= 0) continue;
                    const double wide = std::min(std::max(joint(i, j) / (0.4 * carve), 0.0), 1.0);
                    if (wide > 0) level[i] = std::max(level[i], wide * carve - feet[j].distance);
                }
                if (feet[i].distance < feet[winner].distance) winner = i;
            }
            double value = std::numeric_limits<double>::infinity(), round = feet[winner].radius;
            Vector slope{0, 0, 0};
            for (int a = 0; a < some; a++) {
                const int i = close[a];
                if (level[i] < value) value = level[i], slope = feet[i].normal, round = feet[i].radius;
                if (apart[winner * count + i] > 0 && joint(winner, i) > 0) across = std::min(across, feet[i].distance);
            }
            for (int a = 0; a < some; a++)
                for (int b = 0; b < a; b++) {
                    const int i = close[a], j = close[b];
                    double width = blend[i * count + j];
                    if (width <= 0) continue;
                    const double full = width;
                    width *= 0.5 * (1 - dot(feet[i].normal, feet[j].normal));
                    const double over = width - std::abs(level[i] - level[j]);
                    if (over <= 0) continue;
                    const double joined = std::min(level[i], level[j]) - over * over / (4 * width);
                    if (joined >= value) continue;
                    const double share = over / (2 * width);
                    const bool lower = level[i] < level[j];
                    value = joined;
                    slope = (lower ? 1 - share : share) * feet[i].normal + (lower ? share : 1 - share) * feet[j].normal;
                    round = std::min(round, 0.25 * full * full / width);
                }
            distance[p] = value;
            if (gradient) gradient[3 * p] = slope.x, gradient[3 * p + 1] = slope.y, gradient[3 * p + 2] = slope.z;
            if (bend) bend[p] = round;
            if (facing) facing[p] = across;
            if (nearest) nearest[p] = winner;
        }
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
