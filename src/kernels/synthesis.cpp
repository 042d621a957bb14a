// Weighted Gerchberg-Saxton for many sets of foci: each turn reads a set's rows of the matrix once, while they are in
// the cache.
#include <algorithm>
#include <cmath>
#include <vector>

#include "kernels.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr std::int64_t chunk = 256;

struct Set {  // the foci of one set: rows of the matrix, what they ask, their sources and pressures
    std::vector<const float *> real, imag;
    std::vector<float> wanted, source_real, source_imag, pressure_real, pressure_imag, weight, step, best_real, best_imag;
    float damping = 1.0f;
    explicit Set(std::int64_t n)
        : real(n), imag(n), wanted(n), source_real(n), source_imag(n), pressure_real(n), pressure_imag(n), weight(n), step(n),
          best_real(n), best_imag(n) {}
};

inline float inverse_root(float square) { return square > 0.0f ? 1.0f / std::sqrt(square) : 0.0f; }

// re + i im += sum over G foci of conj(H[f, begin + j]) s[f]
template <int G>
inline void superpose(const Set &set, std::size_t f, std::int64_t begin, std::int64_t n, float *re, float *im) {
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

// p[g] += sum_j H[f + g, begin + j] d[j] for G foci
template <int G>
inline void evaluate(const Set &set, std::size_t f, std::int64_t begin, std::int64_t n, const float *re, const float *im,
                 float *pressure_real, float *pressure_imag) {
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
            pressure_real[g] += pr[g][lane];
            pressure_imag[g] += pi[g][lane];
        }
}

// The same for the first `count` foci
inline void forth(const Set &set, std::size_t count, std::int64_t begin, std::int64_t n, const float *re,
                  const float *im, float *pressure_real, float *pressure_imag) {
    std::size_t f = 0;
    for (; f + 4 <= count; f += 4) evaluate<4>(set, f, begin, n, re, im, pressure_real + f, pressure_imag + f);
    for (; f < count; f++) evaluate<1>(set, f, begin, n, re, im, pressure_real + f, pressure_imag + f);
}

// d[j] = phase(sum_f conj(H[f, begin + j]) s[f])
inline void back(const Set &set, std::int64_t begin, std::int64_t n, float *re, float *im) {
    for (std::int64_t j = 0; j < n; j++) re[j] = im[j] = 0.0f;
    std::size_t f = 0;
    for (; f + 4 <= set.real.size(); f += 4) superpose<4>(set, f, begin, n, re, im);
    for (; f < set.real.size(); f++) superpose<1>(set, f, begin, n, re, im);
#pragma omp simd
    for (std::int64_t j = 0; j < n; j++) {
        const float scale = inverse_root(re[j] * re[j] + im[j] * im[j]);
        re[j] *= scale;
        im[j] *= scale;
    }
}

