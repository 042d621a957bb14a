"""The compiled loops against NumPy twins that share no code with them."""

import numpy as np
import pytest
from airtact.acoustics.solvers.loops import loop
from scipy.integrate import dblquad
from scipy.sparse import csr_matrix

from airtact import _kernels
from airtact.acoustics.solvers.bem.quadrature import RULE, RULE_WEIGHTS

PRECISIONS = [("float32", np.complex64, 2e-5), ("float64", np.complex128, 1e-13)]
WAVENUMBERS = [732.5 + 0j, 732.5 + 3.1j, 0j]


pytestmark = pytest.mark.usefixtures("variant")


def test_an_unknown_variant_is_refused():
    with pytest.raises(ValueError, match="does not run the variant abacus"):
        _kernels.use_variant("abacus")


def scattered_points(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3)) * 0.03


HARD = np.zeros(0, complex)
"""The single layer of sound-hard surfaces."""


def mixed_with(count: int) -> np.ndarray:
    """A single layer of so many nodes, about as strong as their double layer."""
    pick = np.random.default_rng(9)
    return 0.5 * (pick.normal(size=count) + 1j * pick.normal(size=count))


def double_layer(points, sources, weighted_normals, wavenumber, single=HARD):
    offset = sources[None] - points[:, None]
    distance = np.linalg.norm(offset, axis=2)
    slope = (offset * weighted_normals).sum(axis=2) / distance
    strength = slope * (1j * wavenumber - 1 / distance) + (single if len(single) else 0)
    return strength * np.exp(1j * wavenumber * distance) / (4 * np.pi * distance)


