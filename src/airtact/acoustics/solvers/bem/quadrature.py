"""Nodes, weights and near integrals on curved quadratic (six-node) panels.

Each panel has the six nodes of a rule of degree 4, all inside it. The pressure on it is the
quadratic through the nodes. This is a Nyström method, which needs no continuity between panels.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Float64, Int64

from airtact import _kernels
from airtact.acoustics.solvers.shared import (
    Admittances,
    NearLists,
    NodePoints,
    PanelLengths,
    Points,
    SingleLayer,
)
from airtact.geometry.mesh.triangles import (
    QuadraticTriangles,
    points_at,
    shape_functions,
    shape_gradients,
)


def _degree_four_rule() -> tuple[Float64[np.ndarray, "6 2"], Float64[np.ndarray, "6"]]:
    """Return the six-point rule of degree 4 on the unit triangle (Strang & Fix 1973; Cowper 1973).

    The first three points lie near corner 1, the others near the opposite edge.
    """
    root = np.sqrt(38 - 44 * np.sqrt(2 / 5))
    spread = np.sqrt(213125 - 53320 * np.sqrt(10))
    points = []
    weights = []
    for sign in (1, -1):
        a = (8 - np.sqrt(10) + sign * root) / 18
        points += [[a, a], [1 - 2 * a, a], [a, 1 - 2 * a]]
        weights += [(620 + sign * spread) / 7440] * 3
    neighbours = [4, 2, 0, 3, 5, 1]
    return np.array(points)[neighbours], np.array(weights)[neighbours]


# Largest distance from the true surface at which a point touches a panel [contact lengths]. The
# panel deviates from the surface by less than 2/3 of its contact length.
CONTACT_REACH = 2.0

RULE_POINTS, RULE_WEIGHTS = _degree_four_rule()

# (19, 6) shape functions and their u and v derivatives at the six nodes, and the functions at the
# centre.
RULE = np.concatenate(
    [
        shape_functions(RULE_POINTS),
        *shape_gradients(RULE_POINTS),
        shape_functions(np.full((1, 2), 1 / 3)),
    ]
)

_U, _V = RULE_POINTS.T

# (6, 6) coefficients of 1, u, v, u², uv, v² (the order of the compiled near integrals). Column j
# is the quadratic that is 1 at node j and 0 at the other nodes.
NODAL = np.linalg.inv(np.stack([np.ones(6), _U, _V, _U * _U, _U * _V, _V * _V], axis=1))


@dataclass(frozen=True, eq=False)
class Nodes:
    """Quadrature nodes of a set of panels, where node 6 t + j is node j of panel t.

    Attributes
    ----------
    points, normals : positions of the nodes [m], and outward unit normals.
    weights : area that each node represents [m²].
    body : index of each node's obstacle.
    quadratic_triangles : corners and edge midpoints of the panels [m].
    contact : distance below which a point is considered to touch a panel [m].
    centres, radii : centre of each panel, and the distance of its farthest corner or midpoint [m].
    admittance : ρc/Z of each panel; 0 for sound-hard panels.
    """

    points: NodePoints
    normals: NodePoints
    weights: Float64[np.ndarray, "nodes"]
    body: Int64[np.ndarray, "nodes"]
    quadratic_triangles: QuadraticTriangles
    contact: PanelLengths
    centres: Float64[np.ndarray, "panels 3"]
    radii: PanelLengths
    admittance: Admittances

    @cached_property
    def weighted_normals(self) -> NodePoints:
        """Normals times area [m²]."""
        return self.normals * self.weights[:, None]

    @property
    def panel_normals(self) -> Float64[np.ndarray, "panels 3"]:
        """Mean of the six unit normals of each panel."""
        return self.normals.reshape(-1, 6, 3).mean(axis=1)

    @property
    def panels(self) -> _kernels.Panels:
        """The panels in the form that the compiled integrals over near panels require."""
        return _kernels.Panels(self.quadratic_triangles, self.contact)

    def single_layer(self, wavenumber: complex) -> SingleLayer:
        """Area times ikρc/Z [m] at each node, or an empty array if all panels are sound-hard.

        ikρc/Z is the ratio of −∂p/∂n to p on an impedance surface.
        """
        if not self.admittance.any():
            return np.empty(0, dtype=np.complex128)
        return 1j * wavenumber * np.repeat(self.admittance, 6) * self.weights

    def layer(self, wavenumber: complex) -> _kernels.Layer:
        """Double layer of the pressure plus single layer of −∂p/∂n, as input for compiled sums."""
        single = self.single_layer(wavenumber)
        return _kernels.Layer(self.points, self.weighted_normals, single, complex(wavenumber))


def place_nodes(
    quadratic_triangles: QuadraticTriangles,
    body: Int64[np.ndarray, "panels"],
    deviation: PanelLengths,
    admittance: Admittances | None = None,
) -> Nodes:
    """Place the six nodes of the degree-4 rule on every panel.

    Parameters
    ----------
    quadratic_triangles : corners and edge midpoints of the panels [m].
    body : index of each panel's obstacle.
    deviation : distance of each panel from the true surface [m].
    admittance : ρc/Z of each panel; by default all panels are sound-hard.
    """
    panels = np.ascontiguousarray(quadratic_triangles)
    count = len(panels)
    points, normals, weights, centres, radii = _kernels.place_nodes(panels, RULE, RULE_WEIGHTS)
    return Nodes(
        points=points,
        normals=normals,
        weights=weights,
        body=np.repeat(body, 6),
        quadratic_triangles=panels,
        # A thousandth of the radius, or more if the panel deviates from the true surface.
        contact=np.maximum(1e-3 * radii, 1.5 * deviation),
        centres=centres,
        radii=radii,
        admittance=np.zeros(count, dtype=np.complex128) if admittance is None else admittance,
    )


@cache
def near_quadrature(angular: int, radial: int) -> _kernels.NearQuadrature:
    """Return the Gauss-Legendre rules on [0, 1] for integrals over panels near a point."""
    return _kernels.NearQuadrature(*_gauss_rules(40), 40, angular, radial)


@cache
def _gauss_rules(largest: int) -> tuple[Float64[np.ndarray, "_"], Float64[np.ndarray, "_"]]:
    # Concatenate the nodes and the weights of the rules with 1 to ``largest`` points.
    rules = [np.polynomial.legendre.leggauss(n) for n in range(1, largest + 1)]
    nodes = np.concatenate([0.5 * (x + 1) for x, _ in rules])
    return nodes, np.concatenate([0.5 * w for _, w in rules])


def near_lists(nodes: Nodes, points: Points, limits: PanelLengths) -> NearLists:
    """For each point, list the panels whose centres are closer than their ``limits`` [m].

    The panels of point i are ``panel[first[i] : first[i + 1]]``.
    """
    first, panel = _kernels.near_pairs(points, nodes.centres, limits)
    return first.view(np.int64), panel.view(np.int64)  # NumPy has two names for this type


def thickness(
    nodes: Nodes, largest: float, lower_bound: Float64[np.ndarray, "nodes"] | None = None
) -> Float64[np.ndarray, "nodes"]:
    """Return the diameter [m] of the largest inner ball that touches each node of the surface.

    Larger diameters are returned as ``largest``, without any computation if ``lower_bound`` already
    reaches this value.

    At each node, a ball of diameter ``largest`` shrinks until it contains no other node. It then
    shrinks until no panel enters it between nodes (J. Ma, S. W. Bae, S. Choi, The Visual Computer
    28, 7 (2012)).
    """
    diameter = np.full(len(nodes.points), float(largest))
    unknown = (
        np.arange(len(nodes.points))
        if lower_bound is None
        else np.flatnonzero(lower_bound < largest)
    )
    if not len(unknown):
        return diameter
    from airtact.geometry.mesh.triangles import panel_tree

    # Pairs of a node and a panel of the same body that may limit the node's largest ball.
    centres = nodes.points - 0.5 * largest * nodes.normals
    first, panel = near_lists(nodes, centres[unknown], 0.5 * largest + nodes.radii)
    node = np.repeat(unknown, np.diff(first))
    # If the cosine between the normals is below 0.5, parts of the panel may face away.
    apart = np.einsum("ed,ed->e", nodes.panel_normals[panel], nodes.normals[node]) < 0.5
    apart &= nodes.body[6 * panel] == nodes.body[node]
    node = node[apart]
    panel = panel[apart]
    by_panel = nodes.points.reshape(-1, 6, 3)
    offset = by_panel[panel] - centres[node, None]
    # Each point of a panel has a node within 0.45 radii: 0.38 on a hand's panels, 0.33 on flat
    # ones.
    limit = 0.5 * largest + 0.45 * nodes.radii[panel]
    reached = np.einsum("ejd,ejd->ej", offset, offset).min(axis=1) < limit**2
    node = node[reached]
    panel = panel[reached]

    # The ball touches the node from inside and a node of the panel. A panel that faces the same way
    # belongs to a concave edge, which is not thin.
    gap = nodes.points[node, None] - by_panel[panel]
    depth = np.einsum("ejd,ed->ej", gap, nodes.normals[node])
    normals = nodes.normals.reshape(-1, 6, 3)[panel]
    opposite = np.einsum("ejd,ed->ej", normals, nodes.normals[node]) <= 0
    met = np.einsum("ejd,ejd->ej", gap, gap) / np.where(depth > 0, depth, 1)
    met = np.where(opposite & (depth > 0), met, np.inf).min(axis=1, initial=np.inf)
    np.minimum.at(diameter, node, met)
    node = np.unique(node)
    tree = panel_tree(nodes.quadratic_triangles)
    for _ in range(4):  # each iteration leaves at most a quarter of the ball's excess radius
        normals = nodes.normals[node]
        centres = nodes.points[node] - 0.5 * diameter[node, None] * normals
        panel, reference, distance = tree.closest(centres, 0.49 * diameter[node])
        touched, facing = points_at(nodes.quadratic_triangles[panel], reference)
        gap = nodes.points[node] - touched
        depth = np.einsum("nd,nd->n", gap, normals)
        opposite = np.einsum("nd,nd->n", facing, normals) <= 0
        inside = np.isfinite(distance) & opposite & (depth > 0)
        node = node[inside]
        meeting = np.einsum("nd,nd->n", gap, gap)[inside] / depth[inside]
        diameter[node] = np.minimum(diameter[node], meeting)
    return diameter
