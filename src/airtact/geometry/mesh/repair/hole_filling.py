"""Triangles over the rim of a hole, on plain arrays.

All triangulations of the rim are weighed by dynamic programming, after G. Barequet and M. Sharir,
"Filling gaps in the boundary of a polyhedron", CAGD 12, 1995, and P. Liepa, "Filling holes in
meshes", SGP 2003. The weight is the sum of the angles at all edges, towards the surface round the
hole too: where a sharp edge of the body runs into the hole, it is drawn on through it, because one
sharp fold weighs less than many half-sharp ones.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int64

from airtact.geometry.mesh.topology import Vertices

LENGTH_WEIGHT = 0.05
"""What an edge as long as the hole is wide weighs, in radians: of patches alike, the one of short edges is taken."""
THIN_WEIGHT = 100.0
"""What a triangle without area weighs, in radians: it is taken only where there is nothing else."""
THINNEST = 1e-3
"""A triangle whose height is below this share of its longest edge is thin."""


def patch(
    vertices: Vertices,
    rim: Int64[np.ndarray, "rim"],
    beside: Float64[np.ndarray, "rim 3"],
    edges: Int64[np.ndarray, "edges"],
    count: int,
) -> Int64[np.ndarray, "filling 3"] | None:
    """Triangulate the rim of a hole over its own vertices; None if every way uses an edge of the mesh again.

    ``rim`` runs in the direction of the new triangles; ``beside`` are the unit normals beside the
    edge from each rim vertex to the next; ``edges`` are the sorted numbers low * count + high of
    the edges of the mesh.
    """
    size = len(rim)
    points = vertices[rim]
    lengths = np.linalg.norm(points[:, None] - points[None], axis=2)
    barred = _barred(rim, edges, count)
    cost = np.full((size, size), np.inf)
    normal = np.zeros((size, size, 3))
    split = np.zeros((size, size), dtype=np.int64)
    index = np.arange(size - 1)
    cost[index, index + 1] = 0.0
    normal[index, index + 1] = beside[:-1]
    for gap in range(2, size):
        first = np.arange(size - gap)[:, None]
        middle = first + np.arange(1, gap)[None]
        last = first + gap
        facing, thin = _facing(points, lengths, first, middle, last)
        weight = cost[first, middle] + cost[middle, last] + THIN_WEIGHT * thin
        weight += _angles(facing, normal[first, middle]) + _angles(facing, normal[middle, last])
        if gap == size - 1:
            weight += _angles(facing, np.broadcast_to(beside[-1], facing.shape))
        best = weight.argmin(axis=1)
        row = np.arange(size - gap)
        cost[row, row + gap] = (
            weight[row, best] + LENGTH_WEIGHT * lengths[row, row + gap] / lengths.max()
        )
        normal[row, row + gap] = facing[row, best]
        split[row, row + gap] = middle[row, best]
        if gap < size - 1:
            used = row[barred[row, row + gap]]
            cost[used, used + gap] = np.inf
    return rim[_read(split)] if np.isfinite(cost[0, size - 1]) else None


def _barred(
    rim: Int64[np.ndarray, "rim"], edges: Int64[np.ndarray, "edges"], count: int
) -> Bool[np.ndarray, "rim rim"]:
    """Chords that the mesh already has as an edge, or that lead from a vertex to itself."""
    low, high = np.minimum(rim[:, None], rim[None]), np.maximum(rim[:, None], rim[None])
    keys = low * count + high
    found = np.minimum(np.searchsorted(edges, keys), len(edges) - 1)
    return (edges[found] == keys) | (low == high)


def _facing(
    points: Float64[np.ndarray, "rim 3"],
    lengths: Float64[np.ndarray, "rim rim"],
    first: Int64[np.ndarray, "rows 1"],
    middle: Int64[np.ndarray, "rows some"],
    last: Int64[np.ndarray, "rows 1"],
) -> tuple[Float64[np.ndarray, "rows some 3"], Bool[np.ndarray, "rows some"]]:
    """Find unit normals of triangles, and whether they are thin."""
    facing = np.cross(points[middle] - points[first], points[last] - points[first])
    size = np.linalg.norm(facing, axis=2)
    longest = np.maximum(
        np.maximum(lengths[first, middle], lengths[middle, last]), lengths[first, last]
    )
    return facing / np.maximum(size, 1e-300)[:, :, None], size <= THINNEST * longest**2


def _angles(
    one: Float64[np.ndarray, "rows some 3"], two: Float64[np.ndarray, "rows some 3"]
) -> Float64[np.ndarray, "rows some"]:
    return np.arccos(np.clip(np.einsum("rsi,rsi->rs", one, two), -1.0, 1.0))


def _read(split: Int64[np.ndarray, "rim rim"]) -> Int64[np.ndarray, "filling 3"]:
    """Corners of the triangles of the best triangulation."""
    filling, left = [], [(0, len(split) - 1)]
    while left:
        first, last = left.pop()
        if last - first >= 2:
            middle = int(split[first, last])
            filling.append((first, middle, last))
            left += [(first, middle), (middle, last)]
    return np.array(filling, dtype=np.int64)
