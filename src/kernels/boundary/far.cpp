// Every point against every node: one row of the kernel at a time, then stored or summed.
#include "arithmetic.hpp"
#include "rows.hpp"
#include "sums.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr std::int64_t block = 256;
static_assert(block % whole_lines<float>(1) == 0, "blocks are whole cache lines");

template <class Real, class Row>
void sum_rows(std::int64_t n, std::int64_t m, const std::complex<double> *density, std::int64_t sounds,
              std::complex<double> *out, const Row &row) {
    const std::int64_t padded = whole_lines<Real>(m);
    std::vector<Strengths<Real>> densities;
    for (std::int64_t s = 0; s < sounds; s++) densities.emplace_back(density + s, m, sounds);
    over_rows((n + together - 1) / together, together * m, [&](std::int64_t group) {
        alignas(cache_line) Real re[together][block], im[together][block];
        const std::int64_t top = together * group, some = std::min(together, n - top);
        for (std::int64_t i = some; i < together; i++) std::fill(re[i], re[i] + block, Real(0)), std::fill(im[i], im[i] + block, Real(0));
        for (std::int64_t i = top; i < top + some; i++)
            for (std::int64_t s = 0; s < sounds; s++) out[i * sounds + s] = 0;
        for (std::int64_t j = 0; j < padded; j += block) {
            const std::int64_t count = std::min(block, padded - j);
            for (std::int64_t i = 0; i < some; i++) row(top + i, j, count, re[i], im[i]);
            for (std::int64_t s = 0; s < sounds; s++)
                add_products(re[0], im[0], block, densities[s].re.data() + j, densities[s].im.data() + j, count, some,
                             out + top * sounds + s, sounds);
        }
    });
}

constexpr std::int64_t few_sources = 16;  // up to which the receivers fill the registers: so few sources would not

// Adds up the field of a few sources, each at many of n receivers at once: row(j, begin, count, re, im) is that of source j.
// Of a transposed layer the nodes are the receivers and its targets the sources.
template <class Real, class Row>
void add_few(std::int64_t n, std::int64_t m, const std::complex<double> *strength, std::int64_t sounds,
             std::complex<double> *out, const Row &row) {
    over_rows((n + block - 1) / block, block * m, [&](std::int64_t part) {
        const std::int64_t top = part * block, count = std::min(block, n - top);
        alignas(cache_line) Real re[block], im[block];
        std::complex<double> *const sums = out + top * sounds;
        std::fill(sums, sums + count * sounds, 0.0);
        for (std::int64_t j = 0; j < m; j++) {
            row(j, top, whole_lines<Real>(count), re, im);
            for (std::int64_t s = 0; s < sounds; s++) {
                const double a = strength[j * sounds + s].real(), b = strength[j * sounds + s].imag();
                if (a == 0 && b == 0) continue;  // most of those of beacons
                for (std::int64_t l = 0; l < count; l++)
                    sums[l * sounds + s] += std::complex<double>(a * re[l] - b * im[l], a * im[l] + b * re[l]);
            }
        }
    });
}

