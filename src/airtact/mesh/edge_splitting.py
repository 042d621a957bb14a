"""Splits the long edges of curved triangles, so that a coarse mesh gets vertices on its curved surface."""

import numpy as np
from jaxtyping import Bool, Float64, Int64

from airtact.mesh.quadratic_triangles import QuadraticTriangles, edge_lengths, shape_functions, with_middles
from airtact.mesh.topology import edge_twins

_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
_MIDDLES = np.array([[0.5, 0.0], [0.5, 0.5], [0.0, 0.5]])

_PARTS = {
    1: [[0, 3, 2], [3, 1, 2]],
    2: [[0, 3, 2], [3, 1, 4], [3, 4, 2]],
    3: [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
}
"""Pieces by the six nodes of their corners, where the first one, two or all three edges are split."""


def with_short_edges(
    quadratic_triangles: QuadraticTriangles,
    triangles: Int64[np.ndarray, "panels 3"],
    sharp: Bool[np.ndarray, "panels 3"],
    longest: float,
) -> tuple[Float64[np.ndarray, "pieces 6 3"], Int64[np.ndarray, "pieces 3"], Bool[np.ndarray, "pieces 3"]]:
    """Halve edges of a closed mesh until no straight one is longer than ``longest`` [m].

    Returns
    -------
    The pieces, their vertex indices and which of their edges are sharp; all lie on the panels that they come from.
    """
    while True:
        long = edge_lengths(quadratic_triangles) > longest
        if not long.any():
            return quadratic_triangles, triangles, sharp
        quadratic_triangles, triangles, sharp = _split_once(quadratic_triangles, triangles, sharp, long)


def _split_once(
    quadratic_triangles: QuadraticTriangles,
    triangles: Int64[np.ndarray, "panels 3"],
    sharp: Bool[np.ndarray, "panels 3"],
    long: Bool[np.ndarray, "panels 3"],
) -> tuple[Float64[np.ndarray, "pieces 6 3"], Int64[np.ndarray, "pieces 3"], Bool[np.ndarray, "pieces 3"]]:
    own = np.arange(3 * len(triangles)).reshape(-1, 3)
    edge = np.minimum(own, edge_twins(triangles))  # a name that both triangles have for it
    names = np.unique(edge[long])
    middle = int(triangles.max()) + 1 + np.searchsorted(names, edge)
    panels, indices, ridges = (
        [quadratic_triangles[~long.any(axis=1)]],
        [triangles[~long.any(axis=1)]],
        [sharp[~long.any(axis=1)]],
    )
    for count, parts in _PARTS.items():
        for turn in range(3):
            wanted = np.roll([True] * count + [False] * (3 - count), turn)
            chosen = np.flatnonzero((long == wanted).all(axis=1))
            if (count == 3 and turn) or not len(chosen):
                continue
            order = (np.arange(3) + turn) % 3  # the first split edge comes first
            references = np.concatenate([_CORNERS[order], _MIDDLES[order]])
            vertices = np.concatenate([triangles[chosen][:, order], middle[chosen][:, order]], axis=1)
            bent = np.concatenate([sharp[chosen][:, order], np.zeros((len(chosen), 1), dtype=bool)], axis=1)
            for part in parts:
                shape = shape_functions(with_middles(references[part][None])[0])
                panels.append(np.einsum("na,tad->tnd", shape, quadratic_triangles[chosen]))
                indices.append(vertices[:, part])
                ridges.append(bent[:, [_edge_between(part[i], part[(i + 1) % 3]) for i in range(3)]])
    return np.concatenate(panels), np.concatenate(indices), np.concatenate(ridges)


def _edge_between(start: int, end: int) -> int:
    """Which of the edges 0, 1, 2 two of the six nodes both lie on; 3 where none."""
    on = {0: {0, 2}, 1: {0, 1}, 2: {1, 2}, 3: {0}, 4: {1}, 5: {2}}
    return next(iter(on[start] & on[end]), 3)
