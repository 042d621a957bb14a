// The matrix of the dual-surface equation: its blocks, filled a row at a time, and its products with a few vectors at once.
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

template <class Store, bool Lossy>
void fill(const double *targets, const double *shifted, const double *points, const double *normals, std::int64_t m,
          Wavenumber wavenumber, double diagonal, const NearRows &near, const NearRows &near_shifted, const Pairs &whole,
          Store *blocks) {
    using Real = typename Arithmetic<Store>::Real;
    const double zero[3] = {0, 0, 0};
    const Origin origin(points, m);
    const Planes<Real> y(points, m, origin.at), x(targets, m, origin.at), x2(shifted, m / sharing, origin.at);
    const Planes<Real> a(normals, m, zero);
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
            const std::int64_t begin = lanes * whole.column[e], n = std::min(lanes, m - begin);
            if (n < lanes) std::fill(rows[0], rows[0] + sharing * 2 * lanes, Real(0));
            const Real *sx = y[0] + begin, *sy = y[1] + begin, *sz = y[2] + begin;
            const Real *nx = a[0] + begin, *ny = a[1] + begin, *nz = a[2] + begin;
#pragma omp simd
            for (std::int64_t l = 0; l < n; l++) {  // i D(x') - D(x), all that share x' at once, which hides the latency
                Real inside_re, inside_im, re, im;
                double_layer<Real, Lossy>(sx[l] - t2[0], sy[l] - t2[1], sz[l] - t2[2], nx[l], ny[l], nz[l], k, Real(0),
                                          inside_re, inside_im);
                for (int r = 0; r < sharing; r++) {
                    double_layer<Real, Lossy>(sx[l] - t[r][0], sy[l] - t[r][1], sz[l] - t[r][2], nx[l], ny[l], nz[l], k,
                                              Real(0), re, im);
                    rows[r][l] = -re - inside_im;
                    rows[r][l + lanes] = inside_re - im;
                }
            }
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

template <class Real> struct Vectors {  // vectors as planes padded with zeros: real parts, imaginary parts
    std::int64_t length;
    std::vector<Real> data;
    Vectors(std::int64_t vectors, std::int64_t m) : length((m + lanes - 1) / lanes * lanes), data(2 * vectors * length) {}
    Vectors(const std::complex<Real> *v, std::int64_t vectors, std::int64_t m) : Vectors(vectors, m) {
        for (std::int64_t s = 0; s < vectors; s++)
            for (std::int64_t j = 0; j < m; j++) {
                data[2 * s * length + j] = v[s * m + j].real();
                data[(2 * s + 1) * length + j] = v[s * m + j].imag();
            }
    }
};

// Adds to N sums the products of a row with N vectors, planes of `length` that begin at its block
template <int N, class Store, class Real>
void multiply_row(const Store *row, const Real *v_re, std::int64_t length, Real *re, Real *im) {
    const Store *a_re = row, *a_im = row + stored<Store>;
    const Real *v_im = v_re + length, *w_re = v_re + (N > 1 ? 2 * length : 0), *w_im = w_re + length;
    Real rr = 0, ii = 0, ri = 0, ir = 0, r2 = 0, i2 = 0, x2 = 0, y2 = 0;  // several sums hide the latency of each
#pragma omp simd reduction(+ : rr, ii, ri, ir, r2, i2, x2, y2)
    for (std::int64_t l = 0; l < half; l++) {
        const std::int64_t h = half + l;
        const Real x = first(a_re, l), y = first(a_im, l), o = second(a_re, l), w = second(a_im, l);
        rr += x * v_re[l] + o * v_re[h], ii += y * v_im[l] + w * v_im[h];
        ri += x * v_im[l] + o * v_im[h], ir += y * v_re[l] + w * v_re[h];
        if (N == 1) continue;
        r2 += x * w_re[l] + o * w_re[h], i2 += y * w_im[l] + w * w_im[h];
        x2 += x * w_im[l] + o * w_im[h], y2 += y * w_re[l] + w * w_re[h];
    }
    re[0] += rr - ii, im[0] += ri + ir;
    if (N > 1) re[N - 1] += r2 - i2, im[N - 1] += x2 + y2;
}

constexpr int rows_at_once = 4;

// Adds to N vectors, planes of `length` that begin at the block, up to four rows times their weights, planes of `stride`
template <int N, class Store, class Real>
void add_four(const Store *rows, std::int64_t count, const Real *weights, std::int64_t stride, Real *sums,
           std::int64_t length) {
    Real c[rows_at_once][2] = {}, d[rows_at_once][2] = {};
    const Store *row[rows_at_once];
    for (std::int64_t r = 0; r < rows_at_once; r++) {
        row[r] = rows + 2 * stored<Store> * (r < count ? r : 0);
        for (int s = 0; r < count && s < N; s++) {
            c[r][s] = weights[2 * s * stride + r];
            d[r][s] = weights[(2 * s + 1) * stride + r];
        }
    }
    Real *const re = sums, *const im = re + length;
    Real *const re2 = re + (N > 1 ? 2 * length : 0), *const im2 = re2 + length;
#pragma omp simd
    for (std::int64_t l = 0; l < half; l++) {
        const std::int64_t h = half + l;
        Real x = re[l], y = im[l], x2 = re2[l], y2 = im2[l], u = re[h], v = im[h], u2 = re2[h], v2 = im2[h];
        for (int r = 0; r < rows_at_once; r++) {
            const Real p = first(row[r], l), q = first(row[r] + stored<Store>, l);
            const Real o = second(row[r], l), w = second(row[r] + stored<Store>, l);
            x += p * c[r][0] - q * d[r][0], y += p * d[r][0] + q * c[r][0];
            u += o * c[r][0] - w * d[r][0], v += o * d[r][0] + w * c[r][0];
            if (N == 1) continue;
            x2 += p * c[r][1] - q * d[r][1], y2 += p * d[r][1] + q * c[r][1];
            u2 += o * c[r][1] - w * d[r][1], v2 += o * d[r][1] + w * c[r][1];
        }
        re[l] = x, im[l] = y, re[h] = u, im[h] = v;
        if (N > 1) re2[l] = x2, im2[l] = y2, re2[h] = u2, im2[h] = v2;
    }
}

// The products of some rows with vectors are added to `weights`, planes of `stride`; or the rows times weights to `sums`
template <int N, class Store, class Real>
void multiply_rows(const Store *rows, std::int64_t count, const Real *v, std::int64_t length, Real *weights,
               std::int64_t stride) {
    for (std::int64_t r = 0; r < count; r++) {
        Real re[2] = {}, im[2] = {};
        multiply_row<N, Store, Real>(rows + 2 * stored<Store> * r, v, length, re, im);
        for (int s = 0; s < N; s++) weights[2 * s * stride + r] += re[s], weights[(2 * s + 1) * stride + r] += im[s];
    }
}
template <int N, class Store, class Real>
void add_rows(const Store *rows, std::int64_t count, const Real *weights, std::int64_t stride, Real *sums,
                std::int64_t length) {
    for (std::int64_t r = 0; r < count; r += rows_at_once)
        add_four<N, Store, Real>(rows + 2 * stored<Store> * r, std::min<std::int64_t>(rows_at_once, count - r), weights + r,
                              stride, sums, length);
}

struct Partner {  // another block of a pair: its number and that of the pair
    std::int64_t block, pair;
};

std::vector<std::vector<Partner>> by_block(const Pairs &pairs, bool transposed) {  // by the block of the product
    std::vector<std::vector<Partner>> out(pairs.blocks);
    for (std::int64_t t = 0; t < pairs.blocks; t++)
        for (std::int64_t e = pairs.first[t]; e < pairs.first[t + 1]; e++) {
            const std::int64_t c = pairs.column[e];
            transposed ? out[c].push_back({t, e}) : out[t].push_back({c, e});
        }
    return out;
}

// One block of the product with one or two vectors, planes of `length`
template <int N, class Store, class Real>
void product_at(std::int64_t block, const std::vector<Partner> &whole, const Store *blocks, const std::vector<Partner> &far,
                const LowRank<Store> &terms, std::int64_t m, const Real *v, std::int64_t length, bool transposed,
                Real *out) {
    constexpr std::int64_t row_words = 2 * stored<Store>;
    for (const Partner &one : whole) {
        const Store *rows = blocks + row_words * lanes * one.pair;
        if (transposed)
            add_rows<N, Store, Real>(rows, std::min(lanes, m - lanes * one.block), v + lanes * one.block, length,
                                       out + lanes * block, length);
        else
            multiply_rows<N, Store, Real>(rows, std::min(lanes, m - lanes * block), v + lanes * one.block, length,
                                      out + lanes * block, length);
    }
    for (const Partner &one : far) {
        const std::int64_t count = terms.count[one.pair];
        const Store *of_columns = terms.rows + row_words * terms.begin[one.pair];
        const Store *of_rows = of_columns + row_words * count;
        if (transposed) std::swap(of_columns, of_rows);
        Real weights[2 * N * lanes] = {};
        multiply_rows<N, Store, Real>(of_columns, count, v + lanes * one.block, length, weights, lanes);
        add_rows<N, Store, Real>(of_rows, count, weights, lanes, out + lanes * block, length);
    }
}

}  // namespace

