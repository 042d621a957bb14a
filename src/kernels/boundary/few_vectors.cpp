// Products of a dense matrix with a few vectors, which take as long as the matrix takes to read. BLAS would start threads of
// its own for them, which go on spinning on the cores that the other loops need.
#include <algorithm>
#include <type_traits>
#include <vector>

#include "rows.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr int at_once = 4;                  // rows, which share what they read or write of the vectors
constexpr std::int64_t part = 256;          // numbers of a row that a thread adds to sums of its own in a transposed product
constexpr std::int64_t long_part = 1024;    // numbers of a row that are read at once where they are multiplied and summed
constexpr std::int64_t few_entries = 100000;  // of a matrix, below which one thread has done them sooner

// A dense matrix (n, m) of complex numbers, as they are or as whole numbers that each row's own scale is multiplied with
template <class Store, class Real> struct Dense {
    const Store *numbers;
    const Real *scales;
    std::int64_t n, m;
    Real scale(std::int64_t row) const {
        if constexpr (std::is_same_v<Store, Real>)
            return Real(1);
        else
            return scales[row];
    }
};

// Four rows of a matrix, from one on; the last one again where there are fewer
template <class Store, class Real> struct Rows {
    std::int64_t count;
    const Store *at[at_once];
    Rows(const Dense<Store, Real> &matrix, std::int64_t top) : count(std::min<std::int64_t>(at_once, matrix.n - top)) {
        for (std::int64_t r = 0; r < at_once; r++) at[r] = matrix.numbers + 2 * matrix.m * (top + std::min(r, count - 1));
    }
};

// A part of four rows as real numbers, once the four rows after them are asked for
template <class Store, class Real, std::int64_t length> struct Part {
    alignas(cache_line) Real copies[std::is_same_v<Store, Real> ? 1 : at_once][length];
    std::conditional_t<std::is_same_v<Store, Real>, const Real *, Real *> at[at_once];
    void read(const Rows<Store, Real> &rows, std::int64_t begin, std::int64_t count, std::int64_t m) {
        constexpr std::int64_t line = cache_line / sizeof(Store);
        const std::int64_t ahead = 2 * at_once * m * std::int64_t(sizeof(Store));
        for (int r = 0; r < at_once; r++) {
            const Store *const numbers = rows.at[r] + begin;
            if constexpr (std::is_same_v<Store, Real>) {
                fetch(numbers, ahead, count * std::int64_t(sizeof(Store)));
                at[r] = numbers;
            } else {
                Real *const copy = at[r] = copies[r];
                std::int64_t l = 0;
                for (; l + line <= count; l += line) {
                    fetch(numbers + l, ahead, std::int64_t(cache_line));
#pragma omp simd
                    for (std::int64_t i = 0; i < line; i++) copy[l + i] = Real(numbers[l + i]);
                }
                for (; l < count; l++) copy[l] = Real(numbers[l]);
            }
        }
    }
};

// Adds to sums (2 N, 4) the products of four rows with N pairs of real vectors, planes of `length`
template <int N, class Real>
void multiply_rows(const Real *const *rows, std::int64_t count, const Real *v, std::int64_t length, Real *sums) {
    const Real *const r0 = rows[0], *const r1 = rows[1], *const r2 = rows[2], *const r3 = rows[3];
    const Real *const w = v + length, *const v2 = v + (N > 1 ? 2 * length : 0), *const w2 = v2 + length;
    Real a0 = 0, a1 = 0, a2 = 0, a3 = 0, b0 = 0, b1 = 0, b2 = 0, b3 = 0;
    Real c0 = 0, c1 = 0, c2 = 0, c3 = 0, d0 = 0, d1 = 0, d2 = 0, d3 = 0;
#pragma omp simd reduction(+ : a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3, d0, d1, d2, d3)
    for (std::int64_t l = 0; l < count; l++) {
        a0 += r0[l] * v[l], a1 += r1[l] * v[l], a2 += r2[l] * v[l], a3 += r3[l] * v[l];
        b0 += r0[l] * w[l], b1 += r1[l] * w[l], b2 += r2[l] * w[l], b3 += r3[l] * w[l];
        if (N == 1) continue;
        c0 += r0[l] * v2[l], c1 += r1[l] * v2[l], c2 += r2[l] * v2[l], c3 += r3[l] * v2[l];
        d0 += r0[l] * w2[l], d1 += r1[l] * w2[l], d2 += r2[l] * w2[l], d3 += r3[l] * w2[l];
    }
    const Real found[4 * at_once] = {a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3, d0, d1, d2, d3};
    for (int s = 0; s < 2 * N * at_once; s++) sums[s] += found[s];
}

// Adds to N pairs of sums of `count` real numbers four rows times the real and times the imaginary parts of their weights
template <int N, class Real>
void add_rows(const Real *const *rows, const std::complex<Real> (*weights)[at_once], std::int64_t count, Real (*sums)[part]) {
    const Real *const r0 = rows[0], *const r1 = rows[1], *const r2 = rows[2], *const r3 = rows[3];
    Real a[4 * at_once];
    for (int s = 0; s < N; s++)
        for (int r = 0; r < at_once; r++)
            a[2 * s * at_once + r] = weights[s][r].real(), a[(2 * s + 1) * at_once + r] = weights[s][r].imag();
    Real *const p = sums[0], *const q = sums[1], *const p2 = sums[N > 1 ? 2 : 0], *const q2 = sums[N > 1 ? 3 : 1];
#pragma omp simd
    for (std::int64_t l = 0; l < count; l++) {
        p[l] += a[0] * r0[l] + a[1] * r1[l] + a[2] * r2[l] + a[3] * r3[l];
        q[l] += a[4] * r0[l] + a[5] * r1[l] + a[6] * r2[l] + a[7] * r3[l];
        if (N == 1) continue;
        p2[l] += a[8] * r0[l] + a[9] * r1[l] + a[10] * r2[l] + a[11] * r3[l];
        q2[l] += a[12] * r0[l] + a[13] * r1[l] + a[14] * r2[l] + a[15] * r3[l];
    }
}

