"""Where triangles cross or touch, by a triangle-triangle test over a tree, on plain arrays.

Two triangles meet when an edge of one pierces the other or comes within a tolerance of it.
Neighbours in a mesh share a corner or an edge, and meet there by right; they cross only where they
meet beyond it: a ray from the shared corner through the common points leaves one of the two
triangles by the edge opposite that corner, so it is enough to ask whether that edge meets the other
triangle. Triangles that share an edge cross only when folded flat onto each other.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.geometry.mesh.mesh_distance import EDGES, Segments, segment_to_triangle
from airtact.geometry.mesh.quadratic_triangles import Corners, Nearby, area_vectors, unit
from airtact.geometry.mesh.topology import Triangles

Pairs = Int64[np.ndarray, "pairs 2"]
"""(P, 2) numbers of two triangles."""
Found = Bool[np.ndarray, "n"]
Some = Real[np.ndarray, "some 3 3"]
Others = Real[np.ndarray, "others 3 3"]

CLOSE = 1e-9
"""Triangles nearer than this share of the whole extent touch."""


def self_crossings(corners: Corners, triangles: Triangles) -> Int64[np.ndarray, "crossings 2"]:
    """Find pairs of triangles of one mesh that cross or touch beyond what they share; in ascending order."""
    tolerance = CLOSE * float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    pairs = _pairs_within(corners, tolerance)
    pairs = pairs[
        ~_parted(corners, corners, pairs, same_corners(triangles, pairs).max(axis=2), tolerance)
    ]
    pairs = pairs[
        ~_parted(
            corners, corners, pairs[:, ::-1], same_corners(triangles, pairs).max(axis=1), tolerance
        )
    ]
    same = same_corners(triangles, pairs)
    shared = np.count_nonzero(same.reshape(-1, 9), axis=1)
    crossing = np.zeros(len(pairs), dtype=bool)
    for count, test in ((0, _strangers_meet), (1, _fans_meet), (2, _folded)):
        some = np.flatnonzero(shared == count)
        first = _turned(corners, pairs[some, 0], same[some].max(axis=2))
        second = _turned(corners, pairs[some, 1], same[some].max(axis=1))
        crossing[some] = test(first, second, tolerance)
    found = pairs[crossing]
    return found[np.lexsort(found.T[::-1])]


def same_corners(triangles: Triangles, pairs: Pairs) -> Bool[np.ndarray, "pairs 3 3"]:
    """Which corner of the first triangle is which of the second."""
    return triangles[pairs[:, 0]][:, :, None] == triangles[pairs[:, 1]][:, None, :]


def crossings_between(first: Some, second: Others) -> Int64[np.ndarray, "crossings 2"]:
    """Find pairs of triangles of two meshes that cross or touch: (K, 2) index in the first and in the second."""
    tolerance = CLOSE * float(np.ptp(np.concatenate([first, second]).reshape(-1, 3), axis=0).max())
    pairs = _pairs_between(first, second, tolerance)
    nothing = np.zeros((len(pairs), 3), dtype=bool)
    apart = _parted(first, second, pairs, nothing, tolerance)
    pairs = pairs[~(apart | _parted(second, first, pairs[:, ::-1], nothing, tolerance))]
    return pairs[_strangers_meet(first[pairs[:, 0]], second[pairs[:, 1]], tolerance)]


def segment_triangle_distances(segments: Segments, corners: Nearby) -> Float64[np.ndarray, "n"]:
    """Distance of segment and triangle, pair by pair [m]; 0 where the segment pierces the triangle."""
    distance = segment_to_triangle(segments, corners)[0]
    distance[_pierces(segments, corners)] = 0.0
    return distance


def _pierces(segments: Segments, corners: Nearby) -> Found:
    """Whether the ends lie on two sides of the plane and the segment passes through the triangle."""
    height = _heights(segments, corners)
    straddles = height[:, 0] * height[:, 1] < 0.0
    share = np.divide(
        height[:, 0], height[:, 0] - height[:, 1], out=np.zeros(len(height)), where=straddles
    )
    hit = segments[:, 0] + share[:, None] * (segments[:, 1] - segments[:, 0])
    normal = area_vectors(corners)
    inside = straddles
    for one, two in EDGES:
        side = np.cross(corners[:, two] - corners[:, one], hit - corners[:, one])
        inside = inside & (np.einsum("ni,ni->n", side, normal) >= 0.0)
    return inside


def _heights(
    points: Real[np.ndarray, "n some 3"], corners: Nearby
) -> Float64[np.ndarray, "n some"]:
    """Signed distance of points from the plane of each triangle [m]."""
    return np.einsum("npi,ni->np", points - corners[:, :1], unit(area_vectors(corners)))


def _parted(
    first: Some, second: Others, pairs: Pairs, shared: Bool[np.ndarray, "pairs 3"], tolerance: float
) -> Bool[np.ndarray, "pairs"]:
    """Whether all corners of the first triangle that are not shared lie on one side of the second's plane."""
    normals = unit(area_vectors(second))
    offsets = np.einsum("ti,ti->t", normals, second[:, 0])
    here, there = pairs.T
    height = np.einsum("pki,pi->pk", first[here], normals[there]) - offsets[there, None]
    return ((height > tolerance) | shared).all(axis=1) | ((height < -tolerance) | shared).all(
        axis=1
    )


