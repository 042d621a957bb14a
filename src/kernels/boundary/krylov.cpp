// One step of GMRES for several right-hand sides, each of which has a Krylov space of its own.
//
// Source: Y. Saad and M. H. Schultz, "GMRES: a generalized minimal residual algorithm for solving nonsymmetric linear systems",
// SIAM J. Sci. Stat. Comput. 7 (1986) 856, section 3.2.
#include <algorithm>
#include <cmath>

#include "rows.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

using Complex = std::complex<double>;
constexpr std::int64_t few_numbers = 40000;  // of the vectors, below which one thread has done them sooner

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

// Makes a vector orthogonal to `count` of them by modified Gram-Schmidt, and 1 long; gives its overlaps and the length that was left
template <class Real>
void make_orthonormal(const std::complex<Real> *basis, std::int64_t stride, std::int64_t m, std::int64_t count,
                      std::complex<Real> *vector, Complex *column) {
    std::complex<Real> overlap = 0;
    for (std::int64_t i = 0; i < count; i++) {
        overlap = take_off(overlap, basis + (i ? i - 1 : 0) * stride, basis + i * stride, m, vector);
        column[i] = overlap;
    }
    take_off(overlap, basis + (count - 1) * stride, basis, m, vector);
    Real *const v = reinterpret_cast<Real *>(vector);
    Real squared = 0;
#pragma omp simd reduction(+ : squared)
    for (std::int64_t l = 0; l < 2 * m; l++) squared += v[l] * v[l];
    const Real length = std::sqrt(squared);
    column[count] = length;
    if (length > 0)
        for (std::int64_t l = 0; l < 2 * m; l++) v[l] /= length;
}

struct Rotation {  // (upper, lower) becomes (c upper + s lower, c lower - s* upper), c real
    Complex cosine, sine;
    static Rotation to_zero(Complex upper, Complex lower) {  // the lower one
        const double size = std::hypot(std::abs(upper), std::abs(lower)), above = std::abs(upper);
        if (size == 0) return {1, 0};
        return {above / size, (above > 0 ? upper / above : 1) * std::conj(lower) / size};
    }
    void turn(Complex &upper, Complex &lower) const {
        const Complex before = upper;
        upper = cosine.real() * before + sine * lower;
        lower = cosine.real() * lower - std::conj(sine) * before;
    }
};

// Appends to the inverse of a triangle, packed by columns, that of its next column; a zero on the diagonal gives zeros
void invert_column(const Complex *column, std::int64_t step, Complex *inverse) {
    Complex *const made = inverse + step * (step + 1) / 2;
    std::fill(made, made + step + 1, 0.0);
    if (column[step] == 0.0) return;
    made[step] = 1.0 / column[step];
    for (std::int64_t c = 0; c < step; c++)
        for (std::int64_t r = 0; r <= c; r++) made[r] -= inverse[c * (c + 1) / 2 + r] * column[c] * made[step];
}

}  // namespace

template <class Real>
void krylov_step(std::complex<Real> *bases, std::int64_t sides, std::int64_t m, std::int64_t step, Complex *columns,
                 const Krylov &spaces) {
    const std::int64_t count = step + 1, stride = sides * m, most = spaces.most;
#pragma omp parallel for schedule(static) if (count * stride > few_numbers)
    for (std::int64_t s = 0; s < sides; s++) {
        Complex *const column = columns + s * (count + 1), *const left = spaces.right + s * (most + 1) + step;
        make_orthonormal(bases + s * m, stride, m, count, bases + count * stride + s * m, column);
        Rotation *const turns = reinterpret_cast<Rotation *>(spaces.rotations) + s * most;
        for (std::int64_t i = 0; i < step; i++) turns[i].turn(column[i], column[i + 1]);
        turns[step] = Rotation::to_zero(column[step], column[count]);
        turns[step].turn(column[step], column[count]);
        left[1] = 0;
        turns[step].turn(left[0], left[1]);
        Complex *const inverse = spaces.inverses + s * (most * (most + 1) / 2), *const weights = spaces.weights + s * most;
        invert_column(column, step, inverse);
        const Complex *const made = inverse + step * count / 2;
        weights[step] = 0;
        for (std::int64_t i = 0; i < count; i++) {
            weights[i] += made[i] * left[0];
            spaces.squares[s] += std::norm(made[i]);
        }
    }
}

template void krylov_step<float>(std::complex<float> *, std::int64_t, std::int64_t, std::int64_t, Complex *, const Krylov &);
template void krylov_step<double>(std::complex<double> *, std::int64_t, std::int64_t, std::int64_t, Complex *, const Krylov &);

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
