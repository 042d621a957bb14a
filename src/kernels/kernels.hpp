// The loops that the solvers call. Arrays are C-contiguous; points are (n, 3); wavenumber is k + i*absorption.
// The same source is compiled once for each instruction set, into a namespace AIRTACT_VARIANT of its own; the module
// includes this file once for each.
#ifndef AIRTACT_KERNEL_TYPES
#define AIRTACT_KERNEL_TYPES
#include <complex>
#include <cstdint>
#include <vector>

namespace airtact {

struct Wavenumber {
    double real, imag;
};

constexpr std::int64_t lanes = 192;  // nodes of a block, those of 32 panels
constexpr std::int64_t sharing = 3;  // nodes that share a second collocation point

template <class Store> struct Arithmetic {  // the type a matrix is computed in, by its number format
    using Real = Store;
};
template <> struct Arithmetic<std::uint32_t> {  // two of bfloat16
    using Real = float;
};

struct NearRows {  // for each target its near panels, and the corrections to the entries of their six nodes
    const std::int64_t *first, *panel;
    const std::complex<double> *excess;
};

struct Pairs {  // of blocks: block t of the rows with blocks column[first[t]] ... column[first[t + 1] - 1], in rising order
    std::int64_t blocks;
    const std::int64_t *first, *column;
};

// For each far block its rank, and where its factors begin: those along its columns first, then those along its rows. A
// factor is `lanes` real parts, then as many imaginary parts, in the format of `Store`.
template <class Store> struct LowRank {
    const std::int64_t *count, *begin;
    const Store *rows;
};

struct NearRule {
    const double *nodes, *weights;  // Gauss-Legendre on [0, 1], rules 1, 2, ... one after another
    std::int64_t largest;           // how many rules
    std::int64_t angular, radial;   // points for a target far from the panel's plane
};

struct Krylov {  // what the steps so far, of `most`, have made of S right-hand sides
    std::int64_t most;
    std::complex<double> *rotations;  // (S, most, 2)
    std::complex<double> *right;      // (S, most + 1), rotated; the size of the number after the last step is the residual
    std::complex<double> *triangles;  // (S, most (most + 1) / 2), column by column
    std::complex<double> *inverses;   // the same of their inverses
    std::complex<double> *weights;    // (S, most), of the vectors in the solution
    double *squares;                  // (S,), the sum of the squares of each inverse
};

struct Steps {  // that move points onto a surface
    std::int64_t most;
    double longest, on_surface;  // no step is longer; nearer points are there
    double stride;            // where they do not converge, the surface is searched so far on ...
    std::int64_t halvings;    // ... and found by halving the way so often
};

}  // namespace airtact
#endif

