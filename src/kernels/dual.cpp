// The matrix of the dual-surface equation: its rows, filled one at a time, and its products with a few vectors at once.
#include "rows.hpp"

#ifdef _OPENMP
#include <omp.h>
#endif

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

std::int64_t blocks_of(std::int64_t m) { return (m + lanes - 1) / lanes; }

// Calls add(column, real, imaginary) for what the near panels of target i add to the columns of a block. `next` is the
// first of them that may reach into it or a later one: panels come in order.
template <class Add>
void add_near(const NearRows &near, std::int64_t i, std::int64_t begin, std::int64_t n, std::int64_t &next,
              const Add &add) {
    for (std::int64_t e = next; e < near.first[i + 1] && 6 * near.panel[e] < begin + n; e++) {
        for (int l = 0; l < 6; l++) {
            const std::int64_t at = 6 * near.panel[e] + l - begin;
            if (at >= 0 && at < n) add(at, near.excess[6 * e + l].real(), near.excess[6 * e + l].imag());
        }
        if (6 * near.panel[e] + 6 <= begin + n) next = e + 1;
    }
}

constexpr std::int64_t half = lanes / 2;

// A block's two halves, each number as it is, or of two numbers the upper 16 bits each
template <class Real> void store(const Real *block, Real *out) { std::copy(block, block + lanes, out); }
void store(const float *block, std::uint32_t *out) {
    constexpr std::uint32_t rounded = 0x8000, upper = 0xffff0000;
#pragma omp simd
    for (std::int64_t l = 0; l < half; l++)
        out[l] = (bits<std::uint32_t>(block[l]) + rounded) >> 16 | ((bits<std::uint32_t>(block[half + l]) + rounded) & upper);
}

template <class Real> Real first(const Real *stored, std::int64_t l) { return stored[l]; }
template <class Real> Real second(const Real *stored, std::int64_t l) { return stored[half + l]; }
float first(const std::uint32_t *stored, std::int64_t l) { return bits<float>(stored[l] << 16); }
float second(const std::uint32_t *stored, std::int64_t l) { return bits<float>(stored[l] & 0xffff0000); }

template <class Store> constexpr std::int64_t stored = lanes;
template <> constexpr std::int64_t stored<std::uint32_t> = half;

template <class Store, bool Lossy>
void fill(const double *points, const double *shifted, const double *normals, std::int64_t m, Wavenumber wavenumber,
          const NearRows &near, const NearRows &near_shifted, Store *matrix) {
    using Real = typename Arithmetic<Store>::Real;
    const double zero[3] = {0, 0, 0};
    const Origin origin(points, m);
    const Planes<Real> y(points, m, origin.at), x2(shifted, m / sharing, origin.at), a(normals, m, zero);
    const Wave<Real> k(wavenumber);
    const std::int64_t blocks = blocks_of(m);
#pragma omp parallel for schedule(static)
    for (std::int64_t group = 0; group < m / sharing; group++) {
        Real rows[sharing][2 * lanes], t[sharing][3], t2[3];
        std::int64_t next_inside = near_shifted.first[group], next[sharing];
        for (std::int64_t r = 0; r < sharing; r++) next[r] = near.first[sharing * group + r];
        for (int d = 0; d < 3; d++) {
            t2[d] = x2[d][group];
            for (std::int64_t r = 0; r < sharing; r++) t[r][d] = y[d][sharing * group + r];
        }
        for (std::int64_t b = 0; b < blocks; b++) {
            const std::int64_t begin = lanes * b, n = std::min(lanes, m - begin);
            if (n < lanes) std::fill(rows[0], rows[0] + sharing * 2 * lanes, Real(0));
            const Real *sx = y[0] + begin, *sy = y[1] + begin, *sz = y[2] + begin;
            const Real *nx = a[0] + begin, *ny = a[1] + begin, *nz = a[2] + begin;
#pragma omp simd
            for (std::int64_t l = 0; l < n; l++) {  // i D(x') - D(x), all that share x' at once: each waits for itself
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
                if (begin <= i && i < begin + n) rows[r][i - begin] += Real(0.5);
                Store *out = matrix + 2 * stored<Store> * (blocks * i + b);
                store(rows[r], out);
                store(rows[r] + lanes, out + stored<Store>);
            }
        }
    }
}

template <class Real> struct Sounds {  // vectors as planes that are filled up with zeros: real parts, imaginary parts
    std::int64_t length;
    std::vector<Real> data;
    Sounds(const std::complex<Real> *v, std::int64_t sounds, std::int64_t m)
        : length(blocks_of(m) * lanes), data(2 * sounds * length) {
        for (std::int64_t s = 0; s < sounds; s++)
            for (std::int64_t j = 0; j < m; j++) {
                data[2 * s * length + j] = v[s * m + j].real();
                data[(2 * s + 1) * length + j] = v[s * m + j].imag();
            }
    }
};

