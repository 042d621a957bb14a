"""Robust Gauss-Newton fit of a hand to a point cloud.

Sources
-------
- A. E. Beaton, J. W. Tukey, Technometrics 16, 147 (1974): weights that reject outliers.
- F. R. Hampel, J. Am. Stat. Assoc. 69, 383 (1974): scale of the misfit from its median.
- A. Tkach, M. Pauly, A. Tagliasacchi, ACM Trans. Graph. 35, 222 (2016): the distance of a point x
  from a hull of balls is the minimum of |x - c(w)| - r(w) over all weights w of its balls. Its
  derivatives are -w n with respect to the centres and -w with respect to the radii, where n points
  from c(w) to x. Section 4.2: a point seen by a camera belongs to skin that faces the camera. If
  the nearest skin of a hull faces away, the distance from the front or the rim is used.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import cho_factor, cho_solve

from airtact import _kernels
from airtact.hands.body import FREE, PARTS, Hulls, hand_hulls
from airtact.hands.fitting.priors import (
    BODY,
    BODY_BLOCK,
    JOINTS,
    RADII,
    SIZE_RADII,
    SIZES,
    HandAnatomy,
    Sizes,
    SizesMatrix,
    Unknowns,
    UnknownsMatrix,
    balls_at,
    bend_rules,
    bending_axes,
    by_body,
    joints_in,
    landmark_pull,
    length_rules,
    usual_last_bones,
)
from airtact.hands.fitting.silhouette import Silhouette
from airtact.hands.joints import Joints, PerPoint, Point, Points, Side

# The result of a search, and the covariance of joints and sizes (137, 137).
Solution = tuple["NormalEquations", UnknownsMatrix]


# Kind of each hull: 0 for fingers, 1 for the palm.
KIND = (np.arange(len(PARTS)) >= FREE).astype(np.int64)

# Ratio of misfit to scale above which a point has no weight.
TUKEY = 4.685

# Largest scale of the misfit [m].
MAX_SCALE = 4e-3

# Smallest number of points at which fingers or palm get their own scale of the misfit.
MIN_POINTS = 20

# Number of correlated points that count as one, for fingers and for the palm. The palm deviates
# more from hulls of balls.
POINTS_AS_ONE = np.array([4.0, 12.0])


# --- normal equations -------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Observation:
    """Observations of a hand in one frame, and the prior distribution of its sizes.

    Attributes
    ----------
    points : (N, 3) points of the skin, averaged in small cubes [m].
    landmarks : (25, 3) approximate joint positions [m].
    spread : (25,) standard deviation of each coordinate of the landmarks [m].
    side : "right" or "left".
    anatomy : prior on the sizes of the hand.
    camera : (3,) position of the camera [m]; None if the points were seen from several directions.
    silhouette : silhouette seen by the camera; None if there is no camera.
    each : number of measured points that each averaged point represents.
    """

    points: Points
    landmarks: Joints
    spread: Float64[np.ndarray, "25"]
    side: Side
    anatomy: HandAnatomy
    camera: Point | None
    silhouette: Silhouette | None
    each: int = 1

    @cached_property
    def precision(self) -> SizesMatrix:
        """Inverse (62, 62) of the covariance of the sizes."""
        return np.linalg.inv(self.anatomy.covariance)


class SkinResiduals(NamedTuple):
    """Signed distances of points from the nearest skin, and the derivatives of the distances.

    Attributes
    ----------
    distance : (N,) signed distance of each point from the skin [m], positive outside.
    by_balls : (N, 104) derivatives with respect to the centre and radius of each ball.
    hull : (N,) index of the nearest hull.
    """

    distance: PerPoint
    by_balls: Float64[np.ndarray, "points numbers"]
    hull: Int64[np.ndarray, "points"]


def skin_residuals(points: Points, hulls: Hulls, camera: Point | None = None) -> SkinResiduals:
    """Return the distances of points from the skin of the three nearest hulls, with derivatives.

    With a ``camera`` (3,) [m], only skin that faces the camera is considered.
    """
    return SkinResiduals(
        *_kernels.hull_gaps(
            points,
            hulls.balls,
            hulls.parts,
            hulls.blend,
            camera,
            -0.05,  # smallest cosine to the line of sight at which skin faces the camera
        )
    )


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of one Gauss-Newton step, and the terms of the cost function.

    Attributes
    ----------
    unknowns : (137,) unknowns at which the problem is linearised.
    matrix, gradient : (137, 137) matrix and (137,) gradient of the cost.
    squares : sum of the squared residuals of the priors.
    residuals : signed distances of the points from the skin, with derivatives.
    weights : (N,) weights of the points; 0 for outliers.
    scale : (2,) robust scale of the misfit at the fingers and at the palm [m].
    each : number of measured points that each averaged point represents.
    """

    unknowns: Unknowns
    matrix: UnknownsMatrix
    gradient: Unknowns
    squares: float
    residuals: SkinResiduals
    weights: PerPoint
    scale: Float64[np.ndarray, "2"]
    each: int

    def cost(self, scale: Float64[np.ndarray, "2"], rules_weight: float = 1.0) -> float:
        """Return half the weighted sum of squares of the priors plus Tukey's cost of the points."""
        kind = KIND[self.residuals.hull]
        share = np.minimum((self.residuals.distance / (TUKEY * scale[kind])) ** 2, 1.0)
        points = float(((1.0 - (1.0 - share) ** 3) / POINTS_AS_ONE[kind]).sum())
        return 0.5 * rules_weight * self.squares + self.each * TUKEY**2 / 6.0 * points