def relative(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@pytest.mark.parametrize("wavenumber", WAVENUMBERS)
@pytest.mark.parametrize(("precision", "kind", "tolerance"), PRECISIONS)
@pytest.mark.parametrize("mixed", [HARD, mixed_with(700)], ids=["hard", "mixed"])
def test_double_layer_loops_equal_numpy(mixed, precision, kind, tolerance, wavenumber):
    points, sources, normals = (
        scattered_points(1, 40),
        scattered_points(3, 700),
        scattered_points(4, 700) * 1e-3,
    )
    first = double_layer(points, sources, normals, wavenumber, mixed)
    matrix, layer = np.empty((40, 700), kind), (points, sources, normals, mixed)
    getattr(_kernels, f"double_layer_matrix_{precision}")(*layer, wavenumber, matrix)
    assert relative(matrix, first) < tolerance
    dual, inside = np.empty((40, 700), kind), scattered_points(2, 40)
    getattr(_kernels, f"dual_matrix_{precision}")(points, inside, *layer[1:], wavenumber, dual)
    assert (
        relative(dual, 1j * double_layer(inside, sources, normals, wavenumber, mixed) - first)
        < tolerance
    )
    density = np.random.default_rng(5).normal(size=(700, 3)) + 1j
    applied = np.empty((40, 3), np.complex128)
    getattr(_kernels, f"apply_double_layer_{precision}")(*layer, density, wavenumber, 0.0, applied)
    assert relative(applied, first @ density) < 3 * tolerance
    far = np.linalg.norm(points[:, None] - sources[None], axis=2) > 0.02
    getattr(_kernels, f"apply_double_layer_{precision}")(*layer, density, wavenumber, 0.02, applied)
    assert relative(applied, np.where(far, first, 0) @ density) < 3 * tolerance


@pytest.mark.parametrize("wavenumber", WAVENUMBERS)
@pytest.mark.parametrize(("precision", "tolerance"), [one[::2] for one in PRECISIONS])
@pytest.mark.parametrize("mixed", [HARD, mixed_with(700)], ids=["hard", "mixed"])
@pytest.mark.parametrize("count", [1, 16, 17, 300])
def test_a_transposed_double_layer_equals_numpy(count, mixed, precision, tolerance, wavenumber):
    points, sources, normals = (
        scattered_points(1, count),
        scattered_points(3, 700),
        scattered_points(4, 700) * 1e-3,
    )
    strength, applied = (
        np.random.default_rng(5).normal(size=(count, 3)) + 1j,
        np.empty((700, 3), np.complex128),
    )
    strength[0, 1] = 0
    getattr(_kernels, f"apply_transposed_{precision}")(
        points, sources, normals, mixed, strength, wavenumber, applied
    )
    expected = double_layer(points, sources, normals, wavenumber, mixed).T @ strength
    assert relative(applied, expected) < 3 * tolerance


@pytest.mark.parametrize(("precision", "kind", "tolerance"), PRECISIONS)
@pytest.mark.parametrize("shape", [(1, 1), (7, 300), (301, 6), (640, 530)])
def test_products_with_few_vectors_equal_numpy(shape, precision, kind, tolerance):
    pick = np.random.default_rng(1)
    matrix = (pick.normal(size=shape) + 1j * pick.normal(size=shape)).astype(kind)
    for transposed, whole in ((False, matrix.T), (True, matrix)):
        vectors = (
            pick.normal(size=(3, len(whole))) + 1j * pick.normal(size=(3, len(whole)))
        ).astype(kind)
        out = np.empty((3, whole.shape[1]), kind)
        getattr(_kernels, f"few_products_{precision}")(matrix, vectors, transposed, out)
        assert relative(out, vectors.astype(complex) @ whole.astype(complex)) < tolerance


@pytest.mark.parametrize("shape", [(1, 1), (7, 300), (301, 6), (640, 530)])
def test_products_of_rounded_matrices_equal_numpy(shape):
    pick = np.random.default_rng(1)
    numbers = pick.integers(-32767, 32768, (*shape, 2)).astype(np.int16)
    scales = pick.random(shape[0]).astype(np.float32)
    matrix = (numbers[..., 0] + 1j * numbers[..., 1]) * scales[:, None]
    for transposed, whole in ((False, matrix.T), (True, matrix)):
        vectors = (
            pick.normal(size=(3, len(whole))) + 1j * pick.normal(size=(3, len(whole)))
        ).astype(np.complex64)
        out = np.empty((3, whole.shape[1]), np.complex64)
        _kernels.few_rounded_products(numbers, scales, vectors, transposed, out)
        assert relative(out, vectors.astype(complex) @ whole) < 1e-6


@pytest.mark.parametrize(("precision", "kind", "tolerance"), PRECISIONS)
@pytest.mark.parametrize("size", [3, 90])
def test_krylov_steps_find_the_least_residual(size, precision, kind, tolerance):
    steps = min(size, 5)
    pick = np.random.default_rng(2)
    matrix = (pick.normal(size=(size, size)) + 1j * pick.normal(size=(size, size))).astype(kind)
    bases = np.empty((steps + 1, 3, size), kind)
    bases[0] = pick.normal(size=(3, size)) + 1j * pick.normal(size=(3, size))
    bases[0] /= np.linalg.norm(bases[0], axis=1)[:, None]
    right, squares = np.ones((3, steps + 1), complex), np.zeros(3)
    weights, (triangles, inverses) = (
        np.empty((3, steps), complex),
        np.empty((2, 3, steps * (steps + 1) // 2), complex),
    )
    spaces = np.empty((3, steps, 2), complex), right, triangles, inverses, weights, squares
    for step in range(steps):
        bases[step + 1] = bases[step] @ matrix.T
        getattr(_kernels, f"krylov_step_{precision}")(bases[: step + 2], *spaces)
        for side in range(3):
            space = bases[: step + 1, side].T
            assert np.allclose(space.conj().T @ space, np.eye(step + 1), atol=30 * tolerance)
            taken = np.linalg.lstsq(matrix @ space, bases[0, side], rcond=None)[0]
            least = np.linalg.norm(matrix @ space @ taken - bases[0, side])
            assert abs(abs(right[side, step + 1]) - least) < 100 * tolerance
            triangle = np.zeros((step + 1, step + 1), complex)
            for index in range(step + 1):
                begin = index * (index + 1) // 2
                triangle[: index + 1, index] = triangles[side, begin : begin + index + 1]
            inverse = np.linalg.inv(triangle)
            assert np.isclose(squares[side], np.linalg.norm(inverse) ** 2)
            assert np.allclose(weights[side, : step + 1], inverse @ right[side, : step + 1])
            assert np.allclose(weights[side, : step + 1], taken, atol=1000 * tolerance)


def test_vectors_of_no_length_stay_as_they_are_and_leave_nothing():
    bases, one = np.zeros((2, 2, 9), np.complex64), np.empty((2, 1), complex)
    right, weights, squares = np.zeros((2, 2), complex), one.copy(), np.zeros(2)
    _kernels.krylov_step_float32(
        bases, np.empty((2, 1, 2), complex), right, one.copy(), one, weights, squares
    )
    for zero in (bases, right, weights, squares):
        assert not zero.any()


def some_near_rows(seed: int, count: int, panels: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two panels near every target, with numbers to add to the entries of their nodes."""
    pick = np.random.default_rng(seed)
    panel = np.stack([np.sort(pick.permutation(panels)[:2]) for _ in range(count)]).ravel()
    excess = 30 * (pick.normal(size=(2 * count, 6)) + 1j * pick.normal(size=(2 * count, 6)))
    return np.arange(0, 2 * count + 1, 2), panel, excess


def added(rows: tuple[np.ndarray, np.ndarray, np.ndarray], count: int) -> np.ndarray:
    first, panel, excess = rows
    matrix = np.zeros((len(first) - 1, count), complex)
    target = np.repeat(np.arange(len(first) - 1), np.diff(first))
    for node in range(6):
        np.add.at(matrix, (target, 6 * panel + node), excess[:, node])
    return matrix


STORES = [
    ("bfloat16", np.complex64, 2.5e-3),
    ("float32", np.complex64, 2e-5),
    ("float64", np.complex128, 1e-13),
]


def all_pairs(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Every tile with every tile."""
    tiles = -(-count // _kernels.lanes)
    return tiles * np.arange(tiles + 1), np.tile(np.arange(tiles), tiles)


NO_NEAR = np.zeros(0, int), np.zeros((0, 6), complex)


def blank(shape: tuple[int, ...], store: str) -> np.ndarray:
    """Rows of so many numbers, as a store keeps them."""
    halves = store == "bfloat16"
    return np.zeros((*shape[:-1], shape[-1] // (1 + halves)), np.uint32 if halves else store)


def numbers(rows: np.ndarray, store: str) -> np.ndarray:
    """What rows hold (..., 2, W), as complex numbers."""
    halves = store == "bfloat16"
    parts = (
        np.concatenate([rows << 16, rows & 0xFFFF0000], axis=-1).view(np.float32)
        if halves
        else rows
    )
    return parts[..., 0, :] + 1j * parts[..., 1, :]


@pytest.mark.parametrize("wavenumber", WAVENUMBERS)
@pytest.mark.parametrize(("store", "kind", "tolerance"), STORES)
@pytest.mark.parametrize(("diagonal", "mixed"), [(0.5, False), (0.0, False), (0.5, True)])
def test_the_dual_surface_matrix_and_its_products_equal_numpy(
    diagonal, mixed, store, kind, tolerance, wavenumber
):
    """With 0.5 the rows are evaluated at the nodes themselves, without it at other points."""
    count, lanes = 6 * 47, _kernels.lanes  # not a whole number of tiles
    points, shifted, normals, others = (
        scattered_points(seed, many)
        for seed, many in ((1, count), (2, count // 3), (3, count), (7, count))
    )
    targets, single = points if diagonal else others, mixed_with(count) if mixed else HARD
    near, near_shifted = some_near_rows(4, count, 47), some_near_rows(5, count // 3, 47)
    with np.errstate(all="ignore"):
        first, second = (
            double_layer(p, points, normals, wavenumber, single) for p in (targets, shifted)
        )
    if diagonal:
        np.fill_diagonal(first, 0)
    inside = np.repeat(second + added(near_shifted, count), 3, axis=0)
    exact = -first - added(near, count) + 1j * inside + diagonal * np.eye(count)
    whole, nothing = all_pairs(count), (np.zeros(3, int), np.zeros(0, int))
    tiles = blank((4, lanes, 2, lanes), store)
    fill, multiply = (
        getattr(_kernels, f"dual_blocks_{store}"),
        getattr(_kernels, f"dual_product_{store}"),
    )
    fill(
        targets,
        shifted,
        points,
        normals,
        single,
        wavenumber,
        diagonal,
        *near,
        *near_shifted,
        *whole,
        tiles,
    )
    found = np.block(
        [[numbers(tiles[2 * row + column], store) for column in (0, 1)] for row in (0, 1)]
    )
    assert not found[:count, count:].any()
    assert relative(found[:count, :count], exact) < tolerance
    pick = np.random.default_rng(6)
    vectors = (pick.normal(size=(19, count)) + 1j * pick.normal(size=(19, count))).astype(kind)
    no_crosses = np.zeros(0, int), np.zeros(0, int), blank((0, 2, lanes), store)
    for transposed, matrix in ((False, exact), (True, exact.T)):
        out = np.empty_like(vectors)
        multiply(*whole, tiles, *nothing, *no_crosses, vectors, transposed, out)
        assert relative(out, vectors @ matrix.T) < 2 * tolerance


@pytest.mark.parametrize("wavenumber", WAVENUMBERS)
@pytest.mark.parametrize(("store", "kind", "tolerance"), STORES)
@pytest.mark.parametrize("single", [HARD, mixed_with(306)], ids=["hard", "mixed"])
def test_crosses_stand_for_tiles_as_well_as_is_asked(single, store, kind, tolerance, wavenumber):
    """Two clouds of nodes stand 12 mm apart; the second one is not a whole tile."""
    count, lanes = 6 * 51, _kernels.lanes
    points, shifted, normals = (
        scattered_points(seed, many) for seed, many in ((1, count), (2, count // 3), (3, count))
    )
    aside = np.array([0.012 + 2 * np.abs(points).max(), 0, 0])
    points[lanes:] += aside
    shifted[lanes // 3 :] += aside
    targets = points.copy()
    targets[:lanes] = points[:lanes][::-1]  # the rows need not be at the nodes
    columns = points[lanes:], normals[lanes:], wavenumber, single[lanes:]
    first, second = (double_layer(p, *columns) for p in (targets[:lanes], shifted[: lanes // 3]))
    exact = -first + 1j * np.repeat(second, 3, axis=0)
    far = np.array([0, 1, 1]), np.array([1])
    cross, multiply = (
        getattr(_kernels, f"dual_low_rank_{store}"),
        getattr(_kernels, f"dual_product_{store}"),
    )
    found, size = [], np.linalg.norm(exact)
    for asked in (0.1, 0.01):
        crosses, begin, rows = (
            np.zeros(1, int),
            np.zeros(1, int),
            blank((2 * lanes, 2, lanes), store),
        )
        skin = targets, shifted, points, normals, single, wavenumber
        needed = cross(*skin, *far, asked * size, crosses, begin, rows)
        assert needed == 2 * crosses[0] < lanes
        assert (
            cross(*skin, *far, asked * size, crosses, begin, rows[:1]) == needed
        )  # told though there is no room
        columns, of_rows = (
            numbers(rows[: crosses[0]], store),
            numbers(rows[crosses[0] : needed], store),
        )
        kept = of_rows.T @ columns
        assert not kept[:, count - lanes :].any()
        assert (
            relative(kept[:, : count - lanes], exact)
            < (1.5 if len(single) else 1) * asked + tolerance
        )
        found.append(crosses[0])
        nothing = np.zeros(3, int), np.zeros(0, int), blank((0, lanes, 2, lanes), store)
        pick = np.random.default_rng(6)
        vectors = (pick.normal(size=(19, count)) + 1j * pick.normal(size=(19, count))).astype(kind)
        for transposed in (False, True):
            out, said = np.empty_like(vectors), np.zeros((19, count), complex)
            multiply(*nothing, *far, crosses, begin, rows, vectors, transposed, out)
            if transposed:
                said[:, lanes:] = vectors[:, :lanes] @ kept[:, : count - lanes]
            else:
                said[:, :lanes] = vectors[:, lanes:] @ kept[:, : count - lanes].T
            assert relative(out, said) < 2e-5
    assert found[0] < found[1]


def test_near_panels_that_do_not_exist_are_refused():
    points = scattered_points(1, 12)
    rows = np.arange(13), np.full(12, 2), np.zeros((12, 6), complex)
    with pytest.raises(IndexError, match="a near panel does not exist"):
        fill_one_tile(points, rows)


def test_near_panels_out_of_order_are_refused():
    points = scattered_points(1, 12)
    rows = np.arange(0, 25, 2), np.tile([1, 0], 12), np.zeros((24, 6), complex)
    with pytest.raises(ValueError, match="near panels out of order"):
        fill_one_tile(points, rows)


def test_near_panels_in_tiles_that_are_not_whole_are_refused():
    points = scattered_points(1, 12)
    rows = np.arange(13), np.ones(12, int), np.zeros((12, 6), complex)
    with pytest.raises(ValueError, match="a near panel is in a block that is not whole"):
        fill_one_tile(points, rows, (np.zeros(2, int), np.zeros(0, int)))


def test_tiles_and_crosses_that_do_not_exist_are_refused():
    points = scattered_points(1, 12)
    rows = np.zeros(13, int), *NO_NEAR
    with pytest.raises(IndexError, match="a block does not exist"):
        fill_one_tile(points, rows, (np.array([0, 1]), np.array([1])))
    none = (
        np.zeros(2, int),
        np.zeros(0, int),
        blank((0, _kernels.lanes, 2, _kernels.lanes), "float32"),
    )
    crosses = np.ones(1, int), np.zeros(1, int), blank((1, 2, _kernels.lanes), "float32")
    vectors = np.zeros((1, 12), np.complex64)
    with pytest.raises(IndexError, match="a low-rank term does not exist"):
        _kernels.dual_product_float32(
            *none, np.array([0, 1]), np.zeros(1, int), *crosses, vectors, False, vectors
        )


def fill_one_tile(points, rows, whole=None) -> None:
    whole = whole or all_pairs(len(points))
    none = np.zeros(len(points) // 3 + 1, int), *NO_NEAR
    tiles = blank((len(whole[1]), _kernels.lanes, 2, _kernels.lanes), "float32")
    third = points[: len(points) // 3]
    _kernels.dual_blocks_float32(
        points, third, points, points, HARD, 700.0 + 0j, 0.5, *rows, *none, *whole, tiles
    )


@pytest.mark.parametrize("wavenumber", WAVENUMBERS)
@pytest.mark.parametrize(("precision", "kind", "tolerance"), PRECISIONS)
@pytest.mark.parametrize(("receivers", "count"), [(40, 700), (600, 1), (600, 16), (600, 17)])
def test_monopole_loop_equals_numpy(receivers, count, precision, kind, tolerance, wavenumber):
    points, sources = scattered_points(1, receivers), scattered_points(3, count)
    strength = np.random.default_rng(5).normal(size=(count, 2)) + 1j
    strength[0, 1] = 0
    distance = np.linalg.norm(points[:, None] - sources[None], axis=2)
    out = np.full((receivers, 2), np.nan, np.complex128)
    getattr(_kernels, f"apply_monopoles_{precision}")(points, sources, strength, wavenumber, out)
    assert relative(out, np.exp(1j * wavenumber * distance) / distance @ strength) < 3 * tolerance


@pytest.mark.parametrize(("precision", "kind", "tolerance"), PRECISIONS)
def test_sound_that_has_decayed_is_nearly_nothing(precision, kind, tolerance):
    points, out = (
        np.array([[0.01, 0, 0], [0.1, 0, 0], [100.0, 0, 0]]),
        np.empty((3, 1), np.complex128),
    )
    source, strength = np.zeros((1, 3)), np.ones((1, 1), np.complex128)
    getattr(_kernels, f"apply_monopoles_{precision}")(points, source, strength, 732.5 + 2000j, out)
    assert abs(out[0, 0]) == pytest.approx(np.exp(-20) / 0.01, rel=30 * tolerance)
    assert (abs(out[1:]) < 1e-33).all()  # e^-200 and e^-200000 are taken as about e^-80


@pytest.mark.parametrize("inside", [True, False])
@pytest.mark.parametrize("wavenumber", WAVENUMBERS)
def test_sums_in_cells_equal_numpy(wavenumber, inside):
    points, sources, normals = (
        scattered_points(1, 40),
        scattered_points(3, 700),
        scattered_points(4, 700) * 1e-3,
    )
    centres, bounds = scattered_points(6, 3), np.array([0, 15, 15, 40])
    density = np.random.default_rng(5).normal(size=(700, 3)) + 1j
    cell = np.repeat(np.arange(3), np.diff(bounds))
    near = np.linalg.norm(sources[None] - centres[cell][:, None], axis=2) < 0.03
    distance = np.linalg.norm(points[:, None] - sources[None], axis=2)
    found = np.empty((40, 3), np.complex128)
    given = points, bounds, centres, 0.03, inside, sources
    _kernels.apply_in_cells(*given, None, HARD, density, wavenumber, 0.0, found)
    monopoles = np.exp(1j * wavenumber * distance) / distance
    assert relative(found, np.where(near == inside, monopoles, 0) @ density) < 1e-5
    for single in (HARD, mixed_with(700)):
        _kernels.apply_in_cells(*given, normals, single, density, wavenumber, 0.02, found)
        layer = double_layer(points, sources, normals, wavenumber, single)
        assert (
            relative(found, np.where((near == inside) & (distance > 0.02), layer, 0) @ density)
            < 6e-5
        )
    with pytest.raises(IndexError, match="before it begins"):
        _kernels.apply_in_cells(
            points, bounds[::-1].copy(), *given[2:], None, HARD, density, wavenumber, 0.0, found
        )


def test_values_between_those_of_a_table_equal_numpy():
    random = np.random.default_rng(11)
    table = random.normal(size=(7, 9, 4, 3)) + 1j * random.normal(size=(7, 9, 4, 3))
    rows, columns = random.integers(0, 3, 50), random.integers(0, 5, 50)
    u, v, w = (random.normal(size=(50, size)) for size in (5, 5, 4))
    steps = np.array([9 * 4 * 3, 4 * 3])
    found = np.empty((50, 3), np.complex128)
    places = rows * steps[0] + columns * steps[1]
    weights = [part.astype(np.float32) for part in (u, v, w)]
    _kernels.interpolate(table.astype(np.complex64).ravel(), places, steps, *weights, found)
    read = np.stack([table[i : i + 5, j : j + 5] for i, j in zip(rows, columns, strict=True)])
    assert relative(found, np.einsum("pa,pb,pc,pabcs->ps", u, v, w, read)) < 1e-6
    with pytest.raises(IndexError, match="beyond the table"):
        _kernels.interpolate(
            table.astype(np.complex64).ravel(), places + 400, steps, *weights, found
        )


@pytest.mark.parametrize(("precision", "most"), [("float32", 1e-6), ("float64", 1e-14)])
def test_chebyshev_sums_of_a_sparse_matrix_equal_numpy(precision, most):
    random = np.random.default_rng(12)
    dense = random.normal(size=(60, 60)) * (random.random((60, 60)) < 0.1) / 3
    sparse, given = csr_matrix(dense, dtype=precision), random.normal(size=(60, 37))
    factors = random.normal(size=9)
    terms = [given, dense @ given / 2]
    for _ in factors[2:]:
        terms.append(dense @ terms[-1] + terms[-2])
    found, parts = given.astype(precision), (sparse.data, sparse.indices, sparse.indptr)
    loop("chebyshev_sum", precision)(*parts, factors.astype(precision), found)
    assert relative(found, np.tensordot(factors, terms, 1)) < most
    with pytest.raises(IndexError, match="beyond the matrix"):
        loop("chebyshev_sum", precision)(
            *parts[:1], parts[1] + 1, parts[2], factors.astype(precision), found
        )
    with pytest.raises(ValueError, match="different lengths"):
        loop("chebyshev_sum", precision)(*parts, factors.astype(precision), found[1:].copy())


def test_a_long_way_from_the_origin_float32_keeps_its_digits():
    points, sources = scattered_points(1, 40), scattered_points(3, 300)
    near, far = np.empty((40, 1), np.complex128), np.empty((40, 1), np.complex128)
    strength, away = np.ones((300, 1), np.complex128), np.array([3.0, -2.0, 5.0])
    _kernels.apply_monopoles_float32(points, sources, strength, 732.5 + 0j, near)
    _kernels.apply_monopoles_float32(points + away, sources + away, strength, 732.5 + 0j, far)
    assert relative(far, near) < 2e-5


def test_arrays_of_different_lengths_are_refused():
    points = scattered_points(1, 4)
    with pytest.raises(ValueError, match="different lengths"):
        _kernels.apply_monopoles_float64(
            points, points, np.ones((3, 1), complex), 1 + 0j, np.empty((4, 1), complex)
        )


FLAT = np.array([[[0, 0, 0], [4, 0, 0], [1, 3, 0], [2, 0, 0], [2.5, 1.5, 0], [0.5, 1.5, 0]]]) * 1e-3
CURVED = FLAT + np.array(
    [[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 4e-4], [0, 0, 5e-4], [0, 0, 3e-4]]
)


def gauss_rules() -> tuple[np.ndarray, np.ndarray, int]:
    rules = [np.polynomial.legendre.leggauss(n) for n in range(1, 41)]
    return (
        np.concatenate([0.5 * (x + 1) for x, _ in rules]),
        np.concatenate([0.5 * w for _, w in rules]),
        40,
    )


def near_moments(panel, target, wavenumber, points, single_layer=False, contact=0.0):
    out, distance, foot = np.empty((1, 6), complex), np.empty(1), np.empty((1, 2))
    zero, limit = np.zeros(1, dtype=np.int64), np.array([contact])
    rules = gauss_rules()
    _kernels.near_integrals(
        single_layer,
        target[None],
        zero,
        zero,
        panel,
        limit,
        wavenumber,
        *rules,
        *points,
        out,
        distance,
        foot,
    )
    return out[0], distance[0], foot[0]


def panel_at(panel, u, v):
    w = 1 - u - v
    shape = np.array(
        [w * (2 * w - 1), u * (2 * u - 1), v * (2 * v - 1), 4 * w * u, 4 * u * v, 4 * v * w]
    )
    along_u = np.array([1 - 4 * w, 4 * u - 1, 0, 4 * (w - u), 4 * v, -4 * v])
    along_v = np.array([1 - 4 * w, 0, 4 * v - 1, -4 * u, 4 * u, 4 * (w - v)])
    return shape @ panel[0], np.cross(along_u @ panel[0], along_v @ panel[0])


@pytest.mark.parametrize("panel", [FLAT, CURVED], ids=["flat", "curved"])
@pytest.mark.parametrize("single_layer", [False, True], ids=["double", "single"])
def test_near_integral_equals_adaptive_quadrature(panel, single_layer):
    target, wavenumber = np.array([1.2e-3, 0.8e-3, 1.5e-3]), 732.5 + 3j

    def integrand(v, u, part, power):
        point, normal = panel_at(panel, u, v)
        offset = point - target
        distance = np.linalg.norm(offset)
        green = np.exp(1j * wavenumber * distance) / (4 * np.pi * distance)
        kernel = green * np.linalg.norm(normal)
        if not single_layer:
            kernel = green * (1j * wavenumber - 1 / distance) * (offset @ normal) / distance
        return getattr(kernel * u**power, part)

    found, _, _ = near_moments(panel, target, wavenumber, (10, 10), single_layer)
    for index, power in ((0, 0), (1, 1), (3, 2)):
        expected = complex(
            *(
                dblquad(integrand, 0, 1, 0, lambda u: 1 - u, (part, power), 1e-12)[0]
                for part in ("real", "imag")
            )
        )
        assert abs(found[index] - expected) < 1e-7 * abs(expected)


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 2e-5), ("float64", 1e-12)])
@pytest.mark.parametrize("height", [0.0, 1e-5, 1e-3])
@pytest.mark.parametrize("admittance", [0j, 300 - 500j])
@pytest.mark.parametrize("wavenumber", [732.5 + 0j, 732.5 + 3j])
def test_what_a_near_panel_adds_is_its_integral_less_the_plain_nodes(
    wavenumber, admittance, height, precision, tolerance
):
    nodal = np.random.default_rng(1).normal(size=(6, 6))
    foot, normal = panel_at(CURVED, 0.2, 0.3)
    target = foot + height * normal / np.linalg.norm(normal)
    sources, normals = scattered_points(2, 6) * 0.1, scattered_points(3, 6) * 1e-4
    moments, singles = (
        near_moments(CURVED, target, wavenumber, (5, 5), single)[0] for single in (False, True)
    )
    far = np.linalg.norm(sources - target, axis=1) > 2e-3
    mixed = admittance * np.linalg.norm(normals, axis=1)
    plain = double_layer(target[None], sources, normals, wavenumber, mixed)[0]
    expected = (moments + admittance * singles) @ nodal - np.where(far, plain, 0)
    out = np.empty((1, 6), complex)
    lists = np.array([0, 1]), np.zeros(1, dtype=np.int64)
    getattr(_kernels, f"near_excess_{precision}")(
        target[None],
        *lists,
        CURVED,
        np.zeros(1),
        sources,
        normals,
        mixed if admittance else HARD,
        nodal,
        wavenumber,
        2e-3,
        *gauss_rules(),
        5,
        5,
        out,
    )
    assert relative(out[0], expected) < tolerance


@pytest.mark.parametrize("height", [0.0, 1e-7, 1e-5, 1e-3])
@pytest.mark.parametrize("single_layer", [False, True], ids=["double", "single"])
def test_few_points_suffice_at_any_height_over_a_panel(height, single_layer):
    foot = panel_at(CURVED, 0.2, 0.3)
    target = foot[0] + height * foot[1] / np.linalg.norm(foot[1])
    few, distance, place = near_moments(CURVED, target, 732.5 + 0j, (4, 4), single_layer)
    many, _, _ = near_moments(CURVED, target, 732.5 + 0j, (16, 16), single_layer)
    assert np.abs(few - many).max() < 2e-3 * np.abs(many).max()
    assert distance == pytest.approx(height, abs=1e-15)
    assert place == pytest.approx([0.2, 0.3], abs=1e-6)


@pytest.mark.parametrize("place", [(0.2, 0.3), (0.0, 0.0), (0.0, 1.0), (0.5, 0.0), (0.4, 0.6)])
def test_a_point_in_contact_is_heard_as_on_the_panel(place):
    foot, normal = panel_at(CURVED, *place)
    exact, _, _ = near_moments(CURVED, foot, 732.5 + 0j, (12, 12), contact=1e-12)
    for height in (-1e-6, -1e-9, 1e-12, 1e-8, 1e-6):
        target = foot + height * normal / np.linalg.norm(normal)
        found, distance, _ = near_moments(CURVED, target, 732.5 + 0j, (12, 12), contact=2e-6)
        assert np.abs(found - exact).max() < 1e-4 * np.abs(exact).max()
        assert distance == pytest.approx(abs(height), rel=1e-3)


def test_flat_panel_fills_its_solid_angle():
    """Van Oosterom & Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125, equation (8)."""
    target = np.array([1.0e-3, 0.5e-3, 2e-4])
    a, b, c = (FLAT[0, i] - target for i in range(3))
    na, nb, nc = (np.linalg.norm(x) for x in (a, b, c))
    angle = 2 * np.arctan2(
        a @ np.cross(b, c), na * nb * nc + (a @ b) * nc + (a @ c) * nb + (b @ c) * na
    )
    found, _, _ = near_moments(FLAT, target, 0j, (12, 12))
    assert found[0].real == pytest.approx(-angle / (4 * np.pi), rel=1e-7)


@pytest.mark.parametrize("within", [1e-4, 0.01, 0.05, 1.0])
@pytest.mark.parametrize("count", [0, 1, 300])
def test_distances_of_panels_are_those_of_their_nodes_and_middles(count, within):
    panels, points = scattered_points(3, 240).reshape(40, 6, 3), scattered_points(4, count)
    distance = np.empty(40)
    _kernels.panel_distances(panels, points, within, distance)
    samples = np.concatenate([panels, panels.mean(axis=1, keepdims=True)], axis=1)
    apart = np.linalg.norm(samples[:, :, None] - points, axis=3)
    least = apart.min(axis=(1, 2), initial=np.inf)
    assert np.allclose(distance, np.where(least < within, least, np.inf), rtol=1e-12)


@pytest.mark.parametrize("count", [3, 500])
def test_nodes_are_placed_as_by_numpy(count):
    pick = np.random.default_rng(3)
    panels = CURVED + 1e-4 * pick.normal(size=(count, 6, 3))
    (points, normals), areas = np.empty((2, 6 * count, 3)), np.empty(6 * count)
    centres, radii = np.empty((count, 3)), np.empty(count)
    _kernels.place_nodes(panels, RULE, RULE_WEIGHTS, points, normals, areas, centres, radii)
    along = np.cross(RULE[6:12] @ panels, RULE[12:18] @ panels)
    size = np.linalg.norm(along, axis=2)
    assert np.allclose(points, (RULE[:6] @ panels).reshape(-1, 3), rtol=1e-13, atol=0)
    assert np.allclose(normals, (along / size[:, :, None]).reshape(-1, 3), rtol=1e-12, atol=1e-15)
    assert np.allclose(areas, (size * RULE_WEIGHTS).ravel(), rtol=1e-12, atol=0)
    assert np.allclose(centres, RULE[18] @ panels, rtol=1e-13, atol=0)
    assert np.allclose(
        radii, np.linalg.norm(panels - centres[:, None], axis=2).max(axis=1), rtol=1e-13, atol=0
    )


@pytest.mark.parametrize(
    "reach", [np.linspace(0.01, 0.05, 80), np.geomspace(1e-6, 0.08, 80), np.full(80, 1e-9)]
)
def test_near_pairs_are_those_within_reach(reach):
    points, centres = scattered_points(1, 50), scattered_points(2, 80)
    points[:5] = centres[:5]
    first, panel = _kernels.near_pairs(points, centres, reach)
    expected = np.nonzero(np.linalg.norm(points[:, None] - centres[None], axis=2) < reach)
    assert np.array_equal(np.repeat(np.arange(50), np.diff(first)), expected[0])
    assert np.array_equal(panel, expected[1])
