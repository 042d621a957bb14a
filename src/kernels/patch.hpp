// A curved six-node panel as a polynomial, and its point closest to a target. Included inside the namespaces of each
// variant, after <algorithm> and <cmath>.
namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

struct Patch {  // x(u, v) = sum_m c[m] monomial_m, relative to the target
    double c[6][3];

    Patch(const double *p, const double *target) {
        for (int d = 0; d < 3; d++) {
            const double p0 = p[d], p1 = p[3 + d], p2 = p[6 + d], m01 = p[9 + d], m12 = p[12 + d], m20 = p[15 + d];
            c[0][d] = p0 - target[d];
            c[1][d] = -3 * p0 - p1 + 4 * m01;
            c[2][d] = -3 * p0 - p2 + 4 * m20;
            c[3][d] = 2 * p0 + 2 * p1 - 4 * m01;
            c[4][d] = 4 * p0 - 4 * m01 + 4 * m12 - 4 * m20;
            c[5][d] = 2 * p0 + 2 * p2 - 4 * m20;
        }
    }
    void at(double u, double v, double *x, double *a, double *b) const {
        for (int d = 0; d < 3; d++) {
            x[d] = c[0][d] + u * c[1][d] + v * c[2][d] + u * u * c[3][d] + u * v * c[4][d] + v * v * c[5][d];
            a[d] = c[1][d] + 2 * u * c[3][d] + v * c[4][d];
            b[d] = c[2][d] + u * c[4][d] + 2 * v * c[5][d];
        }
    }
    double squared_distance(double u, double v) const {
        double x[3], a[3], b[3];
        at(u, v, x, a, b);
        return x[0] * x[0] + x[1] * x[1] + x[2] * x[2];
    }
};

double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

constexpr double corner[4][2] = {{0, 0}, {1, 0}, {0, 1}, {0, 0}};

// Newton along one edge, held inside it; Gauss-Newton where the distance is not convex
double closest_on_edge(const Patch &patch, int edge, double *best) {
    const double *from = corner[edge], du = corner[edge + 1][0] - from[0], dv = corner[edge + 1][1] - from[1];
    double t = 0.5, x[3], a[3], b[3];
    for (int step = 0; step < 12; step++) {
        patch.at(from[0] + t * du, from[1] + t * dv, x, a, b);
        const double along[3] = {a[0] * du + b[0] * dv, a[1] * du + b[1] * dv, a[2] * du + b[2] * dv};
        const double straight = dot(along, along);
        const double bent =
            straight + 2 * (du * du * dot(x, patch.c[3]) + du * dv * dot(x, patch.c[4]) + dv * dv * dot(x, patch.c[5]));
        const double move = -dot(x, along) / (bent > 0.1 * straight ? bent : straight);
        const double next = std::min(1.0, std::max(0.0, t + move));
        const bool settled = std::abs(next - t) < 1e-6;  // quadratically: the step just taken is exact
        t = next;
        if (settled) break;
    }
    best[0] = from[0] + t * du;
    best[1] = from[1] + t * dv;
    return patch.squared_distance(best[0], best[1]);
}

// Reference coordinates of the panel's point nearest the target (the origin); returns the squared distance
double closest_point(const Patch &patch, double *reference) {
    double u = 1.0 / 3, v = 1.0 / 3, x[3], a[3], b[3];
    bool settled = false, convex = true;
    for (int step = 0; step < 20 && !settled; step++) {
        patch.at(u, v, x, a, b);
        double aa = dot(a, a), ab = dot(a, b), bb = dot(b, b), det = aa * bb - ab * ab;
        const double ra = -dot(x, a), rb = -dot(x, b);
        const double aa_bent = aa + 2 * dot(x, patch.c[3]), ab_bent = ab + dot(x, patch.c[4]);
        const double bb_bent = bb + 2 * dot(x, patch.c[5]), det_bent = aa_bent * bb_bent - ab_bent * ab_bent;
        convex = aa_bent > 0 && det_bent > 0.1 * det;
        if (convex) {  // Newton there, else Gauss-Newton
            aa = aa_bent;
            ab = ab_bent;
            bb = bb_bent;
            det = det_bent;
        }
        const double du = (bb * ra - ab * rb) / det, dv = (aa * rb - ab * ra) / det;
        u += du;
        v += dv;
        if (!(std::abs(u) < 4 && std::abs(v) < 4)) break;
        settled = std::abs(du) + std::abs(dv) < 1e-6;  // quadratically: the step just taken is exact
    }
    if (std::abs(u) < 4 && std::abs(v) < 4 && u >= 0 && v >= 0 && u + v <= 1) {
        reference[0] = u;
        reference[1] = v;
        return patch.squared_distance(u, v);
    }
    const bool beyond[3] = {v < 0, u + v > 1, u < 0};  // a line to the lowest point leaves the panel there, if convex
    const bool beside = u > -0.1 && v > -0.1 && u + v < 1.1;  // farther off it bends
    double best = std::numeric_limits<double>::infinity();
    for (int edge = 0; edge < 3; edge++) {
        if (settled && convex && beside && !beyond[edge]) continue;
        double candidate[2];
        const double distance = closest_on_edge(patch, edge, candidate);
        if (distance < best) {
            best = distance;
            reference[0] = candidate[0];
            reference[1] = candidate[1];
        }
    }
    return best;
}

}  // namespace
}  // namespace AIRTACT_VARIANT
}  // namespace airtact
