// One step of GMRES for several right-hand sides, each of which has a Krylov space of its own.
//
// Source: Y. Saad and M. H. Schultz, "GMRES: a generalized minimal residual algorithm for solving nonsymmetric linear systems",
// SIAM J. Sci. Stat. Comput. 7 (1986) 856, section 3.2.
#include <algorithm>
#include <cmath>
#include <vector>

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
        if (size == 0) return {0, 1};  // nothing is gained: the residual passes to the next step
        return {above / size, (above > 0 ? upper / above : 1) * std::conj(lower) / size};
    }
    void turn(Complex &upper, Complex &lower) const {
        const Complex before = upper;
        upper = cosine.real() * before + sine * lower;
        lower = cosine.real() * lower - std::conj(sine) * before;
    }
};

// Numbers of the columns of a packed triangle before one of them
constexpr std::int64_t before(std::int64_t column) { return column * (column + 1) / 2; }

// Appends to the inverse of a triangle, packed by columns, that of its next column; a zero on the diagonal gives zeros. Its length
// bounds the least singular value; weights by it would not be stable.
void invert_column(const Complex *column, std::int64_t step, Complex *inverse) {
    Complex *const made = inverse + before(step);
    std::fill(made, made + step + 1, 0.0);
    if (column[step] == 0.0) return;
    made[step] = 1.0 / column[step];
    for (std::int64_t c = 0; c < step; c++)
        for (std::int64_t r = 0; r <= c; r++) made[r] -= inverse[before(c) + r] * column[c] * made[step];
}

// Solves a packed triangle by substitution from its last column; a zero on the diagonal gives 0
void solve_triangle(const Complex *triangle, const Complex *right, std::int64_t count, Complex *weights) {
    std::copy(right, right + count, weights);
    for (std::int64_t c = count - 1; c >= 0; c--) {
        const Complex *const column = triangle + before(c);
        weights[c] = column[c] == 0.0 ? 0.0 : weights[c] / column[c];
        for (std::int64_t r = 0; r < c; r++) weights[r] -= column[r] * weights[c];
    }
}

// Inverts a matrix of n rows in place, by Gauss-Jordan elimination. Each row has `width` real parts, then as many imaginary ones.
template <class Real> void invert(Real *rows, std::int64_t n, std::int64_t width) {
    std::vector<std::int64_t> pivots(n);
    for (std::int64_t k = 0; k < n; k++) {
        const auto size = [&](std::int64_t i) {
            const Real *const row = rows + 2 * width * i + k;
            return row[0] * row[0] + row[width] * row[width];
        };
        std::int64_t pivot = k;
        for (std::int64_t i = k + 1; i < n; i++)
            if (size(i) > size(pivot)) pivot = i;
        pivots[k] = pivot;
        Real *const re = rows + 2 * width * k, *const im = re + width;
        if (pivot != k) std::swap_ranges(re, re + 2 * width, rows + 2 * width * pivot);
        const std::complex<Real> inverse = Real(1) / std::complex<Real>(re[k], im[k]);
        re[k] = 1, im[k] = 0;
        for (std::int64_t l = 0; l < n; l++) {
            const Real x = re[l], y = im[l];
            re[l] = x * inverse.real() - y * inverse.imag(), im[l] = x * inverse.imag() + y * inverse.real();
        }
        for (std::int64_t i = 0; i < n; i++) {
            if (i == k) continue;
            Real *const p = rows + 2 * width * i, *const q = p + width;
            const Real x = p[k], y = q[k];
            p[k] = q[k] = 0;
#pragma omp simd
            for (std::int64_t l = 0; l < width; l++) {
                p[l] -= x * re[l] - y * im[l];
                q[l] -= x * im[l] + y * re[l];
            }
        }
    }
    // Exchanged rows of a matrix are exchanged columns of its inverse.
    for (std::int64_t k = n - 1; k >= 0; k--)
        for (std::int64_t i = 0; pivots[k] != k && i < 2 * n; i++) std::swap(rows[width * i + k], rows[width * i + pivots[k]]);
}

}  // namespace

template <class Real> void invert_blocks(std::complex<Real> *blocks, std::int64_t count, std::int64_t n) {
    const std::int64_t width = whole_lines<Real>(n);
#pragma omp parallel for schedule(dynamic, 1)
    for (std::int64_t b = 0; b < count; b++) {
        std::complex<Real> *const block = blocks + n * n * b;
        Lined<Real> rows(2 * n * width);
        for (std::int64_t i = 0; i < n; i++)
            for (std::int64_t j = 0; j < n; j++) {
                rows[2 * width * i + j] = block[n * i + j].real();
                rows[2 * width * i + width + j] = block[n * i + j].imag();
            }
        invert(rows.data(), n, width);
        for (std::int64_t i = 0; i < n; i++)
            for (std::int64_t j = 0; j < n; j++)
                block[n * i + j] = {rows[2 * width * i + j], rows[2 * width * i + width + j]};
    }
}

template void invert_blocks<float>(std::complex<float> *, std::int64_t, std::int64_t);
template void invert_blocks<double>(std::complex<double> *, std::int64_t, std::int64_t);

template <class Real>
void krylov_step(std::complex<Real> *bases, std::int64_t sides, std::int64_t m, std::int64_t step, const Krylov &spaces) {
    const std::int64_t count = step + 1, stride = sides * m, most = spaces.most;
#pragma omp parallel for schedule(static) if (count * stride > few_numbers)
    for (std::int64_t s = 0; s < sides; s++) {
        std::vector<Complex> column(count + 1);
        make_orthonormal(bases + s * m, stride, m, count, bases + count * stride + s * m, column.data());
        Rotation *const turns = reinterpret_cast<Rotation *>(spaces.rotations) + s * most;
        for (std::int64_t i = 0; i < step; i++) turns[i].turn(column[i], column[i + 1]);
        turns[step] = Rotation::to_zero(column[step], column[count]);
        turns[step].turn(column[step], column[count]);
        Complex *const right = spaces.right + s * (most + 1);
        right[count] = 0;
        turns[step].turn(right[step], right[count]);
        Complex *const triangle = spaces.triangles + s * before(most), *const inverse = spaces.inverses + s * before(most);
        std::copy(column.begin(), column.begin() + count, triangle + before(step));
        invert_column(column.data(), step, inverse);
        for (std::int64_t i = 0; i < count; i++) spaces.squares[s] += std::norm(inverse[before(step) + i]);
        solve_triangle(triangle, right, count, spaces.weights + s * most);
    }
}

template void krylov_step<float>(std::complex<float> *, std::int64_t, std::int64_t, std::int64_t, const Krylov &);
template void krylov_step<double>(std::complex<double> *, std::int64_t, std::int64_t, std::int64_t, const Krylov &);

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
