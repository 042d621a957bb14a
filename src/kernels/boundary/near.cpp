// Integrals over a curved panel of a kernel whose target is near or on it: the panel is cut at the point closest to the
// target, and both the angle and the radius are stretched by a sinh so that few Gauss points do (Johnston & Elliott,
// Int. J. Numer. Meth. Engng 62 (2005) 564, "A sinh transformation for evaluating nearly singular boundary element
// integrals"; the cut is Duffy's, SIAM J. Numer. Anal. 19 (1982) 1260).
#include "arithmetic.hpp"
#include "rows.hpp"

#include "shapes/patch.hpp"
#include "sums.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

constexpr int most_points = 512;
constexpr int some = 16;         // pairs at once, which hides the latency of each step
constexpr double nothing = 1e-30;  // square of a distance of no meaning [m2]
constexpr int vector = 16;       // numbers of whole vectors: what is left over is slow

constexpr int largest_rule = 40;

constexpr int whole(int count) { return (count + vector - 1) / vector * vector; }

constexpr int at_once = 8;  // points of a rule, which most have fewer of: they are taken together, those of no meaning too

// Rules in the working precision, with room after the last one for points of no meaning
template <class Real> struct Rules {
    std::vector<Real> nodes, weights;
    int largest;
    Real angular, radial;
    explicit Rules(const NearRule &rule)
        : largest(std::min(int(rule.largest), largest_rule)), angular(Real(rule.angular)), radial(Real(rule.radial)) {
        const int all = largest * (largest + 1) / 2;
        nodes.assign(rule.nodes, rule.nodes + all), weights.assign(rule.weights, rule.weights + all);
        nodes.resize(all + at_once), weights.resize(all + at_once);
    }
};

template <class Real> struct GaussRule {
    const Real *nodes, *weights;
    int n;
    GaussRule(const Rules<Real> &rules, int points) {
        n = std::max(1, std::min(points, rules.largest));
        nodes = rules.nodes.data() + (n * (n - 1)) / 2;
        weights = rules.weights.data() + (n * (n - 1)) / 2;
    }
};

struct Moments {
    double re[6] = {0, 0, 0, 0, 0, 0}, im[6] = {0, 0, 0, 0, 0, 0};
};

// Points on rays from the closest point: how far along their ray, before the stretching is undone; ray; stretched by asinh of
// what; weight of all but the radius and the area element
template <class Real> struct Points {
    static constexpr int room = most_points + at_once;
    Real along[room], ray_u[room], ray_v[room], scale[room], weight[room];
    int n = 0;

    void put(const GaussRule<Real> &rule, Real stretch, Real u, Real v, Real by, Real area) {
        for (int begin = 0; begin < rule.n; begin += at_once)
#pragma omp simd
            for (int l = 0; l < at_once; l++) {
                const int to = n + begin + l;
                along[to] = rule.nodes[begin + l] * stretch, weight[to] = rule.weights[begin + l] * area;
                ray_u[to] = u, ray_v[to] = v, scale[to] = by;
            }
        n += rule.n;
    }
};

enum class Kernel { Double, Single, Mixed };  // layers; mixed, the double layer and a single one of a given strength

// Adds kernel * monomials at the collected points, and forgets them
template <Kernel kernel, bool Lossy, class Real>
void add_points(const Patches<some> &patches, int pair, double u, double v, bool stretched, Points<Real> &points,
                Wave<Real> k, std::complex<double> strength, Moments &sum) {
    Real us[most_points], vs[most_points], re[most_points], im[most_points], c[6][3];
    for (int m = 0; m < 6; m++)
        for (int d = 0; d < 3; d++) c[m][d] = Real(patches.c[m][d][pair]);
    int n = points.n;
    for (; n % vector; n++) {
        points.along[n] = points.scale[n] = Real(0.5);
        points.ray_u[n] = points.ray_v[n] = points.weight[n] = 0;
    }
    const Real at_u = Real(u), at_v = Real(v), p = Real(strength.real()), q = Real(strength.imag());
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
        // at the closest point itself; a machine's reciprocal root takes a subnormal number for 0
        const Real inverse = squared > Real(nothing) ? Real(1) / std::sqrt(squared) : Real(0), distance = squared * inverse;
        const Real weight = weights[i] * rho;
        const Real loss = (Lossy ? decay(k.imag * distance) : Real(1)) * inverse * weight * Real(1 / (4 * pi));
        Real sine, cosine;
        sincospi(k.half_waves * distance, sine, cosine);
        if (kernel == Kernel::Single) {
            const Real g = loss * std::sqrt(n0 * n0 + n1 * n1 + n2 * n2);
            re[i] = g * cosine;
            im[i] = g * sine;
        } else {
            const Real g = loss * inverse * inverse * (r0 * n0 + r1 * n1 + r2 * n2);
            const Real kr = k.real * distance, one = Lossy ? 1 + k.imag * distance : Real(1);
            re[i] = -g * (one * cosine + kr * sine);
            im[i] = g * (kr * cosine - one * sine);
        }
        if (kernel == Kernel::Mixed) {
            const Real g = loss * std::sqrt(n0 * n0 + n1 * n1 + n2 * n2);
            re[i] += g * (p * cosine - q * sine);
            im[i] += g * (p * sine + q * cosine);
        }
    }
    add_moments(us, vs, re, im, n, sum.re, sum.im);
    points.n = 0;
}

