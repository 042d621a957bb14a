// Every point against every node: one row of the kernel at a time, then stored or summed.
#include "kernels.hpp"

#include <algorithm>
#include <type_traits>
#include <vector>

#include "arithmetic.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr double pi = 3.14159265358979323846;
constexpr std::int64_t block = 256;

template <class Real> struct Planes {  // x, y, z, ... each contiguous, relative to an origin
    std::vector<Real> data;
    std::int64_t n;
    Planes(const double *points, std::int64_t count, const double *origin) : data(3 * count), n(count) {
        for (std::int64_t i = 0; i < n; i++)
            for (int d = 0; d < 3; d++) data[d * n + i] = Real(points[3 * i + d] - origin[d]);
    }
    const Real *operator[](int d) const { return data.data() + d * n; }
};

struct Origin {  // the sources' centre: float coordinates keep their digits wherever the hand is
    double at[3] = {0, 0, 0};
    Origin(const double *points, std::int64_t n) {
        for (std::int64_t i = 0; i < n; i++)
            for (int d = 0; d < 3; d++) at[d] += points[3 * i + d] / n;
    }
};

template <class Real> struct Wave {
    Real half_waves, real, imag;  // k / pi, k, absorption
    explicit Wave(Wavenumber k) : half_waves(Real(k.real / pi)), real(Real(k.real)), imag(Real(k.imag)) {}
};

template <class Real, bool Lossy>
inline void monopole_row(const Real *x, const Real *sx, const Real *sy, const Real *sz, std::int64_t n, Wave<Real> k,
                         Real *re, Real *im) {
#pragma omp simd
    for (std::int64_t j = 0; j < n; j++) {
        const Real dx = sx[j] - x[0], dy = sy[j] - x[1], dz = sz[j] - x[2];
        const Real r = std::sqrt(dx * dx + dy * dy + dz * dz);
        Real s, c, g = Real(1) / r;
        if (Lossy) g *= decay(k.imag * r);
        sincospi(k.half_waves * r, s, c);
        re[j] = g * c;
        im[j] = g * s;
    }
}

template <class Real, bool Lossy>
inline void double_layer_row(const Real *x, const Real *sx, const Real *sy, const Real *sz, const Real *nx,
                             const Real *ny, const Real *nz, std::int64_t n, Wave<Real> k, Real least, Real *re,
                             Real *im) {
#pragma omp simd
    for (std::int64_t j = 0; j < n; j++) {
        const Real dx = sx[j] - x[0], dy = sy[j] - x[1], dz = sz[j] - x[2];
        const Real r2 = dx * dx + dy * dy + dz * dz;
        const Real inverse = r2 > least ? Real(1) / std::sqrt(r2) : Real(0);
        const Real r = r2 * inverse;
        Real s, c, g = (dx * nx[j] + dy * ny[j] + dz * nz[j]) * inverse * inverse * inverse * Real(1 / (4 * pi));
        if (Lossy) g *= decay(k.imag * r);
        sincospi(k.half_waves * r, s, c);
        const Real kr = k.real * r, one = Lossy ? Real(1) + k.imag * r : Real(1);
        re[j] = -g * (one * c + kr * s);
        im[j] = g * (kr * c - one * s);
    }
}

// Calls row(i) for every target, shared out over the threads
template <class Row> void over_rows(std::int64_t n, const Row &row) {
#pragma omp parallel for schedule(static)
    for (std::int64_t i = 0; i < n; i++) row(i);
}

template <class Real, bool Lossy>
void dual_rows(const Planes<Real> &t, const Planes<Real> &t2, const Planes<Real> &y, const Planes<Real> &a,
               Wave<Real> k, std::complex<Real> *out) {
    const std::int64_t m = y.n;
    over_rows(t.n, [&](std::int64_t i) {
        Real re[block], im[block], re2[block], im2[block];
        const Real x[3] = {t[0][i], t[1][i], t[2][i]}, x2[3] = {t2[0][i], t2[1][i], t2[2][i]};
        Real *o = reinterpret_cast<Real *>(out + i * m);
        for (std::int64_t j = 0; j < m; j += block) {
            const std::int64_t n = std::min(block, m - j);
            double_layer_row<Real, Lossy>(x, y[0] + j, y[1] + j, y[2] + j, a[0] + j, a[1] + j, a[2] + j, n, k, Real(0), re,
                                         im);
            double_layer_row<Real, Lossy>(x2, y[0] + j, y[1] + j, y[2] + j, a[0] + j, a[1] + j, a[2] + j, n, k, Real(0),
                                          re2, im2);
            for (std::int64_t l = 0; l < n; l++) {
                o[2 * (j + l)] = -re[l] - im2[l];
                o[2 * (j + l) + 1] = -im[l] + re2[l];
            }
        }
    });
}

