// Integrals over a curved panel of a kernel whose target is near or on it: the panel is cut at the point closest to the
// target, and both the angle and the radius are stretched by a sinh so that few Gauss points do (Johnston & Elliott,
// Int. J. Numer. Meth. Engng 62 (2005) 564, "A sinh transformation for evaluating nearly singular boundary element
// integrals"; the cut is Duffy's, SIAM J. Numer. Anal. 19 (1982) 1260).
#include "rows.hpp"

#include "patch.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr int most_points = 512;

struct GaussRule {
    const double *nodes, *weights;
    int n;
    GaussRule(const NearRule &rule, int points) {
        n = std::max(1, std::min<int>(points, int(rule.largest)));
        nodes = rule.nodes + (n * (n - 1)) / 2;
        weights = rule.weights + (n * (n - 1)) / 2;
    }
};

struct Moments {
    double re[6] = {0, 0, 0, 0, 0, 0}, im[6] = {0, 0, 0, 0, 0, 0};
};

// Points on rays from the closest point: how far along their ray, before the stretching is undone; ray; stretched by asinh of
// what; weight of all but the radius and the area element
template <class Real> struct Points {
    Real along[most_points], ray_u[most_points], ray_v[most_points], scale[most_points], weight[most_points];
    int n = 0;
};

// Adds kernel * monomials at the collected points, and forgets them
template <bool SingleLayer, class Real>
void add_points(const Patch &patch, const double *reference, bool stretched, Points<Real> &points, Wave<Real> k,
                Moments &sum) {
    Real us[most_points], vs[most_points], re[most_points], im[most_points], c[6][3];
    for (int m = 0; m < 6; m++)
        for (int d = 0; d < 3; d++) c[m][d] = Real(patch.c[m][d]);
    int n = points.n;
    for (; n % 16; n++) {  // whole vectors: what is left over is slow
        points.along[n] = points.scale[n] = Real(0.5);
        points.ray_u[n] = points.ray_v[n] = points.weight[n] = 0;
    }
    const Real at_u = Real(reference[0]), at_v = Real(reference[1]);
    Real *const along = points.along, *const weights = points.weight;
    const Real *const scales = points.scale, *const ray_u = points.ray_u, *const ray_v = points.ray_v;
    if (stretched) {
#pragma omp simd
        for (int i = 0; i < n; i++) {
            const Real shrunk = decay(along[i]), grown = 1 / shrunk, half = Real(0.5) * scales[i];
            along[i] = half * (grown - shrunk);
            weights[i] *= half * (grown + shrunk);
        }
    }
#pragma omp simd
    for (int i = 0; i < n; i++) {
        const Real rho = along[i], x = at_u + rho * ray_u[i], y = at_v + rho * ray_v[i];
        us[i] = x;
        vs[i] = y;
        const Real r0 = c[0][0] + x * (c[1][0] + x * c[3][0] + y * c[4][0]) + y * (c[2][0] + y * c[5][0]);
        const Real r1 = c[0][1] + x * (c[1][1] + x * c[3][1] + y * c[4][1]) + y * (c[2][1] + y * c[5][1]);
        const Real r2 = c[0][2] + x * (c[1][2] + x * c[3][2] + y * c[4][2]) + y * (c[2][2] + y * c[5][2]);
        const Real a0 = c[1][0] + 2 * x * c[3][0] + y * c[4][0], b0 = c[2][0] + x * c[4][0] + 2 * y * c[5][0];
        const Real a1 = c[1][1] + 2 * x * c[3][1] + y * c[4][1], b1 = c[2][1] + x * c[4][1] + 2 * y * c[5][1];
        const Real a2 = c[1][2] + 2 * x * c[3][2] + y * c[4][2], b2 = c[2][2] + x * c[4][2] + 2 * y * c[5][2];
        const Real n0 = a1 * b2 - a2 * b1, n1 = a2 * b0 - a0 * b2, n2 = a0 * b1 - a1 * b0;
        const Real squared = r0 * r0 + r1 * r1 + r2 * r2;
        const Real inverse = squared > 0 ? Real(1) / std::sqrt(squared) : Real(0), distance = squared * inverse;
        const Real weight = weights[i] * rho;
        const Real loss = decay(k.imag * distance) * inverse * weight * Real(1 / (4 * pi));
        Real sine, cosine;
        sincospi(k.half_waves * distance, sine, cosine);
        if (SingleLayer) {
            const Real g = loss * std::sqrt(n0 * n0 + n1 * n1 + n2 * n2);
            re[i] = g * cosine;
            im[i] = g * sine;
        } else {
            const Real g = loss * inverse * inverse * (r0 * n0 + r1 * n1 + r2 * n2);
            const Real kr = k.real * distance, one = 1 + k.imag * distance;
            re[i] = -g * (one * cosine + kr * sine);
            im[i] = g * (kr * cosine - one * sine);
        }
    }
    Real m0 = 0, m1 = 0, m2 = 0, m3 = 0, m4 = 0, m5 = 0, l0 = 0, l1 = 0, l2 = 0, l3 = 0, l4 = 0, l5 = 0;
#pragma omp simd reduction(+ : m0, m1, m2, m3, m4, m5, l0, l1, l2, l3, l4, l5)
    for (int i = 0; i < n; i++) {
        const Real x = us[i], y = vs[i], a = re[i], b = im[i];
        m0 += a, m1 += a * x, m2 += a * y, m3 += a * x * x, m4 += a * x * y, m5 += a * y * y;
        l0 += b, l1 += b * x, l2 += b * y, l3 += b * x * x, l4 += b * x * y, l5 += b * y * y;
    }
    const Real real[6] = {m0, m1, m2, m3, m4, m5}, imag[6] = {l0, l1, l2, l3, l4, l5};
    for (int m = 0; m < 6; m++) sum.re[m] += real[m], sum.im[m] += imag[m];
    points.n = 0;
}

