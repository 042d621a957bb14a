// Sums over many sources at many receivers, by interpolation between distant clusters of both.
//
// Between a source y near a and a receiver x near b, e^{ikr}/r is nearly the product of the waves from the source to b and
// from a to the receiver:
//   e^{ik|x - y|}/|x - y| = e^{ik|y - b|}/|y - b| * e^{ik|x - a|}/|x - a| * rest(x, y).
// The phase of the rest varies by about k |x - a| |y - b| / |a - b| across the line of sight, so few Chebyshev points along
// each axis of a cluster interpolate it: the sources are replaced by a grid in their cluster, which acts on a grid in the
// receivers' cluster. Pairs of clusters that are close, or for which this is no faster, are summed exactly. The product of
// waves is that of E. Candes, L. Demanet, L. Ying, Multiscale Model. Simul. 7 (2009) 1727.
#include <array>

#include "lines.hpp"
#include "sums.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

using Real = float;
constexpr int width = line<Real>;
constexpr int most_points = 8;            // along an axis of a grid
constexpr std::int64_t cluster_size = 256;  // points; clusters of sources are halved ...
constexpr int halvings = 2;               // ... up to so often
constexpr double closest = 3;              // distance of clusters that are not summed exactly, in their radii
constexpr std::int64_t most_sounds = 64;  // at once, which limits the memory
constexpr double never = 1e9;              // share of time of grids that are not possible

// n points along an axis: their places in [-1, 1], and the Chebyshev coefficients of the polynomial that is 1 at one of them
// and 0 at the others
struct Rule {
    Real at[most_points] = {}, coefficient[most_points][most_points] = {};  // [degree][point]
};

std::array<Rule, most_points + 1> make_rules() {
    std::array<Rule, most_points + 1> made;
    for (int n = 1; n <= most_points; n++)
        for (int g = 0; g < n; g++) {
            const double angle = pi * (g + 0.5) / n;
            made[n].at[g] = Real(std::cos(angle));
            for (int m = 0; m < n; m++) made[n].coefficient[m][g] = Real((m ? 2.0 : 1.0) / n * std::cos(m * angle));
        }
    return made;
}

// Order of points in which each `cluster_size` lie together, and so do the halves of these: the points are halved across the
// longest edge of their box, again and again
std::vector<std::int64_t> cluster_order(const double *points, std::int64_t n) {
    std::vector<std::int64_t> order(n);
    for (std::int64_t i = 0; i < n; i++) order[i] = i;
    std::vector<std::pair<std::int64_t, std::int64_t>> waiting{{0, n}};
    while (!waiting.empty()) {
        const auto [begin, end] = waiting.back();
        waiting.pop_back();
        std::int64_t each = cluster_size;
        while (each > cluster_size >> halvings && each >= end - begin) each /= 2;
        const std::int64_t blocks = (end - begin + each - 1) / each, middle = begin + each * (blocks / 2);
        if (blocks <= 1) continue;
        int axis = 0;
        double longest = -1;
        for (int d = 0; d < 3; d++) {
            double low = points[3 * order[begin] + d], high = low;
            for (std::int64_t i = begin; i < end; i++)
                low = std::min(low, points[3 * order[i] + d]), high = std::max(high, points[3 * order[i] + d]);
            if (high - low > longest) longest = high - low, axis = d;
        }
        std::nth_element(order.begin() + begin, order.begin() + middle, order.begin() + end,
                         [&](std::int64_t a, std::int64_t b) { return points[3 * a + axis] < points[3 * b + axis]; });
        waiting.emplace_back(middle, end), waiting.emplace_back(begin, middle);
    }
    return order;
}

// Points relative to the centre of their cluster, each coordinate contiguous and padded with the last point; their normals, if
// there are any; and their values, sound by sound: strengths of sources, or the single layer of receivers
struct Cluster {
    std::int64_t count, padded;
    double centre[3], radius;
    Lined<Real> place[3], normal[3], re, im;
};

