"""Closest points of segments and triangles, pair by pair, and where meshes that do not cross are nearest.

Source: C. Ericson, *Real-Time Collision Detection*, Morgan Kaufmann (2005), sections 5.1.5
(triangle) and 5.1.9 (two segments).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.geometry.mesh.quadratic_triangles import Corners, Nearby, area_vectors

EDGES = ([0, 1], [1, 2], [2, 0])
"""Ends of the edges of a triangle."""

_TRIED = 64  # pairs of boxes, the nearest ones, of which one triangle each is measured before they are halved
_PASS = 4096  # pairs of triangles that are measured at a time

ROUNDING = 1e-9
"""Pairs that can be nearer than the nearest by no more than this share are not looked at."""

Nearest = tuple[float, Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]
"""A distance [m] and the two points that it lies between [m]."""

AllNearest = tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]
"""Distances of many pairs (N,) [m] and the points (N, 3) that each lies between [m]."""


Points = Real[np.ndarray, "n 3"]
Segments = Real[np.ndarray, "n 2 3"]


def closest_on_segments(points: Points, starts: Points, ends: Points) -> Float64[np.ndarray, "n"]:
    """Where on its segment each point is nearest: 0 at the start, or for a segment of no length, and 1 at the end."""
    along = ends - starts
    length = np.einsum("ni,ni->n", along, along)
    share = np.einsum("ni,ni->n", points - starts, along)
    return np.clip(np.divide(share, length, out=np.zeros(len(share)), where=length > 0.0), 0.0, 1.0)


def segment_distances(first: Segments, second: Segments) -> AllNearest:
    """Distance of segments, pair by pair, with the nearest points of both (Ericson, section 5.1.9)."""
    p, q = first[:, 0], second[:, 0]
    u, v, w = first[:, 1] - p, second[:, 1] - q, p - q
    a, b, c = (np.einsum("ni,ni->n", x, y) for x, y in ((u, u), (u, v), (v, v)))
    d = np.einsum("ni,ni->n", u, w)
    e = np.einsum("ni,ni->n", v, w)
    determinant = a * c - b * b
    skew = determinant > 1e-14 * a * c
    s = np.clip(np.divide(b * e - c * d, determinant, out=np.zeros(len(a)), where=skew), 0.0, 1.0)
    t = np.clip(np.divide(b * s + e, c, out=np.zeros(len(a)), where=c > 0.0), 0.0, 1.0)
    s = np.clip(np.divide(b * t - d, a, out=np.zeros(len(a)), where=a > 0.0), 0.0, 1.0)
    here, there = p + s[:, None] * u, q + t[:, None] * v
    return np.linalg.norm(here - there, axis=1), here, there


def closest_on_triangles(points: Points, corners: Nearby) -> Float64[np.ndarray, "n 3"]:
    """Nearest point of each triangle to its point."""
    return np.einsum("nk,nki->ni", closest_weights(points, corners), corners)


def closest_weights(points: Points, corners: Nearby) -> Float64[np.ndarray, "n 3"]:
    """Barycentric weights of the point of each triangle that is nearest to its point (Ericson, section 5.1.5).

    Exactly zero for corners that do not take part, so that one zero means an edge and two mean a
    corner.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    weights = _projection_weights(points, corners)
    outside = np.flatnonzero((weights <= 0.0).any(axis=1))
    if len(outside) == 0:
        return weights
    nearest = np.full(len(outside), np.inf)
    here = points[outside]
    for start, (one, two) in enumerate(((a, b), (b, c), (c, a))):
        one, two = one[outside], two[outside]
        t = closest_on_segments(here, one, two)
        gap = here - one - t[:, None] * (two - one)
        distance = np.einsum("ni,ni->n", gap, gap)
        better = distance < nearest
        nearest[better] = distance[better]
        candidate = np.zeros((len(outside), 3))
        candidate[:, start], candidate[:, (start + 1) % 3] = 1.0 - t, t
        weights[outside[better]] = candidate[better]
    return weights


