"""The dual-surface equation on curved panels: its matrix, its right-hand sides, and the field from its solution.

For a rigid body in e^{+ikr}/r convention the pressure on the skin solves, at x on the skin and x' = x − δ n inside,

    p(x)/2 − D[p](x) + i D[p](x') = p_inc(x) − i p_inc(x'),

D being the double layer. The second point makes the equation uniquely solvable at every frequency; with the other sign
of i GMRES takes many times the iterations.

Sources: A. Mohsen, R. Piscoya and M. Ochmann, "The application of the dual surface method to treat the nonuniqueness in
solving acoustic exterior problems", Acta Acustica united with Acustica 97 (2011) 699.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Complex128, Float64, Real

from airtact import _kernels
from airtact.conventions import InvalidInput
from airtact.scene.panels import shape_functions
from airtact.solvers.boundary_quadrature import NearPairs, Nodes, find_near, integrate_near, thickness

CONTACT = 1e-3
"""A point nearer to a panel than this share of the panel's radius is taken to lie on it."""

ROWS_AT_ONCE = 512


@dataclass(frozen=True)
class NearRule:
    """How panels near a point are integrated.

    Attributes
    ----------
    reach : panels whose centre is within this many radii of a point count as near.
    gauss_points : points along the angle and the radius before the stretching asks for more.
    """

    reach: float
    gauss_points: tuple[int, int]


@dataclass(frozen=True, eq=False)
class DualSystem:
    """The discrete dual-surface equation of one scene.

    Attributes
    ----------
    nodes : where the pressure is unknown.
    shifted : (M, 3) the second collocation point of each node, inside its body [m].
    matrix : (M, M) complex64 or complex128.
    wavenumber : [1/m].
    near_rule : of the near integrals.
    """

    nodes: Nodes
    shifted: Float64[np.ndarray, "nodes 3"]
    matrix: Complex[np.ndarray, "nodes nodes"]
    wavenumber: complex
    near_rule: NearRule

    @property
    def precision(self) -> str:
        """Working precision, float32 or float64."""
        return "float32" if self.matrix.dtype == np.complex64 else "float64"


def shift_inwards(nodes: Nodes, wavelength: float) -> Float64[np.ndarray, "nodes 3"]:
    """Second collocation points: 0.2 λ under the skin, or 0.3 of the local thickness where the body is thin."""
    depth = np.minimum(0.2 * wavelength, 0.3 * thickness(nodes, wavelength))
    return nodes.points - depth[:, None] * nodes.normals


def build_system(nodes: Nodes, wavenumber: complex, precision: str, near_rule: NearRule) -> DualSystem:
    """Assemble the dual-surface matrix of a set of nodes."""
    shifted = shift_inwards(nodes, 2 * np.pi / wavenumber.real)
    count = len(nodes.points)
    matrix = np.empty((count, count), dtype=np.complex64 if precision == "float32" else np.complex128)
    fill = getattr(_kernels, f"dual_matrix_{precision}")
    fill(nodes.points, shifted, nodes.points, nodes.weighted_normals, wavenumber, matrix)
    for points, factor in ((nodes.points, -1.0 + 0j), (shifted, 1j)):
        pairs = find_near(nodes, points, near_rule.reach)
        near = integrate_near(nodes, points, pairs, wavenumber, near_rule.gauss_points)
        _replace_near(matrix, nodes, points, near, wavenumber, factor)
    matrix.flat[:: count + 1] += 0.5
    return DualSystem(nodes, shifted, matrix, wavenumber, near_rule)


def _replace_near(
    matrix: Complex[np.ndarray, "rows nodes"],
    nodes: Nodes,
    points: Real[np.ndarray, "rows 3"],
    near: NearPairs,
    wavenumber: complex,
    factor: complex,
) -> None:
    """Swap the plain quadrature of near panels in ``factor`` × D for the near integrals."""
    for start in range(0, len(near.target), 1 << 16):
        part = slice(start, start + (1 << 16))
        rows, columns = near.target[part, None], near.columns[part]
        plain = double_layer_entries(points[rows], nodes.points[columns], nodes.weighted_normals[columns], wavenumber)
        matrix[rows, columns] += (factor * (near.values[part] - plain)).astype(matrix.dtype)


def double_layer_entries(
    targets: Real[np.ndarray, "*shape1 3"],
    sources: Real[np.ndarray, "*shape2 3"],
    weighted_normals: Real[np.ndarray, "*shape2 3"],
    wavenumber: complex,
) -> Complex128[np.ndarray, "*shape2"]:
    """∂/∂n_y e^{ikr}/(4πr) times area, element by element; 0 where the points coincide."""
    offset = sources - targets
    distance = np.sqrt(np.einsum("...d,...d->...", offset, offset))
    safe = np.where(distance > 0, distance, 1)
    slope = np.einsum("...d,...d->...", offset, weighted_normals) / (4 * np.pi * safe**3)
    return np.where(distance > 0, slope * (1j * wavenumber * safe - 1) * np.exp(1j * wavenumber * safe), 0)


def monopole_pressure(
    points: Real[np.ndarray, "points 3"],
    positions: Real[np.ndarray, "sources 3"],
    strengths: Complex[np.ndarray, "sources sounds"],
    wavenumber: complex,
    precision: str,
) -> Complex128[np.ndarray, "points sounds"]:
    """Free-field pressure Σ_j s_j e^{ikr}/r at points [Pa]."""
    out = np.empty((len(points), strengths.shape[1]), dtype=np.complex128)
    getattr(_kernels, f"apply_monopoles_{precision}")(
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(positions, dtype=np.float64),
        np.ascontiguousarray(strengths, dtype=np.complex128),
        complex(wavenumber),
        out,
    )
    return out


