// The matrix of the dual-surface equation: its rows, filled one at a time, and its products with a few vectors at once.
#include "rows.hpp"

#ifdef _OPENMP
#include <omp.h>
#endif

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

std::int64_t blocks_of(std::int64_t m) { return (m + lanes - 1) / lanes; }

// D(x, y) for all nodes y, with what the near panels add, in blocks of real and of imaginary parts
template <class Real, bool Lossy>
void layer_row(const Real *x, const Planes<Real> &y, const Planes<Real> &a, Wave<Real> k, const NearRows &near,
               std::int64_t i, Real *row) {
    for (std::int64_t j = 0; j < y.n; j += lanes) {
        const std::int64_t n = std::min(lanes, y.n - j);
        double_layer_row<Real, Lossy>(x, y[0] + j, y[1] + j, y[2] + j, a[0] + j, a[1] + j, a[2] + j, n, k, Real(0),
                                      row + 2 * j, row + 2 * j + lanes);
    }
    for (std::int64_t e = near.first[i]; e < near.first[i + 1]; e++)
        for (int l = 0; l < 6; l++) {
            const std::int64_t j = 6 * near.panel[e] + l, at = 2 * lanes * (j / lanes) + j % lanes;
            row[at] += Real(near.excess[6 * e + l].real());
            row[at + lanes] += Real(near.excess[6 * e + l].imag());
        }
}

void store(const float *row, std::int64_t blocks, std::int16_t *out, float *scales) {
    for (std::int64_t b = 0; b < blocks; b++, row += 2 * lanes, out += 2 * lanes) {
        float largest = 1e-30f;
#pragma omp simd reduction(max : largest)
        for (std::int64_t l = 0; l < 2 * lanes; l++) largest = std::max(largest, std::abs(row[l]));
        scales[b] = largest / 32767;
        const float finer = 32767 / largest;
#pragma omp simd
        for (std::int64_t l = 0; l < 2 * lanes; l++)
            out[l] = std::int16_t(std::int32_t(row[l] * finer + 32768.5f) - 32768);
    }
}

template <class Real> void store(const Real *row, std::int64_t blocks, Real *out, float *) {
    std::copy(row, row + 2 * lanes * blocks, out);
}

template <class Store, bool Lossy>
void fill(const double *points, const double *shifted, const double *normals, std::int64_t m, Wavenumber wavenumber,
          const NearRows &near, const NearRows &near_shifted, Store *matrix, float *scales) {
    using Real = typename Arithmetic<Store>::Real;
    const double zero[3] = {0, 0, 0};
    const Origin origin(points, m);
    const Planes<Real> x(points, m, origin.at), x2(shifted, m / sharing, origin.at), a(normals, m, zero);
    const Wave<Real> k(wavenumber);
    const std::int64_t blocks = blocks_of(m);
#pragma omp parallel
    {
        std::vector<Real> row(2 * lanes * blocks), inside(2 * lanes * blocks);
#pragma omp for schedule(static)
        for (std::int64_t group = 0; group < m / sharing; group++) {
            const Real t2[3] = {x2[0][group], x2[1][group], x2[2][group]};
            layer_row<Real, Lossy>(t2, x, a, k, near_shifted, group, inside.data());
            for (std::int64_t i = sharing * group; i < sharing * (group + 1); i++) {
                const Real t[3] = {x[0][i], x[1][i], x[2][i]};
                layer_row<Real, Lossy>(t, x, a, k, near, i, row.data());
                for (std::int64_t j = 0; j < 2 * lanes * blocks; j += 2 * lanes)
#pragma omp simd
                    for (std::int64_t l = j; l < j + lanes; l++) {  // i D(x') - D(x)
                        row[l] = -row[l] - inside[l + lanes];
                        row[l + lanes] = inside[l] - row[l + lanes];
                    }
                row[2 * lanes * (i / lanes) + i % lanes] += Real(0.5);
                store(row.data(), blocks, matrix + 2 * lanes * blocks * i, scales + blocks * i);
            }
        }
    }
}

template <class Store> float scale_of(const float *, std::int64_t) { return 1; }
template <> float scale_of<std::int16_t>(const float *scales, std::int64_t b) { return scales[b]; }

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
void hear(const Store *row, const float *scales, std::int64_t blocks, const Real *v, std::int64_t length, Real *re,
          Real *im) {
    for (int s = 0; s < N; s++) re[s] = im[s] = 0;
    for (std::int64_t b = 0; b < blocks; b++) {
        const Store *a_re = row + 2 * lanes * b, *a_im = a_re + lanes;
        const Real scale = scale_of<Store>(scales, b);
        const Real *v_re = v + lanes * b, *v_im = v_re + length, *w_re = v_re + (N > 1 ? 2 * length : 0), *w_im = w_re + length;
        Real rr = 0, ii = 0, ri = 0, ir = 0, r2 = 0, i2 = 0, x2 = 0, y2 = 0;  // one sum alone waits for itself
#pragma omp simd reduction(+ : rr, ii, ri, ir, r2, i2, x2, y2)
        for (std::int64_t l = 0; l < lanes; l++) {
            const Real x = Real(a_re[l]), y = Real(a_im[l]);
            rr += x * v_re[l], ii += y * v_im[l], ri += x * v_im[l], ir += y * v_re[l];
            if (N > 1) r2 += x * w_re[l], i2 += y * w_im[l], x2 += x * w_im[l], y2 += y * w_re[l];
        }
        re[0] += scale * (rr - ii);
        im[0] += scale * (ri + ir);
        if (N > 1) re[N - 1] += scale * (r2 - i2), im[N - 1] += scale * (x2 + y2);
    }
}

