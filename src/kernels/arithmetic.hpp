// Sine, cosine and decay of a phase, by polynomials that a compiler can vectorise: no call into libm.
#pragma once
#include <cmath>
#include <cstdint>
#include <cstring>
#include <type_traits>

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {  // one copy for each file, as each has options of its own, or the linker would keep one for all

template <class Real> struct Traits;
template <> struct Traits<float> {
    using Bits = std::int32_t;
    static constexpr float round_magic = 12582912.0f;  // 1.5 * 2^23: adding it rounds to an integer
    static constexpr int sign_shift = 31, mantissa = 23, terms = 7, logarithms = 5;
};
template <> struct Traits<double> {
    using Bits = std::int64_t;
    static constexpr double round_magic = 6755399441055744.0;  // 1.5 * 2^52
    static constexpr int sign_shift = 63, mantissa = 52, terms = 12, logarithms = 11;
};

template <class To, class From> inline To bits(From value) {
    To out;
    static_assert(sizeof(To) == sizeof(From), "same width");
    std::memcpy(&out, &value, sizeof(out));
    return out;
}

constexpr double taylor(double base, int n) {  // base^n / n!
    double value = 1.0;
    for (int i = 1; i <= n; i++) value *= base / i;
    return value;
}

template <class Real, bool Odd> struct Series {  // sin(pi u)/u or cos(pi u) in powers of u^2, by Taylor
    static constexpr int terms = Traits<Real>::terms;
    Real c[terms];
    constexpr Series() : c() {
        for (int i = 0; i < terms; i++)
            c[i] = Real((i % 2 ? -1.0 : 1.0) * taylor(3.14159265358979323846, 2 * i + (Odd ? 1 : 0)));
    }
};
template <> struct Series<float, true> {  // the polynomial with the least largest error, 2.4e-6, for |u| < 1/2
    static constexpr int terms = 4;
    float c[terms] = {3.14159028359f, -5.16740769781f, 2.54402081165f, -0.559489911442f};
};
template <> struct Series<float, false> {  // likewise, 6.8e-6
    static constexpr int terms = 4;
    float c[terms] = {0.999993296125f, -4.93393794509f, 4.0412829794f, -1.22212479406f};
};

// x with its sign changed if `flip` is that of -0.0
template <class Real> inline Real flipped(Real x, typename Traits<Real>::Bits flip) {
    using Bits = typename Traits<Real>::Bits;
    return bits<Real>(static_cast<Bits>(bits<Bits>(x) ^ flip));
}

// sin(pi t) and cos(pi t), |t| < 2^21, but `flipped` by what it returns
template <class Real> inline typename Traits<Real>::Bits flipped_sincospi(Real t, Real &sine, Real &cosine) {
    using T = Traits<Real>;
    static constexpr Series<Real, true> S{};
    static constexpr Series<Real, false> C{};
    const Real magic = t + T::round_magic;
    const typename T::Bits flip = static_cast<typename T::Bits>(
        static_cast<std::make_unsigned_t<typename T::Bits>>(bits<typename T::Bits>(magic)) << T::sign_shift);
    const Real u = t - (magic - T::round_magic), z = u * u;
    Real s = S.c[S.terms - 1], c = C.c[C.terms - 1];
    for (int i = S.terms - 2; i >= 0; i--) s = s * z + S.c[i];
    for (int i = C.terms - 2; i >= 0; i--) c = c * z + C.c[i];
    sine = s * u, cosine = c;
    return flip;
}

// sin(pi t) and cos(pi t), |t| < 2^21
template <class Real> inline void sincospi(Real t, Real &sine, Real &cosine) {
    Real s, c;
    const auto flip = flipped_sincospi(t, s, c);
    sine = flipped(s, flip), cosine = flipped(c, flip);
}

template <class Real> struct Exponential {  // e^f in powers of f, by Taylor
    Real c[Traits<Real>::terms + 1];
    constexpr Exponential() : c() {
        for (int i = 0; i <= Traits<Real>::terms; i++) c[i] = Real(taylor(1.0, i));
    }
};

// exp(-y), 0 <= y < 4e6; about e^-80 from 80 on
template <class Real> inline Real decay(Real y) {
    using T = Traits<Real>;
    constexpr typename T::Bits least = -115;  // exponent of two: 2^-115 is e^-79.7
    const Real x = y * Real(-1.44269504088896340736);
    const Real magic = x + T::round_magic;
    const Real f = (x - (magic - T::round_magic)) * Real(0.69314718055994530942);
    static constexpr Exponential<Real> E{};
    Real e = E.c[T::terms];
    for (int i = T::terms - 1; i >= 0; i--) e = e * f + E.c[i];
    const auto power = bits<typename T::Bits>(magic) - bits<typename T::Bits>(T::round_magic);
    const auto n = power < least ? least : power;
    return bits<Real>(static_cast<typename T::Bits>(bits<typename T::Bits>(e) + n * (typename T::Bits(1) << T::mantissa)));
}

// log(y), y > 0 and no subnormal number
template <class Real> inline Real logarithm(Real y) {
    using T = Traits<Real>;
    constexpr typename T::Bits ones = (typename T::Bits(1) << T::mantissa) - 1;
    const auto whole = bits<typename T::Bits>(y);
    const auto middle = whole + (typename T::Bits(1) << (T::mantissa - 1));  // its exponent is that of the nearer power
    const auto power = (middle & ~ones) - bits<typename T::Bits>(Real(1));
    const Real m = bits<Real>(static_cast<typename T::Bits>(whole - power));  // 3/4 to 3/2
    const Real s = (m - 1) / (m + 1), z = s * s;
    Real series = Real(1.0 / (2 * T::logarithms + 1));
    for (int i = T::logarithms - 1; i >= 0; i--) series = series * z + Real(1.0 / (2 * i + 1));
    return 2 * s * series + Real(power >> T::mantissa) * Real(0.69314718055994530942);
}

}  // namespace
}  // namespace AIRTACT_VARIANT
}  // namespace airtact