def double_layer_pressure(
    points: Real[np.ndarray, "points 3"],
    nodes: Nodes,
    pressure: Complex128[np.ndarray, "nodes sounds"],
    wavenumber: complex,
    precision: str,
) -> Complex128[np.ndarray, "points sounds"]:
    """Double layer D[p] of a pressure on the skin, at points with no panel near [Pa]."""
    out = np.empty((len(points), pressure.shape[1]), dtype=np.complex128)
    getattr(_kernels, f"apply_double_layer_{precision}")(
        np.ascontiguousarray(points, dtype=np.float64),
        nodes.points,
        nodes.weighted_normals,
        np.ascontiguousarray(pressure),
        complex(wavenumber),
        out,
    )
    return out


def incident(
    system: DualSystem, positions: Real[np.ndarray, "sources 3"], strengths: Complex[np.ndarray, "sources sounds"]
) -> Complex128[np.ndarray, "nodes sounds"]:
    """Right-hand side p_inc(x) − i p_inc(x') of some monopoles."""
    both = np.concatenate([system.nodes.points, system.shifted])
    pressure = monopole_pressure(both, positions, strengths, system.wavenumber, "float64")
    count = len(system.shifted)
    return pressure[:count] - 1j * pressure[count:]


@dataclass(frozen=True, eq=False)
class SkinRows:
    """What the pressure on the skin gives at some points: p(x) = factor × p_inc(x) + Σ_j row_j p_j.

    Attributes
    ----------
    rows : (P, M).
    factor : (P,) 1 off the skin; 2 on it, where the representation gives half the pressure.
    """

    rows: Complex128[np.ndarray, "points nodes"]
    factor: Float64[np.ndarray, "points"]


def skin_rows(nodes: Nodes, points: Real[np.ndarray, "points 3"], wavenumber: complex, near_rule: NearRule) -> SkinRows:
    """Rows of the double layer at points near or on the skin, singular panels included."""
    points, contact = project_contacts(nodes, points)
    rows = np.empty((len(points), len(nodes.points)), dtype=np.complex128)
    _kernels.double_layer_matrix_float64(points, nodes.points, nodes.weighted_normals, wavenumber, rows)
    pairs = find_near(nodes, points, near_rule.reach)
    near = integrate_near(nodes, points, pairs, wavenumber, near_rule.gauss_points)
    rows[near.target[:, None], near.columns] = near.values
    factor = np.where(contact, 2.0, 1.0)
    return SkinRows(rows * factor[:, None], factor)


def project_contacts(
    nodes: Nodes, points: Real[np.ndarray, "points 3"]
) -> tuple[Float64[np.ndarray, "points 3"], Bool[np.ndarray, "points"]]:
    """Put points that touch the skin exactly on their panel; says which those are."""
    points = np.array(points, dtype=np.float64)
    near = integrate_near(nodes, points, find_near(nodes, points, 1.01), 0j, (1, 1))
    touching = near.distance < CONTACT * nodes.radii[near.panel]
    order = np.flatnonzero(touching)[np.argsort(-near.distance[touching])]
    contact = np.zeros(len(points), dtype=bool)
    contact[near.target[order]] = True
    shape = shape_functions(near.foot[order])
    points[near.target[order]] = np.einsum("en,end->ed", shape, nodes.six_nodes[near.panel[order]])
    return points, contact


def winding(nodes: Nodes, points: Real[np.ndarray, "points 3"], near_rule: NearRule) -> Float64[np.ndarray, "points"]:
    """Share of the full solid angle that the skin fills as seen from points: 1 inside, 0 outside, ½ on it."""
    points = np.ascontiguousarray(points, dtype=np.float64)
    near = near_skin(nodes, points, near_rule.reach)
    share = np.empty(len(points))
    ones = np.ones((len(nodes.points), 1), dtype=np.complex128)
    share[~near] = -np.real(double_layer_pressure(points[~near], nodes, ones, 0j, "float32")[:, 0])
    chosen = np.flatnonzero(near)
    for start in range(0, len(chosen), ROWS_AT_ONCE):
        part = chosen[start : start + ROWS_AT_ONCE]
        found = skin_rows(nodes, points[part], 0j, near_rule)
        share[part] = -np.sum(np.real(found.rows), axis=1) / found.factor
    return share


def near_skin(nodes: Nodes, points: Real[np.ndarray, "points 3"], reach: float) -> Bool[np.ndarray, "points"]:
    """Whether any panel's centre lies within ``reach`` of its radii from points (P, 3)."""
    near = np.zeros(len(points), dtype=bool)
    near[find_near(nodes, points, reach)[0]] = True
    return near


def refuse_too_large(count: int, precision: str) -> None:
    """Raise where the matrix of ``count`` unknowns does not fit into memory."""
    size = count**2 * (8 if precision == "float32" else 16)
    available = _available_memory()
    if size > 0.9 * available:
        raise InvalidInput(
            f"{count} unknowns need {size / 2**30:.1f} GiB for the matrix, but {available / 2**30:.1f} GiB of memory "
            "are free; ask for less accuracy (0.03 needs a quarter of the matrix of 0.01) or leave out distant bodies."
        )


def _available_memory() -> float:
    """Bytes that can be had without swapping; infinite where the system does not say."""
    try:
        with open("/proc/meminfo") as lines:
            for line in lines:
                if line.startswith("MemAvailable:"):
                    return 1024.0 * int(line.split()[1])
    except OSError:
        return float("inf")
    return float("inf")
