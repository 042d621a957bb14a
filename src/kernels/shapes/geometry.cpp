// Neighbours, by boxes: a few nanoseconds a pair, no tree to keep right; an order in which neighbours lie together; the nodes of
// panels, and how far panels are from points.
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

#include "kernels.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {

namespace {

constexpr std::int64_t many = 2000;  // points, below which one thread has done them sooner

// Parts of 1 in millionths, so that symmetric points do not differ by rounding
std::int64_t rounded(double part) { return std::llrint(1e6 * part); }

double squared(const double *one, const double *other) {  // distance
    const double x = one[0] - other[0], y = one[1] - other[1], z = one[2] - other[2];
    return x * x + y * y + z * z;
}

// Boxes as wide as the largest ball, each with the balls that may reach into it
struct Boxes {
    static constexpr std::int64_t most = 64;  // along each axis
    double lower[3], width = 0;
    std::int64_t count[3];
    std::vector<std::int64_t> first, ball;

    Boxes(const double *centres, const double *reach, std::int64_t n) {
        double upper[3];
        for (int d = 0; d < 3; d++) lower[d] = std::numeric_limits<double>::infinity(), upper[d] = -lower[d];
        for (std::int64_t t = 0; t < n; t++) {
            width = std::max(width, reach[t]);
            for (int d = 0; d < 3; d++) {
                lower[d] = std::min(lower[d], centres[3 * t + d] - reach[t]);
                upper[d] = std::max(upper[d], centres[3 * t + d] + reach[t]);
            }
        }
        for (int d = 0; d < 3; d++) width = std::max(width, n ? (upper[d] - lower[d]) / most : 0.0);
        for (int d = 0; d < 3; d++) count[d] = n && width > 0 ? std::int64_t((upper[d] - lower[d]) / width) + 1 : 0;
        first.assign(count[0] * count[1] * count[2] + 1, 0);
        if (first.size() == 1) return;
        for (int pass = 0; pass < 2; pass++) {  // counts, then fills, each box's balls in order
            for (std::int64_t t = n - 1; t >= 0; t--) {
                std::int64_t from[3], to[3];
                for (int d = 0; d < 3; d++) {
                    from[d] = along(centres[3 * t + d] - reach[t], d);
                    to[d] = along(centres[3 * t + d] + reach[t], d);
                }
                for (std::int64_t i = from[0]; i <= to[0]; i++)
                    for (std::int64_t j = from[1]; j <= to[1]; j++)
                        for (std::int64_t k = from[2]; k <= to[2]; k++) {
                            std::int64_t &end = first[(i * count[1] + j) * count[2] + k];
                            if (pass) ball[--end] = t;
                            else end++;
                        }
            }
            if (pass) break;
            for (std::size_t b = 1; b < first.size(); b++) first[b] += first[b - 1];
            ball.resize(first.back());
        }
    }

    std::int64_t along(double x, int d) const {
        return std::min(count[d] - 1, std::max<std::int64_t>(0, std::int64_t((x - lower[d]) / width)));
    }

    std::int64_t holding(const double *x) const {  // -1 outside
        for (int d = 0; d < 3; d++)
            if (!(x[d] >= lower[d] && x[d] - lower[d] < width * double(count[d]))) return -1;
        return (along(x[0], 0) * count[1] + along(x[1], 1)) * count[2] + along(x[2], 2);
    }
};

}  // namespace

