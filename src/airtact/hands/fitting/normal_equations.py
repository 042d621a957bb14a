"""The normal equations of a hand in a cloud, from rules, landmarks, silhouette and points.

Sources
-------
- A. E. Beaton, J. W. Tukey, Technometrics 16, 147 (1974): the weights of points that are far off.
- F. R. Hampel, J. Am. Stat. Assoc. 69, 383 (1974): the scale of the misfit from its median.
- A. Tkach, M. Pauly, A. Tagliasacchi, ACM Trans. Graph. 35, 222 (2016): the distance of a point x
  to a hull of balls is the least of |x - c(w)| - r(w) over the weights w of its balls; its
  derivatives there are -w n by the centres and -w by the radii, n pointing from c(w) to x. Section
  4.2: a point that a camera has seen belongs to skin that faces it, so that where the nearest skin
  of a hull faces away, the distance is taken from the front or the rim.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from airtact import _kernels
from airtact.hands.anatomy_parts import FREE, PARTS
from airtact.hands.fitting.joint_priors import (
    bend_rules,
    bending_axes,
    landmark_pull,
    length_rules,
    usual_last_bones,
)
from airtact.hands.fitting.silhouette import Silhouette
from airtact.hands.fitting.size_prior import HandAnatomy
from airtact.hands.fitting.unknowns import (
    BODY,
    BODY_BLOCK,
    JOINTS,
    SIZES,
    balls_at,
    by_body,
    joints_in,
)
from airtact.hands.joints import Side
from airtact.hands.sphere_mesh import Hulls

TUKEY = 4.685
"""Points off by more than this over the scale of the misfit have no weight."""

ALIKE = np.array([4.0, 12.0])
"""Points of fingers and of the palm that count as one: neighbouring misfits are alike, more so at the palm, which is
farther from hulls of balls."""

KIND = (np.arange(len(PARTS)) >= FREE).astype(np.int64)
"""0 for the hulls of fingers, 1 for those of the palm."""


@dataclass(frozen=True, eq=False)
class Observation:
    """What is known of a hand in one frame.

    Attributes
    ----------
    points : (N, 3) of its skin, averaged in cells [m].
    landmarks : (25, 3) rough joints [m].
    spread : (25,) standard deviation of each of their coordinates [m].
    side : "right" or "left".
    anatomy : what its sizes may be.
    camera : (3,) that saw the points [m], or None.
    silhouette : what that camera saw of the hand, or None.
    each : how many points each of these stands for.
    """

    points: Float64[np.ndarray, "points 3"]
    landmarks: Float64[np.ndarray, "25 3"]
    spread: Float64[np.ndarray, "25"]
    side: Side
    anatomy: HandAnatomy
    camera: Float64[np.ndarray, "3"] | None
    silhouette: Silhouette | None
    each: int = 1

    @cached_property
    def precision(self) -> Float64[np.ndarray, "62 62"]:
        """The inverse of the covariance of the sizes."""
        return np.linalg.inv(self.anatomy.covariance)


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
    points: Float64[np.ndarray, "points 3"],
    hulls: Hulls,
    camera: Float64[np.ndarray, "3"] | None = None,
) -> SkinResiduals:
    """Find the distances of points from the skin of a body, by the three nearest hulls, and their derivatives.

    Points that a ``camera`` (3,) [m] saw belong to skin that faces it.
    """
    count = len(points)
    found = SkinResiduals(
        np.empty(count), np.empty((count, hulls.balls.size)), np.empty(count, dtype=np.int64)
    )
    eye = np.zeros(0) if camera is None else np.ascontiguousarray(camera, dtype=np.float64)
    points = np.ascontiguousarray(points)
    _kernels.hull_gaps(points, hulls.balls, hulls.parts, hulls.blend, eye, FACING, *found)
    return found


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """The normal equations of a step, and what the cost is made of.

    Attributes
    ----------
    unknowns : (137,) where they hold.
    matrix, gradient : (137, 137) and (137,).
    squares : sum of squares of the rules.
    residuals : of the points.
    weights : (N,) of the points, 0 for outliers.
    scale : (2,) of the misfit at fingers and at the palm [m].
    each : how many points each of them stands for.
    """

    unknowns: Float64[np.ndarray, "137"]
    matrix: Float64[np.ndarray, "137 137"]
    gradient: Float64[np.ndarray, "137"]
    squares: float
    residuals: SkinResiduals
    weights: Float64[np.ndarray, "points"]
    scale: Float64[np.ndarray, "2"]
    each: int

    def cost(self, scale: Float64[np.ndarray, "2"], agreed: float = 1.0) -> float:
        """Half the sum of squares of the rules, weighted by ``agreed``, and Tukey's function of the points."""
        kind = KIND[self.residuals.hull]
        share = np.minimum((self.residuals.distance / (TUKEY * scale[kind])) ** 2, 1.0)
        points = float(((1.0 - (1.0 - share) ** 3) / ALIKE[kind]).sum())
        return 0.5 * agreed * self.squares + self.each * TUKEY**2 / 6.0 * points


