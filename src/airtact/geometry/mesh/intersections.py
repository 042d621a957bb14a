"""Pairs of triangles of a mesh that cross or touch.

Two triangles meet if an edge of one meets the other. Neighbours always meet in their common corner
or edge. If triangles with a common corner also meet at another point, a ray from the corner to that
point leaves one of them at the edge opposite the corner. Only these edges are tested. Triangles
with a common edge cross only if they are folded flat onto each other.
"""

from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Bool, Int64, Real
from scipy.spatial import KDTree

from airtact.geometry.mesh.triangles import (
    Corners,
    IndexPairs,
    PairedCorners,
    PairMask,
    Triangles,
    area_vectors,
    unit,
)

_EDGES = ([0, 1], [1, 2], [2, 0])


def self_crossings(corners: Corners, triangles: Triangles) -> IndexPairs:
    """Return the sorted pairs of triangles that cross or touch beyond their shared corners."""
    # Triangles touch if they are closer than the rounding of positions in a mesh of this extent.
    tolerance = 1e-9 * float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    pairs = _pairs_within(corners, tolerance)
    normals = unit(area_vectors(corners))
    for order in (1, -1):
        first, second = pairs[:, ::order].T
        heights = np.einsum("pki,pi->pk", corners[first] - corners[second, :1], normals[second])
        shared = _same_corners(triangles, first, second).any(axis=2)
        above = ((heights > tolerance) | shared).all(axis=1)
        below = ((heights < -tolerance) | shared).all(axis=1)
        pairs = pairs[~(above | below)]
    same = _same_corners(triangles, *pairs.T)
    count = np.count_nonzero(same, axis=(1, 2))
    crossing = np.zeros(len(pairs), dtype=bool)
    for shared, test in ((0, _strangers_meet), (1, _corner_neighbours_meet), (2, _folded)):
        chosen = np.flatnonzero(count == shared)
        first = _turned(corners, pairs[chosen, 0], same[chosen].max(axis=2))
        second = _turned(corners, pairs[chosen, 1], same[chosen].max(axis=1))
        crossing[chosen] = test(first, second, tolerance)
    pairs = pairs[crossing]
    return pairs[np.lexsort(pairs.T[::-1])]


def _same_corners(
    triangles: Triangles, first: Int64[np.ndarray, "pairs"], second: Int64[np.ndarray, "pairs"]
) -> Bool[np.ndarray, "pairs 3 3"]:
    return triangles[first][:, :, None] == triangles[second][:, None, :]


def _turned(
    corners: Corners, members: Int64[np.ndarray, "n"], shared: Bool[np.ndarray, "n 3"]
) -> PairedCorners:
    """Return triangles' corners, starting at the shared one, or at the third if two are shared."""
    front = np.where(
        np.count_nonzero(shared, axis=1) == 2, shared.argmin(axis=1), shared.argmax(axis=1)
    )
    return corners[members[:, None], (front[:, None] + np.arange(3)) % 3]


def _pierces(
    segments: Real[np.ndarray, "n 2 3"], corners: PairedCorners, tolerance: float
) -> PairMask:
    """Return whether each segment meets its triangle; segments in the triangle's plane do not."""
    normal = unit(area_vectors(corners))
    heights = np.einsum("npi,ni->np", segments - corners[:, :1], normal)
    crosses = (heights.min(axis=1) <= tolerance) & (heights.max(axis=1) >= -tolerance)
    rise = heights[:, 0] - heights[:, 1]
    crosses &= np.abs(rise) > tolerance
    share = np.divide(heights[:, 0], rise, out=np.zeros(len(rise)), where=crosses)
    hit = segments[:, 0] + np.clip(share, 0, 1)[:, None] * (segments[:, 1] - segments[:, 0])
    for start, end in _EDGES:
        inward = np.cross(normal, unit(corners[:, end] - corners[:, start]))
        crosses &= np.einsum("ni,ni->n", inward, hit - corners[:, start]) >= -tolerance
    return crosses


def _strangers_meet(first: PairedCorners, second: PairedCorners, tolerance: float) -> PairMask:
    meet = np.zeros(len(first), dtype=bool)
    for edge in _EDGES:
        meet |= _pierces(first[:, edge], second, tolerance)
        meet |= _pierces(second[:, edge], first, tolerance)
    return meet


def _corner_neighbours_meet(
    first: PairedCorners, second: PairedCorners, tolerance: float
) -> PairMask:
    return _pierces(first[:, 1:], second, tolerance) | _pierces(second[:, 1:], first, tolerance)


def _folded(first: PairedCorners, second: PairedCorners, tolerance: float) -> PairMask:
    """Return whether triangles that share their last two corners are folded onto each other."""
    normal = unit(area_vectors(second))
    height = np.einsum("ni,ni->n", first[:, 0] - second[:, 0], normal)
    # Folded triangles are on the same side of the common edge.
    along = first[:, 2] - first[:, 1]
    inward = [np.cross(along, corners[:, 0] - first[:, 1]) for corners in (first, second)]
    return (np.abs(height) <= tolerance) & (np.einsum("ni,ni->n", *inward) > 0.0)


def _pairs_within(corners: Corners, tolerance: float) -> IndexPairs:
    centres = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centres[:, None, :], axis=2).max(axis=1)
    # Triangles are grouped by size, because one large triangle would widen the search for all.
    size = np.floor(np.log2(reach))
    groups = []
    for level in np.unique(size):
        members = np.flatnonzero(size == level)
        groups.append((members, KDTree(centres[members]), float(reach[members].max())))
    pairs_by_size = []
    for (first, tree, radius), (second, other, other_radius) in combinations_with_replacement(
        groups, 2
    ):
        near = tree.sparse_distance_matrix(
            other, radius + other_radius + tolerance, output_type="ndarray"
        )
        pairs = np.stack([first[near["i"]], second[near["j"]]], axis=1)
        pairs_by_size.append(pairs[pairs[:, 0] < pairs[:, 1]] if tree is other else pairs)
    pairs = np.sort(np.concatenate(pairs_by_size), axis=1)
    low = corners.min(axis=1) - tolerance
    high = corners.max(axis=1)
    for axis in range(3):  # one axis at a time, without copies of (pairs, 3)
        i, j = pairs.T
        overlap = (low[i, axis] <= high[j, axis]) & (low[j, axis] <= high[i, axis])
        pairs = pairs[overlap]
    return pairs.astype(np.int64)
