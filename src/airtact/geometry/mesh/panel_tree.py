"""A tree of boxes around curved panels that finds the panel closest to a point."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from airtact import _kernels
from airtact.geometry.mesh.triangles import PointLengths, Points, QuadraticTriangles

BoxCorners = Float64[np.ndarray, "boxes 3"]


@dataclass(frozen=True, eq=False)
class PanelTree:
    """A binary tree of boxes around curved panels.

    The corners of the boxes, ``lower`` and ``upper`` [m], are stored as a heap: box 1 contains all
    panels, and box b contains boxes 2 b and 2 b + 1. The leaves contain the panels in ``order``.
    """

    quadratic_triangles: QuadraticTriangles
    order: Int64[np.ndarray, "panels"]
    lower: BoxCorners
    upper: BoxCorners

    @cached_property
    def _near(self) -> float:
        """Radius [m] of the first search for the closest panel: 1/20 of the median leaf size."""
        leaves = len(self.lower) // 2
        return 0.05 * float(np.median((self.upper - self.lower)[leaves:].max(axis=1)))

    def closest(
        self, points: Points, within: PointLengths | None = None
    ) -> tuple[Int64[np.ndarray, "points"], Float64[np.ndarray, "points 2"], PointLengths]:
        """Return the panel closest to each point (P, 3), the closest point on it, and its distance.

        The closest point is in reference coordinates, and the distance in metres. If no panel is
        closer than ``within`` [m], the panel is arbitrary and the distance infinite.
        """
        tree = (self.quadratic_triangles, self.order, self.lower, self.upper)
        if within is not None:
            return _kernels.closest_on_panels(points, *tree, within)
        # Most points are near the surface. A search in a small radius takes half the time, because
        # it visits no distant panels before the closest one.
        panel, reference, distance = _kernels.closest_on_panels(
            points, *tree, np.full(len(points), self._near)
        )
        rest = np.flatnonzero(np.isinf(distance))
        if len(rest):
            panel[rest], reference[rest], distance[rest] = _kernels.closest_on_panels(
                np.ascontiguousarray(points[rest]), *tree, None
            )
        return panel, reference, distance


def panel_tree(panels: QuadraticTriangles) -> PanelTree:
    """Sort panels (T, 6, 3) by position, and build boxes around them by repeated halving."""
    panels = np.ascontiguousarray(panels)
    corners = panels[:, :3]
    # A quadratic panel lies in the convex hull of its Bézier control points.
    control_points = 2 * panels[:, 3:] - 0.5 * (corners + np.roll(corners, -1, axis=1))
    hull = np.concatenate([corners, control_points], axis=1)
    order = KDTree(panels.mean(axis=1), leafsize=1).indices.astype(np.int64)
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
