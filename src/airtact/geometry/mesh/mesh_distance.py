"""Closest points of points, segments and triangles pair by pair, and the distance of two meshes.

Source: C. Ericson, *Real-Time Collision Detection*, Morgan Kaufmann (2005), sections 5.1.5
(triangle) and 5.1.9 (two segments).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.geometry.mesh.arrays import (
    Corners,
    IndexPairs,
    PairedCorners,
    PairedPoints,
    PairedSegments,
    PairLengths,
    Points,
)
from airtact.geometry.mesh.quadratic_triangles import area_vectors

EDGES = ([0, 1], [1, 2], [2, 0])
"""Ends of the edges of a triangle."""

Nearest = tuple[float, Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]
"""Distance of two bodies [m] and the closest point of each [m]."""
PairedNearest = tuple[
    Float64[np.ndarray, "n"], Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]
]
"""The same for each pair."""

FirstCorners = Real[np.ndarray, "first 3 3"]
SecondCorners = Real[np.ndarray, "second 3 3"]


def closest_on_segments(
    points: PairedPoints, starts: PairedPoints, ends: PairedPoints
) -> PairLengths:
    """Fraction of each segment, from 0 at its start to 1, at which it is nearest to its point."""
    along = ends - starts
    square = np.einsum("ni,ni->n", along, along)
    share = np.einsum("ni,ni->n", points - starts, along)
    return np.clip(np.divide(share, square, out=np.zeros(len(share)), where=square > 0.0), 0.0, 1.0)


def segment_distances(first: PairedSegments, second: PairedSegments) -> PairedNearest:
    """Distances of segments with the closest points of both (Ericson, section 5.1.9)."""
    p = first[:, 0]
    q = second[:, 0]
    u = first[:, 1] - p
    v = second[:, 1] - q
    a, b, c = (np.einsum("ni,ni->n", x, y) for x, y in ((u, u), (u, v), (v, v)))
    d = np.einsum("ni,ni->n", u, p - q)
    e = np.einsum("ni,ni->n", v, p - q)
    determinant = a * c - b * b
    skew = determinant > 1e-14 * a * c
    s = np.clip(np.divide(b * e - c * d, determinant, out=np.zeros(len(a)), where=skew), 0.0, 1.0)
    t = np.clip(np.divide(b * s + e, c, out=np.zeros(len(a)), where=c > 0.0), 0.0, 1.0)
    s = np.clip(np.divide(b * t - d, a, out=np.zeros(len(a)), where=a > 0.0), 0.0, 1.0)
    on_first = p + s[:, None] * u
    on_second = q + t[:, None] * v
    return np.linalg.norm(on_first - on_second, axis=1), on_first, on_second


def closest_on_triangles(
    points: PairedPoints, corners: PairedCorners
) -> Float64[np.ndarray, "n 3"]:
    """Closest point of each triangle to its point."""
    return np.einsum("nk,nki->ni", closest_weights(points, corners), corners)


def closest_weights(points: PairedPoints, corners: PairedCorners) -> Float64[np.ndarray, "n 3"]:
    """Barycentric coordinates of each triangle's closest point (Ericson, section 5.1.5).

    One coordinate is exactly zero on an edge, two at a corner.
    """
    u = corners[:, 1] - corners[:, 0]
    v = corners[:, 2] - corners[:, 0]
    w = points - corners[:, 0]
    normal = area_vectors(corners)
    square = np.einsum("ni,ni->n", normal, normal)
    weights = np.empty((len(points), 3))
    weights[:, 1] = np.einsum("ni,ni->n", np.cross(w, v), normal) / square
    weights[:, 2] = np.einsum("ni,ni->n", np.cross(u, w), normal) / square
    weights[:, 0] = 1.0 - weights[:, 1] - weights[:, 2]
    # Points that do not project into their triangle are nearest to one of its edges.
    outside = np.flatnonzero((weights <= 0.0).any(axis=1))
    nearest = np.full(len(outside), np.inf)
    points = points[outside]
    for start, end in EDGES:
        begin = corners[outside, start]
        finish = corners[outside, end]
        t = closest_on_segments(points, begin, finish)
        gap = points - begin - t[:, None] * (finish - begin)
        distance = np.einsum("ni,ni->n", gap, gap)
        better = distance < nearest
        nearest[better] = distance[better]
        candidate = np.zeros((len(outside), 3))
        candidate[:, start] = 1.0 - t
        candidate[:, end] = t
        weights[outside[better]] = candidate[better]
    return weights


def segment_to_triangle(segments: PairedSegments, corners: PairedCorners) -> PairedNearest:
    """Distances of segments and triangles that do not cross, with the closest points of both."""
    candidates = [segment_distances(segments, corners[:, edge]) for edge in EDGES]
    for end in (0, 1):
        points = np.asarray(segments[:, end], dtype=np.float64)
        nearest = closest_on_triangles(points, corners)
        candidates.append((np.linalg.norm(points - nearest, axis=1), points, nearest))
    return _smallest(candidates)


def triangle_to_triangle(first: PairedCorners, second: PairedCorners) -> PairedNearest:
    """Distances of triangles that do not cross, with the closest points of both."""
    candidates = [segment_to_triangle(first[:, edge], second) for edge in EDGES]
    for edge in EDGES:
        distance, on_second, on_first = segment_to_triangle(second[:, edge], first)
        candidates.append((distance, on_first, on_second))
    return _smallest(candidates)


def _smallest(candidates: list[PairedNearest]) -> PairedNearest:
    """Keep the candidate of the smallest distance for each pair."""
    best = np.argmin([distance for distance, _, _ in candidates], axis=0)
    rows = np.arange(len(best))
    distance, first, second = (np.stack(part)[best, rows] for part in zip(*candidates, strict=True))
    return distance, first, second


def nearest_between(first: FirstCorners, second: SecondCorners, within: float) -> Nearest | None:
    """Closest points of two meshes that do not cross; None if ``within`` [m] or more apart.

    Boxes around the triangles are halved repeatedly. Pairs of boxes farther apart than the nearest
    pair of triangles so far are dropped.
    """
    near_first = _box_gaps(first, second.min(axis=(0, 1)), second.max(axis=(0, 1))) < within
    near_second = _box_gaps(second, first.min(axis=(0, 1)), first.max(axis=(0, 1))) < within
    first = first[near_first]
    second = second[near_second]
    if len(first) == 0 or len(second) == 0:
        return None
    # A first search among few pairs of boxes finds roughly where the meshes are nearest. The full
    # search uses boxes along that direction, which fit most closely where it matters.
    rough = _descend(first, second, None, 64)
    distance, on_first, on_second = rough
    if distance == 0.0:
        return rough
    frame = np.linalg.qr(np.column_stack([on_second - on_first, np.eye(3)]))[0]
    bound = (min(distance, within), on_first @ frame, on_second @ frame)
    distance, on_first, on_second = _descend(first @ frame, second @ frame, bound, None)
    return (distance, frame @ on_first, frame @ on_second) if distance < within else None


def _descend(
    first: FirstCorners, second: SecondCorners, bound: Nearest | None, max_pairs: int | None
) -> Nearest:
    """Halve boxes down to triangles, keeping the nearest ``max_pairs`` pairs of boxes, or all."""
    tried = 64  # pairs of boxes of which one triangle each is measured before they are halved
    batch = 4096  # pairs of triangles measured at a time
    # Pairs that could be nearer by rounding only are dropped.
    shrink = 1.0 - 1e-9
    first_levels = _halvings(first)
    second_levels = _halvings(second)
    best = bound if bound else (np.inf, first[0, 0], second[0, 0])
    pairs = np.zeros((1, 2), dtype=np.int64)
    gaps = np.zeros(1)
    for level in range(max(len(first_levels), len(second_levels))):
        first_level = first_levels[min(level, len(first_levels) - 1)]
        second_level = second_levels[min(level, len(second_levels) - 1)]
        if level:
            pairs = _halved(pairs, level < len(first_levels), level < len(second_levels))
        below = second_level.low[pairs[:, 1]] - first_level.high[pairs[:, 0]]
        above = first_level.low[pairs[:, 0]] - second_level.high[pairs[:, 1]]
        gaps = np.linalg.norm(np.maximum(np.maximum(below, above), 0.0), axis=-1)
        order = np.argsort(gaps)[: np.count_nonzero(gaps < best[0] * shrink)][:max_pairs]
        pairs = pairs[order]
        gaps = gaps[order]
        samples = pairs[:tried]
        best = _nearer(
            best,
            first[first_level.member[samples[:, 0]]],
            second[second_level.member[samples[:, 1]]],
        )
    pairs = np.stack(
        [first_levels[-1].member[pairs[:, 0]], second_levels[-1].member[pairs[:, 1]]], axis=1
    )
    for start in range(tried, len(pairs), batch):
        rest = pairs[start : start + batch]
        rest = rest[gaps[start : start + batch] < best[0] * shrink]
        best = _nearer(best, first[rest[:, 0]], second[rest[:, 1]])
    return best


def _nearer(best: Nearest, first: PairedCorners, second: PairedCorners) -> Nearest:
    """Return the nearest of the pairs of triangles if it is nearer than the best so far."""
    if len(first) == 0:
        return best
    distance, on_first, on_second = triangle_to_triangle(first, second)
    closest = int(distance.argmin())
    if distance[closest] < best[0]:
        return float(distance[closest]), on_first[closest], on_second[closest]
    return best


def _box_gaps(
    corners: Corners, low: Real[np.ndarray, "3"], high: Real[np.ndarray, "3"]
) -> Float64[np.ndarray, "triangles"]:
    """Distance of the upright boxes around triangles from one box [m]."""
    outside = np.maximum(low - corners.max(axis=1), corners.min(axis=1) - high)
    return np.linalg.norm(np.maximum(outside, 0.0), axis=-1)


class _Boxes(NamedTuple):
    """One level of a binary tree of boxes: their corners [m] and one triangle in each."""

    low: Float64[np.ndarray, "boxes 3"]
    high: Float64[np.ndarray, "boxes 3"]
    member: Int64[np.ndarray, "boxes"]


def _halvings(corners: Corners) -> list[_Boxes]:
    """Boxes around all triangles, around two halves of them, and so on down to single ones."""
    count = 2 ** int(np.ceil(np.log2(len(corners))))
    spread = np.arange(count) * len(corners) // count  # some triangles twice, to fill the level
    order = KDTree(corners.mean(axis=1), leafsize=1).indices[spread].astype(np.int64)
    levels = [_Boxes(corners[order].min(axis=1), corners[order].max(axis=1), order)]
    while len(levels[0].member) > 1:
        low, high, member = levels[0]
        low = np.minimum(low[::2], low[1::2])
        high = np.maximum(high[::2], high[1::2])
        levels.insert(0, _Boxes(low, high, member[::2]))
    return levels


def _halved(pairs: IndexPairs, first: bool, second: bool) -> IndexPairs:
    """Pairs of the halves of pairs of boxes, where the first and the second mesh still have any."""
    first_halves = 2 * pairs[:, :1] + [0, 1] if first else pairs[:, :1]
    second_halves = 2 * pairs[:, 1:] + [0, 1] if second else pairs[:, 1:]
    return np.stack(
        np.broadcast_arrays(first_halves[:, :, None], second_halves[:, None, :]), axis=3
    ).reshape(-1, 2)


def pairs_near(
    tree: KDTree, points: Points, reach: float | Float64[np.ndarray, "points"]
) -> tuple[Int64[np.ndarray, "pairs"], Int64[np.ndarray, "pairs"]]:
    """Pairs of points and points of a tree within reach [m], by their indices, sorted by point."""
    near = tree.query_ball_point(points, reach)
    row = np.repeat(np.arange(len(near)), [len(neighbours) for neighbours in near])
    return row, np.concatenate(near).astype(np.int64)
