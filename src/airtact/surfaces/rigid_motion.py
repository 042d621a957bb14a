"""Which rigid motion brings one surface onto another."""

import numpy as np

from airtact.pose import Pose, nearest_motion
from airtact.surfaces.surface import Surface


def rigid_motion(before: Surface, after: Surface) -> tuple[Pose, float]:
    """Find the rigid motion that brings a surface nearest to another of the same triangles.

    Least squares over the vertices.

    Parameters
    ----------
    before, after : the surface as it was, and as it is now.

    Returns
    -------
    The motion, and how far the vertex or the middle of an edge that fits worst is off [m]: infinite where the triangles
    are others, or curved in another way.
    """
    if before is after:
        return Pose.identity(), 0.0
    if before.triangles is not after.triangles and not np.array_equal(before.triangles, after.triangles):
        return Pose.identity(), float("inf")
    if len(before.vertices) != len(after.vertices) or not _curved_alike(before, after):
        return Pose.identity(), float("inf")
    pose = Pose(*nearest_motion(before.vertices, after.vertices))
    off = np.linalg.norm(pose.apply(before.vertices) - after.vertices, axis=1).max()
    if before.midpoints is not None and after.midpoints is not None:
        off = max(off, np.linalg.norm(pose.apply(before.midpoints) - after.midpoints, axis=2).max())
    return pose, float(off)


def _curved_alike(before: Surface, after: Surface) -> bool:
    """Whether two surfaces make their skin from their triangles in the same way."""
    return (
        type(before.primitive) is type(after.primitive)
        and (before.midpoints is None) == (after.midpoints is None)
        and before.sharp_degrees == after.sharp_degrees
    )
