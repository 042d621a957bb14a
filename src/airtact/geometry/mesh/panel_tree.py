"""Curved panels in a tree of boxes that finds the closest one."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64, Real

from airtact import _kernels
from airtact.geometry.mesh.quadratic_triangles import QuadraticTriangles


@dataclass(frozen=True, eq=False)
class PanelTree:
    """Curved panels in a binary tree of boxes, whose leaves hold them in an ``order``.

    The corners of the boxes ``lower`` and ``upper`` [m] are a heap: box 1 holds all, box b holds 2
    b and 2 b + 1.
    """

    quadratic_triangles: QuadraticTriangles
    order: Int64[np.ndarray, "panels"]
    lower: Float64[np.ndarray, "boxes 3"]
    upper: Float64[np.ndarray, "boxes 3"]

    def closest(
        self,
        points: Real[np.ndarray, "points 3"],
        within: Float64[np.ndarray, "points"] | None = None,
    ) -> tuple[
        Int64[np.ndarray, "points"], Float64[np.ndarray, "points 2"], Float64[np.ndarray, "points"]
    ]:
        """Find for points (P, 3) [m] the closest panel, its reference coordinates there, and how far it is [m].

        Where no panel is nearer than ``within`` [m], any may be returned, infinitely far.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        panel, reference = np.zeros(len(points), dtype=np.int64), np.zeros((len(points), 2))
        distance = (
            np.full(len(points), np.inf) if within is None else np.array(within, dtype=np.float64)
        )
        _kernels.closest_on_panels(
            points,
            self.quadratic_triangles,
            self.order,
            self.lower,
            self.upper,
            panel,
            reference,
            distance,
        )
        return panel, reference, distance


def panel_tree(quadratic_triangles: QuadraticTriangles) -> PanelTree:
    """Sort panels (T, 6, 3) along a space-filling curve and box them by halves."""
    quadratic_triangles = np.ascontiguousarray(quadratic_triangles)
    corners, middles = quadratic_triangles[:, :3], quadratic_triangles[:, 3:]
    hull = np.concatenate(
        [corners, 2 * middles - 0.5 * (corners + np.roll(corners, -1, axis=1))], axis=1
    )
    order = np.argsort(_morton(quadratic_triangles.mean(axis=1)), kind="stable")
    leaves = 1 << (len(order) - 1).bit_length()
    padded = np.full(leaves, order[-1])
    padded[: len(order)] = order
    lower, upper = np.empty((2 * leaves, 3)), np.empty((2 * leaves, 3))
    lower[0] = upper[0] = 0.0
    lower[leaves:], upper[leaves:] = hull.min(axis=1)[padded], hull.max(axis=1)[padded]
    while leaves > 1:
        leaves //= 2
        lower[leaves : 2 * leaves] = (
            lower[2 * leaves : 4 * leaves].reshape(leaves, 2, 3).min(axis=1)
        )
        upper[leaves : 2 * leaves] = (
            upper[2 * leaves : 4 * leaves].reshape(leaves, 2, 3).max(axis=1)
        )
    return PanelTree(quadratic_triangles, order, lower, upper)


def _morton(points: Float64[np.ndarray, "points 3"]) -> Int64[np.ndarray, "points"]:
    """Count points along a Z-order curve through their box (G. M. Morton, IBM report, 1966)."""
    low = points.min(axis=0)
    cell = np.max(points.max(axis=0) - low) / (2**20 - 1)
    grid = ((points - low) / (cell if cell > 0 else 1)).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for axis in range(3):
        bits = grid[:, axis]
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            bits = (bits | (bits << shift)) & mask
        code |= bits << axis
    return code