// asinh, no more exact than its use here needs
template <class Real> Real inverse_sinh(Real x) {
    const Real size = std::abs(x), value = logarithm(size + std::sqrt(size * size + 1));
    const Real exact = size < Real(1e-3) ? size * (1 - size * size / 6) : value;
    return x < 0 ? -exact : exact;
}

// Rays from the closest point to the edges, before and after the stretching of their angle
template <class Real> struct Rays {
    static constexpr int most = 128;  // three rules of at most 40 points, in whole vectors
    Real t[most], weight[most], centre[most], wide[most], length2[most], high2[most], along_u[most], along_v[most];
    Real u[most], v[most], scale[most], stretch[most];
    int n = 0;
};

// Those of one of the three triangles between the closest point and an edge
template <class Real>
void add_triangle(const double *reference, double distance, const double *a, const double *b, int edge, const NearRule &rule,
                  Rays<Real> &rays) {
    const double from[2] = {corner[edge][0] - reference[0], corner[edge][1] - reference[1]};
    const double along[2] = {corner[edge + 1][0] - corner[edge][0], corner[edge + 1][1] - corner[edge][1]};
    const double jacobian = from[0] * along[1] - from[1] * along[0];
    if (jacobian < 1e-10) return;  // the closest point is on this edge
    double start[3], run[3];
    for (int d = 0; d < 3; d++) {
        start[d] = a[d] * from[0] + b[d] * from[1];
        run[d] = a[d] * along[0] + b[d] * along[1];
    }
    const double length2 = dot(run, run), middle = -dot(start, run) / length2;
    const double cross[3] = {start[1] * run[2] - start[2] * run[1], start[2] * run[0] - start[0] * run[2],
                             start[0] * run[1] - start[1] * run[0]};
    const double height2 = dot(cross, cross) / length2;  // no difference of squares: it may be tiny
    const double width = std::sqrt((height2 + distance * distance) / length2);
    const Real t0 = inverse_sinh(Real(-middle / width)), t1 = inverse_sinh(Real((1 - middle) / width));
    const GaussRule angular(rule, int(Real(rule.angular) * (1 + (t1 - t0) / 6)));
    const Real centre = Real(middle), wide = Real(width), area = (t1 - t0) * Real(width * jacobian);
    for (int i = 0; i < angular.n; i++, rays.n++) {
        rays.t[rays.n] = t0 + Real(angular.nodes[i]) * (t1 - t0);
        rays.weight[rays.n] = Real(angular.weights[i]) * area;
        rays.centre[rays.n] = centre, rays.wide[rays.n] = wide;
        rays.length2[rays.n] = Real(length2), rays.high2[rays.n] = Real(height2);
        rays.u[rays.n] = Real(from[0]), rays.v[rays.n] = Real(from[1]);
        rays.along_u[rays.n] = Real(along[0]), rays.along_v[rays.n] = Real(along[1]);
    }
}

