"""Closest points between points, segments and triangles, and the signed distance to a closed mesh.

Sources
-------
- C. Ericson, *Real-Time Collision Detection*, Morgan Kaufmann (2005), sections 5.1.5 (triangle) and 5.1.9
  (two segments).
- J. A. Bærentzen, H. Aanæs, "Signed distance computation using the angle weighted pseudonormal", IEEE
  Trans. Vis. Comput. Graph. 11, 243 (2005).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int, Int64, Real
from scipy.spatial import KDTree

from airtact.mesh.topology import edge_twins

_CHUNK = 4096  # points per pass, which bounds the memory of the candidate lists


def closest_on_segments(
    points: Real[np.ndarray, "n 3"], starts: Real[np.ndarray, "n 3"], ends: Real[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n"]:
    """Where on its segment each point is nearest: 0 at the start, 1 at the end.

    Parameters
    ----------
    points, starts, ends : (N, 3) [m], one segment per point; a segment of no length answers 0.
    """
    along = ends - starts
    length = np.einsum("ni,ni->n", along, along)
    share = np.einsum("ni,ni->n", points - starts, along)
    return np.clip(np.divide(share, length, out=np.zeros(len(share)), where=length > 0.0), 0.0, 1.0)


def segment_distances(
    first: Real[np.ndarray, "n 2 3"], second: Real[np.ndarray, "n 2 3"]
) -> tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Distance of segments, pair by pair (Ericson, section 5.1.9).

    Parameters
    ----------
    first, second : (N, 2, 3) start and end of each segment [m].

    Returns
    -------
    (N,) distances [m] and the (N, 3) nearest points on the first and on the second segment.
    """
    p, q = first[:, 0], second[:, 0]
    u, v, w = first[:, 1] - p, second[:, 1] - q, p - q
    a, b, c = (np.einsum("ni,ni->n", x, y) for x, y in ((u, u), (u, v), (v, v)))
    d = np.einsum("ni,ni->n", u, w)
    e = np.einsum("ni,ni->n", v, w)
    determinant = a * c - b * b
    skew = determinant > 1e-14 * a * c
    s = np.clip(np.divide(b * e - c * d, determinant, out=np.zeros(len(a)), where=skew), 0.0, 1.0)
    t = np.clip(np.divide(b * s + e, c, out=np.zeros(len(a)), where=c > 0.0), 0.0, 1.0)
    s = np.clip(np.divide(b * t - d, a, out=np.zeros(len(a)), where=a > 0.0), 0.0, 1.0)
    here, there = p + s[:, None] * u, q + t[:, None] * v
    return np.linalg.norm(here - there, axis=1), here, there