// Some of the sources, seen from a centre, each coordinate and each sound's strengths contiguous
template <class Real> struct Chosen {
    Lined<Real> place[3], normal[3], single[2], re, im;
    std::int64_t n = 0;
    Nodes<Real> nodes() const {
        return {{place[0].data(), place[1].data(), place[2].data()}, {normal[0].data(), normal[1].data(), normal[2].data()},
                {single[0].empty() ? nullptr : single[0].data(), single[1].empty() ? nullptr : single[1].data()}};
    }
    void choose(const double *sources, const double *normals, const std::complex<double> *mixed, std::int64_t m, const std::complex<double> *density,
                std::int64_t sounds, const double *centre, double reach, bool inside) {
        std::vector<std::int64_t> index;
        for (std::int64_t j = 0; j < m; j++) {
            const double *y = sources + 3 * j;
            const double d[3] = {y[0] - centre[0], y[1] - centre[1], y[2] - centre[2]};
            if ((d[0] * d[0] + d[1] * d[1] + d[2] * d[2] < reach * reach) == inside) index.push_back(j);
        }
        const std::size_t count = index.size();
        if (count) index.resize(whole_lines<Real>(count), index.back());  // the last one again, without strength
        n = std::int64_t(index.size());
        for (int d = 0; d < 3; d++) {
            place[d].resize(n);
            for (std::int64_t l = 0; l < n; l++) place[d][l] = Real(sources[3 * index[l] + d] - centre[d]);
            if (!normals) continue;
            normal[d].resize(n);
            for (std::int64_t l = 0; l < n; l++) normal[d][l] = Real(shared * normals[3 * index[l] + d]);
        }
        for (int part = 0; mixed && part < 2; part++) {
            single[part].resize(n);
            for (std::int64_t l = 0; l < n; l++)
                single[part][l] = Real(part ? mixed[index[l]].imag() : mixed[index[l]].real());
        }
        re.resize(n * sounds), im.resize(n * sounds);
        for (std::int64_t s = 0; s < sounds; s++)
            for (std::int64_t l = 0; l < n; l++) {
                const std::complex<double> strength = std::size_t(l) < count ? density[index[l] * sounds + s] : 0.0;
                re[s * n + l] = Real(strength.real()), im[s * n + l] = Real(strength.imag());
            }
    }
};

}  // namespace

void apply_in_cells(const double *targets, const std::int64_t *first, std::int64_t cells, const double *centres,
                    double reach, bool inside, const double *sources, const double *normals,
                    const std::complex<double> *single, std::int64_t m, const std::complex<double> *density, std::int64_t sounds, Wavenumber k, double least,
                    std::complex<double> *out) {
    using Real = float;  // with the cell's centre as origin it resolves near sources
    const Wave<Real> wave(k);
#pragma omp parallel
    {
        Chosen<Real> chosen;
#pragma omp for schedule(dynamic, 1)
        for (std::int64_t c = 0; c < cells; c++) {
            const double *centre = centres + 3 * c;
            chosen.choose(sources, normals, single, m, density, sounds, centre, reach, inside);
            const Nodes<Real> nodes = chosen.nodes();
            for (std::int64_t i = first[c]; i < first[c + 1]; i++) {
                const double *t = targets + 3 * i;
                const Real x[3] = {Real(t[0] - centre[0]), Real(t[1] - centre[1]), Real(t[2] - centre[2])};
                std::fill(out + i * sounds, out + (i + 1) * sounds, 0.0);
                for (std::int64_t j = 0; j < chosen.n; j += block) {
                    const std::int64_t count = std::min(block, chosen.n - j);
                    alignas(cache_line) Real re[block], im[block];
                    if (normals)
                        double_layer_row(x, nodes, j, count, wave, Real(least * least), re, im);
                    else
                        monopole_row(x, nodes.point, j, count, wave, re, im);
                    for (std::int64_t s = 0; s < sounds; s++)
                        add_product(re, im, chosen.re.data() + s * chosen.n + j, chosen.im.data() + s * chosen.n + j, count,
                                    out[i * sounds + s]);
                }
            }
        }
    }
}

template <class Real>
void double_layer_matrix(const double *targets, std::int64_t n, const double *sources, const double *normals,
                         const std::complex<double> *single, std::int64_t m, Wavenumber k, std::complex<Real> *out) {
    const Origin origin(sources, m);
    const Planes<Real> t(targets, n, origin.at);
    const Layer<Real> layer(sources, normals, single, m, origin.at);
    const Wave<Real> wave(k);
    over_rows(n, m, [&](std::int64_t i) {
        alignas(cache_line) Real re[block], im[block];
        const Real x[3] = {t[0][i], t[1][i], t[2][i]};
        for (std::int64_t j = 0; j < m; j += block) {
            const std::int64_t count = std::min(block, m - j);
            double_layer_row(x, layer.nodes, j, count, wave, Real(0), re, im);
            for (std::int64_t l = 0; l < count; l++) out[i * m + j + l] = {re[l], im[l]};
        }
    });
}

