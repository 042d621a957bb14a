"""Curved quadratic (six-node) panels of a given size for the solvers.

Panels need not meet corner to corner, so each can be cut independently. They are smaller near given
points, in gaps and thin walls, and where flat faces enclose a cavity. In a cavity, multiple
reflections repeat the same error. Most of this error arises at corners, where the errors of the
nearest panels do not cancel.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real

from airtact import _kernels
from airtact.geometry.mesh.triangles import (
    PanelSizes,
    PanelVectors,
    Pieces,
    Points,
    QuadraticTriangles,
    cut,
    longest_edges,
    middles_of,
    panel_areas,
    shape_functions,
    unit,
)
from airtact.geometry.shape import BEND, Shape

# Ratio of a typical triangle's longest edge to the edge of an equilateral triangle of equal area.
LONGEST_TO_EQUILATERAL = 1.2

# Ratio of the longest edge of panels near a point to their distance from the point.
LARGEST_TO_POINT = 1.7

# Ratio of the longest edge of panels that face another body to the gap. The sound in a gap is
# smooth; most of its error comes from larger panels around it, so smaller ones have no benefit.
LARGEST_TO_GAP = 2.0


@dataclass(frozen=True, eq=False)
class Panels:
    """Curved panels that cover the B bodies of a scene, for the boundary element method.

    ``panels_of`` returns all T panels of a scene, as ``BoundaryElement`` uses them.

    Attributes
    ----------
    quadratic_triangles : (T, 6, 3) corners 0, 1, 2 and mid-edge points 01, 12, 20 of each panel
        in the frame of the scene [m], anticlockwise when seen from outside.
    body : (T,) index of the body of each panel, in the order of the scene.
    deviation : (T,) largest distance of each panel from the true surface [m].
    farthest : (B,) largest distance of each body's panels from the triangles of its surface [m].
    mean_distance : (B,) area-weighted mean distance of each body's panels from the triangles of its
        surface [m].
    """

    quadratic_triangles: QuadraticTriangles
    body: Int64[np.ndarray, "panels"]
    deviation: PanelSizes
    farthest: Float64[np.ndarray, "bodies"]
    mean_distance: Float64[np.ndarray, "bodies"]


def panels_of(
    shapes: Sequence[Shape], edge: float, near: Points, smallest: float, **options: Any
) -> Panels:
    """Cover bodies with panels, and measure the distances of the panels from their surfaces.

    The parameters, including ``options``, are those of ``covers``.
    """
    refined = covers(shapes, edge, near, smallest, **options)
    # Distances are measured at the nodes, the centre and the middles between them.
    weights = np.concatenate(
        [np.eye(3), 1 - np.eye(3), 2 - np.eye(3), np.ones((1, 3)), 1 + 3 * np.eye(3)]
    )
    probe_shape = shape_functions((weights / weights.sum(axis=1, keepdims=True))[:, 1:])
    deviation = []
    farthest = []
    mean_distance = []
    for panels, shape in zip(refined, shapes, strict=True):
        probes = (probe_shape @ panels).reshape(-1, 3)
        deviation.append(np.abs(shape.depth(probes)).reshape(len(panels), -1).max(axis=1))
        # Seven probes inside each panel and on its edges are enough for the report.
        inner = (probe_shape[3:10] @ panels).reshape(-1, 3)
        distance = shape.off_triangles(inner).reshape(len(panels), -1)
        farthest.append(float(distance.max()))
        areas = panel_areas(panels)
        mean_distance.append(float(areas @ distance.mean(axis=1) / areas.sum()))
    return Panels(
        quadratic_triangles=np.concatenate(refined),
        body=np.repeat(np.arange(len(refined)), [len(panels) for panels in refined]),
        deviation=np.concatenate(deviation),
        farthest=np.array(farthest),
        mean_distance=np.array(mean_distance),
    )


def covers(
    shapes: Sequence[Shape],
    edge: float,
    near: Points,
    smallest: float,
    bend: float = BEND,
    away: float = np.inf,
    image: Callable[[Points], Points] | None = None,
    walls: Sequence[int] = (),
    close: float = 0.0,
) -> list[Pieces]:
    """Cover each body with panels no larger than equilateral triangles of edge length ``edge``.

    Parameters
    ----------
    shapes : the bodies.
    edge : edge length of the equilateral triangles [m].
    near : points near which panels are smaller [m].
    smallest : edge length below which panels near the points are not divided further [m]. In gaps
        and thin walls, the limit is a quarter of this length.
    bend : largest angle between a panel's normals at opposite edges, on a round surface [rad].
    away : largest root mean square distance of panels from a smooth mesh [m].
    image : function that mirrors points in a plane. If it is given, panels are also smaller in gaps
        between bodies and their mirror images.
    walls : indices of bodies whose flat faces get smaller panels if they face each other.
    close : gap [m] below which panels have edges 0.8 times as long, because sound is scattered back
        and forth in such gaps. Gaps between bodies, and between bodies and their mirror images, are
        considered.
    """
    bodies = [shape.panels(edge, bend, away) for shape in shapes]

    def opposite(index: int) -> Points:
        """Return the points of all other bodies and of all mirror images."""
        points = [np.empty((0, 3))]
        points += [body.reshape(-1, 3) for other, body in enumerate(bodies) if other != index]
        if image is not None:
            points += [image(body.reshape(-1, 3)) for body in bodies]
        return np.concatenate(points)

    for index in set(range(len(shapes))).difference(walls):
        if (_kernels.panel_distances(bodies[index], opposite(index), close) < close).any():
            bodies[index] = shapes[index].panels(0.8 * edge, bend, away)
    facing = _facing_faces([bodies[index] for index in walls])
    for index in walls:
        coarse = bodies[index]
        replaced = _in_faces(coarse, facing)
        if replaced.any():
            # The error is proportional to the cube of the edge, so this factor reduces it to 0.4.
            fine = shapes[index].panels(0.4 ** (1 / 3) * edge, bend, away)
            bodies[index] = np.concatenate([coarse[~replaced], fine[_in_faces(fine, facing)]])
    bodies = [
        panels if shape.thinnest else _halved_in_corners(panels)
        for panels, shape in zip(bodies, shapes, strict=True)
    ]
    return [
        _refined(bodies[index], shape, near, opposite(index), smallest)
        for index, shape in enumerate(shapes)
    ]


def _refined(
    panels: QuadraticTriangles,
    shape: Shape,
    points: Points,
    obstacles: Real[np.ndarray, "obstacles 3"],
    smallest: float,
) -> Pieces:
    beside_point = LONGEST_TO_EQUILATERAL * smallest
    in_gap = LONGEST_TO_EQUILATERAL * smallest * 0.25
    points = np.asarray(points, dtype=np.float64)
    new = np.arange(len(panels))
    while True:
        pieces = panels[new]
        edges = longest_edges(pieces)
        by_points = _allowed(pieces, edges, points, LARGEST_TO_POINT)
        by_gaps = _allowed(pieces, edges, obstacles, LARGEST_TO_GAP)
        if not shape.thinnest:
            by_gaps = np.minimum(by_gaps, _allowed_by_own_surface(panels, new))
        allowed = np.minimum(np.maximum(beside_point, by_points), np.maximum(in_gap, by_gaps))
        # All panels near a point are fitted to the surface, even if they are not divided.
        beside = np.flatnonzero(edges > np.minimum(by_points, by_gaps))
        if len(beside):
            fitted = shape.fitted(pieces[beside])
            panels[new[beside]] = fitted
            edges[beside] = longest_edges(fitted)
        large = new[edges > allowed]
        if not len(large):
            return panels
        parts = np.ones(len(panels), dtype=np.int64)
        parts[large] = 2
        panels, parents = cut(panels, parts)
        new = np.flatnonzero(parts[parents] > 1)


def _allowed(
    panels: QuadraticTriangles, edges: PanelSizes, points: Points, factor: float
) -> PanelSizes:
    """Return the longest edge [m] allowed by each panel's distance from points; inf if no limit."""
    limit = float(edges.max()) * 1.001 / factor
    return factor * _kernels.panel_distances(panels, points, limit)


