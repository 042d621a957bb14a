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
from jaxtyping import Complex, Complex128, Float64, Real, Shaped, UInt8

from airtact import _kernels
from airtact.conventions import InvalidInput
from airtact.scene.printing import in_short
from airtact.solvers.boundary_pressure import (
    NearRule,
    double_layer_heard,
    monopole_pressure,
    near_rows,
    project_contacts,
)
from airtact.solvers.boundary_quadrature import Nodes, thickness
from airtact.solvers.free_memory import available_memory as _available_memory


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
    """The matrix of the dual-surface equation, M x M, as the compiled loops keep it.

    Attributes
    ----------
    values : (M, B, 2, W) each row in blocks of 128 columns, real and imaginary parts, filled up with zeros, in words.
    """

    values: Shaped[np.ndarray, "nodes blocks 2 words"]

    __repr__ = in_short

    @classmethod
    def empty(cls, count: int, store: Store) -> "DualMatrix":
        """Take memory for M = ``count`` unknowns: that of a matrix given back, where there is enough of it."""
        word, numbers = KEPT_AS[store]
        shape, memory = (count, -(-count // _kernels.lanes), 2, _kernels.lanes // numbers), np.empty(0, dtype=np.uint8)
        size = math.prod(shape) * np.dtype(word).itemsize
        with suppress(IndexError):
            memory = _GIVEN_BACK.pop()
        if len(memory) < size:
            memory = np.empty(int(ROOM * size) if size < MOST_KEPT else size, dtype=np.uint8)
        return cls(memory[:size].view(word).reshape(shape))

    @property
    def store(self) -> Store:
        """What its numbers are kept as."""
        return next(store for store, (word, _) in KEPT_AS.items() if self.values.dtype == word)

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
        getattr(_kernels, f"dual_product_{self.store}")(self.values, vectors, transposed, out)
        return out

    def dense(self) -> Complex[np.ndarray, "nodes nodes"]:
        """Give all of it as one array, from float32 or float64."""
        count = len(self.values)
        out = np.empty((count, count), dtype=self.precision, order="F")  # as LAPACK takes it without a copy
        out.real, out.imag = (self.values[:, :, part].reshape(count, -1)[:, :count] for part in (0, 1))
        return out


def give_back(matrix: DualMatrix) -> None:
    """Keep the memory of a matrix that is no longer needed for the next one."""
    memory = matrix.values.base
    if memory is not None and memory.nbytes <= ROOM * MOST_KEPT:
        _GIVEN_BACK[:] = [memory]


def assemble(surface: DualSurface, store: Store) -> DualMatrix:
    """Fill the matrix of the dual-surface equation, its numbers kept as ``store``."""
    nodes = surface.nodes
    matrix = DualMatrix.empty(len(nodes.points), store)
    rule, precision = surface.near_rule, surface.precision
    near = [near_rows(nodes, points, surface.wavenumber, rule, precision) for points in (nodes.points, surface.shifted)]
    fill = getattr(_kernels, f"dual_matrix_{store}")
    of_rows = [part for rows in near for part in (rows.first, rows.panel, rows.excess)]
    fill(
        nodes.points,
        surface.shifted,
        nodes.weighted_normals,
        surface.wavenumber,
        *of_rows,
        matrix.values,
    )
    return matrix


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
    return double_layer_heard(positions, surface.nodes, weights, surface.wavenumber, rule, precision, contact), factors


def refuse_too_large(count: int, store: Store, copies: int = 1) -> None:
    """Raise where the matrix of ``count`` unknowns, or so many like it, does not fit into memory."""
    word, numbers = KEPT_AS[store]
    size = copies * count**2 * 2 * np.dtype(word).itemsize // numbers
    available = _available_memory()
    if size > 0.9 * available:
        raise InvalidInput(
            f"{count} unknowns need {size / 2**30:.1f} GiB for the matrix, but {available / 2**30:.1f} GiB of memory "
            "are free; ask for less accuracy (0.03 needs a quarter of the matrix of 0.01) or leave out distant bodies."
        )
