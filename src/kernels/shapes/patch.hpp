// Curved six-node panels as polynomials, several at once, and the point of each closest to a target. Included inside the
// namespaces of each variant, after <algorithm> and <cmath>.
namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

// Numbers one by one and no small structures, which would keep a compiler from vectorising
inline double dot(double a0, double a1, double a2, double b0, double b1, double b2) { return a0 * b0 + a1 * b1 + a2 * b2; }

template <int many> struct Patches {  // x(u, v) = sum_m c[m] monomial_m, relative to the target of each
    double c[6][3][many];

    void put(int l, const double *p, const double *target) {
        for (int d = 0; d < 3; d++) {
            const double p0 = p[d], p1 = p[3 + d], p2 = p[6 + d], m01 = p[9 + d], m12 = p[12 + d], m20 = p[15 + d];
            c[0][d][l] = p0 - target[d];
            c[1][d][l] = -3 * p0 - p1 + 4 * m01;
            c[2][d][l] = -3 * p0 - p2 + 4 * m20;
            c[3][d][l] = 2 * p0 + 2 * p1 - 4 * m01;
            c[4][d][l] = 4 * p0 - 4 * m01 + 4 * m12 - 4 * m20;
            c[5][d][l] = 2 * p0 + 2 * p2 - 4 * m20;
        }
    }
    double along(int d, int l, double u, double v) const {  // coordinate d of x
        return c[0][d][l] + u * c[1][d][l] + v * c[2][d][l] + u * u * c[3][d][l] + u * v * c[4][d][l] + v * v * c[5][d][l];
    }
    double rise_u(int d, int l, double u, double v) const { return c[1][d][l] + 2 * u * c[3][d][l] + v * c[4][d][l]; }
    double rise_v(int d, int l, double u, double v) const { return c[2][d][l] + u * c[4][d][l] + 2 * v * c[5][d][l]; }
    double squared(int l, double u, double v) const {  // distance
        const double x0 = along(0, l, u, v), x1 = along(1, l, u, v), x2 = along(2, l, u, v);
        return dot(x0, x1, x2, x0, x1, x2);
    }
    // of the vector from the target to the panel with coefficient m: half the second derivatives of the squared distance
    double bend(int m, int l, double x0, double x1, double x2) const {
        return dot(x0, x1, x2, c[m][0][l], c[m][1][l], c[m][2][l]);
    }
};

template <int many> struct Closest {  // reference coordinates of the points closest to the targets, and squared distances
    double u[many], v[many], squared[many];
};

constexpr double corner[4][2] = {{0, 0}, {1, 0}, {0, 1}, {0, 0}};

constexpr double tie = 1 - 1e-9;  // squared distances closer than that are the same, wherever the panel stands

// Newton along one edge, held inside it; Gauss-Newton where the distance is not convex. Of those with `wanted` above 0
// the point replaces one that is farther.
template <int many> void closest_on_edge(const Patches<many> &patches, int edge, const double *wanted, Closest<many> &found) {
    const double from_u = corner[edge][0], from_v = corner[edge][1];
    const double du = corner[edge + 1][0] - from_u, dv = corner[edge + 1][1] - from_v;
    double t[many], moving[many];
    for (int l = 0; l < many; l++) t[l] = 0.5, moving[l] = wanted[l];
    for (int step = 0; step < 12; step++) {
        double left = 0;
#pragma omp simd reduction(+ : left)
        for (int l = 0; l < many; l++) {
            const double u = from_u + t[l] * du, v = from_v + t[l] * dv;
            const double x0 = patches.along(0, l, u, v), x1 = patches.along(1, l, u, v), x2 = patches.along(2, l, u, v);
            const double a0 = du * patches.rise_u(0, l, u, v) + dv * patches.rise_v(0, l, u, v);
            const double a1 = du * patches.rise_u(1, l, u, v) + dv * patches.rise_v(1, l, u, v);
            const double a2 = du * patches.rise_u(2, l, u, v) + dv * patches.rise_v(2, l, u, v);
            const double straight = dot(a0, a1, a2, a0, a1, a2);
            const double bent = straight + 2 * (du * du * patches.bend(3, l, x0, x1, x2) + du * dv * patches.bend(4, l, x0, x1, x2) +
                                                dv * dv * patches.bend(5, l, x0, x1, x2));
            const double move = -dot(x0, x1, x2, a0, a1, a2) / (bent > 0.1 * straight ? bent : straight);
            const double to = t[l] + move, inside = to < 0.0 ? 0.0 : to > 1.0 ? 1.0 : to;
            const double next = moving[l] > 0 ? inside : t[l];  // a result must not depend on the patches beside it
            moving[l] *= std::abs(next - t[l]) < 1e-6 ? 0.0 : 1.0;  // quadratically: the step just taken is exact
            t[l] = next;
            left += moving[l];
        }
        if (left == 0) break;
    }
#pragma omp simd
    for (int l = 0; l < many; l++) {
        const double u = from_u + t[l] * du, v = from_v + t[l] * dv;
        const double squared = patches.squared(l, u, v);
        const double nearer = wanted[l] * (squared < tie * found.squared[l] ? 1.0 : 0.0);
        found.u[l] = nearer > 0 ? u : found.u[l];
        found.v[l] = nearer > 0 ? v : found.v[l];
        found.squared[l] = nearer > 0 ? squared : found.squared[l];
    }
}

