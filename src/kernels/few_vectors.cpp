// Products of a dense matrix with a few vectors, which take as long as the matrix takes to read, and the orthogonal vectors
// of an iteration. BLAS would start threads of its own for them, which go on spinning on the cores that the other loops need.
#include <algorithm>
#include <cmath>
#include <vector>

#include "kernels.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr int at_once = 4;                  // rows, which share what they read or write of the vectors
constexpr std::int64_t part = 512;          // numbers of a sum that stay in the nearest cache
constexpr std::int64_t few_entries = 300000;  // of a matrix or a basis, below which one thread has done them sooner

// Adds to sums (2, 4) the products of four rows, 2 m real numbers each, with two real vectors
template <class Real>
void multiply_rows(const Real *const *rows, std::int64_t m, const Real *v, const Real *w, Real *sums) {
    const Real *const r0 = rows[0], *const r1 = rows[1], *const r2 = rows[2], *const r3 = rows[3];
    Real a0 = 0, a1 = 0, a2 = 0, a3 = 0, b0 = 0, b1 = 0, b2 = 0, b3 = 0;
#pragma omp simd reduction(+ : a0, a1, a2, a3, b0, b1, b2, b3)
    for (std::int64_t l = 0; l < 2 * m; l++) {
        a0 += r0[l] * v[l], a1 += r1[l] * v[l], a2 += r2[l] * v[l], a3 += r3[l] * v[l];
        b0 += r0[l] * w[l], b1 += r1[l] * w[l], b2 += r2[l] * w[l], b3 += r3[l] * w[l];
    }
    const Real found[2 * at_once] = {a0, a1, a2, a3, b0, b1, b2, b3};
    std::copy(found, found + 2 * at_once, sums);
}

// Adds to two sums of `count` real numbers four rows times the real and times the imaginary parts of their weights
template <class Real>
void add_rows(const Real *const *rows, const std::complex<Real> *weights, std::int64_t count, Real *p, Real *q) {
    const Real *const r0 = rows[0], *const r1 = rows[1], *const r2 = rows[2], *const r3 = rows[3];
    const Real a0 = weights[0].real(), a1 = weights[1].real(), a2 = weights[2].real(), a3 = weights[3].real();
    const Real b0 = weights[0].imag(), b1 = weights[1].imag(), b2 = weights[2].imag(), b3 = weights[3].imag();
#pragma omp simd
    for (std::int64_t l = 0; l < count; l++) {
        p[l] += a0 * r0[l] + a1 * r1[l] + a2 * r2[l] + a3 * r3[l];
        q[l] += b0 * r0[l] + b1 * r1[l] + b2 * r2[l] + b3 * r3[l];
    }
}

template <class Real>
void times_columns(const std::complex<Real> *matrix, std::int64_t n, std::int64_t m, const std::complex<Real> *vectors,
                   std::int64_t count, std::complex<Real> *out) {
    Lined<Real> both(4 * m * count);  // of each vector: what gives the real parts of products, and the imaginary ones
    for (std::int64_t s = 0; s < count; s++)
        for (std::int64_t j = 0; j < m; j++) {
            const std::complex<Real> value = vectors[s * m + j];
            Real *const v = both.data() + 4 * m * s + 2 * j, *const w = v + 2 * m;
            v[0] = value.real(), v[1] = -value.imag();
            w[0] = value.imag(), w[1] = value.real();
        }
#pragma omp parallel for schedule(static) if (n * m > few_entries)
    for (std::int64_t top = 0; top < n; top += at_once) {
        const std::int64_t some = std::min<std::int64_t>(at_once, n - top);
        const Real *rows[at_once];
        for (std::int64_t r = 0; r < at_once; r++)
            rows[r] = reinterpret_cast<const Real *>(matrix + (top + std::min(r, some - 1)) * m);
        for (std::int64_t s = 0; s < count; s++) {
            Real sums[2 * at_once];
            multiply_rows(rows, m, both.data() + 4 * m * s, both.data() + 4 * m * s + 2 * m, sums);
            for (std::int64_t r = 0; r < some; r++) out[s * n + top + r] = {sums[r], sums[at_once + r]};
        }
    }
}

