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

// From x to a line of nodes from number j on
template <class Real, bool Lossy, bool Mixed>
inline void double_layer_line(const Real *x, const Nodes<Real> &nodes, std::int64_t j, Wave<Real> k, Real least, Real *re, Real *im) {
    const Real *const sx = nodes.point[0] + j, *const sy = nodes.point[1] + j, *const sz = nodes.point[2] + j;
    const Real *const nx = nodes.normal[0] + j, *const ny = nodes.normal[1] + j, *const nz = nodes.normal[2] + j;
    Real squares[line<Real>], along[line<Real>];
#pragma omp simd
    for (int l = 0; l < line<Real>; l++) {
        const Real dx = sx[l] - x[0], dy = sy[l] - x[1], dz = sz[l] - x[2];
        squares[l] = dx * dx + dy * dy + dz * dz;
        along[l] = dx * nx[l] + dy * ny[l] + dz * nz[l];
    }
    double_layer<Real, Lossy, Mixed>(squares, along, k, least, re, im, Mixed ? nodes.single[0] + j : nullptr,
                                     Mixed ? nodes.single[1] + j : nullptr);
}

}  // namespace
}  // namespace AIRTACT_VARIANT
}  // namespace airtact