def normal_equations(
    seen: Observation, joined_as: Hulls, unknowns: Unknowns, min_scale: float
) -> NormalEquations:
    """Set up the normal equations; ``min_scale`` is the smallest scale of the misfit [m]."""
    matrix, gradient, squares = equations_of_rules(seen, unknowns)
    residuals = skin_residuals(
        seen.points, replace(joined_as, balls=balls_at(unknowns)), seen.camera
    )
    kind = KIND[residuals.hull]
    off = np.abs(residuals.distance)
    scale = np.full(2, MAX_SCALE)
    for index in range(2):
        near = off[(off < 15e-3) & (kind == index)]
        if len(near) < MIN_POINTS:
            near = off[off < 15e-3]
        if len(near):
            # 1.4826 is the ratio of a normal standard deviation to the median magnitude.
            scale[index] = np.clip(1.4826 * np.median(near), max(min_scale, 0.02e-3), MAX_SCALE)
    weights = np.maximum(1.0 - (off / (TUKEY * scale[kind])) ** 2, 0.0) ** 2
    by_variance = seen.each * weights / (POINTS_AS_ONE * scale**2)[kind]
    block, pull = _equations_of_points(residuals, by_variance, unknowns[SIZES])
    matrix[BODY_BLOCK] += block
    gradient[BODY] += pull
    return NormalEquations(
        unknowns, matrix, gradient, squares, residuals, weights, scale, seen.each
    )


def equations_of_rules(
    seen: Observation, unknowns: Unknowns
) -> tuple[UnknownsMatrix, Unknowns, float]:
    """Return the matrix and gradient of the priors' normal equations, and twice their cost."""
    joints = joints_in(unknowns)
    sizes = unknowns[SIZES]
    axes = bending_axes(joints, seen.side)
    lengths = length_rules(joints, sizes)
    bends = bend_rules(joints, axes, usual_last_bones(joints, axes))
    residuals = np.concatenate([lengths.residuals, bends.residuals])
    gradients = np.concatenate([lengths.gradients, bends.gradients])
    matrix = gradients.T @ gradients
    gradient = gradients.T @ residuals
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


def _equations_of_points(
    residuals: SkinResiduals, weights: PerPoint, sizes: Sizes
) -> tuple[Float64[np.ndarray, "100 100"], Float64[np.ndarray, "100"]]:
    """Set up the normal equations of weighted points [1/m²] for the unknowns of the body."""
    used = np.flatnonzero(weights)
    root = np.sqrt(weights[used])
    rows = residuals.by_balls[used] * root[:, None]
    pull = (root * residuals.distance[used]) @ rows
    solved = by_body(np.vstack([rows.T @ rows, pull]), sizes)
    return by_body(np.ascontiguousarray(solved[:-1].T), sizes), solved[-1]


# --- the search -------------------------------------------------------------------------------


# Lower limit of the scale of the misfit in the first step [m]; it decreases from step to step. With
# a large scale, even points far from a finger attract it.
FIRST_SCALE = 3e-3


def best_hand(seen: Observation, starts: Sequence[Joints], sizes: Sizes, hold: bool) -> Solution:
    """Fit the hand from several initial sets of joints [m], and continue from the best result.

    ``sizes`` are the initial logarithms of the sizes; they stay fixed if ``hold`` is true.
    """

    def search(unknowns: Unknowns) -> NormalEquations:
        return _descended(seen, unknowns, FIRST_SCALE, 40, hold)[0]

    best = reduce(_better, [search(np.concatenate([joints.ravel(), sizes])) for joints in starts])
    if len(starts) > 1:
        best = _better(best, search(best.unknowns))
    return best, _covariance(seen, best, hold)


