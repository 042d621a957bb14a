"""The dual-surface equation on curved panels: its matrix and its right-hand sides.

For a rigid body in e^{+ikr}/r convention the pressure on the skin solves, at x on the skin and x' = x − δ n inside,

    p(x)/2 − D[p](x) + i D[p](x') = p_inc(x) − i p_inc(x'),

D being the double layer. The second point makes the equation uniquely solvable at every frequency; with the other sign
of i GMRES takes many times the iterations.

Sources: A. Mohsen, R. Piscoya and M. Ochmann, "The application of the dual surface method to treat the nonuniqueness in
solving acoustic exterior problems", Acta Acustica united with Acustica 97 (2011) 699.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Complex128, Float64, Real

from airtact import _kernels
from airtact.conventions import InvalidInput
from airtact.scene.printing import in_short
from airtact.solvers.boundary_pressure import (
    NearRule,
    double_layer_heard,
    monopole_pressure,
    near_excess,
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
    shifted : (M, 3) the second collocation point of each node, inside its body [m].
    wavenumber : [1/m].
    near_rule : of the near integrals.
    precision : working precision, float32 or float64.
    """

    nodes: Nodes
    shifted: Float64[np.ndarray, "nodes 3"]
    wavenumber: complex
    near_rule: NearRule
    precision: str

    __repr__ = in_short


def dual_surface(nodes: Nodes, wavenumber: complex, near_rule: NearRule, precision: str) -> DualSurface:
    """Put the second surface 0.2 λ under the skin, or 0.3 of the local thickness where the body is thin."""
    wavelength = 2 * np.pi / wavenumber.real
    depth = np.minimum(0.2 * wavelength, 0.3 * thickness(nodes, wavelength))
    return DualSurface(nodes, nodes.points - depth[:, None] * nodes.normals, wavenumber, near_rule, precision)


def assemble(surface: DualSurface) -> Complex[np.ndarray, "nodes nodes"]:
    """Fill the matrix of the dual-surface equation, complex64 or complex128."""
    nodes, count = surface.nodes, len(surface.nodes.points)
    matrix = np.empty((count, count), dtype=np.complex64 if surface.precision == "float32" else np.complex128)
    fill = getattr(_kernels, f"dual_matrix_{surface.precision}")
    fill(nodes.points, surface.shifted, nodes.points, nodes.weighted_normals, surface.wavenumber, matrix)
    for points, factor in ((nodes.points, -1), (surface.shifted, 1j)):
        excess = near_excess(nodes, points, surface.wavenumber, surface.near_rule)
        rows = np.repeat(np.arange(count), np.diff(excess.indptr))
        matrix[rows, excess.indices] += (factor * excess.data).astype(matrix.dtype)
    matrix.flat[:: count + 1] += 0.5
    return matrix


def incident(
    surface: DualSurface, positions: Real[np.ndarray, "sources 3"], strengths: Complex[np.ndarray, "sources sounds"]
) -> Complex128[np.ndarray, "nodes sounds"]:
    """Right-hand side p_inc(x) − i p_inc(x') of some monopoles."""
    both = np.concatenate([surface.nodes.points, surface.shifted])
    pressure = monopole_pressure(both, positions, strengths, surface.wavenumber, "float64")
    count = len(surface.shifted)
    return pressure[:count] - 1j * pressure[count:]


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
    return double_layer_heard(positions, surface.nodes, weights, surface.wavenumber, rule, precision), factors


def refuse_too_large(count: int, precision: str) -> None:
    """Raise where the matrix of ``count`` unknowns does not fit into memory."""
    size = count**2 * (8 if precision == "float32" else 16)
    available = _available_memory()
    if size > 0.9 * available:
        raise InvalidInput(
            f"{count} unknowns need {size / 2**30:.1f} GiB for the matrix, but {available / 2**30:.1f} GiB of memory "
            "are free; ask for less accuracy (0.03 needs a quarter of the matrix of 0.01) or leave out distant bodies."
        )
