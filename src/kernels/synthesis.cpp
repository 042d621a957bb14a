// Weighted Gerchberg-Saxton for many sets of foci: each turn reads a set's rows of the matrix once, while they are in
// the cache.
#include <algorithm>
#include <cmath>
#include <vector>

#include "kernels.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr std::int64_t tile = 256;

struct Set {  // the foci of one set: rows of the matrix, what they ask, their sources and pressures
    std::vector<const float *> real, imag;
    std::vector<float> wanted, source_real, source_imag, pressure_real, pressure_imag, weight, best_real, best_imag;
    explicit Set(std::int64_t n)
        : real(n), imag(n), wanted(n), source_real(n), source_imag(n), pressure_real(n), pressure_imag(n), weight(n),
          best_real(n), best_imag(n) {}
};

inline float inverse_root(float square) { return square > 0.0f ? 1.0f / std::sqrt(square) : 0.0f; }

// re + i im += sum over G foci of conj(H[f, begin + j]) s[f]
template <int G>
inline void speak(const Set &set, std::size_t f, std::int64_t begin, std::int64_t n, float *re, float *im) {
    const float *hr[G], *hi[G];
    float sr[G], si[G];
    for (int g = 0; g < G; g++) {
        hr[g] = set.real[f + g] + begin, hi[g] = set.imag[f + g] + begin;
        sr[g] = set.source_real[f + g], si[g] = set.source_imag[f + g];
    }
#pragma omp simd
    for (std::int64_t j = 0; j < n; j++) {
        float r = re[j], i = im[j];
        for (int g = 0; g < G; g++) {
            r += hr[g][j] * sr[g] + hi[g][j] * si[g];
            i += hr[g][j] * si[g] - hi[g][j] * sr[g];
        }
        re[j] = r, im[j] = i;
    }
}

// p[f] += sum_j H[f, begin + j] d[j] for G foci
template <int G>
inline void hear(Set &set, std::size_t f, std::int64_t begin, std::int64_t n, const float *re, const float *im) {
    constexpr int lanes = 8;  // sums side by side: a compiler may not reorder one sum
    const float *hr[G], *hi[G];
    float pr[G][lanes] = {}, pi[G][lanes] = {};
    for (int g = 0; g < G; g++) hr[g] = set.real[f + g] + begin, hi[g] = set.imag[f + g] + begin;
    const auto add = [&](int g, int lane, std::int64_t j) {
        pr[g][lane] += hr[g][j] * re[j] - hi[g][j] * im[j];
        pi[g][lane] += hr[g][j] * im[j] + hi[g][j] * re[j];
    };
    std::int64_t j = 0;
    for (; j + lanes <= n; j += lanes)
        for (int g = 0; g < G; g++)
#pragma omp simd
            for (int lane = 0; lane < lanes; lane++) add(g, lane, j + lane);
    for (; j < n; j++)
        for (int g = 0; g < G; g++) add(g, 0, j);
    for (int g = 0; g < G; g++)
        for (int lane = 0; lane < lanes; lane++) {
            set.pressure_real[f + g] += pr[g][lane];
            set.pressure_imag[f + g] += pi[g][lane];
        }
}

// d[j] = phase(sum_f conj(H[f, begin + j]) s[f])
inline void back(const Set &set, std::int64_t begin, std::int64_t n, float *re, float *im) {
    for (std::int64_t j = 0; j < n; j++) re[j] = im[j] = 0.0f;
    std::size_t f = 0;
    for (; f + 4 <= set.real.size(); f += 4) speak<4>(set, f, begin, n, re, im);
    for (; f < set.real.size(); f++) speak<1>(set, f, begin, n, re, im);
#pragma omp simd
    for (std::int64_t j = 0; j < n; j++) {
        const float scale = inverse_root(re[j] * re[j] + im[j] * im[j]);
        re[j] *= scale;
        im[j] *= scale;
    }
}

inline void forth(Set &set, std::int64_t begin, std::int64_t n, const float *re, const float *im) {
    std::size_t f = 0;
    for (; f + 4 <= set.real.size(); f += 4) hear<4>(set, f, begin, n, re, im);
    for (; f < set.real.size(); f++) hear<1>(set, f, begin, n, re, im);
}

