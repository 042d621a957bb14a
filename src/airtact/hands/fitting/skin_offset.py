"""The skin of a fitted hand, moved to the points of the cloud by an offset field along its normals.

Between a body of balls and a hand of flesh lie half a millimetre to two, which matters to sound of
8.6 mm. The offset is the points' distance from the body, averaged over neighbours whose skin faces
the same way (E. A. Nadaraya, Theory Probab. Appl. 9, 141 (1964)); where no point is near, it is
zero.
"""

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from airtact.geometry.surface import Surface
from airtact.hands.skin_mesh import even_skin
from airtact.hands.sphere_mesh import Hulls

EDGES = (3.5e-3, 2.5e-3)
"""Edges of the triangles that are tried in turn [m]: flat ones may cross where fingers all but touch."""

WIDTH, WIDE = 5e-3, 2.5
"""Standard deviation of the weights of points around a position on the skin [m], and how many of these are used."""

STAYING = 1.0
"""Weight of the body's own skin, over that of a point right there."""

NEAR, MOST = 3e-3, 1.5e-3
"""Points farther from the body are not used, and the largest offset [m]."""

ROOM = 0.3
"""Largest offset over the distance to other parts of the hand, and over the radius that the skin bends at."""

AROUND, TRIES = 8e-3, 3
"""Where the moved skin crosses itself, the offset is zero within this distance [m]; how often that is tried."""


def with_offset(
    hulls: Hulls, points: Float64[np.ndarray, "points 3"], edges: tuple[float, ...] = EDGES
) -> Surface | None:
    """Move the skin of a body to the points (N, 3) of the true skin [m]; None where its triangles would cross."""
    for edge in edges:
        skin = even_skin(hulls, edge)
        look = hulls.look(skin.vertices)
        normals = _unit(look.gradient)
        room = ROOM * np.minimum(look.facing, np.abs(look.bend))
        most = np.minimum(MOST, np.maximum(room, 0.0))
        move = np.clip(_offset(hulls, points, skin.vertices, normals), -most, most)
        for _ in range(TRIES):
            surface = Surface(skin.vertices + move[:, None] * normals, skin.triangles)
            if len(surface.crossings) == 0:
                return surface
            crossed = skin.vertices[skin.triangles[surface.crossings.ravel()].ravel()]
            move[KDTree(crossed).query(skin.vertices)[0] < AROUND] = 0.0
    return None


def _offset(
    hulls: Hulls,
    points: Float64[np.ndarray, "points 3"],
    positions: Float64[np.ndarray, "positions 3"],
    normals: Float64[np.ndarray, "positions 3"],
) -> Float64[np.ndarray, "positions"]:
    """Average the distances of the points from the body at positions on its skin [m]."""
    look = hulls.look(points)
    near = np.flatnonzero(np.abs(look.distance) < NEAR)
    outward, distance = _unit(look.gradient[near]), look.distance[near]
    pairs = KDTree(positions).sparse_distance_matrix(
        KDTree(points[near]), WIDE * WIDTH, output_type="ndarray"
    )
    position, point = pairs["i"], pairs["j"]
    alike = np.maximum(np.einsum("pi,pi->p", normals[position], outward[point]), 0.0) ** 2
    weight = alike * np.exp(-0.5 * (pairs["v"] / WIDTH) ** 2)
    total = np.bincount(position, weight, len(positions)) + STAYING
    return np.bincount(position, weight * distance[point], len(positions)) / total


def _unit(vectors: Float64[np.ndarray, "rows 3"]) -> Float64[np.ndarray, "rows 3"]:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