// Sources anew from the pressures; returns the worst ratio to the pressure asked for.
inline float turn(Set &set, bool weighted) {
    const std::size_t n = set.wanted.size();
    float worst = INFINITY, mean = 0.0f;
    for (std::size_t f = 0; f < n; f++) {
        const float share = std::hypot(set.pressure_real[f], set.pressure_imag[f]) / set.wanted[f];
        worst = std::min(worst, share);
        mean += share / float(n);
    }
    // Where steps undo each other, as between two foci with like rows, shorter ones settle.
    float undone = 0.0f, before = 0.0f, most = 0.0f;
    for (std::size_t f = 0; f < n && weighted; f++) {
        const float ratio = std::hypot(set.pressure_real[f], set.pressure_imag[f]) / set.wanted[f];
        const float step = std::log(mean / std::max(ratio, 1e-3f * mean));
        undone -= step * set.step[f];
        before += set.step[f] * set.step[f];
        set.step[f] = step;
    }
    if (undone > 0.5f * before) set.damping = std::max(0.05f, 0.7f * set.damping);
    for (std::size_t f = 0; f < n; f++) {
        if (weighted) set.weight[f] *= std::exp(set.damping * set.step[f]);
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

// Pressure at focus g for the conjugate row of focus f, H[g] . conj(H[f]), into row f of both planes; only for g up to f
inline void gram_rows(const Set &set, std::int64_t elements, std::vector<float> &real, std::vector<float> &imag) {
    const std::size_t count = set.real.size();
    float conjugate[chunk];
    for (std::int64_t e = 0; e < elements; e += chunk) {
        const std::int64_t n = std::min(chunk, elements - e);
        for (std::size_t f = 0; f < count; f++) {
            for (std::int64_t j = 0; j < n; j++) conjugate[j] = -set.imag[f][e + j];
            forth(set, f + 1, e, n, set.real[f] + e, conjugate, real.data() + f * count, imag.data() + f * count);
        }
    }
    for (std::size_t f = 0; f < count; f++)
        for (std::size_t g = 0; g < f; g++) {
            real[g * count + f] = real[f * count + g];
            imag[g * count + f] = -imag[f * count + g];
        }
}

// Gerchberg-Saxton between foci alone; at the end sources are w^2 / |p|
inline void iterate_on_foci(Set &set, std::int64_t elements, std::int64_t iterations) {
    const std::size_t n = set.real.size();
    std::vector<float> real(n * n), imag(n * n);
    gram_rows(set, elements, real, imag);
    float *sr = set.source_real.data(), *si = set.source_imag.data();
    float *pr = set.pressure_real.data(), *pi = set.pressure_imag.data();
    std::copy(sr, sr + n, pr), std::copy(si, si + n, pi);
    for (std::int64_t t = 0; t < iterations; t++) {
        for (std::size_t f = 0; f < n; f++) {
            const float scale = set.wanted[f] * inverse_root(pr[f] * pr[f] + pi[f] * pi[f]);
            sr[f] = pr[f] * scale, si[f] = pi[f] * scale;
            pr[f] = pi[f] = 0.0f;
        }
        for (std::size_t g = 0; g < n; g++) {  // row g holds the pressures of g at all
            const float *hr = real.data() + g * n, *hi = imag.data() + g * n;
#pragma omp simd
            for (std::size_t f = 0; f < n; f++) {
                pr[f] += hr[f] * sr[g] - hi[f] * si[g];
                pi[f] += hr[f] * si[g] + hi[f] * sr[g];
            }
        }
    }
    for (std::size_t f = 0; f < n; f++) {
        const float root = set.wanted[f] * inverse_root(pr[f] * pr[f] + pi[f] * pi[f]);
        sr[f] = pr[f] * root * root, si[f] = pi[f] * root * root;
    }
    float most = 0.0f;
    for (std::size_t f = 0; f < n; f++) most = std::max(most, set.weight[f] = std::hypot(sr[f], si[f]));
    for (std::size_t f = 0; f < n; f++) sr[f] /= most, si[f] /= most, set.weight[f] /= most;
}

}  // namespace

void gerchberg_saxton(const float *real, const float *imag, std::int64_t elements, const std::int64_t *rows,
                      const float *wanted, std::int64_t sets, std::int64_t foci, std::int64_t foci_iterations,
                      std::int64_t iterations, bool weighted,
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
        if (foci_iterations > 0) iterate_on_foci(set, elements, foci_iterations);
        float re[chunk], im[chunk];
        worst[s] = -1.0f;
        for (std::int64_t t = 0; t < iterations; t++) {
            std::fill(set.pressure_real.begin(), set.pressure_real.end(), 0.0f);
            std::fill(set.pressure_imag.begin(), set.pressure_imag.end(), 0.0f);
            for (std::int64_t e = 0; e < elements; e += chunk) {
                const std::int64_t n = std::min(chunk, elements - e);
                back(set, e, n, re, im);
                forth(set, set.real.size(), e, n, re, im, set.pressure_real.data(), set.pressure_imag.data());
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
        for (std::int64_t e = 0; e < elements; e += chunk) {
            const std::int64_t n = std::min(chunk, elements - e);
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

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
