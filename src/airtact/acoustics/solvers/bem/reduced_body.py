"""The scattering of one body, reduced to a few of its nodes by inverting its matrix once.

A few nodes of a body, its skeletons, are enough for sources and receivers some distance away. To
any accuracy, they determine the incident field at all nodes and the field that the nodes radiate.
All other nodes are linear combinations of the skeletons. The nodes and the combinations are
computed from monopoles on a surface around the body (the proxy surface).

Source: P. G. Martinsson and V. Rokhlin, "A fast direct solver for boundary integral equations in
two dimensions", Journal of Computational Physics 205 (2005) 1.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from jaxtyping import Complex, Complex128, Float32, Float64, Int16, Int32, Int64, Num
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from airtact import _kernels
from airtact.acoustics.solvers.bem.layer_potentials import double_layer_transposed
from airtact.acoustics.solvers.bem.quadrature import Nodes
from airtact.acoustics.solvers.bem.solutions import DualSurface, assemble
from airtact.acoustics.solvers.shared import SingleLayer
from airtact.geometry.mesh.triangles import longest_edges

Proxies = Float64[np.ndarray, "proxies 3"]

# A compiled loop multiplies up to this many vectors, because BLAS is slower and leaves threads
# spinning.
MAX_COMPILED_VECTORS = 8


@dataclass(frozen=True, eq=False)
class RoundedMatrix:
    """A complex matrix that takes half the memory of single precision.

    Each row consists of 16-bit integers (real and imaginary parts in turn), which are multiplied by
    a scale for the row. The error of a number is at most half of the scale: 1.5e-5 of the largest
    number in its row.
    """

    numbers: Int16[np.ndarray, "rows columns 2"]
    scales: Float32[np.ndarray, "rows"]

    @property
    def dtype(self) -> np.dtype:
        """Precision of products with the matrix."""
        return np.dtype(np.complex64)

    def as_complex(self) -> Complex[np.ndarray, "rows columns"]:
        """Return the matrix as complex numbers in single precision."""
        return (self.numbers * self.scales[:, None, None]).view(np.complex64)[..., 0]


Matrix = Complex[np.ndarray, "_ _"] | RoundedMatrix


def rounded(matrix: Complex[np.ndarray, "rows columns"], goal: float) -> Matrix:
    """Round a single-precision matrix if the rounding error is at most a fifth of ``goal``."""
    if matrix.dtype != np.complex64:
        return matrix
    parts = np.ascontiguousarray(matrix).view(np.float32).reshape(*matrix.shape, 2)
    scales = np.abs(parts).max(axis=(1, 2), initial=0.0) / np.float32(np.iinfo(np.int16).max)
    scales[scales < np.finfo(np.float32).tiny] = 1.0
    candidate = RoundedMatrix(np.rint(parts / scales[:, None, None]).astype(np.int16), scales)
    off = np.linalg.norm(candidate.as_complex() - matrix)
    return candidate if off <= 0.2 * goal * np.linalg.norm(matrix) else matrix


def product(
    matrix: Matrix, vectors: Num[np.ndarray, "vectors inner"], transposed: bool = False
) -> Complex[np.ndarray, "vectors outer"]:
    """Multiply a matrix, or its transpose, by row vectors, in the precision of the matrix."""
    if len(vectors) > MAX_COMPILED_VECTORS:
        full = matrix.as_complex() if isinstance(matrix, RoundedMatrix) else matrix
        return vectors.astype(full.dtype, copy=False) @ (full if transposed else full.T)
    vectors = np.ascontiguousarray(vectors, dtype=matrix.dtype)
    if isinstance(matrix, RoundedMatrix):
        return _kernels.few_rounded_products(matrix.numbers, matrix.scales, vectors, transposed)
    return _kernels.few_products(matrix, vectors, transposed)


@dataclass(frozen=True, eq=False)
class FarMonopoles:
    """A few monopoles that radiate the same field to distant points as a body's skeleton does.

    Attributes
    ----------
    reach : distance from the nodes beyond which the monopoles are accurate [m].
    positions : positions of the monopoles [m].
    combinations : matrix that maps the densities on the skeleton to the strengths of the monopoles.
    error : relative error at a distance of about ``reach``.
    """

    reach: float
    positions: Float64[np.ndarray, "few 3"]
    combinations: Matrix
    error: float


@dataclass(frozen=True, eq=False)
class ReducedBody:
    """A body in its own frame, reduced to skeletons: small sets of nodes that represent all nodes.

    Attributes
    ----------
    surface : the collocation points of the body.
    reach : distance from the nodes beyond which the skeletons represent all nodes accurately [m].
    rows : nodes of the matrix's rows, where incident fields are evaluated.
    columns : nodes of the matrix's columns, from which the scattered field is radiated.
    solved : matrix that maps the right-hand side at all nodes to the transposed solution on
        ``rows``.
    scattering : scattering matrix, which maps the right-hand side at ``columns`` to the transposed
        solution on ``rows``.
    error : relative difference between the sound scattered by the skeletons and by all nodes. It is
        measured at a distance of about ``reach``, both for sources at that distance and for sources
        close to the surface.
    tree : search tree of the nodes, used to compute distances.
    far : a smaller set of monopoles, which replaces the skeletons at more distant points.
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

    @cached_property
    def panel_edges(self) -> Float64[np.ndarray, "panels"]:
        """Longest edge of each panel [m]."""
        return longest_edges(self.surface.nodes.quadratic_triangles)

    @cached_property
    def row_points(self) -> Float64[np.ndarray, "both 3"]:
        """Points of the skeleton of the rows [m]: its nodes, then the second collocation points."""
        return _row_points(self.surface, self.rows)

    @cached_property
    def column_nodes(
        self,
    ) -> tuple[Float64[np.ndarray, "columns 3"], Float64[np.ndarray, "columns 3"], SingleLayer]:
        """Nodes of the columns' skeleton [m], normals times node areas [m²], and single layer."""
        nodes = self.surface.nodes
        single = nodes.single_layer(self.surface.wavenumber)
        return (
            nodes.points[self.columns],
            nodes.weighted_normals[self.columns],
            single[self.columns] if len(single) else single,
        )