template <int N, class Store, class Real>
void times_columns(const Dense<Store, Real> &matrix, const std::complex<Real> *vectors, std::complex<Real> *out) {
    const std::int64_t n = matrix.n, m = matrix.m;
    Lined<Real> both(4 * m * N);  // of each vector: what gives the real parts of products, and the imaginary ones
    for (std::int64_t s = 0; s < N; s++)
        for (std::int64_t j = 0; j < m; j++) {
            const std::complex<Real> value = vectors[s * m + j];
            Real *const v = both.data() + 4 * m * s + 2 * j, *const w = v + 2 * m;
            v[0] = value.real(), v[1] = -value.imag();
            w[0] = value.imag(), w[1] = value.real();
        }
#pragma omp parallel for schedule(static) if (n * m > few_entries)
    for (std::int64_t top = 0; top < n; top += at_once) {
        const Rows<Store, Real> rows(matrix, top);
        Real sums[2 * N * at_once] = {};
        Part<Store, Real, long_part> some;
        for (std::int64_t begin = 0; begin < 2 * m; begin += long_part) {
            const std::int64_t count = std::min(long_part, 2 * m - begin);
            some.read(rows, begin, count, m);
            multiply_rows<N>(some.at, count, both.data() + begin, 2 * m, sums);
        }
        for (std::int64_t s = 0; s < N; s++)
            for (std::int64_t r = 0; r < rows.count; r++)
                out[s * n + top + r] = matrix.scale(top + r) * std::complex<Real>(sums[2 * s * at_once + r],
                                                                                  sums[(2 * s + 1) * at_once + r]);
    }
}

template <int N, class Store, class Real>
void times_rows(const Dense<Store, Real> &matrix, const std::complex<Real> *vectors, std::complex<Real> *out) {
    const std::int64_t n = matrix.n, m = matrix.m;
#pragma omp parallel for schedule(static) if (n * m > few_entries)
    for (std::int64_t left = 0; left < m; left += part / 2) {
        const std::int64_t width = std::min(part / 2, m - left);
        alignas(cache_line) Real sums[2 * N][part] = {};
        Part<Store, Real, part> some;
        for (std::int64_t top = 0; top < n; top += at_once) {
            const Rows<Store, Real> rows(matrix, top);
            std::complex<Real> weights[N][at_once] = {};
            some.read(rows, 2 * left, 2 * width, m);
            for (int s = 0; s < N; s++)
                for (std::int64_t r = 0; r < rows.count; r++) weights[s][r] = matrix.scale(top + r) * vectors[s * n + top + r];
            add_rows<N>(some.at, weights, 2 * width, sums);
        }
        for (int s = 0; s < N; s++)
            for (std::int64_t j = 0; j < width; j++)
                out[s * m + left + j] = {sums[2 * s][2 * j] - sums[2 * s + 1][2 * j + 1],
                                         sums[2 * s][2 * j + 1] + sums[2 * s + 1][2 * j]};
    }
}

template <class Store, class Real>
void multiply_few(const Dense<Store, Real> &matrix, const std::complex<Real> *vectors, std::int64_t count, bool transposed,
                  std::complex<Real> *out) {
    const std::int64_t given = transposed ? matrix.n : matrix.m, made = transposed ? matrix.m : matrix.n;
    for (std::int64_t s = 0; s < count; s += 2) {
        const bool alone = s + 1 == count;
        const auto multiply = transposed ? (alone ? times_rows<1, Store, Real> : times_rows<2, Store, Real>)
                                         : (alone ? times_columns<1, Store, Real> : times_columns<2, Store, Real>);
        multiply(matrix, vectors + s * given, out + s * made);
    }
}

}  // namespace

template <class Real>
void few_products(const std::complex<Real> *matrix, std::int64_t n, std::int64_t m, const std::complex<Real> *vectors,
                  std::int64_t count, bool transposed, std::complex<Real> *out) {
    multiply_few(Dense<Real, Real>{reinterpret_cast<const Real *>(matrix), nullptr, n, m}, vectors, count, transposed, out);
}

template void few_products<float>(const std::complex<float> *, std::int64_t, std::int64_t, const std::complex<float> *,
                                  std::int64_t, bool, std::complex<float> *);
template void few_products<double>(const std::complex<double> *, std::int64_t, std::int64_t, const std::complex<double> *,
                                   std::int64_t, bool, std::complex<double> *);

void few_rounded_products(const std::int16_t *matrix, const float *scales, std::int64_t n, std::int64_t m,
                          const std::complex<float> *vectors, std::int64_t count, bool transposed, std::complex<float> *out) {
    multiply_few(Dense<std::int16_t, float>{matrix, scales, n, m}, vectors, count, transposed, out);
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
