// What Python sees: shapes checked, the interpreter's lock released, no decision taken here.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/complex.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <optional>
#include <string>
#include <tuple>
#include <type_traits>
#include <vector>

#define AIRTACT_VARIANT baseline
#include "kernels.hpp"
#undef AIRTACT_VARIANT
#ifdef AIRTACT_X86
#define AIRTACT_VARIANT avx2
#include "kernels.hpp"
#undef AIRTACT_VARIANT
#define AIRTACT_VARIANT avx512
#include "kernels.hpp"
#undef AIRTACT_VARIANT
#endif

namespace nb = nanobind;
using namespace airtact;

template <class Real> struct Far {
    decltype(&baseline::double_layer_matrix<Real>) double_layer_matrix;
    decltype(&baseline::apply_transposed<Real>) apply_transposed;
    decltype(&baseline::dual_matrix<Real>) dual_matrix;
    decltype(&baseline::few_products<Real>) few_products;
    decltype(&baseline::krylov_step<Real>) krylov_step;
    decltype(&baseline::apply_double_layer<Real>) apply_double_layer;
    decltype(&baseline::apply_monopoles<Real>) apply_monopoles;
    decltype(&baseline::near_excess<Real>) near_excess;
    decltype(&baseline::chebyshev_sum<Real>) chebyshev_sum;
};

template <class Store> struct Dual {
    decltype(&baseline::dual_blocks<Store>) blocks;
    decltype(&baseline::dual_low_rank<Store>) terms;
    decltype(&baseline::dual_product<Store>) product;
};

struct Variant {
    const char *name;
    std::tuple<Dual<std::uint32_t>, Dual<float>, Dual<double>> dual;
    Far<float> single;
    Far<double> twice;
    decltype(&baseline::apply_in_cells) apply_in_cells;
    decltype(&baseline::interpolate) interpolate;
    decltype(&baseline::detoured_waves) detoured_waves;
    decltype(&baseline::near_pairs) near_pairs;
    decltype(&baseline::block_order) block_order;
    decltype(&baseline::mark_blocks) mark_blocks;
    decltype(&baseline::few_rounded_products) few_rounded_products;
    decltype(&baseline::place_nodes) place_nodes;
    decltype(&baseline::panel_distances) panel_distances;
    decltype(&baseline::closest_on_panels) closest_on_panels;
    decltype(&baseline::near_integrals) near_integrals;
    decltype(&baseline::hull_distances) hull_distances;
    decltype(&baseline::blended_distance) blended_distance;
    decltype(&baseline::hull_gaps) hull_gaps;
    decltype(&baseline::project_on_hulls) project_on_hulls;
    decltype(&baseline::grade_sizes) grade_sizes;
    decltype(&baseline::even_pass) even_pass;
    decltype(&baseline::gerchberg_saxton) gerchberg_saxton;
    decltype(&baseline::surface_integral) surface_integral;
    decltype(&baseline::normal_derivative) normal_derivative;
};

#define AIRTACT_FAR(v, Real)                                                                                         \
    { &v::double_layer_matrix<Real>, &v::apply_transposed<Real>, &v::dual_matrix<Real>, &v::few_products<Real>, &v::krylov_step<Real>,         \
      &v::apply_double_layer<Real>, &v::apply_monopoles<Real>,                                                        \
      &v::near_excess<Real>, &v::chebyshev_sum<Real> }
#define AIRTACT_DUAL(v, Store)                                                                                       \
    Dual<Store> { &v::dual_blocks<Store>, &v::dual_low_rank<Store>, &v::dual_product<Store> }
#define AIRTACT_TABLE(v)                                                                                             \
    { #v, {AIRTACT_DUAL(v, std::uint32_t), AIRTACT_DUAL(v, float), AIRTACT_DUAL(v, double)}, AIRTACT_FAR(v, float), AIRTACT_FAR(v, double), &v::apply_in_cells, &v::interpolate, &v::detoured_waves, &v::near_pairs, &v::block_order, &v::mark_blocks, &v::few_rounded_products, &v::place_nodes, &v::panel_distances, &v::closest_on_panels, \
      &v::near_integrals, &v::hull_distances, &v::blended_distance, &v::hull_gaps, &v::project_on_hulls, &v::grade_sizes, \
      &v::even_pass, &v::gerchberg_saxton, &v::surface_integral, &v::normal_derivative }