template <class Real, bool Lossy>
void double_layer_rows(const Planes<Real> &t, const Planes<Real> &y, const Planes<Real> &a, Wave<Real> k,
                       std::complex<Real> *out) {
    const std::int64_t m = y.n;
    over_rows(t.n, [&](std::int64_t i) {
        Real re[block], im[block];
        const Real x[3] = {t[0][i], t[1][i], t[2][i]};
        for (std::int64_t j = 0; j < m; j += block) {
            const std::int64_t n = std::min(block, m - j);
            double_layer_row<Real, Lossy>(x, y[0] + j, y[1] + j, y[2] + j, a[0] + j, a[1] + j, a[2] + j, n, k, Real(0), re,
                                         im);
            for (std::int64_t l = 0; l < n; l++) out[i * m + j + l] = {re[l], im[l]};
        }
    });
}

template <class Real, class Row>
void sum_rows(std::int64_t n, std::int64_t m, const std::complex<double> *density, std::int64_t sounds,
              std::complex<double> *out, const Row &row) {
    std::vector<Real> re_density(m * sounds), im_density(m * sounds);
    for (std::int64_t j = 0; j < m; j++)
        for (std::int64_t s = 0; s < sounds; s++) {
            re_density[s * m + j] = Real(density[j * sounds + s].real());
            im_density[s * m + j] = Real(density[j * sounds + s].imag());
        }
    over_rows(n, [&](std::int64_t i) {
        Real re[block], im[block];
        for (std::int64_t s = 0; s < sounds; s++) out[i * sounds + s] = 0;
        for (std::int64_t j = 0; j < m; j += block) {
            const std::int64_t count = std::min(block, m - j);
            row(i, j, count, re, im);
            for (std::int64_t s = 0; s < sounds; s++) {
                const Real *a = re_density.data() + s * m + j, *b = im_density.data() + s * m + j;
                Real sum_re = 0, sum_im = 0;
#pragma omp simd reduction(+ : sum_re, sum_im)
                for (std::int64_t l = 0; l < count; l++) {
                    sum_re += re[l] * a[l] - im[l] * b[l];
                    sum_im += re[l] * b[l] + im[l] * a[l];
                }
                out[i * sounds + s] += std::complex<double>(sum_re, sum_im);
            }
        }
    });
}

}  // namespace

template <class Real>
void dual_matrix(const double *targets, const double *shifted, std::int64_t n, const double *sources,
                 const double *normals, std::int64_t m, Wavenumber k, std::complex<Real> *out) {
    const double zero[3] = {0, 0, 0};
    const Origin origin(sources, m);
    const Planes<Real> t(targets, n, origin.at), t2(shifted, n, origin.at), y(sources, m, origin.at), a(normals, m, zero);
    if (k.imag > 0)
        dual_rows<Real, true>(t, t2, y, a, Wave<Real>(k), out);
    else
        dual_rows<Real, false>(t, t2, y, a, Wave<Real>(k), out);
}

template <class Real>
void double_layer_matrix(const double *targets, std::int64_t n, const double *sources, const double *normals,
                         std::int64_t m, Wavenumber k, std::complex<Real> *out) {
    const double zero[3] = {0, 0, 0};
    const Origin origin(sources, m);
    const Planes<Real> t(targets, n, origin.at), y(sources, m, origin.at), a(normals, m, zero);
    if (k.imag > 0)
        double_layer_rows<Real, true>(t, y, a, Wave<Real>(k), out);
    else
        double_layer_rows<Real, false>(t, y, a, Wave<Real>(k), out);
}

