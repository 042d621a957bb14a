"""The layers on curved panels, at any points: far panels by their nodes, near ones by near integrals.

With n outward and p_inc that of the sources alone, Green's formula outside the bodies is p = p_inc
+ D[p], D being the double layer. A surface of impedance Z, on which ∂p/∂n = −(ikρc/Z) p, adds the
single layer of (ikρc/Z) p; wherever "double layer" stands, that is included.

Its solid angle also locates points: inside the bodies, outside, near the surface, or on it.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64, Real
from scipy.sparse import csr_array

from airtact import _kernels
from airtact.acoustics.planes import before_planes
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.quadrature import (
    LARGEST_RULE,
    NODAL,
    OFF_SURFACE,
    Nodes,
    find_near,
    gauss_rules,
    integrate_near,
    near_lists,
)
from airtact.acoustics.solvers.bem.target_cells import Cells
from airtact.acoustics.solvers.loops import loop
from airtact.geometry.mesh.quadratic_triangles import shape_functions

ROWS_AT_ONCE = 512
"""Rows of a matrix that is made in parts."""

FEW_SOUNDS = 64
"""Excitations up to which a compiled loop adds up the transposed double layer; of more, BLAS does it sooner."""


@dataclass(frozen=True)
class NearRule:
    """How panels whose centre is within ``reach`` of their radii from a point are integrated.

    ``gauss_points`` are those along the angle and the radius before the stretching asks for more.
    """

    reach: float
    gauss_points: tuple[int, int]


@dataclass(frozen=True, eq=False)
class NearRows:
    """Corrections that near panels add to the plain sum over nodes, for some points; ``first`` as in ``near_lists``.

    ``excess`` is the near integral for each of a panel's nodes, less the plain term of the node.
    """

    first: Int64[np.ndarray, "bounds"]
    panel: Int64[np.ndarray, "pairs"]
    excess: Complex128[np.ndarray, "pairs 6"]

    def split(self, points: int) -> tuple["NearRows", "NearRows"]:
        """Split into the rows of the first ``points`` points and those of the others."""
        begin = int(self.first[points])
        return (
            NearRows(self.first[: points + 1], self.panel[:begin], self.excess[:begin]),
            NearRows(self.first[points:] - begin, self.panel[begin:], self.excess[begin:]),
        )

    def sparse(self, nodes: int) -> csr_array:
        """Return the corrections as a sparse matrix (P, M) with ``nodes`` columns."""
        columns = (6 * self.panel[:, None] + np.arange(6)).ravel()
        return csr_array(
            (self.excess.ravel(), columns, 6 * self.first), shape=(len(self.first) - 1, nodes)
        )


def near_rows(
    nodes: Nodes,
    points: Real[np.ndarray, "points 3"],
    wavenumber: complex,
    near_rule: NearRule,
    precision: str,
    least: float = 0.0,
    lists: tuple[Int64[np.ndarray, "bounds"], Int64[np.ndarray, "pairs"]] | None = None,
) -> NearRows:
    """Near integrals of the double layer, less the plain terms of the nodes farther than ``least`` [m].

    In float32 no point may touch a panel at its edge. ``lists`` are the near panels, where they are
    known already.
    """
    first, panel = (
        near_lists(nodes, points, near_rule.reach * nodes.radii) if lists is None else lists
    )
    excess = np.empty((len(panel), 6), dtype=np.complex128)
    points = np.ascontiguousarray(points, dtype=np.float64)
    panels = nodes.quadratic_triangles, nodes.contact, nodes.points, nodes.weighted_normals
    panels = *panels, nodes.single_layer(wavenumber), NODAL
    rules = *gauss_rules(LARGEST_RULE), LARGEST_RULE, *near_rule.gauss_points
    loop("near_excess", precision)(
        points, first, panel, *panels, complex(wavenumber), least, *rules, excess
    )
    return NearRows(first, panel, excess)


def double_layer_pressure(
    points: Real[np.ndarray, "points 3"],
    nodes: Nodes,
    pressure: Complex128[np.ndarray, "nodes sounds"],
    wavenumber: complex,
    near_rule: NearRule,
    precision: str,
    cells: Cells | None = None,
    nodal: bool = False,
    contact: Bool[np.ndarray, "points"] | None = None,
) -> Complex128[np.ndarray, "points sounds"]:
    """Double layer D[p] of a pressure on the surface, at points off the panels or exactly on them (principal value).

    With ``cells``, which hold the points, none of them may be on a panel. With ``nodal`` all points
    are on panels and away from their edges, as nodes are, so that the near integrals need no more
    than the working precision. ``contact`` marks the points that were projected onto a panel.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    if cells is None:
        least, precision = _least_distance(nodes, near_rule, precision)
        out = np.empty((len(points), pressure.shape[1]), dtype=np.complex128)
        layer = (
            nodes.points,
            nodes.weighted_normals,
            nodes.single_layer(wavenumber),
            np.ascontiguousarray(pressure),
        )
        loop("apply_double_layer", precision)(points, *layer, complex(wavenumber), least, out)
    else:
        least, single = 0.05 * float(nodes.radii.min()), nodes.single_layer(wavenumber)
        out = cells.sums(nodes.points, nodes.weighted_normals, pressure, wavenumber, least, single)
    precise = precision if nodal else "float64" if cells is None else "float32"
    for some, rows in _near_by_contact(
        nodes, points, contact, wavenumber, near_rule, precise, least
    )[1]:
        out[some] += rows.sparse(len(nodes.points)) @ pressure
    return out