def reduced_body(surface: DualSurface, reach: float, goal: float) -> ReducedBody:
    """Invert a body's matrix and find its skeletons.

    Parameters
    ----------
    reach : distance from the nodes beyond which the skeletons must represent all nodes [m].
    goal : target relative error of the scattering.
    """
    tree = KDTree(surface.nodes.points)
    proxies = _proxies(surface.nodes, tree, reach)
    matrix = assemble(surface, "float64" if surface.precision == "float64" else "float32").dense()
    factors = scipy.linalg.lu_factor(matrix, overwrite_a=True, check_finite=False)
    error_of = _error_check(surface, proxies, factors)
    kind = factors[0].dtype.type
    # The search starts with 12 random combinations of the proxies per square wavelength of surface.
    area = float(surface.nodes.weights.sum()) * (surface.wavenumber.real / (2 * np.pi)) ** 2
    count = min(math.ceil(12 * (area + 4)), len(proxies))
    tolerance = 0.3 * goal
    trials = 0
    while True:
        rows, of_rows = _skeleton(_direct_sides, surface, proxies, count, tolerance)
        columns, of_columns = _skeleton(_transposed_sides, surface, proxies, count, tolerance)
        # The solve is only for the skeleton of the rows, a few columns instead of all nodes.
        exact = scipy.linalg.lu_solve(factors, of_rows.T.astype(kind), check_finite=False)
        full = np.ascontiguousarray(exact.T)
        scattering = rounded(full @ of_columns.T.astype(kind), goal)
        solved = rounded(full, goal)
        error = error_of(rows, columns, solved, scattering)
        trials += 1
        if error <= goal or trials == 4:
            far = _far_monopoles(surface, tree, rows, 0.5 * goal, kind)
            error = max(error, far.error)
            return ReducedBody(surface, reach, rows, columns, solved, scattering, error, tree, far)
        tolerance *= 0.4


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
    """Select a few of the rows' monopoles that reproduce their field beyond one wavelength."""
    reach = 2 * np.pi / surface.wavenumber.real
    candidates = _row_points(surface, rows)
    points = _proxies(surface.nodes, tree, reach)
    open_air = _open_air(points, candidates, surface.wavenumber)
    radiated = open_air[:, : len(rows)] - 1j * open_air[:, len(rows) :]
    decomposed = scipy.linalg.qr(open_air, mode="economic", pivoting=True, check_finite=False)
    # Pivoted QR selects the columns (monopoles) that span the others.
    unitary, upper, order = (np.asarray(part) for part in decomposed)
    few = int(np.count_nonzero(np.abs(np.diag(upper)) > tolerance * np.abs(upper[0, 0])))
    projected = unitary[:, :few].conj().T @ radiated
    exact = scipy.linalg.solve_triangular(upper[:few, :few], projected, check_finite=False)
    combinations = rounded(np.ascontiguousarray(exact, dtype=kind), tolerance)
    approximate = product(combinations, open_air[:, order[:few]], transposed=True)
    error = float(np.linalg.norm(approximate - radiated) / np.linalg.norm(radiated))
    return FarMonopoles(reach, candidates[order[:few]], combinations, error)