// The panels' points nearest the targets (the origins), all at once: flags are numbers, 1 or 0, which a compiler can
// vectorise beside others
template <int many> void closest_points(const Patches<many> &patches, Closest<many> &found) {
    constexpr double far_off = 4;
    double u[many], v[many], moving[many], settled[many], convex[many];
    for (int l = 0; l < many; l++) u[l] = v[l] = 1.0 / 3, moving[l] = convex[l] = 1, settled[l] = 0;
    for (int step = 0; step < 20; step++) {
        double left = 0;
#pragma omp simd reduction(+ : left)
        for (int l = 0; l < many; l++) {
            const double s = u[l], t = v[l];
            const double x0 = patches.along(0, l, s, t), x1 = patches.along(1, l, s, t), x2 = patches.along(2, l, s, t);
            const double a0 = patches.rise_u(0, l, s, t), a1 = patches.rise_u(1, l, s, t), a2 = patches.rise_u(2, l, s, t);
            const double b0 = patches.rise_v(0, l, s, t), b1 = patches.rise_v(1, l, s, t), b2 = patches.rise_v(2, l, s, t);
            const double aa = dot(a0, a1, a2, a0, a1, a2), ab = dot(a0, a1, a2, b0, b1, b2), bb = dot(b0, b1, b2, b0, b1, b2);
            const double ra = -dot(x0, x1, x2, a0, a1, a2), rb = -dot(x0, x1, x2, b0, b1, b2), det = aa * bb - ab * ab;
            const double aa_bent = aa + 2 * patches.bend(3, l, x0, x1, x2), ab_bent = ab + patches.bend(4, l, x0, x1, x2);
            const double bb_bent = bb + 2 * patches.bend(5, l, x0, x1, x2), det_bent = aa_bent * bb_bent - ab_bent * ab_bent;
            const double newton = (aa_bent > 0 ? 1.0 : 0.0) * (det_bent > 0.1 * det ? 1.0 : 0.0);  // else Gauss-Newton
            const double p = newton > 0 ? aa_bent : aa, q = newton > 0 ? ab_bent : ab, r = newton > 0 ? bb_bent : bb;
            const double by = newton > 0 ? det_bent : det, du = (r * ra - q * rb) / by, dv = (p * rb - q * ra) / by;
            u[l] = moving[l] > 0 ? s + du : s, v[l] = moving[l] > 0 ? t + dv : t;
            convex[l] = moving[l] > 0 ? newton : convex[l];
            const double within = (std::abs(u[l]) < far_off ? 1.0 : 0.0) * (std::abs(v[l]) < far_off ? 1.0 : 0.0);
            const double goes_on = std::abs(du) + std::abs(dv) < 1e-6 ? 0.0 : 1.0;  // quadratically, as above
            settled[l] = moving[l] > 0 ? within * (1 - goes_on) : settled[l];
            moving[l] *= within * goes_on;
            left += moving[l];
        }
        if (left == 0) break;
    }
    double outside[many], known[many], all = 0;
#pragma omp simd reduction(+ : all)
    for (int l = 0; l < many; l++) {
        const double squared = patches.squared(l, u[l], v[l]);
        const double w = 1 - u[l] - v[l], least = u[l] < v[l] ? (u[l] < w ? u[l] : w) : (v[l] < w ? v[l] : w);
        outside[l] = least >= 0 ? 0.0 : 1.0;
        known[l] = least > -0.1 ? settled[l] * convex[l] : 0.0;  // farther off it bends
        found.u[l] = u[l], found.v[l] = v[l];
        found.squared[l] = least >= 0 ? squared : std::numeric_limits<double>::max();
        all += outside[l];
    }
    for (int edge = 0; edge < 3 && all > 0; edge++) {
        double wanted[many], some = 0;
        for (int l = 0; l < many; l++) {  // a line to the lowest point leaves the panel at this edge, if convex
            const double within = edge == 0 ? v[l] : edge == 1 ? 1 - u[l] - v[l] : u[l];
            wanted[l] = known[l] > 0 && within >= 0 ? 0.0 : outside[l];
            some += wanted[l];
        }
        if (some > 0) closest_on_edge(patches, edge, wanted, found);
    }
}

}  // namespace
}  // namespace AIRTACT_VARIANT
}  // namespace airtact
