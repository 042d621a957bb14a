"""The curved skin of a mesh: how deep points lie under it, and where on it they are nearest."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64, Int, Int64, Real
from scipy.spatial import KDTree

from airtact.mesh.panel_tree import PanelTree, panel_tree
from airtact.mesh.quadratic_triangles import (
    NODE_PLACES,
    QuadraticTriangles,
    enclosed_volume,
    gauss_square,
    panel_areas,
    points_at,
    shape_functions,
    with_middles,
)
from airtact.mesh.topology import edge_twins, shells
from airtact.printing import in_short

EDGE = 1e-9
"""A closest point with a barycentric coordinate below this lies on the edge."""

CREASE_CANDIDATES = 8
"""Places on creases, nearest first, from which the nearest one is sought."""

CREASE_PIECES = 8
"""Pieces of a crease edge among which the nearest is looked for."""

LEVEL_PLACES, LEVEL_WEIGHTS = gauss_square(4)
LEVEL_SHAPE = shape_functions(LEVEL_PLACES)
LEVEL_FIT = np.linalg.solve((LEVEL_SHAPE.T * LEVEL_WEIGHTS) @ LEVEL_SHAPE, LEVEL_SHAPE.T * LEVEL_WEIGHTS)
"""(6, 16): from values at the places to the nearest quadratic, by its values at the nodes."""


@dataclass(frozen=True, eq=False)
class CurvedMesh:
    """The skin of a closed mesh of curved panels, where it was made.

    Attributes
    ----------
    vertices : (V, 3) [m].
    quadratic_triangles : (T, 6, 3) the panels, neighbours sharing corners and middles [m].
    triangles : (T, 3) vertex indices, which tell who is whose neighbour.
    sharp : (T, 3) which of the edges 01, 12, 20 are sharp.
    """

    vertices: Float64[np.ndarray, "vertices 3"]
    quadratic_triangles: QuadraticTriangles
    triangles: Int[np.ndarray, "triangles 3"]
    sharp: Bool[np.ndarray, "triangles 3"]

    __repr__ = in_short

    @cached_property
    def tree(self) -> PanelTree:
        """The panels, ready to be searched."""
        return panel_tree(self.quadratic_triangles)

    @cached_property
    def flat_tree(self) -> PanelTree:
        """The flat triangles under the panels, ready to be searched."""
        corners = self.quadratic_triangles[:, :3]
        return panel_tree(with_middles(corners))

    @cached_property
    def _twins(self) -> Int64[np.ndarray, "triangles 3"]:
        return edge_twins(self.triangles)

    @cached_property
    def sharp_once(self) -> tuple[Int64[np.ndarray, "creases"], Int64[np.ndarray, "creases"]]:
        """Triangle and number of each sharp edge, each edge once."""
        triangle, edge = np.nonzero(self.sharp)
        once = 3 * triangle + edge < self._twins[triangle, edge]
        return triangle[once], edge[once]

    @cached_property
    def creases(self) -> Float64[np.ndarray, "creases 3 3"]:
        """Start, middle and end of each sharp edge (K, 3, 3) [m]."""
        (triangle, edge), nodes = self.sharp_once, self.quadratic_triangles
        return np.stack([nodes[triangle, edge], nodes[triangle, 3 + edge], nodes[triangle, (edge + 1) % 3]], axis=1)

    @cached_property
    def _vertex_normals(self) -> Float64[np.ndarray, "vertices 3"]:
        """Normals of the panels round each vertex, weighted by their angles there."""
        total = np.zeros((int(self.triangles.max()) + 1, 3))
        for corner, reference in enumerate(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))):
            _, normal = points_at(
                self.quadratic_triangles, np.broadcast_to(reference, (len(self.quadratic_triangles), 2))
            )
            here, following = self.quadratic_triangles[:, corner], (corner + 1) % 3
            out = 4 * self.quadratic_triangles[:, 3 + corner] - 3 * here - self.quadratic_triangles[:, following]
            back = (
                4 * self.quadratic_triangles[:, 3 + (corner + 2) % 3]
                - 3 * here
                - self.quadratic_triangles[:, (corner + 2) % 3]
            )
            cosine = np.einsum("td,td->t", _unit(out), _unit(back))
            angle = np.arccos(np.clip(cosine, -1.0, 1.0))
            np.add.at(total, self.triangles[:, corner], angle[:, None] * _unit(normal))
        return total

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance to the skin [m] of points (P, 3) [m], positive inside.

        The sign is that of the normal at the closest point; on edges and corners of its angle-weighted mean (J. A.
        Bærentzen, H. Aanæs, IEEE Trans. Vis. Comput. Graph. 11, 243 (2005)).
        """
        panel, foot, distance = self.tree.closest(points)
        place, normal = points_at(self.quadratic_triangles[panel], foot)
        weights = np.stack([1 - foot.sum(axis=1), foot[:, 0], foot[:, 1]], axis=1)
        gone = weights < EDGE
        lying = np.flatnonzero(gone.sum(axis=1) == 1)
        edge = (gone[lying].argmax(axis=1) + 1) % 3  # corner c is opposite edge c + 1
        normal[lying] = self._edge_normals(panel[lying], edge, weights[lying])
        standing = np.flatnonzero(gone.sum(axis=1) > 1)
        normal[standing] = self._vertex_normals[self.triangles[panel[standing], weights[standing].argmax(axis=1)]]
        inward = np.einsum("pd,pd->p", place - points, normal)
        return np.copysign(distance, np.where(inward == 0.0, 1.0, inward))

    def _edge_normals(
        self,
        panel: Int64[np.ndarray, "points"],
        edge: Int64[np.ndarray, "points"],
        weights: Float64[np.ndarray, "points 3"],
    ) -> Float64[np.ndarray, "points 3"]:
        """Sum of the unit normals of the two panels at a point of their edge."""
        rows = np.arange(len(panel))
        total = _unit(points_at(self.quadratic_triangles[panel], weights[:, 1:])[1])
        other, across = np.divmod(self._twins[panel, edge], 3)
        mirrored = np.zeros_like(weights)
        mirrored[rows, across] = weights[rows, (edge + 1) % 3]
        mirrored[rows, (across + 1) % 3] = weights[rows, edge]
        return total + _unit(points_at(self.quadratic_triangles[other], mirrored[:, 1:])[1])

    def project(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Nearest points of the skin (P, 3) [m] to points (P, 3) [m]."""
        panel, foot, _ = self.tree.closest(points)
        return np.einsum("pn,pnd->pd", shape_functions(foot), self.quadratic_triangles[panel])

    def project_on_sharp_edges(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Nearest points of the sharp edges (P, 3) [m] to points (P, 3) [m]."""
        steps = np.arange(CREASE_PIECES + 1) / CREASE_PIECES
        shape = _along_crease(steps)[0]
        samples = np.einsum("sn,knd->ksd", shape, self.creases).reshape(-1, 3)
        nearest = KDTree(samples).query(points, k=min(CREASE_CANDIDATES, len(samples)))[1].reshape(len(points), -1)
        crease, step = np.divmod(nearest, len(steps))
        nodes, share = self.creases[crease], steps[step]
        for _ in range(6):  # Gauss-Newton from a place that is right to an eighth of the edge
            shape, slope = _along_crease(share)
            gap = points[:, None] - np.einsum("pkn,pknd->pkd", shape, nodes)
            along = np.einsum("pkn,pknd->pkd", slope, nodes)
            share = np.clip(share + (gap * along).sum(axis=2) / (along * along).sum(axis=2), 0, 1)
        found = np.einsum("pkn,pknd->pkd", _along_crease(share)[0], nodes)
        best = np.linalg.norm(found - points[:, None], axis=2).argmin(axis=1)
        return found[np.arange(len(points)), best]

    @cached_property
    def pieces(self) -> "tuple[CurvedMesh, ...]":
        """The closed pieces that the mesh falls into, each a mesh of its own."""
        label = shells(self.triangles)
        if label.max() == 0:
            return (self,)
        pieces = []
        for number in range(label.max() + 1):
            own = label == number
            used, triangles = np.unique(self.triangles[own], return_inverse=True)
            nodes, sharp = self.quadratic_triangles[own], self.sharp[own]
            pieces.append(CurvedMesh(self.vertices[used], nodes, triangles.reshape(-1, 3), sharp))
        return tuple(pieces)

    def leaving(self, panels: QuadraticTriangles) -> Float64[np.ndarray, "panels"]:
        """Root mean square distance of panels (P, 6, 3) from the skin [m]."""
        points = np.einsum("qn,tnd->tqd", LEVEL_SHAPE, panels).reshape(-1, 3)
        return np.sqrt(self.tree.closest(points)[2].reshape(-1, len(LEVEL_PLACES)) ** 2 @ (2 * LEVEL_WEIGHTS))

    def fitted(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        """Bring panels (P, 6, 3) near the skin to where it lies evenly on both sides of each [m]."""
        return self.levelled(self.project(panels.reshape(-1, 3)).reshape(-1, 6, 3))

    def levelled(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        """Move the nodes of panels (P, 6, 3) along their normals until the skin lies evenly on both sides of each.

        Panels whose nodes stand on a round skin run inside it, and those on a rough one follow the roughness at their
        nodes; the quadratic nearest to the skin in the mean square does neither.
        """
        depth = self.depth(np.einsum("qn,tnd->tqd", LEVEL_SHAPE, panels).reshape(-1, 3))
        rise = depth.reshape(-1, len(LEVEL_PLACES)) @ LEVEL_FIT.T
        normals = np.stack(
            [points_at(panels, np.broadcast_to(node, (len(panels), 2)))[1] for node in NODE_PLACES], axis=1
        )
        return panels + rise[:, :, None] * _unit(normals)

    @cached_property
    def area(self) -> float:
        """Area of the skin [m²]."""
        return float(panel_areas(self.quadratic_triangles).sum())

    @cached_property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        return enclosed_volume(self.quadratic_triangles)


def _along_crease(
    share: Float64[np.ndarray, "*places"],
) -> tuple[Float64[np.ndarray, "*places 3"], Float64[np.ndarray, "*places 3"]]:
    """Quadratics of start, middle and end of an edge at a share of it, and their slopes."""
    shape = np.stack([(1 - share) * (1 - 2 * share), 4 * share * (1 - share), share * (2 * share - 1)], axis=-1)
    return shape, np.stack([4 * share - 3, 4 - 8 * share, 4 * share - 1], axis=-1)


def _unit(vectors: Float64[np.ndarray, "*axes 3"]) -> Float64[np.ndarray, "*axes 3"]:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