constexpr int rows_at_once = 4;

// Adds to N sounds, planes of `length`, what some rows say in them; both begin with these rows' and block's part
template <int N, class Store, class Real>
void speak(const Store *matrix, const float *scales, std::int64_t blocks, std::int64_t b, std::int64_t rows,
           const Real *said, Real *heard, std::int64_t length) {
    const std::int64_t stride = 2 * lanes * blocks;
    Real c[rows_at_once][2] = {}, d[rows_at_once][2] = {};
    const Store *row[rows_at_once];
    for (int r = 0; r < rows_at_once; r++) {
        row[r] = matrix + 2 * lanes * b + (r < rows ? r : 0) * stride;
        if (r >= rows) continue;
        const Real scale = scale_of<Store>(scales + r * blocks, b);
        for (int s = 0; s < N; s++) {
            c[r][s] = scale * said[2 * s * length + r];
            d[r][s] = scale * said[(2 * s + 1) * length + r];
        }
    }
    Real *const re = heard, *const im = re + length, *const re2 = re + (N > 1 ? 2 * length : 0), *const im2 = re2 + length;
#pragma omp simd
    for (std::int64_t l = 0; l < lanes; l++) {
        Real x = re[l], y = im[l], x2 = re2[l], y2 = im2[l];
        for (int r = 0; r < rows_at_once; r++) {
            const Real p = Real(row[r][l]), q = Real(row[r][lanes + l]);
            x += p * c[r][0] - q * d[r][0], y += p * d[r][0] + q * c[r][0];
            if (N > 1) x2 += p * c[r][1] - q * d[r][1], y2 += p * d[r][1] + q * c[r][1];
        }
        if (N > 1) re2[l] = x2, im2[l] = y2;
        re[l] = x, im[l] = y;
    }
}

template <class Store, class Real>
void plain_product(const Store *matrix, const float *scales, std::int64_t m, const Sounds<Real> &v, std::int64_t sounds,
                   std::complex<Real> *out) {
    const std::int64_t blocks = blocks_of(m);
#pragma omp parallel for schedule(static)
    for (std::int64_t i = 0; i < m; i++) {
        const Store *row = matrix + 2 * lanes * blocks * i;
        for (std::int64_t s = 0; s < sounds; s += 2) {
            Real re[2], im[2];
            const Real *some = v.data.data() + 2 * s * v.length;
            const bool two = s + 1 < sounds;
            (two ? hear<2, Store, Real> : hear<1, Store, Real>)(row, scales + blocks * i, blocks, some, v.length, re,
                                                                im);
            out[s * m + i] = {re[0], im[0]};
            if (two) out[(s + 1) * m + i] = {re[1], im[1]};
        }
    }
}

template <class Store, class Real>
void transposed_product(const Store *matrix, const float *scales, std::int64_t m, const Sounds<Real> &v,
                        std::int64_t sounds, std::complex<Real> *out) {
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
                        matrix + 2 * lanes * blocks * i, scales + blocks * i, blocks, b, rows,
                        v.data.data() + 2 * s * length + i, part.data() + 2 * s * length + lanes * b, length);
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
                 NearRows near, NearRows near_shifted, Store *matrix, float *scales) {
    (k.imag > 0 ? fill<Store, true> : fill<Store, false>)(points, shifted, normals, m, k, near, near_shifted, matrix,
                                                          scales);
}

template <class Store>
void dual_product(const Store *matrix, const float *scales, std::int64_t m,
                  const std::complex<typename Arithmetic<Store>::Real> *v, std::int64_t sounds, bool transposed,
                  std::complex<typename Arithmetic<Store>::Real> *out) {
    const Sounds<typename Arithmetic<Store>::Real> planes(v, sounds, m);
    if (transposed)
        transposed_product(matrix, scales, m, planes, sounds, out);
    else
        plain_product(matrix, scales, m, planes, sounds, out);
}

#define AIRTACT_DUAL(Store)                                                                                           \
    template void dual_matrix<Store>(const double *, const double *, const double *, std::int64_t, Wavenumber,        \
                                     NearRows, NearRows, Store *, float *);                                           \
    template void dual_product<Store>(const Store *, const float *, std::int64_t,                                     \
                                      const std::complex<Arithmetic<Store>::Real> *, std::int64_t, bool,              \
                                      std::complex<Arithmetic<Store>::Real> *);
AIRTACT_DUAL(std::int16_t)
AIRTACT_DUAL(float)
AIRTACT_DUAL(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