template <class Real>
void dual_matrix(const double *targets, const double *inside, std::int64_t n, const double *sources, const double *normals,
                 const std::complex<double> *single, std::int64_t m, Wavenumber k, std::complex<Real> *out) {
    const Origin origin(sources, m);
    const Planes<Real> t(targets, n, origin.at), t2(inside, n, origin.at);
    const Layer<Real> layer(sources, normals, single, m, origin.at);
    const Wave<Real> wave(k);
    over_rows(n, 2 * m, [&](std::int64_t i) {
        alignas(cache_line) Real re[block], im[block], re2[block], im2[block];
        const Real x[3] = {t[0][i], t[1][i], t[2][i]}, x2[3] = {t2[0][i], t2[1][i], t2[2][i]};
        for (std::int64_t j = 0; j < m; j += block) {
            const std::int64_t count = std::min(block, m - j);
            double_layer_row(x, layer.nodes, j, count, wave, Real(0), re, im);
            double_layer_row(x2, layer.nodes, j, count, wave, Real(0), re2, im2);
            for (std::int64_t l = 0; l < count; l++) out[i * m + j + l] = {-re[l] - im2[l], re2[l] - im[l]};
        }
    });
}

template <class Real>
void apply_double_layer(const double *targets, std::int64_t n, const double *sources, const double *normals,
                        const std::complex<double> *single, std::int64_t m, const std::complex<double> *density,
                        std::int64_t sounds, Wavenumber k, double least, std::complex<double> *out) {
    const Origin origin(sources, m);
    const Planes<Real> t(targets, n, origin.at);
    const Layer<Real> layer(sources, normals, single, m, origin.at);
    const Wave<Real> wave(k);
    sum_rows<Real>(n, m, density, sounds, out,
                   [&](std::int64_t i, std::int64_t j, std::int64_t count, Real *re, Real *im) {
                       const Real x[3] = {t[0][i], t[1][i], t[2][i]};
                       double_layer_row(x, layer.nodes, j, count, wave, Real(least * least), re, im);
                   });
}

template <class Real>
void apply_transposed(const double *targets, std::int64_t n, const double *sources, const double *normals,
                      const std::complex<double> *single, std::int64_t m, const std::complex<double> *strength,
                      std::int64_t sounds, Wavenumber k, std::complex<double> *out) {
    const Origin origin(sources, m);
    const Planes<Real> t(targets, n, origin.at);
    const Layer<Real> layer(sources, normals, single, m, origin.at);
    const Wave<Real> wave(k);
    if (n <= few_sources)
        return add_few<Real>(m, n, strength, sounds, out,
                             [&](std::int64_t i, std::int64_t j, std::int64_t count, Real *re, Real *im) {
                                 const Real x[3] = {t[0][i], t[1][i], t[2][i]};
                                 double_layer_row(x, layer.nodes, j, count, wave, Real(0), re, im);
                             });
    sum_rows<Real>(m, n, strength, sounds, out,
                   [&](std::int64_t j, std::int64_t i, std::int64_t count, Real *re, Real *im) {
                       double_layer_column(layer.nodes, j, t.at, i, count, wave, re, im);
                   });
}

template <class Real>
void apply_monopoles(const double *targets, std::int64_t n, const double *sources, std::int64_t m,
                     const std::complex<double> *strength, std::int64_t sounds, Wavenumber k,
                     std::complex<double> *out) {
    const Origin origin(sources, m);
    const Planes<Real> t(targets, n, origin.at), y(sources, m, origin.at);
    const Wave<Real> wave(k);
    const auto between = [&](const Planes<Real> &from, std::int64_t i, const Planes<Real> &to, std::int64_t j,
                             std::int64_t count, Real *re, Real *im) {
        const Real x[3] = {from[0][i], from[1][i], from[2][i]};
        monopole_row(x, to.at, j, count, wave, re, im);
    };
    if (m <= few_sources)
        return add_few<Real>(n, m, strength, sounds, out,
                             [&](std::int64_t j, std::int64_t i, std::int64_t count, Real *re, Real *im) {
                                 between(y, j, t, i, count, re, im);
                             });
    sum_rows<Real>(n, m, strength, sounds, out,
                   [&](std::int64_t i, std::int64_t j, std::int64_t count, Real *re, Real *im) {
                       between(t, i, y, j, count, re, im);
                   });
}

