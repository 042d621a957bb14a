// Number formats of a block in memory.
#pragma once
#include "arithmetic.hpp"
#include "rows.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr std::int64_t half = lanes / 2;
static_assert(lanes % whole_lines<float>(1) == 0, "rows of a block are whole cache lines");

// A row's two halves, each number as it is, or of two numbers the upper 16 bits each
template <class Real> void store(const Real *row, Real *out) { std::copy(row, row + lanes, out); }
inline void store(const float *row, std::uint32_t *out) {
    constexpr std::uint32_t rounded = 0x8000, upper = 0xffff0000;
#pragma omp simd
    for (std::int64_t l = 0; l < half; l++)
        out[l] = (bits<std::uint32_t>(row[l]) + rounded) >> 16 | ((bits<std::uint32_t>(row[half + l]) + rounded) & upper);
}

template <class Real> Real first(const Real *stored, std::int64_t l) { return stored[l]; }
template <class Real> Real second(const Real *stored, std::int64_t l) { return stored[half + l]; }
inline float first(const std::uint32_t *stored, std::int64_t l) { return bits<float>(stored[l] << 16); }
inline float second(const std::uint32_t *stored, std::int64_t l) { return bits<float>(stored[l] & 0xffff0000); }

template <class Store> constexpr std::int64_t stored = lanes;  // words of as many numbers
template <> constexpr std::int64_t stored<std::uint32_t> = half;

}  // namespace
}  // namespace AIRTACT_VARIANT
}  // namespace airtact
