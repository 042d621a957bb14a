// The matrix of the dual-surface equation: its blocks, filled a row at a time.
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

template <class Store, bool Lossy, bool Mixed>
void fill(const double *targets, const double *shifted, const double *points, const double *normals,
          const std::complex<double> *single, std::int64_t m, Wavenumber wavenumber, double diagonal, const NearRows &near, const NearRows &near_shifted, const Pairs &whole,
          Store *blocks) {
    using Real = typename Arithmetic<Store>::Real;
    const Origin origin(points, m);
    const Planes<Real> y(points, m, origin.at), x(targets, m, origin.at), x2(shifted, m / sharing, origin.at);
    const Normals<Real> a(normals, m);
    const Strengths<Real> mixed(single, m);
    const Wave<Real> k(wavenumber);
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
            const std::int64_t begin = lanes * whole.column[e], n = std::min(lanes, m - begin), filled = whole_lines<Real>(n);
            const Real *sx = y[0] + begin, *sy = y[1] + begin, *sz = y[2] + begin;
            const Real *nx = a[0] + begin, *ny = a[1] + begin, *nz = a[2] + begin;
            const Real *of_re = Mixed ? mixed.re.data() + begin : nullptr, *of_im = Mixed ? mixed.im.data() + begin : nullptr;
            Store *const out = blocks + row_words * (lanes * e + top);
            fetch<1>(out, row_words * lanes * sizeof(Store), sharing * row_words * sizeof(Store));  // of the next block
            for (std::int64_t j = 0; j < filled; j += line<Real>) {
                const auto layer = [&](const Real *from, Real *re, Real *im) {
                    double_layer_line<Real, Lossy, Mixed>(from, sx + j, sy + j, sz + j, nx + j, ny + j, nz + j, k, Real(0), re, im,
                                                          Mixed ? of_re + j : of_re, Mixed ? of_im + j : of_im);
                };
                Real inside_re[line<Real>], inside_im[line<Real>], re[line<Real>], im[line<Real>];
                layer(t2, inside_re, inside_im);
#pragma GCC unroll 3
                for (std::int64_t r = 0; r < sharing; r++) {  // all that share x' at once, which hides the latency
                    layer(t[r], re, im);
#pragma omp simd
                    for (int l = 0; l < line<Real>; l++) {  // i D(x') - D(x)
                        rows[r][j + l] = -re[l] - inside_im[l];
                        rows[r][lanes + j + l] = inside_re[l] - im[l];
                    }
                }
            }
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

}  // namespace

template <class Store>
void dual_blocks(const double *targets, const double *shifted, const double *points, const double *normals,
                const std::complex<double> *single, std::int64_t m, Wavenumber k, double diagonal, NearRows near,
                NearRows near_shifted, Pairs whole, Store *blocks) {
    (single       ? fill<Store, true, true>
     : k.imag > 0 ? fill<Store, true, false>
                  : fill<Store, false, false>)(targets, shifted, points, normals, single, m, k, diagonal, near,
                                               near_shifted, whole, blocks);
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
