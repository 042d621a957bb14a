"""The dual-surface equation on curved panels: its matrix and its right-hand sides.

For a rigid body in e^{+ikr}/r convention the pressure on the skin solves, at x on the skin and x' = x − δ n inside,

    p(x)/2 − D[p](x) + i D[p](x') = p_inc(x) − i p_inc(x'),

D being the double layer. The second point makes the equation uniquely solvable at every frequency; with the other sign
of i GMRES takes many times the iterations.

Sources: A. Mohsen, R. Piscoya and M. Ochmann, "The application of the dual surface method to treat the nonuniqueness in
solving acoustic exterior problems", Acta Acustica united with Acustica 97 (2011) 699.
"""

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Complex, Complex128, Float64, Int64, Real, Shaped, UInt8

from airtact import _kernels
from airtact.conventions import InvalidInput
from airtact.printing import in_short
from airtact.solvers.bem.blocks import Pairs, blocks_of, near_tiles
from airtact.solvers.bem.layer_potentials import NearRule, double_layer_transposed, near_rows, project_contacts
from airtact.solvers.bem.quadrature import Nodes, near_lists, thickness
from airtact.solvers.memory import available_memory as _available_memory
from airtact.solvers.monopoles import monopole_pressure


@dataclass(frozen=True, eq=False)
class DualSurface:
    """Where and how the dual-surface equation of a scene is written down.

    Attributes
    ----------
    nodes : where the pressure is unknown.
    shifted : (M/3, 3) the second collocation point of each three nodes, inside their body [m].
    wavenumber : [1/m].
    near_rule : of the near integrals.
    precision : working precision, float32 or float64.
    """

    nodes: Nodes
    shifted: Float64[np.ndarray, "groups 3"]
    wavenumber: complex
    near_rule: NearRule
    precision: str

    __repr__ = in_short


def dual_surface(
    nodes: Nodes,
    wavenumber: complex,
    near_rule: NearRule,
    precision: str,
    thinnest: Float64[np.ndarray, "bodies"] | None = None,
) -> DualSurface:
    """Put the second surface 0.2 λ under the skin, or 0.3 of the local thickness where the body is thin.

    Three neighbours on a panel share one point of it: a third fewer kernels for the same accuracy. ``thinnest`` is how
    thick each body is everywhere at least [m], as far as that is known.
    """
    wavelength = 2 * np.pi / wavenumber.real
    depth = 0.3 * thickness(nodes, 2 / 3 * wavelength, thinnest)
    inside = (nodes.points - depth[:, None] * nodes.normals).reshape(-1, _kernels.sharing, 3)
    return DualSurface(nodes, inside.mean(axis=1), wavenumber, near_rule, precision)


Store = Literal["bfloat16", "float32", "float64"]
"""What the numbers of a matrix are kept as; bfloat16 is the upper half of a float32, good to 0.2 %."""

KEPT_AS: dict[Store, tuple[type[np.generic], int]] = {
    "bfloat16": (np.uint32, 2),
    "float32": (np.float32, 1),
    "float64": (np.float64, 1),
}
"""The words of each, and how many numbers a word holds."""


_GIVEN_BACK: list[UInt8[np.ndarray, "bytes"]] = []
"""Memory of the last matrix that was given back, if any: touching fresh memory takes longer than filling it."""

MOST_KEPT = 2**28
"""Bytes of a matrix above which its memory is not kept."""

ROOM = 1.25
"""Memory taken over what is needed: the next pose may have some more unknowns. What is not touched costs nothing."""


