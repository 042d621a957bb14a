"""Curved tetrahedra, and the search for the one that contains a point."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from airtact.acoustics.solvers.arrays import Barycentric, Indices, Points, Vectors

# Corners of the six edges of a tetrahedron
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])

# Smallest barycentric coordinate of a point that is inside a tetrahedron for certain
INSIDE = -1e-7


@dataclass(frozen=True, eq=False, repr=False)
class Tetrahedra:
    """Quadratic tetrahedra: corners, and offsets of the midpoints of the edges [λ]."""

    corners: Float64[np.ndarray, "tetrahedra 4 3"]
    bends: Float64[np.ndarray, "tetrahedra 6 3"]

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.corners.mean(axis=1))

    def positions(self, number: Indices, weights: Barycentric) -> Vectors:
        """Points with barycentric coordinates (P, 4) of tetrahedra (P,) [λ]."""
        products = weights[:, EDGES[:, 0]] * weights[:, EDGES[:, 1]]
        straight = np.einsum("pc,pcd->pd", weights, self.corners[number])
        return straight + 4 * np.einsum("pe,ped->pd", products, self.bends[number])

    def jacobians(self, number: Indices, weights: Barycentric) -> Float64[np.ndarray, "points 3 3"]:
        """Differentiate the position along the first three barycentric coordinates, as columns."""
        along = np.array(self.corners[number])
        for edge, (start, end) in enumerate(EDGES):
            bend = 4 * self.bends[number, edge]
            along[:, start] += weights[:, end, None] * bend
            along[:, end] += weights[:, start, None] * bend
        return (along[:, :3] - along[:, 3:]).transpose(0, 2, 1)

    def smallest_stretch(self) -> tuple[float, int]:
        """Smallest ratio of a volume element to that of the straight tetrahedron, and where.

        0 or less is folded.

        It is sampled 15 % of the way in from the corners and midpoints: between two faces on a
        smooth surface the ratio is 0, which does no harm.
        """
        midpoints = 0.5 * (np.eye(4)[EDGES[:, 0]] + np.eye(4)[EDGES[:, 1]])
        samples = 0.85 * np.concatenate([np.eye(4), midpoints]) + 0.15 / 4
        every = np.arange(len(self.corners))
        flat = np.linalg.det((self.corners[:, :3] - self.corners[:, 3:]).transpose(0, 2, 1))
        smallest = np.full(len(every), np.inf)
        for sample in samples:
            weights = np.broadcast_to(sample, (len(every), 4))
            smallest = np.minimum(smallest, np.linalg.det(self.jacobians(every, weights)) / flat)
        return float(smallest.min()), int(smallest.argmin())

    def holding(self, points: Points) -> tuple[Indices, Barycentric]:
        """Tetrahedron of each point (P, 3) [λ], -1 for none, and barycentric coordinates.

        The tetrahedra with the nearest centres are tried, more and more of them for the points that
        are still outside all.
        """
        best = np.full(len(points), -1, dtype=np.int64)
        weights = np.zeros((len(points), 4))
        depth = np.full(len(points), -np.inf)
        tried = 0
        for candidates in (4, 12, 40, 160, 640):
            count = min(candidates, len(self.corners))
            outside = np.flatnonzero(depth < INSIDE)
            if not len(outside) or tried == count:
                break
            nearest = np.asarray(self._tree.query(points[outside], k=count)[1])
            for column in nearest.reshape(len(outside), count).T[tried:]:
                still = depth[outside] < INSIDE
                index = outside[still]
                number = column[still]
                candidate = self._weights(number, points[index])
                smallest = candidate.min(axis=1)
                deeper = smallest > depth[index]
                chosen = index[deeper]
                best[chosen] = number[deeper]
                weights[chosen] = candidate[deeper]
                depth[chosen] = smallest[deeper]
            tried = count
        # The meshed surface lies micrometres off the true one, so a point beside a tetrahedron
        # belongs to it.
        best[depth < -0.05] = -1
        return best, weights

    def _weights(self, number: Indices, points: Points) -> Barycentric:
        """Barycentric coordinates, by Newton's method in curved tetrahedra."""
        weights = np.full((len(points), 4), 0.25)
        bent = np.arange(len(points))
        for _ in range(6):
            off = points[bent] - self.positions(number[bent], weights[bent])
            jacobians = self.jacobians(number[bent], weights[bent])
            # One step is exact in a straight tetrahedron.
            step = np.linalg.solve(jacobians, off[:, :, None])[:, :, 0]
            weights[bent, :3] += np.clip(step, -1e3, 1e3)
            weights[bent, 3] = 1 - weights[bent, :3].sum(axis=1)
            moving = (np.abs(step).max(axis=1) > 1e-12) & (np.abs(weights[bent]).max(axis=1) < 5)
            bent = bent[moving & (self.bends[number[bent]] != 0).any(axis=(1, 2))]
            if not len(bent):
                break
        return weights
