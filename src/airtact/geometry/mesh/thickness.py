"""Parts of a closed mesh that are thinner than a given length.

The thickness at a point of the surface is the diameter of the largest inner ball that touches the
surface there and is bounded by surface of opposite direction, so the sides of a wedge may meet. A
triangle moved inwards by half the length holds the centres of the balls of that diameter that touch
it. Where another triangle is nearer to the moved one than half the length, the body is thinner.
"""

from collections.abc import Callable
from itertools import product

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from airtact.geometry.mesh.arrays import (
    Corners,
    IndexPairs,
    PairedCorners,
    TriangleLabels,
    Triangles,
    TriangleVectors,
    Vector3,
)
from airtact.geometry.mesh.intersections import Group, pairs_of_groups, same_corners
from airtact.geometry.mesh.mesh_distance import closest_on_triangles, triangle_to_triangle
from airtact.geometry.mesh.quadratic_triangles import area_vectors, longest_edges

TriangleSizes = Float64[np.ndarray, "triangles"]

Depth = Callable[[Float64[np.ndarray, "points 3"]], Float64[np.ndarray, "points"]]
"""Depth of points (P, 3) [m] in a body (P,) [m], negative outside."""

_MAX_ANGLE = np.radians(20.0)
# Surfaces bound a thickness where they are parallel to within this angle.
_CELL = 0.3
# Edge, over the length, of grid cells of which one triangle or one ball each is looked at.


def thin_position(
    corners: Corners, triangles: Triangles, depth: Depth, thinnest: float, short: float
) -> tuple[float, Vector3] | None:
    """Find a part of a closed mesh thinner than a length: thickness [m] and middle (3,) [m].

    Thin parts narrower than a third of ``thinnest`` [m] may be missed. A part counts if the body is
    not thick enough anywhere within ``short`` [m] of it: 0 for all parts, more to ignore bumps and
    ribs of at most that height.
    """
    area = area_vectors(corners)
    twice_area = np.linalg.norm(area, axis=1)
    normals = area / twice_area[:, None]
    centres = corners.mean(axis=1)
    out = corners - centres[:, None]
    reach = np.linalg.norm(out, axis=2).max(axis=1)
    # Triangles smaller than half the length (level -1) are touched near their centres only.
    level = np.floor(np.log2(np.maximum(reach / (0.5 * thinnest), 0.5))).astype(np.int64)
    touched = np.where((level < 0)[:, None, None], corners - (1.0 - 1e-3) * out, corners)
    inner = touched - 0.5 * thinnest * normals[:, None]
    pairs = _opposite(centres, normals, reach, level, thinnest)
    heights = np.einsum(
        "nki,ni->nk", corners[pairs[:, 1]] - inner[pairs[:, 0], :1], normals[pairs[:, 0]]
    )
    near = (heights.min(axis=1) < 0.5 * thinnest) & (heights.max(axis=1) > -0.5 * thinnest)
    pairs = pairs[near][np.argsort(-heights[near].max(axis=1))]
    # Neighbours across the rim of a plate are nearer than the plate is thick.
    slim = twice_area < thinnest * longest_edges(corners)
    pairs = pairs[~(same_corners(triangles, pairs).any(axis=(1, 2)) & slim[pairs].any(axis=1))]
    batch = 4096  # pairs measured at a time
    for start in range(0, len(pairs), batch):
        first, second = pairs[start : start + batch].T
        distance, _, _ = triangle_to_triangle(inner[first], corners[second])
        thin = distance < 0.5 * thinnest * (1.0 - 1e-9)
        if thin.any():
            first = first[thin]
            ball = _thinnest_ball(
                touched[first], corners[second[thin]], normals[first], depth, thinnest, short
            )
            if ball is not None:
                return ball
    return None


