"""Curved quadratic (six-node) triangles: interpolation, normals, areas, volumes and cutting.

The nodes are corners 0, 1, 2 and the mid-edge points of edges 01, 12, 20.
"""

from functools import cache

import numpy as np
from jaxtyping import Float64, Int, Int64, Real

from airtact.geometry.mesh.arrays import Corners, Pieces, QuadraticTriangles, TriangleVectors

# Coordinates (u, v) on the unit triangle.
References = Real[np.ndarray, "points 2"]
NodeWeights = Float64[np.ndarray, "points 6"]
PanelVectors = Float64[np.ndarray, "panels 3"]
PanelSizes = Float64[np.ndarray, "panels"]

# Reference coordinates of the six nodes.
NODE_REFERENCES = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5]])


def shape_functions(points: References) -> NodeWeights:
    """Return the quadratic shape functions of the six nodes at reference points (P, 2)."""
    u, v = points.T
    w = 1 - u - v
    return np.stack(
        [w * (2 * w - 1), u * (2 * u - 1), v * (2 * v - 1), 4 * w * u, 4 * u * v, 4 * v * w], axis=1
    )


def shape_gradients(points: References) -> tuple[NodeWeights, NodeWeights]:
    """Return the u- and v-derivatives of the shape functions at reference points (P, 2)."""
    u, v = points.T
    w = 1 - u - v
    zero = np.zeros_like(u)
    along_u = np.stack([1 - 4 * w, 4 * u - 1, zero, 4 * (w - u), 4 * v, -4 * v], axis=1)
    along_v = np.stack([1 - 4 * w, zero, 4 * v - 1, -4 * u, 4 * u, 4 * (w - v)], axis=1)
    return along_u, along_v


def points_at(
    panels: QuadraticTriangles, references: Real[np.ndarray, "panels 2"]
) -> tuple[PanelVectors, PanelVectors]:
    """Return a point of each panel [m], and the outward normal there times twice the area."""
    along_u, along_v = (
        np.einsum("tn,tnd->td", gradient, panels) for gradient in shape_gradients(references)
    )
    position = np.einsum("tn,tnd->td", shape_functions(references), panels)
    return position, np.cross(along_u, along_v)


def middles_of(panels: QuadraticTriangles) -> tuple[PanelVectors, PanelVectors]:
    """Return the middle of each panel [m] and the outward unit normal there."""
    middles, normals = points_at(panels, np.full((len(panels), 2), 1 / 3))
    return middles, unit(normals)


def normals_at(panels: QuadraticTriangles, reference: Real[np.ndarray, "2"]) -> PanelVectors:
    """Return the normals of ``points_at`` for all panels, at the same reference coordinates."""
    return points_at(panels, np.broadcast_to(reference, (len(panels), 2)))[1]


def with_middles(
    corners: Float64[np.ndarray, "triangles 3 axes"],
) -> Float64[np.ndarray, "triangles 6 axes"]:
    """Append the middles of edges 01, 12, 20 to the corners of flat triangles."""
    return np.concatenate([corners, 0.5 * (corners + corners[:, [1, 2, 0]])], axis=1)


def area_vectors(corners: Corners) -> TriangleVectors:
    """Return the outward normal of each flat triangle; its length is twice the area [m²]."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def unit(vectors: Float64[np.ndarray, "*axes 3"]) -> Float64[np.ndarray, "*axes 3"]:
    """Scale vectors to unit length; zero vectors stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def edge_lengths(panels: Real[np.ndarray, "panels nodes 3"]) -> Float64[np.ndarray, "panels 3"]:
    """Return the straight lengths [m] of edges 01, 12, 20 of flat or curved triangles."""
    along = panels[:, [1, 2, 0]] - panels[:, :3]
    return np.sqrt(np.einsum("tki,tki->tk", along, along))


def longest_edges(panels: Real[np.ndarray, "panels nodes 3"]) -> PanelSizes:
    """Return the length [m] of the longest straight edge of each flat or curved triangle."""
    return edge_lengths(panels).max(axis=1)


def corner_angles(
    along: Float64[np.ndarray, "triangles 3 3"],
) -> TriangleVectors:
    """Return the angles [rad] at corners 0, 1, 2 from unit vectors along edges 01, 12, 20."""
    cosines = -np.einsum("tki,tki->tk", along, np.roll(along, 1, axis=1))
    return np.arccos(np.clip(cosines, -1.0, 1.0))


def smallest_angles(panels: QuadraticTriangles) -> PanelSizes:
    """Return the smallest angle [degrees] between the straight edges of each panel."""
    along = np.roll(panels[:, :3], -1, axis=1) - panels[:, :3]
    return np.degrees(corner_angles(along / np.linalg.norm(along, axis=2, keepdims=True))).min(
        axis=1
    )


def cut(
    panels: QuadraticTriangles, parts: Int[np.ndarray, "panels"]
) -> tuple[Pieces, Int64[np.ndarray, "_"]]:
    """Divide each panel into ``parts``² pieces, and return the index of each piece's panel."""
    parents = np.repeat(np.arange(len(parts)), parts * parts)
    pieces = panels[parents]
    for count in np.flatnonzero(np.bincount(parts)).tolist():
        if count > 1:
            chosen = parts == count
            shape = _piece_shapes(count).reshape(-1, 6)
            pieces[chosen[parents]] = (shape @ panels[chosen]).reshape(-1, 6, 3)
    return pieces, parents


@cache
def _piece_shapes(count: int) -> Float64[np.ndarray, "pieces 6 6"]:
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
    """Return points and weights of a collapsed Gauss rule with ``points``² nodes on a triangle."""
    x, weights = np.polynomial.legendre.leggauss(points)
    u, v = (grid.ravel() for grid in np.meshgrid(0.5 * (x + 1), 0.5 * (x + 1)))
    return np.stack([u, v * (1 - u)], axis=1), np.outer(weights, weights).ravel() / 4 * (1 - u)


def enclosed_volume(panels: QuadraticTriangles) -> float:
    """Return the volume inside closed panels [m³], which is exact for the quadratic surface."""
    # By the divergence theorem, the integral of position times normal is three volumes. One matrix
    # product evaluates positions and both derivatives at all quadrature points.
    nodes = panels.transpose(2, 1, 0).reshape(3, 6, -1)
    values = _volume_rule() @ (nodes - nodes[:, :1, :1])
    position, along_u, along_v = np.split(values, 3, axis=1)
    normals = along_u[[1, 2, 0]] * along_v[[2, 0, 1]] - along_u[[2, 0, 1]] * along_v[[1, 2, 0]]
    return float(gauss_square(3)[1] @ (position * normals).sum(axis=(0, 2)) / 3)


@cache
def _volume_rule() -> Float64[np.ndarray, "functions 6"]:
    """Return the shape functions at the points of a Gauss rule, then their u- and v-derivatives."""
    references, _ = gauss_square(3)
    return np.concatenate([shape_functions(references), *shape_gradients(references)])


def panel_areas(panels: QuadraticTriangles) -> PanelSizes:
    """Return the area of each panel [m²], which is exact for flat panels."""
    references, weights = gauss_square(3)
    along_u, along_v = (gradient @ panels for gradient in shape_gradients(references))
    return np.linalg.norm(np.cross(along_u, along_v), axis=2) @ weights