std::vector<Cluster> clusters_of(const double *points, const std::vector<std::int64_t> &order, std::int64_t each,
                                 const double *normals, const std::complex<double> *values, std::int64_t sounds,
                                 std::int64_t stride) {
    const std::int64_t n = std::int64_t(order.size());
    std::vector<Cluster> clusters((n + each - 1) / each);
    for (std::int64_t c = 0; c < std::int64_t(clusters.size()); c++) {
        Cluster &cluster = clusters[c];
        const std::int64_t *const index = order.data() + c * each;
        const std::int64_t count = cluster.count = std::min(each, n - c * each);
        const std::int64_t padded = cluster.padded = whole_lines<Real>(count);
        std::vector<double> squares(count);
        for (int d = 0; d < 3; d++) {
            double low = points[3 * index[0] + d], high = low;
            for (std::int64_t l = 0; l < count; l++)
                low = std::min(low, points[3 * index[l] + d]), high = std::max(high, points[3 * index[l] + d]);
            const double middle = cluster.centre[d] = 0.5 * (low + high);
            cluster.place[d].resize(padded);
            if (normals) cluster.normal[d].resize(padded);
            for (std::int64_t l = 0; l < padded; l++) {
                const std::int64_t i = 3 * index[std::min(l, count - 1)] + d;
                cluster.place[d][l] = Real(points[i] - middle);
                if (normals) cluster.normal[d][l] = Real(shared * normals[i]);
                if (l < count) squares[l] += (points[i] - middle) * (points[i] - middle);
            }
        }
        cluster.radius = std::sqrt(*std::max_element(squares.begin(), squares.end()));
        if (!values) continue;
        cluster.re.resize(padded * sounds), cluster.im.resize(padded * sounds);
        for (std::int64_t s = 0; s < sounds; s++)
            for (std::int64_t l = 0; l < count; l++) {
                cluster.re[s * padded + l] = Real(values[index[l] * stride + s].real());
                cluster.im[s * padded + l] = Real(values[index[l] * stride + s].imag());
            }
    }
    return clusters;
}

// e^{ikr}/r, or its inverse, and 1/r, at points of the frame, from a point on its last axis
template <bool Lossy, bool Inverse>
void waves(const Lined<Real> *at, Real from, Wave<Real> k, Lined<Real> &re, Lined<Real> &im, Lined<Real> &nearness) {
    const std::int64_t n = std::int64_t(at[0].size());
    re.resize(n), im.resize(n), nearness.resize(n);
    for (std::int64_t j = 0; j < n; j += width) {
        Real squares[width], inverses[width];
        const Real *const u = at[0].data() + j, *const v = at[1].data() + j, *const w = at[2].data() + j;
        Real *const a = re.data() + j, *const b = im.data() + j, *const one = nearness.data() + j;
#pragma omp simd
        for (int l = 0; l < width; l++) squares[l] = u[l] * u[l] + v[l] * v[l] + (w[l] - from) * (w[l] - from);
        inverse_roots(squares, Real(-1), inverses);
#pragma omp simd
        for (int l = 0; l < width; l++) {
            const Real r = squares[l] * inverses[l] / 2, left = Lossy ? decay(k.imag * r) : Real(1);
            Real s, c;
            sincospi(k.half_waves * r, s, c);
            one[l] = inverses[l] / 2;
            const Real size = Inverse ? r / left : one[l] * left;
            a[l] = size * c;
            b[l] = Inverse ? -size * s : size * s;
        }
    }
}

// A cluster as seen along a line of sight, which is the last axis of the frame, and its grid
struct View {
    Lined<Real> local[3];           // coordinates of the points
    double most[3];                 // their largest distance from the centre along each axis
    double middle[3], half[3];      // of the grid
    int n[3];                       // points of the grid along each axis
    std::int64_t points;            // of the whole grid
    Lined<Real> weight[3], slope[3];  // [point of the grid along the axis][point]: of the interpolation; their derivatives
    Lined<Real> grid[3];            // coordinates of the grid, padded with its last point
    // The wave from the centre of the other cluster to the points, 1/r, and the inverse wave at the grid
    Lined<Real> wave_re, wave_im, nearness, inverse_re, inverse_im, grid_nearness;

