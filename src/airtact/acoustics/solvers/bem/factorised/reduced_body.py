"""The scattering of one body, reduced to a few of its nodes: its own matrix is inverted once.

From some distance on, the incident field at the nodes of a body and the field that the nodes
radiate are determined, to any accuracy, by a few of them, its skeletons: all other nodes are linear
combinations of those, whatever is outside. Which nodes, and the combinations, follow from monopoles
on a surface around the body (the proxy surface).

Source: P. G. Martinsson and V. Rokhlin, "A fast direct solver for boundary integral equations in
two dimensions", Journal of Computational Physics 205 (2005) 1.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import scipy.linalg
from jaxtyping import Complex, Complex128, Float64, Int32, Int64, Num
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from airtact import _kernels
from airtact.acoustics.solvers.bem.factorised.products import Matrix, product, rounded
from airtact.acoustics.solvers.bem.layer_potentials import double_layer_transposed
from airtact.acoustics.solvers.bem.operator import DualSurface, assemble
from airtact.acoustics.solvers.bem.quadrature import Nodes
from airtact.geometry.mesh.quadratic_triangles import longest_edges
from airtact.printing import in_short

SECOND_LAYER = 2.5
"""Distance of the second half of the proxy monopoles from the body, over that of the first."""

SKETCHED = 12
"""Random combinations of the proxies for each square wavelength of surface to begin with, doubled until a few are
redundant."""

CHECKED = 64
"""Proxies, and points beside the surface, from which the reduced scattering is checked."""

BESIDE = 0.06
"""Height of the latter over the surface in wavelengths: half a millimetre at 40 kHz in air."""

FIRST, TIGHTER, TRIES = 0.3, 0.4, 4
"""Tolerance of the first skeletons over the error wanted, the factor from one to the next, and the most trials."""

FAR = 1.0
"""Distance from all nodes in wavelengths beyond which fewer monopoles radiate the same, such as at an array."""

FAR_ERROR = 0.5
"""Tolerance of those monopoles over the error wanted."""

GROUPS_AT_ONCE = 100
"""Shifted points, and three times as many nodes, at which the proxies are evaluated at once."""

FULLEST = 0.7
"""Largest rank of a skeleton over the number of combinations."""


@dataclass(frozen=True, eq=False)
class FarMonopoles:
    """The few monopoles that radiate, to points beyond ``reach`` of all nodes [m], what the skeleton of the rows does.

    Their strengths are ``combinations`` times the densities there; ``error`` is relative, at points
    near the reach.
    """

    reach: float
    positions: Float64[np.ndarray, "few 3"]
    combinations: Matrix
    error: float

    __repr__ = in_short


@dataclass(frozen=True, eq=False)
class ReducedBody:
    """One body in its own frame, reduced to its skeletons, which serve points beyond ``reach`` of all nodes [m].

    The nodes of the two skeletons are those of the matrix's rows, where incident fields are
    evaluated, and of its columns, which radiate. ``solved`` is the transposed solution on the
    skeleton of the rows from the right-hand side at all nodes, ``scattering`` that from the
    right-hand side at the skeleton of the columns: the scattering matrix. ``error`` is the relative
    error of the scattering against all nodes, to points as near as the reach, from there and from
    beside the surface. ``tree`` holds the nodes, for distances. Points beyond the reach of ``far``
    take fewer monopoles.
    """

    surface: DualSurface
    reach: float
    rows: Int64[np.ndarray, "rows"]
    columns: Int64[np.ndarray, "columns"]
    solved: Matrix
    scattering: Matrix
    error: float
    tree: KDTree
    far: FarMonopoles

    __repr__ = in_short

    @cached_property
    def panel_edges(self) -> Float64[np.ndarray, "panels"]:
        """Longest edge of each panel [m]."""
        return longest_edges(self.surface.nodes.quadratic_triangles)

    @cached_property
    def row_points(self) -> Float64[np.ndarray, "both 3"]:
        """Collocation points of the skeleton of the rows (2 R, 3) [m]: its nodes, then their shifted points inside."""
        return _row_points(self.surface, self.rows)

    @cached_property
    def column_nodes(
        self,
    ) -> tuple[
        Float64[np.ndarray, "columns 3"],
        Float64[np.ndarray, "columns 3"],
        Complex128[np.ndarray, "some_columns"],
    ]:
        """Nodes of the skeleton of the columns (Q, 3) [m], normals times area [m²], ``Nodes.single_layer`` [m]."""
        nodes, single = self.surface.nodes, self.surface.nodes.single_layer(self.surface.wavenumber)
        return (
            nodes.points[self.columns],
            nodes.weighted_normals[self.columns],
            single[self.columns[: len(single)]],
        )


def reduced_body(surface: DualSurface, reach: float, wanted: float) -> ReducedBody:
    """Invert a body's own matrix and find its skeletons, for points beyond the reach [m], to the error wanted."""
    tree = KDTree(surface.nodes.points)
    proxies = _proxies(surface.nodes, tree, reach)
    matrix = assemble(surface, "float64" if surface.precision == "float64" else "float32").dense()
    factors = scipy.linalg.lu_factor(matrix, overwrite_a=True, check_finite=False)
    error_of = _checks(surface, proxies, factors)
    kind = factors[0].dtype.type
    area = float(surface.nodes.weights.sum()) * (surface.wavenumber.real / (2 * np.pi)) ** 2
    count = min(math.ceil(SKETCHED * (area + 4)), len(proxies))
    direct, transposed = (
        partial(sides, surface, proxies) for sides in (_direct_sides, _transposed_sides)
    )
    tolerance, trials = FIRST * wanted, 0
    while True:
        rows, of_rows = _skeleton(direct, len(proxies), count, tolerance, kind)
        columns, of_columns = _skeleton(transposed, len(proxies), count, tolerance, kind)
        solved = np.ascontiguousarray(
            scipy.linalg.lu_solve(factors, of_rows.T.astype(kind), check_finite=False).T
        )
        scattering = rounded(solved @ of_columns.T.astype(kind), wanted)
        solved = rounded(solved, wanted)
        error = error_of(rows, columns, solved, scattering)
        trials += 1
        if error <= wanted or trials == TRIES:
            far = _far_monopoles(surface, tree, rows, FAR_ERROR * wanted, kind)
            error = max(error, far.error)
            return ReducedBody(surface, reach, rows, columns, solved, scattering, error, tree, far)
        tolerance *= TIGHTER


