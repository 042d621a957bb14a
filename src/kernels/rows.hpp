// Arrays that loops can read a line of the cache at a time, and rows of the kernels over them.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <new>
#include <vector>

#include "kernels.hpp"

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

// Prefetches bytes that are read soon, so far ahead of what is read now; a hint, without effect beyond the end of the memory.
// For rows that are read side by side, which the hardware does not predict.
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

template <class Real> struct Planes {  // x, y, z, each contiguous, relative to an origin, padded with the last point
    Lined<Real> plane[3];
    const Real *at[3];
    // Not inlined, here and below: copies of these loops would take a third of the compiler's time
    [[gnu::noinline]] Planes(const double *points, std::int64_t n, const double *origin, double scale = 1) {
        for (int d = 0; d < 3; d++) {
            plane[d].resize(whole_lines<Real>(n));
            for (std::int64_t i = 0; i < n; i++) plane[d][i] = Real(scale * (points[3 * i + d] - origin[d]));
            if (n) std::fill(plane[d].begin() + n, plane[d].end(), plane[d][n - 1]);
            at[d] = plane[d].data();
        }
    }
    Planes(const Planes &) = delete;  // the pointers are its own
    const Real *operator[](int d) const { return at[d]; }
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

template <class Real> struct Strengths {  // complex numbers, real and imaginary parts contiguous each, then zeros; none if null
    Lined<Real> re, im;
    [[gnu::noinline]] Strengths(const std::complex<double> *given, std::int64_t n, std::int64_t stride = 1)
        : re(given ? whole_lines<Real>(n) : 0), im(re.size()) {
        for (std::int64_t i = 0; given && i < n; i++)
            re[i] = Real(given[i * stride].real()), im[i] = Real(given[i * stride].imag());
    }
};

// The loops below take a line of the cache at a time, those beyond n too: a compiler keeps it in registers
template <class Real> constexpr int line = int(whole_lines<Real>(1));

}  // namespace

template <class Real> struct Wave {
    Real half_waves, real, imag;  // k / pi, k, absorption
    explicit Wave(Wavenumber k) : half_waves(Real(k.real / pi)), real(Real(k.real)), imag(Real(k.imag)) {}
};

template <class Real> struct Nodes {  // of a layer: each coordinate of points, `Normals` and single layers; null where there are none
    const Real *point[3], *normal[3], *single[2];
};

// Rows of a matrix, compiled once in rows.cpp. They fill whole lines, beyond n too.

// e^{ikr}/r from x to n points from number j on
template <class Real>
void monopole_row(const Real *x, const Real *const *points, std::int64_t j, std::int64_t n, Wave<Real> k, Real *re, Real *im);

// D of a target x and n nodes from number j on, 0 nearer than the root of `least`
template <class Real>
void double_layer_row(const Real *x, const Nodes<Real> &nodes, std::int64_t j, std::int64_t n, Wave<Real> k, Real least, Real *re,
                      Real *im);

// D of n targets from number i on and node j
template <class Real>
void double_layer_column(const Nodes<Real> &nodes, std::int64_t j, const Real *const *targets, std::int64_t i, std::int64_t n,
                         Wave<Real> k, Real *re, Real *im);

namespace {

template <class Real> struct Layer {  // the nodes of a surface, relative to an origin
    Planes<Real> position;
    Normals<Real> normal;
    Strengths<Real> single;
    Nodes<Real> nodes;
    Layer(const double *points, const double *normals, const std::complex<double> *given, std::int64_t m, const double *origin)
        : position(points, m, origin), normal(normals, m), single(given, m),
          nodes{{position[0], position[1], position[2]}, {normal[0], normal[1], normal[2]},
                {given ? single.re.data() : nullptr, given ? single.im.data() : nullptr}} {}
    Layer(const Layer &) = delete;  // the nodes point into it
};

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