std::vector<std::int64_t> near_pairs(const double *targets, std::int64_t n, const double *centres, const double *reach,
                                     std::int64_t panels, std::int64_t *first) {
    const Boxes boxes(centres, reach, panels);
    const std::int64_t parts = n > many ? 32 : 1;
    std::vector<std::vector<std::int64_t>> found(parts);
#pragma omp parallel for schedule(static) if (parts > 1)
    for (std::int64_t part = 0; part < parts; part++)
        for (std::int64_t i = n * part / parts; i < n * (part + 1) / parts; i++) {
            const std::size_t before = found[part].size();
            const std::int64_t box = panels ? boxes.holding(targets + 3 * i) : -1;
            for (std::int64_t l = box < 0 ? 0 : boxes.first[box]; box >= 0 && l < boxes.first[box + 1]; l++) {
                const std::int64_t t = boxes.ball[l];
                if (squared(centres + 3 * t, targets + 3 * i) < reach[t] * reach[t]) found[part].push_back(t);
            }
            first[i + 1] = found[part].size() - before;
        }
    first[0] = 0;
    for (std::int64_t i = 0; i < n; i++) first[i + 1] += first[i];
    std::vector<std::int64_t> all = std::move(found[0]);
    all.reserve(first[n]);
    for (std::int64_t part = 1; part < parts; part++) all.insert(all.end(), found[part].begin(), found[part].end());
    return all;
}

void mark_blocks(const std::int64_t *first, std::int64_t n, const std::int64_t *panel, std::int64_t targets, std::int64_t panels,
                 std::int64_t columns, bool *met) {
    for (std::int64_t i = 0; i < n; i++)
        for (std::int64_t e = first[i]; e < first[i + 1]; e++) met[i / targets * columns + panel[e] / panels] = true;
}

