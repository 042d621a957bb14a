// The point of many curved panels that is closest to a target, over a binary tree of boxes.
#include <algorithm>
#include <cmath>
#include <limits>

#include "kernels.hpp"

#include "patch.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

// The search for one target: the boxes that it has still to visit, the next one last
struct Search {
    std::int64_t target, depth, box[64];
    double away[64], best;  // squared distances of these boxes, and of the closest panel so far
    double x[6];            // the target, twice

    void start(std::int64_t of, const double *targets, double within) {
        target = of, depth = 1, box[0] = 1, away[0] = 0, best = within * within;
        for (int d = 0; d < 6; d++) x[d] = targets[3 * of + d % 3];
    }
    // The next leaf that may hold a closer panel, or -1 at the end
    std::int64_t next(const double *lower, const double *upper, const double *sides, std::int64_t leaves) {
        while (depth) {
            std::int64_t inner = box[--depth];
            if (away[depth] >= best) continue;
            while (inner < leaves) {  // go down into the nearer half first
                const std::int64_t left = 2 * inner, right = left + 1;
                double out[6];
#pragma omp simd
                for (int d = 0; d < 6; d++) {  // both halves, which are stored side by side
                    const double below = lower[3 * left + d] - x[d], above = x[d] - upper[3 * left + d];
                    const double most = below > above ? below : above;
                    out[d] = most > 0 ? most * most : 0;
                }
                const double to_left = out[0] + out[1] + out[2], to_right = out[3] + out[4] + out[5];
                const bool left_first = to_left <= to_right;
                box[depth] = left_first ? right : left, away[depth] = left_first ? to_right : to_left;
                if (away[depth] < best) depth++;
                inner = left_first ? left : right;
            }
            const double *side = sides + 12 * (inner - leaves);
            double beyond = 0;  // boxes of neighbours overlap, but the panels lie beyond their common edge
            for (int e = 0; e < 3; e++) {
                const double gap = side[4 * e] * x[0] + side[4 * e + 1] * x[1] + side[4 * e + 2] * x[2] - side[4 * e + 3];
                beyond = gap > beyond ? gap : beyond;
            }
            if (beyond > 0 && beyond * beyond >= best) continue;
            return inner - leaves;
        }
        return -1;
    }
};

}  // namespace

void closest_on_panels(const double *targets, std::int64_t n, const double *quadratic_triangles, const std::int64_t *order,
                       const double *lower, const double *upper, const double *sides, std::int64_t leaves,
                       std::int64_t *panel, double *reference, double *distance) {
    constexpr std::int64_t each = 128;  // targets for one thread
    constexpr int some = 16;            // searches side by side, whose panels are evaluated at once
#pragma omp parallel for schedule(dynamic)
    for (std::int64_t begin = 0; begin < n; begin += each) {
        const std::int64_t end = std::min(n, begin + each);
        Search searches[some];
        std::int64_t tried[some], waiting = begin;
        Patches<some> patches;
        Closest<some> closest;
        int count = 0;
        for (; count < some && waiting < end; count++, waiting++) searches[count].start(waiting, targets, distance[waiting]);
        while (true) {
            for (int l = 0; l < count;) {
                Search &search = searches[l];
                const std::int64_t leaf = search.next(lower, upper, sides, leaves);
                if (leaf >= 0) {
                    tried[l] = order[leaf];
                    patches.put(l, quadratic_triangles + 18 * tried[l], search.x);
                    l++;
                    continue;
                }
                double &within = distance[search.target];
                within = search.best < within * within ? std::sqrt(search.best) : std::numeric_limits<double>::infinity();
                if (waiting < end)
                    search.start(waiting, targets, distance[waiting]), waiting++;
                else
                    search = searches[--count];
            }
            if (!count) break;
            for (int l = count; l < some; l++)  // the rest repeats the first one
                for (int m = 0; m < 6; m++)
                    for (int d = 0; d < 3; d++) patches.c[m][d][l] = patches.c[m][d][0];
            closest_points(patches, closest);
            for (int l = 0; l < count; l++)
                if (closest.squared[l] < searches[l].best) {
                    const std::int64_t i = searches[l].target;
                    searches[l].best = closest.squared[l];
                    panel[i] = tried[l], reference[2 * i] = closest.u[l], reference[2 * i + 1] = closest.v[l];
                }
        }
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
