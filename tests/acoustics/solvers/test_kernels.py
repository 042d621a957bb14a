"""The compiled loops against NumPy twins that share no code with them."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.sparse import csr_matrix

from airtact import _kernels
from airtact.acoustics.solvers.bem.quadrature import RULE, RULE_WEIGHTS, near_quadrature
from references import relative

pytestmark = pytest.mark.usefixtures("variant")

PRECISIONS = [("float32", np.complex64, 2e-5), ("float64", np.complex128, 1e-13)]
precisions = pytest.mark.parametrize(("precision", "kind", "tolerance"), PRECISIONS)
wavenumbers = pytest.mark.parametrize("wavenumber", [732.5 + 0j, 732.5 + 3.1j, 0j])
HARD = np.zeros(0, complex)
"""The single layer of sound-hard surfaces."""


def random_complex(seed: int, *shape: int) -> np.ndarray:
    pick = np.random.default_rng(seed)
    return pick.normal(size=shape) + 1j * pick.normal(size=shape)


def scattered_points(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3)) * 0.03


def yielding(count: int) -> np.ndarray:
    """A single layer about as strong as the double layer."""
    return 0.5 * random_complex(9, count)


SOURCES = scattered_points(3, 700)
NORMALS = scattered_points(4, 700) * 1e-3
singles = pytest.mark.parametrize("single", [HARD, yielding(700)], ids=["hard", "yielding"])


def double_layer(points, sources, normals, wavenumber, single=HARD):
    offset = sources[None] - points[:, None]
    distance = np.linalg.norm(offset, axis=2)
    slope = (offset * normals).sum(axis=2) / distance
    strength = slope * (1j * wavenumber - 1 / distance) + (single if len(single) else 0)
    return strength * np.exp(1j * wavenumber * distance) / (4 * np.pi * distance)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: _kernels.use_variant("abacus"), "abacus"),
        (lambda: monopoles_at(np.ones((4, 1)), "half"), "float32"),
        (lambda: monopoles_at(np.ones((3, 1)), "float64"), "different lengths"),
        (lambda: _kernels.Layer(np.zeros((4, 3)), np.zeros((3, 3)), HARD, 1j), "different lengths"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(call, words):
    with pytest.raises(ValueError, match=words):
        call()


def monopoles_at(strengths: np.ndarray, precision: str) -> np.ndarray:
    points = scattered_points(1, 4)
    return _kernels.apply_monopoles(points, points + 1, strengths, 1j, precision)


@wavenumbers
@precisions
@singles
def test_double_layer_loops_equal_numpy(single, precision, kind, tolerance, wavenumber):
    points = scattered_points(1, 40)
    inside = scattered_points(2, 40)
    layer = _kernels.Layer(SOURCES, NORMALS, single, wavenumber)
    expected = double_layer(points, SOURCES, NORMALS, wavenumber, single)
    matrix = _kernels.double_layer_matrix(points, layer, precision)
    assert matrix.dtype == kind
    assert relative(matrix, expected) < tolerance
    dual = 1j * double_layer(inside, SOURCES, NORMALS, wavenumber, single) - expected
    assert relative(_kernels.dual_matrix(points, inside, layer, precision), dual) < tolerance
    density = random_complex(5, 700, 3)
    distance = np.linalg.norm(points[:, None] - SOURCES[None], axis=2)
    for least in (0.0, 0.02):
        applied = _kernels.apply_double_layer(points, layer, density, least, precision)
        sums = np.where(distance > least, expected, 0) @ density
        assert relative(applied, sums) < 3 * tolerance


@wavenumbers
@precisions
@singles
@pytest.mark.parametrize("count", [1, 16, 17, 300])
def test_a_transposed_double_layer_equals_numpy(
    count, single, precision, kind, tolerance, wavenumber
):
    points = scattered_points(1, count)
    strengths = random_complex(5, count, 3)
    strengths[0, 1] = 0
    layer = _kernels.Layer(SOURCES, NORMALS, single, wavenumber)
    applied = _kernels.apply_transposed(points, layer, strengths, precision)
    expected = double_layer(points, SOURCES, NORMALS, wavenumber, single).T @ strengths
    assert relative(applied, expected) < 3 * tolerance


@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("shape", [(1, 1), (7, 300), (301, 6), (640, 530)])
def test_products_with_few_vectors_equal_numpy(shape, transposed):
    numbers = np.random.default_rng(1).integers(-32767, 32768, (*shape, 2)).astype(np.int16)
    scales = np.random.default_rng(2).random(shape[0]).astype(np.float32)
    rounded = (numbers[..., 0] + 1j * numbers[..., 1]) * scales[:, None]
    vectors = random_complex(3, 3, shape[0 if transposed else 1]).astype(np.complex64)
    out = _kernels.few_rounded_products(numbers, scales, vectors, transposed)
    assert relative(out, vectors @ (rounded if transposed else rounded.T)) < 1e-6
    for _, kind, tolerance in PRECISIONS:
        matrix = random_complex(1, *shape).astype(kind)
        factors = vectors.astype(kind)
        products = _kernels.few_products(matrix, factors, transposed)
        exact = (matrix if transposed else matrix.T).astype(complex)
        assert relative(products, factors.astype(complex) @ exact) < tolerance


def krylov_spaces(sides: int, steps: int) -> _kernels.KrylovSpaces:
    packed = steps * (steps + 1) // 2
    return _kernels.KrylovSpaces(
        rotations=np.empty((sides, steps, 2), complex),
        right=np.ones((sides, steps + 1), complex),
        triangles=np.empty((sides, packed), complex),
        inverses=np.empty((sides, packed), complex),
        weights=np.empty((sides, steps), complex),
        squares=np.zeros(sides),
    )


@precisions
@pytest.mark.parametrize("size", [3, 90])
def test_krylov_steps_find_the_least_residual(size, precision, kind, tolerance):
    steps = min(size, 5)
    matrix = random_complex(2, size, size).astype(kind)
    bases = np.empty((steps + 1, 3, size), kind)
    bases[0] = random_complex(3, 3, size)
    bases[0] /= np.linalg.norm(bases[0], axis=1)[:, None]
    spaces = krylov_spaces(3, steps)
    for step in range(1, steps + 1):
        bases[step] = bases[step - 1] @ matrix.T
        _kernels.krylov_step(bases[: step + 1], spaces)
        for side in range(3):
            space = bases[:step, side].T
            assert np.allclose(space.conj().T @ space, np.eye(step), atol=30 * tolerance)
            best = np.linalg.lstsq(matrix @ space, bases[0, side], rcond=None)[0]
            least = np.linalg.norm(matrix @ space @ best - bases[0, side])
            assert abs(abs(spaces.right[side, step]) - least) < 100 * tolerance
            triangle = np.zeros((step, step), complex)
            column, row = np.tril_indices(step)
            triangle[row, column] = spaces.triangles[side, : len(row)]
            inverse = np.linalg.inv(triangle)
            assert np.isclose(spaces.squares[side], np.linalg.norm(inverse) ** 2)
            weights = spaces.weights[side, :step]
            assert np.allclose(weights, inverse @ spaces.right[side, :step])
            assert np.allclose(weights, best, atol=1000 * tolerance)


LANES = _kernels.lanes
STORES = [("bfloat16", np.complex64, 2.5e-3), *PRECISIONS]


def near_rows(seed: int, count: int, panels: int) -> _kernels.NearRows:
    """Two panels near every target, with corrections to the entries of their nodes."""
    pick = np.random.default_rng(seed)
    panel = np.stack([np.sort(pick.permutation(panels)[:2]) for _ in range(count)]).ravel()
    excess = 30 * random_complex(seed, 2 * count, 6)
    return _kernels.NearRows(np.arange(0, 2 * count + 1, 2), panel, excess)


def without_near(targets: int) -> _kernels.NearRows:
    nothing = np.zeros(0, int), np.zeros((0, 6), complex)
    return _kernels.NearRows(np.zeros(targets + 1, int), *nothing)


def dense(rows: _kernels.NearRows, count: int) -> np.ndarray:
    matrix = np.zeros((len(rows.first) - 1, count), complex)
    target = np.repeat(np.arange(len(rows.first) - 1), np.diff(rows.first))
    for node in range(6):
        np.add.at(matrix, (target, 6 * rows.panel + node), rows.excess[:, node])
    return matrix


def all_pairs(count: int) -> _kernels.Pairs:
    blocks = -(-count // LANES)
    return _kernels.Pairs(blocks * np.arange(blocks + 1), np.tile(np.arange(blocks), blocks))


def no_pairs(blocks: int) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros(blocks + 1, int), np.zeros(0, int)


def blank(store: str, *shape: int) -> np.ndarray:
    """Rows of so many numbers, in the words of a store."""
    halves = store == "bfloat16"
    return np.zeros((*shape[:-1], shape[-1] // (1 + halves)), np.uint32 if halves else store)


def numbers_of(rows: np.ndarray) -> np.ndarray:
    """Complex numbers of rows (..., 2, W)."""
    if rows.dtype == np.uint32:
        rows = np.concatenate([rows << 16, rows & 0xFFFF0000], axis=-1).view(np.float32)
    return rows[..., 0, :] + 1j * rows[..., 1, :]


@wavenumbers
@pytest.mark.parametrize(("store", "kind", "tolerance"), STORES)
@pytest.mark.parametrize(("diagonal", "hard"), [(0.5, True), (0.0, True), (0.5, False)])
def test_the_dual_surface_matrix_and_its_products_equal_numpy(
    diagonal, hard, store, kind, tolerance, wavenumber
):
    """With 0.5 the rows are evaluated at the nodes themselves, without it at other points."""
    count = 6 * 47  # not a multiple of a block
    points = scattered_points(1, count)
    shifted = scattered_points(2, count // 3)
    normals = scattered_points(3, count)
    targets = points if diagonal else scattered_points(7, count)
    single = HARD if hard else yielding(count)
    near = near_rows(4, count, 47)
    near_shifted = near_rows(5, count // 3, 47)
    with np.errstate(all="ignore"):
        first = double_layer(targets, points, normals, wavenumber, single)
    if diagonal:
        np.fill_diagonal(first, 0)
    second = double_layer(shifted, points, normals, wavenumber, single) + dense(near_shifted, count)
    exact = diagonal * np.eye(count) - first - dense(near, count)
    exact = exact + 1j * np.repeat(second, 3, axis=0)
    whole = all_pairs(count)
    blocks = blank(store, 4, LANES, 2, LANES)
    layer = _kernels.Layer(points, normals, single, wavenumber)
    _kernels.dual_blocks(
        targets, shifted, layer, diagonal, near, near_shifted, whole=whole, out=blocks
    )
    numbers = numbers_of(blocks)
    matrix = np.block([[numbers[0], numbers[1]], [numbers[2], numbers[3]]])
    assert not matrix[:count, count:].any()
    assert relative(matrix[:count, :count], exact) < tolerance
    vectors = random_complex(6, 19, count).astype(kind)
    far = _kernels.FarBlocks(*no_pairs(2), np.zeros(0, int), np.zeros(0, int))
    factors = blank(store, 0, 2, LANES)
    for transposed in (False, True):
        out = _kernels.dual_product(whole, blocks, far, factors, vectors, transposed)
        assert relative(out, vectors @ (exact if transposed else exact.T)) < 2 * tolerance


@wavenumbers
@pytest.mark.parametrize(("store", "kind", "tolerance"), STORES)
@pytest.mark.parametrize("hard", [True, False])
def test_low_rank_terms_have_the_error_asked_for(hard, store, kind, tolerance, wavenumber):
    """Two clouds of nodes stand 12 mm apart; the second one is less than a block."""
    count = 6 * 51
    points = scattered_points(1, count)
    shifted = scattered_points(2, count // 3)
    normals = scattered_points(3, count)
    single = HARD if hard else yielding(count)
    apart = np.array([0.012 + 2 * np.abs(points).max(), 0, 0])
    points[LANES:] += apart
    shifted[LANES // 3 :] += apart
    targets = points.copy()
    targets[:LANES] = points[:LANES][::-1]  # the rows need not be at the nodes
    columns = points[LANES:], normals[LANES:], wavenumber, single[LANES:]
    second = double_layer(shifted[: LANES // 3], *columns)
    exact = 1j * np.repeat(second, 3, axis=0) - double_layer(targets[:LANES], *columns)
    layer = _kernels.Layer(points, normals, single, wavenumber)
    whole = _kernels.Pairs(*no_pairs(2))
    blocks = blank(store, 0, LANES, 2, LANES)
    vectors = random_complex(6, 19, count).astype(kind)
    ranks = []
    for error in (0.1, 0.01):
        far = _kernels.FarBlocks(
            np.array([0, 1, 1]), np.array([1]), np.zeros(1, int), np.zeros(1, int)
        )
        factors = blank(store, 2 * LANES, 2, LANES)
        limit = error * np.linalg.norm(exact)
        needed = _kernels.dual_low_rank(targets, shifted, layer, far, limit, factors)
        rank = int(far.ranks[0])
        assert needed == 2 * rank < LANES
        # the number is returned even if there is no room
        assert _kernels.dual_low_rank(targets, shifted, layer, far, limit, factors[:1]) == needed
        numbers = numbers_of(factors)
        block = numbers[rank:needed].T @ numbers[:rank]
        assert not block[:, count - LANES :].any()
        block = block[:, : count - LANES]
        assert relative(block, exact) < (1 if hard else 1.5) * error + tolerance
        ranks.append(rank)
        for transposed in (False, True):
            out = _kernels.dual_product(whole, blocks, far, factors, vectors, transposed)
            expected = np.zeros((19, count), complex)
            if transposed:
                expected[:, LANES:] = vectors[:, :LANES] @ block
            else:
                expected[:, :LANES] = vectors[:, LANES:] @ block.T
            assert relative(out, expected) < 2e-5
    assert ranks[0] < ranks[1]


ONE_BLOCK = _kernels.Pairs(np.array([0, 1]), np.array([0]))


@pytest.mark.parametrize(
    ("first", "panel", "whole", "words"),
    [
        (np.arange(13), np.full(12, 2), ONE_BLOCK, "a near panel does not exist"),
        (np.arange(0, 25, 2), np.tile([1, 0], 12), ONE_BLOCK, "near panels out of order"),
        (np.arange(13), np.ones(12, int), _kernels.Pairs(*no_pairs(1)), "not whole"),
    ],
)
def test_near_panels_that_do_not_fit_the_blocks_are_refused(first, panel, whole, words):
    points = scattered_points(1, 12)
    rows = _kernels.NearRows(first, panel, np.zeros((len(panel), 6), complex))
    layer = _kernels.Layer(points, points, HARD, 700.0 + 0j)
    blocks = blank("float32", len(whole.column), LANES, 2, LANES)
    with pytest.raises((IndexError, ValueError), match=words):
        _kernels.dual_blocks(
            points, points[:4], layer, 0.5, rows, without_near(4), whole=whole, out=blocks
        )


def test_blocks_that_do_not_exist_are_refused():
    with pytest.raises(IndexError, match="a block does not exist"):
        _kernels.Pairs(np.array([0, 1]), np.array([1]))
    far = _kernels.FarBlocks(np.array([0, 1]), np.zeros(1, int), np.ones(1, int), np.zeros(1, int))
    whole = _kernels.Pairs(*no_pairs(1))
    blocks = blank("float32", 0, LANES, 2, LANES)
    vectors = np.zeros((1, 12), np.complex64)
    with pytest.raises(IndexError, match="a low-rank term does not exist"):
        _kernels.dual_product(whole, blocks, far, blank("float32", 1, 2, LANES), vectors, False)


@wavenumbers
@precisions
@pytest.mark.parametrize(("receivers", "count"), [(40, 700), (600, 1), (600, 16), (600, 17)])
def test_monopole_loop_equals_numpy(receivers, count, precision, kind, tolerance, wavenumber):
    points = scattered_points(1, receivers)
    sources = SOURCES[:count]
    strengths = random_complex(5, count, 2)
    strengths[0, 1] = 0
    distance = np.linalg.norm(points[:, None] - sources[None], axis=2)
    out = _kernels.apply_monopoles(points, sources, strengths, wavenumber, precision)
    assert relative(out, np.exp(1j * wavenumber * distance) / distance @ strengths) < 3 * tolerance


@precisions
def test_sound_that_has_decayed_is_nearly_nothing(precision, kind, tolerance):
    points = np.array([[0.01, 0, 0], [0.1, 0, 0], [100.0, 0, 0]])
    one = np.ones((1, 1), complex)
    out = _kernels.apply_monopoles(points, np.zeros((1, 3)), one, 732.5 + 2000j, precision)
    assert abs(out[0, 0]) == pytest.approx(np.exp(-20) / 0.01, rel=30 * tolerance)
    assert (abs(out[1:]) < 1e-33).all()  # e^-200 and e^-200000 are taken as about e^-80


@wavenumbers
@pytest.mark.parametrize("inside", [True, False])
def test_sums_in_cells_equal_numpy(wavenumber, inside):
    points = scattered_points(1, 40)
    centres = scattered_points(6, 3)
    first = np.array([0, 15, 15, 40])
    cells = _kernels.Cells(points, first, centres, 0.03)
    density = random_complex(5, 700, 3)
    own_centre = centres[np.repeat(np.arange(3), np.diff(first))]
    near = np.linalg.norm(SOURCES[None] - own_centre[:, None], axis=2) < 0.03
    distance = np.linalg.norm(points[:, None] - SOURCES[None], axis=2)
    monopoles = _kernels.Layer(SOURCES, None, HARD, wavenumber)
    out = _kernels.apply_in_cells(cells, inside, monopoles, density, 0.0)
    plain = np.exp(1j * wavenumber * distance) / distance
    assert relative(out, np.where(near == inside, plain, 0) @ density) < 1e-5
    for single in (HARD, yielding(700)):
        layer = _kernels.Layer(SOURCES, NORMALS, single, wavenumber)
        out = _kernels.apply_in_cells(cells, inside, layer, density, 0.02)
        plain = double_layer(points, SOURCES, NORMALS, wavenumber, single)
        chosen = (near == inside) & (distance > 0.02)
        assert relative(out, np.where(chosen, plain, 0) @ density) < 6e-5
    with pytest.raises(IndexError, match="before it begins"):
        _kernels.Cells(points, first[::-1].copy(), centres, 0.03)


def test_values_between_those_of_a_table_equal_numpy():
    table = random_complex(11, 7, 9, 4, 3)
    pick = np.random.default_rng(11)
    rows = pick.integers(0, 3, 50)
    columns = pick.integers(0, 5, 50)
    weights = [pick.normal(size=(50, size)).astype(np.float32) for size in (5, 5, 4)]
    steps = np.array([9 * 4 * 3, 4 * 3])
    places = rows * steps[0] + columns * steps[1]
    flat = table.astype(np.complex64).reshape(-1, 3)
    out = _kernels.interpolate(flat, places, steps, *weights)
    read = np.stack([table[i : i + 5, j : j + 5] for i, j in zip(rows, columns, strict=True)])
    assert relative(out, np.einsum("pa,pb,pc,pabcs->ps", *weights, read)) < 1e-6
    with pytest.raises(IndexError, match="beyond the table"):
        _kernels.interpolate(flat, places + 400, steps, *weights)


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 1e-6), ("float64", 1e-14)])
def test_chebyshev_sums_of_a_sparse_matrix_equal_numpy(precision, tolerance):
    pick = np.random.default_rng(12)
    matrix = pick.normal(size=(60, 60)) * (pick.random((60, 60)) < 0.1) / 3
    sparse = csr_matrix(matrix, dtype=precision)
    given = pick.normal(size=(60, 37))
    factors = pick.normal(size=9)
    terms = [given, matrix @ given / 2]
    for _ in factors[2:]:
        terms.append(matrix @ terms[-1] + terms[-2])
    out = given.astype(precision)
    single = factors.astype(precision)
    _kernels.chebyshev_sum(sparse.data, sparse.indices, sparse.indptr, single, out)
    assert relative(out, np.tensordot(factors, terms, 1)) < tolerance
    with pytest.raises(IndexError, match="beyond the matrix"):
        _kernels.chebyshev_sum(sparse.data, sparse.indices + 1, sparse.indptr, single, out)
    with pytest.raises(ValueError, match="different lengths"):
        _kernels.chebyshev_sum(sparse.data, sparse.indices, sparse.indptr, single, out[1:].copy())


FLAT = np.array([[[0, 0, 0], [4, 0, 0], [1, 3, 0], [2, 0, 0], [2.5, 1.5, 0], [0.5, 1.5, 0]]]) * 1e-3
BULGE = np.zeros((6, 3))
BULGE[3:, 2] = [4e-4, 5e-4, 3e-4]
CURVED = FLAT + BULGE
layers = pytest.mark.parametrize("single_layer", [False, True], ids=["double", "single"])


def near_moments(panel, target, wavenumber, points, single_layer=False, contact=0.0):
    zero = np.zeros(1, dtype=np.int64)
    moments, distance, foot = _kernels.near_integrals(
        single_layer,
        target[None],
        zero,
        zero,
        _kernels.Panels(panel, np.array([contact])),
        wavenumber=wavenumber,
        quadrature=near_quadrature(points, points),
    )
    return moments[0], distance[0], foot[0]


def panel_at(panel, u, v):
    w = 1 - u - v
    shape = [w * (2 * w - 1), u * (2 * u - 1), v * (2 * v - 1), 4 * w * u, 4 * u * v, 4 * v * w]
    along_u = np.array([1 - 4 * w, 4 * u - 1, 0, 4 * (w - u), 4 * v, -4 * v])
    along_v = np.array([1 - 4 * w, 0, 4 * v - 1, -4 * u, 4 * u, 4 * (w - v)])
    return np.array(shape) @ panel[0], np.cross(along_u @ panel[0], along_v @ panel[0])


ABOVE = np.array([1.2e-3, 0.8e-3, 1.5e-3])


@cache
def adaptive_moments(curved, single_layer, wavenumber):
    """Moments of a panel at ``ABOVE``: with the weights 1, u and u squared."""
    panel = CURVED if curved else FLAT

    def integrand(v, u, part, power):
        point, normal = panel_at(panel, u, v)
        offset = point - ABOVE
        distance = np.linalg.norm(offset)
        green = np.exp(1j * wavenumber * distance) / (4 * np.pi * distance)
        kernel = green * np.linalg.norm(normal)
        if not single_layer:
            kernel = green * (1j * wavenumber - 1 / distance) * (offset @ normal) / distance
        return getattr(kernel * u**power, part)

    return [
        complex(
            *(
                dblquad(integrand, 0, 1, 0, lambda u: 1 - u, (part, power), 1e-12)[0]
                for part in ("real", "imag")
            )
        )
        for power in (0, 1, 2)
    ]


@pytest.mark.parametrize("curved", [False, True], ids=["flat", "curved"])
@layers
def test_near_integral_equals_adaptive_quadrature(curved, single_layer):
    wavenumber = 732.5 + 3j
    expected = np.array(adaptive_moments(curved, single_layer, wavenumber))
    panel = CURVED if curved else FLAT
    moments, _, _ = near_moments(panel, ABOVE, wavenumber, 10, single_layer)
    assert (np.abs(moments[[0, 1, 3]] - expected) < 1e-7 * np.abs(expected)).all()


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 2e-5), ("float64", 1e-12)])
@pytest.mark.parametrize("height", [0.0, 1e-5, 1e-3])
@pytest.mark.parametrize("admittance", [0j, 300 - 500j])
@pytest.mark.parametrize("wavenumber", [732.5 + 0j, 732.5 + 3j])
def test_near_excess_is_the_panels_integral_less_the_plain_nodes(
    wavenumber, admittance, height, precision, tolerance
):
    nodal = np.random.default_rng(1).normal(size=(6, 6))
    foot, normal = panel_at(CURVED, 0.2, 0.3)
    target = foot + height * normal / np.linalg.norm(normal)
    sources = scattered_points(2, 6) * 0.1
    normals = scattered_points(3, 6) * 1e-4
    doubles, _, _ = near_moments(CURVED, target, wavenumber, 5)
    simples, _, _ = near_moments(CURVED, target, wavenumber, 5, single_layer=True)
    far = np.linalg.norm(sources - target, axis=1) > 2e-3
    single = admittance * np.linalg.norm(normals, axis=1)
    plain = double_layer(target[None], sources, normals, wavenumber, single)[0]
    expected = (doubles + admittance * simples) @ nodal - np.where(far, plain, 0)
    rows = _kernels.NearRows(np.array([0, 1]), np.zeros(1, int), np.empty((1, 6), complex))
    _kernels.near_excess(
        target[None],
        rows,
        panels=_kernels.Panels(CURVED, np.zeros(1)),
        layer=_kernels.Layer(sources, normals, single if admittance else HARD, wavenumber),
        nodal=nodal,
        least=2e-3,
        quadrature=near_quadrature(5, 5),
        precision=precision,
    )
    assert relative(rows.excess[0], expected) < tolerance


@pytest.mark.parametrize("place", [(0.2, 0.3), (0.0, 0.0), (0.0, 1.0), (0.5, 0.0), (0.4, 0.6)])
def test_a_point_in_contact_counts_as_on_the_panel(place):
    foot, normal = panel_at(CURVED, *place)
    exact, _, _ = near_moments(CURVED, foot, 732.5 + 0j, 12, contact=1e-12)
    for height in (-1e-6, -1e-9, 1e-12, 1e-8, 1e-6):
        target = foot + height * normal / np.linalg.norm(normal)
        moments, distance, _ = near_moments(CURVED, target, 732.5 + 0j, 12, contact=2e-6)
        assert np.abs(moments - exact).max() < 1e-4 * np.abs(exact).max()
        assert distance == pytest.approx(abs(height), rel=1e-3)


@pytest.mark.parametrize("within", [1e-4, 0.01, 0.05, 1.0])
@pytest.mark.parametrize("count", [0, 1, 300])
def test_distances_of_panels_are_those_of_their_nodes_and_middles(count, within):
    panels = scattered_points(3, 240).reshape(40, 6, 3)
    points = scattered_points(4, count)
    distance = _kernels.panel_distances(panels, points, within)
    samples = np.concatenate([panels, panels.mean(axis=1, keepdims=True)], axis=1)
    apart = np.linalg.norm(samples[:, :, None] - points, axis=3)
    least = apart.min(axis=(1, 2), initial=np.inf)
    assert np.allclose(distance, np.where(least < within, least, np.inf), rtol=1e-12)


@pytest.mark.parametrize("count", [3, 500])
def test_nodes_are_placed_as_by_numpy(count):
    panels = CURVED + 1e-4 * np.random.default_rng(3).normal(size=(count, 6, 3))
    points, normals, areas, centres, radii = _kernels.place_nodes(panels, RULE, RULE_WEIGHTS)
    along = np.cross(RULE[6:12] @ panels, RULE[12:18] @ panels)
    size = np.linalg.norm(along, axis=2)
    assert np.allclose(points, (RULE[:6] @ panels).reshape(-1, 3), rtol=1e-13, atol=0)
    assert np.allclose(normals, (along / size[:, :, None]).reshape(-1, 3), rtol=1e-12, atol=1e-15)
    assert np.allclose(areas, (size * RULE_WEIGHTS).ravel(), rtol=1e-12, atol=0)
    assert np.allclose(centres, RULE[18] @ panels, rtol=1e-13, atol=0)
    farthest = np.linalg.norm(panels - centres[:, None], axis=2).max(axis=1)
    assert np.allclose(radii, farthest, rtol=1e-13, atol=0)


@pytest.mark.parametrize(
    "reach", [np.linspace(0.01, 0.05, 80), np.geomspace(1e-6, 0.08, 80), np.full(80, 1e-9)]
)
def test_near_pairs_are_those_within_reach(reach):
    points, centres = scattered_points(1, 50), scattered_points(2, 80)
    points[:5] = centres[:5]
    first, panel = _kernels.near_pairs(points, centres, reach)
    target, expected = np.nonzero(np.linalg.norm(points[:, None] - centres, axis=2) < reach)
    assert np.array_equal(np.repeat(np.arange(50), np.diff(first)), target)
    assert np.array_equal(panel, expected)