def _thinnest_ball(
    touched: PairedCorners,
    bounding: PairedCorners,
    outward: Float64[np.ndarray, "n 3"],
    depth: Depth,
    thinnest: float,
    short: float,
) -> tuple[float, Vector3] | None:
    """Find the smallest inner ball between two triangles of a pair: its diameter and centre."""
    _, on_touched, on_bounding = triangle_to_triangle(touched, bounding)
    # Balls are laid at points from the nearest ones of both triangles to their centres.
    shares = (0.0, 0.02, 0.1, 0.3, 0.6, 1.0)
    paths = [(on_touched, touched.mean(axis=1)), (on_bounding, bounding.mean(axis=1))]
    points = np.concatenate(
        [start + share * (end - start) for start, end in paths for share in shares]
    )
    pair = np.tile(np.arange(len(touched)), len(paths) * len(shares))
    outward = outward[pair]
    touch = closest_on_triangles(points, touched[pair])
    opposite = closest_on_triangles(touch - 0.5 * thinnest * outward, bounding[pair])
    across = touch - opposite
    # The ball through both points whose centre lies inward of the first one.
    square = (across**2).sum(axis=1)
    height = np.einsum("ni,ni->n", across, outward)
    diameter = np.divide(
        square, height, out=np.where(square > 0.0, np.inf, 0.0), where=height > 0.0
    )
    chosen = np.argsort(diameter)[: np.count_nonzero(diameter < thinnest * (1.0 - 1e-9))]
    centres = touch[chosen] - 0.5 * diameter[chosen, None] * outward[chosen]
    firsts = _first_in_cells(centres, _CELL * thinnest)
    chosen = chosen[firsts]
    centres = centres[firsts]
    batch = 64  # balls looked at at a time
    for start in range(0, len(chosen), batch):
        part = slice(start, start + batch)
        # A ball that touches beside an edge may leave the body there: 0.9 of its radius suffices.
        inside = np.flatnonzero(depth(centres[part]) >= 0.5 * 0.9 * diameter[chosen[part]])
        alone = inside[_stands_alone(centres[part][inside], depth, thinnest, short)]
        if len(alone) > 0:
            first = start + int(alone[0])
            return float(diameter[chosen[first]]), centres[first]
    return None


def _stands_alone(
    centres: Float64[np.ndarray, "n 3"], depth: Depth, thinnest: float, short: float
) -> Bool[np.ndarray, "n"]:
    """Whether the body is not thick enough anywhere within a distance of centres."""
    if short == 0.0:
        return np.ones(len(centres), dtype=bool)
    directions = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    around = np.concatenate([share * short * directions for share in (0.4, 0.7, 1.0)])
    deepest = depth((centres[:, None] + around).reshape(-1, 3)).reshape(-1, len(around)).max(axis=1)
    return deepest < 0.5 * thinnest


def _opposite(
    centres: TriangleVectors,
    normals: TriangleVectors,
    reach: TriangleSizes,
    level: TriangleLabels,
    thinnest: float,
) -> IndexPairs:
    """Pairs of opposite triangles, the second within reach of inner balls that touch the first."""
    # Of two opposite surfaces, balls are laid against the one that faces an arbitrary direction.
    side = normals @ np.array([0.48, 0.6, 0.64])
    upper = side > -np.sin(_MAX_ANGLE)
    small = np.flatnonzero(upper & (level < 0))
    octant = (normals[small] > 0.0) @ np.array([1, 2, 4])
    upper[small] = False
    upper[small[_first_in_cells(centres[small], _CELL * thinnest, octant)]] = True
    # Triangles pair up if they are near and of opposite direction, so trees hold normals too.
    inner = np.hstack([centres - 0.5 * thinnest * normals, -0.5 * thinnest * normals])
    outer = np.hstack([centres, 0.5 * thinnest * normals])
    normal_gap = thinnest * np.sin(_MAX_ANGLE / 2.0)
    first = _groups(inner, upper, level, np.where(level < 0, 0.0, reach))
    second = _groups(outer, side < np.sin(_MAX_ANGLE), level, reach)
    chosen = [np.zeros((0, 2), dtype=np.int64)]
    for inner_group, outer_group in product(first, second):
        within = float(np.hypot(0.5 * thinnest + inner_group.reach + outer_group.reach, normal_gap))
        pairs = pairs_of_groups(inner_group, outer_group, within)
        cosine = np.einsum("ni,ni->n", normals[pairs[:, 0]], normals[pairs[:, 1]])
        chosen.append(pairs[cosine < -np.cos(_MAX_ANGLE)])
    return np.concatenate(chosen)


def _groups(
    points: Float64[np.ndarray, "triangles 6"],
    chosen: Bool[np.ndarray, "triangles"],
    level: TriangleLabels,
    reach: TriangleSizes,
) -> list[Group]:
    """Group chosen triangles of one level each."""
    parts = [np.flatnonzero(chosen & (level == value)) for value in np.unique(level[chosen])]
    return [
        Group(part, KDTree(points[part], balanced_tree=False), float(reach[part].max()))
        for part in parts
    ]


def _first_in_cells(
    points: Float64[np.ndarray, "n 3"], cell: float, kind: Int64[np.ndarray, "n"] | None = None
) -> Int64[np.ndarray, "_"]:
    """Choose the first point of each kind (0 to 7) in each cell of a grid."""
    boxes = np.floor((points - points.min(axis=0, initial=np.inf)) / cell).astype(np.int64)
    size = boxes.max(axis=0, initial=0) + 1
    key = boxes @ np.array([1, size[0], size[0] * size[1]])
    if kind is not None:
        key = key * 8 + kind
    return np.sort(np.unique(key, return_index=True)[1])
