"""Curved tetrahedra, and the search for the one that contains a point."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from airtact.acoustics.solvers.arrays import Barycentric, Indices, Points, Vectors
from airtact.printing import in_short

EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
"""Corners of the six edges of a tetrahedron."""

CANDIDATES = (4, 12, 40, 160, 640)
"""Numbers of tetrahedra with the nearest centres that are tried for a point, one after the other."""

INWARD = 0.85
"""Where tetrahedra are checked for folds: this part of the way from their centres to corners and midpoints."""

INSIDE = 1e-7
"""Barycentric coordinates may be this far below 0 inside a tetrahedron ..."""

BESIDE = 0.05
"""... and this far for a point in no tetrahedron: the meshed surface lies micrometres off the true one."""


@dataclass(frozen=True, eq=False)
class Tetrahedra:
    """Quadratic tetrahedra: corners, and offsets of the midpoints of the edges from the straight ones [λ]."""

    corners: Float64[np.ndarray, "tetrahedra 4 3"]
    bends: Float64[np.ndarray, "tetrahedra 6 3"]

    __repr__ = in_short

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.corners.mean(axis=1))

    def positions(self, number: Indices, weights: Barycentric) -> Vectors:
        """Points with barycentric coordinates (P, 4) of tetrahedra (P,) [λ]."""
        one, other = weights[:, EDGES[:, 0]], weights[:, EDGES[:, 1]]
        straight = np.einsum("pc,pcd->pd", weights, self.corners[number])
        return straight + 4 * np.einsum("pe,ped->pd", one * other, self.bends[number])

    def jacobians(self, number: Indices, weights: Barycentric) -> Float64[np.ndarray, "points 3 3"]:
        """Differentiate the position along the first three barycentric coordinates, as columns."""
        along = np.array(self.corners[number])
        for edge, (one, other) in enumerate(EDGES):
            bend = 4 * self.bends[number, edge]
            along[:, one] += weights[:, other, None] * bend
            along[:, other] += weights[:, one, None] * bend
        return (along[:, :3] - along[:, 3:]).transpose(0, 2, 1)

    def smallest_stretch(self) -> tuple[float, int]:
        """Smallest ratio of a volume element to that of the straight tetrahedron, and where; 0 or less is folded.

        It is taken a little inside: between two faces on a smooth surface the ratio is 0, which
        does no harm.
        """
        middles = 0.5 * (np.eye(4)[EDGES[:, 0]] + np.eye(4)[EDGES[:, 1]])
        smallest = np.full(len(self.corners), np.inf)
        every = np.arange(len(self.corners))
        flat = np.linalg.det((self.corners[:, :3] - self.corners[:, 3:]).transpose(0, 2, 1))
        for sample in INWARD * np.concatenate([np.eye(4), middles]) + (1 - INWARD) / 4:
            volume = np.linalg.det(self.jacobians(every, np.broadcast_to(sample, (len(flat), 4))))
            smallest = np.minimum(smallest, volume / flat)
        return float(smallest.min()), int(smallest.argmin())

    def holding(self, points: Points) -> tuple[Indices, Barycentric]:
        """Find the tetrahedron of each point (P, 3) [λ], -1 for none, and its barycentric coordinates there."""
        best = np.full(len(points), -1, dtype=np.int64)
        weights, depth = np.zeros((len(points), 4)), np.full(len(points), -np.inf)
        tried = 0
        for count in (min(count, len(self.corners)) for count in CANDIDATES):
            left = np.flatnonzero(depth < -INSIDE)
            if not len(left) or tried == count:
                break
            nearest = np.asarray(self._tree.query(points[left], k=count)[1]).reshape(
                len(left), count
            )
            for column in nearest.T[tried:]:
                open_ = depth[left] < -INSIDE
                some, number = left[open_], column[open_]
                found = self._weights(number, points[some])
                deeper = found.min(axis=1) > depth[some]
                chosen = some[deeper]
                best[chosen], weights[chosen], depth[chosen] = (
                    number[deeper],
                    found[deeper],
                    found[deeper].min(axis=1),
                )
            tried = count
        best[depth < -BESIDE] = -1
        return best, weights

    def _weights(self, number: Indices, points: Points) -> Barycentric:
        """Barycentric coordinates of points in given tetrahedra, by Newton's method where those are curved."""
        weights = np.full((len(points), 4), 0.25)
        bent = np.arange(len(points))
        for _ in range(6):
            off = points[bent] - self.positions(number[bent], weights[bent])
            step = np.linalg.solve(self.jacobians(number[bent], weights[bent]), off[:, :, None])[
                :, :, 0
            ]
            weights[bent, :3] += np.clip(step, -1e3, 1e3)
            weights[bent, 3] = 1 - weights[bent, :3].sum(axis=1)
            moving = (np.abs(step).max(axis=1) > 1e-12) & (np.abs(weights[bent]).max(axis=1) < 5)
            bent = bent[moving & (self.bends[number[bent]] != 0).any(axis=(1, 2))]
            if not len(bent):
                break
        return weights