    void look(const Cluster &cluster, const double (*frame)[3]) {
        const Real *const x = cluster.place[0].data(), *const y = cluster.place[1].data(), *const z = cluster.place[2].data();
        for (int axis = 0; axis < 3; axis++) {
            local[axis].resize(cluster.padded);
            const Real a = Real(frame[axis][0]), b = Real(frame[axis][1]), c = Real(frame[axis][2]);
            Real *const out = local[axis].data();
            Real low = 1e30f, high = -1e30f;
#pragma omp simd reduction(min : low) reduction(max : high)
            for (std::int64_t l = 0; l < cluster.padded; l++) {
                out[l] = a * x[l] + b * y[l] + c * z[l];
                low = std::min(low, out[l]), high = std::max(high, out[l]);
            }
            most[axis] = std::max(std::abs(low), std::abs(high));
            middle[axis] = 0.5 * (double(low) + high), half[axis] = 0.5 * (double(high) - low);
        }
    }

    void place_grid(double from, Wave<Real> k, bool sloped) {
        static const std::array<Rule, most_points + 1> rules = make_rules();
        for (int axis = 0; axis < 3; axis++) grid[axis].resize(whole_lines<Real>(points));
        std::int64_t g = 0;
        for (int a = 0; a < n[0]; a++)
            for (int b = 0; b < n[1]; b++)
                for (int c = 0; c < n[2]; c++, g++) {
                    const int at[3] = {a, b, c};
                    for (int axis = 0; axis < 3; axis++)
                        grid[axis][g] = Real(middle[axis] + half[axis] * rules[n[axis]].at[at[axis]]);
                }
        for (int axis = 0; axis < 3; axis++) {
            std::fill(grid[axis].begin() + g, grid[axis].end(), grid[axis][g - 1]);
            weigh(axis, rules[n[axis]], sloped);
        }
        const bool lossy = k.imag > 0;
        (lossy ? waves<true, true> : waves<false, true>)(grid, Real(from), k, inverse_re, inverse_im, grid_nearness);
        (lossy ? waves<true, false> : waves<false, false>)(local, Real(from), k, wave_re, wave_im, nearness);
    }

    void weigh(int axis, const Rule &rule, bool sloped) {
        const std::int64_t count = std::int64_t(local[axis].size());
        weight[axis].resize(n[axis] * count), slope[axis].resize(sloped ? n[axis] * count : 0);
        const Real inverse = half[axis] > 0 ? Real(1 / half[axis]) : Real(0), centre = Real(middle[axis]);
        for (std::int64_t j = 0; j < count; j += width) {
            Real t[most_points][width], d[most_points][width];  // Chebyshev polynomials and their derivatives
            const Real *const x = local[axis].data() + j;
#pragma omp simd
            for (int l = 0; l < width; l++) {
                t[0][l] = 1, t[1][l] = (x[l] - centre) * inverse;
                d[0][l] = 0, d[1][l] = inverse;
            }
            for (int m = 2; m < n[axis]; m++) {
#pragma omp simd
                for (int l = 0; l < width; l++) t[m][l] = 2 * t[1][l] * t[m - 1][l] - t[m - 2][l];
                if (!sloped) continue;
#pragma omp simd
                for (int l = 0; l < width; l++)
                    d[m][l] = 2 * (inverse * t[m - 1][l] + t[1][l] * d[m - 1][l]) - d[m - 2][l];
            }
            for (int g = 0; g < n[axis]; g++) {
                Real value[width] = {}, change[width] = {};
                for (int m = 0; m < n[axis]; m++) {
                    const Real c = rule.coefficient[m][g];
#pragma omp simd
                    for (int l = 0; l < width; l++) value[l] += c * t[m][l];
                    if (!sloped) continue;
#pragma omp simd
                    for (int l = 0; l < width; l++) change[l] += c * d[m][l];
                }
                std::copy(value, value + width, weight[axis].data() + g * count + j);
                if (sloped) std::copy(change, change + width, slope[axis].data() + g * count + j);
            }
        }
    }
};

