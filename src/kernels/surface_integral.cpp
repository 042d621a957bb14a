// The surface integral of Kirchhoff and Helmholtz for finite elements alone: plain double precision with the standard
// library's sine, cosine and exponential. Boundary elements have loops of their own, so that each solver can verify the
// other.
#include <cmath>
#include <vector>

#include "kernels.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr std::int64_t block = 256;  // pairs whose waves are computed before they are summed

// One point against a block of others: G = e^{ikr}/r, and H = n (dG/dr)/r with n = normal . (other - point)
struct Waves {
    double real[block], imag[block], slope_real[block], slope_imag[block];

    void fill(const double *x, const double *others, std::int64_t size, Wavenumber k) {
        double distance[block], inverse[block], level[block];
#pragma omp simd
        for (std::int64_t j = 0; j < size; j++) {
            const double a = others[3 * j] - x[0], b = others[3 * j + 1] - x[1], c = others[3 * j + 2] - x[2];
            distance[j] = std::sqrt(a * a + b * b + c * c);
            level[j] = inverse[j] = 1 / distance[j];
        }
        if (k.imag != 0)
#pragma omp simd
            for (std::int64_t j = 0; j < size; j++) level[j] *= std::exp(-k.imag * distance[j]);
        // Apart, since compilers vectorise neither of a sine and a cosine that stand together.
#pragma omp simd
        for (std::int64_t j = 0; j < size; j++) real[j] = level[j] * std::cos(k.real * distance[j]);
#pragma omp simd
        for (std::int64_t j = 0; j < size; j++) imag[j] = level[j] * std::sin(k.real * distance[j]);
#pragma omp simd
        for (std::int64_t j = 0; j < size; j++) {
            const double p = -(k.imag + inverse[j]) * inverse[j], q = k.real * inverse[j];  // (ik - 1/r)/r
            slope_real[j] = p * real[j] - q * imag[j];
            slope_imag[j] = p * imag[j] + q * real[j];
        }
    }

    void project(const double *x, const double *others, const double *normals, std::int64_t stride, std::int64_t size) {
#pragma omp simd
        for (std::int64_t j = 0; j < size; j++) {
            const double *n = normals + stride * j;
            const double along = n[0] * (others[3 * j] - x[0]) + n[1] * (others[3 * j + 1] - x[1]) +
                                 n[2] * (others[3 * j + 2] - x[2]);
            slope_real[j] *= along;
            slope_imag[j] *= along;
        }
    }
};

struct Parts {  // real and imaginary parts of strengths (count, sounds), one sound after another
    std::vector<double> real, imag;

    Parts(const std::complex<double> *strength, std::int64_t count, std::int64_t sounds)
        : real(count * sounds), imag(count * sounds) {
        for (std::int64_t j = 0; j < count; j++)
            for (std::int64_t s = 0; s < sounds; s++) {
                real[s * count + j] = strength[j * sounds + s].real();
                imag[s * count + j] = strength[j * sounds + s].imag();
            }
    }
};

std::complex<double> sum(const double *a, const double *b, const double *c, const double *d, std::int64_t size) {
    double real = 0, imag = 0;
#pragma omp simd reduction(+ : real, imag)
    for (std::int64_t j = 0; j < size; j++) {
        real += a[j] * c[j] - b[j] * d[j];
        imag += a[j] * d[j] + b[j] * c[j];
    }
    return {real, imag};
}

}  // namespace

void surface_integral(const double *points, std::int64_t n, const double *sources, const double *normals,
                      std::int64_t m, const std::complex<double> *monopoles, const std::complex<double> *dipoles,
                      std::int64_t sounds, Wavenumber k, std::complex<double> *out) {
    const Parts single(monopoles, m, sounds), twin(dipoles, m, sounds);
#pragma omp parallel for schedule(static)
    for (std::int64_t i = 0; i < n; i++) {
        Waves waves;
        const double *x = points + 3 * i;
        for (std::int64_t s = 0; s < sounds; s++) out[i * sounds + s] = 0;
        for (std::int64_t j = 0; j < m; j += block) {
            const std::int64_t size = m - j < block ? m - j : block;
            waves.fill(x, sources + 3 * j, size, k);
            waves.project(x, sources + 3 * j, normals + 3 * j, 3, size);
            for (std::int64_t s = 0; s < sounds; s++) {
                const std::int64_t at = s * m + j;
                out[i * sounds + s] += sum(waves.real, waves.imag, &single.real[at], &single.imag[at], size) +
                                       sum(waves.slope_real, waves.slope_imag, &twin.real[at], &twin.imag[at], size);
            }
        }
    }
}

void normal_derivative(const double *points, const double *normals, std::int64_t n, const double *sources,
                       std::int64_t m, const std::complex<double> *strength, std::int64_t sounds, Wavenumber k,
                       std::complex<double> *out) {
    const Parts parts(strength, m, sounds);
#pragma omp parallel for schedule(static)
    for (std::int64_t i = 0; i < n; i++) {
        Waves waves;
        const double *x = points + 3 * i;
        for (std::int64_t s = 0; s < sounds; s++) out[i * sounds + s] = 0;
        for (std::int64_t j = 0; j < m; j += block) {
            const std::int64_t size = m - j < block ? m - j : block;
            waves.fill(x, sources + 3 * j, size, k);
            waves.project(x, sources + 3 * j, normals + 3 * i, 0, size);
            for (std::int64_t s = 0; s < sounds; s++)  // towards the sources it is the other way round
                out[i * sounds + s] -=
                    sum(waves.slope_real, waves.slope_imag, &parts.real[s * m + j], &parts.imag[s * m + j], size);
        }
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
