// The rows of rows.hpp.
#include "lines.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

template <class Real, bool Lossy>
void fill_monopoles(const Real *x, const Real *const *points, std::int64_t from, std::int64_t n, Wave<Real> k, Real *re, Real *im) {
    const Real *const sx = points[0] + from, *const sy = points[1] + from, *const sz = points[2] + from;
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

template <class Real, bool Lossy, bool Mixed>
void fill_row(const Real *x, const Nodes<Real> &nodes, std::int64_t from, std::int64_t n, Wave<Real> k, Real least, Real *re,
              Real *im) {
    Waves<Real> waves;
    for (std::int64_t j = 0; j < n; j += line<Real>) {
        double_layer_line<Real, Lossy, Mixed>(x, nodes, from + j, k, least, waves);
        store(waves, re + j, im + j);
    }
}

template <class Real, bool Lossy, bool Mixed>
void fill_column(const Nodes<Real> &nodes, std::int64_t j, const Real *const *targets, std::int64_t from, std::int64_t n, Wave<Real> k,
                 Real *re, Real *im) {
    const Real y[3] = {nodes.point[0][j], nodes.point[1][j], nodes.point[2][j]};
    const Real normal[3] = {nodes.normal[0][j], nodes.normal[1][j], nodes.normal[2][j]};
    const Real *const tx = targets[0] + from, *const ty = targets[1] + from, *const tz = targets[2] + from;
    Real squares[line<Real>], along[line<Real>], a[line<Real>], b[line<Real>];
    Waves<Real> waves;
    if (Mixed) std::fill(a, a + line<Real>, nodes.single[0][j]), std::fill(b, b + line<Real>, nodes.single[1][j]);
    for (std::int64_t i = 0; i < n; i += line<Real>) {
#pragma omp simd
        for (int l = 0; l < line<Real>; l++) {
            const Real dx = y[0] - tx[i + l], dy = y[1] - ty[i + l], dz = y[2] - tz[i + l];
            squares[l] = dx * dx + dy * dy + dz * dz;
            along[l] = dx * normal[0] + dy * normal[1] + dz * normal[2];
        }
        double_layer<Real, Lossy, Mixed>(squares, along, k, Real(0), a, b, waves);
        store(waves, re + i, im + i);
    }
}

}  // namespace

template <class Real>
void monopole_row(const Real *x, const Real *const *points, std::int64_t j, std::int64_t n, Wave<Real> k, Real *re, Real *im) {
    (k.imag > 0 ? fill_monopoles<Real, true> : fill_monopoles<Real, false>)(x, points, j, n, k, re, im);
}

template <class Real>
void double_layer_row(const Real *x, const Nodes<Real> &nodes, std::int64_t j, std::int64_t n, Wave<Real> k, Real least, Real *re,
                      Real *im) {
    (nodes.single[0] ? fill_row<Real, true, true>
     : k.imag > 0    ? fill_row<Real, true, false>
                     : fill_row<Real, false, false>)(x, nodes, j, n, k, least, re, im);
}

template <class Real>
void double_layer_column(const Nodes<Real> &nodes, std::int64_t j, const Real *const *targets, std::int64_t i, std::int64_t n,
                         Wave<Real> k, Real *re, Real *im) {
    (nodes.single[0] ? fill_column<Real, true, true>
     : k.imag > 0    ? fill_column<Real, true, false>
                     : fill_column<Real, false, false>)(nodes, j, targets, i, n, k, re, im);
}

#define AIRTACT_ROWS(Real)                                                                                             \
    template void monopole_row<Real>(const Real *, const Real *const *, std::int64_t, std::int64_t, Wave<Real>, Real *, Real *); \
    template void double_layer_row<Real>(const Real *, const Nodes<Real> &, std::int64_t, std::int64_t, Wave<Real>, Real, Real *, \
                                         Real *);                                                                       \
    template void double_layer_column<Real>(const Nodes<Real> &, std::int64_t, const Real *const *, std::int64_t, std::int64_t, \
                                            Wave<Real>, Real *, Real *);
AIRTACT_ROWS(float)
AIRTACT_ROWS(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
