"""Where triangles cross or touch, by a triangle-triangle test over a tree, on plain arrays.

Two triangles meet when an edge of one pierces the other or comes within a tolerance of it. Neighbours in a mesh share a
corner or an edge, and meet there by right; they cross only where they meet beyond it: a ray from the shared corner
through the common points leaves one of the two triangles by the edge opposite that corner, so it is enough to ask
whether that edge meets the other triangle. Triangles that share an edge cross only when folded flat onto each other.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int, Int64, Real
from scipy.spatial import KDTree

from airtact.mesh.mesh_distance import segment_to_triangle
from airtact.mesh.quadratic_triangles import area_vectors

CLOSE = 1e-9
"""Triangles nearer than this share of the whole extent touch."""

_EDGES = ([0, 1], [1, 2], [2, 0])


def self_crossings(
    corners: Real[np.ndarray, "triangles 3 3"], triangles: Int[np.ndarray, "triangles 3"]
) -> Int64[np.ndarray, "crossings 2"]:
    """Find pairs of triangles of one mesh that cross or touch beyond what they share; in ascending order."""
    tolerance = CLOSE * float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    pairs = _pairs_within(corners, tolerance)
    same = _same_corners(triangles, pairs)
    pairs = pairs[~_parted(corners, corners, pairs, same.max(axis=2), tolerance)]
    same = _same_corners(triangles, pairs)
    pairs = pairs[~_parted(corners, corners, pairs[:, ::-1], same.max(axis=1), tolerance)]
    same = _same_corners(triangles, pairs)
    shared = np.count_nonzero(same.reshape(-1, 9), axis=1)
    crossing = np.zeros(len(pairs), dtype=bool)
    for count, test in ((0, _strangers_meet), (1, _fans_meet), (2, _folded)):
        some = np.flatnonzero(shared == count)
        first = _turned(corners, pairs[some, 0], same[some].max(axis=2))
        second = _turned(corners, pairs[some, 1], same[some].max(axis=1))
        crossing[some] = test(first, second, tolerance)
    found = pairs[crossing]
    return found[np.lexsort(found.T[::-1])]


def _same_corners(
    triangles: Int[np.ndarray, "triangles 3"], pairs: Int64[np.ndarray, "pairs 2"]
) -> Bool[np.ndarray, "pairs 3 3"]:
    """Which corner of the first triangle is which of the second."""
    return triangles[pairs[:, 0]][:, :, None] == triangles[pairs[:, 1]][:, None, :]


def crossings_between(
    first: Real[np.ndarray, "some 3 3"], second: Real[np.ndarray, "others 3 3"]
) -> Int64[np.ndarray, "crossings 2"]:
    """Find pairs of triangles of two meshes that cross or touch: (K, 2) index in the first and in the second."""
    tolerance = CLOSE * float(np.ptp(np.concatenate([first, second]).reshape(-1, 3), axis=0).max())
    pairs = _pairs_between(first, second, tolerance)
    nothing = np.zeros((len(pairs), 3), dtype=bool)
    parted = _parted(first, second, pairs, nothing, tolerance) | _parted(
        second, first, pairs[:, ::-1], nothing, tolerance
    )
    pairs = pairs[~parted]
    return pairs[_strangers_meet(first[pairs[:, 0]], second[pairs[:, 1]], tolerance)]


def segment_triangle_distances(
    segments: Real[np.ndarray, "n 2 3"], corners: Real[np.ndarray, "n 3 3"]
) -> Float64[np.ndarray, "n"]:
    """Distance of segment and triangle, pair by pair [m]; 0 where the segment pierces the triangle."""
    distance = segment_to_triangle(segments, corners)[0]
    distance[_pierces(segments, corners)] = 0.0
    return distance


def _pierces(segments: Real[np.ndarray, "n 2 3"], corners: Real[np.ndarray, "n 3 3"]) -> Bool[np.ndarray, "n"]:
    """Whether the ends lie on two sides of the plane and the segment passes through the triangle."""
    height = _heights(segments, corners)
    straddles = height[:, 0] * height[:, 1] < 0.0
    share = np.divide(height[:, 0], height[:, 0] - height[:, 1], out=np.zeros(len(height)), where=straddles)
    hit = segments[:, 0] + share[:, None] * (segments[:, 1] - segments[:, 0])
    normal = area_vectors(corners)
    inside = straddles
    for one, two in _EDGES:
        side = np.cross(corners[:, two] - corners[:, one], hit - corners[:, one])
        inside = inside & (np.einsum("ni,ni->n", side, normal) >= 0.0)
    return inside


def _heights(points: Real[np.ndarray, "n some 3"], corners: Real[np.ndarray, "n 3 3"]) -> Float64[np.ndarray, "n some"]:
    """Signed distance of points from the plane of each triangle [m]."""
    normal = area_vectors(corners)
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.einsum("npi,ni->np", points - corners[:, :1], normal)


def _parted(
    first: Real[np.ndarray, "some 3 3"],
    second: Real[np.ndarray, "others 3 3"],
    pairs: Int64[np.ndarray, "pairs 2"],
    shared: Bool[np.ndarray, "pairs 3"],
    tolerance: float,
) -> Bool[np.ndarray, "pairs"]:
    """Whether all corners of the first triangle that are not shared lie on one side of the second's plane."""
    normals = area_vectors(second)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.einsum("ti,ti->t", normals, second[:, 0])
    here, there = pairs.T
    height = np.einsum("pki,pi->pk", first[here], normals[there]) - offsets[there, None]
    return ((height > tolerance) | shared).all(axis=1) | ((height < -tolerance) | shared).all(axis=1)


