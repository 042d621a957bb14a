"""Curved quadratic (six-node) panels of a wanted size, for the solvers.

Panels need not meet corner to corner, so each may be cut into smaller ones on its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float64, Int64, Real
from scipy.spatial import KDTree

from airtact import _kernels
from airtact.geometry.cavities import FACED, are_flat, finer_where_faced, halved_in_corners
from airtact.geometry.mesh.quadratic_triangles import (
    QuadraticTriangles,
    cut,
    longest_edges,
    middles_of,
    panel_areas,
    shape_functions,
)
from airtact.geometry.shape import BEND, Shape

Points = Real[np.ndarray, "points 3"]

LONGEST_TO_EQUILATERAL = 1.2
"""Longest edge of a typical triangle over the edge of the equilateral triangle of the same area."""

LARGEST_TO_POINT = 1.7
"""Panels beside a point that asks for smaller ones have edges of at most this many distances."""

LARGEST_TO_GAP = 1.0
"""Panels that face another body, or another side of their own, have edges no longer than so many gaps."""

LARGEST_TO_WALL, LARGEST_TO_PLATE = 2.0, 4.0
"""Panels of a thin wall have edges of at most this many thicknesses, flat ones more.

Bent walls enclose cavities, whose resonances enlarge errors; plates in the open would cost four
times as much.
"""

LEAST_IN_GAP = 0.25
"""Edge, over the smallest beside points, below which no panel is cut for a gap's or a wall's sake."""

OPPOSITE = 0.75
"""Distance, over the longest edge, within which the other side of a gap or wall is looked for."""


def _probes() -> Float64[np.ndarray, "probes 6"]:
    """Shape functions at the nodes, centre and the middles between them, where panels are measured."""
    points = np.concatenate(
        [np.eye(3), 1 - np.eye(3), 2 - np.eye(3), np.ones((1, 3)), 1 + 3 * np.eye(3)]
    )
    return shape_functions((points / points.sum(axis=1, keepdims=True))[:, 1:])


PROBES = _probes()


@dataclass(frozen=True, eq=False)
class Panels:
    """The surfaces of all bodies of a scene, cut into curved panels.

    Attributes
    ----------
    quadratic_triangles : (T, 6, 3) corners 0, 1, 2 and mid-edge points 01, 12, 20 of each panel
        [m], outward.
    body : (T,) which obstacle each panel belongs to.
    deviation : (T,) how far the panel lies from the true surface at most [m].
    farthest : (B,) how far the panels of each body lie from the triangles that it was given as, at
        most [m].
    mean_distance : (B,) the same in the mean over the panels [m].
    """

    quadratic_triangles: QuadraticTriangles
    body: Int64[np.ndarray, "panels"]
    deviation: Float64[np.ndarray, "panels"]
    farthest: Float64[np.ndarray, "bodies"]
    mean_distance: Float64[np.ndarray, "bodies"]


def panels_of(
    shapes: Sequence[Shape],
    edge: float,
    near: Points,
    smallest: float,
    bend: float = BEND,
    away: float = np.inf,
    image: Callable[[Points], Points] | None = None,
    walls: Sequence[int] = (),
) -> Panels:
    """Panels of some bodies as large as equilateral triangles of an edge [m], smaller beside points, in gaps and walls.

    No panel is cut for a point's sake below the edge ``smallest`` [m], for a gap's or a thin wall's
    below ``LEAST_IN_GAP`` of it. Panels of a round surface turn by ``bend`` [rad] at most; those of
    a smooth mesh lie at most about ``away`` [m] off it, in root mean square. The bodies' ``image``,
    if there is one, makes gaps too. Flat faces of the bodies ``walls`` that look at each other have
    smaller panels.
    """
    whole = [shape.panels(edge, bend, away) for shape in shapes]
    finer = [partial(shapes[index].panels, FACED * edge, bend, away) for index in walls]
    for index, panels in zip(
        walls, finer_where_faced([whole[index] for index in walls], finer), strict=True
    ):
        whole[index] = panels
    whole = [
        panels if shape.thinnest else halved_in_corners(panels)
        for panels, shape in zip(whole, shapes, strict=True)
    ]
    bodies = []
    for index, shape in enumerate(shapes):
        others = [np.empty((0, 3))] + [
            panels.reshape(-1, 3) for other, panels in enumerate(whole) if other != index
        ]
        others += [image(panels.reshape(-1, 3)) for panels in whole] if image is not None else []
        bodies.append(_refined(whole[index], shape, near, np.concatenate(others), smallest))
    probes = [(PROBES @ body).reshape(-1, 3) for body in bodies]
    placed = list(zip(bodies, shapes, probes, strict=True))
    distances = [_off_triangles(*one) for one in placed]
    return Panels(
        quadratic_triangles=np.concatenate(bodies),
        body=np.repeat(np.arange(len(bodies)), [len(body) for body in bodies]),
        deviation=np.concatenate(
            [np.abs(shape.depth(at)).reshape(len(own), -1).max(axis=1) for own, shape, at in placed]
        ),
        farthest=np.array([farthest for farthest, _ in distances]),
        mean_distance=np.array([mean for _, mean in distances]),
    )


def _refined(
    panels: QuadraticTriangles,
    shape: Shape,
    points: Points,
    others: Real[np.ndarray, "others 3"],
    smallest: float,
) -> Float64[np.ndarray, "pieces 6 3"]:
    """Cut in four the panels larger than ``smallest`` and than points, other bodies or thin walls near them allow."""
    beside_point, in_gap = LONGEST_TO_EQUILATERAL * smallest * np.array([1.0, LEAST_IN_GAP])
    points = np.asarray(points, dtype=np.float64)
    fresh = np.arange(len(panels))
    while True:
        some = panels[fresh]
        edges = longest_edges(some)
        by_points = _allowed(some, edges, points, LARGEST_TO_POINT)
        by_gaps = _allowed(some, edges, others, LARGEST_TO_GAP)
        if not shape.thinnest:
            by_gaps = np.minimum(by_gaps, _allowed_by_own(panels, fresh))
        allowed = np.minimum(np.maximum(beside_point, by_points), np.maximum(in_gap, by_gaps))
        # all panels beside a point are fitted to the surface, or those left whole would stand off
        # the others
        beside = np.flatnonzero(edges > np.minimum(by_points, by_gaps))
        if len(beside):
            fitted = shape.fitted(some[beside])
            panels[fresh[beside]], edges[beside] = fitted, longest_edges(fitted)
        large = fresh[edges > allowed]
        if not len(large):
            return panels
        parts = np.ones(len(panels), dtype=np.int64)
        parts[large] = 2
        panels, parents = cut(panels, parts)
        fresh = np.flatnonzero(parts[parents] > 1)


def _allowed_by_own(
    panels: QuadraticTriangles, some: Int64[np.ndarray, "some"]
) -> Float64[np.ndarray, "some"]:
    """Longest edge that other sides of the same surface allow some panels [m]: across a gap or through a wall.

    Centres are neighbours if they are near and look in opposite directions, so the tree holds
    normals too.
    """
    edges = longest_edges(panels)
    reach = OPPOSITE * float(edges[some].max())
    centres, normals = middles_of(panels)
    tree = KDTree(np.concatenate([centres, reach * normals], axis=1))
    own, outward = centres[some], normals[some]
    distance, other = tree.query(
        np.concatenate([own, -reach * outward], axis=1), distance_upper_bound=reach
    )
    met = np.flatnonzero(distance < OPPOSITE * edges[some])
    across = np.einsum("nd,nd->n", centres[np.asarray(other)[met]] - own[met], outward[met])
    allowed = np.full(len(own), np.inf)
    to_wall = np.where(are_flat(panels[some][met]), LARGEST_TO_PLATE, LARGEST_TO_WALL)
    allowed[met] = np.abs(across) * np.where(across > 0, LARGEST_TO_GAP, to_wall)
    return allowed


def _allowed(
    panels: QuadraticTriangles, edges: Float64[np.ndarray, "panels"], points: Points, factor: float
) -> Float64[np.ndarray, "panels"]:
    """Longest edge that some points allow each panel [m]; infinite where they allow more than any has."""
    distance = np.empty(len(panels))
    _kernels.panel_distances(panels, points, float(edges.max()) * 1.001 / factor, distance)
    return factor * distance


def _off_triangles(panels: QuadraticTriangles, shape: Shape, probes: Points) -> tuple[float, float]:
    """Largest and mean distance of panels from the triangles that the body was given as [m]."""
    distance = shape.off_triangles(probes).reshape(len(panels), -1)
    if not distance.any():
        return 0.0, 0.0
    areas = panel_areas(panels)
    return float(distance.max()), float(areas @ distance.mean(axis=1) / areas.sum())