def _near_by_contact(
    nodes: Nodes,
    points: Float64[np.ndarray, "points 3"],
    contact: Bool[np.ndarray, "points"] | None,
    wavenumber: complex,
    near_rule: NearRule,
    precision: str,
    least: float = 0.0,
) -> tuple[Bool[np.ndarray, "points"], list[tuple[Bool[np.ndarray, "points"], NearRows]]]:
    """Which points are near; near rows of those off the panels, and of those on a panel, whose contacts reach farther.

    Adjacent panels deviate from the true surface by different lengths. If the point on one panel
    counted as above or below the next, the solid angle at the shared corner would be halved or
    doubled. So the point touches the next panel too if its distance is within the sum of both
    panels' contact distances.
    """
    first, panel = near_lists(nodes, points, near_rule.reach * nodes.radii)
    near, rule = np.diff(first) > 0, (wavenumber, near_rule, precision, least)
    on = near & contact if contact is not None else np.zeros(len(points), dtype=bool)
    if not on.any():
        lists = (
            np.append(first[:-1][near], first[-1]),
            panel,
        )  # points that are not near have no panels in it
        return near, [(near, near_rows(nodes, points[near], *rule, lists))] if near.any() else []
    own = nodes.contact[find_contacts(nodes, points[on]).panel].max(initial=0.0)
    groups = (near & ~on, nodes), (on, replace(nodes, contact=nodes.contact + own))
    return near, [
        (some, near_rows(there, points[some], *rule)) for some, there in groups if some.any()
    ]


def _least_distance(nodes: Nodes, near_rule: NearRule, precision: str) -> tuple[float, str]:
    """Distance below which float32 does not resolve a node's position, if such panels are near ones; else float64."""
    least = 1e-3 * float(np.abs(nodes.points - nodes.points.mean(axis=0)).max())
    if precision == "float32" and least < 0.5 * (near_rule.reach - 1) * float(nodes.radii.min()):
        return least, precision
    return 0.0, "float64"


