"""Curved six-node panels of a wanted size, for the solvers.

A panel is a quadratic triangle: corners 0, 1, 2 and the mid-edge points of its edges 01, 12, 20. Panels need not meet
corner to corner, so each may be cut into smaller ones on its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int, Int64, Real
from scipy.spatial import KDTree

from airtact.scene.geometry import ExactShape, Surface

SixNodes = Float64[np.ndarray, "panels 6 3"]

LONGEST_TO_EQUILATERAL = 1.2
"""Longest edge of a typical triangle over the edge of the equilateral triangle of the same area."""

LONGEST_OF_A_FILE = 1.5
"""The same for the uneven triangles of files, whose small ones make up for it."""

LARGEST_TO_POINT = 1.7
"""Panels beside a point that asks for finer ones have edges of at most this many distances."""

LARGEST_TO_GAP = 3.0
"""Panels that face another body have edges of at most this many gaps."""


@dataclass(frozen=True, eq=False)
class Panels:
    """The skin of all bodies of a scene, cut into curved panels.

    Attributes
    ----------
    six_nodes : (T, 6, 3) corners 0, 1, 2 and mid-edge points 01, 12, 20 of each panel [m], outward.
    body : (T,) which obstacle each panel belongs to.
    deviation : (T,) how far the panel lies from the true skin at most [m]; 0 where the panel is the skin.
    """

    six_nodes: SixNodes
    body: Int64[np.ndarray, "panels"]
    deviation: Float64[np.ndarray, "panels"]


def shape_functions(points: Real[np.ndarray, "points 2"]) -> Float64[np.ndarray, "points 6"]:
    """Quadratic shape functions of the six nodes at reference points (P, 2) of the unit triangle."""
    u, v = points[:, 0], points[:, 1]
    w = 1 - u - v
    return np.stack([w * (2 * w - 1), u * (2 * u - 1), v * (2 * v - 1), 4 * w * u, 4 * u * v, 4 * v * w], axis=1)


def shape_slopes(points: Real[np.ndarray, "points 2"]) -> tuple[Float64[np.ndarray, "points 6"], ...]:
    """Differentiate the shape functions along u and v."""
    u, v = points[:, 0], points[:, 1]
    w, zero = 1 - u - v, np.zeros_like(u)
    along_u = np.stack([1 - 4 * w, 4 * u - 1, zero, 4 * (w - u), 4 * v, -4 * v], axis=1)
    along_v = np.stack([1 - 4 * w, zero, 4 * v - 1, -4 * u, 4 * u, 4 * (w - v)], axis=1)
    return along_u, along_v


def surface_panels(surface: Surface) -> SixNodes:
    """Six nodes of each triangle of a surface as it is; without mid-edge points the panels are flat."""
    corners = surface.vertices[surface.triangles]
    if surface.midpoints is None:
        return _with_middles(corners)
    return np.concatenate([corners, surface.midpoints], axis=1)


def _with_middles(corners: Float64[np.ndarray, "triangles 3 axes"]) -> Float64[np.ndarray, "triangles 6 axes"]:
    """Add the middles of edges 01, 12, 20 to the corners of straight triangles."""
    return np.concatenate([corners, 0.5 * (corners + np.roll(corners, -1, axis=1))], axis=1)


def longest_edges(six_nodes: SixNodes) -> Float64[np.ndarray, "panels"]:
    """Longest corner-to-corner edge of each panel [m]."""
    return _edge_lengths(six_nodes).max(axis=1)


def _edge_lengths(six_nodes: SixNodes) -> Float64[np.ndarray, "panels 3"]:
    """Corner-to-corner lengths of edges 01, 12, 20 [m]."""
    corners = six_nodes[:, :3]
    return np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)


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
    return _with_middles(np.array(corners, dtype=np.float64) / count)


def _halved(panels: SixNodes, longest: float) -> Float64[np.ndarray, "pieces 6 3"]:
    """Halve panels across their longest edge until none is longer than ``longest`` [m]."""
    middle = [(0.5, 0.0), (0.5, 0.5), (0.0, 0.5)]
    corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]
    shapes = []
    for edge in range(3):
        start, end, apex = (corners[(edge + step) % 3] for step in range(3))
        halves = np.array([[start, middle[edge], apex], [middle[edge], end, apex]])
        shapes.append(shape_functions(_with_middles(halves).reshape(-1, 2)).reshape(2, 6, 6))
    done = []
    while len(panels):
        lengths = _edge_lengths(panels)
        large = lengths.max(axis=1) > longest
        done.append(panels[~large])
        halves = np.einsum("thna,tad->thnd", np.array(shapes)[lengths[large].argmax(axis=1)], panels[large])
        panels = halves.reshape(-1, 6, 3)
    return np.concatenate(done)


def panelled(surface: Surface, edge: float) -> SixNodes:
    """Panels of a surface about as large as equilateral triangles of a given edge [m].

    A primitive is meshed anew on its exact shape, as coarsely as its panels' mean area allows; the triangles of any
    other surface are kept and cut where they are too large, so a finer mesh than needed stays as fine as it is.
    """
    if surface.primitive is None:
        return _halved(surface_panels(surface), LONGEST_OF_A_FILE * edge)
    wanted = surface.primitive.area / (np.sqrt(3) / 4 * edge**2)
    for stretch in (1.6, 1.5, 1.4, 1.3, 1.2, 1.1):
        mesh = surface.primitive.mesh(stretch * edge)
        if len(mesh.triangles) >= 0.9 * wanted:
            break
    else:
        mesh = surface.primitive.mesh(edge)
    return _filled_out(surface_panels(mesh), surface.primitive)


def _filled_out(panels: SixNodes, shape: ExactShape) -> SixNodes:
    """Move the nodes outwards until the panels enclose the shape's volume: quadratics through its points hold less."""
    missing = shape.volume - enclosed_volume(panels)
    return shape.grown(missing / shape.area).project(panels.reshape(-1, 3)).reshape(panels.shape)


