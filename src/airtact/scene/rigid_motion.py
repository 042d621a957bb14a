"""Which rigid motion brings one surface onto another."""

import numpy as np
from jaxtyping import Float64

from airtact.scene.geometry import Surface
from airtact.scene.pose import Pose


def rigid_motion(before: Surface, after: Surface) -> tuple[Pose, float]:
    """Find the rigid motion that brings a surface nearest to another of the same triangles.

    Least squares over the vertices (W. Kabsch, Acta Crystallographica A32 (1976) 922).

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
    rotation, translation = _nearest(before.vertices, after.vertices)
    pose = Pose(rotation, translation)
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


def _nearest(
    before: Float64[np.ndarray, "points 3"], after: Float64[np.ndarray, "points 3"]
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]:
    middle, moved = before.mean(axis=0), after.mean(axis=0)
    left, _, right = np.linalg.svd((after - moved).T @ (before - middle))
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ proper @ right
    return rotation, moved - rotation @ middle