def _allowed_by_own_surface(
    panels: QuadraticTriangles, chosen: Int64[np.ndarray, "chosen"]
) -> Float64[np.ndarray, "chosen"]:
    """Return the longest edge [m] allowed by the gap or wall opposite each chosen panel."""
    from scipy.spatial import KDTree  # importing it takes 0.2 s

    share = 0.75  # ratio of the search radius for the opposite side to the longest edge
    edges = longest_edges(panels)
    reach = share * float(edges[chosen].max())
    # The opposite side is near and has the opposite normal, so the tree includes normals.
    centres, normals = middles_of(panels)
    tree = KDTree(np.concatenate([centres, reach * normals], axis=1))
    queries = np.concatenate([centres[chosen], -reach * normals[chosen]], axis=1)
    distance, opposite = tree.query(queries, distance_upper_bound=reach)
    met = np.flatnonzero(distance < share * edges[chosen])
    gap = centres[np.asarray(opposite)[met]] - centres[chosen][met]
    across = np.einsum("nd,nd->n", gap, normals[chosen][met])
    # Bent walls enclose cavities, whose resonances amplify errors. Flat plates may have larger
    # panels: a limit of two thicknesses would cost four times as much.
    to_wall = np.where(_are_flat(panels[chosen][met]), 4.0, 2.0)
    allowed = np.full(len(chosen), np.inf)
    allowed[met] = np.abs(across) * np.where(across > 0, 1.0, to_wall)
    return allowed