def enclosed_volume(panels: SixNodes) -> float:
    """Volume inside closed panels [m³], exact for the quadratic surface."""
    points, weights = np.polynomial.legendre.leggauss(4)
    u, v = (grid.ravel() for grid in np.meshgrid(0.5 * (points + 1), 0.5 * (points + 1)))
    reference = np.stack([u, v * (1 - u)], axis=1)
    weight = np.outer(weights, weights).ravel() / 4 * (1 - u)
    place = np.einsum("qn,tnd->tqd", shape_functions(reference), panels)
    along_u, along_v = (np.einsum("qn,tnd->tqd", slope, panels) for slope in shape_slopes(reference))
    return float(np.einsum("tqd,tqd,q->", place, np.cross(along_u, along_v), weight)) / 3


def _refined(
    panels: SixNodes,
    surface: Surface,
    points: Real[np.ndarray, "points 3"],
    others: Real[np.ndarray, "others 3"],
    smallest: float,
) -> Float64[np.ndarray, "pieces 6 3"]:
    """Cut in four the panels larger than ``smallest`` and than points or other bodies near them allow."""
    trees = [(KDTree(points), LARGEST_TO_POINT), (KDTree(others), LARGEST_TO_GAP)]
    while True:
        samples = np.concatenate([panels, panels.mean(axis=1, keepdims=True)], axis=1)
        allowed = np.min([factor * tree.query(samples.reshape(-1, 3))[0] for tree, factor in trees], axis=0)
        allowed = allowed.reshape(len(panels), -1).min(axis=1)
        if surface.primitive is not None:  # all panels beside a point, or those left whole would stand off the others
            beside = longest_edges(panels) > allowed
            panels[beside] = surface.primitive.project(panels[beside].reshape(-1, 3)).reshape(-1, 6, 3)
        large = longest_edges(panels) > np.maximum(LONGEST_TO_EQUILATERAL * smallest, allowed)
        if not large.any():
            return panels
        panels, _ = cut(panels, np.where(large, 2, 1))


def _deviation(panels: SixNodes, surface: Surface) -> Float64[np.ndarray, "panels"]:
    """How far panels lie from the exact shape at their nodes, centre and the middles between them [m]."""
    if surface.primitive is None:
        return np.zeros(len(panels))
    points = np.concatenate([np.eye(3), 1 - np.eye(3), 2 - np.eye(3), np.ones((1, 3)), 1 + 3 * np.eye(3)])
    shape = shape_functions((points / points.sum(axis=1, keepdims=True))[:, 1:])
    depth = surface.primitive.depth(np.einsum("qn,tnd->tqd", shape, panels).reshape(-1, 3))
    return np.abs(depth).reshape(len(panels), -1).max(axis=1)


def scene_panels(
    surfaces: Sequence[Surface],
    edge: float,
    near: Real[np.ndarray, "points 3"],
    smallest: float,
) -> Panels:
    """Panels of all bodies of a scene, finer beside some points and where bodies come close.

    Parameters
    ----------
    surfaces : the bodies' skins.
    edge : edge of the equilateral triangle as large as the panels wanted [m].
    near : (P, 3) points beside which panels are cut finer [m].
    smallest : edge below which no panel is cut for a point's or another body's sake [m].
    """
    whole = [panelled(surface, edge) for surface in surfaces]
    bodies = []
    for index, surface in enumerate(surfaces):
        others = [np.empty((0, 3))] + [panels.reshape(-1, 3) for other, panels in enumerate(whole) if other != index]
        bodies.append(_refined(whole[index], surface, near, np.concatenate(others), smallest))
    return Panels(
        six_nodes=np.concatenate(bodies),
        body=np.repeat(np.arange(len(bodies)), [len(body) for body in bodies]),
        deviation=np.concatenate([_deviation(body, surface) for body, surface in zip(bodies, surfaces, strict=True)]),
    )
