"""Closest points between points, segments and triangles, pair by pair, on plain arrays.

Source: C. Ericson, *Real-Time Collision Detection*, Morgan Kaufmann (2005), sections 5.1.5 (triangle) and 5.1.9 (two
segments).
"""

import numpy as np
from jaxtyping import Float64, Real


def closest_on_segments(
    points: Real[np.ndarray, "n 3"], starts: Real[np.ndarray, "n 3"], ends: Real[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n"]:
    """Where on its segment each point is nearest: 0 at the start, or for a segment of no length, and 1 at the end."""
    along = ends - starts
    length = np.einsum("ni,ni->n", along, along)
    share = np.einsum("ni,ni->n", points - starts, along)
    return np.clip(np.divide(share, length, out=np.zeros(len(share)), where=length > 0.0), 0.0, 1.0)


def segment_distances(
    first: Real[np.ndarray, "n 2 3"], second: Real[np.ndarray, "n 2 3"]
) -> tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Distance of segments, pair by pair (Ericson, section 5.1.9).

    Returns
    -------
    (N,) distances [m] and the (N, 3) nearest points on the first and on the second segment.
    """
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


def closest_on_triangles(
    points: Real[np.ndarray, "n 3"], corners: Real[np.ndarray, "n 3 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Barycentric weights of the point of each triangle that is nearest to its point (Ericson, section 5.1.5).

    Returns
    -------
    (N, 3) weights of the three corners; exactly zero for corners that do not take part, so that one zero means an edge
    and two mean a corner.
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


def _projection_weights(
    points: Real[np.ndarray, "n 3"], corners: Real[np.ndarray, "n 3 3"]
) -> Float64[np.ndarray, "n 3"]:
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    w = points - corners[:, 0]
    normal = np.cross(u, v)
    square = np.einsum("ni,ni->n", normal, normal)
    weights = np.empty((len(points), 3))
    weights[:, 1] = np.einsum("ni,ni->n", np.cross(w, v), normal) / square
    weights[:, 2] = np.einsum("ni,ni->n", np.cross(u, w), normal) / square
    weights[:, 0] = 1.0 - weights[:, 1] - weights[:, 2]
    return weights