def double_layer_transposed(
    points: Real[np.ndarray, "points 3"],
    nodes: Nodes,
    strengths: Complex128[np.ndarray, "points sounds"],
    wavenumber: complex,
    near_rule: NearRule,
    precision: str,
    contact: Bool[np.ndarray, "points"] | None = None,
) -> Complex128[np.ndarray, "nodes sounds"]:
    """Σ_i s_i D(x_i, y_j): the transposed double layer of sources of strength s_i, at each node.

    ``contact`` marks the points that were projected onto a panel.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    near, groups = _near_by_contact(nodes, points, contact, wavenumber, near_rule, "float64")
    total, single = (
        np.zeros((len(nodes.points), strengths.shape[1]), np.complex128),
        nodes.single_layer(wavenumber),
    )
    for some, rows in groups:
        pairs = np.repeat(strengths[some], np.diff(rows.first), axis=0)
        np.add.at(
            total.reshape(-1, 6, total.shape[1]),
            rows.panel,
            rows.excess[:, :, None] * pairs[:, None],
        )
    layer = nodes.points, nodes.weighted_normals, single
    for chosen, kind in ((near, "float64"), (~near, precision)):
        if chosen.any():
            sum_up = _by_matrix if strengths.shape[1] > FEW_SOUNDS else _summed
            total += sum_up(points[chosen], layer, strengths[chosen], complex(wavenumber), kind)
    return total


Layer = tuple[
    Float64[np.ndarray, "nodes 3"], Float64[np.ndarray, "nodes 3"], Complex128[np.ndarray, "some"]
]
"""Nodes, their normals times area, and ``Nodes.single_layer``."""


def _summed(
    points: Float64[np.ndarray, "points 3"],
    layer: Layer,
    strengths: Complex128[np.ndarray, "points sounds"],
    wavenumber: complex,
    precision: str,
) -> Complex128[np.ndarray, "nodes sounds"]:
    """Σ_i s_i D(x_i, y_j) by a loop that leaves no threads of BLAS spinning."""
    out = np.empty((len(layer[0]), strengths.shape[1]), dtype=np.complex128)
    loop("apply_transposed", precision)(points, *layer, strengths, wavenumber, out)
    return out


def _by_matrix(
    points: Float64[np.ndarray, "points 3"],
    layer: Layer,
    strengths: Complex128[np.ndarray, "points sounds"],
    wavenumber: complex,
    precision: str,
) -> Complex128[np.ndarray, "nodes sounds"]:
    """Σ_i s_i D(x_i, y_j) by products with the matrix D, some rows of it at a time."""
    out = np.zeros((len(layer[0]), strengths.shape[1]), dtype=np.complex128)
    for start in range(0, len(points), ROWS_AT_ONCE):
        block = slice(start, start + ROWS_AT_ONCE)
        shape = len(points[block]), len(layer[0])
        rows = np.empty(shape, dtype=np.complex64 if precision == "float32" else np.complex128)
        loop("double_layer_matrix", precision)(points[block], *layer, wavenumber, rows)
        out += rows.T @ strengths[block].astype(rows.dtype)
    return out


@dataclass(frozen=True, eq=False)
class Contacts:
    """Where points touch the surface, or are close to it: each point once, with the panel nearest to it.

    ``reference`` are the reference coordinates of its projection onto the panel, at a distance [m].
    """

    target: Int64[np.ndarray, "contacts"]
    panel: Int64[np.ndarray, "contacts"]
    reference: Float64[np.ndarray, "contacts 2"]
    distance: Float64[np.ndarray, "contacts"]


def find_contacts(
    nodes: Nodes, points: Real[np.ndarray, "points 3"], within: float = 0.0
) -> Contacts:
    """Find which of some points (P, 3) touch the surface or are nearer to it than ``within`` [m], and where."""
    pairs = find_near(nodes, points, 1.1)
    if not len(pairs[0]):
        return Contacts(*pairs, np.empty((0, 2)), np.empty(0))
    near = integrate_near(nodes, points, pairs, 0j, (1, 1))
    touching = np.flatnonzero(near.distance < np.maximum(nodes.contact[near.panel], within))
    nearest_first = touching[np.argsort(near.distance[touching], kind="stable")]
    target, first = np.unique(near.target[nearest_first], return_index=True)
    chosen = nearest_first[first]
    return Contacts(target, near.panel[chosen], near.reference[chosen], near.distance[chosen])


def project_contacts(
    nodes: Nodes, points: Real[np.ndarray, "points 3"]
) -> tuple[Float64[np.ndarray, "points 3"], Bool[np.ndarray, "points"]]:
    """Project points that touch the surface onto their panel; also returns which those are."""
    points = np.array(points, dtype=np.float64)
    found = find_contacts(nodes, points)
    contact = np.zeros(len(points), dtype=bool)
    if not len(found.target):
        return points, contact
    contact[found.target] = True
    shape = shape_functions(found.reference)
    points[found.target] = np.einsum("en,end->ed", shape, nodes.quadratic_triangles[found.panel])
    return points, contact


def near_surface(
    nodes: Nodes, points: Real[np.ndarray, "points 3"], reach: float
) -> Bool[np.ndarray, "points"]:
    """Whether any panel's centre lies within ``reach`` of its radii from points (P, 3)."""
    return np.diff(near_lists(nodes, points, reach * nodes.radii)[0]) > 0


