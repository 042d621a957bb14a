// Integrals over a curved panel of a kernel whose target is near or on it: the panel is cut at the point closest to the
// target, and both the angle and the radius are stretched by a sinh so that few Gauss points do (Johnston & Elliott,
// Int. J. Numer. Meth. Engng 62 (2005) 564, "A sinh transformation for evaluating nearly singular boundary element
// integrals"; the cut is Duffy's, SIAM J. Numer. Anal. 19 (1982) 1260).
#include <algorithm>
#include <cmath>
#include <type_traits>

#include "kernels.hpp"

#include "arithmetic.hpp"
#include "patch.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr double pi = 3.14159265358979323846;
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

struct Points {  // reference points with weights that hold everything but the area element
    double u[most_points], v[most_points], w[most_points];
    int n = 0;
};

// Adds kernel * monomials at the collected points, and forgets them
template <bool SingleLayer>
void add_points(const Patch &patch, Points &points, Wavenumber k, Moments &sum) {
    double re[most_points], im[most_points];
    const double *u = points.u, *v = points.v, *w = points.w;
    const int n = points.n;
    const auto &c = patch.c;
    const double half_waves = k.real / pi;
#pragma omp simd
    for (int i = 0; i < n; i++) {
        const double x = u[i], y = v[i];
        const double r0 = c[0][0] + x * (c[1][0] + x * c[3][0] + y * c[4][0]) + y * (c[2][0] + y * c[5][0]);
        const double r1 = c[0][1] + x * (c[1][1] + x * c[3][1] + y * c[4][1]) + y * (c[2][1] + y * c[5][1]);
        const double r2 = c[0][2] + x * (c[1][2] + x * c[3][2] + y * c[4][2]) + y * (c[2][2] + y * c[5][2]);
        const double a0 = c[1][0] + 2 * x * c[3][0] + y * c[4][0], b0 = c[2][0] + x * c[4][0] + 2 * y * c[5][0];
        const double a1 = c[1][1] + 2 * x * c[3][1] + y * c[4][1], b1 = c[2][1] + x * c[4][1] + 2 * y * c[5][1];
        const double a2 = c[1][2] + 2 * x * c[3][2] + y * c[4][2], b2 = c[2][2] + x * c[4][2] + 2 * y * c[5][2];
        const double n0 = a1 * b2 - a2 * b1, n1 = a2 * b0 - a0 * b2, n2 = a0 * b1 - a1 * b0;
        const double squared = r0 * r0 + r1 * r1 + r2 * r2;
        const double inverse = squared > 0 ? 1 / std::sqrt(squared) : 0.0, distance = squared * inverse;
        const double loss = decay(k.imag * distance) * inverse * w[i] * (1 / (4 * pi));
        double s, cosine;
        sincospi(half_waves * distance, s, cosine);
        if (SingleLayer) {
            const double g = loss * std::sqrt(n0 * n0 + n1 * n1 + n2 * n2);
            re[i] = g * cosine;
            im[i] = g * s;
        } else {
            const double g = loss * inverse * inverse * (r0 * n0 + r1 * n1 + r2 * n2);
            const double kr = k.real * distance, one = 1 + k.imag * distance;
            re[i] = -g * (one * cosine + kr * s);
            im[i] = g * (kr * cosine - one * s);
        }
    }
    double m0 = 0, m1 = 0, m2 = 0, m3 = 0, m4 = 0, m5 = 0, l0 = 0, l1 = 0, l2 = 0, l3 = 0, l4 = 0, l5 = 0;
#pragma omp simd reduction(+ : m0, m1, m2, m3, m4, m5, l0, l1, l2, l3, l4, l5)
    for (int i = 0; i < n; i++) {
        const double x = u[i], y = v[i], a = re[i], b = im[i];
        m0 += a, m1 += a * x, m2 += a * y, m3 += a * x * x, m4 += a * x * y, m5 += a * y * y;
        l0 += b, l1 += b * x, l2 += b * y, l3 += b * x * x, l4 += b * x * y, l5 += b * y * y;
    }
    const double real[6] = {m0, m1, m2, m3, m4, m5}, imag[6] = {l0, l1, l2, l3, l4, l5};
    for (int m = 0; m < 6; m++) sum.re[m] += real[m], sum.im[m] += imag[m];
    points.n = 0;
}