// Chooses the grids of both clusters for this error. False if they are too close, or too large for their distance. A layer is
// differentiated at the receivers, so their grid may not be flat.
bool choose_grids(View &from, View &to, double distance, double k, double error, bool layer) {
    for (int axis = 0; layer && axis < 3; axis++) {
        to.half[axis] = std::max(to.half[axis], 2 / k);
        to.most[axis] = std::max(to.most[axis], std::abs(to.middle[axis]) + to.half[axis]);
    }
    const double apart = distance - from.most[2] - to.most[2];
    for (View *view : {&from, &to}) {
        View &own = *view;
        const View &other = view == &from ? to : from;
        const bool sloped = layer && view == &to;
        const double across = std::hypot(own.most[0], own.most[1]), facing = std::hypot(other.most[0], other.most[1]);
        if (apart < closest * std::max({across, facing, own.half[2]})) return false;
        // The phase, from its expansion in x and y: linear along an axis, and also quadratic across the line of sight. The
        // amplitude varies less.
        const double turn = facing * (facing + 2 * across) / (2 * apart * apart), nearer = other.most[2] / apart;
        const double swell = std::hypot(facing, other.most[2]) / (apart * apart);
        own.points = 1;
        for (int axis = 0; axis < 3; axis++) {
            const double slant = axis < 2 ? other.most[axis] / apart : turn + across * across * nearer / (apart * apart);
            const double linear = 0.5 * own.half[axis] * (k * slant + swell);
            const double quadratic = axis < 2 ? 0.25 * k * own.half[axis] * own.most[axis] * (nearer + turn) / apart : 0;
            // n points interpolate e^{2i linear t}, |t| < 1, with an error of about linear^n / n!, e^{2i quadratic t^2} with
            // quadratic^m / m!, m being half of n rounded up; and their derivatives with n^2 times that. Measured errors of
            // sums are below `error` with half of it.
            int n = 0;
            for (double first = 0.5, second = 0.5, steep = 1; n == 0 || (first + second) * steep > error;) {
                if (++n > most_points) return false;
                first *= linear / n;
                if (n % 2) second *= quadratic / ((n + 1) / 2);
                if (sloped) steep = std::max(1.0, n * n / (k * own.half[axis]));
            }
            own.n[axis] = n, own.points *= n;
        }
    }
    return true;
}

// x + i y = sum_p weights_p (a + i b)[p] of a line of numbers; two sums of each hide the latency
inline void interpolate_line(const Real *weights, const Real *a, const Real *b, std::int64_t points, Real *x, Real *y) {
    Real x0[width] = {}, y0[width] = {}, x1[width] = {}, y1[width] = {};
    for (std::int64_t p = 0; p + 1 < points; p += 2) {
        const Real *const first = weights + p * width, *const second = first + width;
#pragma omp simd
        for (int l = 0; l < width; l++) {
            x0[l] += first[l] * a[p], y0[l] += first[l] * b[p];
            x1[l] += second[l] * a[p + 1], y1[l] += second[l] * b[p + 1];
        }
    }
    const std::int64_t last = points - 1;
    const Real odd = Real(points % 2), *const first = weights + last * width;
#pragma omp simd
    for (int l = 0; l < width; l++) {
        x[l] = x0[l] + x1[l] + odd * first[l] * a[last];
        y[l] = y0[l] + y1[l] + odd * first[l] * b[last];
    }
}

// p + i q = (a + i b) (c + i d), for n numbers; p, q may be a, b
inline void multiply(const Real *a, const Real *b, const Real *c, const Real *d, std::int64_t n, Real *p, Real *q) {
#pragma omp simd
    for (std::int64_t l = 0; l < n; l++) {
        const Real x = a[l], y = b[l];
        p[l] = x * c[l] - y * d[l], q[l] = x * d[l] + y * c[l];
    }
}

// Adds (a + i b) (re + i im) to p + i q, for n numbers
inline void add_multiple(Real a, Real b, const Real *re, const Real *im, std::int64_t n, Real *p, Real *q) {
#pragma omp simd
    for (std::int64_t l = 0; l < n; l++) p[l] += a * re[l] - b * im[l], q[l] += a * im[l] + b * re[l];
}

// The sums of a cluster of receivers, and buffers
struct Sums {
    bool layer, mixed;     // whether receivers are nodes of a transposed double layer; and have a single one
    std::int64_t sounds;
    Wave<Real> k;
    Lined<Real> re, im;    // [sound][receiver]
    View from, to;
    double frame[3][3];    // the last axis points from the sources to the receivers
    Lined<Real> row_re, row_im, products, totals, strength_re, strength_im, grid_re, grid_im, weights, slopes;
    Sums(bool layer, bool mixed, std::int64_t sounds, Wavenumber k) : layer(layer), mixed(mixed), sounds(sounds), k(k) {}