void place_nodes(const double *panels, std::int64_t n, const double *rule, const double *weights, double *points,
                 double *normals, double *areas, double *centres, double *radii) {
    constexpr int nodes = 6;
    const auto at = [](const double *functions, const double *panel, double *out) {
        for (int d = 0; d < 3; d++) {
            out[d] = 0;
            for (int s = 0; s < nodes; s++) out[d] += functions[s] * panel[3 * s + d];
        }
    };
#pragma omp parallel for schedule(static) if (n > many)
    for (std::int64_t t = 0; t < n; t++) {
        const double *const panel = panels + 3 * nodes * t;
        for (int j = 0; j < nodes; j++) {
            const std::int64_t i = nodes * t + j;
            double u[3], v[3];
            at(rule + nodes * j, panel, points + 3 * i);
            at(rule + nodes * (nodes + j), panel, u), at(rule + nodes * (2 * nodes + j), panel, v);
            const double normal[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
            const double size = std::sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
            areas[i] = size * weights[j];
            for (int d = 0; d < 3; d++) normals[3 * i + d] = normal[d] / size;
        }
        at(rule + 3 * nodes * nodes, panel, centres + 3 * t);
        double farthest = 0;
        for (int s = 0; s < nodes; s++) farthest = std::max(farthest, squared(panel + 3 * s, centres + 3 * t));
        radii[t] = std::sqrt(farthest);
    }
}

void panel_distances(const double *panels, std::int64_t n, const double *points, std::int64_t count, double within,
                     double *distance) {
    constexpr int nodes = 6, samples = nodes + 1;
    double lower[3], upper[3];
    for (int d = 0; d < 3; d++) lower[d] = std::numeric_limits<double>::infinity(), upper[d] = -lower[d];
    for (std::int64_t i = 0; i < 3 * nodes * n; i++)
        lower[i % 3] = std::min(lower[i % 3], panels[i] - within), upper[i % 3] = std::max(upper[i % 3], panels[i] + within);
    std::vector<double> near;
    for (std::int64_t i = 0; i < count; i++) {
        const double *const p = points + 3 * i;
        if (p[0] > lower[0] && p[0] < upper[0] && p[1] > lower[1] && p[1] < upper[1] && p[2] > lower[2] && p[2] < upper[2])
            near.insert(near.end(), p, p + 3);
    }
    const std::int64_t left = near.size() / 3;
#pragma omp parallel for schedule(static) if (n * left > 500000)
    for (std::int64_t t = 0; t < n; t++) {
        double at[samples][3], *const middle = at[nodes], radius = 0, least = within * within;
        bool met = false;
        std::copy(panels + 3 * nodes * t, panels + 3 * nodes * (t + 1), at[0]);
        for (int d = 0; d < 3; d++) middle[d] = (at[0][d] + at[1][d] + at[2][d] + at[3][d] + at[4][d] + at[5][d]) / nodes;
        for (int s = 0; s < nodes; s++) radius = std::max(radius, squared(at[s], middle));
        const double reach = within + std::sqrt(radius), reach2 = reach * reach;
        for (std::int64_t i = 0; i < left; i++) {
            if (squared(&near[3 * i], middle) >= reach2) continue;
            for (int s = 0; s < samples; s++) {
                const double found = squared(&near[3 * i], at[s]);
                if (found < least) least = found, met = true;
            }
        }
        distance[t] = met ? std::sqrt(least) : std::numeric_limits<double>::infinity();
    }
}

namespace {

// Unit direction in which some points around the origin extend farthest: the farthest one times a power of their covariance
void longest(const std::vector<double> &off, double *along) {
    double matrix[3][3] = {}, sum = 0, most = 0;
    for (std::size_t i = 0; i < off.size(); i += 3) {
        const double size = off[i] * off[i] + off[i + 1] * off[i + 1] + off[i + 2] * off[i + 2];
        sum += size, most = std::max(most, size);
        for (int c = 0; c < 3; c++)
            for (int d = 0; d < 3; d++) matrix[c][d] += off[i + c] * off[i + d];
    }
    if (most == 0) return;
    std::int64_t farthest = -1;
    for (std::size_t i = 0; i < off.size(); i += 3) {
        const double size = off[i] * off[i] + off[i + 1] * off[i + 1] + off[i + 2] * off[i + 2];
        if (rounded(size / most) > farthest) farthest = rounded(size / most), std::copy(&off[i], &off[i] + 3, along);
    }
    for (auto &row : matrix)
        for (double &entry : row) entry /= sum;
    for (int step = 0; step < 16; step++) {
        double next[3];
        for (int c = 0; c < 3; c++) next[c] = matrix[c][0] * along[0] + matrix[c][1] * along[1] + matrix[c][2] * along[2];
        const double size = std::sqrt(next[0] * next[0] + next[1] * next[1] + next[2] * next[2]);
        for (int c = 0; c < 3; c++) along[c] = next[c] / size;
    }
}

// Sorts some points by their order along the direction of their largest extent
void sort_along(const double *points, std::int64_t *begin, std::int64_t *end) {
    double centre[3] = {};
    for (const std::int64_t *i = begin; i < end; i++)
        for (int d = 0; d < 3; d++) centre[d] += points[3 * *i + d] / double(end - begin);
    std::vector<double> off, along;
    for (const std::int64_t *i = begin; i < end; i++)
        for (int d = 0; d < 3; d++) off.push_back(points[3 * *i + d] - centre[d]);
    double axis[3] = {}, most = 0;
    longest(off, axis);
    for (std::size_t i = 0; i < off.size(); i += 3) {
        along.push_back(off[i] * axis[0] + off[i + 1] * axis[1] + off[i + 2] * axis[2]);
        most = std::max(most, std::abs(along.back()));
    }
    if (most == 0) return;  // all in one place
    std::vector<std::pair<std::int64_t, std::int64_t>> keys;
    for (std::size_t i = 0; i < along.size(); i++) keys.emplace_back(rounded(along[i] / most), begin[i]);
    std::stable_sort(keys.begin(), keys.end(), [](const auto &one, const auto &other) { return one.first < other.first; });
    std::transform(keys.begin(), keys.end(), begin, [](const auto &key) { return key.second; });
}

}  // namespace

void block_order(const double *points, std::int64_t n, std::int64_t each, std::int64_t *order) {
    std::iota(order, order + n, 0);
    std::vector<std::pair<std::int64_t, std::int64_t>> waiting{{0, n}};
    while (!waiting.empty()) {
        const auto [begin, end] = waiting.back();
        waiting.pop_back();
        const std::int64_t blocks = (end - begin + each - 1) / each, middle = begin + each * (blocks / 2);
        if (blocks <= 1) continue;
        sort_along(points, order + begin, order + end);
        waiting.emplace_back(middle, end), waiting.emplace_back(begin, middle);
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