// asinh, no more exact than its use here needs
template <class Real> inline Real inverse_sinh(Real x) {
    const Real size = std::abs(x), value = logarithm(size + std::sqrt(size * size + 1));
    const Real exact = size < Real(1e-3) ? size * (1 - size * size / 6) : value;
    return x < 0 ? -exact : exact;
}

// Pairs of a panel and a target: where it touches or comes closest, the tangents there, and how far that is
template <class Real> struct Group {
    Patches<some> patches;
    Closest<some> closest;
    double a[3][some], b[3][some];
    double contact[some], distance[some], height[some];
    std::complex<double> strength[some];
    bool stretched[some];
    int count = 0;

    void put(const double *quadratic_triangles, const double *target, double within, std::complex<double> mixed) {
        patches.put(count, quadratic_triangles, target);
        contact[count] = within, strength[count] = mixed;
        count++;
    }
    void find_closest() {
        for (int l = count; l < some; l++)  // the rest repeats the first one
            for (int m = 0; m < 6; m++)
                for (int d = 0; d < 3; d++) patches.c[m][d][l] = patches.c[m][d][0];
        closest_points(patches, closest);
        for (int l = count; l < some; l++) contact[l] = contact[0];
        for (int l = 0; l < some; l++) {
            const double u = closest.u[l], v = closest.v[l];
            double aa = 0, bb = 0;
            distance[l] = height[l] = std::sqrt(closest.squared[l]);
            if (distance[l] < contact[l]) height[l] = 0;  // it counts as on the panel: the principal value where it is closest
            for (int d = 0; d < 3; d++) {
                a[d][l] = patches.rise_u(d, l, u, v), b[d][l] = patches.rise_v(d, l, u, v);
                aa += a[d][l] * a[d][l], bb += b[d][l] * b[d][l];
                if (distance[l] < contact[l]) patches.c[0][d][l] -= patches.along(d, l, u, v);
            }
            stretched[l] = height[l] > 1e-9 * std::sqrt(std::max(aa, bb));
        }
    }
};

// The triangles between the closest points and the edges: reference coordinates of the edges' ends, seen from there
template <class Real> struct Triangles {
    Real t0[3][some], t1[3][some], middle[3][some], width[3][some], area[3][some], length2[3][some], high2[3][some];
    Real u[3][some], v[3][some];

    explicit Triangles(const Group<Real> &group) {
        for (int edge = 0; edge < 3; edge++) {
            const double du = corner[edge + 1][0] - corner[edge][0], dv = corner[edge + 1][1] - corner[edge][1];
            const auto &a = group.a, &b = group.b;
#pragma omp simd
            for (int l = 0; l < some; l++) {
                const double p = corner[edge][0] - group.closest.u[l], q = corner[edge][1] - group.closest.v[l];
                const double s0 = a[0][l] * p + b[0][l] * q, s1 = a[1][l] * p + b[1][l] * q, s2 = a[2][l] * p + b[2][l] * q;
                const double r0 = a[0][l] * du + b[0][l] * dv, r1 = a[1][l] * du + b[1][l] * dv, r2 = a[2][l] * du + b[2][l] * dv;
                const double c0 = s1 * r2 - s2 * r1, c1 = s2 * r0 - s0 * r2, c2 = s0 * r1 - s1 * r0;
                const double square = dot(r0, r1, r2, r0, r1, r2), foot = -dot(s0, s1, s2, r0, r1, r2) / square;
                const double height2 = dot(c0, c1, c2, c0, c1, c2) / square;  // no difference of squares: it may be tiny
                const double wide = std::sqrt((height2 + group.height[l] * group.height[l]) / square);
                t0[edge][l] = inverse_sinh(Real(-foot / wide)), t1[edge][l] = inverse_sinh(Real((1 - foot) / wide));
                middle[edge][l] = Real(foot), width[edge][l] = Real(wide), area[edge][l] = Real(p * dv - q * du);
                length2[edge][l] = Real(square), high2[edge][l] = Real(height2);
                u[edge][l] = Real(p), v[edge][l] = Real(q);
            }
        }
    }
};

