// The point of many curved panels that is closest to a target, over a binary tree of boxes.
#include <algorithm>
#include <cmath>
#include <limits>

#include "kernels.hpp"

#include "patch.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

double squared_distance_to_box(const double *lower, const double *upper, const double *x) {
    double sum = 0;
    for (int d = 0; d < 3; d++) {
        const double out = std::max({lower[d] - x[d], x[d] - upper[d], 0.0});
        sum += out * out;
    }
    return sum;
}

}  // namespace

void closest_on_panels(const double *targets, std::int64_t n, const double *quadratic_triangles, const std::int64_t *order,
                       std::int64_t panels, const double *lower, const double *upper, std::int64_t leaves,
                       std::int64_t *panel, double *reference, double *distance) {
#pragma omp parallel for schedule(dynamic, 64)
    for (std::int64_t i = 0; i < n; i++) {
        const double *x = targets + 3 * i;
        const double within = distance[i];
        double best = within * within;
        std::int64_t stack[64];
        int depth = 0;
        stack[depth++] = 1;
        while (depth) {
            std::int64_t box = stack[--depth];
            if (squared_distance_to_box(lower + 3 * box, upper + 3 * box, x) >= best) continue;
            while (box < leaves) {  // go down into the nearer half first
                const std::int64_t left = 2 * box, right = left + 1;
                const double to_left = squared_distance_to_box(lower + 3 * left, upper + 3 * left, x);
                const double to_right = squared_distance_to_box(lower + 3 * right, upper + 3 * right, x);
                const bool left_first = to_left <= to_right;
                if ((left_first ? to_right : to_left) < best) stack[depth++] = left_first ? right : left;
                box = left_first ? left : right;
            }
            if (box - leaves >= panels) continue;
            const std::int64_t found = order[box - leaves];
            Patches<1> patch;
            Closest<1> candidate;
            patch.put(0, quadratic_triangles + 18 * found, x);
            closest_points(patch, candidate);
            if (candidate.squared[0] < best) {
                best = candidate.squared[0];
                panel[i] = found;
                reference[2 * i] = candidate.u[0];
                reference[2 * i + 1] = candidate.v[0];
            }
        }
        distance[i] = best < within * within ? std::sqrt(best) : std::numeric_limits<double>::infinity();
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
