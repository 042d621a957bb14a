// Products of the matrix of the dual-surface equation with a few vectors at once. The compiler may take these sums in any order.
#include "storage.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

template <class Real> struct Vectors {  // vectors as planes padded with zeros: real parts, imaginary parts
    std::int64_t length;
    Lined<Real> data;
    Vectors(std::int64_t vectors, std::int64_t m) : length((m + lanes - 1) / lanes * lanes), data(2 * vectors * length) {}
    Vectors(const std::complex<Real> *v, std::int64_t vectors, std::int64_t m) : Vectors(vectors, m) {
        for (std::int64_t s = 0; s < vectors; s++)
            for (std::int64_t j = 0; j < m; j++) {
                data[2 * s * length + j] = v[s * m + j].real();
                data[(2 * s + 1) * length + j] = v[s * m + j].imag();
            }
    }
};

constexpr int rows_at_once = 4;

template <class Store> inline void fetch_next(const Store *rows) {  // the four after these
    constexpr std::int64_t words = 2 * stored<Store> * rows_at_once;
    fetch(rows, words * std::int64_t(sizeof(Store)), words * std::int64_t(sizeof(Store)));
}

// Number l of a row times those of one or two vectors, added to sums
template <int N, class Store, class Real>
inline void add_entry(const Store *row, std::int64_t l, const Real *v_re, const Real *v_im, const Real *w_re,
                      const Real *w_im, Real &re, Real &im, Real &re2, Real &im2) {
    const std::int64_t h = half + l;
    const Real x = first(row, l), y = first(row + stored<Store>, l), o = second(row, l), w = second(row + stored<Store>, l);
    re += x * v_re[l], im += x * v_im[l];
    re -= y * v_im[l], im += y * v_re[l];
    re += o * v_re[h], im += o * v_im[h];
    re -= w * v_im[h], im += w * v_re[h];
    if (N == 1) return;
    re2 += x * w_re[l], im2 += x * w_im[l];
    re2 -= y * w_im[l], im2 += y * w_re[l];
    re2 += o * w_re[h], im2 += o * w_im[h];
    re2 -= w * w_im[h], im2 += w * w_re[h];
}

// Adds to N sums for each of four rows, planes of `stride`, their products with N vectors, planes of `length` that begin at
// their block: all at once, which hides the latency of each sum and reads the vectors once
template <int N, class Store, class Real>
void multiply_four(const Store *const *row, const Real *v_re, std::int64_t length, Real *weights, std::int64_t stride,
                   std::int64_t count) {
    const Real *v_im = v_re + length, *w_re = v_re + (N > 1 ? 2 * length : 0), *w_im = w_re + length;
    const Store *const r0 = row[0], *const r1 = row[1], *const r2 = row[2], *const r3 = row[3];
    Real a0 = 0, b0 = 0, c0 = 0, d0 = 0, a1 = 0, b1 = 0, c1 = 0, d1 = 0;
    Real a2 = 0, b2 = 0, c2 = 0, d2 = 0, a3 = 0, b3 = 0, c3 = 0, d3 = 0;
#pragma omp simd reduction(+ : a0, b0, c0, d0, a1, b1, c1, d1, a2, b2, c2, d2, a3, b3, c3, d3)
    for (std::int64_t l = 0; l < half; l++) {
        add_entry<N>(r0, l, v_re, v_im, w_re, w_im, a0, b0, c0, d0);
        add_entry<N>(r1, l, v_re, v_im, w_re, w_im, a1, b1, c1, d1);
        add_entry<N>(r2, l, v_re, v_im, w_re, w_im, a2, b2, c2, d2);
        add_entry<N>(r3, l, v_re, v_im, w_re, w_im, a3, b3, c3, d3);
    }
    const Real sums[4][rows_at_once] = {{a0, a1, a2, a3}, {b0, b1, b2, b3}, {c0, c1, c2, c3}, {d0, d1, d2, d3}};
    for (int part = 0; part < 2 * N; part++)
        for (std::int64_t r = 0; r < count; r++) weights[part * stride + r] += sums[part][r];
}

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
            x += p * c[r][0], y += p * d[r][0], u += o * c[r][0], v += o * d[r][0];  // one by one, or each pair takes three steps
            x -= q * d[r][0], y += q * c[r][0], u -= w * d[r][0], v += w * c[r][0];
            if (N == 1) continue;
            x2 += p * c[r][1], y2 += p * d[r][1], u2 += o * c[r][1], v2 += o * d[r][1];
            x2 -= q * d[r][1], y2 += q * c[r][1], u2 -= w * d[r][1], v2 += w * c[r][1];
        }
        re[l] = x, im[l] = y, re[h] = u, im[h] = v;
        if (N > 1) re2[l] = x2, im2[l] = y2, re2[h] = u2, im2[h] = v2;
    }
}