// Sources anew from the pressures; returns the worst share of what is asked.
inline float turn(Set &set, bool weighted) {
    const std::size_t n = set.wanted.size();
    float worst = INFINITY, mean = 0.0f;
    for (std::size_t f = 0; f < n; f++) {
        const float share = std::hypot(set.pressure_real[f], set.pressure_imag[f]) / set.wanted[f];
        worst = std::min(worst, share);
        mean += share / float(n);
    }
    float most = 0.0f;
    for (std::size_t f = 0; f < n; f++) {
        const float loud = std::hypot(set.pressure_real[f], set.pressure_imag[f]);
        if (weighted) set.weight[f] *= mean / std::max(loud / set.wanted[f], 1e-3f * mean);
        most = std::max(most, set.weight[f]);
    }
    for (std::size_t f = 0; f < n; f++) {
        set.weight[f] /= most;
        const float scale =
            set.weight[f] * inverse_root(set.pressure_real[f] * set.pressure_real[f] +
                                         set.pressure_imag[f] * set.pressure_imag[f]);
        set.source_real[f] = set.pressure_real[f] * scale;
        set.source_imag[f] = set.pressure_imag[f] * scale;
    }
    return worst;
}

}  // namespace

void gerchberg_saxton(const float *real, const float *imag, std::int64_t elements, const std::int64_t *rows,
                      const float *wanted, std::int64_t sets, std::int64_t foci, std::int64_t turns, bool weighted,
                      std::complex<float> *sources, float *worst, std::complex<float> *drives) {
#pragma omp parallel for schedule(static) if (sets > 8)
    for (std::int64_t s = 0; s < sets; s++) {
        std::int64_t asked = 0;
        for (std::int64_t f = 0; f < foci; f++) asked += wanted[s * foci + f] > 0.0f;
        Set set(asked);
        for (std::int64_t f = 0, g = 0; f < foci; f++) {
            if (!(wanted[s * foci + f] > 0.0f)) continue;
            set.real[g] = real + rows[s * foci + f] * elements;
            set.imag[g] = imag + rows[s * foci + f] * elements;
            set.wanted[g] = wanted[s * foci + f];
            set.source_real[g] = sources[s * foci + f].real();
            set.source_imag[g] = sources[s * foci + f].imag();
            set.weight[g] = std::abs(sources[s * foci + f]);
            g++;
        }
        float re[tile], im[tile];
        worst[s] = -1.0f;
        for (std::int64_t t = 0; t < turns; t++) {
            std::fill(set.pressure_real.begin(), set.pressure_real.end(), 0.0f);
            std::fill(set.pressure_imag.begin(), set.pressure_imag.end(), 0.0f);
            for (std::int64_t e = 0; e < elements; e += tile) {
                const std::int64_t n = std::min(tile, elements - e);
                back(set, e, n, re, im);
                forth(set, e, n, re, im);
            }
            const std::vector<float> before_real = set.source_real, before_imag = set.source_imag;
            const float reached = turn(set, weighted);
            if (weighted && !(reached > worst[s])) continue;
            worst[s] = reached;
            set.best_real = before_real;
            set.best_imag = before_imag;
        }
        set.source_real = set.best_real;
        set.source_imag = set.best_imag;
        for (std::int64_t e = 0; e < elements; e += tile) {
            const std::int64_t n = std::min(tile, elements - e);
            back(set, e, n, re, im);
            for (std::int64_t j = 0; j < n; j++) drives[s * elements + e + j] = {re[j], im[j]};
        }
        for (std::int64_t f = 0, g = 0; f < foci; f++) {
            if (!(wanted[s * foci + f] > 0.0f)) continue;
            sources[s * foci + f] = {set.best_real[g], set.best_imag[g]};
            g++;
        }
    }
}

void gerchberg_saxton_of_foci(const std::complex<double> *heard, const double *wanted, std::int64_t foci,
                              std::int64_t turns, std::complex<double> *pressure) {
    std::vector<double> real(foci), imag(foci);
    for (std::int64_t t = 0; t < turns; t++) {
        for (std::int64_t f = 0; f < foci; f++) {
            const double square = std::norm(pressure[f]), scale = square > 0.0 ? wanted[f] / std::sqrt(square) : 0.0;
            real[f] = pressure[f].real() * scale;
            imag[f] = pressure[f].imag() * scale;
        }
        for (std::int64_t f = 0; f < foci; f++) {
            const double *row = reinterpret_cast<const double *>(heard + f * foci);
            double pr = 0.0, pi = 0.0;
#pragma omp simd reduction(+ : pr, pi)
            for (std::int64_t g = 0; g < foci; g++) {
                pr += row[2 * g] * real[g] - row[2 * g + 1] * imag[g];
                pi += row[2 * g] * imag[g] + row[2 * g + 1] * real[g];
            }
            pressure[f] = {pr, pi};
        }
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