namespace airtact {
namespace AIRTACT_VARIANT {

// The matrix of the dual-surface equation, M x M, in blocks of `lanes` rows and columns, the last columns padded with zeros:
//   diagonal [i = j] - D(x_i, y_j) + i D(x'_i, y_j) plus the corrections of the near panels, in rising order, to either D,
// where D is the normal derivative at y of e^{ikr}/(4 pi r) times area, here and below plus single[j] e^{ikr}/(4 pi r)
// unless `single` is null; x_i = targets[i], which is y_i or its image in a plane; x'_i = shifted[i / sharing]. A block is
// `lanes` rows, each of `lanes` real parts, then imaginary parts. As bfloat16, the upper half of a float, number
// l + lanes / 2 is in the upper 16 bits of word l, and number l in the lower ones.

// The blocks that are stored whole, one after another. All near panels must be in one of them.
template <class Store>
void dual_blocks(const double *targets, const double *shifted, const double *points, const double *normals,
                const std::complex<double> *single, std::int64_t m, Wavenumber k, double diagonal, NearRows near,
                NearRows near_shifted, Pairs whole, Store *blocks);

// The other blocks as sums of low-rank terms: few of their own columns times few of their own rows, chosen one by one
// (adaptive cross approximation, ACA), until the residuals of three rows in turn, scaled to the block, are below
// `tolerance` in the Frobenius norm. Returns how many factors they take; those beyond `room` are not written.
template <class Store>
std::int64_t dual_low_rank(const double *targets, const double *shifted, const double *points, const double *normals,
                          const std::complex<double> *single, std::int64_t m, Wavenumber k, Pairs far, double tolerance,
                          std::int64_t room, std::int64_t *count, std::int64_t *begin, Store *rows);

// out[s] = A v[s], or A^T v[s], for each of S vectors (S, M)
template <class Store>
void dual_product(Pairs whole, const Store *blocks, Pairs far, LowRank<Store> terms, std::int64_t m,
                  const std::complex<typename Arithmetic<Store>::Real> *v, std::int64_t sounds, bool transposed,
                  std::complex<typename Arithmetic<Store>::Real> *out);

// out[s] = A v[s], or A^T v[s], for each of a few vectors; A is (n, m)
template <class Real>
void few_products(const std::complex<Real> *matrix, std::int64_t n, std::int64_t m, const std::complex<Real> *vectors,
                  std::int64_t count, bool transposed, std::complex<Real> *out);

// The same where row i of A is scales[i] times whole numbers, real and imaginary parts in turn
void few_rounded_products(const std::int16_t *matrix, const float *scales, std::int64_t n, std::int64_t m,
                          const std::complex<float> *vectors, std::int64_t count, bool transposed, std::complex<float> *out);

// Step number `step` of GMRES for S right-hand sides. Vector step + 1 of the bases (step + 2, S, m), the product with the one before
// it, becomes orthogonal to all before it and 1 long; rotations make its overlaps and length a column of a triangle.
template <class Real>
void krylov_step(std::complex<Real> *bases, std::int64_t sides, std::int64_t m, std::int64_t step, const Krylov &spaces);

// Inverts `count` matrices of n rows in place
template <class Real> void invert_blocks(std::complex<Real> *blocks, std::int64_t count, std::int64_t n);

// out[i, j] = D(x_i, y_j)
template <class Real>
void double_layer_matrix(const double *targets, std::int64_t n, const double *sources, const double *normals,
                         const std::complex<double> *single, std::int64_t m, Wavenumber k, std::complex<Real> *out);

// out[i, j] = i D(x'_i, y_j) - D(x_i, y_j), where x'_i = inside[i]
template <class Real>
void dual_matrix(const double *targets, const double *inside, std::int64_t n, const double *sources, const double *normals,
                 const std::complex<double> *single, std::int64_t m, Wavenumber k, std::complex<Real> *out);

// out[i, s] = sum_j D(x_i, y_j) density[j, s], over the sources farther than `least`
template <class Real>
void apply_double_layer(const double *targets, std::int64_t n, const double *sources, const double *normals,
                        const std::complex<double> *single, std::int64_t m, const std::complex<double> *density,
                        std::int64_t sounds, Wavenumber k, double least, std::complex<double> *out);

// out[j, s] = sum_i D(x_i, y_j) strength[i, s]
template <class Real>
void apply_transposed(const double *targets, std::int64_t n, const double *sources, const double *normals,
                      const std::complex<double> *single, std::int64_t m, const std::complex<double> *strength,
                      std::int64_t sounds, Wavenumber k, std::complex<double> *out);

// out[i, s] = sum_j e^{ikr}/r strength[j, s]
template <class Real>
void apply_monopoles(const double *targets, std::int64_t n, const double *sources, std::int64_t m,
                     const std::complex<double> *strength, std::int64_t sounds, Wavenumber k,
                     std::complex<double> *out);

// out[f, e] = straight[f] + sum_h waves[h, f, e] e^{ik(|c_hf - y_f| + |c_hf - x_e| - |y_f - x_e|)}: sound from the foci y to the
// elements x that comes straight, and by way of the centres c (bones, foci, 3). In single precision, on one thread.
void detoured_waves(const double *centres, std::int64_t bones, const double *foci, std::int64_t count, const double *elements,
                    std::int64_t n, const double *straight, const std::complex<float> *waves, double k,
                    std::complex<float> *out);

// The surface integral of finite elements, with G = e^{ikr}/r:
// out[i, s] = sum_j monopoles[j, s] G(x_i, y_j) + dipoles[j, s] dG/dn(y_j)
void surface_integral(const double *points, std::int64_t n, const double *sources, const double *normals,
                      std::int64_t m, const std::complex<double> *monopoles, const std::complex<double> *dipoles,
                      std::int64_t sounds, Wavenumber k, std::complex<double> *out);

// out[i, s] = sum_j strength[j, s] dG/dn(x_i)
void normal_derivative(const double *points, const double *normals, std::int64_t n, const double *sources,
                       std::int64_t m, const std::complex<double> *strength, std::int64_t sounds, Wavenumber k,
                       std::complex<double> *out);

// The targets first[c] ... first[c + 1] - 1 are in cell c. out[i, s] = the sum over the sources nearer than `reach` to the
// centre of the target's cell, or over the others, of D(x_i, y_j) density[j, s] where y_j is farther than `least`, or with
// null normals of e^{ikr}/r density[j, s].
void apply_in_cells(const double *targets, const std::int64_t *first, std::int64_t cells, const double *centres,
                    double reach, bool inside, const double *sources, const double *normals,
                    const std::complex<double> *single, std::int64_t m, const std::complex<double> *density,
                    std::int64_t sounds, Wavenumber k, double least, std::complex<double> *out);

// out[i, s] = sum_j e^{ikr}/r density[j, s] at target i, or with normals the transposed double layer, sum_j D(x_j, y_i)
// density[j, s] at node y_i; with a relative error of about `error` over all i, by interpolation between distant clusters, which
// is faster for thousands of targets and sources. In single precision, with the cluster of the target as origin.
void apply_distant(const double *targets, const double *normals, const std::complex<double> *single, std::int64_t n,
                   const double *sources, std::int64_t m, const std::complex<double> *density, std::int64_t sounds, Wavenumber k,
                   double error, std::complex<double> *out);

// out[i, s] = sum_abc u[i, a] v[i, b] w[i, c] table[first[i] + a steps[0] + b steps[1] + c sounds + s]
void interpolate(const std::complex<float> *table, const std::int64_t *first, std::int64_t n, const std::int64_t *steps,
                 const float *u, std::int64_t us, const float *v, std::int64_t vs, const float *w, std::int64_t ws,
                 std::int64_t sounds, std::complex<double> *out);

// x becomes sum_t factors[t] phi_t x of the sparse matrix A, with phi_0 = 1, phi_1 = A/2 and phi_(t+1) = A phi_t +
// phi_(t-1). x: (n, width); rows: (n + 1), where the entries of each row begin
template <class Real>
void chebyshev_sum(const Real *values, const std::int32_t *columns, const std::int32_t *rows, std::int64_t n,
                   const Real *factors, std::int64_t terms, Real *x, std::int64_t width);

// Panels whose centre is nearer than `reach` to each target, in order. first: (n + 1), where those of each target begin
std::vector<std::int64_t> near_pairs(const double *targets, std::int64_t n, const double *centres, const double *reach,
                                     std::int64_t panels, std::int64_t *first);

// met[i / targets, p / panels] = true for every panel p near a target i; rows of `met` have `columns` numbers. The panels near
// target i are panel[first[i]] ... panel[first[i + 1] - 1]
void mark_blocks(const std::int64_t *first, std::int64_t n, const std::int64_t *panel, std::int64_t targets, std::int64_t panels,
                 std::int64_t columns, bool *met);

// The nodes of six-node panels, their unit normals and the areas that they stand for; centres, and how far a panel's own six
// points are from them at most. Rows of `rule` (19, 6): shape functions at the six nodes, their derivatives along u and along
// v, and at the centre
void place_nodes(const double *panels, std::int64_t n, const double *rule, const double *weights, double *points,
                 double *normals, double *areas, double *centres, double *radii);

// How far the point nearest to a panel is from its six nodes and their middle: the least of these, infinite from `within` on
void panel_distances(const double *panels, std::int64_t n, const double *points, std::int64_t count, double within,
                     double *distance);

// Order of points in which each so many lie together: bisected across the direction of their largest extent, and each half
// again, so that only the last ones may be fewer
void block_order(const double *points, std::int64_t n, std::int64_t each, std::int64_t *order);

// For each target the panel that is closest, the reference coordinates of its closest point and how far that is, of those
// nearer than `distance` says at first; infinitely far where there are none. The
// boxes are a binary tree as a heap: box 1 holds all, box b holds boxes 2 b and 2 b + 1, box leaves + l holds panel
// order[l]. Empty boxes have infinite lower corners. sides: three planes for each
// leaf that its panel lies behind, as unit normals and distances from the origin.
void closest_on_panels(const double *targets, std::int64_t n, const double *quadratic_triangles, const std::int64_t *order,
                       const double *lower, const double *upper, const double *sides, std::int64_t leaves,
                       std::int64_t *panel, double *reference, double *distance);

// out[e, m] = integral over the panel of kernel(x, y) * monomial_m(reference point) dS, m in 1, x, y, xx, xy, yy;
// distance[e] and reference[e] = the closest point's distance and reference coordinates. A target nearer to a panel than its
// contact counts as on it, at its closest point.
void near_integrals(bool single_layer, const double *targets, const std::int64_t *pair_target,
                    const std::int64_t *pair_panel, std::int64_t pairs, const double *quadratic_triangles,
                    const double *contact, Wavenumber k, NearRule rule, std::complex<double> *out, double *distance,
                    double *reference);

// out[e, l] = correction by near panel e to the entry of its node l: the integral over it of kernel(x, y) * L_l, L_l
// being the quadratic that is 1 at node l, less D(x, y_l) where y_l is farther than `least`. The near panels of target i are
// pair_panel[first[i]] ... pair_panel[first[i + 1] - 1]; nodal (6, 6) holds the monomials of each L_l in its columns. All of
// a panel has the single layer of its nodes.
template <class Real>
void near_excess(const double *targets, std::int64_t n, const std::int64_t *first, const std::int64_t *pair_panel,
                 const double *quadratic_triangles, const double *contact, const double *sources, const double *normals,
                 const std::complex<double> *single, const double *nodal, Wavenumber k, double least, NearRule rule, std::complex<double> *out);

// out[i, h] = distance of point i to the hull h of the two or three balls parts[h] (the third -1 for two), negative inside
void hull_distances(const double *points, std::int64_t n, const double *balls, const std::int64_t *parts,
                    std::int64_t count, double *out);

// Distance to the union of hulls, the edges between hulls i and j filled over a blend radius blend[i, j] (1 - n_i n_j)/2, n being
// outward normals. Hulls with apart[i, j] > 0 are each carved out to `carve` around the other, or not at all if 0, but not
// where a hull that joins both is nearer. Hulls farther than the nearest by `reach` are left out. Also its gradient; the
// radius at which it bends there; the distance of the nearest hull that stands apart from the nearest one; the nearest
// hull.
void blended_distance(const double *points, std::int64_t n, const double *balls, const std::int64_t *parts,
                      std::int64_t count, const double *blend, const double *apart, double carve, double reach,
                      double *distance, double *gradient, double *bend, double *facing,
                      std::int64_t *nearest);

// Signed distance to that union, of the three nearest hulls only, its derivatives by centre and radius of each of `some`
// balls (n, 4 some), and the hull that each point belongs to. A closest point whose normal has a cosine to the line to the
// camera below `facing` is compared with the front of the same ball, or its rim; camera is null for none.
void hull_gaps(const double *points, std::int64_t n, const double *balls, std::int64_t some, const std::int64_t *parts,
               std::int64_t count, const double *blend, const double *camera, double facing, double *distance,
               double *gradients, std::int64_t *hull);

// Move points onto that surface, in place, along the gradient of the distance.
void project_on_hulls(double *points, std::int64_t n, const double *balls, const std::int64_t *parts,
                      std::int64_t count, const double *blend, const double *apart, double reach, Steps steps);

// Make the sizes at vertices grow by `grading` times the length of an edge from end to end at most, in some rounds.
void grade_sizes(const double *vertices, const std::int64_t *triangles, std::int64_t count, double grading,
                 std::int64_t rounds, double *sizes);

// One pass towards even triangles with edges about as long as the sizes of their ends, in place: `counts` are the
// vertices and triangles in use, before and after, `most` the vertices and half the triangles that there is room for.
// With `keep` only vertices move. Triangles with a larger cosine than `needle` lose their shortest edge; vertices move
// by `share` of the way to the middle of their neighbours, within the surface.
void even_pass(double *vertices, double *sizes, std::int64_t most, std::int64_t *triangles, std::int64_t *counts,
               bool keep, double needle, double share);

// For each set of foci, `foci_iterations` of GS-PAT on the foci alone, if above 0, and then `iterations` of
// Gerchberg-Saxton with elements at full scale, weighted or not. The matrix is (points, elements); rows (sets, foci) are
// each set's rows of it, wanted (sets, foci) the pressures asked for, 0 for none. In: sources (sets, foci) to start from,
// their magnitudes being the weights. Out: sources of the best iteration (the last one where not weighted), worst (sets) = min |p| /
// wanted then, and drives (sets, elements), all magnitudes 1.
void gerchberg_saxton(const float *real, const float *imag, std::int64_t elements, const std::int64_t *rows,
                      const float *wanted, std::int64_t sets, std::int64_t foci, std::int64_t foci_iterations,
                      std::int64_t iterations, bool weighted, std::complex<float> *sources, float *worst,
                      std::complex<float> *drives);

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