// Rays from the closest points to the edges, before and after the stretching of their angle; those of a pair follow each
// other
template <class Real> struct Rays {
    static constexpr int most = whole(3 * some * largest_rule + at_once);
    Real t[most], weight[most], centre[most], wide[most], length2[most], high2[most], along_u[most], along_v[most];
    Real u[most], v[most], inverse[most], scale[most], stretch[most];
    int begin[some + 1];

    Rays(const Group<Real> &group, const Rules<Real> &rules) {
        const Triangles<Real> of(group);
        int n = 0;
        for (int l = 0; l < group.count; l++) {
            begin[l] = n;
            for (int e = 0; e < 3; e++) {
                if (of.area[e][l] < Real(1e-10)) continue;  // the closest point is on this edge
                const Real start = of.t0[e][l], range = of.t1[e][l] - start, area = range * of.width[e][l] * of.area[e][l];
                const GaussRule<Real> angular(rules, int(rules.angular * (1 + range / 6)));
                const Real over = group.stretched[l] ? Real(1 / group.height[l]) : Real(0);
                const Real du = Real(corner[e + 1][0] - corner[e][0]), dv = Real(corner[e + 1][1] - corner[e][1]);
                for (int first = 0; first < angular.n; first += at_once)
#pragma omp simd
                    for (int i = 0; i < at_once; i++) {
                        const int to = n + first + i;
                        t[to] = start + angular.nodes[first + i] * range, weight[to] = angular.weights[first + i] * area;
                        centre[to] = of.middle[e][l], wide[to] = of.width[e][l];
                        length2[to] = of.length2[e][l], high2[to] = of.high2[e][l];
                        u[to] = of.u[e][l], v[to] = of.v[e][l], along_u[to] = du, along_v[to] = dv, inverse[to] = over;
                    }
                n += angular.n;
            }
        }
        begin[group.count] = n;
        for (; n % vector; n++) {
            t[n] = weight[n] = centre[n] = u[n] = v[n] = along_u[n] = along_v[n] = inverse[n] = 0;
            wide[n] = length2[n] = high2[n] = 1;
        }
        stretch_angles(n);
    }

  private:
    void stretch_angles(int n) {
#pragma omp simd
        for (int i = 0; i < n; i++) {
            const Real shrunk = decay(std::abs(t[i])), grown = 1 / shrunk, half = Real(0.5) * wide[i];
            const Real off = std::copysign(half * (grown - shrunk), t[i]), h = centre[i] + off;
            const Real far_off = std::sqrt(high2[i] + off * off * length2[i]) * inverse[i];
            const Real by = logarithm(far_off + std::sqrt(far_off * far_off + 1));  // its asinh, of 1 or more
            const bool stretched = inverse[i] > 0;
            u[i] += h * along_u[i], v[i] += h * along_v[i];
            weight[i] *= Real(0.5) * (grown + shrunk) * (stretched ? by : Real(1));
            scale[i] = 1 / (stretched ? far_off : Real(1)), stretch[i] = stretched ? by : Real(1);
        }
    }
};

// Integrals over the panel of each pair of kernel times monomials
template <class Real>
void integrate(Group<Real> &group, Wave<Real> k, const Rules<Real> &rules, decltype(add_points<Kernel::Double, true, Real>) *add,
               Moments *sums) {
    group.find_closest();
    const Rays<Real> rays(group, rules);
    Points<Real> points;
    for (int pair = 0; pair < group.count; pair++) {
        const bool stretched = group.stretched[pair];
        const double u = group.closest.u[pair], v = group.closest.v[pair];
        sums[pair] = Moments();
        for (int i = rays.begin[pair]; i < rays.begin[pair + 1]; i++) {
            const Real stretch = rays.stretch[i];
            const GaussRule<Real> radial(rules, int(rules.radial * (stretched ? 1 + Real(0.5) * stretch : Real(1))));
            if (points.n + radial.n > most_points)
                add(group.patches, pair, u, v, stretched, points, k, group.strength[pair], sums[pair]);
            points.put(radial, stretch, rays.u[i], rays.v[i], rays.scale[i], rays.weight[i]);
        }
        add(group.patches, pair, u, v, stretched, points, k, group.strength[pair], sums[pair]);
    }
}

}  // namespace

