// Blocks of the dual-surface matrix that are far from each other, as sums of few low-rank terms, by adaptive cross approximation (ACA).
//
// Source: M. Bebendorf and S. Rjasanow, "Adaptive low-rank approximation of collocation matrices", Computing 70 (2003) 1.
#include "storage.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr int checks = 3;               // rows in turn whose residual must be small
constexpr std::int64_t stride = 73;     // from one of them to the next: prime to `lanes`, so that all are checked

template <class Real> struct Geometry {  // that the entries follow from: nodes of the columns; x and x' of each of the rows
    Layer<Real> layer;
    Planes<Real> target, inside;
    Wave<Real> k;
};

std::vector<double> spread(const double *shifted, std::int64_t m) {  // x' of each node
    std::vector<double> out(3 * m);
    for (std::int64_t i = 0; i < m; i++) std::copy_n(shifted + 3 * (i / sharing), 3, out.data() + 3 * i);
    return out;
}

// i D(x') - D(x) in place of D(x)
template <class Real> void combine(const Real *inside, Real *row) {
#pragma omp simd
    for (std::int64_t l = 0; l < lanes; l++) {
        row[l] = -row[l] - inside[lanes + l];
        row[lanes + l] = inside[l] - row[lanes + l];
    }
}

// Entries of the rows' node i with n of the columns' nodes from `begin` on, or of the columns' node j with those of the rows
template <class Real> void row_of(const Geometry<Real> &geometry, std::int64_t i, std::int64_t begin, std::int64_t n, Real *row) {
    const auto layer = [&](const Planes<Real> &from, Real *out) {
        const Real x[3] = {from[0][i], from[1][i], from[2][i]};
        double_layer_row(x, geometry.layer.nodes, begin, n, geometry.k, Real(0), out, out + lanes);
        clear_rest(out, n);
    };
    alignas(cache_line) Real inside[2 * lanes];
    layer(geometry.target, row), layer(geometry.inside, inside);
    combine(inside, row);
}
template <class Real>
void column_of(const Geometry<Real> &geometry, std::int64_t j, std::int64_t begin, std::int64_t n, Real *column) {
    const auto layer = [&](const Planes<Real> &to, Real *out) {
        double_layer_column(geometry.layer.nodes, j, to.at, begin, n, geometry.k, out, out + lanes);
        clear_rest(out, n);
    };
    alignas(cache_line) Real inside[2 * lanes];
    layer(geometry.target, column), layer(geometry.inside, inside);
    combine(inside, column);
}

template <class Real> struct Term {  // a column and a row of the residual of the terms before it: real, then imaginary parts
    Real column[2 * lanes], row[2 * lanes];
};

// Subtracts `many` terms from a row or a column: the `part` of each along it, times number `at` of its other factor
template <int many, class Real>
void subtract(const Term<Real> *terms, Real (Term<Real>::*part)[2 * lanes], Real (Term<Real>::*other)[2 * lanes],
          std::int64_t at, Real *residual) {
    const Real *line[many];
    Real c[many], d[many];
    for (int n = 0; n < many; n++) {
        line[n] = terms[n].*part;
        c[n] = (terms[n].*other)[at], d[n] = (terms[n].*other)[lanes + at];
    }
#pragma omp simd
    for (std::int64_t l = 0; l < lanes; l++) {
        Real re = residual[l], im = residual[lanes + l];
        for (int n = 0; n < many; n++) {
            re -= line[n][l] * c[n] - line[n][lanes + l] * d[n];
            im -= line[n][l] * d[n] + line[n][lanes + l] * c[n];
        }
        residual[l] = re, residual[lanes + l] = im;
    }
}

template <class Real>
void subtract_all(const Lined<Term<Real>> &terms, std::int64_t count, Real (Term<Real>::*part)[2 * lanes],
              Real (Term<Real>::*other)[2 * lanes], std::int64_t at, Real *residual) {
    std::int64_t n = 0;
    for (; n + 4 <= count; n += 4) subtract<4>(terms.data() + n, part, other, at, residual);
    for (; n < count; n++) subtract<1>(terms.data() + n, part, other, at, residual);
}

template <class Real> Real square(const Real *line, std::int64_t l) {
    return line[l] * line[l] + line[lanes + l] * line[lanes + l];
}