@dataclass(frozen=True, eq=False)
class DualMatrix:
    """The matrix of the dual-surface equation, M x M, in tiles of ``_kernels.lanes`` rows and columns.

    Attributes
    ----------
    count : M.
    whole : the pairs of tiles of which all entries are kept.
    tiles : (N, L, 2, W) those entries, row by row, real and imaginary parts, filled up with zeros, in words.
    far : the other pairs, which are sums of crosses.
    crosses : (F,) how many crosses each of them has.
    begin : (F,) where the rows of each begin.
    rows : (R, 2, W) of the crosses, those of the columns' tile first, then those of the rows' tile.
    memory : that all of it is kept in.
    """

    count: int
    whole: Pairs
    tiles: Shaped[np.ndarray, "pairs lanes 2 words"]
    far: Pairs
    crosses: Int64[np.ndarray, "far"]
    begin: Int64[np.ndarray, "far"]
    rows: Shaped[np.ndarray, "rows 2 words"]
    memory: UInt8[np.ndarray, "bytes"]

    __repr__ = in_short

    @classmethod
    def empty(cls, count: int, store: Store, near: Bool[np.ndarray, "tiles tiles"], room: int = 0) -> "DualMatrix":
        """Take memory for M = ``count`` unknowns, ``near`` tiles of which are whole, and ``room`` rows of crosses.

        It is that of a matrix given back where there is enough of it.
        """
        word, numbers = KEPT_AS[store]
        row = (2, _kernels.lanes // numbers)
        whole, far = Pairs.of(near), Pairs.of(~near)
        lines = len(whole.column) * _kernels.lanes
        line = math.prod(row) * np.dtype(word).itemsize
        memory = _memory((lines + room) * line)
        words = memory[: (lines + room) * line].view(word)
        tiles = words[: lines * math.prod(row)].reshape(-1, _kernels.lanes, *row)
        rows = words[lines * math.prod(row) :].reshape(-1, *row)
        crosses, begin = np.zeros((2, len(far.column)), dtype=np.int64)
        return cls(count, whole, tiles, far, crosses, begin, rows, memory)

    @property
    def store(self) -> Store:
        """What its numbers are kept as."""
        return next(store for store, (word, _) in KEPT_AS.items() if self.tiles.dtype == word)

    @property
    def precision(self) -> type[np.complexfloating]:
        """What it is multiplied with: complex64 or complex128."""
        return np.complex128 if self.store == "float64" else np.complex64

    def times(
        self, vectors: Complex[np.ndarray, "columns nodes"], transposed: bool = False
    ) -> Complex[np.ndarray, "columns nodes"]:
        """Multiply the matrix, or its transpose, by vectors (S, M), which are rows here; in one pass over it."""
        vectors = np.ascontiguousarray(vectors, dtype=self.precision)
        out = np.empty_like(vectors)
        whole, far = (self.whole.first, self.whole.column), (self.far.first, self.far.column)
        crosses = self.crosses, self.begin, self.rows
        getattr(_kernels, f"dual_product_{self.store}")(*whole, self.tiles, *far, *crosses, vectors, transposed, out)
        return out

    def dense(self) -> Complex[np.ndarray, "nodes nodes"]:
        """Give all of a whole matrix as one array, from float32 or float64."""
        lanes = _kernels.lanes
        out = np.empty((self.count, self.count), dtype=self.precision, order="F")  # as LAPACK takes it without a copy
        for tile, row, column in zip(self.tiles, lanes * self.whole.row, lanes * self.whole.column, strict=True):
            part = out[row : row + lanes, column : column + lanes]
            part.real, part.imag = (tile[: len(part), of, : part.shape[1]] for of in (0, 1))
        return out


def _memory(size: int) -> UInt8[np.ndarray, "bytes"]:
    """Memory of at least ``size`` bytes."""
    memory = np.empty(0, dtype=np.uint8)
    with suppress(IndexError):
        memory = _GIVEN_BACK.pop()
    return memory if len(memory) >= size else np.empty(int(ROOM * size) if size < MOST_KEPT else size, dtype=np.uint8)


def give_back(matrix: DualMatrix) -> None:
    """Keep the memory of a matrix that is no longer needed for the next one."""
    if matrix.memory.nbytes <= ROOM * MOST_KEPT:
        _GIVEN_BACK[:] = [matrix.memory]


APART = 0.2
"""Wavelengths between the edges of panels beyond which tiles are sums of crosses."""

EXPECTED = 24
"""Crosses that pairs of tiles have in the mean, at most, or they are made again with more room; often half as many."""


def assemble(surface: DualSurface, store: Store, error: float | None = None) -> DualMatrix:
    """Fill the matrix of the dual-surface equation, its numbers kept as ``store``.

    Tiles apart are sums of crosses where an ``error`` is allowed, as a share of the half that stands on the diagonal;
    without it all of the matrix is whole.

    Raises
    ------
    InvalidInput
        It does not fit into memory.
    """
    nodes, rule, precision = surface.nodes, surface.near_rule, surface.precision
    near = [near_rows(nodes, points, surface.wavenumber, rule, precision) for points in (nodes.points, surface.shifted)]
    tiles = blocks_of(len(nodes.points))
    whole = np.ones((tiles, tiles), dtype=bool)
    if error is not None:
        beside = near_lists(nodes, nodes.centres, 2 * nodes.radii + APART * 2 * np.pi / surface.wavenumber.real)
        met = [beside, *((rows.first, rows.panel) for rows in near)]
        whole = np.any([near_tiles(len(nodes.centres), *one) for one in met], axis=0)
    matrix = _crossed(surface, store, whole, error or 0.0)
    of_rows = [part for rows in near for part in (rows.first, rows.panel, rows.excess)]
    fill = getattr(_kernels, f"dual_tiles_{store}")
    fill(*_skin(surface), *of_rows, matrix.whole.first, matrix.whole.column, matrix.tiles)
    return matrix


def _crossed(surface: DualSurface, store: Store, whole: Bool[np.ndarray, "tiles tiles"], error: float) -> DualMatrix:
    """Take memory for a matrix, and make the crosses of the tiles that are not whole."""
    count, kept = len(surface.nodes.points), int(np.count_nonzero(whole))
    tolerance = 0.5 * error * math.sqrt(_kernels.lanes / len(whole))
    needed = 2 * EXPECTED * (whole.size - kept)
    while True:
        room = needed
        check_memory(count, store, kept, room // 2)
        matrix = DualMatrix.empty(count, store, whole, room)
        if not room:
            return matrix
        far, crosses = (matrix.far.first, matrix.far.column), (matrix.crosses, matrix.begin, matrix.rows)
        needed = getattr(_kernels, f"dual_crosses_{store}")(*_skin(surface), *far, tolerance, *crosses)
        if needed <= room:
            return matrix


def _skin(
    surface: DualSurface,
) -> tuple[Float64[np.ndarray, "nodes 3"], Float64[np.ndarray, "groups 3"], Float64[np.ndarray, "nodes 3"], complex]:
    nodes = surface.nodes
    return nodes.points, surface.shifted, nodes.weighted_normals, surface.wavenumber


def incident(
    surface: DualSurface, positions: Real[np.ndarray, "sources 3"], strengths: Complex[np.ndarray, "sources sounds"]
) -> Complex128[np.ndarray, "nodes sounds"]:
    """Right-hand side p_inc(x) − i p_inc(x') of some monopoles."""
    both = np.concatenate([surface.nodes.points, surface.shifted])
    pressure = monopole_pressure(both, positions, strengths, surface.wavenumber, "float64")
    count = len(surface.nodes.points)
    return pressure[:count] - 1j * np.repeat(pressure[count:], _kernels.sharing, axis=0)


def heard(
    surface: DualSurface, positions: Real[np.ndarray, "sources 3"], strengths: Complex128[np.ndarray, "sources sounds"]
) -> tuple[Complex128[np.ndarray, "nodes sounds"], Float64[np.ndarray, "sources"]]:
    """Right-hand side of the transposed equation: how the pressure on the skin is heard where monopoles stand.

    Also (N,) the factor of each monopole: 1 off the skin, 2 on it, where the representation gives half the pressure.
    """
    positions, contact = project_contacts(surface.nodes, positions)
    factors = np.where(contact, 2.0, 1.0)
    weights = factors[:, None] * strengths
    rule, precision = surface.near_rule, surface.precision
    return double_layer_transposed(
        positions, surface.nodes, weights, surface.wavenumber, rule, precision, contact
    ), factors


def check_memory(count: int, store: Store, tiles: int, rows: int) -> None:
    """Raise where the matrix of ``count`` unknowns, in whole tiles and rows of crosses, does not fit into memory."""
    word, numbers = KEPT_AS[store]
    size = (tiles * _kernels.lanes + rows) * _kernels.lanes * 2 * np.dtype(word).itemsize // numbers
    available = _available_memory()
    if size > 0.9 * available:
        raise InvalidInput(
            f"{count} unknowns need {size / 2**30:.1f} GiB for the matrix, but {available / 2**30:.1f} GiB of memory "
            "are free; ask for less accuracy or leave out distant bodies."
        )
