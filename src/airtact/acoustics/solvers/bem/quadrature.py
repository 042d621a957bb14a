"""Nodes, weights and near integrals on curved quadratic (six-node) panels.

Each panel carries the six nodes of a rule of degree 4, all inside it, and the pressure on it is the
quadratic through them (a Nyström method that needs no continuity between panels).
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Real

from airtact import _kernels
from airtact.geometry.mesh.panel_tree import panel_tree
from airtact.geometry.mesh.quadratic_triangles import (
    QuadraticTriangles,
    points_at,
    shape_functions,
    shape_gradients,
)
from airtact.printing import in_short


def _degree_four_rule() -> tuple[Float64[np.ndarray, "6 2"], Float64[np.ndarray, "6"]]:
    """Six-point rule of degree 4 on the unit triangle (Strang & Fix 1973; Cowper 1973, closed form).

    The first three points lie about corner 1, the others about the edge facing it.
    """
    root = np.sqrt(38 - 44 * np.sqrt(2 / 5))
    spread = np.sqrt(213125 - 53320 * np.sqrt(10))
    points, weights = [], []
    for sign in (1, -1):
        a = (8 - np.sqrt(10) + sign * root) / 18
        points += [[a, a], [1 - 2 * a, a], [a, 1 - 2 * a]]
        weights += [(620 + sign * spread) / 7440] * 3
    neighbours = [4, 2, 0, 3, 5, 1]
    return np.array(points)[neighbours], np.array(weights)[neighbours]


CONTACT = 1e-3
"""A point nearer to a panel than this share of the panel's radius is taken to lie on it."""

OFF_SURFACE = 2.0
"""Farther from the true surface than so many times a panel's contact nothing touches the panel, which deviates from the
surface by less than 2/3 of its contact."""

RULE_POINTS, RULE_WEIGHTS = _degree_four_rule()

RULE = np.concatenate(
    [
        shape_functions(RULE_POINTS),
        *shape_gradients(RULE_POINTS),
        shape_functions(np.full((1, 2), 1 / 3)),
    ]
)
"""(19, 6) shape functions at the six nodes, their derivatives along both coordinates, and at the centre."""


def monomials(points: Real[np.ndarray, "points 2"]) -> Float64[np.ndarray, "points 6"]:
    """1, u, v, u², uv, v² at reference points (P, 2), the order of the compiled near integrals."""
    u, v = points[:, 0], points[:, 1]
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)


