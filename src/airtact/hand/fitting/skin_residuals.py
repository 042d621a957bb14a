"""Distances of the points of a cloud from the skin of a hand, and their derivatives by its balls.

The distance of a point x to a hull of balls is the least of |x - c(w)| - r(w) over the weights w of its balls. At that
least w, the derivatives by the centres are -w n and those by the radii -w, with n the direction from c(w) to x
(A. Tkach, M. Pauly, A. Tagliasacchi, ACM Trans. Graph. 35, 222 (2016)). A point that a camera has seen belongs to skin
that faces it: where the nearest skin of a hull faces away, the distance is taken from the front or the rim, section 4.2
there.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from airtact import _kernels
from airtact.hand.sphere_mesh import Hulls

FACING = -0.05
"""Cosine to the line of sight below which skin faces away from the camera."""


class SkinResiduals(NamedTuple):
    """Signed distances of points (N,) from the skin that they belong to, and their derivatives.

    Attributes
    ----------
    distance : (N,) [m].
    by_balls : (N, 104) derivatives by centre and radius of each ball.
    hull : (N,) the hull that each belongs to.
    """

    distance: Float64[np.ndarray, "points"]
    by_balls: Float64[np.ndarray, "points numbers"]
    hull: Int64[np.ndarray, "points"]


def skin_residuals(
    points: Float64[np.ndarray, "points 3"], hulls: Hulls, camera: Float64[np.ndarray, "3"] | None = None
) -> SkinResiduals:
    """Find the distances of points from the skin of a blended body, and their derivatives by its balls.

    Only the three nearest hulls of each point are evaluated.

    Parameters
    ----------
    points : (N, 3) [m].
    hulls : the body.
    camera : (3,) that saw the points [m], which then belong to skin that faces it; None for any skin.
    """
    count = len(points)
    found = SkinResiduals(np.empty(count), np.empty((count, hulls.balls.size)), np.empty(count, dtype=np.int64))
    eye = np.zeros(0) if camera is None else np.ascontiguousarray(camera, dtype=np.float64)
    points = np.ascontiguousarray(points)
    _kernels.hull_gaps(points, hulls.balls, hulls.parts, hulls.blend, eye, FACING, *found)
    return found