template <class Real>
void apply_double_layer(const double *targets, std::int64_t n, const double *sources, const double *normals,
                        std::int64_t m, const std::complex<double> *density, std::int64_t sounds, Wavenumber k,
                        double least, std::complex<double> *out) {
    const double zero[3] = {0, 0, 0};
    const Real least_squared = Real(least * least);
    const Origin origin(sources, m);
    const Planes<Real> t(targets, n, origin.at), y(sources, m, origin.at), a(normals, m, zero);
    const Wave<Real> wave(k);
    sum_rows<Real>(n, m, density, sounds, out,
                   [&](std::int64_t i, std::int64_t j, std::int64_t count, Real *re, Real *im) {
                       const Real x[3] = {t[0][i], t[1][i], t[2][i]};
                       if (k.imag > 0)
                           double_layer_row<Real, true>(x, y[0] + j, y[1] + j, y[2] + j, a[0] + j, a[1] + j, a[2] + j,
                                                        count, wave, least_squared, re, im);
                       else
                           double_layer_row<Real, false>(x, y[0] + j, y[1] + j, y[2] + j, a[0] + j, a[1] + j,
                                                         a[2] + j, count, wave, least_squared, re, im);
                   });
}

template <class Real>
void apply_monopoles(const double *targets, std::int64_t n, const double *sources, std::int64_t m,
                     const std::complex<double> *strength, std::int64_t sounds, Wavenumber k,
                     std::complex<double> *out) {
    const Origin origin(sources, m);
    const Planes<Real> t(targets, n, origin.at), y(sources, m, origin.at);
    const Wave<Real> wave(k);
    sum_rows<Real>(n, m, strength, sounds, out,
                   [&](std::int64_t i, std::int64_t j, std::int64_t count, Real *re, Real *im) {
                       const Real x[3] = {t[0][i], t[1][i], t[2][i]};
                       if (k.imag > 0)
                           monopole_row<Real, true>(x, y[0] + j, y[1] + j, y[2] + j, count, wave, re, im);
                       else
                           monopole_row<Real, false>(x, y[0] + j, y[1] + j, y[2] + j, count, wave, re, im);
                   });
}

void panel_entries(const double *targets, std::int64_t n, const std::int64_t *pair_target,
                   const std::int64_t *pair_panel, std::int64_t pairs, const double *sources, const double *normals,
                   std::int64_t m, Wavenumber k, double least, std::complex<double> *out) {
    const double zero[3] = {0, 0, 0};
    const Planes<double> t(targets, n, zero), y(sources, m, zero), a(normals, m, zero);
    const Wave<double> wave(k);
    over_rows(pairs, [&](std::int64_t e) {
        double re[6], im[6];
        const std::int64_t i = pair_target[e], j = 6 * pair_panel[e];
        const double x[3] = {t[0][i], t[1][i], t[2][i]};
        double_layer_row<double, true>(x, y[0] + j, y[1] + j, y[2] + j, a[0] + j, a[1] + j, a[2] + j, 6, wave,
                                       least * least, re, im);
        for (int l = 0; l < 6; l++) out[6 * e + l] = {re[l], im[l]};
    });
}

#define AIRTACT_FAR(Real)                                                                                             \
    template void dual_matrix<Real>(const double *, const double *, std::int64_t, const double *, const double *,     \
                                    std::int64_t, Wavenumber, std::complex<Real> *);                                  \
    template void double_layer_matrix<Real>(const double *, std::int64_t, const double *, const double *,             \
                                            std::int64_t, Wavenumber, std::complex<Real> *);                          \
    template void apply_double_layer<Real>(const double *, std::int64_t, const double *, const double *,              \
                                           std::int64_t, const std::complex<double> *, std::int64_t, Wavenumber,      \
                                           double, std::complex<double> *);                                                   \
    template void apply_monopoles<Real>(const double *, std::int64_t, const double *, std::int64_t,                   \
                                        const std::complex<double> *, std::int64_t, Wavenumber,                       \
                                        std::complex<double> *);
AIRTACT_FAR(float)
AIRTACT_FAR(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
