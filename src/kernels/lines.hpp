// Kernels of a line of the cache at a time, by loops that a compiler can vectorise.
#pragma once
#ifdef __AVX512F__
#include <immintrin.h>
#endif

#include "arithmetic.hpp"
#include "rows.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

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

// The normal derivative at y of e^{ikr}/(4 pi r) times area, which is -(g c + h s) + i (h c - g s), where c and s are the cosine
// and the sine of kr but for a sign that g and h share. It follows from the squares of r and the products of y - x with `Normals`,
// and is 0 nearer than the root of `least`. Mixed, e^{ikr}/(4 pi r) times a + i b is added.
template <class Real> struct Waves {
    Real g[line<Real>], h[line<Real>], c[line<Real>], s[line<Real>];
};
template <class Real, bool Lossy, bool Mixed>
inline void double_layer(const Real *squares, const Real *along, Wave<Real> k, Real least, const Real *a, const Real *b,
                         Waves<Real> &out) {
    Real inverses[line<Real>];
    inverse_roots(squares, least, inverses);
#pragma omp simd
    for (int l = 0; l < line<Real>; l++) {
        const Real inverse = inverses[l], twice = squares[l] * inverse;  // 2/r and 2r
        const auto flip = flipped_sincospi(k.half_waves / 2 * twice, out.s[l], out.c[l]);
        const Real lost = k.imag / 2 * twice, left = Lossy ? decay(lost) : Real(1);
        const Real part = flipped(along[l], flip) * (inverse * inverse) * left;
        out.g[l] = part * inverse * (Lossy ? 1 + lost : Real(1));
        out.h[l] = part * (2 * k.real);
        const Real monopole = flipped(inverse, flip) * left * Real(1 / (8 * pi));
        if (Mixed) out.g[l] -= monopole * a[l], out.h[l] += monopole * b[l];
    }
}

// From x to a line of nodes from number j on
template <class Real, bool Lossy, bool Mixed>
inline void double_layer_line(const Real *x, const Nodes<Real> &nodes, std::int64_t j, Wave<Real> k, Real least, Waves<Real> &out) {
    const Real *const sx = nodes.point[0] + j, *const sy = nodes.point[1] + j, *const sz = nodes.point[2] + j;
    const Real *const nx = nodes.normal[0] + j, *const ny = nodes.normal[1] + j, *const nz = nodes.normal[2] + j;
    Real squares[line<Real>], along[line<Real>];
#pragma omp simd
    for (int l = 0; l < line<Real>; l++) {
        const Real dx = sx[l] - x[0], dy = sy[l] - x[1], dz = sz[l] - x[2];
        squares[l] = dx * dx + dy * dy + dz * dz;
        along[l] = dx * nx[l] + dy * ny[l] + dz * nz[l];
    }
    double_layer<Real, Lossy, Mixed>(squares, along, k, least, Mixed ? nodes.single[0] + j : nullptr,
                                     Mixed ? nodes.single[1] + j : nullptr, out);
}

template <class Real> inline void store(const Waves<Real> &waves, Real *re, Real *im) {
#pragma omp simd
    for (int l = 0; l < line<Real>; l++) {
        re[l] = -(waves.g[l] * waves.c[l] + waves.h[l] * waves.s[l]);
        im[l] = waves.h[l] * waves.c[l] - waves.g[l] * waves.s[l];
    }
}

}  // namespace
}  // namespace AIRTACT_VARIANT
}  // namespace airtact
