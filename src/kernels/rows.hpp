// One row of the kernels at a time, by loops that a compiler can vectorise. Included inside translation units that are
// compiled once for each instruction set.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <new>
#include <vector>
#ifdef __AVX512F__
#include <immintrin.h>
#endif

#include "kernels.hpp"

#include "arithmetic.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr double pi = 3.14159265358979323846;

// Memory that begins where a line of the cache does: a register that lies in two lines takes twice as long to read
constexpr std::size_t cache_line = 64;  // bytes
template <class T> struct OnLines {
    using value_type = T;
    OnLines() = default;
    template <class U> OnLines(const OnLines<U> &) {}
    T *allocate(std::size_t n) { return static_cast<T *>(::operator new(n * sizeof(T), std::align_val_t(cache_line))); }
    void deallocate(T *memory, std::size_t) { ::operator delete(memory, std::align_val_t(cache_line)); }
    template <class U> bool operator==(const OnLines<U> &) const { return true; }
    template <class U> bool operator!=(const OnLines<U> &) const { return false; }
};
template <class T> using Lined = std::vector<T, OnLines<T>>;

// Prefetches bytes that are read or `written` soon, so far ahead of what is read now; a hint, without effect beyond the end of the
// memory. For rows that are read side by side or filled far apart, which the hardware does not predict.
template <int written = 0>
inline void fetch([[maybe_unused]] const void *now, [[maybe_unused]] std::int64_t ahead, [[maybe_unused]] std::int64_t bytes) {
#ifdef __GNUC__
    const auto begin = reinterpret_cast<std::uintptr_t>(now) + std::uintptr_t(ahead);
    for (std::int64_t b = 0; b < bytes; b += std::int64_t(cache_line))
        __builtin_prefetch(reinterpret_cast<const void *>(begin + std::uintptr_t(b)), written);
#endif
}

// n rounded up to whole cache lines: loops over so many numbers have no remainder, which would be slow
template <class Real> constexpr std::int64_t whole_lines(std::int64_t n) {
    constexpr std::int64_t each = cache_line / sizeof(Real);
    return (n + each - 1) / each * each;
}

template <class Real> struct Planes {  // x, y, z, ... each contiguous, relative to an origin, padded with the last point
    std::int64_t padded;
    Lined<Real> data;
    Planes(const double *points, std::int64_t n, const double *origin, double scale = 1)
        : padded(whole_lines<Real>(n)), data(3 * padded) {
        for (int d = 0; d < 3; d++) {
            Real *const plane = data.data() + d * padded;
            for (std::int64_t i = 0; i < n; i++) plane[i] = Real(scale * (points[3 * i + d] - origin[d]));
            if (n) std::fill(plane + n, plane + padded, plane[n - 1]);
        }
    }
    const Real *operator[](int d) const { return data.data() + d * padded; }
};

