"""Pairs of triangles that cross or touch, within one mesh and between two.

Two triangles meet when an edge of one pierces the other or comes within a tolerance of it.
Neighbours in a mesh always meet in their shared corner or edge. Triangles that share a corner cross
only where they meet beyond it. A ray from the corner through the common points leaves one of the
triangles by the edge opposite the corner, so it suffices to test whether that edge meets the other
triangle. Triangles that share an edge cross only when folded flat onto each other.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.geometry.mesh.arrays import (
    Corners,
    IndexPairs,
    PairedCorners,
    PairedSegments,
    PairLengths,
    PairMask,
    Triangles,
)
from airtact.geometry.mesh.mesh_distance import (
    EDGES,
    FirstCorners,
    SecondCorners,
    segment_to_triangle,
)
from airtact.geometry.mesh.quadratic_triangles import area_vectors, unit


def self_crossings(corners: Corners, triangles: Triangles) -> IndexPairs:
    """Pairs of triangles of one mesh that cross or touch beyond their shared corners, sorted."""
    tolerance = _tolerance(corners)
    pairs = _pairs_within(corners, tolerance)
    shared_by_first = same_corners(triangles, pairs).max(axis=2)
    pairs = pairs[~_separated(corners, corners, pairs, shared_by_first, tolerance)]
    shared_by_second = same_corners(triangles, pairs).max(axis=1)
    pairs = pairs[~_separated(corners, corners, pairs[:, ::-1], shared_by_second, tolerance)]
    same = same_corners(triangles, pairs)
    shared = np.count_nonzero(same.reshape(-1, 9), axis=1)
    crossing = np.zeros(len(pairs), dtype=bool)
    for count, test in ((0, _strangers_meet), (1, _corner_neighbours_meet), (2, _folded)):
        chosen = np.flatnonzero(shared == count)
        first = _turned(corners, pairs[chosen, 0], same[chosen].max(axis=2))
        second = _turned(corners, pairs[chosen, 1], same[chosen].max(axis=1))
        crossing[chosen] = test(first, second, tolerance)
    pairs = pairs[crossing]
    return pairs[np.lexsort(pairs.T[::-1])]


def crossings_between(first: FirstCorners, second: SecondCorners) -> IndexPairs:
    """Pairs (K, 2) of a triangle of the first mesh and one of the second that cross or touch."""
    tolerance = _tolerance(np.concatenate([first, second]))
    groups = product(size_groups(first), size_groups(second))
    pairs = np.concatenate(
        [
            pairs_of_groups(group, other_group, group.reach + other_group.reach + tolerance)
            for group, other_group in groups
        ]
    )
    pairs = pairs[_boxes_overlap(first, second, pairs, tolerance)]
    unshared = np.zeros((len(pairs), 3), dtype=bool)
    apart = _separated(first, second, pairs, unshared, tolerance)
    apart |= _separated(second, first, pairs[:, ::-1], unshared, tolerance)
    pairs = pairs[~apart]
    return pairs[_strangers_meet(first[pairs[:, 0]], second[pairs[:, 1]], tolerance)]


def _tolerance(corners: Corners) -> float:
    """Distance below which triangles touch [m]: rounding of positions in a mesh of this extent."""
    return 1e-9 * float(np.ptp(corners.reshape(-1, 3), axis=0).max())


def same_corners(triangles: Triangles, pairs: IndexPairs) -> Bool[np.ndarray, "pairs 3 3"]:
    """Whether each corner of the first triangle of a pair is each corner of the second."""
    return triangles[pairs[:, 0]][:, :, None] == triangles[pairs[:, 1]][:, None, :]


def segment_triangle_distances(segments: PairedSegments, corners: PairedCorners) -> PairLengths:
    """Distance of segments and triangles, pair by pair [m]; 0 where they cross."""
    distance = segment_to_triangle(segments, corners)[0]
    height = _heights(segments, corners)
    crosses_plane = height[:, 0] * height[:, 1] < 0.0
    share = np.divide(
        height[:, 0], height[:, 0] - height[:, 1], out=np.zeros(len(height)), where=crosses_plane
    )
    hit = segments[:, 0] + share[:, None] * (segments[:, 1] - segments[:, 0])
    normal = area_vectors(corners)
    inside = crosses_plane
    for start, end in EDGES:
        side = np.cross(corners[:, end] - corners[:, start], hit - corners[:, start])
        inside = inside & (np.einsum("ni,ni->n", side, normal) >= 0.0)
    distance[inside] = 0.0
    return distance


def _heights(
    points: Real[np.ndarray, "n points 3"], corners: PairedCorners
) -> Float64[np.ndarray, "n points"]:
    """Signed distance of points from the plane of each triangle [m]."""
    return np.einsum("npi,ni->np", points - corners[:, :1], unit(area_vectors(corners)))


def _separated(
    first: FirstCorners,
    second: SecondCorners,
    pairs: IndexPairs,
    shared: Bool[np.ndarray, "pairs 3"],
    tolerance: float,
) -> Bool[np.ndarray, "pairs"]:
    """Whether all unshared corners of the first triangle lie on one side of the second's plane."""
    normals = unit(area_vectors(second))
    offsets = np.einsum("ti,ti->t", normals, second[:, 0])
    i, j = pairs.T
    height = np.einsum("pki,pi->pk", first[i], normals[j]) - offsets[j, None]
    above = ((height > tolerance) | shared).all(axis=1)
    below = ((height < -tolerance) | shared).all(axis=1)
    return above | below