def normal_equations(
    seen: Observation, joined_as: Hulls, unknowns: Float64[np.ndarray, "137"], floor: float
) -> NormalEquations:
    """Set up the normal equations at some unknowns; ``floor`` is the least scale of the misfit [m]."""
    matrix, gradient, squares = without_points(seen, unknowns)
    residuals, weights, scale = _misfit(seen, replace(joined_as, balls=balls_at(unknowns)), floor)
    kind = KIND[residuals.hull]
    part, pull = of_points(
        residuals, seen.each * weights / (ALIKE * scale**2)[kind], unknowns[SIZES]
    )
    matrix[BODY_BLOCK] += part
    gradient[BODY] += pull
    return NormalEquations(
        unknowns, matrix, gradient, squares, residuals, weights, scale, seen.each
    )


def without_points(
    seen: Observation, unknowns: Float64[np.ndarray, "137"]
) -> tuple[Float64[np.ndarray, "137 137"], Float64[np.ndarray, "137"], float]:
    """Set up the normal equations of all but the points: matrix, gradient, and twice the cost."""
    joints, sizes = joints_in(unknowns), unknowns[SIZES]
    axes = bending_axes(joints, seen.side)
    rules = (length_rules(joints, sizes), bend_rules(joints, axes, usual_last_bones(joints, axes)))
    residuals, gradients = (np.concatenate(part) for part in zip(*rules, strict=True))
    matrix, gradient = gradients.T @ gradients, gradients.T @ residuals
    off = joints - seen.landmarks
    weights, squares = landmark_pull(off, seen.spread)
    weights = np.repeat(weights**2, 3)
    matrix[JOINTS, JOINTS][np.diag_indices(len(weights))] += weights
    gradient[JOINTS] += weights * off.ravel()
    from_mean = sizes - seen.anatomy.mean
    matrix[SIZES, SIZES] += seen.precision
    gradient[SIZES] += seen.precision @ from_mean
    squares += float(residuals @ residuals + from_mean @ seen.precision @ from_mean)
    if seen.silhouette is not None:
        beyond, by_balls, cost = seen.silhouette.beyond(balls_at(unknowns))
        rows = by_body(by_balls, sizes)
        matrix[BODY_BLOCK] += rows.T @ rows
        gradient[BODY] += rows.T @ beyond
        squares += cost
    return matrix, gradient, squares


def of_points(
    residuals: SkinResiduals,
    weights: Float64[np.ndarray, "points"],
    sizes: Float64[np.ndarray, "62"],
) -> tuple[Float64[np.ndarray, "body body"], Float64[np.ndarray, "body"]]:
    """Set up the normal equations of points with some weights [1/m²]: matrix and gradient of the body's unknowns."""
    own = np.flatnonzero(weights)
    root = np.sqrt(weights[own])
    rows = residuals.by_balls[own] * root[:, None]
    pull = (root * residuals.distance[own]) @ rows
    both = by_body(np.vstack([rows.T @ rows, pull]), sizes)
    return by_body(np.ascontiguousarray(both[:-1].T), sizes), both[-1]


NORMAL = 1.4826
"""Standard deviation of a normal distribution over the median of its magnitudes."""

REACH = 15e-3
"""Points farther than this do not enter the scale of the misfit [m]."""

LEAST, MOST = 0.02e-3, 4e-3
"""Bounds of that scale [m]."""

FEW = 20
"""Fewer points of fingers, or of the palm, give no scale of their own misfit."""


def _misfit(
    seen: Observation, hulls: Hulls, floor: float
) -> tuple[SkinResiduals, Float64[np.ndarray, "points"], Float64[np.ndarray, "2"]]:
    """Find the residuals of the points, their weights, and the scales of the misfit [m]."""
    scale, residuals = np.full(2, MOST), skin_residuals(seen.points, hulls, seen.camera)
    off, kinds = np.abs(residuals.distance), KIND[residuals.hull]
    for kind in range(2):
        near = off[(off < REACH) & (kinds == kind)]
        near = near if len(near) >= FEW else off[off < REACH]
        if len(near):
            scale[kind] = np.clip(NORMAL * np.median(near), max(floor, LEAST), MOST)
    return residuals, np.maximum(1.0 - (off / (TUKEY * scale[kinds])) ** 2, 0.0) ** 2, scale