def next_hand(seen: Observation, joints: Joints, sizes: Sizes, hold: bool) -> Solution:
    """Fit the hand, starting from the joints of the previous frame [m]."""
    unknowns = np.concatenate([joints.ravel(), sizes])
    hulls, _ = hand_hulls(joints, np.exp(sizes[SIZE_RADII]))
    min_scale = FIRST_SCALE
    # Every sixth point is used for up to 8 steps, then all points for up to 4 steps.
    for each, max_steps in ((6, 8), (1, 4)):
        few = replace(seen, points=np.ascontiguousarray(seen.points[::each]), each=each)
        end, min_scale = _descended(few, unknowns, min_scale, max_steps, hold, hulls)
        unknowns = end.unknowns
    end = normal_equations(seen, hulls, unknowns, min_scale)
    return end, _covariance(seen, end, hold)


def _better(first: NormalEquations, second: NormalEquations) -> NormalEquations:
    """Return the result that matches the points better; both are compared at the smaller scale.

    The priors get less weight than in the search, because an unusual pose is more likely than
    unexplained points.
    """
    scale = np.minimum(first.scale, second.scale)
    return second if second.cost(scale, 0.3) < first.cost(scale, 0.3) else first


def _descended(
    seen: Observation,
    unknowns: Unknowns,
    min_scale: float,
    max_steps: int,
    hold: bool,
    hulls: Hulls | None = None,
) -> tuple[NormalEquations, float]:
    """Take damped steps until the expected gain is small; return the result and scale limit [m].

    The blend radii are those of ``hulls``, or by default those of the initial hand.
    """
    free = JOINTS.stop if hold else SIZES.stop
    damping = 1e-3
    hulls = hulls or hand_hulls(joints_in(unknowns), np.exp(unknowns[RADII]))[0]
    here = normal_equations(seen, hulls, unknowns, min_scale)
    for _ in range(max_steps):
        matrix = here.matrix[:free, :free].copy()
        matrix[np.diag_indices(free)] *= 1.0 + damping
        step = -cho_solve(cho_factor(matrix), here.gradient[:free])
        promised = -0.5 * float(here.gradient[:free] @ step)
        # In one step, no joint moves by more than 10 mm and no log size changes by more than 0.1.
        joint_step = float(np.linalg.norm(step[JOINTS].reshape(25, 3), axis=1).max())
        size_step = float(np.abs(step[SIZES]).max(initial=0.0))
        step *= min(1.0, 10e-3 / max(joint_step, 1e-12), 0.1 / max(size_step, 1e-12))
        moved = here.unknowns.copy()
        moved[:free] += step
        min_scale *= 0.7
        next_equations = normal_equations(seen, hulls, moved, min_scale)
        better = next_equations.cost(here.scale) < here.cost(here.scale)
        if better:
            here = next_equations
        damping = damping / 5.0 if better else damping * 10.0
        # A step may fail because points switch from one part of the hand to another. The search
        # then stops at a larger expected gain.
        enough = (1e-3 if better else 1e-2) * (1.0 + here.cost(here.scale))
        if promised < enough and min_scale < here.scale.min():
            break
    return here, min_scale


# --- uncertainty ------------------------------------------------------------------------------


def _covariance(seen: Observation, here: NormalEquations, hold: bool) -> UnknownsMatrix:
    """Estimate the covariance of the unknowns; correlated neighbouring points count as one."""
    kinds = KIND[here.residuals.hull]
    alike = np.ones(2)
    for kind in range(2):
        used = np.flatnonzero((here.weights > 0.0) & (kinds == kind))
        alike[kind] = _points_as_one(
            seen.points[used], here.residuals.distance[used], here.residuals.hull[used]
        )
    matrix = equations_of_rules(seen, here.unknowns)[0]
    by_variance = here.weights / (alike * here.scale**2)[kinds]
    matrix[BODY_BLOCK] += _equations_of_points(here.residuals, by_variance, here.unknowns[SIZES])[0]
    if not hold:
        return cho_solve(cho_factor(matrix), np.eye(137))
    # The covariance of the sizes is that of the prior.
    by_sizes = -np.linalg.solve(matrix[JOINTS, JOINTS], matrix[JOINTS, SIZES])
    follow = np.vstack([by_sizes, np.eye(62)])
    covariance = follow @ seen.anatomy.covariance @ follow.T
    covariance[JOINTS, JOINTS] += np.linalg.inv(matrix[JOINTS, JOINTS])
    return covariance


def _points_as_one(points: Points, off: PerPoint, hull: Int64[np.ndarray, "points"]) -> float:
    """Return how many correlated neighbouring points count as one independent point.

    Errors in the shape correlate the misfits of a hull's points within a cube of 25 mm.
    """
    if len(points) < MIN_POINTS:
        return 1.0
    cells = np.column_stack([np.floor(points / 25e-3).astype(np.int64), hull])
    _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    mean = np.bincount(cell, off) / count
    total = float(np.var(off))
    within = float(np.sum((off - mean[cell]) ** 2) / max(len(off) - len(count), 1))
    common = max(total - within, 0.0)
    usual_count = float((count**2).sum() / count.sum())
    return min(1.0 + (usual_count - 1.0) * common / max(total, 1e-18), 80.0)
