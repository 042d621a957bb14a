// Neighbours and thickness, by brute force: a few nanoseconds a pair, no tree to keep right.
#include <algorithm>

#include "kernels.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {

void near_pairs(const double *targets, std::int64_t n, const double *centres, const double *reach, std::int64_t panels,
                std::int64_t *first, std::int64_t *pair_panel) {
#pragma omp parallel for schedule(static)
    for (std::int64_t i = 0; i < n; i++) {
        std::int64_t count = pair_panel ? first[i] : 0;
        for (std::int64_t t = 0; t < panels; t++) {
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

void inscribed_diameter(const double *points, const double *normals, const std::int64_t *body, std::int64_t n,
                        const std::int64_t *some, std::int64_t count, double largest, double *diameter) {
#pragma omp parallel for schedule(static)
    for (std::int64_t e = 0; e < count; e++) {
        const std::int64_t i = some[e];
        const double *x = points + 3 * i, *a = normals + 3 * i;
        double smallest = largest;
        for (std::int64_t j = 0; j < n; j++) {
            const double *y = points + 3 * j, *b = normals + 3 * j;
            // skins that face the same way do not bound the thickness: this keeps a crease from counting as thin
            if (body[j] != body[i] || a[0] * b[0] + a[1] * b[1] + a[2] * b[2] > 0) continue;
            const double d[3] = {x[0] - y[0], x[1] - y[1], x[2] - y[2]};
            const double depth = d[0] * a[0] + d[1] * a[1] + d[2] * a[2];
            if (depth > 0) smallest = std::min(smallest, (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) / depth);
        }
        diameter[e] = smallest;
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
