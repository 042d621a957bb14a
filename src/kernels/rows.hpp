// One row of the kernels at a time, by loops that a compiler can vectorise. Included inside translation units that are
// compiled once for each instruction set.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <new>
#include <vector>

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

// Prefetches bytes that are read soon, so far ahead of what is read now; a hint, without effect beyond the end of the memory. For
// rows that are read side by side, which the hardware does not predict.
inline void fetch([[maybe_unused]] const void *now, [[maybe_unused]] std::int64_t ahead, [[maybe_unused]] std::int64_t bytes) {
#ifdef __GNUC__
    const auto begin = reinterpret_cast<std::uintptr_t>(now) + std::uintptr_t(ahead);
    for (std::int64_t b = 0; b < bytes; b += std::int64_t(cache_line))
        __builtin_prefetch(reinterpret_cast<const void *>(begin + std::uintptr_t(b)));
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
    Planes(const double *points, std::int64_t n, const double *origin) : padded(whole_lines<Real>(n)), data(3 * padded) {
        for (int d = 0; d < 3; d++) {
            Real *const plane = data.data() + d * padded;
            for (std::int64_t i = 0; i < n; i++) plane[i] = Real(points[3 * i + d] - origin[d]);
            if (n) std::fill(plane + n, plane + padded, plane[n - 1]);
        }
    }
    const Real *operator[](int d) const { return data.data() + d * padded; }
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

template <class Real, bool Lossy>
inline void monopole_row(const Real *x, const Real *sx, const Real *sy, const Real *sz, std::int64_t n, Wave<Real> k,
                         Real *re, Real *im) {
#pragma omp simd
    for (std::int64_t j = 0; j < n; j++) {
        const Real dx = sx[j] - x[0], dy = sy[j] - x[1], dz = sz[j] - x[2];
        const Real squared = dx * dx + dy * dy + dz * dz;
        Real s, c, g = Real(1) / std::sqrt(squared);
        const Real r = squared * g;
        if (Lossy) g *= decay(k.imag * r);
        sincospi(k.half_waves * r, s, c);
        re[j] = g * c;
        im[j] = g * s;
    }
}

// The normal derivative at y of e^{ikr}/(4 pi r) times area, from d = y - x and the normal times area; 0 nearer than the
// root of `least`. Mixed, e^{ikr}/(4 pi r) times a + i b is added.
template <class Real, bool Lossy, bool Mixed = false>
inline void double_layer(Real dx, Real dy, Real dz, Real nx, Real ny, Real nz, Wave<Real> k, Real least, Real &re,
                         Real &im, Real a = 0, Real b = 0) {
    const Real r2 = dx * dx + dy * dy + dz * dz;
    const Real inverse = r2 > least ? Real(1) / std::sqrt(r2) : Real(0);
    const Real r = r2 * inverse, away = inverse * Real(1 / (4 * pi)) * (Lossy ? decay(k.imag * r) : Real(1));
    Real s, c;
    const Real g = (dx * nx + dy * ny + dz * nz) * (inverse * inverse) * away;
    sincospi(k.half_waves * r, s, c);
    const Real kr = k.real * r, one = Lossy ? Real(1) + k.imag * r : Real(1);
    re = -g * (one * c + kr * s);
    im = g * (kr * c - one * s);
    if (Mixed) re += away * (a * c - b * s), im += away * (a * s + b * c);
}

template <class Real, bool Lossy, bool Mixed = false>
inline void double_layer_row(const Real *x, const Real *sx, const Real *sy, const Real *sz, const Real *nx,
                             const Real *ny, const Real *nz, std::int64_t n, Wave<Real> k, Real least, Real *re,
                             Real *im, const Real *a = nullptr, const Real *b = nullptr) {
#pragma omp simd
    for (std::int64_t j = 0; j < n; j++)
        double_layer<Real, Lossy, Mixed>(sx[j] - x[0], sy[j] - x[1], sz[j] - x[2], nx[j], ny[j], nz[j], k, least, re[j],
                                         im[j], strength<Mixed>(a, j), strength<Mixed>(b, j));
}

template <class Real, bool Lossy, bool Mixed = false>
inline void double_layer_column(const Real *y, const Real *normal, const Real *tx, const Real *ty, const Real *tz,
                                std::int64_t n, Wave<Real> k, Real *re, Real *im, Real a = 0, Real b = 0) {
#pragma omp simd
    for (std::int64_t i = 0; i < n; i++)
        double_layer<Real, Lossy, Mixed>(y[0] - tx[i], y[1] - ty[i], y[2] - tz[i], normal[0], normal[1], normal[2], k, Real(0),
                                         re[i], im[i], a, b);
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