// The products of some rows with vectors are added to `weights`, planes of `stride`; or the rows times weights to `sums`
template <int N, class Store, class Real>
void multiply_rows(const Store *rows, std::int64_t count, const Real *v, std::int64_t length, Real *weights,
               std::int64_t stride) {
    for (std::int64_t top = 0; top < count; top += rows_at_once) {
        const std::int64_t some = std::min<std::int64_t>(rows_at_once, count - top);
        const Store *row[rows_at_once];
        fetch_next(rows + 2 * stored<Store> * top);
        for (std::int64_t r = 0; r < rows_at_once; r++) row[r] = rows + 2 * stored<Store> * (top + (r < some ? r : 0));
        multiply_four<N, Store, Real>(row, v, length, weights + top, stride, some);
    }
}
template <int N, class Store, class Real>
void add_rows(const Store *rows, std::int64_t count, const Real *weights, std::int64_t stride, Real *sums,
                std::int64_t length) {
    for (std::int64_t r = 0; r < count; r += rows_at_once) {
        fetch_next(rows + 2 * stored<Store> * r);
        add_four<N, Store, Real>(rows + 2 * stored<Store> * r, std::min<std::int64_t>(rows_at_once, count - r), weights + r,
                              stride, sums, length);
    }
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

// The blocks of the product, those that take longest first: then no thread begins a long one last
template <class Store>
std::vector<std::int64_t> longest_first(const std::vector<std::vector<Partner>> &whole, const std::vector<std::vector<Partner>> &far,
                                        const LowRank<Store> &terms) {
    std::vector<std::int64_t> rows(whole.size()), order(whole.size());
    for (std::size_t t = 0; t < whole.size(); t++) {
        order[t] = std::int64_t(t);
        rows[t] = lanes * std::int64_t(whole[t].size());
        for (const Partner &one : far[t]) rows[t] += 2 * terms.count[one.pair];
    }
    std::stable_sort(order.begin(), order.end(), [&](std::int64_t one, std::int64_t other) { return rows[one] > rows[other]; });
    return order;
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

// --- many vectors at once: each number of a row is multiplied by a whole vector register of sides --------------------

#ifdef __GNUC__
#if defined(__AVX512F__)
constexpr int register_bytes = 64;
#elif defined(__AVX2__)
constexpr int register_bytes = 32;
#else
constexpr int register_bytes = 16;
#endif
template <class Real> struct Register;
template <> struct Register<float> {
    typedef float Lanes __attribute__((vector_size(register_bytes)));
};
template <> struct Register<double> {
    typedef double Lanes __attribute__((vector_size(register_bytes)));
};
template <class Real> constexpr int sides = register_bytes / int(sizeof(Real));

// As many vectors as a register holds: for each node a register of real parts and one of imaginary parts
template <class Real> using Lanes = typename Register<Real>::Lanes;
template <class Real> struct Interleaved {
    Lined<Real> data;
    Lanes<Real> *begin;
    explicit Interleaved(std::int64_t nodes) : data(2 * sides<Real> * nodes), begin(reinterpret_cast<Lanes<Real> *>(data.data())) {}
};

template <class Store, class Real> void unpack(const Store *row, Real *out) {  // real parts, then imaginary parts
    for (int part = 0; part < 2; part++)
#pragma omp simd
        for (std::int64_t l = 0; l < half; l++) {
            out[part * lanes + l] = first(row + part * stored<Store>, l);
            out[part * lanes + half + l] = second(row + part * stored<Store>, l);
        }
}

constexpr int tile = 4;  // rows at a time

template <class Store, class Real> void unpack_tile(const Store *rows, std::int64_t count, Real (*out)[2 * lanes]) {
    for (std::int64_t r = 0; r < tile; r++)
        if (r < count) unpack(rows + 2 * stored<Store> * r, out[r]);
        else std::fill(out[r], out[r] + 2 * lanes, Real(0));
}

// The products of some rows with the vectors are added to `sums`, a pair of registers for each row
template <class Store, class Real>
void multiply_many(const Store *rows, std::int64_t count, const Lanes<Real> *v, Lanes<Real> *sums) {
    Real row[tile][2 * lanes];
    for (std::int64_t top = 0; top < count; top += tile) {
        unpack_tile(rows + 2 * stored<Store> * top, count - top, row);
        Lanes<Real> re[tile] = {}, im[tile] = {};
        for (std::int64_t l = 0; l < lanes; l++) {
            const Lanes<Real> x = v[2 * l], y = v[2 * l + 1];
#pragma GCC unroll 4
            for (int r = 0; r < tile; r++) {
                const Real p = row[r][l], q = row[r][lanes + l];
                re[r] += p * x, im[r] += p * y;
                re[r] -= q * y, im[r] += q * x;
            }
        }
        for (std::int64_t r = 0; r < tile && top + r < count; r++)
            sums[2 * (top + r)] += re[r], sums[2 * (top + r) + 1] += im[r];
    }
}

// The rows times weights, a pair of registers for each row, are added to `sums`, one for each column
template <class Store, class Real>
void add_many(const Store *rows, std::int64_t count, const Lanes<Real> *weights, Lanes<Real> *sums) {
    Real row[tile][2 * lanes];
    for (std::int64_t top = 0; top < count; top += tile) {
        unpack_tile(rows + 2 * stored<Store> * top, count - top, row);
        Lanes<Real> x[tile] = {}, y[tile] = {};
        for (std::int64_t r = 0; r < tile && top + r < count; r++) x[r] = weights[2 * (top + r)], y[r] = weights[2 * (top + r) + 1];
        for (std::int64_t l = 0; l < lanes; l++) {
            Lanes<Real> re = sums[2 * l], im = sums[2 * l + 1];
#pragma GCC unroll 4
            for (int r = 0; r < tile; r++) {
                const Real p = row[r][l], q = row[r][lanes + l];
                re += p * x[r], im += p * y[r];
                re -= q * y[r], im += q * x[r];
            }
            sums[2 * l] = re, sums[2 * l + 1] = im;
        }
    }
}

template <class Store, class Real>
void product_of_many(std::int64_t block, const std::vector<Partner> &whole, const Store *blocks,
                     const std::vector<Partner> &far, const LowRank<Store> &terms, std::int64_t m, const Lanes<Real> *v,
                     bool transposed, Lanes<Real> *out) {
    constexpr std::int64_t row_words = 2 * stored<Store>;
    Lanes<Real> *const sums = out + 2 * lanes * block;
    for (const Partner &one : whole) {
        const Store *rows = blocks + row_words * lanes * one.pair;
        const Lanes<Real> *with = v + 2 * lanes * one.block;
        if (transposed)
            add_many<Store, Real>(rows, std::min(lanes, m - lanes * one.block), with, sums);
        else
            multiply_many<Store, Real>(rows, std::min(lanes, m - lanes * block), with, sums);
    }
    for (const Partner &one : far) {
        const std::int64_t count = terms.count[one.pair];
        const Store *of_columns = terms.rows + row_words * terms.begin[one.pair];
        const Store *of_rows = of_columns + row_words * count;
        if (transposed) std::swap(of_columns, of_rows);
        Lanes<Real> weights[2 * lanes];
        std::fill(weights, weights + 2 * count, Lanes<Real>{});
        multiply_many<Store, Real>(of_columns, count, v + 2 * lanes * one.block, weights);
        add_many<Store, Real>(of_rows, count, weights, sums);
    }
}

// The product with a register of vectors
template <class Store, class Real>
void multiply_sides(const Pairs &whole, const std::vector<std::vector<Partner>> &whole_pairs, const Store *blocks,
                    const std::vector<std::vector<Partner>> &far_pairs, const LowRank<Store> &terms, std::int64_t m,
                    const std::complex<Real> *v, bool transposed, std::complex<Real> *out) {
    Interleaved<Real> given(whole.blocks * lanes), made(whole.blocks * lanes);
    constexpr int width = sides<Real>;
    Real *const in = reinterpret_cast<Real *>(given.begin);
    const Real *const result = reinterpret_cast<const Real *>(made.begin);
#pragma omp parallel
    {
#pragma omp for schedule(static)
        for (std::int64_t j = 0; j < m; j++)
            for (std::int64_t s = 0; s < width; s++) {
                in[2 * width * j + s] = v[s * m + j].real();
                in[2 * width * j + width + s] = v[s * m + j].imag();
            }
#pragma omp for schedule(dynamic, 1)
        for (std::int64_t block = 0; block < whole.blocks; block++) {
            product_of_many<Store, Real>(block, whole_pairs[block], blocks, far_pairs[block], terms, m, given.begin,
                                         transposed, made.begin);
            for (std::int64_t s = 0; s < width; s++)
                for (std::int64_t j = lanes * block; j < std::min(m, lanes * (block + 1)); j++)
                    out[s * m + j] = {result[2 * width * j + s], result[2 * width * j + width + s]};
        }
    }
}

#endif

}  // namespace

template <class Store>
void dual_product(Pairs whole, const Store *blocks, Pairs far, LowRank<Store> terms, std::int64_t m,
                  const std::complex<typename Arithmetic<Store>::Real> *v, std::int64_t vectors, bool transposed,
                  std::complex<typename Arithmetic<Store>::Real> *out) {
    using Real = typename Arithmetic<Store>::Real;
    const auto whole_pairs = by_block(whole, transposed), far_pairs = by_block(far, transposed);
#ifdef __GNUC__
    for (; vectors >= sides<Real>; vectors -= sides<Real>, v += sides<Real> * m, out += sides<Real> * m)
        multiply_sides<Store, Real>(whole, whole_pairs, blocks, far_pairs, terms, m, v, transposed, out);
#endif
    const Vectors<Real> given(v, vectors, m);
    Vectors<Real> made(vectors, m);
    const std::int64_t length = given.length;
    const std::vector<std::int64_t> order = longest_first(whole_pairs, far_pairs, terms);
#pragma omp parallel for schedule(dynamic, 1)
    for (std::int64_t turn = 0; turn < whole.blocks; turn++)
        for (std::int64_t s = 0, block = order[turn]; s < vectors; s += 2)
            (s + 1 < vectors ? product_at<2, Store, Real> : product_at<1, Store, Real>)(
                block, whole_pairs[block], blocks, far_pairs[block], terms, m, given.data.data() + 2 * s * length, length,
                transposed, made.data.data() + 2 * s * length);
    for (std::int64_t s = 0; s < vectors; s++)
        for (std::int64_t j = 0; j < m; j++)
            out[s * m + j] = {made.data[2 * s * length + j], made.data[(2 * s + 1) * length + j]};
}

#define AIRTACT_PRODUCT(Store)                                                                                        \
    template void dual_product<Store>(Pairs, const Store *, Pairs, LowRank<Store>, std::int64_t,                      \
                                      const std::complex<Arithmetic<Store>::Real> *, std::int64_t, bool,              \
                                      std::complex<Arithmetic<Store>::Real> *);
AIRTACT_PRODUCT(std::uint32_t)
AIRTACT_PRODUCT(float)
AIRTACT_PRODUCT(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