def _projection_weights(points: Points, corners: Nearby) -> Float64[np.ndarray, "n 3"]:
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    w = points - corners[:, 0]
    normal = area_vectors(corners)
    square = np.einsum("ni,ni->n", normal, normal)
    weights = np.empty((len(points), 3))
    weights[:, 1] = np.einsum("ni,ni->n", np.cross(w, v), normal) / square
    weights[:, 2] = np.einsum("ni,ni->n", np.cross(u, w), normal) / square
    weights[:, 0] = 1.0 - weights[:, 1] - weights[:, 2]
    return weights


def segment_to_triangle(segments: Segments, corners: Nearby) -> AllNearest:
    """Distance of segments and triangles that do not pierce each other, pair by pair, with the nearest points."""
    found = [segment_distances(segments, corners[:, edge]) for edge in EDGES]
    for end in (0, 1):
        points = np.asarray(segments[:, end], dtype=np.float64)
        nearest = closest_on_triangles(points, corners)
        found.append((np.linalg.norm(points - nearest, axis=1), points, nearest))
    return _least(found)


def triangle_to_triangle(first: Nearby, second: Nearby) -> AllNearest:
    """Distance of two triangles that do not cross, pair by pair, with the nearest points of both."""
    found = [segment_to_triangle(first[:, edge], second) for edge in EDGES]
    back = [segment_to_triangle(second[:, edge], first) for edge in EDGES]
    return _least(found + [(distance, there, here) for distance, here, there in back])


def _least(found: list[AllNearest]) -> AllNearest:
    """Keep for each pair the smallest of several distances, with its points."""
    best = np.argmin([distance for distance, _, _ in found], axis=0)
    rows = np.arange(len(best))
    distance, here, there = (np.stack(part)[best, rows] for part in zip(*found, strict=True))
    return distance, here, there


def nearest_between(
    first: Real[np.ndarray, "some 3 3"], second: Real[np.ndarray, "others 3 3"], within: float
) -> Nearest | None:
    """Find where two meshes that do not cross are nearest; None when they are not nearer than ``within`` [m].

    Boxes round the triangles are halved again and again, and pairs of boxes that stand farther
    apart than the nearest triangles known by then are left out: once with few pairs, which shows
    roughly where and in which direction, then with all and with boxes along that direction, which
    fit closest where it matters.
    """
    first, second = _beside(first, second, within), _beside(second, first, within)
    if len(first) == 0 or len(second) == 0:
        return None
    distance, here, there = rough = _descended(first, second, None, _TRIED)
    if distance == 0.0:
        return rough
    frame = np.linalg.qr(np.column_stack([there - here, np.eye(3)]))[0]
    known = (min(distance, within), here @ frame, there @ frame)
    distance, here, there = _descended(first @ frame, second @ frame, known, None)
    return (distance, frame @ here, frame @ there) if distance < within else None


def _descended(
    first: Real[np.ndarray, "some 3 3"],
    second: Real[np.ndarray, "others 3 3"],
    known: Nearest | None,
    most: int | None,
) -> Nearest:
    """Halve boxes down to triangles, keeping at most so many pairs of them, the nearest; None keeps all."""
    here, there = _halvings(first), _halvings(second)
    best = known if known else (np.inf, first[0, 0], second[0, 0])
    pairs, gaps = np.zeros((1, 2), dtype=np.int64), np.zeros(1)
    for level in range(max(len(here), len(there))):
        one, two = here[min(level, len(here) - 1)], there[min(level, len(there) - 1)]
        if level:
            pairs = _halved(pairs, level < len(here), level < len(there))
        gaps = _gaps(
            one.low[pairs[:, 0]], one.high[pairs[:, 0]], two.low[pairs[:, 1]], two.high[pairs[:, 1]]
        )
        order = np.argsort(gaps)[: np.count_nonzero(gaps < best[0] * (1.0 - ROUNDING))][:most]
        pairs, gaps = pairs[order], gaps[order]
        tried = pairs[:_TRIED]
        best = _better(best, first[one.member[tried[:, 0]]], second[two.member[tried[:, 1]]])
    pairs = np.stack([here[-1].member[pairs[:, 0]], there[-1].member[pairs[:, 1]]], axis=1)
    for start in range(_TRIED, len(pairs), _PASS):
        some = pairs[start : start + _PASS][
            gaps[start : start + _PASS] < best[0] * (1.0 - ROUNDING)
        ]
        best = _better(best, first[some[:, 0]], second[some[:, 1]])
    return best


