"""A closed mesh of quadratic triangles: how deep points lie under them, and where on them they are nearest."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.geometry.mesh.curving import SHARP_DEGREES, curved
from airtact.geometry.mesh.edge_splitting import with_short_edges
from airtact.geometry.mesh.intersections import self_crossings
from airtact.geometry.mesh.panel_tree import PanelTree, panel_tree
from airtact.geometry.mesh.quadratic_triangles import (
    NODE_PLACES,
    QuadraticTriangles,
    enclosed_volume,
    gauss_square,
    normals_at,
    panel_areas,
    points_at,
    shape_functions,
    unit,
    with_middles,
)
from airtact.geometry.mesh.remeshing import RidgedMesh
from airtact.geometry.mesh.topology import (
    Numbers,
    Triangles,
    Twins,
    Vertices,
    edge_ends,
    edge_twins,
    shells,
)
from airtact.printing import in_short

Points = Real[np.ndarray, "points 3"]

EDGE = 1e-9
"""A closest point with a barycentric coordinate below this lies on the edge."""

RIDGE_CANDIDATES = 8
"""Points of sharp edges, nearest first, from which the nearest one is sought."""

RIDGE_PIECES = 8
"""Pieces of a sharp edge among which the nearest is looked for."""

LEVEL_PLACES, LEVEL_WEIGHTS = gauss_square(4)
LEVEL_SHAPE = shape_functions(LEVEL_PLACES)
LEVEL_FIT = np.linalg.solve(
    (LEVEL_SHAPE.T * LEVEL_WEIGHTS) @ LEVEL_SHAPE, LEVEL_SHAPE.T * LEVEL_WEIGHTS
)
"""(6, 16): from values at the quadrature points to the nearest quadratic, by its values at the nodes."""


@dataclass(frozen=True, eq=False)
class QuadraticMesh:
    """A closed mesh of quadratic triangles, where it was made; curved when first asked.

    Without ``midpoints``, points of the surface over the middles of edges 01, 12, 20 [m], it is
    curved by normals; without ``sharp_edges`` those are found that turn by more than
    ``sharp_degrees``.
    """

    vertices: Vertices
    triangles: Triangles
    midpoints: Float64[np.ndarray, "triangles 3 3"] | None = None
    sharp_degrees: float = SHARP_DEGREES
    sharp_edges: Bool[np.ndarray, "triangles 3"] | None = None

    __repr__ = in_short

    @cached_property
    def _curved(
        self,
    ) -> tuple[Float64[np.ndarray, "triangles 3 3"], Bool[np.ndarray, "triangles 3"]]:
        if self.midpoints is not None and self.sharp_edges is not None:
            return self.midpoints, self.sharp_edges
        middles, sharp = curved(self.vertices, self.triangles, self.sharp_degrees)
        return middles if self.midpoints is None else self.midpoints, sharp

    @cached_property
    def quadratic_triangles(self) -> QuadraticTriangles:
        """Its triangles (T, 6, 3) as panels, neighbours sharing corners and middles [m]."""
        return np.concatenate([self.vertices[self.triangles], self._curved[0]], axis=1)

    @property
    def sharp(self) -> Bool[np.ndarray, "triangles 3"]:
        """Which of the edges 01, 12, 20 are sharp (T, 3)."""
        return self._curved[1]

    @cached_property
    def crossings(self) -> Int64[np.ndarray, "crossings 2"]:
        """Pairs of flat triangles (K, 2) that cross or touch beyond what they share as neighbours."""
        return self_crossings(self.vertices[self.triangles], self.triangles)

    @cached_property
    def tree(self) -> PanelTree:
        """The panels in a tree of boxes."""
        return panel_tree(self.quadratic_triangles)

    @cached_property
    def flat_tree(self) -> PanelTree:
        """The flat triangles under the panels in a tree of boxes."""
        return panel_tree(with_middles(self.quadratic_triangles[:, :3]))

    @cached_property
    def _twins(self) -> Twins:
        return edge_twins(self.triangles)

    @cached_property
    def ridges(self) -> Float64[np.ndarray, "ridges 3 3"]:
        """Start, middle and end of each sharp edge (K, 3, 3) [m], each edge once."""
        triangle, edge = np.nonzero(self.sharp)
        once = 3 * triangle + edge < self._twins[triangle, edge]
        triangle, edge, nodes = triangle[once], edge[once], self.quadratic_triangles
        return np.stack(
            [nodes[triangle, edge], nodes[triangle, 3 + edge], nodes[triangle, (edge + 1) % 3]],
            axis=1,
        )

    @cached_property
    def _vertex_normals(self) -> Vertices:
        """Normals of the panels round each vertex, weighted by their angles there."""
        total, nodes = np.zeros((int(self.triangles.max()) + 1, 3)), self.quadratic_triangles
        for corner in range(3):
            here, following, before = nodes[:, corner], (corner + 1) % 3, (corner + 2) % 3
            out = 4 * nodes[:, 3 + corner] - 3 * here - nodes[:, following]
            back = 4 * nodes[:, 3 + before] - 3 * here - nodes[:, before]
            cosine = np.einsum("td,td->t", unit(out), unit(back))
            angle = np.arccos(np.clip(cosine, -1.0, 1.0))
            np.add.at(
                total,
                self.triangles[:, corner],
                angle[:, None] * unit(normals_at(nodes, NODE_PLACES[corner])),
            )
        return total

    def depth(self, points: Points) -> Float64[np.ndarray, "points"]:
        """Distance to the surface [m] of points (P, 3) [m], positive inside.

        The sign is that of the normal at the closest point; on edges and corners of its
        angle-weighted mean (J. A. Bærentzen, H. Aanæs, IEEE Trans. Vis. Comput. Graph. 11, 243
        (2005)).
        """
        panel, reference, distance = self.tree.closest(points)
        position, normal = points_at(self.quadratic_triangles[panel], reference)
        weights = np.stack([1 - reference.sum(axis=1), reference[:, 0], reference[:, 1]], axis=1)
        gone = weights < EDGE
        on_edge = np.flatnonzero(gone.sum(axis=1) == 1)
        edge = (gone[on_edge].argmax(axis=1) + 1) % 3  # corner c is opposite edge c + 1
        normal[on_edge] = self._edge_normals(panel[on_edge], edge, weights[on_edge])
        on_corner = np.flatnonzero(gone.sum(axis=1) > 1)
        corner = weights[on_corner].argmax(axis=1)
        normal[on_corner] = self._vertex_normals[self.triangles[panel[on_corner], corner]]
        inward = np.einsum("pd,pd->p", position - points, normal)
        return np.copysign(distance, np.where(inward == 0.0, 1.0, inward))

    def _edge_normals(
        self, panel: Numbers, edge: Numbers, weights: Float64[np.ndarray, "n 3"]
    ) -> Points:
        """Sum of the unit normals of the two panels at a point of their edge."""
        rows = np.arange(len(panel))
        total = unit(points_at(self.quadratic_triangles[panel], weights[:, 1:])[1])
        other, across = np.divmod(self._twins[panel, edge], 3)
        mirrored = np.zeros_like(weights)
        mirrored[rows, across] = weights[rows, (edge + 1) % 3]
        mirrored[rows, (across + 1) % 3] = weights[rows, edge]
        return total + unit(points_at(self.quadratic_triangles[other], mirrored[:, 1:])[1])

    def project(self, points: Points) -> Float64[np.ndarray, "points 3"]:
        """Nearest points of the surface (P, 3) [m] to points (P, 3) [m]."""
        panel, reference, _ = self.tree.closest(points)
        return np.einsum("pn,pnd->pd", shape_functions(reference), self.quadratic_triangles[panel])

    def project_on_sharp_edges(self, points: Points) -> Float64[np.ndarray, "points 3"]:
        """Nearest points of the sharp edges (P, 3) [m] to points (P, 3) [m]."""
        steps = np.arange(RIDGE_PIECES + 1) / RIDGE_PIECES
        shape = _along_ridge(steps)[0]
        samples = np.einsum("sn,knd->ksd", shape, self.ridges).reshape(-1, 3)
        nearest = (
            KDTree(samples)
            .query(points, k=min(RIDGE_CANDIDATES, len(samples)))[1]
            .reshape(len(points), -1)
        )
        ridge, step = np.divmod(nearest, len(steps))
        nodes, share = self.ridges[ridge], steps[step]
        for _ in range(6):  # Gauss-Newton from a start that is right to an eighth of the edge
            shape, gradient = _along_ridge(share)
            gap = points[:, None] - np.einsum("pkn,pknd->pkd", shape, nodes)
            along = np.einsum("pkn,pknd->pkd", gradient, nodes)
            share = np.clip(share + (gap * along).sum(axis=2) / (along * along).sum(axis=2), 0, 1)
        found = np.einsum("pkn,pknd->pkd", _along_ridge(share)[0], nodes)
        best = np.linalg.norm(found - points[:, None], axis=2).argmin(axis=1)
        return found[np.arange(len(points)), best]

    @cached_property
    def pieces(self) -> "tuple[QuadraticMesh, ...]":
        """The closed pieces that the mesh falls into, each a mesh of its own."""
        label = shells(self.triangles)
        if label.max() == 0:
            return (self,)
        found = []
        for number in range(label.max() + 1):
            own = label == number
            used, triangles = np.unique(self.triangles[own], return_inverse=True)
            middles, sharp = (part[own] for part in self._curved)
            corners = triangles.reshape(-1, 3)
            found.append(
                QuadraticMesh(self.vertices[used], corners, middles, self.sharp_degrees, sharp)
            )
        return tuple(found)

    def with_short_edges(self, longest: float) -> RidgedMesh:
        """Split its triangles, on the surface, until no edge is longer than ``longest`` [m]."""
        nodes, triangles, sharp = with_short_edges(
            self.quadratic_triangles, self.triangles, self.sharp, longest
        )
        vertices = np.empty((int(triangles.max()) + 1, 3))
        vertices[triangles] = nodes[:, :3]
        ridges = edge_ends(triangles)[sharp]
        return RidgedMesh(vertices, triangles, ridges[ridges[:, 0] < ridges[:, 1]])

    def leaving(self, panels: QuadraticTriangles) -> Float64[np.ndarray, "panels"]:
        """Root mean square distance of panels (P, 6, 3) from the surface [m]."""
        points = np.einsum("qn,tnd->tqd", LEVEL_SHAPE, panels).reshape(-1, 3)
        return np.sqrt(
            self.tree.closest(points)[2].reshape(-1, len(LEVEL_PLACES)) ** 2 @ (2 * LEVEL_WEIGHTS)
        )

    def fitted(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        """Bring panels (P, 6, 3) near the surface to where it lies evenly on both sides of each [m]."""
        return self.levelled(self.project(panels.reshape(-1, 3)).reshape(-1, 6, 3))

    def levelled(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        """Move the nodes of panels (P, 6, 3) along their normals until the surface lies evenly on both sides of each.

        Panels whose nodes stand on a round surface run inside it, and those on a rough one follow
        the roughness at their nodes; the quadratic nearest to the surface in the mean square does
        neither.
        """
        depth = self.depth(np.einsum("qn,tnd->tqd", LEVEL_SHAPE, panels).reshape(-1, 3))
        rise = depth.reshape(-1, len(LEVEL_PLACES)) @ LEVEL_FIT.T
        normals = np.stack([normals_at(panels, node) for node in NODE_PLACES], axis=1)
        return panels + rise[:, :, None] * unit(normals)

    @cached_property
    def area(self) -> float:
        """Area of the surface [m²]."""
        return float(panel_areas(self.quadratic_triangles).sum())

    @cached_property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        return enclosed_volume(self.quadratic_triangles)


def _along_ridge(
    share: Float64[np.ndarray, "*points"],
) -> tuple[Float64[np.ndarray, "*points 3"], Float64[np.ndarray, "*points 3"]]:
    """Quadratics of start, middle and end of an edge at a share of it, and their derivatives."""
    shape = np.stack(
        [(1 - share) * (1 - 2 * share), 4 * share * (1 - share), share * (2 * share - 1)], axis=-1
    )
    return shape, np.stack([4 * share - 3, 4 - 8 * share, 4 * share - 1], axis=-1)
