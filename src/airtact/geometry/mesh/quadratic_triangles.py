"""Curved quadratic (six-node) panels, on plain arrays: their shape, their pieces, their area and what they enclose.

A panel is a quadratic triangle: corners 0, 1, 2 and the mid-edge points of its edges 01, 12, 20.
"""

from functools import cache

import numpy as np
from jaxtyping import Float64, Int, Int64, Real

QuadraticTriangles = Float64[np.ndarray, "panels 6 3"]
Corners = Real[np.ndarray, "triangles 3 3"]
"""(T, 3, 3) points of flat triangles [m]."""
Nearby = Real[np.ndarray, "n 3 3"]
"""(N, 3, 3) corners of triangles that are looked at pair by pair [m]."""

NODE_PLACES = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5]])
"""Reference coordinates of the six nodes."""


def shape_functions(points: Real[np.ndarray, "points 2"]) -> Float64[np.ndarray, "points 6"]:
    """Quadratic shape functions of the six nodes at reference points (P, 2) of the unit triangle."""
    u, v = points[:, 0], points[:, 1]
    w = 1 - u - v
    return np.stack(
        [w * (2 * w - 1), u * (2 * u - 1), v * (2 * v - 1), 4 * w * u, 4 * u * v, 4 * v * w], axis=1
    )


def shape_gradients(
    points: Real[np.ndarray, "points 2"],
) -> tuple[Float64[np.ndarray, "points 6"], ...]:
    """Differentiate the shape functions along u and v."""
    u, v = points[:, 0], points[:, 1]
    w, zero = 1 - u - v, np.zeros_like(u)
    along_u = np.stack([1 - 4 * w, 4 * u - 1, zero, 4 * (w - u), 4 * v, -4 * v], axis=1)
    along_v = np.stack([1 - 4 * w, zero, 4 * v - 1, -4 * u, 4 * u, 4 * (w - v)], axis=1)
    return along_u, along_v


def points_at(
    quadratic_triangles: QuadraticTriangles, references: Real[np.ndarray, "panels 2"]
) -> tuple[Float64[np.ndarray, "panels 3"], Float64[np.ndarray, "panels 3"]]:
    """One point of each panel by its coordinates, and the outward normal, as long as twice the area is round it."""
    along_u, along_v = (
        np.einsum("tn,tnd->td", some, quadratic_triangles) for some in shape_gradients(references)
    )
    return np.einsum("tn,tnd->td", shape_functions(references), quadratic_triangles), np.cross(
        along_u, along_v
    )


def middles_of(
    quadratic_triangles: QuadraticTriangles,
) -> tuple[Float64[np.ndarray, "panels 3"], Float64[np.ndarray, "panels 3"]]:
    """Middle of each panel, and the outward unit normal there."""
    middles, normals = points_at(quadratic_triangles, np.full((len(quadratic_triangles), 2), 1 / 3))
    return middles, unit(normals)


def normals_at(
    quadratic_triangles: QuadraticTriangles, reference: Real[np.ndarray, "2"]
) -> Float64[np.ndarray, "panels 3"]:
    """Outward normals of all panels at the same reference coordinates, as ``points_at`` has them."""
    return points_at(
        quadratic_triangles, np.broadcast_to(reference, (len(quadratic_triangles), 2))
    )[1]


def with_middles(
    corners: Float64[np.ndarray, "triangles 3 axes"],
) -> Float64[np.ndarray, "triangles 6 axes"]:
    """Add the middles of edges 01, 12, 20 to the corners of straight triangles."""
    return np.concatenate([corners, 0.5 * (corners + corners[:, [1, 2, 0]])], axis=1)


def area_vectors(corners: Corners) -> Float64[np.ndarray, "triangles 3"]:
    """Outward normal of each flat triangle, as long as twice its area [m²]."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def unit(vectors: Float64[np.ndarray, "*axes 3"]) -> Float64[np.ndarray, "*axes 3"]:
    """Divide vectors by their lengths; those of no length stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def edge_lengths(panels: Real[np.ndarray, "panels nodes 3"]) -> Float64[np.ndarray, "panels 3"]:
    """Corner-to-corner lengths of edges 01, 12, 20 of flat or curved triangles [m]."""
    along = panels[:, [1, 2, 0]] - panels[:, :3]
    return np.sqrt(np.einsum("tki,tki->tk", along, along))


def longest_edges(panels: Real[np.ndarray, "panels nodes 3"]) -> Float64[np.ndarray, "panels"]:
    """Longest corner-to-corner edge of each flat or curved triangle [m]."""
    return edge_lengths(panels).max(axis=1)