template <class Real>
std::int64_t largest(const Real *line, std::int64_t n, const bool *passed) {  // of those not passed; -1 for none
    Real size[lanes], most = -1;
#pragma omp simd
    for (std::int64_t l = 0; l < n; l++) size[l] = square(line, l);
    for (std::int64_t l = 0; passed && l < n; l++) size[l] = passed[l] ? Real(-1) : size[l];
#pragma omp simd reduction(max : most)
    for (std::int64_t l = 0; l < n; l++) most = size[l] > most ? size[l] : most;
    return most < 0 ? -1 : std::find(size, size + n, most) - size;
}

template <class Real>
void approximate(const Geometry<Real> &geometry, std::int64_t rows, std::int64_t columns, std::int64_t m, Real tolerance,
           Lined<Term<Real>> &terms, std::int64_t &count) {
    const std::int64_t top = lanes * rows, left = lanes * columns;
    const std::int64_t height = std::min(lanes, m - top), width = std::min(lanes, m - left);
    bool seen[lanes] = {};
    std::int64_t i = height / 2, passed = 0;
    count = 0;
    for (std::int64_t step = 0; step < height && passed < checks && count < width; step++) {
        seen[i] = true;
        if (std::int64_t(terms.size()) <= count) terms.emplace_back();
        Term<Real> &next = terms[count];
        row_of(geometry, top + i, left, width, next.row);
        subtract_all(terms, count, &Term<Real>::row, &Term<Real>::column, i, next.row);
        Real sum = 0;
#pragma omp simd reduction(+ : sum)
        for (std::int64_t l = 0; l < lanes; l++) sum += square(next.row, l);
        if (sum * Real(height) <= tolerance * tolerance) {
            passed++;
            for (std::int64_t n = 0; n < height && seen[i]; n++) i = (i + stride) % height;
            continue;
        }
        passed = 0;
        const std::int64_t j = largest(next.row, width, static_cast<const bool *>(nullptr));
        column_of(geometry, left + j, top, height, next.column);
        subtract_all(terms, count, &Term<Real>::column, &Term<Real>::row, j, next.column);
        const Real size = square(next.row, j), p = next.row[j] / size, q = -next.row[lanes + j] / size;
        for (std::int64_t l = 0; l < lanes; l++) {
            const Real re = next.row[l], im = next.row[lanes + l];
            next.row[l] = re * p - im * q, next.row[lanes + l] = re * q + im * p;
        }
        count++;
        i = std::max<std::int64_t>(0, largest(next.column, height, seen));
    }
}

}  // namespace

template <class Store>
std::int64_t dual_low_rank(const double *targets, const double *shifted, const double *points, const double *normals,
                          const std::complex<double> *single, std::int64_t m, Wavenumber k, Pairs far, double tolerance,
                          std::int64_t room, std::int64_t *count, std::int64_t *begin, Store *rows) {
    using Real = typename Arithmetic<Store>::Real;
    const Origin origin(points, m);
    const std::vector<double> inside = spread(shifted, m);
    const Geometry<Real> geometry{{points, normals, single, m, origin.at}, {targets, m, origin.at}, {inside.data(), m, origin.at}, Wave<Real>(k)};
    std::int64_t taken = 0;
#pragma omp parallel
    {
        Lined<Term<Real>> terms;
#pragma omp for schedule(dynamic, 1)
        for (std::int64_t t = 0; t < far.blocks; t++)
            for (std::int64_t e = far.first[t]; e < far.first[t + 1]; e++) {
                approximate(geometry, t, far.column[e], m, Real(tolerance), terms, count[e]);
                std::int64_t at;
#pragma omp atomic capture
                {
                    at = taken;
                    taken += 2 * count[e];
                }
                begin[e] = at;
                if (at + 2 * count[e] > room) continue;
                for (std::int64_t c = 0; c < 2 * count[e]; c++) {
                    const Real *line = c < count[e] ? terms[c].row : terms[c - count[e]].column;
                    store(line, rows + 2 * stored<Store> * (at + c));
                    store(line + lanes, rows + 2 * stored<Store> * (at + c) + stored<Store>);
                }
            }
    }
    return taken;
}

#define AIRTACT_LOW_RANK(Store)                                                                                        \
    template std::int64_t dual_low_rank<Store>(const double *, const double *, const double *, const double *,         \
                                              const std::complex<double> *, std::int64_t, Wavenumber, Pairs, double, std::int64_t, std::int64_t *,   \
                                              std::int64_t *, Store *);
AIRTACT_LOW_RANK(std::uint32_t)
AIRTACT_LOW_RANK(float)
AIRTACT_LOW_RANK(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