def _turned(
    corners: Real[np.ndarray, "triangles 3 3"], members: Int64[np.ndarray, "n"], shared: Bool[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3 3"]:
    """Corners of some triangles, the shared one in front, or the one that is not shared when there are two."""
    front = np.where(np.count_nonzero(shared, axis=1) == 2, shared.argmin(axis=1), shared.argmax(axis=1))
    return corners[members[:, None], (front[:, None] + np.arange(3)) % 3]


def _strangers_meet(
    first: Real[np.ndarray, "n 3 3"], second: Real[np.ndarray, "n 3 3"], tolerance: float
) -> Bool[np.ndarray, "n"]:
    distance = np.full(len(first), np.inf)
    for edge in _EDGES:
        distance = np.minimum(distance, segment_triangle_distances(first[:, edge], second))
        distance = np.minimum(distance, segment_triangle_distances(second[:, edge], first))
    return distance <= tolerance


def _fans_meet(
    first: Real[np.ndarray, "n 3 3"], second: Real[np.ndarray, "n 3 3"], tolerance: float
) -> Bool[np.ndarray, "n"]:
    """Whether triangles that share their first corner meet at an edge opposite it."""
    distance = segment_triangle_distances(first[:, 1:], second)
    return np.minimum(distance, segment_triangle_distances(second[:, 1:], first)) <= tolerance


def _folded(
    first: Real[np.ndarray, "n 3 3"], second: Real[np.ndarray, "n 3 3"], tolerance: float
) -> Bool[np.ndarray, "n"]:
    """Whether two triangles over the edge of their last two corners lie on each other."""
    flat = np.abs(_heights(first[:, :1], second)[:, 0]) <= tolerance
    along = first[:, 2] - first[:, 1]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    up, over = first[:, 0] - first[:, 1], second[:, 0] - first[:, 1]
    up = up - np.einsum("ni,ni->n", up, along)[:, None] * along
    over = over - np.einsum("ni,ni->n", over, along)[:, None] * along
    return flat & (np.einsum("ni,ni->n", up, over) > 0.0)


def _pairs_within(corners: Real[np.ndarray, "triangles 3 3"], tolerance: float) -> Int64[np.ndarray, "pairs 2"]:
    """Pairs i < j of triangles of one mesh whose boxes overlap."""
    groups = size_groups(corners)
    found = [np.zeros((0, 2), dtype=np.int64)]
    for rank, (members, tree, reach) in enumerate(groups):
        within = tree.query_pairs(2.0 * reach + tolerance, output_type="ndarray")
        found.append(members[within])
        found.extend(_pairs_of_groups((members, tree, reach), other, tolerance) for other in groups[rank + 1 :])
    pairs = np.sort(np.concatenate(found), axis=1).astype(np.int64)
    return pairs[_boxes_overlap(corners, corners, pairs, tolerance)]


def _pairs_between(
    first: Real[np.ndarray, "some 3 3"], second: Real[np.ndarray, "others 3 3"], tolerance: float
) -> Int64[np.ndarray, "pairs 2"]:
    """Pairs of a triangle here and one there whose boxes overlap."""
    there = size_groups(second)
    found = [_pairs_of_groups(one, two, tolerance) for one in size_groups(first) for two in there]
    pairs = np.concatenate(found)
    return pairs[_boxes_overlap(first, second, pairs, tolerance)]


def _pairs_of_groups(one: tuple, two: tuple, tolerance: float) -> Int64[np.ndarray, "pairs 2"]:
    reach = one[2] + two[2] + tolerance
    table = one[1].sparse_distance_matrix(two[1], reach, output_type="ndarray")
    return np.stack([one[0][table["i"]], two[0][table["j"]]], axis=1).astype(np.int64)


def _boxes_overlap(
    first: Real[np.ndarray, "some 3 3"],
    second: Real[np.ndarray, "others 3 3"],
    pairs: Int64[np.ndarray, "pairs 2"],
    tolerance: float,
) -> Bool[np.ndarray, "pairs"]:
    here, there = pairs.T
    (low, high), (bottom, top) = ((corners.min(axis=1), corners.max(axis=1)) for corners in (first, second))
    overlap = np.ones(len(pairs), dtype=bool)
    for axis in range(3):
        overlap &= low[here, axis] <= top[there, axis] + tolerance
        overlap &= bottom[there, axis] <= high[here, axis] + tolerance
    return overlap


def size_groups(corners: Real[np.ndarray, "triangles 3 3"]) -> tuple[tuple[Int64[np.ndarray, "_"], KDTree, float], ...]:
    """Sort triangles by size, a factor of two in each group, so that one large one does not widen every search.

    Returns
    -------
    For each group the triangles in it, the tree of their centres and the largest distance of a corner from its centre.
    """
    centres = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centres[:, None, :], axis=2).max(axis=1)
    size = np.floor(np.log2(reach)).astype(np.int64)
    groups = (np.flatnonzero(size == level) for level in np.unique(size))
    return tuple((members, KDTree(centres[members]), float(reach[members].max())) for members in groups)