def corner_angles(
    along: Float64[np.ndarray, "triangles 3 3"],
) -> Float64[np.ndarray, "triangles 3"]:
    """Angles [rad] at the corners 0, 1, 2 of triangles by the unit vectors along their edges 01, 12, 20."""
    return np.arccos(
        np.clip(-np.einsum("tki,tki->tk", along, np.roll(along, 1, axis=1)), -1.0, 1.0)
    )


def smallest_angles(quadratic_triangles: QuadraticTriangles) -> Float64[np.ndarray, "panels"]:
    """Smallest angle between the straight edges of each panel [degrees]."""
    corners = quadratic_triangles[:, :3]
    along = np.roll(corners, -1, axis=1) - corners
    return np.degrees(corner_angles(along / np.linalg.norm(along, axis=2, keepdims=True))).min(
        axis=1
    )


def cut(
    quadratic_triangles: QuadraticTriangles, parts: Int[np.ndarray, "panels"]
) -> tuple[Float64[np.ndarray, "pieces 6 3"], Int64[np.ndarray, "pieces"]]:
    """Cut each panel into ``parts``² pieces of the same quadratic surface; (P,) is the panel that each came from."""
    parents = np.repeat(np.arange(len(parts)), parts * parts)
    pieces = quadratic_triangles[parents]
    for count in np.flatnonzero(np.bincount(parts)).tolist():
        if count > 1:
            chosen = parts == count
            shape = _piece_shapes(count).reshape(-1, 6)
            pieces[chosen[parents]] = (shape @ quadratic_triangles[chosen]).reshape(-1, 6, 3)
    return pieces, parents


@cache
def _piece_shapes(count: int) -> Float64[np.ndarray, "pieces 6 6"]:
    """Shape functions of a triangle at the six nodes of each of its count² pieces."""
    corners = []
    for i in range(count):
        for j in range(count - i):
            corners.append([(i, j), (i + 1, j), (i, j + 1)])
            if i + j < count - 1:
                corners.append([(i + 1, j + 1), (i, j + 1), (i + 1, j)])
    references = with_middles(np.array(corners, dtype=np.float64) / count)
    return shape_functions(references.reshape(-1, 2)).reshape(-1, 6, 6)


@cache
def gauss_square(
    points: int,
) -> tuple[Float64[np.ndarray, "points 2"], Float64[np.ndarray, "points"]]:
    """Gauss rule of points² on the unit triangle, by collapsing the unit square."""
    x, weights = np.polynomial.legendre.leggauss(points)
    u, v = (grid.ravel() for grid in np.meshgrid(0.5 * (x + 1), 0.5 * (x + 1)))
    return np.stack([u, v * (1 - u)], axis=1), np.outer(weights, weights).ravel() / 4 * (1 - u)


def enclosed_volume(quadratic_triangles: QuadraticTriangles) -> float:
    """Volume inside closed panels [m³], exact for the quadratic surface."""
    nodes = quadratic_triangles.transpose(2, 1, 0).reshape(3, 6, -1)
    placed = _volume_rule() @ (nodes - nodes[:, :1, :1])
    some = placed.shape[1] // 3
    at, along_u, along_v = placed[:, :some], placed[:, some : 2 * some], placed[:, 2 * some :]
    normals = along_u[[1, 2, 0]] * along_v[[2, 0, 1]] - along_u[[2, 0, 1]] * along_v[[1, 2, 0]]
    return float(gauss_square(3)[1] @ (at * normals).sum(axis=(0, 2)) / 3)


@cache
def _volume_rule() -> Float64[np.ndarray, "functions 6"]:
    """Shape functions at the points of a Gauss rule, then their derivatives along u and along v."""
    references, _ = gauss_square(3)
    return np.concatenate([shape_functions(references), *shape_gradients(references)])


def panel_areas(quadratic_triangles: QuadraticTriangles) -> Float64[np.ndarray, "panels"]:
    """Area of each panel [m²], exact for flat ones."""
    references, weights = gauss_square(3)
    return np.linalg.norm(_normals(quadratic_triangles, references), axis=2) @ weights


def _normals(
    quadratic_triangles: QuadraticTriangles, references: Real[np.ndarray, "points 2"]
) -> Float64[np.ndarray, "panels points 3"]:
    """Outward normals of all panels at the same reference points, as long as twice the panel's area is round them."""
    along_u, along_v = (some @ quadratic_triangles for some in shape_gradients(references))
    return np.cross(along_u, along_v)
