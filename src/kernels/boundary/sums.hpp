// Sums that the compiler may take in any order: they stand apart from loops whose rounding depends on it.
#pragma once
#include <complex>
#include <cstdint>

namespace airtact {
namespace AIRTACT_VARIANT {

constexpr std::int64_t together = 4;  // rows at once: it hides the latency of the sums and reads the density once

// out[i * step] += sum_l row_i[l] (a + i b)[l] for i < some <= 4; row i begins at re + i * stride and im + i * stride, and all four
// are read
template <class Real>
void add_products(const Real *re, const Real *im, std::int64_t stride, const Real *a, const Real *b, std::int64_t count,
                  std::int64_t some, std::complex<double> *out, std::int64_t step);

// The same of one row
template <class Real>
void add_product(const Real *re, const Real *im, const Real *a, const Real *b, std::int64_t count, std::complex<double> &out);

// out[i] = sum_l weights[l] row_i[l] of some rows of `count` numbers, one after another
template <class Real>
void sum_products(const Real *weights, const Real *rows, std::int64_t count, std::int64_t some, Real *out);

// Adds the sums of n complex numbers times 1, u, v, u², uv and v²
template <class Real>
void add_moments(const Real *u, const Real *v, const Real *re, const Real *im, std::int64_t n, double *out_re, double *out_im);

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
