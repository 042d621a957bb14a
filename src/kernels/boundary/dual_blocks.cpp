// The matrix of the dual-surface equation: its blocks, filled a row at a time.
#include "lines.hpp"
#include "storage.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

static_assert(lanes % 6 == 0 && lanes % sharing == 0, "a panel is in one block");

// Calls add(column, real, imaginary) for the corrections of the near panels of target i to the columns of a block. `next` is the
// first of them that may be in it or a later one: panels come in order.
template <class Add>
void add_near(const NearRows &near, std::int64_t i, std::int64_t begin, std::int64_t n, std::int64_t &next,
              const Add &add) {
    for (; next < near.first[i + 1] && 6 * near.panel[next] < begin + n; next++)
        for (int l = 0; l < 6; l++)
            add(6 * near.panel[next] + l - begin, near.excess[6 * next + l].real(), near.excess[6 * next + l].imag());
}

// i D(x') - D(x) of the targets x that share an x', with n nodes from `begin` on
template <class Real, bool Lossy, bool Mixed>
void fill_rows(const Real (*x)[3], const Real *inside, const Nodes<Real> &nodes, std::int64_t begin, std::int64_t n, Wave<Real> k,
               Real (*rows)[2 * lanes]) {
    for (std::int64_t j = 0; j < n; j += line<Real>) {
        Real inside_re[line<Real>], inside_im[line<Real>];
        Waves<Real> waves;
        double_layer_line<Real, Lossy, Mixed>(inside, nodes, begin + j, k, Real(0), waves);
        store(waves, inside_re, inside_im);
#pragma GCC unroll 3
        for (std::int64_t r = 0; r < sharing; r++) {  // all at once, which hides the latency
            double_layer_line<Real, Lossy, Mixed>(x[r], nodes, begin + j, k, Real(0), waves);
#pragma omp simd
            for (int l = 0; l < line<Real>; l++) {
                // In an order that takes two multiply-adds each
                rows[r][j + l] = waves.h[l] * waves.s[l] + (waves.g[l] * waves.c[l] - inside_im[l]);
                rows[r][lanes + j + l] = waves.g[l] * waves.s[l] + (inside_re[l] - waves.h[l] * waves.c[l]);
            }
        }
    }
}

}  // namespace

template <class Store>
void dual_blocks(const double *targets, const double *shifted, const double *points, const double *normals,
                const std::complex<double> *single, std::int64_t m, Wavenumber k, double diagonal, NearRows near,
                NearRows near_shifted, Pairs whole, Store *blocks) {
    using Real = typename Arithmetic<Store>::Real;
    const Origin origin(points, m);
    const Planes<Real> x(targets, m, origin.at), x2(shifted, m / sharing, origin.at);
    const Layer<Real> layer(points, normals, single, m, origin.at);
    const auto fill = single ? fill_rows<Real, true, true> : k.imag > 0 ? fill_rows<Real, true, false> : fill_rows<Real, false, false>;
    constexpr std::int64_t row_words = 2 * stored<Store>;
#pragma omp parallel for schedule(dynamic, 8)
    for (std::int64_t group = 0; group < m / sharing; group++) {
        alignas(cache_line) Real rows[sharing][2 * lanes];
        Real t[sharing][3], t2[3];
        std::int64_t next_inside = near_shifted.first[group], next[sharing];
        for (std::int64_t r = 0; r < sharing; r++) next[r] = near.first[sharing * group + r];
        for (int d = 0; d < 3; d++) {
            t2[d] = x2[d][group];
            for (std::int64_t r = 0; r < sharing; r++) t[r][d] = x[d][sharing * group + r];
        }
        const std::int64_t block = sharing * group / lanes, top = sharing * group % lanes;
        for (std::int64_t e = whole.first[block]; e < whole.first[block + 1]; e++) {
            const std::int64_t begin = lanes * whole.column[e], n = std::min(lanes, m - begin);
            Store *const out = blocks + row_words * (lanes * e + top);
            fill(t, t2, layer.nodes, begin, n, Wave<Real>(k), rows);
            for (std::int64_t r = 0; r < sharing; r++) clear_rest(rows[r], n);
            add_near(near_shifted, group, begin, n, next_inside, [&](std::int64_t l, double re, double im) {
                for (int r = 0; r < sharing; r++) rows[r][l] -= Real(im), rows[r][l + lanes] += Real(re);
            });
            for (std::int64_t r = 0; r < sharing; r++) {
                const std::int64_t i = sharing * group + r;
                add_near(near, i, begin, n, next[r], [&](std::int64_t l, double re, double im) {
                    rows[r][l] -= Real(re), rows[r][l + lanes] -= Real(im);
                });
                if (begin <= i && i < begin + n) rows[r][i - begin] += Real(diagonal);
                store(rows[r], out + r * row_words);
                store(rows[r] + lanes, out + r * row_words + stored<Store>);
            }
        }
    }
}

#define AIRTACT_DUAL(Store)                                                                                           \
    template void dual_blocks<Store>(const double *, const double *, const double *, const double *,                   \
                                    const std::complex<double> *, std::int64_t, Wavenumber, double, NearRows,         \
                                    NearRows, Pairs, Store *);
AIRTACT_DUAL(std::uint32_t)
AIRTACT_DUAL(float)
AIRTACT_DUAL(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