def _turned(
    corners: Corners, members: Int64[np.ndarray, "n"], shared: Bool[np.ndarray, "n 3"]
) -> PairedCorners:
    """Corners of triangles from their shared corner on, or, if two are shared, from the third."""
    front = np.where(
        np.count_nonzero(shared, axis=1) == 2, shared.argmin(axis=1), shared.argmax(axis=1)
    )
    return corners[members[:, None], (front[:, None] + np.arange(3)) % 3]


def _strangers_meet(first: PairedCorners, second: PairedCorners, tolerance: float) -> PairMask:
    """Whether triangles without a common corner meet: an edge of one meets the other."""
    distance = np.full(len(first), np.inf)
    for edge in EDGES:
        distance = np.minimum(distance, segment_triangle_distances(first[:, edge], second))
        distance = np.minimum(distance, segment_triangle_distances(second[:, edge], first))
    return distance <= tolerance


def _corner_neighbours_meet(
    first: PairedCorners, second: PairedCorners, tolerance: float
) -> PairMask:
    """Whether triangles that share their first corner meet at an edge opposite it."""
    distance = segment_triangle_distances(first[:, 1:], second)
    return np.minimum(distance, segment_triangle_distances(second[:, 1:], first)) <= tolerance


def _folded(first: PairedCorners, second: PairedCorners, tolerance: float) -> PairMask:
    """Whether triangles that share their last two corners lie on each other."""
    flat = np.abs(_heights(first[:, :1], second)[:, 0]) <= tolerance
    along = unit(first[:, 2] - first[:, 1])
    up = first[:, 0] - first[:, 1]
    up = up - np.einsum("ni,ni->n", up, along)[:, None] * along
    over = second[:, 0] - first[:, 1]
    over = over - np.einsum("ni,ni->n", over, along)[:, None] * along
    return flat & (np.einsum("ni,ni->n", up, over) > 0.0)


def _pairs_within(corners: Corners, tolerance: float) -> IndexPairs:
    """Pairs i < j of triangles of one mesh whose boxes overlap."""
    groups = size_groups(corners)
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for rank, group in enumerate(groups):
        within = group.tree.query_pairs(2.0 * group.reach + tolerance, output_type="ndarray")
        pairs.append(group.members[within])
        pairs += [
            pairs_of_groups(group, larger, group.reach + larger.reach + tolerance)
            for larger in groups[rank + 1 :]
        ]
    result = np.sort(np.concatenate(pairs), axis=1).astype(np.int64)
    return result[_boxes_overlap(corners, corners, result, tolerance)]


def _boxes_overlap(
    first: FirstCorners, second: SecondCorners, pairs: IndexPairs, tolerance: float
) -> Bool[np.ndarray, "_"]:
    i, j = pairs.T
    low = first.min(axis=1)
    high = first.max(axis=1)
    other_low = second.min(axis=1)
    other_high = second.max(axis=1)
    overlap = np.ones(len(pairs), dtype=bool)
    for axis in range(3):  # one axis at a time, without copies of (pairs, 3)
        overlap &= low[i, axis] <= other_high[j, axis] + tolerance
        overlap &= other_low[j, axis] <= high[i, axis] + tolerance
    return overlap


class Group(NamedTuple):
    """Triangles of similar size: indices, a tree of their centres, and the largest radius [m]."""

    members: Int64[np.ndarray, "_"]
    tree: KDTree
    reach: float


def pairs_of_groups(first: Group, second: Group, within: float) -> IndexPairs:
    """Pairs of a triangle of each group whose centres are within a distance [m]."""
    table = first.tree.sparse_distance_matrix(second.tree, within, output_type="ndarray")
    return np.stack([first.members[table["i"]], second.members[table["j"]]], axis=1).astype(
        np.int64
    )


def size_groups(corners: Corners) -> tuple[Group, ...]:
    """Sort triangles by size into groups of a factor of two each.

    Without groups, one large triangle would widen the search around every small one.
    """
    centres = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centres[:, None, :], axis=2).max(axis=1)
    size = np.floor(np.log2(reach)).astype(np.int64)
    groups = (np.flatnonzero(size == level) for level in np.unique(size))
    return tuple(
        Group(members, KDTree(centres[members]), float(reach[members].max())) for members in groups
    )
