"""A tree of boxes around curved panels that finds the panel closest to a point."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from airtact import _kernels
from airtact.geometry.mesh.arrays import PointLengths, Points, QuadraticTriangles

BoxCorners = Float64[np.ndarray, "boxes 3"]


@dataclass(frozen=True, eq=False)
class PanelTree:
    """A binary tree of boxes around curved panels.

    The corners of the boxes ``lower`` and ``upper`` [m] are stored as a heap: box 1 holds all
    panels, box b the boxes 2 b and 2 b + 1. The leaves hold the panels in the given ``order``.
    """

    quadratic_triangles: QuadraticTriangles
    order: Int64[np.ndarray, "panels"]
    lower: BoxCorners
    upper: BoxCorners

    def closest(
        self, points: Points, within: PointLengths | None = None
    ) -> tuple[Int64[np.ndarray, "points"], Float64[np.ndarray, "points 2"], PointLengths]:
        """Closest panel of points (P, 3) [m], reference coordinates there, and distances [m].

        Where no panel is nearer than ``within`` [m], the panel is arbitrary and the distance
        infinite.
        """
        return _kernels.closest_on_panels(
            points, self.quadratic_triangles, self.order, self.lower, self.upper, within
        )


def panel_tree(panels: QuadraticTriangles) -> PanelTree:
    """Sort panels (T, 6, 3) along a space-filling curve and build boxes around them by halves."""
    panels = np.ascontiguousarray(panels)
    corners = panels[:, :3]
    # A quadratic panel lies in the convex hull of its Bézier control points.
    control_points = 2 * panels[:, 3:] - 0.5 * (corners + np.roll(corners, -1, axis=1))
    hull = np.concatenate([corners, control_points], axis=1)
    order = np.argsort(_morton(panels.mean(axis=1)), kind="stable")
    leaves = 1 << (len(order) - 1).bit_length()
    padded = np.full(leaves, order[-1])
    padded[: len(order)] = order
    lower = np.zeros((2 * leaves, 3))
    upper = np.zeros((2 * leaves, 3))
    lower[leaves:] = hull.min(axis=1)[padded]
    upper[leaves:] = hull.max(axis=1)[padded]
    while leaves > 1:
        children = slice(leaves, 2 * leaves)
        leaves //= 2
        parents = slice(leaves, 2 * leaves)
        lower[parents] = lower[children].reshape(leaves, 2, 3).min(axis=1)
        upper[parents] = upper[children].reshape(leaves, 2, 3).max(axis=1)
    return PanelTree(panels, order, lower, upper)


def _morton(points: Float64[np.ndarray, "points 3"]) -> Int64[np.ndarray, "points"]:
    """Order of points along a Z-order curve through their box (G. M. Morton, IBM report, 1966)."""
    low = points.min(axis=0)
    cell = np.max(points.max(axis=0) - low) / (2**20 - 1)
    grid = ((points - low) / (cell if cell > 0 else 1)).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for axis in range(3):
        bits = grid[:, axis]
        # Spread the bits three apart, in steps of halved distance.
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