def closest_on_triangles(
    points: Real[np.ndarray, "n 3"], corners: Real[np.ndarray, "n 3 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Barycentric weights of the point of each triangle that is nearest to its point (Ericson, section 5.1.5).

    Parameters
    ----------
    points : (N, 3) [m], one per triangle.
    corners : (N, 3, 3) [m].

    Returns
    -------
    (N, 3) weights of the three corners; exactly zero for corners that do not take part, so that one zero means an edge
    and two mean a corner.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    weights = _projection_weights(points, corners)
    outside = np.flatnonzero((weights <= 0.0).any(axis=1))
    if len(outside) == 0:
        return weights
    nearest = np.full(len(outside), np.inf)
    here = points[outside]
    for start, (one, two) in enumerate(((a, b), (b, c), (c, a))):
        one, two = one[outside], two[outside]
        t = closest_on_segments(here, one, two)
        gap = here - one - t[:, None] * (two - one)
        distance = np.einsum("ni,ni->n", gap, gap)
        better = distance < nearest
        nearest[better] = distance[better]
        candidate = np.zeros((len(outside), 3))
        candidate[:, start], candidate[:, (start + 1) % 3] = 1.0 - t, t
        weights[outside[better]] = candidate[better]
    return weights


def _projection_weights(
    points: Real[np.ndarray, "n 3"], corners: Real[np.ndarray, "n 3 3"]
) -> Float64[np.ndarray, "n 3"]:
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    w = points - corners[:, 0]
    normal = np.cross(u, v)
    square = np.einsum("ni,ni->n", normal, normal)
    weights = np.empty((len(points), 3))
    weights[:, 1] = np.einsum("ni,ni->n", np.cross(w, v), normal) / square
    weights[:, 2] = np.einsum("ni,ni->n", np.cross(u, w), normal) / square
    weights[:, 0] = 1.0 - weights[:, 1] - weights[:, 2]
    return weights


@dataclass(frozen=True, eq=False)
class SignedDistance:
    """A closed mesh made ready to be asked how deep points lie.

    Attributes
    ----------
    corners : (T, 3, 3) [m].
    triangles : (T, 3) vertex indices.
    edge_normals : (T, 3, 3) sum of the two normals at edges 01, 12, 20.
    vertex_normals : (V, 3) normals of the triangles round each vertex, weighted by their angles there.
    groups : triangles of like size, as ``size_groups`` gives them.
    """

    corners: Float64[np.ndarray, "triangles 3 3"]
    triangles: Int[np.ndarray, "triangles 3"]
    edge_normals: Float64[np.ndarray, "triangles 3 3"]
    vertex_normals: Float64[np.ndarray, "vertices 3"]
    groups: tuple[tuple[Int64[np.ndarray, "_"], KDTree, float], ...]

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance to the skin [m] of points (P, 3) [m], positive inside."""
        depth = np.empty(len(points))
        for start in range(0, len(points), _CHUNK):
            depth[start : start + _CHUNK] = self._depth(np.asarray(points[start : start + _CHUNK], dtype=np.float64))
        return depth

    def _depth(self, points: Float64[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        bound = np.full(len(points), np.inf)
        for members, tree, _ in self.groups:
            near = members[tree.query(points)[1]]
            bound = np.minimum(bound, self._gaps(points, near)[0])
        rows, columns = self._candidates(points, bound)
        distance, gap, weights = self._gaps(points[rows], columns)
        order = np.lexsort((distance, rows))
        first = order[np.r_[True, rows[order][1:] != rows[order][:-1]]]
        inward = -np.einsum("ni,ni->n", gap[first], self._normals(columns[first], weights[first]))
        return np.copysign(distance[first], np.where(inward == 0.0, 1.0, inward))

    def _candidates(
        self, points: Float64[np.ndarray, "points 3"], bound: Float64[np.ndarray, "points"]
    ) -> tuple[Int64[np.ndarray, "pairs"], Int64[np.ndarray, "pairs"]]:
        """Pairs of point and triangle that may be nearer than the bound."""
        rows, columns = [], []
        for members, tree, reach in self.groups:
            lists = tree.query_ball_point(points, bound + reach + 1e-12)
            counts = np.fromiter(map(len, lists), dtype=np.int64, count=len(points))
            rows.append(np.repeat(np.arange(len(points)), counts))
            columns.append(members[np.concatenate(lists).astype(np.int64)])
        return np.concatenate(rows), np.concatenate(columns)

    def _gaps(
        self, points: Float64[np.ndarray, "n 3"], chosen: Int64[np.ndarray, "n"]
    ) -> tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
        """Distance to one triangle per point, the way there from the skin, and where on the triangle it starts."""
        corners = self.corners[chosen]
        weights = closest_on_triangles(points, corners)
        gap = points - np.einsum("nk,nki->ni", weights, corners)
        return np.linalg.norm(gap, axis=1), gap, weights

    def _normals(
        self, chosen: Int64[np.ndarray, "n"], weights: Float64[np.ndarray, "n 3"]
    ) -> Float64[np.ndarray, "n 3"]:
        """Angle-weighted pseudonormal of the face, edge or vertex that the weights stand for."""
        corners = self.corners[chosen]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        zeros = weights == 0.0
        on_edge = np.flatnonzero(zeros.sum(axis=1) == 1)
        normals[on_edge] = self.edge_normals[chosen[on_edge], (zeros[on_edge].argmax(axis=1) + 1) % 3]
        on_vertex = np.flatnonzero(zeros.sum(axis=1) == 2)
        vertex = self.triangles[chosen[on_vertex], weights[on_vertex].argmax(axis=1)]
        normals[on_vertex] = self.vertex_normals[vertex]
        return normals


def signed_distance(
    vertices: Real[np.ndarray, "vertices 3"], triangles: Int[np.ndarray, "triangles 3"]
) -> SignedDistance:
    """Prepare a closed, outward mesh for ``SignedDistance.depth``.

    Parameters
    ----------
    vertices : (V, 3) [m].
    triangles : (T, 3) vertex indices.
    """
    corners = np.asarray(vertices, dtype=np.float64)[triangles]
    edges = np.roll(corners, -1, axis=1) - corners
    normals = np.cross(edges[:, 0], edges[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    directions = edges / np.linalg.norm(edges, axis=2, keepdims=True)
    cosine = -np.einsum("tki,tki->tk", directions, np.roll(directions, 1, axis=1))
    angles = np.arccos(np.clip(cosine, -1.0, 1.0))
    vertex_normals = np.zeros((len(vertices), 3))
    np.add.at(vertex_normals, triangles, angles[:, :, None] * normals[:, None, :])
    return SignedDistance(
        corners=corners,
        triangles=triangles,
        edge_normals=normals[:, None, :] + normals[edge_twins(triangles) // 3],
        vertex_normals=vertex_normals,
        groups=size_groups(corners),
    )


def size_groups(
    corners: Real[np.ndarray, "triangles 3 3"],
) -> tuple[tuple[Int64[np.ndarray, "_"], KDTree, float], ...]:
    """Sort triangles by size, a factor of two in each group, so that one large one does not widen every search.

    Parameters
    ----------
    corners : (T, 3, 3) [m].

    Returns
    -------
    For each group the triangles in it, the tree of their centres and the largest distance of a corner from its centre.
    """
    centres = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centres[:, None, :], axis=2).max(axis=1)
    size = np.floor(np.log2(reach)).astype(np.int64)
    groups = (np.flatnonzero(size == level) for level in np.unique(size))
    return tuple((members, KDTree(centres[members]), float(reach[members].max())) for members in groups)
