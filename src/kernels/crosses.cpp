// Tiles of the dual-surface matrix that are far from each other, as sums of few crosses.
//
// Source: M. Bebendorf and S. Rjasanow, "Adaptive low-rank approximation of collocation matrices", Computing 70 (2003) 1.
#include "tiles.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr int checks = 3;               // rows in turn that must be right
constexpr std::int64_t stride = 73;     // from one of them to the next: prime to `lanes`, so that all are met

template <class Real> struct Skin {  // what the entries follow from; x' of each node
    Planes<Real> place, normal, inside;
    Wave<Real> k;
};

std::vector<double> spread(const double *shifted, std::int64_t m) {  // x' of each node
    std::vector<double> out(3 * m);
    for (std::int64_t i = 0; i < m; i++) std::copy_n(shifted + 3 * (i / sharing), 3, out.data() + 3 * i);
    return out;
}

template <class Real> struct Place {
    Real x, y, z;
    Place(const Planes<Real> &of, std::int64_t i) : x(of[0][i]), y(of[1][i]), z(of[2][i]) {}
};

// i D(x') - D(x) of a node at y with normal n
template <class Real, bool Lossy>
inline void entry(Place<Real> x, Place<Real> inside, Place<Real> y, Place<Real> n, Wave<Real> k, Real &re, Real &im) {
    Real a, b, c, d;
    double_layer<Real, Lossy>(y.x - inside.x, y.y - inside.y, y.z - inside.z, n.x, n.y, n.z, k, Real(0), a, b);
    double_layer<Real, Lossy>(y.x - x.x, y.y - x.y, y.z - x.z, n.x, n.y, n.z, k, Real(0), c, d);
    re = -c - b, im = a - d;
}

// Entries of the rows' node i with the columns' nodes from `begin` on, or of the columns' node j with those of the rows
template <class Real, bool Lossy>
void row_of(const Skin<Real> &skin, std::int64_t i, std::int64_t begin, std::int64_t n, Real *re, Real *im) {
    const Place<Real> x(skin.place, i), inside(skin.inside, i);
#pragma omp simd
    for (std::int64_t l = 0; l < n; l++)
        entry<Real, Lossy>(x, inside, {skin.place, begin + l}, {skin.normal, begin + l}, skin.k, re[l], im[l]);
}
template <class Real, bool Lossy>
void column_of(const Skin<Real> &skin, std::int64_t j, std::int64_t begin, std::int64_t n, Real *re, Real *im) {
    const Place<Real> y(skin.place, j), normal(skin.normal, j);
#pragma omp simd
    for (std::int64_t l = 0; l < n; l++)
        entry<Real, Lossy>({skin.place, begin + l}, {skin.inside, begin + l}, y, normal, skin.k, re[l], im[l]);
}

template <class Real> struct Cross {  // a column and a row of what the crosses before it leave: real, then imaginary parts
    Real column[2 * lanes] = {}, row[2 * lanes] = {};
};

// Takes from `left`, a row or a column, what `many` crosses have in it: of each its `part` there, times number `at` of its
// other one
template <int many, class Real>
void take(const Cross<Real> *crosses, Real (Cross<Real>::*part)[2 * lanes], Real (Cross<Real>::*other)[2 * lanes],
          std::int64_t at, Real *left) {
    const Real *line[many];
    Real c[many], d[many];
    for (int n = 0; n < many; n++) {
        line[n] = crosses[n].*part;
        c[n] = (crosses[n].*other)[at], d[n] = (crosses[n].*other)[lanes + at];
    }
#pragma omp simd
    for (std::int64_t l = 0; l < lanes; l++) {
        Real re = left[l], im = left[lanes + l];
        for (int n = 0; n < many; n++) {
            re -= line[n][l] * c[n] - line[n][lanes + l] * d[n];
            im -= line[n][l] * d[n] + line[n][lanes + l] * c[n];
        }
        left[l] = re, left[lanes + l] = im;
    }
}

template <class Real>
void take_all(const std::vector<Cross<Real>> &crosses, std::int64_t count, Real (Cross<Real>::*part)[2 * lanes],
              Real (Cross<Real>::*other)[2 * lanes], std::int64_t at, Real *left) {
    std::int64_t n = 0;
    for (; n + 4 <= count; n += 4) take<4>(crosses.data() + n, part, other, at, left);
    for (; n < count; n++) take<1>(crosses.data() + n, part, other, at, left);
}

template <class Real> Real square(const Real *line, std::int64_t l) {
    return line[l] * line[l] + line[lanes + l] * line[lanes + l];
}

template <class Real>
std::int64_t largest(const Real *line, std::int64_t n, const bool *passed) {  // of those not passed; -1 for none
    std::int64_t best = -1;
    Real most = -1;
    for (std::int64_t l = 0; l < n; l++)
        if (!(passed && passed[l]) && square(line, l) > most) most = square(line, best = l);
    return best;
}

