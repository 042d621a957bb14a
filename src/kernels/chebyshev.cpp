// Functions of a sparse matrix as sums of polynomials, for many columns that stay in a cache.
#include <algorithm>
#include <vector>

#include "kernels.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {

constexpr std::int64_t lane = 16, wide = 2 * lane;  // columns at once
constexpr std::int64_t much = 1 << 22;              // products that one thread has done before others are awake

// dst = half A src + old dst, and total += factor dst
template <class Real>
static void recur(const Real *values, const std::int32_t *columns, const std::int32_t *rows, std::int64_t n, Real half,
                  Real old, Real factor, const Real *src, Real *dst, Real *total) {
    for (std::int64_t i = 0; i < n; i++) {
        Real low[lane] = {}, high[lane] = {};  // two arrays, or compilers keep the sums in memory
        for (std::int32_t e = rows[i]; e < rows[i + 1]; e++) {
            const Real *from = src + columns[e] * wide, value = values[e];
#pragma omp simd
            for (std::int64_t l = 0; l < lane; l++) low[l] += value * from[l];
#pragma omp simd
            for (std::int64_t l = 0; l < lane; l++) high[l] += value * from[l + lane];
        }
        Real sums[wide], *to = dst + i * wide, *sum = total + i * wide;
        std::copy(low, low + lane, sums), std::copy(high, high + lane, sums + lane);
#pragma omp simd
        for (std::int64_t l = 0; l < wide; l++) {
            to[l] = half * sums[l] + old * to[l];
            sum[l] += factor * to[l];
        }
    }
}

template <class Real>
void chebyshev_sum(const Real *values, const std::int32_t *columns, const std::int32_t *rows, std::int64_t n,
                   const Real *factors, std::int64_t terms, Real *x, std::int64_t width) {
#pragma omp parallel if (rows[n] * terms * width > much)
    {
        std::vector<Real> room(3 * n * wide);
#pragma omp for schedule(static)
        for (std::int64_t first = 0; first < width; first += wide) {
            const std::int64_t count = std::min(wide, width - first);
            Real *before = room.data(), *here = before + n * wide, *total = here + n * wide;
            std::fill(room.begin(), room.end(), Real(0));
            for (std::int64_t i = 0; i < n; i++)
                for (std::int64_t l = 0; l < count; l++) {
                    before[i * wide + l] = x[i * width + first + l];
                    total[i * wide + l] = factors[0] * before[i * wide + l];
                }
            for (std::int64_t t = 1; t < terms; t++) {
                if (t == 1)
                    recur(values, columns, rows, n, Real(0.5), Real(0), factors[t], before, here, total);
                else {
                    recur(values, columns, rows, n, Real(1), Real(1), factors[t], here, before, total);
                    std::swap(before, here);
                }
            }
            for (std::int64_t i = 0; i < n; i++)
                for (std::int64_t l = 0; l < count; l++) x[i * width + first + l] = total[i * wide + l];
        }
    }
}

#define AIRTACT_CHEBYSHEV(Real)                                                                                     \
    template void chebyshev_sum<Real>(const Real *, const std::int32_t *, const std::int32_t *, std::int64_t,       \
                                      const Real *, std::int64_t, Real *, std::int64_t);
AIRTACT_CHEBYSHEV(float)
AIRTACT_CHEBYSHEV(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