    // Sets up both views. The time of a sum over grids as a share of that of an exact sum; infinite if there are no grids
    double share_of_time(const Cluster &sources, const Cluster &receivers, double distance, double error) {
        if (distance <= closest * std::max(sources.radius, receivers.radius)) return never;
        int least = 0;
        for (int d = 0; d < 3; d++) {
            frame[2][d] = (receivers.centre[d] - sources.centre[d]) / distance;
            if (std::abs(frame[2][d]) < std::abs(frame[2][least])) least = d;
        }
        const double share = frame[2][least], size = std::sqrt(1 - share * share);
        for (int d = 0; d < 3; d++) frame[0][d] = ((d == least) - share * frame[2][d]) / size;
        for (int d = 0; d < 3; d++) {
            const int e = (d + 1) % 3, f = (d + 2) % 3;
            frame[1][d] = frame[2][e] * frame[0][f] - frame[2][f] * frame[0][e];
        }
        from.look(sources, frame), to.look(receivers, frame);
        if (!choose_grids(from, to, distance, k.real, error, layer)) return never;
        // Measured on one machine, in units of the time of a number: 25 for a kernel, 2.5 for its product with a sound
        const double kernel = 25 + 2.5 * sounds, weighting = 1 + 1.5 * sounds;
        return (from.points * (to.points + 8) * kernel + sources.padded * (100 + from.points * weighting) +
                receivers.padded * (100 + to.points * weighting * (layer ? 2 : 1))) /
               (double(sources.count) * receivers.padded * kernel);
    }

    void add_exact(const Cluster &sources, const Cluster &receivers) {
        const std::int64_t n = receivers.padded;
        row_re.resize(n), row_im.resize(n);
        const Lined<Real> *const at = receivers.place, *const normal = receivers.normal;
        const Nodes<Real> nodes{{at[0].data(), at[1].data(), at[2].data()}, {normal[0].data(), normal[1].data(), normal[2].data()},
                                {mixed ? receivers.re.data() : nullptr, mixed ? receivers.im.data() : nullptr}};
        for (std::int64_t j = 0; j < sources.count; j++) {
            Real y[3];
            for (int d = 0; d < 3; d++) y[d] = Real(sources.centre[d] - receivers.centre[d] + sources.place[d][j]);
            if (layer)
                double_layer_row(y, nodes, 0, n, k, Real(0), row_re.data(), row_im.data());
            else
                monopole_row(y, nodes.point, 0, n, k, row_re.data(), row_im.data());
            for (std::int64_t s = 0; s < sounds; s++)
                add_multiple(sources.re[s * sources.padded + j], sources.im[s * sources.padded + j], row_re.data(), row_im.data(), n,
                             re.data() + s * n, im.data() + s * n);
        }
    }

    void add_over_grids(const Cluster &sources, const Cluster &receivers, double distance) {
        from.place_grid(distance, k, false), to.place_grid(-distance, k, layer);
        gather(sources);
        const std::int64_t n = std::int64_t(to.grid[0].size());
        grid_re.assign(sounds * n, 0), grid_im.assign(sounds * n, 0);
        row_re.resize(n), row_im.resize(n);
        const Real *const grid[3] = {to.grid[0].data(), to.grid[1].data(), to.grid[2].data()};
        for (std::int64_t g = 0; g < from.points; g++) {
            const Real y[3] = {from.grid[0][g], from.grid[1][g], Real(from.grid[2][g] - distance)};
            monopole_row(y, grid, 0, n, k, row_re.data(), row_im.data());
            for (std::int64_t s = 0; s < sounds; s++)
                add_multiple(strength_re[g * sounds + s], strength_im[g * sounds + s], row_re.data(), row_im.data(), n,
                             grid_re.data() + s * n, grid_im.data() + s * n);
        }
        for (std::int64_t s = 0; s < sounds; s++)
            multiply(grid_re.data() + s * n, grid_im.data() + s * n, to.inverse_re.data(), to.inverse_im.data(), n,
                     grid_re.data() + s * n, grid_im.data() + s * n);
        for (std::int64_t j = 0; j < receivers.padded; j += width) interpolate(receivers, distance, j);
    }

