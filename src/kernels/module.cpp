// What Python sees: shapes checked, the interpreter's lock released, no decision taken here.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/complex.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <initializer_list>
#include <limits>
#include <optional>
#include <string>
#include <tuple>
#include <type_traits>
#include <vector>

#define AIRTACT_VARIANT baseline
#include "kernels.hpp"
#undef AIRTACT_VARIANT
#define AIRTACT_VARIANT avx2
#include "kernels.hpp"
#undef AIRTACT_VARIANT
#define AIRTACT_VARIANT avx512
#include "kernels.hpp"
#undef AIRTACT_VARIANT

namespace nb = nanobind;
using namespace airtact;

template <class Real> struct Far {
    decltype(&baseline::double_layer_matrix<Real>) double_layer_matrix;
    decltype(&baseline::apply_transposed<Real>) apply_transposed;
    decltype(&baseline::dual_matrix<Real>) dual_matrix;
    decltype(&baseline::few_products<Real>) few_products;
    decltype(&baseline::krylov_step<Real>) krylov_step;
    decltype(&baseline::invert_blocks<Real>) invert_blocks;
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
    decltype(&baseline::apply_distant) apply_distant;
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

#define AIRTACT_FAR(v, Real)                                                                                          \
    { &v::double_layer_matrix<Real>, &v::apply_transposed<Real>, &v::dual_matrix<Real>, &v::few_products<Real>,       \
      &v::krylov_step<Real>, &v::invert_blocks<Real>, &v::apply_double_layer<Real>, &v::apply_monopoles<Real>,         \
      &v::near_excess<Real>, &v::chebyshev_sum<Real> }
#define AIRTACT_DUAL(v, Store)                                                                                        \
    Dual<Store> { &v::dual_blocks<Store>, &v::dual_low_rank<Store>, &v::dual_product<Store> }
#define AIRTACT_TABLE(v)                                                                                              \
    { #v, {AIRTACT_DUAL(v, std::uint32_t), AIRTACT_DUAL(v, float), AIRTACT_DUAL(v, double)},                          \
      AIRTACT_FAR(v, float), AIRTACT_FAR(v, double), &v::apply_in_cells, &v::apply_distant, &v::interpolate,          \
      &v::detoured_waves, &v::near_pairs, &v::block_order, &v::mark_blocks, &v::few_rounded_products, &v::place_nodes,                    \
      &v::panel_distances, &v::closest_on_panels, &v::near_integrals, &v::hull_distances, &v::blended_distance,       \
      &v::hull_gaps, &v::project_on_hulls, &v::grade_sizes, &v::even_pass, &v::gerchberg_saxton,                      \
      &v::surface_integral, &v::normal_derivative }

// The compiled variants that this machine runs, the best last. CMakeLists.txt defines the condition of each.
static std::vector<Variant> runnable() {
    std::vector<Variant> found;
#ifdef AIRTACT_RUNS_baseline
    if (AIRTACT_RUNS_baseline) found.push_back(AIRTACT_TABLE(baseline));
#endif
#ifdef AIRTACT_RUNS_avx2
    if (AIRTACT_RUNS_avx2) found.push_back(AIRTACT_TABLE(avx2));
#endif
#ifdef AIRTACT_RUNS_avx512
    if (AIRTACT_RUNS_avx512) found.push_back(AIRTACT_TABLE(avx512));
#endif
    return found;
}

static const std::vector<Variant> variants = runnable();
static const Variant *active = variants.empty() ? nullptr : &variants.back();

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

// Arrays as Python passes them. None that is changed is converted: the copy would be filled and thrown away.
template <class T, int... n> using Read = nb::ndarray<nb::numpy, const T, nb::shape<n...>, nb::c_contig, nb::device::cpu>;
template <class T, int... n> using Write = nb::ndarray<nb::numpy, T, nb::shape<n...>, nb::c_contig, nb::device::cpu>;
using Complex = std::complex<double>;
using Points = Read<double, -1, 3>;
using Index = Read<std::int64_t, -1>;
using Line = Read<double, -1>;
using Triangles = Read<double, -1, 6, 3>;  // quadratic: three corners, three middles of edges

template <class T> constexpr const char *kind = nullptr;  // NumPy's name
template <> constexpr const char *kind<float> = "float32";
template <> constexpr const char *kind<double> = "float64";
template <> constexpr const char *kind<std::int64_t> = "int64";
template <> constexpr const char *kind<std::complex<float>> = "complex64";
template <> constexpr const char *kind<Complex> = "complex128";

// A new array, with numbers that are not set. NumPy makes it, because it takes large ones from huge pages.
template <class T> struct Output {
    nb::object array;
    T *data;

    explicit Output(std::initializer_list<std::size_t> shape) {
        nb::list sizes;
        for (const std::size_t size : shape) sizes.append(size);
        array = nb::module_::import_("numpy").attr("empty")(nb::tuple(sizes), kind<T>);
        data = nb::cast<nb::ndarray<nb::numpy, T, nb::c_contig, nb::device::cpu>>(array).data();
    }
};

static void same(std::size_t a, std::size_t b) {
    if (a != b) throw nb::value_error("arrays of different lengths");
}

static Wavenumber wave(Complex k) { return {k.real(), k.imag()}; }

static bool in_single(const std::string &precision) {
    if (precision != "float32" && precision != "float64") throw nb::value_error("the precision is neither float32 nor float64");
    return precision == "float32";
}

// Groups of arrays that belong together, which Python binds once; each checks its own lengths.
namespace bound {

struct Layer {
    Points points;
    std::optional<Points> normals;
    Read<Complex, -1> single;
    Wavenumber k;

    Layer(Points points, std::optional<Points> normals, Read<Complex, -1> single, Complex k)
        : points(points), normals(normals), single(single), k(wave(k)) {
        if (normals) same(normals->shape(0), size());
        if (single.shape(0) != 0) same(single.shape(0), size());
    }
    std::size_t size() const { return points.shape(0); }
    const double *double_layer() const {
        if (!normals) throw nb::value_error("a double layer has no normals");
        return normals->data();
    }
    const Complex *single_layer() const { return single.shape(0) ? single.data() : nullptr; }
};

struct Panels {
    Triangles triangles;
    Line contact;

    Panels(Triangles triangles, Line contact) : triangles(triangles), contact(contact) { same(triangles.shape(0), contact.shape(0)); }
};

struct NearQuadrature {
    Line nodes, weights;
    int largest, angular, radial;

    NearQuadrature(Line nodes, Line weights, int largest, int angular, int radial)
        : nodes(nodes), weights(weights), largest(largest), angular(angular), radial(radial) {
        same(nodes.shape(0), std::size_t(largest * (largest + 1) / 2)), same(weights.shape(0), nodes.shape(0));
    }
    NearRule rule() const { return {nodes.data(), weights.data(), largest, angular, radial}; }
};

struct NearRows {
    Index first, panel;
    Write<Complex, -1, 6> excess;

    NearRows(Index first, Index panel, Write<Complex, -1, 6> excess) : first(first), panel(panel), excess(excess) {
        if (first.shape(0) == 0) throw nb::value_error("the near panels of no target do not end");
        same(panel.shape(0), excess.shape(0)), same(panel.shape(0), std::size_t(first.data()[targets()]));
    }
    std::size_t targets() const { return first.shape(0) - 1; }

    airtact::NearRows checked(std::size_t nodes) const {
        for (std::size_t e = 0; e < panel.shape(0); e++)
            if (panel.data()[e] < 0 || 6 * panel.data()[e] + 6 > std::int64_t(nodes))
                throw nb::index_error("a near panel does not exist");
        for (std::size_t i = 0; i < targets(); i++) {
            const std::int64_t from = first.data()[i], to = first.data()[i + 1];
            if (from < 0 || from > to || !std::is_sorted(panel.data() + from, panel.data() + to))
                throw nb::value_error("near panels out of order");
        }
        return {first.data(), panel.data(), excess.data()};
    }
};

struct Pairs {
    Index first, column;

    Pairs(Index first, Index column) : first(first), column(column) {
        const std::int64_t *from = first.data(), blocks = std::int64_t(first.shape(0)) - 1;
        if (blocks < 0) throw nb::value_error("the pairs of no block do not end");
        same(column.shape(0), std::size_t(from[blocks]));
        for (std::int64_t t = 0; t < blocks; t++)
            if (from[t] < 0 || from[t] > from[t + 1] || !std::is_sorted(column.data() + from[t], column.data() + from[t + 1]))
                throw nb::value_error("blocks out of order");
        for (std::size_t e = 0; e < column.shape(0); e++)
            if (column.data()[e] < 0 || column.data()[e] >= blocks) throw nb::index_error("a block does not exist");
    }
    airtact::Pairs of(std::size_t unknowns) const {
        same(first.shape(0), (unknowns + lanes - 1) / lanes + 1);
        return {std::int64_t(first.shape(0)) - 1, first.data(), column.data()};
    }
};

struct FarBlocks : Pairs {
    Write<std::int64_t, -1> ranks, begin;

    FarBlocks(Index first, Index column, Write<std::int64_t, -1> ranks, Write<std::int64_t, -1> begin)
        : Pairs(first, column), ranks(ranks), begin(begin) {
        same(ranks.shape(0), column.shape(0)), same(begin.shape(0), column.shape(0));
    }
    template <class Store> LowRank<Store> checked(const Store *factors, std::size_t room) const {
        for (std::size_t e = 0; e < ranks.shape(0); e++) {
            const std::int64_t rank = ranks.data()[e], from = begin.data()[e];
            if (rank < 0 || rank > lanes || from < 0 || from + 2 * rank > std::int64_t(room))
                throw nb::index_error("a low-rank term does not exist");
        }
        return {ranks.data(), begin.data(), factors};
    }
};

struct Cells {
    Points points;
    Index first;
    Points centres;
    double reach;

    Cells(Points points, Index first, Points centres, double reach)
        : points(points), first(first), centres(centres), reach(reach) {
        const std::size_t cells = centres.shape(0);
        same(first.shape(0), cells + 1);
        for (std::size_t c = 0; c < cells; c++)
            if (first.data()[c] > first.data()[c + 1]) throw nb::index_error("a cell ends before it begins");
        same(first.data()[0], 0), same(std::size_t(first.data()[cells]), points.shape(0));
    }
};

struct KrylovSpaces {
    Write<Complex, -1, -1, 2> rotations;
    Write<Complex, -1, -1> right, triangles, inverses, weights;
    Write<double, -1> squares;

    KrylovSpaces(Write<Complex, -1, -1, 2> rotations, Write<Complex, -1, -1> right, Write<Complex, -1, -1> triangles,
                 Write<Complex, -1, -1> inverses, Write<Complex, -1, -1> weights, Write<double, -1> squares)
        : rotations(rotations), right(right), triangles(triangles), inverses(inverses), weights(weights), squares(squares) {
        const std::size_t packed = most() * (most() + 1) / 2;
        same(right.shape(0), sides()), same(right.shape(1), most() + 1);
        same(triangles.shape(0), sides()), same(triangles.shape(1), packed);
        same(inverses.shape(0), sides()), same(inverses.shape(1), packed);
        same(weights.shape(0), sides()), same(weights.shape(1), most()), same(squares.shape(0), sides());
    }
    std::size_t sides() const { return rotations.shape(0); }
    std::size_t most() const { return rotations.shape(1); }
    Krylov krylov() const {
        return {std::int64_t(most()), rotations.data(), right.data(), triangles.data(), inverses.data(), weights.data(), squares.data()};
    }
};

}  // namespace bound

template <class Store>  // two bfloat16 are one word
constexpr int words = std::is_same_v<std::remove_const_t<Store>, std::uint32_t> ? lanes / 2 : lanes;
template <class Store>
using Blocks = nb::ndarray<nb::numpy, Store, nb::shape<-1, lanes, 2, words<Store>>, nb::c_contig, nb::device::cpu>;
template <class Store>
using Rows = nb::ndarray<nb::numpy, Store, nb::shape<-1, 2, words<Store>>, nb::c_contig, nb::device::cpu>;
template <class Store> using Vectors = Read<std::complex<typename Arithmetic<Store>::Real>, -1, -1>;

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
void dual_blocks(Points targets, Points shifted, const bound::Layer &layer, double diagonal, const bound::NearRows &near,
                 const bound::NearRows &near_shifted, const bound::Pairs &whole, Blocks<Store> out) {
    const std::size_t m = layer.size();
    same(m, targets.shape(0)), same(m, sharing * shifted.shape(0)), same(out.shape(0), whole.column.shape(0));
    same(near.targets(), m), same(sharing * near_shifted.targets(), m);
    const Pairs pairs = whole.of(m);
    const NearRows rows = near.checked(m), rows_shifted = near_shifted.checked(m);
    all_in(rows, m, 1, pairs), all_in(rows_shifted, m / sharing, sharing, pairs);
    const double *normals = layer.double_layer();
    nb::gil_scoped_release release;
    std::get<Dual<Store>>(active->dual)
        .blocks(targets.data(), shifted.data(), layer.points.data(), normals, layer.single_layer(), std::int64_t(m), layer.k,
                diagonal, rows, rows_shifted, pairs, out.data());
}

template <class Store>
std::int64_t dual_low_rank(Points targets, Points shifted, const bound::Layer &layer, const bound::FarBlocks &far, double tolerance,
                           Rows<Store> factors) {
    const std::size_t m = layer.size();
    same(m, targets.shape(0)), same(m, sharing * shifted.shape(0));
    const Pairs pairs = far.of(m);
    const double *normals = layer.double_layer();
    nb::gil_scoped_release release;
    return std::get<Dual<Store>>(active->dual)
        .terms(targets.data(), shifted.data(), layer.points.data(), normals, layer.single_layer(), std::int64_t(m), layer.k, pairs,
               tolerance, std::int64_t(factors.shape(0)), far.ranks.data(), far.begin.data(), factors.data());
}

template <class Store>
nb::object dual_product(const bound::Pairs &whole, Blocks<const Store> blocks, const bound::FarBlocks &far,
                        Rows<const Store> factors, Vectors<Store> vectors, bool transposed) {
    const std::size_t m = vectors.shape(1);
    same(blocks.shape(0), whole.column.shape(0));
    const Pairs pairs = whole.of(m), far_pairs = far.of(m);
    const LowRank<Store> terms = far.checked(factors.data(), factors.shape(0));
    const Output<std::complex<typename Arithmetic<Store>::Real>> out({vectors.shape(0), m});
    {
        nb::gil_scoped_release release;
        std::get<Dual<Store>>(active->dual)
            .product(pairs, blocks.data(), far_pairs, terms, std::int64_t(m), vectors.data(), vectors.shape(0), transposed, out.data);
    }
    return out.array;
}

template <class Real> nb::object double_layer_matrix(Points targets, const bound::Layer &layer) {
    const Output<std::complex<Real>> out({targets.shape(0), layer.size()});
    const double *normals = layer.double_layer();
    {
        nb::gil_scoped_release release;
        far<Real>().double_layer_matrix(targets.data(), targets.shape(0), layer.points.data(), normals, layer.single_layer(),
                                        layer.size(), layer.k, out.data);
    }
    return out.array;
}

template <class Real> nb::object dual_matrix(Points targets, Points inside, const bound::Layer &layer) {
    same(targets.shape(0), inside.shape(0));
    const Output<std::complex<Real>> out({targets.shape(0), layer.size()});
    const double *normals = layer.double_layer();
    {
        nb::gil_scoped_release release;
        far<Real>().dual_matrix(targets.data(), inside.data(), targets.shape(0), layer.points.data(), normals,
                                layer.single_layer(), layer.size(), layer.k, out.data);
    }
    return out.array;
}

static nb::object apply_transposed(Points targets, const bound::Layer &layer, Read<Complex, -1, -1> strengths,
                                   const std::string &precision) {
    same(strengths.shape(0), targets.shape(0));
    const Output<Complex> out({layer.size(), strengths.shape(1)});
    const double *normals = layer.double_layer();
    const auto loop = in_single(precision) ? far<float>().apply_transposed : far<double>().apply_transposed;
    {
        nb::gil_scoped_release release;
        loop(targets.data(), targets.shape(0), layer.points.data(), normals, layer.single_layer(), layer.size(),
             strengths.data(), strengths.shape(1), layer.k, out.data);
    }
    return out.array;
}

static nb::object apply_double_layer(Points targets, const bound::Layer &layer, Read<Complex, -1, -1> density, double least,
                                     const std::string &precision) {
    same(density.shape(0), layer.size());
    const Output<Complex> out({targets.shape(0), density.shape(1)});
    const double *normals = layer.double_layer();
    const auto loop = in_single(precision) ? far<float>().apply_double_layer : far<double>().apply_double_layer;
    {
        nb::gil_scoped_release release;
        loop(targets.data(), targets.shape(0), layer.points.data(), normals, layer.single_layer(), layer.size(), density.data(),
             density.shape(1), layer.k, least, out.data);
    }
    return out.array;
}

static nb::object apply_monopoles(Points targets, Points sources, Read<Complex, -1, -1> strengths, Complex k,
                                  const std::string &precision) {
    same(strengths.shape(0), sources.shape(0));
    const Output<Complex> out({targets.shape(0), strengths.shape(1)});
    const auto loop = in_single(precision) ? far<float>().apply_monopoles : far<double>().apply_monopoles;
    {
        nb::gil_scoped_release release;
        loop(targets.data(), targets.shape(0), sources.data(), sources.shape(0), strengths.data(), strengths.shape(1), wave(k),
             out.data);
    }
    return out.array;
}

static nb::object apply_in_cells(const bound::Cells &cells, bool inside, const bound::Layer &layer, Read<Complex, -1, -1> density,
                                 double least) {
    same(density.shape(0), layer.size());
    const Output<Complex> out({cells.points.shape(0), density.shape(1)});
    {
        nb::gil_scoped_release release;
        active->apply_in_cells(cells.points.data(), cells.first.data(), cells.centres.shape(0), cells.centres.data(), cells.reach,
                               inside, layer.points.data(), layer.normals ? layer.normals->data() : nullptr,
                               layer.single_layer(), layer.size(), density.data(), density.shape(1), layer.k, least, out.data);
    }
    return out.array;
}

static nb::object apply_distant(const bound::Layer &targets, Points sources, Read<Complex, -1, -1> density, double error) {
    same(density.shape(0), sources.shape(0));
    const Output<Complex> out({targets.size(), density.shape(1)});
    {
        nb::gil_scoped_release release;
        active->apply_distant(targets.points.data(), targets.normals ? targets.normals->data() : nullptr, targets.single_layer(),
                              targets.size(), sources.data(), sources.shape(0), density.data(), density.shape(1), targets.k,
                              error, out.data);
    }
    return out.array;
}

template <class Real>
nb::object few_products(Read<std::complex<Real>, -1, -1> matrix, Read<std::complex<Real>, -1, -1> vectors, bool transposed) {
    same(vectors.shape(1), matrix.shape(transposed ? 0 : 1));
    const Output<std::complex<Real>> out({vectors.shape(0), matrix.shape(transposed ? 1 : 0)});
    {
        nb::gil_scoped_release release;
        far<Real>().few_products(matrix.data(), matrix.shape(0), matrix.shape(1), vectors.data(), vectors.shape(0), transposed,
                                 out.data);
    }
    return out.array;
}

static nb::object few_rounded_products(Read<std::int16_t, -1, -1, 2> matrix, Read<float, -1> scales,
                                       Read<std::complex<float>, -1, -1> vectors, bool transposed) {
    same(scales.shape(0), matrix.shape(0)), same(vectors.shape(1), matrix.shape(transposed ? 0 : 1));
    const Output<std::complex<float>> out({vectors.shape(0), matrix.shape(transposed ? 1 : 0)});
    {
        nb::gil_scoped_release release;
        active->few_rounded_products(matrix.data(), scales.data(), matrix.shape(0), matrix.shape(1), vectors.data(),
                                     vectors.shape(0), transposed, out.data);
    }
    return out.array;
}

template <class Real> void krylov_step(Write<std::complex<Real>, -1, -1, -1> bases, const bound::KrylovSpaces &spaces) {
    const std::size_t vectors = bases.shape(0);
    same(bases.shape(1), spaces.sides());
    if (vectors < 2 || vectors > spaces.most() + 1) throw nb::value_error("no room for the step");
    nb::gil_scoped_release release;
    far<Real>().krylov_step(bases.data(), spaces.sides(), bases.shape(2), std::int64_t(vectors) - 2, spaces.krylov());
}

template <class Real> void invert_blocks(Write<std::complex<Real>, -1, -1, -1> blocks) {
    same(blocks.shape(1), blocks.shape(2));
    nb::gil_scoped_release release;
    far<Real>().invert_blocks(blocks.data(), blocks.shape(0), blocks.shape(1));
}

static nb::object detoured(Read<double, -1, -1, 3> centres, Points foci, Points elements, Line straight,
                           Read<std::complex<float>, -1, -1, -1> waves, double k) {
    const std::size_t bones = centres.shape(0), count = foci.shape(0), n = elements.shape(0);
    same(centres.shape(1), count), same(straight.shape(0), count);
    same(waves.shape(0), bones), same(waves.shape(1), count), same(waves.shape(2), n);
    const Output<std::complex<float>> out({count, n});
    {
        nb::gil_scoped_release release;
        active->detoured_waves(centres.data(), bones, foci.data(), count, elements.data(), n, straight.data(), waves.data(), k,
                               out.data);
    }
    return out.array;
}

static nb::object whole_surface(Points x, Points y, Points a, Read<Complex, -1, -1> single, Read<Complex, -1, -1> twin, Complex k) {
    same(y.shape(0), a.shape(0)), same(single.shape(0), y.shape(0)), same(twin.shape(0), y.shape(0));
    same(single.shape(1), twin.shape(1));
    const Output<Complex> out({x.shape(0), single.shape(1)});
    {
        nb::gil_scoped_release release;
        active->surface_integral(x.data(), x.shape(0), y.data(), a.data(), y.shape(0), single.data(), twin.data(),
                                 single.shape(1), wave(k), out.data);
    }
    return out.array;
}

static nb::object along_normals(Points x, Points a, Points y, Read<Complex, -1, -1> strength, Complex k) {
    same(x.shape(0), a.shape(0)), same(strength.shape(0), y.shape(0));
    const Output<Complex> out({x.shape(0), strength.shape(1)});
    {
        nb::gil_scoped_release release;
        active->normal_derivative(x.data(), a.data(), x.shape(0), y.data(), y.shape(0), strength.data(), strength.shape(1),
                                  wave(k), out.data);
    }
    return out.array;
}

static nb::object interpolated(Read<std::complex<float>, -1, -1> table, Index first, Read<std::int64_t, 2> steps,
                               Read<float, -1, -1> u, Read<float, -1, -1> v, Read<float, -1, -1> w) {
    const std::size_t n = first.shape(0), sounds = table.shape(1);
    same(u.shape(0), n), same(v.shape(0), n), same(w.shape(0), n);
    const std::int64_t last = (std::int64_t(u.shape(1)) - 1) * steps.data()[0] +
                              (std::int64_t(v.shape(1)) - 1) * steps.data()[1] + std::int64_t(w.shape(1) * sounds);
    for (std::size_t i = 0; i < n; i++)
        if (first.data()[i] < 0 || first.data()[i] + last > std::int64_t(table.size()))
            throw nb::index_error("a value lies beyond the table");
    const Output<Complex> out({n, sounds});
    {
        nb::gil_scoped_release release;
        active->interpolate(table.data(), first.data(), n, steps.data(), u.data(), u.shape(1), v.data(), v.shape(1), w.data(),
                            w.shape(1), sounds, out.data);
    }
    return out.array;
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

static nb::object panel_distances(Triangles panels, Points points, double within) {
    const Output<double> distance({panels.shape(0)});
    {
        nb::gil_scoped_release release;
        active->panel_distances(panels.data(), panels.shape(0), points.data(), points.shape(0), within, distance.data);
    }
    return distance.array;
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

static nb::tuple place_nodes(Triangles panels, Read<double, 19, 6> rule, Read<double, 6> weights) {
    const std::size_t n = panels.shape(0);
    const Output<double> points({6 * n, 3}), normals({6 * n, 3}), areas({6 * n}), centres({n, 3}), radii({n});
    {
        nb::gil_scoped_release release;
        active->place_nodes(panels.data(), n, rule.data(), weights.data(), points.data, normals.data, areas.data, centres.data,
                            radii.data);
    }
    return nb::make_tuple(points.array, normals.array, areas.array, centres.array, radii.array);
}

static nb::object block_order(Points points, std::int64_t each) {
    if (each < 1) throw nb::value_error("blocks of no points");
    const Output<std::int64_t> order({points.shape(0)});
    {
        nb::gil_scoped_release release;
        active->block_order(points.data(), points.shape(0), each, order.data);
    }
    return order.array;
}

static nb::tuple near_integrals(bool single_layer, Points targets, Index pair_target, Index pair_panel, const bound::Panels &panels,
                                Complex k, const bound::NearQuadrature &quadrature) {
    const std::size_t pairs = pair_target.shape(0);
    same(pairs, pair_panel.shape(0));
    const Output<Complex> moments({pairs, 6});
    const Output<double> distance({pairs}), reference({pairs, 2});
    {
        nb::gil_scoped_release release;
        active->near_integrals(single_layer, targets.data(), pair_target.data(), pair_panel.data(), std::int64_t(pairs),
                               panels.triangles.data(), panels.contact.data(), wave(k), quadrature.rule(), moments.data,
                               distance.data, reference.data);
    }
    return nb::make_tuple(moments.array, distance.array, reference.array);
}

static void near_excess(Points targets, const bound::NearRows &rows, const bound::Panels &panels, const bound::Layer &layer,
                        Read<double, 6, 6> nodal, double least, const bound::NearQuadrature &quadrature,
                        const std::string &precision) {
    same(rows.targets(), targets.shape(0)), same(6 * panels.triangles.shape(0), layer.size());
    const double *normals = layer.double_layer();
    const auto loop = in_single(precision) ? far<float>().near_excess : far<double>().near_excess;
    nb::gil_scoped_release release;
    loop(targets.data(), targets.shape(0), rows.first.data(), rows.panel.data(), panels.triangles.data(), panels.contact.data(),
         layer.points.data(), normals, layer.single_layer(), nodal.data(), layer.k, least, quadrature.rule(), rows.excess.data());
}

static nb::tuple closest(Points targets, Triangles panels, Index order, Points lower, Points upper, Read<double, -1, 3, 4> sides,
                         std::optional<Line> within) {
    const std::size_t n = targets.shape(0);
    same(2 * order.shape(0), lower.shape(0)), same(lower.shape(0), upper.shape(0)), same(order.shape(0), sides.shape(0));
    if (within) same(n, within->shape(0));
    const Output<std::int64_t> panel({n});
    const Output<double> reference({n, 2}), distance({n});
    std::fill_n(panel.data, n, 0), std::fill_n(reference.data, 2 * n, 0.0);
    std::fill_n(distance.data, n, std::numeric_limits<double>::infinity());
    if (within) std::copy_n(within->data(), n, distance.data);
    {
        nb::gil_scoped_release release;
        active->closest_on_panels(targets.data(), n, panels.data(), order.data(), lower.data(), upper.data(),
                                  sides.data(), order.shape(0), panel.data, reference.data, distance.data);
    }
    return nb::make_tuple(panel.array, reference.array, distance.array);
}

static nb::tuple saxton(Read<float, -1, -1> real, Read<float, -1, -1> imag, Read<std::int64_t, -1, -1> rows,
                        Read<float, -1, -1> wanted, std::int64_t foci_iterations, std::int64_t iterations, bool weighted,
                        Read<std::complex<float>, -1, -1> start) {
    const std::size_t sets = rows.shape(0), foci = rows.shape(1), points = real.shape(0), elements = real.shape(1);
    same(imag.shape(0), points), same(imag.shape(1), elements);
    same(wanted.shape(0), sets), same(wanted.shape(1), foci), same(start.shape(0), sets), same(start.shape(1), foci);
    for (std::size_t i = 0; i < sets * foci; i++)
        if (rows.data()[i] < 0 || rows.data()[i] >= std::int64_t(points))
            throw nb::index_error("a set has a row that the matrix does not have");
    const Output<std::complex<float>> sources({sets, foci}), drives({sets, elements});
    const Output<float> worst({sets});
    std::copy_n(start.data(), sets * foci, sources.data);
    {
        nb::gil_scoped_release release;
        active->gerchberg_saxton(real.data(), imag.data(), elements, rows.data(), wanted.data(), sets, foci, foci_iterations,
                                 iterations, weighted, sources.data, worst.data, drives.data);
    }
    return nb::make_tuple(sources.array, worst.array, drives.array);
}

using Square = Read<double, -1, -1>;
using Hulls = Read<std::int64_t, -1, 3>;

static void right_balls(Read<double, -1, 4> balls, Hulls parts) {
    for (std::size_t i = 0; i < 3 * parts.shape(0); i++)
        if (parts.data()[i] < (i % 3 == 2 ? -1 : 0) || parts.data()[i] >= std::int64_t(balls.shape(0)))
            throw nb::index_error("a hull has a ball that does not exist");
}

static nb::object apart_from_hulls(Points x, Read<double, -1, 4> balls, Hulls parts) {
    right_balls(balls, parts);
    const Output<double> out({x.shape(0), parts.shape(0)});
    {
        nb::gil_scoped_release release;
        active->hull_distances(x.data(), x.shape(0), balls.data(), parts.data(), parts.shape(0), out.data);
    }
    return out.array;
}

static nb::tuple blended(Points x, Read<double, -1, 4> balls, Hulls parts, Square blend, Square apart, double carve, double reach) {
    right_balls(balls, parts);
    for (const Square &table : {blend, apart})
        same(table.shape(0), parts.shape(0)), same(table.shape(1), parts.shape(0));
    const std::size_t n = x.shape(0);
    const Output<double> distance({n}), gradient({n, 3}), bend({n}), facing({n});
    const Output<std::int64_t> nearest({n});
    {
        nb::gil_scoped_release release;
        active->blended_distance(x.data(), n, balls.data(), parts.data(), parts.shape(0), blend.data(), apart.data(), carve, reach,
                                 distance.data, gradient.data, bend.data, facing.data, nearest.data);
    }
    return nb::make_tuple(distance.array, gradient.array, bend.array, facing.array, nearest.array);
}

static nb::tuple gaps(Points x, Read<double, -1, 4> balls, Hulls parts, Square blend, std::optional<Read<double, 3>> camera,
                      double facing) {
    right_balls(balls, parts);
    same(blend.shape(0), parts.shape(0)), same(blend.shape(1), parts.shape(0));
    if (parts.shape(0) == 0) throw nb::index_error("there is no hull");
    const Output<double> distance({x.shape(0)}), gradients({x.shape(0), 4 * balls.shape(0)});
    const Output<std::int64_t> hull({x.shape(0)});
    {
        nb::gil_scoped_release release;
        active->hull_gaps(x.data(), x.shape(0), balls.data(), balls.shape(0), parts.data(), parts.shape(0), blend.data(),
                          camera ? camera->data() : nullptr, facing, distance.data, gradients.data, hull.data);
    }
    return nb::make_tuple(distance.array, gradients.array, hull.array);
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

template <class Array> static void right_vertices(Array triangles, std::int64_t used, std::size_t vertices) {
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
    if (!active) throw nb::import_error("airtact was compiled for a machine with other instructions: install it again on this one");
    // Structs that a session or a notebook still holds when Python ends are no fault to report.
    nb::set_leak_warnings(false);
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

    using namespace nb::literals;
    const auto out = "out"_a.noconvert();
    nb::class_<bound::Layer>(m, "Layer")
        .def(nb::init<Points, std::optional<Points>, Read<Complex, -1>, Complex>(), "points"_a, "normals"_a.none(), "single"_a,
             "wavenumber"_a);
    nb::class_<bound::Panels>(m, "Panels").def(nb::init<Triangles, Line>(), "quadratic_triangles"_a, "contact"_a);
    nb::class_<bound::NearQuadrature>(m, "NearQuadrature")
        .def(nb::init<Line, Line, int, int, int>(), "nodes"_a, "weights"_a, "largest"_a, "angular"_a, "radial"_a);
    nb::class_<bound::NearRows>(m, "NearRows")
        .def(nb::init<Index, Index, Write<Complex, -1, 6>>(), "first"_a, "panel"_a, "excess"_a.noconvert())
        .def_prop_ro("first", [](const bound::NearRows &self) { return self.first; })
        .def_prop_ro("panel", [](const bound::NearRows &self) { return self.panel; })
        .def_prop_ro("excess", [](const bound::NearRows &self) { return self.excess; });
    nb::class_<bound::Pairs>(m, "Pairs")
        .def(nb::init<Index, Index>(), "first"_a, "column"_a)
        .def_prop_ro("first", [](const bound::Pairs &self) { return self.first; })
        .def_prop_ro("column", [](const bound::Pairs &self) { return self.column; });
    nb::class_<bound::FarBlocks, bound::Pairs>(m, "FarBlocks")
        .def(nb::init<Index, Index, Write<std::int64_t, -1>, Write<std::int64_t, -1>>(), "first"_a, "column"_a,
             "ranks"_a.noconvert(), "begin"_a.noconvert())
        .def_prop_ro("ranks", [](const bound::FarBlocks &self) { return self.ranks; })
        .def_prop_ro("begin", [](const bound::FarBlocks &self) { return self.begin; });
    nb::class_<bound::Cells>(m, "Cells")
        .def(nb::init<Points, Index, Points, double>(), "points"_a, "first"_a, "centres"_a, "reach"_a);
    nb::class_<bound::KrylovSpaces>(m, "KrylovSpaces")
        .def(nb::init<Write<Complex, -1, -1, 2>, Write<Complex, -1, -1>, Write<Complex, -1, -1>, Write<Complex, -1, -1>,
                      Write<Complex, -1, -1>, Write<double, -1>>(),
             "rotations"_a.noconvert(), "right"_a.noconvert(), "triangles"_a.noconvert(), "inverses"_a.noconvert(),
             "weights"_a.noconvert(), "squares"_a.noconvert())
        .def_prop_ro("right", [](const bound::KrylovSpaces &self) { return self.right; })
        .def_prop_ro("triangles", [](const bound::KrylovSpaces &self) { return self.triangles; })
        .def_prop_ro("weights", [](const bound::KrylovSpaces &self) { return self.weights; })
        .def_prop_ro("squares", [](const bound::KrylovSpaces &self) { return self.squares; });

    // one name for all number formats: the output's own says which
    const auto dual = [&](auto store) {
        using Store = decltype(store);
        m.def("dual_blocks", &dual_blocks<Store>, "targets"_a, "shifted"_a, "layer"_a, "diagonal"_a, "near"_a, "near_shifted"_a,
              "whole"_a, out);
        m.def("dual_low_rank", &dual_low_rank<Store>, "targets"_a, "shifted"_a, "layer"_a, "far"_a, "tolerance"_a,
              "factors"_a.noconvert());
        m.def("dual_product", &dual_product<Store>, "whole"_a, "blocks"_a.noconvert(), "far"_a, "factors"_a.noconvert(),
              "vectors"_a.noconvert(), "transposed"_a);
    };
    dual(std::uint32_t()), dual(float()), dual(double());
    const auto both = [&](auto real) {
        using Real = decltype(real);
        m.def("few_products", &few_products<Real>, "matrix"_a.noconvert(), "vectors"_a.noconvert(), "transposed"_a);
        m.def("invert_blocks", &invert_blocks<Real>, "blocks"_a.noconvert());
        m.def("krylov_step", &krylov_step<Real>, "bases"_a.noconvert(), "spaces"_a);
        m.def("chebyshev_sum", &chebyshev<Real>, "values"_a.noconvert(), "columns"_a, "rows"_a, "factors"_a.noconvert(),
              "x"_a.noconvert());
    };
    both(float()), both(double());
    m.def("few_rounded_products", &few_rounded_products, "matrix"_a, "scales"_a, "vectors"_a, "transposed"_a);
    m.def(
        "double_layer_matrix",
        [](Points targets, const bound::Layer &layer, const std::string &precision) {
            return in_single(precision) ? double_layer_matrix<float>(targets, layer) : double_layer_matrix<double>(targets, layer);
        },
        "targets"_a, "layer"_a, "precision"_a);
    m.def(
        "dual_matrix",
        [](Points targets, Points inside, const bound::Layer &layer, const std::string &precision) {
            return in_single(precision) ? dual_matrix<float>(targets, inside, layer) : dual_matrix<double>(targets, inside, layer);
        },
        "targets"_a, "inside"_a, "layer"_a, "precision"_a);
    m.def("apply_transposed", &apply_transposed, "targets"_a, "layer"_a, "strengths"_a, "precision"_a);
    m.def("apply_double_layer", &apply_double_layer, "targets"_a, "layer"_a, "density"_a, "least"_a, "precision"_a);
    m.def("apply_monopoles", &apply_monopoles, "targets"_a, "sources"_a, "strengths"_a, "wavenumber"_a, "precision"_a);
    m.def("apply_distant", &apply_distant, "targets"_a, "sources"_a, "density"_a, "error"_a);
    m.def("apply_in_cells", &apply_in_cells, "cells"_a, "inside"_a, "layer"_a, "density"_a, "least"_a);
    m.def("near_excess", &near_excess, "targets"_a, "rows"_a, "panels"_a, "layer"_a, "nodal"_a, "least"_a, "quadrature"_a,
          "precision"_a);
    m.def("near_integrals", &near_integrals, "single_layer"_a, "targets"_a, "pair_target"_a, "pair_panel"_a, "panels"_a,
          "wavenumber"_a, "quadrature"_a);
    m.def("surface_integral", &whole_surface);
    m.def("normal_derivative", &along_normals);
    m.def("interpolate", &interpolated);
    m.def("detoured_waves", &detoured);
    m.def("near_pairs", &near_pairs);
    m.def("block_order", &block_order);
    m.def("mark_blocks", &mark_blocks);
    m.def("place_nodes", &place_nodes);
    m.def("panel_distances", &panel_distances);
    m.def("closest_on_panels", &closest, "targets"_a, "quadratic_triangles"_a, "order"_a, "lower"_a, "upper"_a,
          "sides"_a, "within"_a = nb::none());
    m.def("hull_distances", &apart_from_hulls);
    m.def("blended_distance", &blended);
    m.def("hull_gaps", &gaps, "points"_a, "balls"_a, "parts"_a, "blend"_a, "camera"_a.none(), "facing"_a);
    m.def("project_on_hulls", &on_hulls);
    m.def("grade_sizes", &graded);
    m.def("even_pass", &even);
    m.def("gerchberg_saxton", &saxton);
}