def _in_box(nodes: Nodes, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
    """Whether points lie in the upright box round all panels, each widened by its radius."""
    away = nodes.radii[:, None]
    lower, upper = (nodes.centres - away).min(axis=0), (nodes.centres + away).max(axis=0)
    x, y, z = (
        (points[:, axis] > lower[axis]) & (points[:, axis] < upper[axis]) for axis in range(3)
    )
    return x & y & z


@dataclass(frozen=True, eq=False)
class Located:
    """Points [m], those in contact with the surface projected onto their panel, and where they are.

    Near ones need near integrals; ``outside`` are those outside the bodies or in contact.
    """

    points: Float64[np.ndarray, "points 3"]
    near: Bool[np.ndarray, "points"]
    contact: Bool[np.ndarray, "points"]
    outside: Bool[np.ndarray, "points"]


def locate(
    scene: Scene, nodes: Nodes, points: Real[np.ndarray, "points 3"], near_rule: NearRule
) -> Located:
    """Locate points (P, 3) [m] by the solid angle that the panels subtend.

    Near the panels that takes near integrals. Where a point is farther from the scene's own
    surfaces than the panels may deviate from them, their signed distance decides; everywhere if all
    surfaces are closed forms. Behind a plane of the scene nothing is outside.
    """
    located = _located(scene, nodes, points, near_rule)
    if scene.planes:
        located.outside[~before_planes(scene.planes, points)] = False
    return located


def _located(
    scene: Scene, nodes: Nodes, points: Real[np.ndarray, "points 3"], near_rule: NearRule
) -> Located:
    located, contact = np.array(points, dtype=np.float64), np.zeros(len(points), dtype=bool)
    first, panel = near_lists(nodes, located, near_rule.reach * nodes.radii)
    near = np.diff(first) > 0
    touch = np.zeros(len(located))
    if len(panel):
        touch[near] = np.maximum.reduceat(nodes.contact[panel], first[:-1][near])
    outside, doubtful = (
        np.ones(len(located), dtype=bool),
        _in_box(nodes, located),
    )  # all others are outside
    if not near.any() and not doubtful.any():
        return Located(located, near, contact, outside)
    closed = all(obstacle.surface.primitive is not None for obstacle in scene.obstacles)
    known = np.flatnonzero(near | doubtful) if closed else np.flatnonzero(near)
    depth = scene.depth(located[known])
    outside[known] = depth < 0
    doubtful[known] = False
    outside[doubtful] = _unfilled(nodes, located[doubtful])
    some = known[np.abs(depth) < OFF_SURFACE * touch[known]]
    located[some], contact[some] = project_contacts(nodes, located[some])
    outside[contact] = True
    some = known[(np.abs(depth) < touch[known]) & ~contact[known]]
    ones = np.ones((len(nodes.points), 1), dtype=np.complex128)
    outside[some] = _less_than_half(
        double_layer_pressure(located[some], nodes, ones, 0j, near_rule, "float32")
    )
    return Located(located, near, contact, outside)


def _unfilled(nodes: Nodes, points: Float64[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
    """Whether points away from the surface are outside; there each panel counts as one node."""
    whole = nodes.weighted_normals.reshape(-1, 6, 3).sum(axis=1)
    filled = np.empty((len(points), 1), dtype=np.complex128)
    ones = np.ones((len(whole), 1), dtype=np.complex128)
    _kernels.apply_double_layer_float32(
        points, nodes.centres, whole, ones[:0, 0], ones, 0j, 0.0, filled
    )
    return _less_than_half(filled)


def _less_than_half(filled: Complex128[np.ndarray, "points 1"]) -> Bool[np.ndarray, "points"]:
    return np.real(filled[:, 0]) > -0.5