    // The strengths of the grid that replaces the sources
    void gather(const Cluster &sources) {
        const std::int64_t m = sources.padded;
        products.resize(2 * sounds * m), totals.resize(2 * sounds), weights.resize(m);
        for (std::int64_t s = 0; s < sounds; s++)
            multiply(sources.re.data() + s * m, sources.im.data() + s * m, from.wave_re.data(), from.wave_im.data(), m,
                     products.data() + 2 * s * m, products.data() + (2 * s + 1) * m);
        strength_re.resize(from.points * sounds), strength_im.resize(from.points * sounds);
        std::int64_t g = 0;
        for (int a = 0; a < from.n[0]; a++)
            for (int b = 0; b < from.n[1]; b++)
                for (int c = 0; c < from.n[2]; c++, g++) {
                    const Real *const u = from.weight[0].data() + a * m, *const v = from.weight[1].data() + b * m;
                    const Real *const w = from.weight[2].data() + c * m;
                    Real *const all = weights.data();
#pragma omp simd
                    for (std::int64_t l = 0; l < m; l++) all[l] = u[l] * v[l] * w[l];
                    sum_products(all, products.data(), m, 2 * sounds, totals.data());
                    for (std::int64_t s = 0; s < sounds; s++)
                        multiply(&totals[2 * s], &totals[2 * s + 1], &from.inverse_re[g], &from.inverse_im[g], 1,
                                 &strength_re[g * sounds + s], &strength_im[g * sounds + s]);
                }
    }

    // Adds the field of the receivers' grid at a line of receivers from j on
    void interpolate(const Cluster &receivers, double distance, std::int64_t j) {
        const std::int64_t n = receivers.padded, grid = std::int64_t(to.grid[0].size());
        weights.resize(to.points * width), slopes.resize(to.points * width);
        // Normals in the frame, of which those of the cluster have the scale of `Normals`, 1/8 of 1/(4 pi); and the layer's factor
        // of the wave from the centre of the sources, whose derivative along its way is e^{ikr}/r times ik - 1/r
        Real normal[3][width], single_re[width] = {}, single_im[width] = {}, factor_re[width], factor_im[width];
        if (mixed) std::copy_n(&receivers.re[j], width, single_re), std::copy_n(&receivers.im[j], width, single_im);
        const int layered = layer ? width : 0;
#pragma omp simd
        for (int l = 0; l < layered; l++) {
            const Real x = 8 * receivers.normal[0][j + l], y = 8 * receivers.normal[1][j + l], z = 8 * receivers.normal[2][j + l];
            for (int axis = 0; axis < 3; axis++)
                normal[axis][l] = x * Real(frame[axis][0]) + y * Real(frame[axis][1]) + z * Real(frame[axis][2]);
            const Real nearness = to.nearness[j + l];
            const Real along = nearness * (normal[0][l] * to.local[0][j + l] + normal[1][l] * to.local[1][j + l] +
                                           normal[2][l] * (to.local[2][j + l] + Real(distance)));
            factor_re[l] = single_re[l] * Real(1 / (4 * pi)) - (k.imag + nearness) * along;
            factor_im[l] = single_im[l] * Real(1 / (4 * pi)) + k.real * along;
        }
        Real *weight = weights.data(), *slope = slopes.data();
        for (int a = 0; a < to.n[0]; a++)
            for (int b = 0; b < to.n[1]; b++) {
                const Real *const u = to.weight[0].data() + a * n + j, *const v = to.weight[1].data() + b * n + j;
                Real both[width], across[width];
#pragma omp simd
                for (int l = 0; l < width; l++) both[l] = u[l] * v[l];
                if (layer) {
                    const Real *const du = to.slope[0].data() + a * n + j, *const dv = to.slope[1].data() + b * n + j;
#pragma omp simd
                    for (int l = 0; l < width; l++) across[l] = normal[0][l] * du[l] * v[l] + normal[1][l] * u[l] * dv[l];
                }
                for (int c = 0; c < to.n[2]; c++, weight += width) {
                    const Real *const w = to.weight[2].data() + c * n + j;
#pragma omp simd
                    for (int l = 0; l < width; l++) weight[l] = both[l] * w[l];
                    if (!layer) continue;
                    const Real *const dw = to.slope[2].data() + c * n + j;
#pragma omp simd
                    for (int l = 0; l < width; l++) slope[l] = across[l] * w[l] + normal[2][l] * both[l] * dw[l];
                    slope += width;
                }
            }
        for (std::int64_t s = 0; s < sounds; s++) {
            const Real *const p = grid_re.data() + s * grid, *const q = grid_im.data() + s * grid;
            Real x[width], y[width], dx[width], dy[width];
            interpolate_line(weights.data(), p, q, to.points, x, y);
            if (layer) {
                interpolate_line(slopes.data(), p, q, to.points, dx, dy);
                multiply(x, y, factor_re, factor_im, width, x, y);
#pragma omp simd
                for (int l = 0; l < width; l++) x[l] += dx[l], y[l] += dy[l];
            }
            const Real *const c = to.wave_re.data() + j, *const d = to.wave_im.data() + j;
            Real *const out_re = re.data() + s * n + j, *const out_im = im.data() + s * n + j;
#pragma omp simd
            for (int l = 0; l < width; l++) {
                out_re[l] += x[l] * c[l] - y[l] * d[l];
                out_im[l] += x[l] * d[l] + y[l] * c[l];
            }
        }
    }
};

}  // namespace

