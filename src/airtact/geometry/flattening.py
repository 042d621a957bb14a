"""The true surface of a body as flat triangles that stay close to it."""

import numpy as np
from jaxtyping import Bool, Float64, Int64

from airtact.geometry.mesh.edge_splitting import split_pieces
from airtact.geometry.mesh.quadratic_triangles import shape_functions
from airtact.geometry.mesh.topology import edge_twins
from airtact.geometry.shape import FlatMesh
from airtact.geometry.surface import Surface

AWAY = 10e-6
"""Farthest that the flat triangles may be from the true surface [m]."""

MIDDLE = 0.75
"""Distance of the surface from the middle of a straight edge, over that from the middle of its triangle, at least."""


def flattened(surface: Surface) -> FlatMesh:
    """Follow the true surface with flat triangles: its own, split at edges that are more than ``AWAY`` off."""
    exact = surface.shape.flat_mesh(AWAY)
    if exact is not None:
        return exact
    vertices, triangles, panels = surface.vertices, surface.triangles, surface.quadratic_triangles
    parent = np.arange(len(triangles))
    references = np.broadcast_to([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], (len(triangles), 3, 2))
    while True:
        between = 0.5 * (references + np.roll(references, -1, axis=1))
        shape = shape_functions(between.reshape(-1, 2)).reshape(-1, 3, 6)
        middles = np.einsum("ten,tnd->ted", shape, panels[parent])
        corners = vertices[triangles]
        rise = np.linalg.norm(middles - 0.5 * (corners + np.roll(corners, -1, axis=1)), axis=2)
        twins = edge_twins(triangles)
        far = rise > MIDDLE * AWAY
        far |= far.ravel()[twins]
        if not far.any():
            return vertices, triangles
        once = far & (
            np.arange(far.size).reshape(-1, 3) < twins
        )  # each edge is split by the first of its triangles
        number = np.zeros(far.shape, dtype=np.int64)
        number[once] = len(vertices) + np.arange(np.count_nonzero(once))
        number = np.maximum(number, number.ravel()[twins])
        vertices = np.concatenate([vertices, middles[once]])
        pieces, whole = _split(far)
        triangles = np.concatenate([triangles, number], axis=1)[whole[:, None], pieces]
        references = np.concatenate([references, between], axis=1)[whole[:, None], pieces]
        parent = parent[whole]


def corners_of(mesh: FlatMesh) -> Float64[np.ndarray, "triangles 3 3"]:
    """Corners (T, 3, 3) of the triangles of a mesh [m]."""
    vertices, triangles = mesh
    return vertices[triangles]


def bulge(surface: Surface) -> float:
    """How far the true surface leaves the flat triangles of a mesh at most [m]."""
    straight = 0.5 * (surface.corners + np.roll(surface.corners, -1, axis=1))
    return (
        float(np.linalg.norm(surface.quadratic_triangles[:, 3:] - straight, axis=2).max()) / MIDDLE
    )


_PIECES = split_pieces([[3, 1, 4], [0, 3, 4], [0, 4, 2]])


def _split(
    split: Bool[np.ndarray, "triangles 3"],
) -> tuple[Int64[np.ndarray, "pieces 3"], Int64[np.ndarray, "pieces"]]:
    """Cut triangles at the middles of some edges: which of their corners and middles, and which triangle."""
    pattern = split @ np.array([1, 2, 4])
    pieces, whole = [], []
    for number in (0, 7, 1, 3, 2, 6, 4, 5):
        table = _PIECES[number]
        chosen = np.flatnonzero(pattern == number)
        pieces.append(np.tile(table, (len(chosen), 1)))
        whole.append(np.repeat(chosen, len(table)))
    return np.concatenate(pieces).astype(np.int64), np.concatenate(whole)