static std::vector<Variant> runnable() {  // on this machine, the best last
    std::vector<Variant> found{AIRTACT_TABLE(baseline)};
#ifdef AIRTACT_X86
    const bool fused = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    if (fused) found.push_back(AIRTACT_TABLE(avx2));
    if (fused && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl"))
        found.push_back(AIRTACT_TABLE(avx512));
#endif
    return found;
}

static const std::vector<Variant> variants = runnable();
static const Variant *active = &variants.back();

template <class Real> const Far<Real> &far();
template <> const Far<float> &far<float>() { return active->single; }
template <> const Far<double> &far<double>() { return active->twice; }

static void use(const std::string &name) {
    for (const Variant &variant : variants)
        if (name == variant.name) {
            active = &variant;
            return;
        }
    throw nb::value_error(("this machine does not run the variant " + name).c_str());
}

template <class T, int... n> using Read = nb::ndarray<const T, nb::shape<n...>, nb::c_contig, nb::device::cpu>;
template <class T, int... n> using Write = nb::ndarray<T, nb::shape<n...>, nb::c_contig, nb::device::cpu>;
using Points = Read<double, -1, 3>;
using Complex = std::complex<double>;

static void same(std::size_t a, std::size_t b) {
    if (a != b) throw nb::value_error("arrays of different lengths");
}

using Single = Read<Complex, -1>;

static const Complex *single_of(Single given, std::size_t nodes) {  // none if empty
    if (given.shape(0) == 0) return nullptr;
    same(given.shape(0), nodes);
    return given.data();
}

static Wavenumber wave(Complex k) { return {k.real(), k.imag()}; }

using Index = Read<std::int64_t, -1>;
using Line = Read<double, -1>;
using Near = Read<Complex, -1, 6>;

static NearRows near_rows(Points x, std::size_t nodes, Index first, Index panel, Near excess) {
    same(first.shape(0), x.shape(0) + 1), same(panel.shape(0), excess.shape(0));
    same(panel.shape(0), std::size_t(first.data()[x.shape(0)]));
    for (std::size_t e = 0; e < panel.shape(0); e++)
        if (panel.data()[e] < 0 || 6 * panel.data()[e] + 6 > std::int64_t(nodes))
            throw nb::index_error("a near panel does not exist");
    for (std::size_t i = 0; i < x.shape(0); i++)
        if (first.data()[i] < 0 || first.data()[i] > first.data()[i + 1] || !std::is_sorted(panel.data() + first.data()[i], panel.data() + first.data()[i + 1]))
            throw nb::value_error("near panels out of order");
    return {first.data(), panel.data(), excess.data()};
}

template <class Store>  // two bfloat16 are one word
constexpr int words = std::is_same_v<std::remove_const_t<Store>, std::uint32_t> ? lanes / 2 : lanes;
template <class Store>
using Blocks = nb::ndarray<Store, nb::shape<-1, lanes, 2, words<Store>>, nb::c_contig, nb::device::cpu>;
template <class Store> using Rows = nb::ndarray<Store, nb::shape<-1, 2, words<Store>>, nb::c_contig, nb::device::cpu>;

static Pairs pairs(Index first, Index column, std::size_t m) {
    const std::size_t blocks = (m + lanes - 1) / lanes;
    same(first.shape(0), blocks + 1);
    const std::int64_t *from = first.data();
    same(column.shape(0), std::size_t(from[blocks]));
    for (std::size_t t = 0; t < blocks; t++)
        if (from[t] < 0 || from[t] > from[t + 1] || !std::is_sorted(column.data() + from[t], column.data() + from[t + 1]))
            throw nb::value_error("blocks out of order");
    for (std::size_t e = 0; e < column.shape(0); e++)
        if (column.data()[e] < 0 || column.data()[e] >= std::int64_t(blocks)) throw nb::index_error("a block does not exist");
    return {std::int64_t(blocks), from, column.data()};
}

static void all_in(const NearRows &near, std::size_t targets, std::int64_t each, const Pairs &whole) {
    for (std::size_t i = 0; i < targets; i++) {
        const std::int64_t block = std::int64_t(i) * each / lanes;
        const std::int64_t *begin = whole.column + whole.first[block], *end = whole.column + whole.first[block + 1];
        for (std::int64_t e = near.first[i]; e < near.first[i + 1]; e++)
            if (!std::binary_search(begin, end, 6 * near.panel[e] / lanes))
                throw nb::value_error("a near panel is in a block that is not whole");
    }
}

template <class Store>
void dual_blocks(Points x, Points x2, Points y, Points a, Single single, Complex k, double diagonal, Index first, Index panel, Near excess,
                Index first_shifted, Index panel_shifted, Near excess_shifted, Index whole_first, Index whole_column,
                Blocks<Store> out) {
    const std::size_t m = y.shape(0);
    same(m, x.shape(0)), same(m, sharing * x2.shape(0)), same(m, a.shape(0));
    const Pairs whole = pairs(whole_first, whole_column, m);
    same(out.shape(0), whole_column.shape(0));
    const NearRows near = near_rows(x, m, first, panel, excess);
    const NearRows near_shifted = near_rows(x2, m, first_shifted, panel_shifted, excess_shifted);
    all_in(near, m, 1, whole), all_in(near_shifted, m / sharing, sharing, whole);
    const Complex *of = single_of(single, m);
    nb::gil_scoped_release release;
    std::get<Dual<Store>>(active->dual)
        .blocks(x.data(), x2.data(), y.data(), a.data(), of, std::int64_t(m), wave(k), diagonal, near, near_shifted, whole,
                out.data());
}

template <class Store>
std::int64_t dual_low_rank(Points x, Points x2, Points y, Points a, Single single, Complex k, Index far_first, Index far_column,
                          double tolerance, Write<std::int64_t, -1> count, Write<std::int64_t, -1> begin,
                          Rows<Store> out) {
    const std::size_t m = y.shape(0);
    same(m, x.shape(0)), same(m, sharing * x2.shape(0)), same(m, a.shape(0));
    const Pairs far = pairs(far_first, far_column, m);
    const Complex *of = single_of(single, m);
    same(count.shape(0), far_column.shape(0)), same(begin.shape(0), far_column.shape(0));
    nb::gil_scoped_release release;
    return std::get<Dual<Store>>(active->dual)
        .terms(x.data(), x2.data(), y.data(), a.data(), of, std::int64_t(m), wave(k), far, tolerance,
                 std::int64_t(out.shape(0)), count.data(), begin.data(), out.data());
}

template <class Store>
void product(Index whole_first, Index whole_column, Blocks<const Store> blocks, Index far_first, Index far_column,
             Index count, Index begin, Rows<const Store> terms,
             Read<std::complex<typename Arithmetic<Store>::Real>, -1, -1> v, bool transposed,
             Write<std::complex<typename Arithmetic<Store>::Real>, -1, -1> out) {
    const std::size_t m = v.shape(1);
    const Pairs whole = pairs(whole_first, whole_column, m), far = pairs(far_first, far_column, m);
    same(blocks.shape(0), whole_column.shape(0));
    same(count.shape(0), far_column.shape(0)), same(begin.shape(0), far_column.shape(0));
    for (std::size_t e = 0; e < count.shape(0); e++)
        if (count.data()[e] < 0 || count.data()[e] > lanes || begin.data()[e] < 0 ||
            begin.data()[e] + 2 * count.data()[e] > std::int64_t(terms.shape(0)))
            throw nb::index_error("a low-rank term does not exist");
    same(v.shape(0), out.shape(0)), same(m, out.shape(1));
    nb::gil_scoped_release release;
    std::get<Dual<Store>>(active->dual)
        .product(whole, blocks.data(), far, {count.data(), begin.data(), terms.data()}, std::int64_t(m), v.data(),
                 v.shape(0), transposed, out.data());
}

template <class Real>
void layer_matrix(Points x, Points y, Points a, Single single, Complex k, Write<std::complex<Real>, -1, -1> out) {
    same(y.shape(0), a.shape(0)), same(out.shape(0), x.shape(0)), same(out.shape(1), y.shape(0));
    const Complex *of = single_of(single, y.shape(0));
    nb::gil_scoped_release release;
    far<Real>().double_layer_matrix(x.data(), x.shape(0), y.data(), a.data(), of, y.shape(0), wave(k), out.data());
}

template <class Real>
void transposed_layer(Points x, Points y, Points a, Single single, Read<Complex, -1, -1> strength, Complex k,
                      Write<Complex, -1, -1> out) {
    same(y.shape(0), a.shape(0)), same(strength.shape(0), x.shape(0));
    same(out.shape(0), y.shape(0)), same(out.shape(1), strength.shape(1));
    const Complex *of = single_of(single, y.shape(0));
    nb::gil_scoped_release release;
    far<Real>().apply_transposed(x.data(), x.shape(0), y.data(), a.data(), of, y.shape(0), strength.data(), strength.shape(1),
                                 wave(k), out.data());
}

template <class Real>
void both_layers(Points x, Points x2, Points y, Points a, Single single, Complex k, Write<std::complex<Real>, -1, -1> out) {
    same(x.shape(0), x2.shape(0)), same(y.shape(0), a.shape(0));
    same(out.shape(0), x.shape(0)), same(out.shape(1), y.shape(0));
    const Complex *of = single_of(single, y.shape(0));
    nb::gil_scoped_release release;
    far<Real>().dual_matrix(x.data(), x2.data(), x.shape(0), y.data(), a.data(), of, y.shape(0), wave(k), out.data());
}

template <class Real>
void few(Read<std::complex<Real>, -1, -1> matrix, Read<std::complex<Real>, -1, -1> vectors, bool transposed,
         Write<std::complex<Real>, -1, -1> out) {
    same(vectors.shape(0), out.shape(0));
    same(vectors.shape(1), matrix.shape(transposed ? 0 : 1)), same(out.shape(1), matrix.shape(transposed ? 1 : 0));
    nb::gil_scoped_release release;
    far<Real>().few_products(matrix.data(), matrix.shape(0), matrix.shape(1), vectors.data(), vectors.shape(0), transposed,
                             out.data());
}

static void few_rounded(Read<std::int16_t, -1, -1, 2> matrix, Read<float, -1> scales, Read<std::complex<float>, -1, -1> vectors,
                        bool transposed, Write<std::complex<float>, -1, -1> out) {
    same(vectors.shape(0), out.shape(0)), same(scales.shape(0), matrix.shape(0));
    same(vectors.shape(1), matrix.shape(transposed ? 0 : 1)), same(out.shape(1), matrix.shape(transposed ? 1 : 0));
    nb::gil_scoped_release release;
    active->few_rounded_products(matrix.data(), scales.data(), matrix.shape(0), matrix.shape(1), vectors.data(), vectors.shape(0),
                                 transposed, out.data());
}

template <class Real>
void krylov(Write<std::complex<Real>, -1, -1, -1> bases, Write<Complex, -1, -1, 2> rotations, Write<Complex, -1, -1> right,
            Write<Complex, -1, -1> triangles, Write<Complex, -1, -1> inverses, Write<Complex, -1, -1> weights, Write<double, -1> squares) {
    const std::size_t sides = bases.shape(1), most = rotations.shape(1), vectors = bases.shape(0), packed = most * (most + 1) / 2;
    same(rotations.shape(0), sides), same(squares.shape(0), sides);
    same(right.shape(0), sides), same(right.shape(1), most + 1), same(weights.shape(0), sides), same(weights.shape(1), most);
    same(triangles.shape(0), sides), same(triangles.shape(1), packed), same(inverses.shape(0), sides), same(inverses.shape(1), packed);
    if (vectors < 2 || vectors > most + 1) throw nb::value_error("no room for the step");
    nb::gil_scoped_release release;
    far<Real>().krylov_step(bases.data(), sides, bases.shape(2), std::int64_t(vectors) - 2,
                            {std::int64_t(most), rotations.data(), right.data(), triangles.data(), inverses.data(), weights.data(),
                             squares.data()});
}

template <class Real>
void layer(Points x, Points y, Points a, Single single, Read<Complex, -1, -1> density, Complex k, double least,
           Write<Complex, -1, -1> out) {
    same(y.shape(0), a.shape(0)), same(density.shape(0), y.shape(0));
    same(out.shape(0), x.shape(0)), same(out.shape(1), density.shape(1));
    const Complex *of = single_of(single, y.shape(0));
    nb::gil_scoped_release release;
    far<Real>().apply_double_layer(x.data(), x.shape(0), y.data(), a.data(), of, y.shape(0), density.data(), density.shape(1),
                             wave(k), least, out.data());
}

template <class Real>
void monopoles(Points x, Points y, Read<Complex, -1, -1> strength, Complex k, Write<Complex, -1, -1> out) {
    same(strength.shape(0), y.shape(0));
    same(out.shape(0), x.shape(0)), same(out.shape(1), strength.shape(1));
    nb::gil_scoped_release release;
    far<Real>().apply_monopoles(x.data(), x.shape(0), y.data(), y.shape(0), strength.data(), strength.shape(1), wave(k),
                          out.data());
}

static void detoured(Read<double, -1, -1, 3> centres, Points foci, Points elements, Line straight,
                     Read<std::complex<float>, -1, -1, -1> waves, double k, Write<std::complex<float>, -1, -1> out) {
    const std::size_t bones = centres.shape(0), count = foci.shape(0), n = elements.shape(0);
    same(centres.shape(1), count), same(straight.shape(0), count), same(out.shape(0), count), same(out.shape(1), n);
    same(waves.shape(0), bones), same(waves.shape(1), count), same(waves.shape(2), n);
    nb::gil_scoped_release release;
    active->detoured_waves(centres.data(), bones, foci.data(), count, elements.data(), n, straight.data(), waves.data(), k,
                           out.data());
}

static void whole_surface(Points x, Points y, Points a, Read<Complex, -1, -1> single, Read<Complex, -1, -1> twin,
                          Complex k, Write<Complex, -1, -1> out) {
    same(y.shape(0), a.shape(0)), same(single.shape(0), y.shape(0)), same(twin.shape(0), y.shape(0));
    same(out.shape(0), x.shape(0)), same(out.shape(1), single.shape(1)), same(out.shape(1), twin.shape(1));
    nb::gil_scoped_release release;
    active->surface_integral(x.data(), x.shape(0), y.data(), a.data(), y.shape(0), single.data(), twin.data(),
                             out.shape(1), wave(k), out.data());
}

static void along_normals(Points x, Points a, Points y, Read<Complex, -1, -1> strength, Complex k,
                          Write<Complex, -1, -1> out) {
    same(x.shape(0), a.shape(0)), same(strength.shape(0), y.shape(0));
    same(out.shape(0), x.shape(0)), same(out.shape(1), strength.shape(1));
    nb::gil_scoped_release release;
    active->normal_derivative(x.data(), a.data(), x.shape(0), y.data(), y.shape(0), strength.data(), out.shape(1),
                              wave(k), out.data());
}

static void in_cells(Points x, Index first, Points centres, double reach, bool inside, Points y, std::optional<Points> a,
              Single single, Read<Complex, -1, -1> density, Complex k, double least, Write<Complex, -1, -1> out) {
    const std::int64_t cells = std::int64_t(centres.shape(0));
    same(first.shape(0), centres.shape(0) + 1), same(density.shape(0), y.shape(0));
    same(out.shape(0), x.shape(0)), same(out.shape(1), density.shape(1)), same(a ? a->shape(0) : y.shape(0), y.shape(0));
    for (std::int64_t c = 0; c < cells; c++)
        if (first.data()[c] > first.data()[c + 1]) throw nb::index_error("a cell ends before it begins");
    same(first.data()[0], 0), same(std::size_t(first.data()[cells]), x.shape(0));
    const Complex *of = single_of(single, y.shape(0));
    nb::gil_scoped_release release;
    active->apply_in_cells(x.data(), first.data(), cells, centres.data(), reach, inside, y.data(),
                           a ? a->data() : nullptr, of, y.shape(0), density.data(), density.shape(1), wave(k), least,
                           out.data());
}

static void interpolated(Read<std::complex<float>, -1> table, Index first, Read<std::int64_t, 2> steps,
                         Read<float, -1, -1> u, Read<float, -1, -1> v, Read<float, -1, -1> w,
                         Write<Complex, -1, -1> out) {
    const std::size_t n = first.shape(0), sounds = out.shape(1);
    same(u.shape(0), n), same(v.shape(0), n), same(w.shape(0), n), same(out.shape(0), n);
    const std::int64_t last = (std::int64_t(u.shape(1)) - 1) * steps.data()[0] +
                              (std::int64_t(v.shape(1)) - 1) * steps.data()[1] + std::int64_t(w.shape(1) * sounds);
    for (std::size_t i = 0; i < n; i++)
        if (first.data()[i] < 0 || first.data()[i] + last > std::int64_t(table.shape(0)))
            throw nb::index_error("a value lies beyond the table");
    nb::gil_scoped_release release;
    active->interpolate(table.data(), first.data(), n, steps.data(), u.data(), u.shape(1), v.data(), v.shape(1), w.data(),
                        w.shape(1), sounds, out.data());
}

template <class Real>
static void chebyshev(Read<Real, -1> values, Read<std::int32_t, -1> columns, Read<std::int32_t, -1> rows,
                      Read<Real, -1> factors, Write<Real, -1, -1> x) {
    const std::size_t n = x.shape(0);
    const std::int32_t *ends = rows.data();
    same(columns.shape(0), values.shape(0)), same(rows.shape(0), n + 1);
    if (!factors.shape(0)) throw nb::value_error("a sum of no terms");
    bool right = ends[0] == 0 && std::size_t(ends[n]) == values.shape(0);
    for (std::size_t i = 0; i < n; i++) right = right && ends[i] <= ends[i + 1];
    for (std::size_t e = 0; e < values.shape(0); e++)
        right = right && columns.data()[e] >= 0 && std::size_t(columns.data()[e]) < n;
    if (!right) throw nb::index_error("an entry lies beyond the matrix");
    nb::gil_scoped_release release;
    far<Real>().chebyshev_sum(values.data(), columns.data(), ends, n, factors.data(), factors.shape(0), x.data(),
                                       x.shape(1));
}

using Numbers = nb::ndarray<nb::numpy, std::int64_t, nb::ndim<1>>;

static Numbers array_of(std::vector<std::int64_t> &&numbers) {
    numbers.reserve(1);  // or no numbers would have no address
    auto *kept = new std::vector<std::int64_t>(std::move(numbers));
    nb::capsule owner(kept, [](void *one) noexcept { delete static_cast<std::vector<std::int64_t> *>(one); });
    return {kept->data(), {kept->size()}, owner};
}

static std::pair<Numbers, Numbers> near_pairs(Points x, Points centres, Line reach) {
    same(centres.shape(0), reach.shape(0));
    std::vector<std::int64_t> first(x.shape(0) + 1), panel;
    {
        nb::gil_scoped_release release;
        panel = active->near_pairs(x.data(), x.shape(0), centres.data(), reach.data(), centres.shape(0), first.data());
    }
    return {array_of(std::move(first)), array_of(std::move(panel))};
}

static void panel_distances(Read<double, -1, 6, 3> panels, Points points, double within, Write<double, -1> distance) {
    same(panels.shape(0), distance.shape(0));
    nb::gil_scoped_release release;
    active->panel_distances(panels.data(), panels.shape(0), points.data(), points.shape(0), within, distance.data());
}

static void mark_blocks(Index first, Index panel, std::int64_t targets, std::int64_t panels, Write<bool, -1, -1> met) {
    const std::int64_t n = std::int64_t(first.shape(0)) - 1, pairs = panel.shape(0), rows = met.shape(0), columns = met.shape(1);
    if (targets < 1 || panels < 1) throw nb::value_error("blocks of no targets or panels");
    if (n < 0 || first.data()[n] != pairs || (n > 0 && (n - 1) / targets >= rows)) throw nb::index_error("no such block");
    for (std::int64_t i = 0; i < n; i++)
        if (first.data()[i] < 0 || first.data()[i] > first.data()[i + 1]) throw nb::value_error("the list of a target ends before it begins");
    for (std::int64_t e = 0; e < pairs; e++)
        if (panel.data()[e] < 0 || panel.data()[e] / panels >= columns) throw nb::index_error("no such block");
    nb::gil_scoped_release release;
    active->mark_blocks(first.data(), n, panel.data(), targets, panels, columns, met.data());
}

static void place_nodes(Read<double, -1, 6, 3> panels, Read<double, 19, 6> rule, Read<double, 6> weights, Write<double, -1, 3> points,
                        Write<double, -1, 3> normals, Write<double, -1> areas, Write<double, -1, 3> centres,
                        Write<double, -1> radii) {
    const std::size_t n = panels.shape(0);
    same(points.shape(0), 6 * n), same(normals.shape(0), 6 * n), same(areas.shape(0), 6 * n);
    same(centres.shape(0), n), same(radii.shape(0), n);
    nb::gil_scoped_release release;
    active->place_nodes(panels.data(), n, rule.data(), weights.data(), points.data(), normals.data(), areas.data(),
                        centres.data(), radii.data());
}

static void block_order(Points points, std::int64_t each, Write<std::int64_t, -1> order) {
    same(points.shape(0), order.shape(0));
    if (each < 1) throw nb::value_error("blocks of no points");
    nb::gil_scoped_release release;
    active->block_order(points.data(), points.shape(0), each, order.data());
}

static void near(bool single_layer, Points targets, Index pair_target, Index pair_panel, Read<double, -1, 6, 3> panels,
                 Line contact, Complex k, Line nodes, Line weights, int largest, int angular, int radial, Write<Complex, -1, 6> out,
                 Write<double, -1> distance, Write<double, -1, 2> reference) {
    const std::size_t pairs = pair_target.shape(0);
    same(pairs, pair_panel.shape(0)), same(pairs, out.shape(0)), same(pairs, distance.shape(0));
    same(panels.shape(0), contact.shape(0));
    same(pairs, reference.shape(0)), same(nodes.shape(0), std::size_t(largest * (largest + 1) / 2));
    same(nodes.shape(0), weights.shape(0));
    nb::gil_scoped_release release;
    active->near_integrals(single_layer, targets.data(), pair_target.data(), pair_panel.data(), std::int64_t(pairs),
                   panels.data(), contact.data(), wave(k), {nodes.data(), weights.data(), largest, angular, radial}, out.data(),
                   distance.data(), reference.data());
}

template <class Real>
void excess(Points targets, Index first, Index panel, Read<double, -1, 6, 3> panels, Line contact, Points sources,
            Points normals, Single single, Read<double, 6, 6> nodal, Complex k, double least, Line nodes, Line weights, int largest,
            int angular, int radial, Write<Complex, -1, 6> out) {
    same(first.shape(0), targets.shape(0) + 1), same(panel.shape(0), out.shape(0));
    same(panel.shape(0), std::size_t(first.data()[targets.shape(0)]));
    same(panels.shape(0), contact.shape(0)), same(6 * panels.shape(0), sources.shape(0));
    same(sources.shape(0), normals.shape(0)), same(nodes.shape(0), std::size_t(largest * (largest + 1) / 2));
    same(nodes.shape(0), weights.shape(0));
    const Complex *of = single_of(single, sources.shape(0));
    nb::gil_scoped_release release;
    far<Real>().near_excess(targets.data(), targets.shape(0), first.data(), panel.data(), panels.data(), contact.data(),
                            sources.data(), normals.data(), of, nodal.data(), wave(k), least,
                            {nodes.data(), weights.data(), largest, angular, radial}, out.data());
}

static void closest(Points targets, Read<double, -1, 6, 3> panels, Index order, Points lower, Points upper,
                    Write<std::int64_t, -1> panel, Write<double, -1, 2> reference, Write<double, -1> distance) {
    same(panels.shape(0), order.shape(0)), same(lower.shape(0), upper.shape(0));
    same(targets.shape(0), panel.shape(0)), same(targets.shape(0), reference.shape(0));
    same(targets.shape(0), distance.shape(0));
    nb::gil_scoped_release release;
    active->closest_on_panels(targets.data(), targets.shape(0), panels.data(), order.data(), panels.shape(0), lower.data(),
                              upper.data(), lower.shape(0) / 2, panel.data(), reference.data(), distance.data());
}

static void saxton(Read<float, -1, -1> real, Read<float, -1, -1> imag, Read<std::int64_t, -1, -1> rows,
                   Read<float, -1, -1> wanted, std::int64_t foci_iterations, std::int64_t iterations, bool weighted,
                   Write<std::complex<float>, -1, -1> sources, Write<float, -1> worst,
                   Write<std::complex<float>, -1, -1> drives) {
    const std::size_t sets = rows.shape(0), foci = rows.shape(1), points = real.shape(0), elements = real.shape(1);
    same(imag.shape(0), points), same(imag.shape(1), elements);
    same(wanted.shape(0), sets), same(wanted.shape(1), foci), same(sources.shape(0), sets), same(sources.shape(1), foci);
    same(worst.shape(0), sets), same(drives.shape(0), sets), same(drives.shape(1), elements);
    for (std::size_t i = 0; i < sets * foci; i++)
        if (rows.data()[i] < 0 || rows.data()[i] >= std::int64_t(points))
            throw nb::index_error("a set has a row that the matrix does not have");
    nb::gil_scoped_release release;
    active->gerchberg_saxton(real.data(), imag.data(), elements, rows.data(), wanted.data(), sets, foci, foci_iterations, iterations, weighted,
                             sources.data(), worst.data(), drives.data());
}

using Square = Read<double, -1, -1>;
using Hulls = Read<std::int64_t, -1, 3>;

static void right_balls(Read<double, -1, 4> balls, Hulls parts) {
    for (std::size_t i = 0; i < 3 * parts.shape(0); i++)
        if (parts.data()[i] < (i % 3 == 2 ? -1 : 0) || parts.data()[i] >= std::int64_t(balls.shape(0)))
            throw nb::index_error("a hull has a ball that does not exist");
}

static void apart_from_hulls(Points x, Read<double, -1, 4> balls, Hulls parts, Write<double, -1, -1> out) {
    right_balls(balls, parts);
    same(out.shape(0), x.shape(0)), same(out.shape(1), parts.shape(0));
    nb::gil_scoped_release release;
    active->hull_distances(x.data(), x.shape(0), balls.data(), parts.data(), parts.shape(0), out.data());
}

static void blended(Points x, Read<double, -1, 4> balls, Hulls parts, Square blend, Square apart,
                    double carve, double reach, Write<double, -1> distance, Write<double, -1, 3> gradient,
                    Write<double, -1> bend, Write<double, -1> facing, Write<std::int64_t, -1> nearest) {
    right_balls(balls, parts);
    for (const Square &table : {blend, apart})
        same(table.shape(0), parts.shape(0)), same(table.shape(1), parts.shape(0));
    same(distance.shape(0), x.shape(0)), same(gradient.shape(0), x.shape(0)), same(bend.shape(0), x.shape(0));
    same(facing.shape(0), x.shape(0)), same(nearest.shape(0), x.shape(0));
    nb::gil_scoped_release release;
    active->blended_distance(x.data(), x.shape(0), balls.data(), parts.data(), parts.shape(0), blend.data(), apart.data(),
                             carve, reach, distance.data(), gradient.data(), bend.data(), facing.data(),
                             nearest.data());
}

static void gaps(Points x, Read<double, -1, 4> balls, Hulls parts, Square blend, Read<double, -1> camera, double facing,
                 Write<double, -1> distance, Write<double, -1, -1> gradients, Write<std::int64_t, -1> hull) {
    right_balls(balls, parts);
    same(blend.shape(0), parts.shape(0)), same(blend.shape(1), parts.shape(0));
    same(distance.shape(0), x.shape(0)), same(gradients.shape(0), x.shape(0)), same(hull.shape(0), x.shape(0));
    same(gradients.shape(1), 4 * balls.shape(0));
    if (parts.shape(0) == 0) throw nb::index_error("there is no hull");
    if (camera.shape(0) > 0) same(camera.shape(0), 3);
    nb::gil_scoped_release release;
    active->hull_gaps(x.data(), x.shape(0), balls.data(), balls.shape(0), parts.data(), parts.shape(0), blend.data(),
                      camera.shape(0) > 0 ? camera.data() : nullptr, facing, distance.data(), gradients.data(),
                      hull.data());
}

static void on_hulls(Write<double, -1, 3> x, Read<double, -1, 4> balls, Hulls parts, Square blend, Square apart,
                     double reach, std::int64_t most, double longest, double on_surface, double stride,
                     std::int64_t halvings) {
    right_balls(balls, parts);
    for (const Square &table : {blend, apart})
        same(table.shape(0), parts.shape(0)), same(table.shape(1), parts.shape(0));
    nb::gil_scoped_release release;
    active->project_on_hulls(x.data(), x.shape(0), balls.data(), parts.data(), parts.shape(0), blend.data(),
                             apart.data(), reach, {most, longest, on_surface, stride, halvings});
}

template <class Triangles> static void right_vertices(Triangles triangles, std::int64_t used, std::size_t vertices) {
    for (std::int64_t i = 0; i < 3 * used; i++)
        if (triangles.data()[i] < 0 || triangles.data()[i] >= std::int64_t(vertices))
            throw nb::index_error("a triangle has a vertex that does not exist");
}

static void graded(Points x, Hulls triangles, double grading, std::int64_t rounds, Write<double, -1> sizes) {
    same(x.shape(0), sizes.shape(0));
    right_vertices(triangles, triangles.shape(0), x.shape(0));
    nb::gil_scoped_release release;
    active->grade_sizes(x.data(), triangles.data(), triangles.shape(0), grading, rounds, sizes.data());
}

static void even(Write<double, -1, 3> vertices, Write<double, -1> sizes, Write<std::int64_t, -1, 3> triangles,
                 Write<std::int64_t, 2> counts, bool keep, double needle, double share) {
    same(vertices.shape(0), sizes.shape(0)), same(2 * vertices.shape(0), triangles.shape(0));
    right_vertices(triangles, counts.data()[1], counts.data()[0]);
    nb::gil_scoped_release release;
    active->even_pass(vertices.data(), sizes.data(), vertices.shape(0), triangles.data(), counts.data(), keep, needle,
                      share);
}

// A pointer of this type is what pyautd3's library calls once for each element: context, geometry, board, element, and
// where the drive goes, phase in the low byte. The context is a table of words, elements_of_a_board a board.
struct Words {
    const std::uint16_t *words;
    std::int64_t elements_of_a_board;
};

static void word_of_element(const Words *table, const void *, std::uint16_t board, std::uint8_t element,
                            std::uint8_t *drive) {
    const std::uint16_t word = table->words[board * table->elements_of_a_board + element];
    drive[0] = word & 0xFF, drive[1] = word >> 8;
}

NB_MODULE(_kernels, m) {
    m.doc() = "The compiled loops; kernels.hpp documents each.";
    m.def("variants", [] {
        nb::list names;
        for (const Variant &variant : variants) names.append(variant.name);
        return names;
    });
    m.def("active_variant", [] { return active->name; });
    m.def("use_variant", &use);
    m.attr("lanes") = lanes;
    m.attr("sharing") = sharing;
    m.attr("word_of_element") = reinterpret_cast<std::uintptr_t>(&word_of_element);
    m.def("dual_blocks_bfloat16", &dual_blocks<std::uint32_t>);
    m.def("dual_low_rank_bfloat16", &dual_low_rank<std::uint32_t>);
    m.def("dual_blocks_float32", &dual_blocks<float>);
    m.def("dual_low_rank_float32", &dual_low_rank<float>);
    m.def("dual_blocks_float64", &dual_blocks<double>);
    m.def("dual_low_rank_float64", &dual_low_rank<double>);
    m.def("dual_product_bfloat16", &product<std::uint32_t>);
    m.def("dual_product_float32", &product<float>);
    m.def("dual_product_float64", &product<double>);
    m.def("double_layer_matrix_float32", &layer_matrix<float>);
    m.def("double_layer_matrix_float64", &layer_matrix<double>);
    m.def("apply_transposed_float32", &transposed_layer<float>);
    m.def("apply_transposed_float64", &transposed_layer<double>);
    m.def("dual_matrix_float32", &both_layers<float>);
    m.def("dual_matrix_float64", &both_layers<double>);
    m.def("few_products_float32", &few<float>);
    m.def("few_products_float64", &few<double>);
    m.def("few_rounded_products", &few_rounded);
    m.def("krylov_step_float32", &krylov<float>);
    m.def("krylov_step_float64", &krylov<double>);
    m.def("apply_double_layer_float32", &layer<float>);
    m.def("apply_double_layer_float64", &layer<double>);
    m.def("apply_monopoles_float32", &monopoles<float>);
    m.def("apply_monopoles_float64", &monopoles<double>);
    m.def("surface_integral", &whole_surface);
    m.def("normal_derivative", &along_normals);
    m.def("apply_in_cells", &in_cells, nb::arg("targets"), nb::arg("first"), nb::arg("centres"), nb::arg("reach"),
          nb::arg("inside"), nb::arg("sources"), nb::arg("normals").none(), nb::arg("single"), nb::arg("density"), nb::arg("wavenumber"),
          nb::arg("least"), nb::arg("out"));
    m.def("near_excess_float32", &excess<float>);
    m.def("near_excess_float64", &excess<double>);
    m.def("interpolate", &interpolated);
    m.def("detoured_waves", &detoured);
    m.def("chebyshev_sum_float32", &chebyshev<float>);
    m.def("chebyshev_sum_float64", &chebyshev<double>);
    m.def("near_pairs", &near_pairs);
    m.def("block_order", &block_order);
    m.def("mark_blocks", &mark_blocks);
    m.def("place_nodes", &place_nodes);
    m.def("panel_distances", &panel_distances);
    m.def("closest_on_panels", &closest);
    m.def("near_integrals", &near);
    m.def("hull_distances", &apart_from_hulls);
    m.def("blended_distance", &blended);
    m.def("hull_gaps", &gaps);
    m.def("project_on_hulls", &on_hulls);
    m.def("grade_sizes", &graded);
    m.def("even_pass", &even);
    m.def("gerchberg_saxton", &saxton);
}