template <class Real>
void times_rows(const std::complex<Real> *matrix, std::int64_t n, std::int64_t m, const std::complex<Real> *vectors,
                std::int64_t count, std::complex<Real> *out) {
#pragma omp parallel for schedule(static) if (n * m > few_entries)
    for (std::int64_t left = 0; left < m; left += part / 2)
        for (std::int64_t s = 0; s < count; s++) {
            const std::int64_t width = std::min(part / 2, m - left);
            Real p[part] = {}, q[part] = {};
            for (std::int64_t top = 0; top < n; top += at_once) {
                const std::int64_t some = std::min<std::int64_t>(at_once, n - top);
                const Real *rows[at_once];
                std::complex<Real> weights[at_once] = {};
                for (std::int64_t r = 0; r < at_once; r++)
                    rows[r] = reinterpret_cast<const Real *>(matrix + (top + std::min(r, some - 1)) * m + left);
                std::copy(vectors + s * n + top, vectors + s * n + top + some, weights);
                add_rows(rows, weights, 2 * width, p, q);
            }
            for (std::int64_t j = 0; j < width; j++)
                out[s * m + left + j] = {p[2 * j] - q[2 * j + 1], p[2 * j + 1] + q[2 * j]};
        }
}

// Takes a vector's part along `before`, given by its weight, from it; returns what is left of it along `next`
template <class Real>
std::complex<Real> take_off(std::complex<Real> weight, const std::complex<Real> *before, const std::complex<Real> *next,
                            std::int64_t m, std::complex<Real> *vector) {
    const Real a = weight.real(), b = weight.imag();
    const Real *const p = reinterpret_cast<const Real *>(before), *const q = reinterpret_cast<const Real *>(next);
    Real *const v = reinterpret_cast<Real *>(vector);
    Real re = 0, im = 0;
#pragma omp simd reduction(+ : re, im)
    for (std::int64_t j = 0; j < m; j++) {
        const Real x = v[2 * j] - (a * p[2 * j] - b * p[2 * j + 1]), y = v[2 * j + 1] - (a * p[2 * j + 1] + b * p[2 * j]);
        v[2 * j] = x, v[2 * j + 1] = y;
        re += q[2 * j] * x + q[2 * j + 1] * y;
        im += q[2 * j] * y - q[2 * j + 1] * x;
    }
    return {re, im};
}

template <class Real>
void make_orthonormal(const std::complex<Real> *basis, std::int64_t m, std::int64_t count, std::complex<Real> *vector,
                      std::complex<double> *column) {
    std::complex<Real> overlap = 0;
    for (std::int64_t i = 0; i < count; i++) {
        overlap = take_off(overlap, basis + (i ? i - 1 : 0) * m, basis + i * m, m, vector);
        column[i] = overlap;
    }
    if (count) take_off(overlap, basis + (count - 1) * m, basis, m, vector);
    Real *const v = reinterpret_cast<Real *>(vector);
    Real squared = 0;
#pragma omp simd reduction(+ : squared)
    for (std::int64_t l = 0; l < 2 * m; l++) squared += v[l] * v[l];
    const Real length = std::sqrt(squared);
    column[count] = length;
    if (length > 0)
        for (std::int64_t l = 0; l < 2 * m; l++) v[l] /= length;
}

}  // namespace

template <class Real>
void orthonormalise(const std::complex<Real> *bases, std::int64_t sides, std::int64_t room, std::int64_t m, std::int64_t count,
                    std::complex<Real> *vectors, std::complex<double> *columns) {
#pragma omp parallel for schedule(static) if (sides * count * m > few_entries)
    for (std::int64_t s = 0; s < sides; s++)
        make_orthonormal(bases + s * room * m, m, count, vectors + s * m, columns + s * (count + 1));
}

template void orthonormalise<float>(const std::complex<float> *, std::int64_t, std::int64_t, std::int64_t, std::int64_t,
                                    std::complex<float> *, std::complex<double> *);
template void orthonormalise<double>(const std::complex<double> *, std::int64_t, std::int64_t, std::int64_t, std::int64_t,
                                     std::complex<double> *, std::complex<double> *);

template <class Real>
void few_products(const std::complex<Real> *matrix, std::int64_t n, std::int64_t m, const std::complex<Real> *vectors,
                  std::int64_t count, bool transposed, std::complex<Real> *out) {
    (transposed ? times_rows<Real> : times_columns<Real>)(matrix, n, m, vectors, count, out);
}

template void few_products<float>(const std::complex<float> *, std::int64_t, std::int64_t, const std::complex<float> *,
                                  std::int64_t, bool, std::complex<float> *);
template void few_products<double>(const std::complex<double> *, std::int64_t, std::int64_t, const std::complex<double> *,
                                   std::int64_t, bool, std::complex<double> *);

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