void near_integrals(bool single_layer, const double *targets, const std::int64_t *pair_target,
                    const std::int64_t *pair_panel, std::int64_t pairs, const double *quadratic_triangles,
                    const double *contact, Wavenumber k, NearRule rule,
                    std::complex<double> *out, double *distance, double *reference) {
    const Wave<double> wave(k);
    const Rules<double> rules(rule);
#pragma omp parallel for schedule(dynamic, 4) if (pairs > 64)
    for (std::int64_t first = 0; first < pairs; first += some) {
        Group<double> group;
        Moments sums[some];
        for (std::int64_t e = first; e < std::min(pairs, first + some); e++)
            group.put(quadratic_triangles + 18 * pair_panel[e], targets + 3 * pair_target[e], contact[pair_panel[e]], 0);
        integrate(group, wave, rules, single_layer ? add_points<Kernel::Single, true, double> : add_points<Kernel::Double, true, double>, sums);
        for (int l = 0; l < group.count; l++) {
            const std::int64_t e = first + l;
            distance[e] = group.distance[l];
            reference[2 * e] = group.closest.u[l], reference[2 * e + 1] = group.closest.v[l];
            for (int m = 0; m < 6; m++) out[6 * e + m] = {sums[l].re[m], sums[l].im[m]};
        }
    }
}

namespace {

// The plain terms of the nodes of some pairs' panels at their targets
template <class Real> struct PlainTerms {
    static constexpr int most = 6 * some;
    alignas(cache_line) Real offset[3][most], normal[3][most], single[2][most] = {}, re[most], im[most];
    int count = 0;

    void put(const double *target, const double *nodes, const double *normals, const std::complex<double> *mixed) {
        for (int l = 0; l < 6; l++, count++) {
            for (int d = 0; d < 3; d++) {
                offset[d][count] = Real(nodes[3 * l + d] - target[d]);
                normal[d][count] = Real(shared * normals[3 * l + d]);
            }
            if (mixed) single[0][count] = Real(mixed[l].real()), single[1][count] = Real(mixed[l].imag());
        }
    }
    void evaluate(Wave<Real> k, bool mixed, Real nearest) {
        for (; count % vector; count++)
            for (int d = 0; d < 3; d++) offset[d][count] = normal[d][count] = 1;
        const Real target[3] = {0, 0, 0};
        const Nodes<Real> nodes{{offset[0], offset[1], offset[2]}, {normal[0], normal[1], normal[2]},
                                {mixed ? single[0] : nullptr, mixed ? single[1] : nullptr}};
        double_layer_row(target, nodes, 0, count, k, nearest, re, im);
    }
};

}  // namespace

template <class Real>
void near_excess(const double *targets, std::int64_t n, const std::int64_t *first, const std::int64_t *pair_panel,
                 const double *quadratic_triangles, const double *contact, const double *sources, const double *normals,
                 const std::complex<double> *single, const double *nodal, Wavenumber k, double least, NearRule rule,
                 std::complex<double> *out) {
    const Wave<Real> wave(k);
    const Rules<Real> rules(rule);
    const auto add = single       ? add_points<Kernel::Mixed, true, Real>
                     : k.imag > 0 ? add_points<Kernel::Double, true, Real>
                                  : add_points<Kernel::Double, false, Real>;
    const Real nearest = Real(least * least);
    std::vector<std::int64_t> target(first[n]);
    for (std::int64_t i = 0; i < n; i++) std::fill(target.begin() + first[i], target.begin() + first[i + 1], i);
#pragma omp parallel for schedule(dynamic, 4) if (first[n] > 64)
    for (std::int64_t begin = 0; begin < first[n]; begin += some) {
        Group<Real> group;
        PlainTerms<Real> plain;
        Moments sums[some];
        for (std::int64_t e = begin; e < std::min(first[n], begin + some); e++) {
            const std::int64_t panel = pair_panel[e];
            const double *normal = normals + 18 * panel;
            const double area = std::sqrt(dot(normal[0], normal[1], normal[2], normal[0], normal[1], normal[2]));
            const std::complex<double> strength = single ? single[6 * panel] / area : 0;
            group.put(quadratic_triangles + 18 * panel, targets + 3 * target[e], contact[panel], strength);
            plain.put(targets + 3 * target[e], sources + 18 * panel, normal, single ? single + 6 * panel : nullptr);
        }
        integrate(group, wave, rules, add, sums);
        plain.evaluate(wave, single, nearest);
        for (int pair = 0; pair < group.count; pair++) {
            const std::int64_t e = begin + pair;
            for (int l = 0; l < 6; l++) {
                double excess_re = -double(plain.re[6 * pair + l]), excess_im = -double(plain.im[6 * pair + l]);
                for (int m = 0; m < 6; m++) {
                    excess_re += sums[pair].re[m] * nodal[6 * m + l];
                    excess_im += sums[pair].im[m] * nodal[6 * m + l];
                }
                out[6 * e + l] = {excess_re, excess_im};
            }
        }
    }
}

#define AIRTACT_NEAR(Real)                                                                                            \
    template void near_excess<Real>(const double *, std::int64_t, const std::int64_t *, const std::int64_t *,         \
                                    const double *, const double *, const double *, const double *,                   \
                                    const std::complex<double> *, const double *, Wavenumber, double, NearRule,       \
                                    std::complex<double> *);
AIRTACT_NEAR(float)
AIRTACT_NEAR(double)

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
