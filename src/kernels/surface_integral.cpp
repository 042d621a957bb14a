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

struct Axes {  // (count, 3) as three lines
    std::vector<double> x, y, z;

    Axes(const double *points, std::int64_t count) : x(count), y(count), z(count) {
        for (std::int64_t j = 0; j < count; j++) x[j] = points[3 * j], y[j] = points[3 * j + 1], z[j] = points[3 * j + 2];
    }
};

// One point against a block of sources: G = e^{ikr}/r, and the vector (source - point) (dG/dr)/r
struct Waves {
    double a[block], b[block], c[block], real[block], imag[block], slope_real[block], slope_imag[block];

    void fill(const double *point, const Axes &sources, std::int64_t first, std::int64_t size, Wavenumber k) {
        const double *x = &sources.x[first], *y = &sources.y[first], *z = &sources.z[first];
        double distance[block], inverse[block], level[block];
#pragma omp simd
        for (std::int64_t j = 0; j < size; j++) {
            a[j] = x[j] - point[0], b[j] = y[j] - point[1], c[j] = z[j] - point[2];
            distance[j] = std::sqrt(a[j] * a[j] + b[j] * b[j] + c[j] * c[j]);
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

    void along(const Axes &normals, std::int64_t first, std::int64_t size) {  // at the sources
        const double *x = &normals.x[first], *y = &normals.y[first], *z = &normals.z[first];
#pragma omp simd
        for (std::int64_t j = 0; j < size; j++) {
            const double part = x[j] * a[j] + y[j] * b[j] + z[j] * c[j];
            slope_real[j] *= part, slope_imag[j] *= part;
        }
    }

    void along(const double *normal, std::int64_t size) {  // at the point, where the distance grows the other way
#pragma omp simd
        for (std::int64_t j = 0; j < size; j++) {
            const double part = -(normal[0] * a[j] + normal[1] * b[j] + normal[2] * c[j]);
            slope_real[j] *= part, slope_imag[j] *= part;
        }
    }
};

struct Parts {  // real and imaginary parts of strengths (count, excitations), one excitation after another
    std::vector<double> real, imag;

    Parts(const std::complex<double> *strength, std::int64_t count, std::int64_t excitations)
        : real(count * excitations), imag(count * excitations) {
        for (std::int64_t j = 0; j < count; j++)
            for (std::int64_t s = 0; s < excitations; s++) {
                real[s * count + j] = strength[j * excitations + s].real();
                imag[s * count + j] = strength[j * excitations + s].imag();
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
                      std::int64_t excitations, Wavenumber k, std::complex<double> *out) {
    const Axes positions(sources, m), directions(normals, m);
    const Parts single(monopoles, m, excitations), twin(dipoles, m, excitations);
#pragma omp parallel for schedule(static)
    for (std::int64_t i = 0; i < n; i++) {
        Waves waves;
        for (std::int64_t s = 0; s < excitations; s++) out[i * excitations + s] = 0;
        for (std::int64_t j = 0; j < m; j += block) {
            const std::int64_t size = m - j < block ? m - j : block;
            waves.fill(points + 3 * i, positions, j, size, k);
            waves.along(directions, j, size);
            for (std::int64_t s = 0; s < excitations; s++) {
                const std::int64_t at = s * m + j;
                out[i * excitations + s] += sum(waves.real, waves.imag, &single.real[at], &single.imag[at], size) +
                                       sum(waves.slope_real, waves.slope_imag, &twin.real[at], &twin.imag[at], size);
            }
        }
    }
}

void normal_derivative(const double *points, const double *normals, std::int64_t n, const double *sources,
                       std::int64_t m, const std::complex<double> *strength, std::int64_t excitations, Wavenumber k,
                       std::complex<double> *out) {
    const Axes positions(sources, m);
    const Parts parts(strength, m, excitations);
#pragma omp parallel for schedule(static)
    for (std::int64_t i = 0; i < n; i++) {
        Waves waves;
        for (std::int64_t s = 0; s < excitations; s++) out[i * excitations + s] = 0;
        for (std::int64_t j = 0; j < m; j += block) {
            const std::int64_t size = m - j < block ? m - j : block;
            waves.fill(points + 3 * i, positions, j, size, k);
            waves.along(normals + 3 * i, size);
            for (std::int64_t s = 0; s < excitations; s++)
                out[i * excitations + s] +=
                    sum(waves.slope_real, waves.slope_imag, &parts.real[s * m + j], &parts.imag[s * m + j], size);
        }
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