def _row_points(
    surface: DualSurface, rows: Int64[np.ndarray, "rows"]
) -> Float64[np.ndarray, "both 3"]:
    return np.concatenate([surface.nodes.points[rows], surface.shifted[rows // _kernels.sharing]])


def _far_monopoles(
    surface: DualSurface,
    tree: KDTree,
    rows: Int64[np.ndarray, "rows"],
    tolerance: float,
    kind: type[np.complexfloating],
) -> FarMonopoles:
    """Find the few of the monopoles at the rows' points, and their strengths, that radiate the same to far points."""
    reach = FAR * 2 * np.pi / surface.wavenumber.real
    candidates, points = _row_points(surface, rows), _proxies(surface.nodes, tree, reach)
    open_air = _open_air(points, candidates, surface.wavenumber)
    radiated = open_air[:, : len(rows)] - 1j * open_air[:, len(rows) :]
    decomposed = scipy.linalg.qr(open_air, mode="economic", pivoting=True, check_finite=False)
    unitary, upper, order = (np.asarray(one) for one in decomposed)
    few = int(np.count_nonzero(np.abs(np.diag(upper)) > tolerance * np.abs(upper[0, 0])))
    wanted = unitary[:, :few].conj().T @ radiated
    exact = scipy.linalg.solve_triangular(upper[:few, :few], wanted, check_finite=False)
    combinations = rounded(np.ascontiguousarray(exact, dtype=kind), tolerance)
    found = product(combinations, open_air[:, order[:few]], transposed=True)
    error = float(np.linalg.norm(found - radiated) / np.linalg.norm(radiated))
    return FarMonopoles(reach, candidates[order[:few]], combinations, error)


def _checks(
    surface: DualSurface,
    proxies: Float64[np.ndarray, "proxies 3"],
    factors: tuple[Complex[np.ndarray, "nodes nodes"], Int32[np.ndarray, "nodes"]],
) -> Callable[[np.ndarray, np.ndarray, Matrix, Matrix], float]:
    """Make the function that gives the relative error of skeletons from their rows, columns, solution and scattering.

    It is the larger one for sources as near as the reach and sources beside the surface, at points
    near the reach.
    """
    nodes, wavelength = surface.nodes, 2 * np.pi / surface.wavenumber.real
    some, beside = (
        np.arange(0, count, -(-count // CHECKED)) for count in (len(proxies), len(nodes.points))
    )
    radiated = _direct_sides(surface, proxies[some - len(proxies) // 2], np.eye(len(some)))
    close = nodes.points[beside] + BESIDE * wavelength * nodes.normals[beside]
    far, near = (
        _transposed_sides(surface, points, np.eye(len(points))) for points in (proxies[some], close)
    )
    exact = [
        scipy.linalg.lu_solve(factors, one, trans=1, check_finite=False).T @ radiated
        for one in (far, near)
    ]

    def error_of(
        rows: np.ndarray, columns: np.ndarray, solved: Matrix, scattering: Matrix
    ) -> float:
        scattered = (
            product(scattering, far[columns].T) @ radiated[rows],
            product(solved, near.T) @ radiated[rows],
        )
        pairs = zip(scattered, exact, strict=True)
        return max(
            float(np.linalg.norm(found - true) / np.linalg.norm(true)) for found, true in pairs
        )

    return error_of


def _proxies(nodes: Nodes, tree: KDTree, reach: float) -> Float64[np.ndarray, "proxies 3"]:
    """Place monopoles all around the body: off every node, and farther off every second one."""
    near = nodes.points + reach * nodes.normals
    far = nodes.points[::2] + SECOND_LAYER * reach * nodes.normals[::2]
    everywhere = np.concatenate([near, far])
    return everywhere[tree.query(everywhere, distance_upper_bound=0.95 * reach)[0] > 0.95 * reach]


def _direct_sides(
    surface: DualSurface,
    proxies: Float64[np.ndarray, "proxies 3"],
    strengths: Num[np.ndarray, "proxies some"],
) -> Complex128[np.ndarray, "nodes some"]:
    """Right-hand sides of the direct equation for the proxies as sources."""
    points, sharing = surface.nodes.points, _kernels.sharing
    kind = np.complex64 if surface.precision == "float32" else np.complex128
    strengths = strengths.astype(kind)
    sides = np.empty((len(points), strengths.shape[1]), dtype=np.complex128)
    for begin in range(0, len(points), sharing * GROUPS_AT_ONCE):
        rows = slice(begin, begin + sharing * GROUPS_AT_ONCE)
        groups = slice(begin // sharing, begin // sharing + GROUPS_AT_ONCE)
        inside = np.repeat(
            _open_air(surface.shifted[groups], proxies, surface.wavenumber), sharing, axis=0
        )
        sides[rows] = (_open_air(points[rows], proxies, surface.wavenumber) - 1j * inside).astype(
            kind
        ) @ strengths
    return sides


def _open_air(
    points: Float64[np.ndarray, "points 3"],
    proxies: Float64[np.ndarray, "proxies 3"],
    wavenumber: complex,
) -> Complex128[np.ndarray, "points proxies"]:
    """Pressure e^{ikr}/r of each proxy."""
    distance = cdist(points, proxies)
    return np.exp(1j * wavenumber * distance) / distance


def _transposed_sides(
    surface: DualSurface,
    proxies: Float64[np.ndarray, "proxies 3"],
    strengths: Num[np.ndarray, "proxies some"],
) -> Complex128[np.ndarray, "nodes some"]:
    """Right-hand sides of the transposed equation for the proxies as sources."""
    given = (
        strengths.astype(np.complex128),
        surface.wavenumber,
        surface.near_rule,
        surface.precision,
    )
    return double_layer_transposed(proxies, surface.nodes, *given)


def _skeleton(
    mixed: Callable[[np.ndarray], np.ndarray],
    proxies: int,
    count: int,
    tolerance: float,
    kind: type[np.complexfloating],
) -> tuple[Int64[np.ndarray, "skeleton"], Complex128[np.ndarray, "skeleton nodes"]]:
    """Find nodes of which all others are linear combinations, and those combinations.

    ``mixed`` returns the right-hand sides for random strengths of the proxies: an interpolative
    decomposition of a random sketch (E. Liberty, F. Woolfe, P. G. Martinsson, V. Rokhlin, M.
    Tygert, PNAS 104 (2007) 20167).
    """
    random = np.random.default_rng(0)
    while True:
        sketch = mixed(
            random.standard_normal((proxies, count)) + 1j * random.standard_normal((proxies, count))
        )
        decomposed = scipy.linalg.qr(
            sketch.T.astype(kind), mode="r", pivoting=True, check_finite=False
        )
        upper, order = np.asarray(decomposed[0]), np.asarray(decomposed[-1])
        size = np.abs(np.diag(upper))
        rank = int(np.count_nonzero(size > tolerance * size[0]))
        if rank <= FULLEST * count or count >= min(proxies, len(sketch)):
            break
        count = min(2 * count, proxies)
    combinations = np.empty((rank, len(sketch)), dtype=np.complex128)
    combinations[:, order[:rank]] = np.eye(rank)
    combinations[:, order[rank:]] = scipy.linalg.solve_triangular(
        upper[:rank, :rank], upper[:rank, rank:]
    )
    return order[:rank].astype(np.int64), combinations