template <bool Stretched, class Real> void stretch(Rays<Real> &rays, Real distance) {
    constexpr int vector = 16;  // whole ones: what is left over is slow
    for (int n = rays.n; n % vector; n++) {
        rays.t[n] = rays.weight[n] = rays.centre[n] = rays.u[n] = rays.v[n] = rays.along_u[n] = rays.along_v[n] = 0;
        rays.wide[n] = rays.length2[n] = rays.high2[n] = 1;
    }
    const int n = (rays.n + vector - 1) / vector * vector;
    const Real *const t = rays.t, *const wide = rays.wide, *const centre = rays.centre, *const length2 = rays.length2;
    const Real *const high2 = rays.high2, *const along_u = rays.along_u, *const along_v = rays.along_v;
    Real *const u = rays.u, *const v = rays.v, *const weight = rays.weight;
    Real *const scales = rays.scale, *const stretches = rays.stretch;
#pragma omp simd
    for (int i = 0; i < n; i++) {
        const Real shrunk = decay(std::abs(t[i])), grown = 1 / shrunk, half = Real(0.5) * wide[i];
        const Real off = std::copysign(half * (grown - shrunk), t[i]), h = centre[i] + off;
        weight[i] *= Real(0.5) * (grown + shrunk);
        u[i] += h * along_u[i], v[i] += h * along_v[i];
        if (!Stretched) continue;
        const Real inverse = std::sqrt(high2[i] + off * off * length2[i]) / distance;
        const Real by = logarithm(inverse + std::sqrt(inverse * inverse + 1));  // its asinh, of 1 or more
        weight[i] *= by, scales[i] = 1 / inverse, stretches[i] = by;
    }
    if (!Stretched) std::fill(scales, scales + n, Real(1)), std::fill(stretches, stretches + n, Real(1));
}

template <bool SingleLayer, class Real>
Moments one_pair(const double *quadratic_triangles, const double *target, double contact, Wavenumber wavenumber,
                 const NearRule &rule, double *distance, double *reference) {
    Patch patch(quadratic_triangles, target);
    *distance = std::sqrt(closest_point(patch, reference));
    double x[3], a[3], b[3], height = *distance;
    patch.at(reference[0], reference[1], x, a, b);
    if (height < contact) {  // the target counts as on the panel: the principal value at its closest point
        for (int d = 0; d < 3; d++) patch.c[0][d] -= x[d];
        height = 0;
    }
    const double size = std::sqrt(std::max(dot(a, a), dot(b, b)));
    const bool stretched = height > 1e-9 * size;
    const Wave<Real> k(wavenumber);
    Moments sum;
    Points<Real> points;
    Rays<Real> rays;
    for (int edge = 0; edge < 3; edge++) add_triangle(reference, height, a, b, edge, rule, rays);
    (stretched ? stretch<true, Real> : stretch<false, Real>)(rays, Real(height));
    for (int i = 0; i < rays.n; i++) {
        const GaussRule radial(rule, int(Real(rule.radial) * (stretched ? 1 + Real(0.5) * rays.stretch[i] : Real(1))));
        if (points.n + radial.n > most_points) add_points<SingleLayer>(patch, reference, stretched, points, k, sum);
        for (int l = 0; l < radial.n; l++, points.n++) {
            points.along[points.n] = Real(radial.nodes[l]) * rays.stretch[i];
            points.ray_u[points.n] = rays.u[i], points.ray_v[points.n] = rays.v[i];
            points.scale[points.n] = rays.scale[i];
            points.weight[points.n] = rays.weight[i] * Real(radial.weights[l]);
        }
    }
    add_points<SingleLayer>(patch, reference, stretched, points, k, sum);
    return sum;
}

}  // namespace