template <class Real, bool Lossy>
void cross(const Skin<Real> &skin, std::int64_t rows, std::int64_t columns, std::int64_t m, Real tolerance,
           std::vector<Cross<Real>> &crosses, std::int64_t &count) {
    const std::int64_t top = lanes * rows, left = lanes * columns;
    const std::int64_t height = std::min(lanes, m - top), width = std::min(lanes, m - left);
    bool seen[lanes] = {};
    std::int64_t i = height / 2, quiet = 0;
    count = 0;
    for (std::int64_t step = 0; step < height && quiet < checks && count < width; step++) {
        seen[i] = true;
        if (std::int64_t(crosses.size()) <= count) crosses.emplace_back();
        Cross<Real> &next = crosses[count];
        std::fill(next.row, next.row + 2 * lanes, Real(0));
        row_of<Real, Lossy>(skin, top + i, left, width, next.row, next.row + lanes);
        take_all(crosses, count, &Cross<Real>::row, &Cross<Real>::column, i, next.row);
        Real sum = 0;
        for (std::int64_t l = 0; l < width; l++) sum += square(next.row, l);
        if (sum * Real(height) <= tolerance * tolerance) {
            quiet++;
            for (std::int64_t n = 0; n < height && seen[i]; n++) i = (i + stride) % height;
            continue;
        }
        quiet = 0;
        const std::int64_t j = largest(next.row, width, static_cast<const bool *>(nullptr));
        std::fill(next.column, next.column + 2 * lanes, Real(0));
        column_of<Real, Lossy>(skin, left + j, top, height, next.column, next.column + lanes);
        take_all(crosses, count, &Cross<Real>::column, &Cross<Real>::row, j, next.column);
        const Real size = square(next.row, j), p = next.row[j] / size, q = -next.row[lanes + j] / size;
        for (std::int64_t l = 0; l < width; l++) {
            const Real re = next.row[l], im = next.row[lanes + l];
            next.row[l] = re * p - im * q, next.row[lanes + l] = re * q + im * p;
        }
        count++;
        i = std::max<std::int64_t>(0, largest(next.column, height, seen));
    }
}

template <class Store, bool Lossy>
std::int64_t all_crosses(const double *points, const double *shifted, const double *normals, std::int64_t m,
                         Wavenumber wavenumber, const Pairs &far, double tolerance, std::int64_t room,
                         std::int64_t *count, std::int64_t *begin, Store *out) {
    using Real = typename Arithmetic<Store>::Real;
    const double zero[3] = {0, 0, 0};
    const Origin origin(points, m);
    const std::vector<double> inside = spread(shifted, m);
    const Skin<Real> skin{Planes<Real>(points, m, origin.at), Planes<Real>(normals, m, zero),
                          Planes<Real>(inside.data(), m, origin.at), Wave<Real>(wavenumber)};
    std::int64_t taken = 0;
#pragma omp parallel
    {
        std::vector<Cross<Real>> crosses;
#pragma omp for schedule(dynamic, 1)
        for (std::int64_t t = 0; t < far.tiles; t++)
            for (std::int64_t e = far.first[t]; e < far.first[t + 1]; e++) {
                cross<Real, Lossy>(skin, t, far.column[e], m, Real(tolerance), crosses, count[e]);
                std::int64_t at;
#pragma omp atomic capture
                {
                    at = taken;
                    taken += 2 * count[e];
                }
                begin[e] = at;
                if (at + 2 * count[e] > room) continue;
                for (std::int64_t c = 0; c < 2 * count[e]; c++) {
                    const Real *line = c < count[e] ? crosses[c].row : crosses[c - count[e]].column;
                    store(line, out + 2 * stored<Store> * (at + c));
                    store(line + lanes, out + 2 * stored<Store> * (at + c) + stored<Store>);
                }
            }
    }
    return taken;
}

}  // namespace

template <class Store>
std::int64_t dual_crosses(const double *points, const double *shifted, const double *normals, std::int64_t m,
                          Wavenumber k, Pairs far, double tolerance, std::int64_t room, std::int64_t *count,
                          std::int64_t *begin, Store *rows) {
    return (k.imag > 0 ? all_crosses<Store, true> : all_crosses<Store, false>)(points, shifted, normals, m, k, far,
                                                                             tolerance, room, count, begin, rows);
}

#define AIRTACT_CROSSES(Store)                                                                                        \
    template std::int64_t dual_crosses<Store>(const double *, const double *, const double *, std::int64_t,           \
                                              Wavenumber, Pairs, double, std::int64_t, std::int64_t *,                \
                                              std::int64_t *, Store *);
AIRTACT_CROSSES(std::uint32_t)
AIRTACT_CROSSES(float)
AIRTACT_CROSSES(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