// One of the three triangles between the foot and an edge
template <bool SingleLayer>
void add_triangle(const Patch &patch, const double *foot, double distance, const double *a, const double *b, int edge,
                  Wavenumber k, const NearRule &rule, Points &points, Moments &sum) {
    const double from[2] = {corner[edge][0] - foot[0], corner[edge][1] - foot[1]};
    const double along[2] = {corner[edge + 1][0] - corner[edge][0], corner[edge + 1][1] - corner[edge][1]};
    const double jacobian = from[0] * along[1] - from[1] * along[0];
    if (jacobian < 1e-10) return;  // the foot stands on this edge
    double start[3], run[3];
    for (int d = 0; d < 3; d++) {
        start[d] = a[d] * from[0] + b[d] * from[1];
        run[d] = a[d] * along[0] + b[d] * along[1];
    }
    const double length = std::sqrt(dot(run, run)), middle = -dot(start, run) / (length * length);
    const double cross[3] = {start[1] * run[2] - start[2] * run[1], start[2] * run[0] - start[0] * run[2],
                             start[0] * run[1] - start[1] * run[0]};
    const double height2 = dot(cross, cross) / (length * length);  // no difference of squares: it may be tiny
    const double width = std::sqrt(height2 + distance * distance) / length;
    const double t0 = std::asinh(-middle / width), t1 = std::asinh((1 - middle) / width);
    const GaussRule angular(rule, int(rule.angular) + int((t1 - t0) / 1.5));
    for (int i = 0; i < angular.n; i++) {
        const double t = t0 + angular.nodes[i] * (t1 - t0), h = middle + width * std::sinh(t);
        const double angular_weight = angular.weights[i] * (t1 - t0) * width * std::cosh(t) * jacobian;
        const double ray[2] = {from[0] + h * along[0], from[1] + h * along[1]};
        const double reach = std::sqrt(height2 + (h - middle) * (h - middle) * length * length);
        const bool stretched = distance > 1e-9 * reach;
        const double scale = stretched ? distance / reach : 1.0, stretch = stretched ? std::asinh(1 / scale) : 1.0;
        const GaussRule radial(rule, int(rule.radial) + (stretched ? int(2 * stretch) : 0));
        if (points.n + radial.n > most_points) add_points<SingleLayer>(patch, points, k, sum);
        for (int l = 0; l < radial.n; l++) {
            const double s = radial.nodes[l] * stretch, grown = stretched ? std::exp(s) : 0.0;
            const double rho = stretched ? scale * 0.5 * (grown - 1 / grown) : s;
            const double slope = stretched ? scale * 0.5 * (grown + 1 / grown) : 1.0;
            points.u[points.n] = foot[0] + rho * ray[0];
            points.v[points.n] = foot[1] + rho * ray[1];
            points.w[points.n++] = angular_weight * radial.weights[l] * stretch * slope * rho;
        }
    }
}

template <bool SingleLayer>
void one_pair(const double *six_nodes, const double *target, double contact, Wavenumber k, const NearRule &rule,
              std::complex<double> *out, double *distance, double *foot) {
    Patch patch(six_nodes, target);
    *distance = std::sqrt(closest_point(patch, foot));
    double x[3], a[3], b[3], height = *distance;
    patch.at(foot[0], foot[1], x, a, b);
    if (height < contact) {  // the target counts as on the panel: the principal value at its foot
        for (int d = 0; d < 3; d++) patch.c[0][d] -= x[d];
        height = 0;
    }
    Moments sum;
    Points points;
    for (int edge = 0; edge < 3; edge++)
        add_triangle<SingleLayer>(patch, foot, height, a, b, edge, k, rule, points, sum);
    add_points<SingleLayer>(patch, points, k, sum);
    for (int m = 0; m < 6; m++) out[m] = {sum.re[m], sum.im[m]};
}

}  // namespace

void near_integrals(bool single_layer, const double *targets, const std::int64_t *pair_target,
                    const std::int64_t *pair_panel, std::int64_t pairs, const double *six_nodes,
                    const double *contact, Wavenumber k, NearRule rule,
                    std::complex<double> *out, double *distance, double *foot) {
#pragma omp parallel for schedule(dynamic, 64)
    for (std::int64_t e = 0; e < pairs; e++) {
        const auto one = single_layer ? one_pair<true> : one_pair<false>;
        one(six_nodes + 18 * pair_panel[e], targets + 3 * pair_target[e], contact[pair_panel[e]], k, rule,
            out + 6 * e, distance + e, foot + 2 * e);
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