NODAL = np.linalg.inv(monomials(RULE_POINTS))
"""(6, 6): column j holds the monomial coefficients of the quadratic that is 1 at node j and 0 at the others."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """The quadrature nodes of a set of panels [m], with outward unit normals; node 6 t + j is node j of panel t.

    ``weights`` are the areas that nodes stand for [m²], ``body`` their obstacles. Points nearer to
    a panel than its ``contact`` are taken to lie on it; ``radii`` reach from a panel's centre to
    the farthest of its six nodes [m]. ``admittance`` is ρc/Z of a panel's surface, 0 for a
    sound-hard one.
    """

    points: Float64[np.ndarray, "nodes 3"]
    normals: Float64[np.ndarray, "nodes 3"]
    weights: Float64[np.ndarray, "nodes"]
    body: Int64[np.ndarray, "nodes"]
    quadratic_triangles: Float64[np.ndarray, "panels 6 3"]
    contact: Float64[np.ndarray, "panels"]
    centres: Float64[np.ndarray, "panels 3"]
    radii: Float64[np.ndarray, "panels"]
    admittance: Complex128[np.ndarray, "panels"]

    __repr__ = in_short

    @cached_property
    def weighted_normals(self) -> Float64[np.ndarray, "nodes 3"]:
        """(M, 3) normals times area [m²]."""
        return self.normals * self.weights[:, None]

    def single_layer(self, wavenumber: complex) -> Complex128[np.ndarray, "some"]:
        """(M,) ikρc/Z times area [m], by which the pressure enters a single layer; (0,) where that is 0 everywhere.

        It is −∂p/∂n over p: Green's formula adds the single layer of it to the double layer of the
        pressure.
        """
        if not self.admittance.any():
            return np.empty(0, dtype=np.complex128)
        return 1j * wavenumber * np.repeat(self.admittance, 6) * self.weights


def place_nodes(
    quadratic_triangles: QuadraticTriangles,
    body: Int64[np.ndarray, "panels"],
    deviation: Float64[np.ndarray, "panels"],
    admittance: Complex128[np.ndarray, "panels"] | None = None,
) -> Nodes:
    """Put the six nodes of the degree-4 rule on every panel, which deviates from the true surface by a length [m].

    Without an ``admittance`` of each panel all are sound-hard.
    """
    panels, count = np.ascontiguousarray(quadratic_triangles), len(quadratic_triangles)
    (points, normals), weights = np.empty((2, 6 * count, 3)), np.empty(6 * count)
    centres, radii = np.empty((count, 3)), np.empty(count)
    _kernels.place_nodes(panels, RULE, RULE_WEIGHTS, points, normals, weights, centres, radii)
    return Nodes(
        points=points,
        normals=normals,
        weights=weights,
        body=np.repeat(body, 6),
        quadratic_triangles=panels,
        contact=np.maximum(CONTACT * radii, 1.5 * deviation),
        centres=centres,
        radii=radii,
        admittance=np.zeros(len(body), dtype=np.complex128) if admittance is None else admittance,
    )


@cache
def gauss_rules(
    largest: int,
) -> tuple[Float64[np.ndarray, "points"], Float64[np.ndarray, "points"]]:
    """Gauss-Legendre rules of 1, 2, ... ``largest`` points on [0, 1], one after another."""
    rules = [np.polynomial.legendre.leggauss(n) for n in range(1, largest + 1)]
    return np.concatenate([0.5 * (x + 1) for x, _ in rules]), np.concatenate(
        [0.5 * w for _, w in rules]
    )


LARGEST_RULE = 40

MAY_FACE_AWAY = 0.5
"""Cosine between the normals of a node and of a panel below which some of the panel may face away from the node."""

COVERED = 0.45
"""Radii of a panel within which each of its points has a node; 0.38 on the panels of a hand, 0.33 on flat ones."""

SHRINKINGS = 4
"""How often a ball may be shrunk: each time its excess falls to a quarter, or less."""


@dataclass(frozen=True, eq=False)
class NearPairs:
    """Integrals ∫ kernel(x, y) L_j(y) dS over the panels near targets, L_j the quadratics of a panel's six nodes.

    Each pair has the distance from the target to the panel [m] and the reference coordinates of the
    closest point.
    """

    target: Int64[np.ndarray, "pairs"]
    panel: Int64[np.ndarray, "pairs"]
    values: Complex128[np.ndarray, "pairs 6"]
    distance: Float64[np.ndarray, "pairs"]
    reference: Float64[np.ndarray, "pairs 2"]


def near_lists(
    nodes: Nodes, points: Real[np.ndarray, "points 3"], limits: Float64[np.ndarray, "panels"]
) -> tuple[Int64[np.ndarray, "bounds"], Int64[np.ndarray, "pairs"]]:
    """Where each point's panels begin, and panels whose centre is nearer to it than the panel's limit [m]."""
    first, panel = _kernels.near_pairs(
        np.ascontiguousarray(points, dtype=np.float64), nodes.centres, limits
    )
    return first.view(np.int64), panel.view(np.int64)  # NumPy has two names for the same numbers


def find_near(
    nodes: Nodes, points: Real[np.ndarray, "points 3"], reach: float
) -> tuple[Int64[np.ndarray, "pairs"], Int64[np.ndarray, "pairs"]]:
    """Pairs (target, panel) whose distance from the panel's centre is below ``reach`` panel radii."""
    first, panel = near_lists(nodes, points, reach * nodes.radii)
    return np.repeat(np.arange(len(points)), np.diff(first)), panel


def integrate_near(
    nodes: Nodes,
    points: Real[np.ndarray, "points 3"],
    pairs: tuple[Int64[np.ndarray, "pairs"], Int64[np.ndarray, "pairs"]],
    wavenumber: complex,
    gauss_points: tuple[int, int],
    single_layer: bool = False,
) -> NearPairs:
    """Integrate the double layer (or single layer) of e^{ikr}/(4πr) over panels near points, singular or not.

    The points [m] are on the panels (nearer than their contact) or off them; ``pairs`` as
    ``find_near`` returns them. ``gauss_points`` are along the angle and the radius, before the
    stretching adds more.
    """
    target, panel = pairs
    points = np.ascontiguousarray(points, dtype=np.float64)
    rules = *gauss_rules(LARGEST_RULE), LARGEST_RULE, *gauss_points
    moments = np.empty((len(target), 6), dtype=np.complex128)
    distance, reference = np.empty(len(target)), np.empty((len(target), 2))
    panels, out = (nodes.quadratic_triangles, nodes.contact), (moments, distance, reference)
    _kernels.near_integrals(
        single_layer, points, target, panel, *panels, complex(wavenumber), *rules, *out
    )
    return NearPairs(target, panel, moments @ NODAL, distance, reference)


