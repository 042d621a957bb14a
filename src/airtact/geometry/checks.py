"""Checks of bodies: self-intersections, thin parts, and bodies that overlap.

Distances are measured between points of the true, curved surfaces.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple
from weakref import WeakSet

import numpy as np
from jaxtyping import Bool

from airtact.errors import (
    InvalidInput,
    counted,
    in_mm,
)
from airtact.geometry.mesh.triangles import (
    Points,
    PointVectors,
    Vector3,
    Vertices,
    cut,
    longest_edges,
    panel_areas,
    points_at,
    shells,
    unit,
)
from airtact.geometry.primitives import Capsule, nearest_on_segments
from airtact.geometry.surface import Body, Surface

# Smallest distance between two bodies [m]; panels cannot resolve a narrower gap.
NEAREST = 0.3e-3

# Smallest thickness of a body [m].
THINNEST = 0.5e-3

# Bodies that passed the checks. Surfaces are immutable, so a moved body is not checked again.
_PASSED: WeakSet[Body] = WeakSet()


def check_surface(surface: Surface) -> None:
    """Check that a surface has no self-intersections, nested pieces or thin parts."""
    if surface.body not in _PASSED:
        check_not_crossed(surface)
        part = thin_part(surface)
        if part is not None:
            thickness, where = part
            raise InvalidInput(
                f"the body is {thickness * 1e3:.3g} mm thick near {in_mm(where)}, but must be at "
                f"least {THINNEST * 1e3:g} mm thick. Make it thicker there, or load it with "
                "smallest=2e-3, which removes thinner parts.",
                where,
                code="out_of_range",
            )
        _PASSED.add(surface.body)


def check_not_crossed(surface: Surface) -> None:
    """Check that a surface neither crosses nor touches itself and has no nested pieces."""
    pairs = surface.crossings
    if len(pairs):
        first, second = pairs[0]
        where = surface.corners[pairs[0]].mean(axis=(0, 1))
        meet = counted(len(pairs), "pair of triangles intersects", "pairs of triangles intersect")
        raise InvalidInput(
            f"the surface crosses itself: {meet}, such as {first} and {second} near "
            f"{in_mm(where)}; repair it, or load it with union=True.",
            where,
            code="mesh_faulty",
        )
    nested = surface.shape.nested_piece()
    if nested is not None:
        inner, outer, depth, where = nested
        raise InvalidInput(
            f"closed piece {inner} of {shells(surface.triangles).max() + 1} lies inside piece "
            f"{outer}, {depth * 1e3:.3g} mm deep near {in_mm(where)}; sound cannot reach it, so "
            "remove it.",
            where,
            code="mesh_faulty",
        )


def thin_part(surface: Surface) -> tuple[float, Vector3] | None:
    """Return the thickness [m] and position (3,) [m] of a part thinner than ``THINNEST``, or None.

    The thickness at a point is the diameter of the largest inner ball that touches the surface
    there and also touches the opposite surface. The normals at both points must be antiparallel to
    within 20 degrees, so edges of wedges pass the check. The thickness is measured at points 0.25
    mm apart, or farther apart on large bodies. A part counts as thin only if the body is too thin
    everywhere within a distance of ``THINNEST``, so small bumps, ribs and necks pass. The limit for
    the thickness is reduced by 10 %, because meshes may be rough or coarse.
    """
    shape = surface.shape
    if shape.least_thickness >= THINNEST * (1.0 - 1e-9):
        return None
    if shape.thinnest > 0.0:
        return shape.thinnest, surface.vertices.mean(axis=0)
    panels = surface.quadratic_triangles
    # The points on each panel are an R2 sequence (M. Roberts, 2018).
    areas = panel_areas(panels)
    spacing = max(0.5 * THINNEST, np.sqrt(areas.sum() / 20_000))
    count = 1 + (areas / spacing**2).astype(np.int64)
    number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    references = (1 / 3 + number[:, None] * [0.7548776662, 0.5698402910]) % 1.0
    beyond = references.sum(axis=1) > 1.0
    references[beyond] = 1.0 - references[beyond]
    touch, normals = points_at(np.repeat(panels, count, axis=0), references)
    normals = unit(normals)
    limit = 0.9 * THINNEST
    thin = shape.depth(touch - 0.5 * limit * normals) < 0.5 * limit * (1.0 - 1e-6)
    touch = touch[thin]
    normals = normals[thin]
    diameter = np.full(len(touch), limit)
    facing = normals.copy()
    # Each ball shrinks until it lies inside (J. Ma, S. W. Bae, S. Choi, "3D medial axis point
    # approximation using nearest neighbors and the normal field", Visual Computer 28, 7 (2012)).
    for _ in range(4):
        centres = touch - 0.5 * diameter[:, None] * normals
        depth = shape.depth(centres)
        cut_off = np.flatnonzero(depth < 0.5 * diameter * (1.0 - 1e-6))
        opposite = shape.project(centres[cut_off])
        facing[cut_off] = unit(opposite - centres[cut_off]) * np.sign(depth[cut_off, None])
        across = touch[cut_off] - opposite
        height = np.einsum("ni,ni->n", across, normals[cut_off])
        square = np.einsum("ni,ni->n", across, across)
        diameter[cut_off] = np.divide(square, height, out=np.zeros(len(square)), where=height > 0.0)
    centres = touch - 0.5 * diameter[:, None] * normals
    opposed = np.einsum("ni,ni->n", facing, normals) < -np.cos(np.radians(20.0))
    # Near an edge a ball may protrude from the body, so 0.9 of its radius is enough.
    inside = shape.depth(centres) >= 0.9 * 0.5 * diameter
    thin = np.flatnonzero(inside & opposed)
    thin = thin[:: 1 + len(thin) // 2000]
    thin = thin[_stands_alone(surface, centres[thin])]
    if len(thin) == 0:
        return None
    worst = thin[diameter[thin].argmin()]
    return float(diameter[worst]), centres[worst]


def _stands_alone(surface: Surface, centres: PointVectors) -> Bool[np.ndarray, "points"]:
    """Return whether the body is too thin everywhere within ``THINNEST`` of each centre."""
    directions = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=3).reshape(-1, 3)
    shares = np.array([0.4, 0.7, 1.0])
    around = THINNEST * (shares[:, None, None] * unit(directions)).reshape(-1, 3)
    alone = np.arange(len(centres))
    tried = 0
    while tried < len(around) and len(alone):
        # A few centres are tried in several directions at once, because each call takes 1 ms.
        offsets = around[tried : tried + max(1, 500 // len(alone))]
        points = centres[alone, None] + offsets
        thick = surface.shape.depth(points.reshape(-1, 3)) >= 0.5 * THINNEST
        alone = alone[~thick.reshape(len(alone), -1).any(axis=1)]
        tried += len(offsets)
    return np.isin(np.arange(len(centres)), alone)


# --- distances between bodies ------------------------------------------------------------------


class Approach(NamedTuple):
    """Distance [m] between two bodies, and the point (3,) of closest approach [m].

    The distance is negative if the bodies overlap.
    """

    gap: float
    position: Vector3


def check_apart(surfaces: Sequence[Surface]) -> None:
    """Check that bodies are at least ``NEAREST`` apart."""
    for i, j in combinations(range(len(surfaces)), 2):
        near = approach(surfaces[i], surfaces[j], NEAREST * (1.0 - 1e-9))
        if near is None:
            continue
        where = in_mm(near.position)
        if near.gap <= 1e-9:
            fault = f"overlap or touch: {max(-near.gap, 0.0) * 1e3:.3g} mm deep near {where}"
        else:
            apart = f"{near.gap * 1e3:.3g} mm apart near {where}"
            fault = f"are {apart}, but must be at least {NEAREST * 1e3:g} mm apart"
        raise InvalidInput(
            f"bodies {i} and {j} {fault}; move them apart, or merge them: "
            "airtact.geometry.merged([first, second]), or merge_bodies = true in a scene file.",
            near.position,
            code="bodies_overlap",
        )


def approach(first: Surface, second: Surface, within: float = np.inf) -> Approach | None:
    """Return the closest approach of two surfaces, or None if it exceeds ``within`` [m]."""
    if isinstance(first.shape, Capsule) and isinstance(second.shape, Capsule):
        on_first, on_second = nearest_on_segments(first.shape.axis, second.shape.axis)
        across = on_second - on_first
        gap = float(np.linalg.norm(across)) - first.shape.radius - second.shape.radius
        middle = on_first + (first.shape.radius + gap / 2.0) * unit(across)
        return Approach(gap, middle) if gap < within else None
    if isinstance(first.shape, Capsule):
        first, second = second, first  # computing the depth in a capsule is fast
    low = np.maximum(first.vertices.min(axis=0), second.vertices.min(axis=0))
    high = np.minimum(first.vertices.max(axis=0), second.vertices.max(axis=0))
    # The curved surface is at most half an edge away from the triangles.
    bulge = 0.5 * float(first.edge_lengths.max() + second.edge_lengths.max())
    if np.linalg.norm(np.maximum(low - high, 0.0)) >= within + bulge:
        return None
    # Vertices of the second body may lie in the first.
    points = second.vertices[_near_box(second.vertices, first.vertices, within + bulge)]
    nearest = None
    if len(points):
        gaps = -first.shape.depth(points)
        if gaps.min() < within:
            nearest = Approach(float(gaps.min()), points[gaps.argmin()])
    # Panels of the first body that may be closer are divided until their nodes are 0.1 mm apart.
    panels = first.quadratic_triangles
    panels = panels[_near_box(panels[:, 0], second.vertices, within + 3.0 * bulge)]
    while len(panels):
        gaps = -second.shape.depth(panels.reshape(-1, 3))
        if gaps.min() < within:
            nearest = Approach(float(gaps.min()), panels.reshape(-1, 3)[gaps.argmin()])
        within = nearest.gap if nearest else within
        lowest = gaps.reshape(-1, 6).min(axis=1)
        longest = longest_edges(panels)
        chosen = np.flatnonzero((lowest - 0.5 * longest < within) & (longest > 0.2e-3))
        if nearest is not None:  # the few nearest panels are enough
            chosen = chosen[np.argsort(lowest[chosen])[:256]]
        elif len(chosen) > 10_000:  # wide parallel faces that are just far enough apart
            return None
        panels = panels[chosen]
        panels = cut(panels, np.full(len(panels), 2))[0]
    return nearest


def _near_box(points: Points, around: Vertices, reach: float) -> Bool[np.ndarray, "points"]:
    low = around.min(axis=0) - reach
    high = around.max(axis=0) + reach
    return ((points >= low) & (points <= high)).all(axis=1)