// N of the sounds that row i hears
template <int N, class Store, class Real>
void hear(const Store *row, std::int64_t blocks, const Real *v, std::int64_t length, Real *re, Real *im) {
    for (int s = 0; s < N; s++) re[s] = im[s] = 0;
    for (std::int64_t b = 0; b < blocks; b++) {
        const Store *a_re = row + 2 * stored<Store> * b, *a_im = a_re + stored<Store>;
        const Real *v_re = v + lanes * b, *v_im = v_re + length;
        const Real *w_re = v_re + (N > 1 ? 2 * length : 0), *w_im = w_re + length;
        Real rr = 0, ii = 0, ri = 0, ir = 0, r2 = 0, i2 = 0, x2 = 0, y2 = 0;  // one sum alone waits for itself
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
}

constexpr int rows_at_once = 4;

// Adds to N sounds, planes of `length`, what some rows say in them; both begin with these rows' and block's part
template <int N, class Store, class Real>
void speak(const Store *matrix, std::int64_t blocks, std::int64_t b, std::int64_t rows, const Real *said, Real *heard,
           std::int64_t length) {
    Real c[rows_at_once][2] = {}, d[rows_at_once][2] = {};
    const Store *row[rows_at_once];
    for (std::int64_t r = 0; r < rows_at_once; r++) {
        row[r] = matrix + 2 * stored<Store> * (blocks * (r < rows ? r : 0) + b);
        for (int s = 0; r < rows && s < N; s++) {
            c[r][s] = said[2 * s * length + r];
            d[r][s] = said[(2 * s + 1) * length + r];
        }
    }
    Real *const re = heard, *const im = re + length;
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

template <class Store, class Real>
void plain_product(const Store *matrix, std::int64_t m, const Sounds<Real> &v, std::int64_t sounds,
                   std::complex<Real> *out) {
    const std::int64_t blocks = blocks_of(m);
#pragma omp parallel for schedule(static)
    for (std::int64_t i = 0; i < m; i++)
        for (std::int64_t s = 0; s < sounds; s += 2) {
            Real re[2], im[2];
            const bool two = s + 1 < sounds;
            (two ? hear<2, Store, Real> : hear<1, Store, Real>)(matrix + 2 * stored<Store> * blocks * i, blocks,
                                                                v.data.data() + 2 * s * v.length, v.length, re, im);
            out[s * m + i] = {re[0], im[0]};
            if (two) out[(s + 1) * m + i] = {re[1], im[1]};
        }
}

template <class Store, class Real>
void transposed_product(const Store *matrix, std::int64_t m, const Sounds<Real> &v, std::int64_t sounds,
                        std::complex<Real> *out) {
    const std::int64_t blocks = blocks_of(m), length = v.length, groups = (m + rows_at_once - 1) / rows_at_once;
    std::vector<Real> total(2 * sounds * length);
#pragma omp parallel
    {
        std::vector<Real> part(2 * sounds * length);
#pragma omp for schedule(static)
        for (std::int64_t group = 0; group < groups; group++) {
            const std::int64_t i = group * rows_at_once, rows = std::min<std::int64_t>(rows_at_once, m - i);
            for (std::int64_t b = 0; b < blocks; b++)
                for (std::int64_t s = 0; s < sounds; s += 2)
                    (s + 1 < sounds ? speak<2, Store, Real> : speak<1, Store, Real>)(
                        matrix + 2 * stored<Store> * blocks * i, blocks, b, rows, v.data.data() + 2 * s * length + i,
                        part.data() + 2 * s * length + lanes * b, length);
        }
#pragma omp critical
        for (std::size_t j = 0; j < part.size(); j++) total[j] += part[j];
    }
    for (std::int64_t s = 0; s < sounds; s++)
        for (std::int64_t j = 0; j < m; j++)
            out[s * m + j] = {total[2 * s * length + j], total[(2 * s + 1) * length + j]};
}

}  // namespace

template <class Store>
void dual_matrix(const double *points, const double *shifted, const double *normals, std::int64_t m, Wavenumber k,
                 NearRows near, NearRows near_shifted, Store *matrix) {
    (k.imag > 0 ? fill<Store, true> : fill<Store, false>)(points, shifted, normals, m, k, near, near_shifted, matrix);
}

template <class Store>
void dual_product(const Store *matrix, std::int64_t m,
                  const std::complex<typename Arithmetic<Store>::Real> *v, std::int64_t sounds, bool transposed,
                  std::complex<typename Arithmetic<Store>::Real> *out) {
    const Sounds<typename Arithmetic<Store>::Real> planes(v, sounds, m);
    if (transposed)
        transposed_product(matrix, m, planes, sounds, out);
    else
        plain_product(matrix, m, planes, sounds, out);
}

#define AIRTACT_DUAL(Store)                                                                                           \
    template void dual_matrix<Store>(const double *, const double *, const double *, std::int64_t, Wavenumber,        \
                                     NearRows, NearRows, Store *);                                                    \
    template void dual_product<Store>(const Store *, std::int64_t, const std::complex<Arithmetic<Store>::Real> *,     \
                                      std::int64_t, bool, std::complex<Arithmetic<Store>::Real> *);
AIRTACT_DUAL(std::uint32_t)
AIRTACT_DUAL(float)
AIRTACT_DUAL(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
