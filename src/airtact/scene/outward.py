"""Which way is out of a body."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float64, Real

UPWARD = np.array([0.0, 0.0, 1.0])
"""The direction where none is further from a skin than another."""

STEP = 1e-4
"""Over which the depth is differentiated [m]."""


def outward(
    depth: Callable[[Float64[np.ndarray, "places 3"]], Float64[np.ndarray, "places"]],
    points: Real[np.ndarray, "points 3"],
) -> Float64[np.ndarray, "points 3"]:
    """Find unit directions in which a depth falls fastest: away from the nearest skin; z midway between two.

    Parameters
    ----------
    depth : of points, as ``Surface.depth`` and ``Scene.depth``.
    points : (P, 3) [m].
    """
    shifts = STEP * np.concatenate([np.eye(3), -np.eye(3)])
    around = depth((points[:, None] + shifts).reshape(-1, 3)).reshape(-1, 6)
    slopes = around[:, 3:] - around[:, :3]
    length = np.linalg.norm(slopes, axis=1, keepdims=True)
    return np.where(length > 0, slopes / np.where(length > 0, length, 1), UPWARD)
