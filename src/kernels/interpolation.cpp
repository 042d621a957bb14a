// Values between those of a table, by weights along three of its axes.
#include <vector>

#include "kernels.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {

constexpr std::int64_t few = 1 << 22;  // products that one thread has done before others are awake

void interpolate(const std::complex<float> *table, const std::int64_t *first, std::int64_t n, const std::int64_t *steps,
                 const float *u, std::int64_t us, const float *v, std::int64_t vs, const float *w, std::int64_t ws,
                 std::int64_t sounds, std::complex<double> *out) {
    const std::int64_t width = 2 * ws * sounds;
#pragma omp parallel if (n * us * vs * width > few)
    {
        std::vector<float> sums(width);
        float *const sum = sums.data();
#pragma omp for schedule(static)
        for (std::int64_t i = 0; i < n; i++) {
#ifdef __GNUC__
            for (std::int64_t a = 0; i + 1 < n && a < us; a++) {  // the next rows, from memory that others may have used
                const std::complex<float> *row = table + first[i + 1] + a * steps[0];
                for (std::int64_t l = 0; l < (vs - 1) * steps[1] + ws * sounds; l += 8) __builtin_prefetch(row + l);
            }
#endif
            for (std::int64_t l = 0; l < width; l++) sum[l] = 0;
            for (std::int64_t a = 0; a < us; a++)
                for (std::int64_t b = 0; b < vs; b++) {
                    const float weight = u[us * i + a] * v[vs * i + b];
                    const float *row = reinterpret_cast<const float *>(table + first[i] + a * steps[0] + b * steps[1]);
#pragma omp simd
                    for (std::int64_t l = 0; l < width; l++) sum[l] += weight * row[l];
                }
            for (std::int64_t s = 0; s < sounds; s++) {
                double re = 0, im = 0;
                for (std::int64_t c = 0; c < ws; c++) {
                    re += double(w[ws * i + c]) * sum[2 * (sounds * c + s)];
                    im += double(w[ws * i + c]) * sum[2 * (sounds * c + s) + 1];
                }
                out[i * sounds + s] = {re, im};
            }
        }
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
