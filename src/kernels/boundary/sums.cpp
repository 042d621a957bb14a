// The sums of sums.hpp.
#include "sums.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {

template <class Real>
void add_products(const Real *re, const Real *im, std::int64_t stride, const Real *a, const Real *b, std::int64_t count,
                  std::int64_t some, std::complex<double> *out, std::int64_t step) {
    const Real *const re1 = re + stride, *const re2 = re1 + stride, *const re3 = re2 + stride;
    const Real *const im1 = im + stride, *const im2 = im1 + stride, *const im3 = im2 + stride;
    Real x0 = 0, x1 = 0, x2 = 0, x3 = 0, y0 = 0, y1 = 0, y2 = 0, y3 = 0;
#pragma omp simd reduction(+ : x0, x1, x2, x3, y0, y1, y2, y3)
    for (std::int64_t l = 0; l < count; l++) {
        const Real p = a[l], q = b[l];
        x0 += re[l] * p, x1 += re1[l] * p, x2 += re2[l] * p, x3 += re3[l] * p;
        y0 += re[l] * q, y1 += re1[l] * q, y2 += re2[l] * q, y3 += re3[l] * q;
        x0 -= im[l] * q, x1 -= im1[l] * q, x2 -= im2[l] * q, x3 -= im3[l] * q;
        y0 += im[l] * p, y1 += im1[l] * p, y2 += im2[l] * p, y3 += im3[l] * p;
    }
    const Real x[together] = {x0, x1, x2, x3}, y[together] = {y0, y1, y2, y3};
    for (std::int64_t i = 0; i < some; i++) out[i * step] += std::complex<double>(x[i], y[i]);
}

template <class Real>
void add_product(const Real *re, const Real *im, const Real *a, const Real *b, std::int64_t count, std::complex<double> &out) {
    Real x = 0, y = 0;
#pragma omp simd reduction(+ : x, y)
    for (std::int64_t l = 0; l < count; l++) {
        x += re[l] * a[l] - im[l] * b[l];
        y += re[l] * b[l] + im[l] * a[l];
    }
    out += std::complex<double>(x, y);
}

template <class Real>
void sum_products(const Real *weights, const Real *rows, std::int64_t count, std::int64_t some, Real *out) {
    std::int64_t i = 0;
    for (; i + together <= some; i += together) {
        const Real *const row = rows + i * count, *const row1 = row + count, *const row2 = row1 + count, *const row3 = row2 + count;
        Real x0 = 0, x1 = 0, x2 = 0, x3 = 0;
#pragma omp simd reduction(+ : x0, x1, x2, x3)
        for (std::int64_t l = 0; l < count; l++)
            x0 += weights[l] * row[l], x1 += weights[l] * row1[l], x2 += weights[l] * row2[l], x3 += weights[l] * row3[l];
        out[i] = x0, out[i + 1] = x1, out[i + 2] = x2, out[i + 3] = x3;
    }
    for (; i < some; i++) {
        const Real *const row = rows + i * count;
        Real x = 0;
#pragma omp simd reduction(+ : x)
        for (std::int64_t l = 0; l < count; l++) x += weights[l] * row[l];
        out[i] = x;
    }
}

template <class Real>
void add_moments(const Real *u, const Real *v, const Real *re, const Real *im, std::int64_t n, double *out_re, double *out_im) {
    Real m0 = 0, m1 = 0, m2 = 0, m3 = 0, m4 = 0, m5 = 0, l0 = 0, l1 = 0, l2 = 0, l3 = 0, l4 = 0, l5 = 0;
#pragma omp simd reduction(+ : m0, m1, m2, m3, m4, m5, l0, l1, l2, l3, l4, l5)
    for (std::int64_t i = 0; i < n; i++) {
        const Real x = u[i], y = v[i], a = re[i], b = im[i];
        m0 += a, m1 += a * x, m2 += a * y, m3 += a * x * x, m4 += a * x * y, m5 += a * y * y;
        l0 += b, l1 += b * x, l2 += b * y, l3 += b * x * x, l4 += b * x * y, l5 += b * y * y;
    }
    const Real real[6] = {m0, m1, m2, m3, m4, m5}, imag[6] = {l0, l1, l2, l3, l4, l5};
    for (int m = 0; m < 6; m++) out_re[m] += real[m], out_im[m] += imag[m];
}

#define AIRTACT_SUMS(Real)                                                                                            \
    template void add_products<Real>(const Real *, const Real *, std::int64_t, const Real *, const Real *,            \
                                     std::int64_t, std::int64_t, std::complex<double> *, std::int64_t);               \
    template void add_product<Real>(const Real *, const Real *, const Real *, const Real *, std::int64_t,             \
                                    std::complex<double> &);                                                          \
    template void sum_products<Real>(const Real *, const Real *, std::int64_t, std::int64_t, Real *);                 \
    template void add_moments<Real>(const Real *, const Real *, const Real *, const Real *, std::int64_t, double *,   \
                                    double *);
AIRTACT_SUMS(float)
AIRTACT_SUMS(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
