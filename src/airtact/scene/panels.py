"""Curved six-node panels of a wanted size, for the solvers.

A panel is a quadratic triangle: corners 0, 1, 2 and the mid-edge points of its edges 01, 12, 20. Panels need not meet
corner to corner, so each may be cut into smaller ones on its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int, Int64, Real

from airtact.scene.geometry import Surface

SixNodes = Float64[np.ndarray, "panels 6 3"]


@dataclass(frozen=True, eq=False)
class Panels:
    """The skin of all bodies of a scene, cut into curved panels.

    Attributes
    ----------
    six_nodes : (T, 6, 3) corners 0, 1, 2 and mid-edge points 01, 12, 20 of each panel [m], outward.
    body : (T,) which obstacle each panel belongs to.
    """

    six_nodes: SixNodes
    body: Int64[np.ndarray, "panels"]


def shape_functions(points: Real[np.ndarray, "points 2"]) -> Float64[np.ndarray, "points 6"]:
    """Quadratic shape functions of the six nodes at reference points (P, 2) of the unit triangle."""
    u, v = points[:, 0], points[:, 1]
    w = 1 - u - v
    return np.stack([w * (2 * w - 1), u * (2 * u - 1), v * (2 * v - 1), 4 * w * u, 4 * u * v, 4 * v * w], axis=1)


def surface_panels(surface: Surface) -> SixNodes:
    """Six nodes of each triangle of a surface as it is; without mid-edge points the panels are flat."""
    corners = surface.vertices[surface.triangles]
    midpoints = surface.midpoints
    if midpoints is None:
        midpoints = 0.5 * (corners + np.roll(corners, -1, axis=1))
    return np.concatenate([corners, midpoints], axis=1)


def longest_edges(six_nodes: SixNodes) -> Float64[np.ndarray, "panels"]:
    """Longest corner-to-corner edge of each panel [m]."""
    corners = six_nodes[:, :3]
    return np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)


def cut(
    six_nodes: SixNodes, parts: Int[np.ndarray, "panels"]
) -> tuple[Float64[np.ndarray, "pieces 6 3"], Int64[np.ndarray, "pieces"]]:
    """Cut each panel into ``parts``² pieces of the same quadratic surface.

    Returns
    -------
    pieces : (P, 6, 3) the pieces, and (P,) the panel that each came from.
    """
    pieces, parents = [], []
    for count in np.unique(parts):
        chosen = np.flatnonzero(parts == count)
        references = _piece_references(int(count))
        shape = shape_functions(references.reshape(-1, 2)).reshape(-1, 6, 6)
        pieces.append(np.einsum("sna,tad->tsnd", shape, six_nodes[chosen]).reshape(-1, 6, 3))
        parents.append(np.repeat(chosen, len(references)))
    order = np.argsort(np.concatenate(parents), kind="stable")
    return np.concatenate(pieces)[order], np.concatenate(parents)[order]


def _piece_references(count: int) -> Float64[np.ndarray, "pieces 6 2"]:
    """Place the six nodes of each of the count² pieces of a triangle, in its reference coordinates."""
    corners = []
    for i in range(count):
        for j in range(count - i):
            corners.append([(i, j), (i + 1, j), (i, j + 1)])
            if i + j < count - 1:
                corners.append([(i + 1, j + 1), (i, j + 1), (i + 1, j)])
    corner = np.array(corners, dtype=np.float64) / count
    return np.concatenate([corner, 0.5 * (corner + np.roll(corner, -1, axis=1))], axis=1)


def panelled(surface: Surface, edge: float) -> SixNodes:
    """Panels of a surface whose edges are at most about ``edge`` [m].

    A primitive is meshed anew on its exact shape; the triangles of any other surface are kept and cut where they are
    too large, so a finer mesh than needed stays as fine as it is.
    """
    if surface.primitive is not None:
        return surface_panels(surface.primitive.mesh(edge))
    panels = surface_panels(surface)
    return cut(panels, np.maximum(1, np.ceil(longest_edges(panels) / edge - 1e-9)).astype(np.int64))[0]


def _refined(
    panels: SixNodes, surface: Surface, points: Real[np.ndarray, "points 3"], smallest: float, growth: float
) -> Float64[np.ndarray, "pieces 6 3"]:
    """Cut panels near the points in four until their edge is at most max(smallest, growth × distance)."""
    for _ in range(12):
        samples = np.concatenate([panels, panels.mean(axis=1, keepdims=True)], axis=1)
        distance = np.min(
            [np.linalg.norm(samples - point, axis=2).min(axis=1) for point in points], axis=0, initial=np.inf
        )
        large = longest_edges(panels) > np.maximum(smallest, growth * distance)
        if not large.any():
            break
        panels, parents = cut(panels, np.where(large, 2, 1))
        if surface.primitive is not None:
            new = large[parents]
            panels[new] = surface.primitive.project(panels[new].reshape(-1, 3)).reshape(-1, 6, 3)
    return panels


def scene_panels(
    surfaces: Sequence[Surface],
    edge: float,
    near: Real[np.ndarray, "points 3"],
    smallest: float,
    growth: float,
) -> Panels:
    """Panels of all bodies of a scene, finer beside some points.

    Parameters
    ----------
    surfaces : the bodies' skins.
    edge : longest panel edge wanted [m].
    near : (P, 3) points beside which panels are cut finer [m].
    smallest : edge below which no panel is cut for a point's sake [m].
    growth : panels at distance d of a point have edges of at most max(smallest, growth × d).
    """
    bodies = [_refined(panelled(surface, edge), surface, near, smallest, growth) for surface in surfaces]
    return Panels(np.concatenate(bodies), np.repeat(np.arange(len(bodies)), [len(body) for body in bodies]))