def thickness(
    nodes: Nodes, largest: float, least: Float64[np.ndarray, "nodes"] | None = None
) -> Float64[np.ndarray, "nodes"]:
    """Diameter of the largest ball inside the body that touches the surface at each node [m], at most ``largest``.

    Nodes where the body is known to be as thick as that, by the ``least`` that it is there, are
    skipped.

    A ball that reaches no other node may still reach the surface between nodes, so it is shrunk
    until the point of the panels nearest to its centre is on it (J. Ma, S. W. Bae, S. Choi, The
    Visual Computer 28, 7 (2012)).
    """
    diameter = np.full(len(nodes.points), float(largest))
    unknown = np.flatnonzero(least < largest) if least is not None else np.arange(len(nodes.points))
    if not len(unknown):
        return diameter
    node, panel = _facing(nodes, unknown, largest)
    np.minimum.at(diameter, node, _meeting_diameters(nodes, node, panel))
    some = np.unique(node)
    tree = panel_tree(nodes.quadratic_triangles)
    for _ in range(SHRINKINGS):
        centres = nodes.points[some] - 0.5 * diameter[some, None] * nodes.normals[some]
        panel, reference, distance = tree.closest(centres, 0.49 * diameter[some])
        touched, facing = points_at(nodes.quadratic_triangles[panel], reference)
        gap = nodes.points[some] - touched
        depth = np.einsum("nd,nd->n", gap, nodes.normals[some])
        opposite = (
            np.einsum("nd,nd->n", facing, nodes.normals[some]) <= 0
        )  # or a concave edge would count as thin
        inside = np.isfinite(distance) & opposite & (depth > 0)
        some = some[inside]
        diameter[some] = np.minimum(
            diameter[some], np.einsum("nd,nd->n", gap, gap)[inside] / depth[inside]
        )
    return diameter


def _facing(
    nodes: Nodes, some: Int64[np.ndarray, "some_nodes"], largest: float
) -> tuple[Int64[np.ndarray, "pairs"], Int64[np.ndarray, "pairs"]]:
    """Find panels of the body of some nodes that their largest ball may reach and that do not face the way they do.

    No point of a panel is farther than ``COVERED`` of its radii from a node.
    """
    centres = nodes.points - 0.5 * largest * nodes.normals
    first, panel = near_lists(nodes, centres[some], 0.5 * largest + nodes.radii)
    node = np.repeat(some, np.diff(first))
    facing = nodes.normals.reshape(-1, 6, 3).mean(axis=1)
    apart = np.einsum("ed,ed->e", facing[panel], nodes.normals[node]) < MAY_FACE_AWAY
    apart &= nodes.body[6 * panel] == nodes.body[node]
    node, panel = node[apart], panel[apart]
    off = nodes.points.reshape(-1, 6, 3)[panel] - centres[node, None]
    reached = (
        np.einsum("ejd,ejd->ej", off, off).min(axis=1)
        < (0.5 * largest + COVERED * nodes.radii[panel]) ** 2
    )
    return node[reached], panel[reached]


def _meeting_diameters(
    nodes: Nodes, node: Int64[np.ndarray, "pairs"], panel: Int64[np.ndarray, "pairs"]
) -> Float64[np.ndarray, "pairs"]:
    """Diameter of the ball that touches the surface at a node from inside and just meets a node of a panel [m].

    Infinite where all of the panel's nodes face the way the node does, or a concave edge would
    count as thin.
    """
    normals = nodes.normals[node]
    gap = nodes.points[node, None] - nodes.points.reshape(-1, 6, 3)[panel]
    depth = np.einsum("ejd,ed->ej", gap, normals)
    opposite = np.einsum("ejd,ed->ej", nodes.normals.reshape(-1, 6, 3)[panel], normals) <= 0
    met = np.einsum("ejd,ejd->ej", gap, gap) / np.where(depth > 0, depth, 1)
    return np.where(opposite & (depth > 0), met, np.inf).min(axis=1, initial=np.inf)
