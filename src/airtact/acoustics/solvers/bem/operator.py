"""The dual-surface equation on curved panels: its matrix and its right-hand sides.

For a sound-hard body and outgoing waves e^{+ikr}/r the pressure p on the surface solves, at x on
the surface and at x' = x − δ n inside,

    p(x)/2 − D[p](x) + i D[p](x') = p_inc(x) − i p_inc(x'),

where D is the double layer; a locally reacting surface adds a single layer to it
(``layer_potentials``). The second point makes the equation uniquely solvable at every frequency;
with the other sign of i GMRES takes many times the iterations.

Sources: A. Mohsen, R. Piscoya and M. Ochmann, "The application of the dual surface method to treat
the nonuniqueness in solving acoustic exterior problems", Acta Acustica united with Acustica 97
(2011) 699.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Complex, Complex128, Float64, Int64, Real, Shaped, UInt8

from airtact import _kernels
from airtact.acoustics.planes import Plane, with_images
from airtact.acoustics.solvers.bem.blocks import Pairs, blocks_of, near_blocks
from airtact.acoustics.solvers.bem.layer_potentials import (
    NearRule,
    double_layer_transposed,
    near_rows,
    project_contacts,
)
from airtact.acoustics.solvers.bem.quadrature import Nodes, near_lists, thickness
from airtact.acoustics.solvers.loops import loop
from airtact.acoustics.solvers.memory import available_memory as _available_memory
from airtact.acoustics.solvers.monopoles import monopole_pressure
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput
from airtact.printing import in_short


@dataclass(frozen=True, eq=False)
class DualSurface:
    """The discrete dual-surface equation of a scene, in the working precision float32 or float64.

    ``shifted`` are the second collocation points of each three nodes, inside their body [m].
    """

    nodes: Nodes
    shifted: Float64[np.ndarray, "groups 3"]
    wavenumber: complex
    near_rule: NearRule
    precision: str

    __repr__ = in_short


THICK = 2 / 3
"""Wavelengths of thickness from which on a body is no longer thin."""

Geometry = tuple[
    Float64[np.ndarray, "rows 3"],
    Float64[np.ndarray, "groups 3"],
    Float64[np.ndarray, "nodes 3"],
    Float64[np.ndarray, "nodes 3"],
    Complex128[np.ndarray, "some"],
    complex,
]
"""What the entries of a matrix follow from: x and x' of its rows; nodes, weighted normals and single layer of its
columns; k."""


def dual_surface(
    nodes: Nodes,
    wavenumber: complex,
    near_rule: NearRule,
    precision: str,
    least: Float64[np.ndarray, "nodes"] | None = None,
) -> DualSurface:
    """Put the second surface 0.2 λ under the surface, or 0.3 of the local thickness where the body is thin.

    Three neighbours on a panel share one point of it: a third fewer kernels for the same accuracy.
    ``least`` is a lower bound of the thickness at each node [m].
    """
    wavelength = 2 * np.pi / wavenumber.real
    depth = 0.3 * thickness(nodes, THICK * wavelength, least)
    inside = (nodes.points - depth[:, None] * nodes.normals).reshape(-1, _kernels.sharing, 3)
    shared = np.einsum("gsd->gd", inside) / _kernels.sharing  # NumPy's mean takes ten times as long
    return DualSurface(nodes, shared, wavenumber, near_rule, precision)


Store = Literal["bfloat16", "float32", "float64"]
"""Number format of a matrix in memory; bfloat16 is the upper half of a float32, right to 0.2 %."""

FORMATS: dict[Store, tuple[type[np.generic], int]] = {
    "bfloat16": (np.uint32, 2),
    "float32": (np.float32, 1),
    "float64": (np.float64, 1),
}
"""The word of each format, and how many numbers a word holds."""


_FREE: list[UInt8[np.ndarray, "bytes"]] = []
"""Memory of the last matrix that was released, if any: touching fresh memory takes longer than filling it."""

LARGEST_REUSED = 2**28
"""Bytes of a matrix above which its memory is not reused."""

LINE = 64
"""Bytes that a processor reads at once: what begins at a multiple of them is read in fewer pieces."""

ALWAYS_FREE = 2**26
"""Bytes that are free wherever this program runs, so that how many are need not be read."""

ROOM = 1.25
"""Memory allocated over what is needed: the next pose may have more unknowns, and untouched pages cost nothing."""


@dataclass(frozen=True, eq=False)
class DualMatrix:
    """The matrix of the dual-surface equation for ``count`` unknowns, in blocks of ``_kernels.lanes`` rows and columns.

    The whole ones are stored entry by entry in ``blocks``: row by row, real and imaginary parts,
    padded with zeros, in words. The far ones are sums of low-rank (ACA) terms: ``ranks`` says how
    many, ``begin`` where the factors of each begin, those along the columns of a block first, then
    those along its rows. ``memory`` holds all of it.
    """

    count: int
    whole: Pairs
    blocks: Shaped[np.ndarray, "pairs lanes 2 words"]
    far: Pairs
    ranks: Int64[np.ndarray, "far"]
    begin: Int64[np.ndarray, "far"]
    factors: Shaped[np.ndarray, "factors 2 words"]
    memory: UInt8[np.ndarray, "bytes"]

    __repr__ = in_short

    @classmethod
    def empty(
        cls, count: int, store: Store, near: Bool[np.ndarray, "blocks blocks"], room: int = 0
    ) -> "DualMatrix":
        """Allocate M = ``count`` unknowns with ``near`` blocks whole and ``room`` factors of low-rank terms.

        The memory of the last released matrix is reused if it is large enough.
        """
        word, numbers = FORMATS[store]
        row = (2, _kernels.lanes // numbers)
        whole, far = Pairs.of(near), Pairs.of(~near)
        lines = len(whole.column) * _kernels.lanes
        line = math.prod(row) * np.dtype(word).itemsize
        memory = _memory((lines + room) * line)
        words = memory[: (lines + room) * line].view(word)
        blocks = words[: lines * math.prod(row)].reshape(-1, _kernels.lanes, *row)
        factors = words[lines * math.prod(row) :].reshape(-1, *row)
        ranks, begin = np.zeros((2, len(far.column)), dtype=np.int64)
        return cls(count, whole, blocks, far, ranks, begin, factors, memory)

    @property
    def store(self) -> Store:
        """Number format in memory."""
        return next(store for store, (word, _) in FORMATS.items() if self.blocks.dtype == word)

    @property
    def precision(self) -> type[np.complexfloating]:
        """Type of its products: complex64 or complex128."""
        return np.complex128 if self.store == "float64" else np.complex64

    def times(
        self, vectors: Complex[np.ndarray, "columns nodes"], transposed: bool = False
    ) -> Complex[np.ndarray, "columns nodes"]:
        """Multiply the matrix, or its transpose, by vectors (S, M), which are rows here; in one pass over it."""
        vectors = np.ascontiguousarray(vectors, dtype=self.precision)
        out = np.empty_like(vectors)
        whole, far = (self.whole.first, self.whole.column), (self.far.first, self.far.column)
        terms = self.ranks, self.begin, self.factors
        loop("dual_product", self.store)(
            *whole, self.blocks, *far, *terms, vectors, transposed, out
        )
        return out

    def dense(self) -> Complex[np.ndarray, "nodes nodes"]:
        """Return a matrix without low-rank blocks as one array, from float32 or float64."""
        lanes = _kernels.lanes
        out = np.empty(
            (self.count, self.count), dtype=self.precision, order="F"
        )  # as LAPACK takes it without a copy
        for block, row, column in zip(
            self.blocks, lanes * self.whole.row, lanes * self.whole.column, strict=True
        ):
            part = out[row : row + lanes, column : column + lanes]
            part.real, part.imag = (block[: len(part), of, : part.shape[1]] for of in (0, 1))
        return out


def _memory(size: int) -> UInt8[np.ndarray, "bytes"]:
    """Allocate at least ``size`` bytes, from the released memory if that is enough."""
    with suppress(IndexError):
        memory = _FREE.pop()
        if len(memory) >= size:
            return memory
    memory = np.empty((int(ROOM * size) if size < LARGEST_REUSED else size) + LINE, dtype=np.uint8)
    return memory[-memory.ctypes.data % LINE :]


def release(matrix: DualMatrix) -> None:
    """Let the next matrix reuse the memory of one that is no longer needed."""
    if matrix.memory.nbytes <= ROOM * LARGEST_REUSED:
        _FREE[:] = [matrix.memory]


APART = 0.2
"""Wavelengths between the edges of panels beyond which blocks are sums of low-rank terms."""

EXPECTED = 24
"""Mean rank that memory is allocated for; often it is half of that. Beyond it the terms are computed again."""


def assemble(
    surface: DualSurface, store: Store, error: float | None = None, image: Plane | None = None
) -> DualMatrix:
    """Fill the matrix of the dual-surface equation in the number format ``store``.

    With an ``error``, relative to the 1/2 on the diagonal, blocks apart are sums of low-rank (ACA)
    terms; without it all blocks are whole. With ``image`` it is the part of the matrix that the
    bodies' image in a plane adds: images have the same pressure, and D over them at x is D over the
    bodies at the image of x. ``InvalidInput`` is raised where it does not fit into memory.
    """
    nodes, rule, precision = surface.nodes, surface.near_rule, surface.precision
    placed = _rows_at(surface, image)
    near = near_rows(nodes, np.concatenate(placed), surface.wavenumber, rule, precision).split(
        len(placed[0])
    )
    blocks = blocks_of(len(nodes.points))
    whole = np.ones((blocks, blocks), dtype=bool)
    if error is not None:
        centres = nodes.centres if image is None else image.image(nodes.centres)
        beside = near_lists(
            nodes, centres, 2 * nodes.radii + APART * 2 * np.pi / surface.wavenumber.real
        )
        whole = near_blocks(
            len(nodes.centres), beside, *((rows.first, rows.panel) for rows in near)
        )
    single = nodes.single_layer(surface.wavenumber)
    geometry = *placed, nodes.points, nodes.weighted_normals, single, surface.wavenumber
    matrix = _with_low_rank(geometry, store, whole, error or 0.0)
    of_rows = [part for rows in near for part in (rows.first, rows.panel, rows.excess)]
    diagonal = 0.5 if image is None else 0.0
    loop("dual_blocks", store)(
        *geometry, diagonal, *of_rows, matrix.whole.first, matrix.whole.column, matrix.blocks
    )
    return matrix


def _rows_at(
    surface: DualSurface, image: Plane | None
) -> tuple[Float64[np.ndarray, "rows 3"], Float64[np.ndarray, "groups 3"]]:
    """Where the double layer of the rows is evaluated: at the nodes and the shifted points, or at their images."""
    if image is None:
        return surface.nodes.points, surface.shifted
    return image.image(surface.nodes.points), image.image(surface.shifted)


def _with_low_rank(
    geometry: Geometry, store: Store, whole: Bool[np.ndarray, "blocks blocks"], error: float
) -> DualMatrix:
    """Allocate a matrix, and compute the low-rank terms of the blocks that are not whole."""
    count, stored = len(geometry[0]), int(np.count_nonzero(whole))
    tolerance = 0.5 * error * math.sqrt(_kernels.lanes / len(whole))
    needed = 2 * EXPECTED * (whole.size - stored)
    while True:
        room = needed
        check_memory(count, store, stored, room // 2)
        matrix = DualMatrix.empty(count, store, whole, room)
        if not room:
            return matrix
        far, terms = (
            (matrix.far.first, matrix.far.column),
            (matrix.ranks, matrix.begin, matrix.factors),
        )
        needed = loop("dual_low_rank", store)(*geometry, *far, tolerance, *terms)
        if needed <= room:
            return matrix


def direct_right_side(
    surface: DualSurface,
    positions: Real[np.ndarray, "sources 3"],
    strengths: Complex[np.ndarray, "sources sounds"],
) -> Complex128[np.ndarray, "nodes sounds"]:
    """Right-hand side p_inc(x) − i p_inc(x') of some monopoles."""
    both = np.concatenate([surface.nodes.points, surface.shifted])
    pressure = monopole_pressure(both, positions, strengths, surface.wavenumber, "float64")
    count = len(surface.nodes.points)
    return pressure[:count] - 1j * np.repeat(pressure[count:], _kernels.sharing, axis=0)


def transposed_right_side(
    surface: DualSurface,
    positions: Real[np.ndarray, "sources 3"],
    strengths: Complex128[np.ndarray, "sources sounds"],
    planes: Sequence[Plane] = (),
) -> tuple[Complex128[np.ndarray, "nodes sounds"], Float64[np.ndarray, "sources"]]:
    """Right-hand side of the transposed equation: the transposed double layer of the monopoles and their images.

    Also (N,) the factor of each monopole: 1 off the surface, 2 on it, where Green's formula gives
    half the pressure.
    """
    positions, contact = project_contacts(surface.nodes, positions)
    factors = np.where(contact, 2.0, 1.0)
    emitting = with_images(planes, Monopoles(positions, factors[:, None] * strengths))
    touching = np.concatenate(
        [contact, np.zeros(len(emitting.positions) - len(contact), dtype=bool)]
    )
    given = (
        surface.nodes,
        emitting.strengths,
        surface.wavenumber,
        surface.near_rule,
        surface.precision,
    )
    return double_layer_transposed(emitting.positions, *given, touching), factors


def check_memory(count: int, store: Store, blocks: int, factors: int) -> None:
    """Raise if the matrix of ``count`` unknowns, in whole blocks and low-rank factors, does not fit into memory."""
    word, numbers = FORMATS[store]
    size = (
        (blocks * _kernels.lanes + factors)
        * _kernels.lanes
        * 2
        * np.dtype(word).itemsize
        // numbers
    )
    if size > ALWAYS_FREE and size > 0.9 * (available := _available_memory()):
        raise InvalidInput(
            f"{count} unknowns need {size / 2**30:.1f} GiB for the matrix, but {available / 2**30:.1f} GiB of memory "
            "are free; ask for less accuracy or leave out distant bodies.",
            code="too_little_memory",
        )