void apply_distant(const double *targets, const double *normals, const std::complex<double> *single, std::int64_t n,
                   const double *sources, std::int64_t m, const std::complex<double> *density, std::int64_t sounds, Wavenumber k,
                   double error, std::complex<double> *out) {
    const std::vector<std::int64_t> order = cluster_order(targets, n), source_order = cluster_order(sources, m);
    const std::vector<Cluster> receivers = clusters_of(targets, order, cluster_size, normals, single, 1, 1);
    const bool layer = normals != nullptr;
    for (std::int64_t first = 0; first < sounds; first += most_sounds) {
        const std::int64_t some = std::min(most_sounds, sounds - first);
        std::vector<std::vector<Cluster>> emitting;  // the halves of cluster c are clusters 2 c and 2 c + 1 of the next level
        for (int level = 0; level <= halvings; level++)
            emitting.push_back(clusters_of(sources, source_order, cluster_size >> level, nullptr, density + first, some, sounds));
#pragma omp parallel
        {
            Sums sums(layer, single != nullptr, some, k);
            std::vector<std::pair<std::size_t, std::size_t>> waiting;
#pragma omp for schedule(dynamic, 1)
            for (std::int64_t t = 0; t < std::int64_t(receivers.size()); t++) {
                const Cluster &to = receivers[t];
                sums.re.assign(some * to.padded, 0), sums.im.assign(some * to.padded, 0);
                for (std::size_t c = 0; c < emitting[0].size(); c++) waiting.emplace_back(0, c);
                while (!waiting.empty()) {
                    const auto [level, c] = waiting.back();
                    waiting.pop_back();
                    const Cluster &from = emitting[level][c];
                    double square = 0;
                    for (int d = 0; d < 3; d++) square += (to.centre[d] - from.centre[d]) * (to.centre[d] - from.centre[d]);
                    const double distance = std::sqrt(square), share = sums.share_of_time(from, to, distance, error);
                    // Where grids save little, those of halves may save more, unless the receivers are too close.
                    if (share > 0.8 && level < halvings && distance > closest * to.radius)
                        for (std::size_t half = 2 * c; half < 2 * c + 2 && half < emitting[level + 1].size(); half++)
                            waiting.emplace_back(level + 1, half);
                    else if (share < 1)
                        sums.add_over_grids(from, to, distance);
                    else
                        sums.add_exact(from, to);
                }
                for (std::int64_t l = 0; l < to.count; l++)
                    for (std::int64_t s = 0; s < some; s++)
                        out[order[t * cluster_size + l] * sounds + first + s] = {sums.re[s * to.padded + l], sums.im[s * to.padded + l]};
            }
        }
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