void detoured_waves(const double *centres, std::int64_t bones, const double *foci, std::int64_t count, const double *elements,
                    std::int64_t n, const double *straight, const std::complex<float> *waves, double k,
                    std::complex<float> *out) {
    const Origin origin(foci, count);
    const Planes<float> x(elements, n, origin.at), y(foci, count, origin.at), c(centres, bones * count, origin.at);
    const float half_waves = float(k / pi), *const ex = x[0], *const ey = x[1], *const ez = x[2];
    const auto distance = [=](float px, float py, float pz, std::int64_t e) {
        return std::sqrt((ex[e] - px) * (ex[e] - px) + (ey[e] - py) * (ey[e] - py) + (ez[e] - pz) * (ez[e] - pz));
    };
    std::vector<float> away(n), re(n), im(n);
    for (std::int64_t f = 0; f < count; f++) {
        const float fx = y[0][f], fy = y[1][f], fz = y[2][f];
#pragma omp simd
        for (std::int64_t e = 0; e < n; e++) {
            away[e] = distance(fx, fy, fz, e);
            re[e] = float(straight[f]), im[e] = 0;
        }
        for (std::int64_t h = 0; h < bones; h++) {
            const std::int64_t way = h * count + f;
            const float cx = c[0][way], cy = c[1][way], cz = c[2][way];
            const float begun = std::sqrt((cx - fx) * (cx - fx) + (cy - fy) * (cy - fy) + (cz - fz) * (cz - fz));
            const float *const wave = reinterpret_cast<const float *>(waves + way * n);
            float *const a = re.data(), *const b = im.data(), *const r = away.data();
#pragma omp simd
            for (std::int64_t e = 0; e < n; e++) {
                float sine, cosine;
                sincospi(half_waves * (begun + distance(cx, cy, cz, e) - r[e]), sine, cosine);
                a[e] += wave[2 * e] * cosine - wave[2 * e + 1] * sine;
                b[e] += wave[2 * e] * sine + wave[2 * e + 1] * cosine;
            }
        }
        for (std::int64_t e = 0; e < n; e++) out[f * n + e] = {re[e], im[e]};
    }
}

#define AIRTACT_FAR(Real)                                                                                             \
    template void double_layer_matrix<Real>(const double *, std::int64_t, const double *, const double *,             \
                                            const std::complex<double> *, std::int64_t, Wavenumber,                   \
                                            std::complex<Real> *);                                                    \
    template void apply_transposed<Real>(const double *, std::int64_t, const double *, const double *,                \
                                         const std::complex<double> *, std::int64_t, const std::complex<double> *,    \
                                         std::int64_t, Wavenumber, std::complex<double> *);                           \
    template void dual_matrix<Real>(const double *, const double *, std::int64_t, const double *, const double *,     \
                                    const std::complex<double> *, std::int64_t, Wavenumber, std::complex<Real> *);    \
    template void apply_double_layer<Real>(const double *, std::int64_t, const double *, const double *,              \
                                           const std::complex<double> *, std::int64_t, const std::complex<double> *,  \
                                           std::int64_t, Wavenumber, double, std::complex<double> *);                 \
    template void apply_monopoles<Real>(const double *, std::int64_t, const double *, std::int64_t,                   \
                                        const std::complex<double> *, std::int64_t, Wavenumber,                       \
                                        std::complex<double> *);
AIRTACT_FAR(float)
AIRTACT_FAR(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
