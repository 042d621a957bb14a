// Neighbours, by boxes: a few nanoseconds a pair, no tree to keep right.
#include <algorithm>
#include <limits>
#include <vector>

#include "kernels.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {

namespace {

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

void near_pairs(const double *targets, std::int64_t n, const double *centres, const double *reach, std::int64_t panels,
                std::int64_t *first, std::int64_t *pair_panel) {
    const Boxes boxes(centres, reach, panels);
#pragma omp parallel for schedule(static) if (n > 256)
    for (std::int64_t i = 0; i < n; i++) {
        std::int64_t count = pair_panel ? first[i] : 0;
        const std::int64_t box = panels ? boxes.holding(targets + 3 * i) : -1;
        for (std::int64_t l = box < 0 ? 0 : boxes.first[box]; box >= 0 && l < boxes.first[box + 1]; l++) {
            const std::int64_t t = boxes.ball[l];
            const double dx = centres[3 * t] - targets[3 * i], dy = centres[3 * t + 1] - targets[3 * i + 1],
                         dz = centres[3 * t + 2] - targets[3 * i + 2];
            if (dx * dx + dy * dy + dz * dz < reach[t] * reach[t]) {
                if (pair_panel) pair_panel[count] = t;
                count++;
            }
        }
        if (!pair_panel) first[i + 1] = count;
    }
    if (pair_panel) return;
    first[0] = 0;
    for (std::int64_t i = 0; i < n; i++) first[i + 1] += first[i];
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