// What the entries of a double layer have in common, by their normals: its 1/(4 pi), and 1/8 as roots come doubled
constexpr double shared = 1 / (32 * pi);
constexpr double zero[3] = {0, 0, 0};
template <class Real> struct Normals : Planes<Real> {
    Normals(const double *normals, std::int64_t n) : Planes<Real>(normals, n, zero, shared) {}
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

template <class Real> struct Strengths {  // complex numbers, real and imaginary parts contiguous each, then zeros; none if null
    Lined<Real> re, im;
    Strengths(const std::complex<double> *given, std::int64_t n, std::int64_t stride = 1)
        : re(given ? whole_lines<Real>(n) : 0), im(re.size()) {
        for (std::int64_t i = 0; given && i < n; i++)
            re[i] = Real(given[i * stride].real()), im[i] = Real(given[i * stride].imag());
    }
};

// Number l of a line that is there for surfaces of a mixed layer alone
template <bool Mixed, class Real> inline Real strength(const Real *line, std::int64_t l) {
    if constexpr (Mixed)
        return line[l];
    else
        return Real(0);
}

// The loops below take a line of the cache at a time, those beyond n too: a compiler keeps it in registers
template <class Real> constexpr int line = int(whole_lines<Real>(1));

// 2 / root of each number of a line, 0 up to `least`
template <class Real> inline void inverse_roots(const Real *squares, Real least, Real *out) {
#pragma omp simd
    for (int l = 0; l < line<Real>; l++) out[l] = squares[l] > least ? Real(2) / std::sqrt(squares[l]) : Real(0);
}
#ifdef __AVX512F__
// Newton's step from the machine's estimate, which GCC takes for narrower registers by itself
inline void inverse_roots(const float *squares, float least, float *out) {
    const __m512 square = _mm512_loadu_ps(squares);
    const __mmask16 apart = _mm512_cmp_ps_mask(square, _mm512_set1_ps(least), _CMP_GT_OQ);
    const __m512 estimate = _mm512_maskz_rsqrt14_ps(apart, square);
    const __m512 one = _mm512_mul_ps(square, estimate);
    _mm512_storeu_ps(out, _mm512_mul_ps(estimate, _mm512_fnmadd_ps(one, estimate, _mm512_set1_ps(3))));
}
#endif

template <class Real, bool Lossy>
inline void monopole_row(const Real *x, const Real *sx, const Real *sy, const Real *sz, std::int64_t n, Wave<Real> k,
                         Real *re, Real *im) {
    for (std::int64_t j = 0; j < n; j += line<Real>) {
        Real squares[line<Real>], inverses[line<Real>];
#pragma omp simd
        for (int l = 0; l < line<Real>; l++) {
            const Real dx = sx[j + l] - x[0], dy = sy[j + l] - x[1], dz = sz[j + l] - x[2];
            squares[l] = dx * dx + dy * dy + dz * dz;
        }
        inverse_roots(squares, Real(-1), inverses);
#pragma omp simd
        for (int l = 0; l < line<Real>; l++) {
            const Real inverse = inverses[l] / 2, r = squares[l] * inverse, g = inverse * (Lossy ? decay(k.imag * r) : Real(1));
            Real s, c;
            sincospi(k.half_waves * r, s, c);
            re[j + l] = g * c;
            im[j + l] = g * s;
        }
    }
}

// The normal derivative at y of e^{ikr}/(4 pi r) times area, from the squares of r and the products of y - x with `Normals`;
// 0 nearer than the root of `least`. Mixed, e^{ikr}/(4 pi r) times a + i b is added.
template <class Real, bool Lossy, bool Mixed>
inline void double_layer(const Real *squares, const Real *along, Wave<Real> k, Real least, Real *re, Real *im, const Real *a,
                         const Real *b) {
    Real inverses[line<Real>];
    inverse_roots(squares, least, inverses);
#pragma omp simd
    for (int l = 0; l < line<Real>; l++) {
        const Real inverse = inverses[l], twice = squares[l] * inverse;  // 2/r and 2r
        const Real kr = k.real / 2 * twice, lost = k.imag / 2 * twice, one = Lossy ? 1 + lost : Real(1);
        const Real left = Lossy ? decay(lost) : Real(1), g = along[l] * (inverse * inverse) * inverse * left;
        Real s, c;
        sincospi(k.half_waves / 2 * twice, s, c);
        re[l] = -g * (one * c + kr * s);
        im[l] = g * (kr * c - one * s);
        const Real monopole = inverse * left * Real(1 / (8 * pi));
        if (Mixed) re[l] += monopole * (a[l] * c - b[l] * s), im[l] += monopole * (a[l] * s + b[l] * c);
    }
}

// From x to a line of nodes
template <class Real, bool Lossy, bool Mixed>
inline void double_layer_line(const Real *x, const Real *sx, const Real *sy, const Real *sz, const Real *nx,
                              const Real *ny, const Real *nz, Wave<Real> k, Real least, Real *re, Real *im, const Real *a,
                              const Real *b) {
    Real squares[line<Real>], along[line<Real>];
#pragma omp simd
    for (int l = 0; l < line<Real>; l++) {
        const Real dx = sx[l] - x[0], dy = sy[l] - x[1], dz = sz[l] - x[2];
        squares[l] = dx * dx + dy * dy + dz * dz;
        along[l] = dx * nx[l] + dy * ny[l] + dz * nz[l];
    }
    double_layer<Real, Lossy, Mixed>(squares, along, k, least, re, im, a, b);
}

template <class Real, bool Lossy, bool Mixed = false>
inline void double_layer_row(const Real *x, const Real *sx, const Real *sy, const Real *sz, const Real *nx,
                             const Real *ny, const Real *nz, std::int64_t n, Wave<Real> k, Real least, Real *re,
                             Real *im, const Real *a = nullptr, const Real *b = nullptr) {
    for (std::int64_t j = 0; j < n; j += line<Real>)
        double_layer_line<Real, Lossy, Mixed>(x, sx + j, sy + j, sz + j, nx + j, ny + j, nz + j, k, least, re + j, im + j,
                                              Mixed ? a + j : a, Mixed ? b + j : b);
}

template <class Real, bool Lossy, bool Mixed = false>
inline void double_layer_column(const Real *y, const Real *normal, const Real *tx, const Real *ty, const Real *tz,
                                std::int64_t n, Wave<Real> k, Real *re, Real *im, Real a = 0, Real b = 0) {
    Real squares[line<Real>], along[line<Real>], as[line<Real>], bs[line<Real>];
    std::fill(as, as + line<Real>, a), std::fill(bs, bs + line<Real>, b);
    for (std::int64_t i = 0; i < n; i += line<Real>) {
#pragma omp simd
        for (int l = 0; l < line<Real>; l++) {
            const Real dx = y[0] - tx[i + l], dy = y[1] - ty[i + l], dz = y[2] - tz[i + l];
            squares[l] = dx * dx + dy * dy + dz * dz;
            along[l] = dx * normal[0] + dy * normal[1] + dz * normal[2];
        }
        double_layer<Real, Lossy, Mixed>(squares, along, k, Real(0), re + i, im + i, as, bs);
    }
}

// Zeros both halves of a row, `lanes` real parts and `lanes` imaginary parts, from number n on
template <class Real> inline void clear_rest(Real *row, std::int64_t n) {
    std::fill(row + n, row + lanes, Real(0));
    std::fill(row + lanes + n, row + 2 * lanes, Real(0));
}

// Calls row(i) for every target, shared out over the threads unless there are so few pairs that one has done them sooner
template <class Row> void over_rows(std::int64_t n, std::int64_t m, const Row &row) {
#pragma omp parallel for schedule(static) if (n * m > 10000)
    for (std::int64_t i = 0; i < n; i++) row(i);
}

}  // namespace
}  // namespace AIRTACT_VARIANT
}  // namespace airtact
