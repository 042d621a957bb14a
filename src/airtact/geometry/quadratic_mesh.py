"""A closed mesh of quadratic triangles: depth and projection of points, and fitted panels."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from airtact.errors import in_short
from airtact.geometry.mesh.arrays import (
    EdgeMask,
    EdgeVectors,
    IndexPairs,
    Indices,
    PointLengths,
    Points,
    PointVectors,
    QuadraticTriangles,
    Triangles,
    Twins,
    Vertices,
)
from airtact.geometry.mesh.curving import curved
from airtact.geometry.mesh.intersections import self_crossings
from airtact.geometry.mesh.panel_tree import PanelTree, panel_tree
from airtact.geometry.mesh.quadratic_triangles import (
    NODE_REFERENCES,
    enclosed_volume,
    gauss_square,
    normals_at,
    panel_areas,
    points_at,
    shape_functions,
    unit,
    with_middles,
)
from airtact.geometry.mesh.remeshing import RidgedMesh, with_short_edges
from airtact.geometry.mesh.topology import SHARP_DEGREES, edge_twins, shells

_RULE_POINTS, _RULE_WEIGHTS = gauss_square(4)
_RULE_SHAPE = shape_functions(_RULE_POINTS)
_WEIGHTED_SHAPE = _RULE_SHAPE.T * _RULE_WEIGHTS
# (6, 16) matrix from values at the quadrature points to the nodes of the nearest quadratic.
_RULE_FIT = np.linalg.solve(_WEIGHTED_SHAPE @ _RULE_SHAPE, _WEIGHTED_SHAPE)


@dataclass(frozen=True, eq=False)
class QuadraticMesh:
    """A closed mesh of quadratic triangles before any motion; it is curved on first use.

    ``midpoints`` are points of the surface at the middles of edges 01, 12, 20 [m]; by default the
    mesh is curved by its normals. By default ``sharp_edges`` are the edges that bend by more than
    ``sharp_degrees``.
    """

    vertices: Vertices
    triangles: Triangles
    midpoints: EdgeVectors | None = None
    sharp_degrees: float = SHARP_DEGREES
    sharp_edges: EdgeMask | None = None

    __repr__ = in_short

    @cached_property
    def _curved(self) -> tuple[EdgeVectors, EdgeMask]:
        if self.midpoints is not None and self.sharp_edges is not None:
            return self.midpoints, self.sharp_edges
        middles, sharp = curved(self.vertices, self.triangles, self.sharp_degrees)
        return middles if self.midpoints is None else self.midpoints, sharp

    @cached_property
    def quadratic_triangles(self) -> QuadraticTriangles:
        """The triangles as curved panels (T, 6, 3) [m]; neighbours share corners and midpoints."""
        return np.concatenate([self.vertices[self.triangles], self._curved[0]], axis=1)

    @property
    def sharp(self) -> EdgeMask:
        """(T, 3) whether each of the edges 01, 12, 20 is sharp."""
        return self._curved[1]

    @cached_property
    def crossings(self) -> IndexPairs:
        """(K, 2) pairs of flat triangles that cross or touch beyond their shared corners."""
        return self_crossings(self.vertices[self.triangles], self.triangles)

    @cached_property
    def tree(self) -> PanelTree:
        """A tree of boxes around the panels."""
        return panel_tree(self.quadratic_triangles)

    @cached_property
    def flat_tree(self) -> PanelTree:
        """A tree of boxes around the flat triangles between the corners of the panels."""
        return panel_tree(with_middles(self.quadratic_triangles[:, :3]))

    @cached_property
    def _twins(self) -> Twins:
        return edge_twins(self.triangles)

    @cached_property
    def ridges(self) -> Float64[np.ndarray, "ridges 3 3"]:
        """(K, 3, 3) start, middle and end of each sharp edge, listed once [m]."""
        triangle, edge = np.nonzero(self.sharp)
        once = 3 * triangle + edge < self._twins[triangle, edge]
        triangle = triangle[once]
        edge = edge[once]
        nodes = self.quadratic_triangles
        return np.stack(
            [nodes[triangle, edge], nodes[triangle, 3 + edge], nodes[triangle, (edge + 1) % 3]],
            axis=1,
        )

    @cached_property
    def _vertex_normals(self) -> Vertices:
        """Sum of the normals of the panels around each vertex, weighted by their corner angles."""
        nodes = self.quadratic_triangles
        total = np.zeros((int(self.triangles.max()) + 1, 3))
        for corner in range(3):
            # These are the tangents of the two curved edges at the corner.
            following = (corner + 1) % 3
            before = (corner + 2) % 3
            out = 4 * nodes[:, 3 + corner] - 3 * nodes[:, corner] - nodes[:, following]
            back = 4 * nodes[:, 3 + before] - 3 * nodes[:, corner] - nodes[:, before]
            cosine = np.einsum("td,td->t", unit(out), unit(back))
            angle = np.arccos(np.clip(cosine, -1.0, 1.0))
            normal = unit(normals_at(nodes, NODE_REFERENCES[corner]))
            np.add.at(total, self.triangles[:, corner], angle[:, None] * normal)
        return total

    def depth(self, points: Points) -> PointLengths:
        """Return the distance [m] of points (P, 3) from the surface; positive inside.

        The sign follows from the normal at the closest point. On edges and corners, it follows from
        the angle-weighted mean normal (J. A. Bærentzen, H. Aanæs, IEEE Trans. Vis. Comput. Graph.
        11, 243 (2005)).
        """
        panel, reference, distance = self.tree.closest(points)
        position, normal = points_at(self.quadratic_triangles[panel], reference)
        weights = np.stack([1 - reference.sum(axis=1), reference[:, 0], reference[:, 1]], axis=1)
        zero = weights < 1e-9
        on_edge = np.flatnonzero(zero.sum(axis=1) == 1)
        edge = (zero[on_edge].argmax(axis=1) + 1) % 3  # corner c is opposite edge c + 1
        normal[on_edge] = self._edge_normals(panel[on_edge], edge, weights[on_edge])
        on_corner = np.flatnonzero(zero.sum(axis=1) > 1)
        corner = weights[on_corner].argmax(axis=1)
        normal[on_corner] = self._vertex_normals[self.triangles[panel[on_corner], corner]]
        inward = np.einsum("pd,pd->p", position - points, normal)
        return np.copysign(distance, np.where(inward == 0.0, 1.0, inward))

    def _edge_normals(
        self, panel: Indices, edge: Indices, weights: Float64[np.ndarray, "n 3"]
    ) -> Float64[np.ndarray, "n 3"]:
        rows = np.arange(len(panel))
        normal = unit(points_at(self.quadratic_triangles[panel], weights[:, 1:])[1])
        neighbour, across = np.divmod(self._twins[panel, edge], 3)
        mirrored = np.zeros_like(weights)
        mirrored[rows, across] = weights[rows, (edge + 1) % 3]
        mirrored[rows, (across + 1) % 3] = weights[rows, edge]
        return normal + unit(points_at(self.quadratic_triangles[neighbour], mirrored[:, 1:])[1])

    def project(self, points: Points) -> PointVectors:
        """Return the points of the surface [m] that are nearest to points (P, 3)."""
        panel, reference, _ = self.tree.closest(points)
        return np.einsum("pn,pnd->pd", shape_functions(reference), self.quadratic_triangles[panel])

    def project_on_sharp_edges(self, points: Points) -> PointVectors:
        """Return the points of the sharp edges [m] that are nearest to points (P, 3)."""
        steps = np.arange(9) / 8
        shape, _ = _along_ridge(steps)
        samples = np.einsum("sn,knd->ksd", shape, self.ridges).reshape(-1, 3)
        # The nearest eight samples may lie on different edges, and each is refined.
        nearest = KDTree(samples).query(points, k=min(8, len(samples)))[1].reshape(len(points), -1)
        ridge, step = np.divmod(nearest, len(steps))
        nodes = self.ridges[ridge]
        share = steps[step]
        for _ in range(6):  # Gauss-Newton steps from a start within an eighth of the edge
            shape, gradient = _along_ridge(share)
            gap = points[:, None] - np.einsum("pkn,pknd->pkd", shape, nodes)
            along = np.einsum("pkn,pknd->pkd", gradient, nodes)
            share = np.clip(share + (gap * along).sum(axis=2) / (along * along).sum(axis=2), 0, 1)
        candidates = np.einsum("pkn,pknd->pkd", _along_ridge(share)[0], nodes)
        best = np.linalg.norm(candidates - points[:, None], axis=2).argmin(axis=1)
        return candidates[np.arange(len(points)), best]

    @cached_property
    def pieces(self) -> "tuple[QuadraticMesh, ...]":
        """Return the closed pieces of the mesh as separate meshes."""
        label = shells(self.triangles)
        if label.max() == 0:
            return (self,)
        pieces = []
        for number in range(label.max() + 1):
            chosen = label == number
            used, triangles = np.unique(self.triangles[chosen], return_inverse=True)
            middles, sharp = (part[chosen] for part in self._curved)
            pieces.append(
                QuadraticMesh(
                    self.vertices[used],
                    triangles.reshape(-1, 3),
                    middles,
                    self.sharp_degrees,
                    sharp,
                )
            )
        return tuple(pieces)

    def with_short_edges(self, longest: float) -> RidgedMesh:
        """Split the triangles along the surface until no edge exceeds ``longest`` [m]."""
        return with_short_edges(self.quadratic_triangles, self.triangles, self.sharp, longest)

    def deviation(self, panels: QuadraticTriangles) -> Float64[np.ndarray, "panels"]:
        """Return the root mean square distance (P,) of panels (P, 6, 3) from the surface [m]."""
        points = np.einsum("qn,tnd->tqd", _RULE_SHAPE, panels).reshape(-1, 3)
        distance = self.tree.closest(points)[2].reshape(-1, len(_RULE_POINTS))
        return np.sqrt(distance**2 @ (2 * _RULE_WEIGHTS))

    def fitted(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        """Fit panels (P, 6, 3) [m] to the surface by least squares."""
        return self.levelled(self.project(panels.reshape(-1, 3)).reshape(-1, 6, 3))[0]

    def levelled(
        self, panels: QuadraticTriangles
    ) -> tuple[QuadraticTriangles, Float64[np.ndarray, "panels"]]:
        """Move nodes of panels (P, 6, 3) along normals to minimise the mean square distance.

        The second result is an estimate of the root mean square distance (P,) that remains [m],
        which mostly agrees with ``deviation`` within 10 %.

        A panel whose nodes are all on the surface lies inside a round surface, and follows the
        roughness of a scan at its nodes. A least-squares fit avoids both.
        """
        points = np.einsum("qn,tnd->tqd", _RULE_SHAPE, panels).reshape(-1, 3)
        depth = self.depth(points).reshape(-1, len(_RULE_POINTS))
        rise = depth @ _RULE_FIT.T
        remaining = np.sqrt((depth - rise @ _RULE_SHAPE.T) ** 2 @ (2 * _RULE_WEIGHTS))
        normals = np.stack([normals_at(panels, node) for node in NODE_REFERENCES], axis=1)
        return panels + rise[:, :, None] * unit(normals), remaining

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
    shape = np.stack(
        [(1 - share) * (1 - 2 * share), 4 * share * (1 - share), share * (2 * share - 1)], axis=-1
    )
    return shape, np.stack([4 * share - 3, 4 - 8 * share, 4 * share - 1], axis=-1)