# --- flat faces -------------------------------------------------------------------------------


def _are_flat(panels: QuadraticTriangles) -> Bool[np.ndarray, "panels"]:
    normals = unit(np.cross(panels[:, 1] - panels[:, 0], panels[:, 2] - panels[:, 0]))
    off = np.einsum("pmd,pd->pm", panels[:, 3:] - panels[:, :1], normals)
    return np.abs(off).max(axis=1) < 0.002 * longest_edges(panels)


def _halved_in_corners(panels: QuadraticTriangles) -> Pieces:
    flat = np.flatnonzero(_are_flat(panels))
    if not len(flat):
        return panels.copy()  # the caller may change the result in place
    # Two edges with the same middle are one edge.
    middles = panels[flat, 3:].reshape(-1, 3)
    edge = np.unique(np.round(middles / 1e-9), axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(edge, kind="stable")
    first = np.flatnonzero(edge[order][:-1] == edge[order][1:])
    edge_use = order[first]
    twin = order[first + 1]
    centres, normals = middles_of(panels[flat])
    towards = unit(centres[twin // 3] - middles[edge_use])
    # The second panel rises by more than 30 degrees in front of the first.
    rising = np.einsum("ed,ed->e", towards, normals[edge_use // 3]) > 0.5
    parts = np.ones(len(panels), dtype=np.int64)
    parts[flat[np.concatenate([edge_use[rising], twin[rising]]) // 3]] = 2
    return cut(panels, parts)[0]


@dataclass(frozen=True, eq=False)
class _Face:
    """Flat panels in one plane: unit normal, distance from the origin and panel centres [m]."""

    normal: Float64[np.ndarray, "3"]
    distance: float
    middles: PanelVectors

    def contains(self, middles: PanelVectors, normals: PanelVectors) -> Bool[np.ndarray, "panels"]:
        """Return whether flat panels lie in the plane of this face."""
        aligned = np.abs(normals - self.normal).max(axis=1) < 1e-4
        return aligned & (np.abs(middles @ self.normal - self.distance) < 1e-6)

    def faces(self, opposite_face: "_Face") -> bool:
        """Return whether another face is oriented toward this one and partly in front of it."""
        ahead = opposite_face.middles @ self.normal - self.distance > 1e-6
        return bool(self.normal @ opposite_face.normal < -0.5 and ahead.any())


def _facing_faces(bodies: Sequence[Pieces]) -> list[_Face]:
    if not bodies:
        return []
    panels = np.concatenate(bodies)
    middles, normals = middles_of(panels[_are_flat(panels)])
    faces = []
    while len(middles):
        normal = normals[0]
        plane = _Face(normal, float(middles[0] @ normal), middles)
        within = plane.contains(middles, normals)
        faces.append(_Face(normal, plane.distance, middles[within]))
        middles = middles[~within]
        normals = normals[~within]
    return [
        face
        for face in faces
        if any(face.faces(opposite_face) and opposite_face.faces(face) for opposite_face in faces)
    ]


def _in_faces(panels: QuadraticTriangles, faces: Sequence[_Face]) -> Bool[np.ndarray, "panels"]:
    middles, normals = middles_of(panels)
    within = np.zeros(len(panels), dtype=bool)
    for face in faces:
        within |= face.contains(middles, normals)
    return _are_flat(panels) & within