template <class Store>
void dual_blocks(const double *targets, const double *shifted, const double *points, const double *normals,
                std::int64_t m, Wavenumber k, double diagonal, NearRows near, NearRows near_shifted, Pairs whole,
                Store *blocks) {
    (k.imag > 0 ? fill<Store, true> : fill<Store, false>)(targets, shifted, points, normals, m, k, diagonal, near,
                                                          near_shifted, whole, blocks);
}

template <class Store>
void dual_product(Pairs whole, const Store *blocks, Pairs far, LowRank<Store> terms, std::int64_t m,
                  const std::complex<typename Arithmetic<Store>::Real> *v, std::int64_t vectors, bool transposed,
                  std::complex<typename Arithmetic<Store>::Real> *out) {
    using Real = typename Arithmetic<Store>::Real;
    const Vectors<Real> given(v, vectors, m);
    Vectors<Real> made(vectors, m);
    const auto whole_pairs = by_block(whole, transposed), far_pairs = by_block(far, transposed);
    const std::int64_t length = given.length;
#pragma omp parallel for schedule(dynamic, 1)
    for (std::int64_t block = 0; block < whole.blocks; block++)
        for (std::int64_t s = 0; s < vectors; s += 2)
            (s + 1 < vectors ? product_at<2, Store, Real> : product_at<1, Store, Real>)(
                block, whole_pairs[block], blocks, far_pairs[block], terms, m, given.data.data() + 2 * s * length, length,
                transposed, made.data.data() + 2 * s * length);
    for (std::int64_t s = 0; s < vectors; s++)
        for (std::int64_t j = 0; j < m; j++)
            out[s * m + j] = {made.data[2 * s * length + j], made.data[(2 * s + 1) * length + j]};
}

#define AIRTACT_DUAL(Store)                                                                                           \
    template void dual_blocks<Store>(const double *, const double *, const double *, const double *, std::int64_t,     \
                                    Wavenumber, double, NearRows, NearRows, Pairs, Store *);                          \
    template void dual_product<Store>(Pairs, const Store *, Pairs, LowRank<Store>, std::int64_t,                      \
                                      const std::complex<Arithmetic<Store>::Real> *, std::int64_t, bool,              \
                                      std::complex<Arithmetic<Store>::Real> *);
AIRTACT_DUAL(std::uint32_t)
AIRTACT_DUAL(float)
AIRTACT_DUAL(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
