"""Curved panels as one mesh of flat triangles, for programs that read no curved ones.

Each panel is projected onto the surface on its own, so that neighbours are micrometres apart, and a
panel that was cut in four has nodes on the edge of an uncut neighbour that this does not have. Both
are joined here, as far as they are distinguishable from gaps.
"""

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from airtact.geometry.mesh.arrays import QuadraticTriangles, Triangles, Vertices
from airtact.geometry.mesh.quadratic_triangles import edge_lengths
from airtact.geometry.mesh.topology import are_among, components, edge_ends, edge_twins, with_fans

PARTED = (1e-6, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Nodes on open edges are joined that part by less than these shares of the shortest edge of the smaller panel, those
that part least first; the nodes of one panel stand half of an edge apart."""

CLOSEST = 1.5
"""Joined are nodes that part by less than this factor times what each parts from its nearest."""

LONGER = 1.3
"""The way over the nodes of smaller neighbours is longer than the edge by less than this factor."""

ROUNDS = 8
"""Each round splits one edge of a triangle where smaller neighbours have nodes."""

FOUR = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
"""The nodes of the four flat triangles of a panel."""


def flat_triangles(quadratic_triangles: QuadraticTriangles) -> tuple[Vertices, Triangles]:
    """Cut each panel into four flat triangles, or more beside smaller ones, and join neighbours where they part."""
    points = quadratic_triangles.reshape(-1, 3)
    shortest = np.repeat(edge_lengths(quadratic_triangles).min(axis=1), 6)
    node = np.arange(len(points))
    vertices, sizes, triangles = points, shortest, node.reshape(-1, 6)[:, FOUR].reshape(-1, 3)
    for share in PARTED:
        node = _joined(vertices, triangles, share * sizes)[node]
        vertices = np.stack([np.bincount(node, weights=axis) for axis in points.T], axis=1)
        vertices /= np.bincount(node)[:, None]
        sizes = np.full(len(vertices), np.inf)
        np.minimum.at(sizes, node, shortest)
        triangles = node.reshape(-1, 6)[:, FOUR].reshape(-1, 3)
    for _ in range(ROUNDS):
        through = _bypassed(vertices, triangles)
        if not through:
            break
        triangles = with_fans(triangles, through)
    return vertices, triangles


def _joined(
    vertices: Vertices, triangles: Triangles, near: Float64[np.ndarray, "vertices"]
) -> Int64[np.ndarray, "vertices"]:
    """Give the vertices new numbers, one to those that face each other over a gap."""
    count, ends = len(vertices), edge_ends(triangles)
    rim = np.unique(ends[edge_twins(triangles) == -1])
    if len(rim) == 0:
        return np.arange(count)
    pairs = rim[KDTree(vertices[rim]).query_pairs(float(near[rim].max()), output_type="ndarray")]
    gap = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
    fit = ~are_among(pairs, ends) & (gap <= near[pairs].min(axis=1))
    pairs, gap = pairs[fit], gap[fit]
    nearest = np.full(count, np.inf)
    np.minimum.at(nearest, pairs.ravel(), np.repeat(gap, 2))
    touching = PARTED[0] * near[pairs].min(axis=1)
    pairs = pairs[gap <= np.maximum(CLOSEST * nearest[pairs].min(axis=1), touching)]
    return components(pairs[:, 0], pairs[:, 1], count)


def _bypassed(vertices: Vertices, triangles: Triangles) -> dict[int, list[int]]:
    """Edges 3 t + e with no neighbour, one of a triangle, and the vertices of shorter such edges that run back."""
    lone = np.flatnonzero(edge_twins(triangles).ravel() == -1)
    starts, ends = edge_ends(triangles).reshape(-1, 2)[lone].T
    lengths = np.linalg.norm(vertices[ends] - vertices[starts], axis=1)
    following: dict[int, list[tuple[int, float]]] = {}
    for start, end, length in zip(starts.tolist(), ends.tolist(), lengths.tolist(), strict=True):
        following.setdefault(start, []).append((end, length))
    found: dict[int, tuple[int, list[int]]] = {}
    for edge, start, end, length in zip(
        lone.tolist(), starts.tolist(), ends.tolist(), lengths.tolist(), strict=True
    ):
        way = _way(following, end, start, LONGER * length, length)
        if way and edge // 3 not in found:
            found[edge // 3] = edge, way[:0:-1]
    return dict(found.values())


def _way(
    following: dict[int, list[tuple[int, float]]], here: int, goal: int, left: float, longest: float
) -> list[int]:
    """Vertices from here to before a goal along edges shorter than ``longest``, ``left`` long together; or none."""
    for there, length in following.get(here, ()):
        if length >= min(longest, left):
            continue
        if there == goal:
            return [here]
        way = _way(following, there, goal, left - length, longest)
        if way:
            return [here, *way]
    return []
