"""The skin of a fitted hand, brought to the points where they show it: no person is made of balls.

Between a body of balls and a hand of flesh lie half a millimetre to two, which is much to sound of 8.6 mm. The points'
distances from the body, averaged over neighbours whose skin looks the same way (E. A. Nadaraya, Theory Probab. Appl. 9,
141 (1964)), say by how much to move the skin along its normals; where no point is near, it stays that of the body.
"""

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from airtact.hand.skin_mesh import even_skin
from airtact.hand.sphere_mesh import Hulls
from airtact.surfaces.surface import Surface

EDGES = (3.5e-3, 2.5e-3)
"""Edges of the triangles that are tried [m]: flat ones may cross where fingers all but touch."""

WIDTH, WIDE = 5e-3, 2.5
"""Standard deviation of the weights of points around a place of the skin [m], and how many of them are looked at."""

STAYING = 1.0
"""Weight of the body's own skin, over that of a point right there."""

NEAR, MOST = 3e-3, 1.5e-3
"""Points farther from the body say nothing of its skin, and that moves no farther [m]."""

ROOM = 0.3
"""Nor farther than this share of the way to other parts of the hand, and of the radius that it bends at."""

AROUND, TRIES = 8e-3, 3
"""Skin this near a place where it would cross itself stays where it was [m], and how often that is tried."""


def in_relief(
    hulls: Hulls, points: Float64[np.ndarray, "points 3"], edges: tuple[float, ...] = EDGES
) -> Surface | None:
    """Bring the skin of a body to the points that show it.

    Parameters
    ----------
    hulls : the body of the hand.
    points : (N, 3) of the true skin, strays left out [m].
    edges : of the triangles that are tried, one after the other [m].

    Returns
    -------
    The moved skin, or None where its triangles would cross.
    """
    for edge in edges:
        skin = even_skin(hulls, edge)
        look = hulls.look(skin.vertices)
        normals = _unit(look.gradient)
        room = ROOM * np.minimum(look.facing, np.abs(look.bend))
        most = np.minimum(MOST, np.maximum(room, 0.0))
        move = np.clip(_shown(hulls, points, skin.vertices, normals), -most, most)
        for _ in range(TRIES):
            surface = Surface(skin.vertices + move[:, None] * normals, skin.triangles)
            if len(surface.crossings) == 0:
                return surface
            crossed = skin.vertices[skin.triangles[surface.crossings.ravel()].ravel()]
            move[KDTree(crossed).query(skin.vertices)[0] < AROUND] = 0.0
    return None


def _shown(
    hulls: Hulls,
    points: Float64[np.ndarray, "points 3"],
    places: Float64[np.ndarray, "places 3"],
    normals: Float64[np.ndarray, "places 3"],
) -> Float64[np.ndarray, "places"]:
    """How far the points show the true skin to be out of the body's, at places on this [m]."""
    look = hulls.look(points)
    near = np.flatnonzero(np.abs(look.distance) < NEAR)
    outward, distance = _unit(look.gradient[near]), look.distance[near]
    pairs = KDTree(places).sparse_distance_matrix(KDTree(points[near]), WIDE * WIDTH, output_type="ndarray")
    place, point = pairs["i"], pairs["j"]
    alike = np.maximum(np.einsum("pi,pi->p", normals[place], outward[point]), 0.0) ** 2
    weight = alike * np.exp(-0.5 * (pairs["v"] / WIDTH) ** 2)
    total = np.bincount(place, weight, len(places)) + STAYING
    return np.bincount(place, weight * distance[point], len(places)) / total


def _unit(vectors: Float64[np.ndarray, "rows 3"]) -> Float64[np.ndarray, "rows 3"]:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
