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
    const double zero[3] = {0, 0, 0};
    const Origin origin(points, m);
    const Planes<Real> y(points, m, origin.at), x(targets, m, origin.at), x2(shifted, m / sharing, origin.at);
    const Planes<Real> a(normals, m, zero);
    const Strengths<Real> mixed(single, m);
    const Wave<Real> k(wavenumber);
    constexpr std::int64_t row_words = 2 * stored<Store>;
#pragma omp parallel for schedule(dynamic, 8)
    for (std::int64_t group = 0; group < m / sharing; group++) {
        Real rows[sharing][2 * lanes], t[sharing][3], t2[3];
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
#pragma omp simd
            for (std::int64_t l = 0; l < filled; l++) {  // i D(x') - D(x), all that share x' at once, which hides the latency
                Real inside_re, inside_im, re, im;
                const Real p = strength<Mixed>(of_re, l), q = strength<Mixed>(of_im, l);
                double_layer<Real, Lossy, Mixed>(sx[l] - t2[0], sy[l] - t2[1], sz[l] - t2[2], nx[l], ny[l], nz[l], k,
                                                 Real(0), inside_re, inside_im, p, q);
#pragma GCC unroll 3  // or the compiler leaves a loop here, and does not vectorise the one around it
                for (int r = 0; r < sharing; r++) {
                    double_layer<Real, Lossy, Mixed>(sx[l] - t[r][0], sy[l] - t[r][1], sz[l] - t[r][2], nx[l], ny[l],
                                                     nz[l], k, Real(0), re, im, p, q);
                    rows[r][l] = -re - inside_im;
                    rows[r][l + lanes] = inside_re - im;
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
                Store *out = blocks + row_words * (lanes * e + top + r);
                store(rows[r], out);
                store(rows[r] + lanes, out + stored<Store>);
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
