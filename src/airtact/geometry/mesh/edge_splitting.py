"""Splits the long edges of curved triangles, so that a coarse mesh gets vertices on its curved surface."""

import numpy as np
from jaxtyping import Bool, Float64, Int64

from airtact.geometry.mesh.quadratic_triangles import (
    NODE_PLACES,
    QuadraticTriangles,
    edge_lengths,
    shape_functions,
    with_middles,
)
from airtact.geometry.mesh.topology import Triangles, edge_twins

Edges = Bool[np.ndarray, "panels 3"]
Split = tuple[
    Float64[np.ndarray, "pieces 6 3"], Int64[np.ndarray, "pieces 3"], Bool[np.ndarray, "pieces 3"]
]
"""Pieces of panels, their vertex indices and which of their edges are sharp."""

_ON_EDGES = (
    {0, 2},
    {0, 1},
    {1, 2},
    {0},
    {1},
    {2},
)  # which of the edges 0, 1, 2 each of the six nodes lies on


def split_pieces(two_split: list[list[int]]) -> dict[int, list[list[int]]]:
    """Pieces of a triangle by their corners, of its six nodes, for every pattern of edges (bits 01, 12, 20) to split.

    ``two_split`` are the pieces where edges 01 and 12 are split, whose diagonal is a choice.
    """
    found = {0: [[0, 1, 2]]}
    for pattern, pieces in ((1, [[0, 3, 2], [3, 1, 2]]), (3, two_split)):
        for turn in range(3):
            turned = (pattern << turn | pattern >> (3 - turn)) & 7
            found[turned] = [
                [node // 3 * 3 + (node + turn) % 3 for node in piece] for piece in pieces
            ]
    return found | {7: [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]}


_PIECES = split_pieces([[0, 3, 2], [3, 1, 4], [3, 4, 2]])


def with_short_edges(
    quadratic_triangles: QuadraticTriangles, triangles: Triangles, sharp: Edges, longest: float
) -> Split:
    """Halve edges of a closed mesh, on its panels, until no straight one is longer than ``longest`` [m]."""
    while True:
        long = edge_lengths(quadratic_triangles) > longest
        if not long.any():
            return quadratic_triangles, triangles, sharp
        quadratic_triangles, triangles, sharp = _split_once(
            quadratic_triangles, triangles, sharp, long
        )


def _split_once(
    quadratic_triangles: QuadraticTriangles, triangles: Triangles, sharp: Edges, long: Edges
) -> Split:
    own = np.arange(3 * len(triangles)).reshape(-1, 3)
    edge = np.minimum(own, edge_twins(triangles))  # a name that both triangles have for it
    middle = int(triangles.max()) + 1 + np.searchsorted(np.unique(edge[long]), edge)
    vertices = np.concatenate([triangles, middle], axis=1)
    ridge = np.concatenate([sharp, np.zeros((len(sharp), 1), dtype=bool)], axis=1)
    panels, indices, ridges = [], [], []
    for pattern, pieces in _PIECES.items():
        chosen = np.flatnonzero(long @ [1, 2, 4] == pattern)
        for nodes in pieces:
            shape = shape_functions(with_middles(NODE_PLACES[nodes][None])[0])
            sides = [
                next(iter(_ON_EDGES[one] & _ON_EDGES[two]), 3)
                for one, two in zip(nodes, np.roll(nodes, -1), strict=True)
            ]
            panels.append(np.einsum("na,tad->tnd", shape, quadratic_triangles[chosen]))
            indices.append(vertices[chosen][:, nodes])
            ridges.append(ridge[chosen][:, sides])
    return np.concatenate(panels), np.concatenate(indices), np.concatenate(ridges)