def _better(best: Nearest, first: Nearby, second: Nearby) -> Nearest:
    """Keep the best so far, or take a nearer pair of triangles."""
    if len(first) == 0:
        return best
    distance, here, there = triangle_to_triangle(first, second)
    least = int(distance.argmin())
    return (
        (float(distance[least]), here[least], there[least]) if distance[least] < best[0] else best
    )


def _beside(
    first: Real[np.ndarray, "some 3 3"], second: Real[np.ndarray, "others 3 3"], within: float
) -> Real[np.ndarray, "near 3 3"]:
    """Those triangles of the first mesh that may be nearer to the box round the second than ``within``."""
    low, high = second.min(axis=(0, 1)), second.max(axis=(0, 1))
    return first[_gaps(first.min(axis=1), first.max(axis=1), low, high) < within]


def _gaps(
    low: Real[np.ndarray, "*n 3"],
    high: Real[np.ndarray, "*n 3"],
    bottom: Real[np.ndarray, "*m 3"],
    top: Real[np.ndarray, "*m 3"],
) -> Float64[np.ndarray, "*k"]:
    """Distance of upright boxes, pair by pair [m]."""
    return np.linalg.norm(np.maximum(np.maximum(bottom - high, low - top), 0.0), axis=-1)


def pairs_near(
    tree: KDTree, points: Points, reach: float | Float64[np.ndarray, "n"]
) -> tuple[Int64[np.ndarray, "pairs"], Int64[np.ndarray, "pairs"]]:
    """Pairs of a point and a point of a tree within its reach [m], by their numbers, in the order of the points."""
    near = tree.query_ball_point(points, reach)
    return np.repeat(np.arange(len(near)), [len(some) for some in near]), np.concatenate(
        near
    ).astype(np.int64)


class _Boxes(NamedTuple):
    """One level of a tree of boxes: corners (B, 3) of the boxes [m] and (B,) a triangle in each."""

    low: Float64[np.ndarray, "boxes 3"]
    high: Float64[np.ndarray, "boxes 3"]
    member: Int64[np.ndarray, "boxes"]


def _halvings(corners: Corners) -> list[_Boxes]:
    """Boxes round all triangles, round two halves of them, and so on down to single ones."""
    count = 2 ** int(np.ceil(np.log2(len(corners))))
    order = KDTree(corners.mean(axis=1), leafsize=1).indices[
        np.arange(count) * len(corners) // count
    ]
    levels = [
        _Boxes(corners[order].min(axis=1), corners[order].max(axis=1), order.astype(np.int64))
    ]
    while len(levels[0].member) > 1:
        low, high, member = levels[0]
        levels.insert(
            0,
            _Boxes(np.minimum(low[::2], low[1::2]), np.maximum(high[::2], high[1::2]), member[::2]),
        )
    return levels


def _halved(
    pairs: Int64[np.ndarray, "pairs 2"], one: bool, two: bool
) -> Int64[np.ndarray, "halves 2"]:
    """Go from pairs of boxes to those of their halves, where the one and the other mesh has any."""
    here = 2 * pairs[:, :1] + [0, 1] if one else pairs[:, :1]
    there = 2 * pairs[:, 1:] + [0, 1] if two else pairs[:, 1:]
    return np.stack(np.broadcast_arrays(here[:, :, None], there[:, None, :]), axis=3).reshape(-1, 2)