void near_integrals(bool single_layer, const double *targets, const std::int64_t *pair_target,
                    const std::int64_t *pair_panel, std::int64_t pairs, const double *quadratic_triangles,
                    const double *contact, Wavenumber k, NearRule rule,
                    std::complex<double> *out, double *distance, double *reference) {
#pragma omp parallel for schedule(dynamic, 64) if (pairs > 64)
    for (std::int64_t e = 0; e < pairs; e++) {
        const auto one = single_layer ? one_pair<true, double> : one_pair<false, double>;
        const Moments sum = one(quadratic_triangles + 18 * pair_panel[e], targets + 3 * pair_target[e], contact[pair_panel[e]], k,
                                rule, distance + e, reference + 2 * e);
        for (int m = 0; m < 6; m++) out[6 * e + m] = {sum.re[m], sum.im[m]};
    }
}

template <class Real>
void near_excess(const double *targets, std::int64_t n, const std::int64_t *first, const std::int64_t *pair_panel,
                 const double *quadratic_triangles, const double *contact, const double *sources, const double *normals,
                 const double *nodal, Wavenumber k, double least, NearRule rule, std::complex<double> *out) {
    const Wave<Real> wave(k);
    const Real nearest = Real(least * least);
#pragma omp parallel for schedule(dynamic, 16) if (n > 16)
    for (std::int64_t i = 0; i < n; i++)
        for (std::int64_t e = first[i]; e < first[i + 1]; e++) {
            const std::int64_t panel = pair_panel[e];
            double distance, reference[2];
            const Moments sum = one_pair<false, Real>(quadratic_triangles + 18 * panel, targets + 3 * i, contact[panel], k, rule,
                                                      &distance, reference);
            Real re[8], im[8], d[6][8] = {};
            for (int l = 0; l < 6; l++)
                for (int axis = 0; axis < 3; axis++) {
                    const std::int64_t at = 3 * (6 * panel + l) + axis;
                    d[axis][l] = Real(sources[at] - targets[3 * i + axis]);
                    d[3 + axis][l] = Real(normals[at]);
                }
#pragma omp simd
            for (int l = 0; l < 8; l++)
                double_layer<Real, true>(d[0][l], d[1][l], d[2][l], d[3][l], d[4][l], d[5][l], wave, nearest, re[l],
                                         im[l]);
            for (int l = 0; l < 6; l++) {
                double kept_re = -double(re[l]), kept_im = -double(im[l]);
                for (int m = 0; m < 6; m++) {
                    kept_re += sum.re[m] * nodal[6 * m + l];
                    kept_im += sum.im[m] * nodal[6 * m + l];
                }
                out[6 * e + l] = {kept_re, kept_im};
            }
        }
}

#define AIRTACT_NEAR(Real)                                                                                            \
    template void near_excess<Real>(const double *, std::int64_t, const std::int64_t *, const std::int64_t *,         \
                                    const double *, const double *, const double *, const double *, const double *,   \
                                    Wavenumber, double, NearRule, std::complex<double> *);
AIRTACT_NEAR(float)
AIRTACT_NEAR(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