def _turned(
    corners: Corners, members: Int64[np.ndarray, "n"], shared: Bool[np.ndarray, "n 3"]
) -> Nearby:
    """Corners of some triangles, the shared one in front, or the one that is not shared when there are two."""
    front = np.where(
        np.count_nonzero(shared, axis=1) == 2, shared.argmin(axis=1), shared.argmax(axis=1)
    )
    return corners[members[:, None], (front[:, None] + np.arange(3)) % 3]


def _strangers_meet(first: Nearby, second: Nearby, tolerance: float) -> Found:
    distance = np.full(len(first), np.inf)
    for edge in EDGES:
        distance = np.minimum(distance, segment_triangle_distances(first[:, edge], second))
        distance = np.minimum(distance, segment_triangle_distances(second[:, edge], first))
    return distance <= tolerance


def _fans_meet(first: Nearby, second: Nearby, tolerance: float) -> Found:
    """Whether triangles that share their first corner meet at an edge opposite it."""
    distance = segment_triangle_distances(first[:, 1:], second)
    return np.minimum(distance, segment_triangle_distances(second[:, 1:], first)) <= tolerance


def _folded(first: Nearby, second: Nearby, tolerance: float) -> Found:
    """Whether two triangles over the edge of their last two corners lie on each other."""
    flat = np.abs(_heights(first[:, :1], second)[:, 0]) <= tolerance
    along = unit(first[:, 2] - first[:, 1])
    up, over = first[:, 0] - first[:, 1], second[:, 0] - first[:, 1]
    up = up - np.einsum("ni,ni->n", up, along)[:, None] * along
    over = over - np.einsum("ni,ni->n", over, along)[:, None] * along
    return flat & (np.einsum("ni,ni->n", up, over) > 0.0)


def _pairs_within(corners: Corners, tolerance: float) -> Pairs:
    """Pairs i < j of triangles of one mesh whose boxes overlap."""
    groups = size_groups(corners)
    found = [np.zeros((0, 2), dtype=np.int64)]
    for rank, group in enumerate(groups):
        within = group.tree.query_pairs(2.0 * group.reach + tolerance, output_type="ndarray")
        found.append(group.members[within])
        found += [
            pairs_of_groups(group, other, group.reach + other.reach + tolerance)
            for other in groups[rank + 1 :]
        ]
    pairs = np.sort(np.concatenate(found), axis=1).astype(np.int64)
    return pairs[_boxes_overlap(corners, corners, pairs, tolerance)]


def _pairs_between(first: Some, second: Others, tolerance: float) -> Pairs:
    """Pairs of a triangle here and one there whose boxes overlap."""
    groups = product(size_groups(first), size_groups(second))
    pairs = np.concatenate(
        [pairs_of_groups(one, two, one.reach + two.reach + tolerance) for one, two in groups]
    )
    return pairs[_boxes_overlap(first, second, pairs, tolerance)]


def _boxes_overlap(
    first: Some, second: Others, pairs: Pairs, tolerance: float
) -> Bool[np.ndarray, "pairs"]:
    here, there = pairs.T
    (low, high), (bottom, top) = (
        (corners.min(axis=1), corners.max(axis=1)) for corners in (first, second)
    )
    overlap = np.ones(len(pairs), dtype=bool)
    for axis in range(3):
        overlap &= low[here, axis] <= top[there, axis] + tolerance
        overlap &= bottom[there, axis] <= high[here, axis] + tolerance
    return overlap


class Group(NamedTuple):
    """Triangles of like size: which, a tree of their centres, and how far their corners are from these at most [m]."""

    members: Int64[np.ndarray, "_"]
    tree: KDTree
    reach: float


def pairs_of_groups(one: Group, two: Group, within: float) -> Pairs:
    """Pairs of a triangle of each group whose centres are within a distance [m]."""
    table = one.tree.sparse_distance_matrix(two.tree, within, output_type="ndarray")
    return np.stack([one.members[table["i"]], two.members[table["j"]]], axis=1).astype(np.int64)


def size_groups(corners: Corners) -> tuple[Group, ...]:
    """Sort triangles by size, a factor of two in each group, so that one large one does not widen every search."""
    centres = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centres[:, None, :], axis=2).max(axis=1)
    size = np.floor(np.log2(reach)).astype(np.int64)
    groups = (np.flatnonzero(size == level) for level in np.unique(size))
    return tuple(
        Group(members, KDTree(centres[members]), float(reach[members].max())) for members in groups
    )