def _error_check(
    surface: DualSurface,
    proxies: Proxies,
    factors: tuple[Complex[np.ndarray, "nodes nodes"], Int32[np.ndarray, "nodes"]],
) -> Callable[[np.ndarray, np.ndarray, Matrix, Matrix], float]:
    """Return a function that measures the relative error of skeletons and their scattering.

    The error is measured at points at a distance of about ``reach``, both for sources at that
    distance and for sources close to the surface. The larger of the two errors is returned. About
    64 sources and points of each kind are used.
    """
    nodes = surface.nodes
    sources = np.arange(0, len(proxies), -(-len(proxies) // 64))
    beside = np.arange(0, len(nodes.points), -(-len(nodes.points) // 64))
    radiated = _direct_sides(surface, proxies[sources - len(proxies) // 2], np.eye(len(sources)))
    # 0.06 λ above the surface is half a millimetre at 40 kHz in air.
    height = 0.06 * 2 * np.pi / surface.wavenumber.real
    close = nodes.points[beside] + height * nodes.normals[beside]
    far_sides = _transposed_sides(surface, proxies[sources], np.eye(len(sources)))
    near_sides = _transposed_sides(surface, close, np.eye(len(close)))
    exact = [
        scipy.linalg.lu_solve(factors, right_sides, trans=1, check_finite=False).T @ radiated
        for right_sides in (far_sides, near_sides)
    ]

    def error_of(
        rows: np.ndarray, columns: np.ndarray, solved: Matrix, scattering: Matrix
    ) -> float:
        reduced = (
            product(scattering, far_sides[columns].T) @ radiated[rows],
            product(solved, near_sides.T) @ radiated[rows],
        )
        return max(
            float(np.linalg.norm(approximate - true) / np.linalg.norm(true))
            for approximate, true in zip(reduced, exact, strict=True)
        )

    return error_of


def _proxies(nodes: Nodes, tree: KDTree, reach: float) -> Proxies:
    """Place monopoles ``reach`` above all nodes, and 2.5 times as high above every second node."""
    inner = nodes.points + reach * nodes.normals
    outer = nodes.points[::2] + 2.5 * reach * nodes.normals[::2]
    everywhere = np.concatenate([inner, outer])
    return everywhere[tree.query(everywhere, distance_upper_bound=0.95 * reach)[0] > 0.95 * reach]


def _direct_sides(
    surface: DualSurface, proxies: Proxies, strengths: Num[np.ndarray, "proxies columns"]
) -> Complex128[np.ndarray, "nodes columns"]:
    points = surface.nodes.points
    sharing = _kernels.sharing
    kind = np.complex64 if surface.precision == "float32" else np.complex128
    strengths = strengths.astype(kind)
    right_sides = np.empty((len(points), strengths.shape[1]), dtype=np.complex128)
    for group in range(0, len(surface.shifted), 100):  # limits the memory
        rows = slice(sharing * group, sharing * (group + 100))
        inside = _open_air(surface.shifted[group : group + 100], proxies, surface.wavenumber)
        outside = _open_air(points[rows], proxies, surface.wavenumber)
        combined = outside - 1j * np.repeat(inside, sharing, axis=0)
        right_sides[rows] = combined.astype(kind) @ strengths
    return right_sides


def _open_air(
    points: Float64[np.ndarray, "points 3"], proxies: Proxies, wavenumber: complex
) -> Complex128[np.ndarray, "points proxies"]:
    distance = cdist(points, proxies)
    return np.exp(1j * wavenumber * distance) / distance


def _transposed_sides(
    surface: DualSurface, proxies: Proxies, strengths: Num[np.ndarray, "proxies columns"]
) -> Complex128[np.ndarray, "nodes columns"]:
    return double_layer_transposed(
        proxies,
        surface.nodes,
        strengths.astype(np.complex128),
        surface.wavenumber,
        near_rule=surface.near_rule,
        precision=surface.precision,
    )


def _skeleton(
    right_sides: Callable[[DualSurface, np.ndarray, np.ndarray], np.ndarray],
    surface: DualSurface,
    proxies: Proxies,
    count: int,
    tolerance: float,
) -> tuple[Int64[np.ndarray, "skeleton"], Complex128[np.ndarray, "skeleton nodes"]]:
    """Find skeleton nodes, and write all other nodes as linear combinations of them.

    The nodes follow from an interpolative decomposition of the right-hand sides
    for ``count`` random combinations of the proxies. ``count`` is doubled until
    some combinations are redundant (E. Liberty, F. Woolfe, P. G. Martinsson, V.
    Rokhlin, M. Tygert, PNAS 104 (2007) 20167).
    """
    random = np.random.default_rng(0)
    kind = np.complex128 if surface.precision == "float64" else np.complex64
    while True:
        shape = len(proxies), count
        strengths = random.standard_normal(shape) + 1j * random.standard_normal(shape)
        # Columns of the sketch are right-hand sides at all nodes. Dependent nodes are redundant.
        sketch = right_sides(surface, proxies, strengths)
        decomposed = scipy.linalg.qr(
            sketch.T.astype(kind), mode="r", pivoting=True, check_finite=False
        )
        upper = np.asarray(decomposed[0])
        order = np.asarray(decomposed[-1])
        size = np.abs(np.diag(upper))
        rank = int(np.count_nonzero(size > tolerance * size[0]))
        if rank <= 0.7 * count or count >= min(len(proxies), len(sketch)):
            break
        count = min(2 * count, len(proxies))
    combinations = np.empty((rank, len(sketch)), dtype=np.complex128)
    combinations[:, order[:rank]] = np.eye(rank)
    combinations[:, order[rank:]] = scipy.linalg.solve_triangular(
        upper[:rank, :rank], upper[:rank, rank:]
    )
    return order[:rank].astype(np.int64), combinations
