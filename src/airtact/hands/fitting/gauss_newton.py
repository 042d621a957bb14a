"""The hand that explains a cloud best: Gauss-Newton steps with exact derivatives, outliers weighted down."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import cho_factor, cho_solve

from airtact.hands.anatomy_parts import FREE, PARTS, hand_hulls
from airtact.hands.fitting.normal_equations import (
    FEW,
    KIND,
    MOST,
    NormalEquations,
    Observation,
    SkinResiduals,
    normal_equations,
    of_points,
    without_points,
)
from airtact.hands.fitting.unknowns import (
    BALLS,
    BODY_BLOCK,
    COUNT,
    JOINTS,
    RADII,
    SIZE_COUNT,
    SIZE_RADII,
    SIZES,
    by_body,
    joined,
    joints_in,
)
from airtact.hands.sphere_mesh import Hulls


@dataclass(frozen=True, eq=False)
class HandEstimate:
    """The hand that explains a cloud best.

    Attributes
    ----------
    joints : (25, 3) [m].
    sizes : (62,) logarithms.
    covariance : (137, 137) of joints and sizes.
    residuals : of the points.
    weights : (N,) of the points, 0 for outliers.
    common : (2,) standard deviation of the part of the misfit that neighbouring points share, at
        fingers and at the palm [m].
    """

    joints: Float64[np.ndarray, "25 3"]
    sizes: Float64[np.ndarray, "62"]
    covariance: Float64[np.ndarray, "137 137"]
    residuals: SkinResiduals
    weights: Float64[np.ndarray, "points"]
    common: Float64[np.ndarray, "2"]

    @property
    def radii(self) -> Float64[np.ndarray, "25"]:
        """Radii of the skin round the joints (25,) [m]."""
        return np.exp(self.sizes[SIZE_RADII])


# --- the search -----------------------------------------------------------------------------------------------------

WIDEST, SHARPER = 3e-3, 0.7
"""The scale of the misfit is at least the first in the first step [m], and that share of it in each later one, so that
a finger that is off may come."""

STEPS = 40
"""Steps at most in a first frame."""

LATER = ((6, 8), (1, 4))
"""In later frames, one point stands for so many, with so many steps at most: few points first, then all."""

AGREED = 0.3
"""Weight of the rules where two ends of the search are compared: a pose that joints and landmarks hardly allow is
likelier than points that nothing explains."""


def best_hand(
    seen: Observation,
    starts: Sequence[Float64[np.ndarray, "25 3"]],
    sizes: Float64[np.ndarray, "62"],
    hold: bool,
) -> HandEstimate:
    """Find the hand that explains a cloud best, from some joints [m] and once more from the best end.

    ``sizes`` are logarithms to start with; ``hold`` keeps them as they are.
    """
    ends = [_descended(seen, joined(joints, sizes), WIDEST, STEPS, hold) for joints in starts]
    best = ends[0]
    for end in ends[1:]:
        best = _better(best, end)
    if len(starts) > 1:
        best = _better(best, _descended(seen, best.here.unknowns, WIDEST, STEPS, hold))
    return _estimate(seen, best.here, hold)


def next_hand(
    seen: Observation,
    joints: Float64[np.ndarray, "25 3"],
    sizes: Float64[np.ndarray, "62"],
    hold: bool,
) -> HandEstimate:
    """Find the hand that explains a cloud best near the joints of the frame before [m], first with few points."""
    unknowns, hulls, floor = (
        joined(joints, sizes),
        hand_hulls(joints, np.exp(sizes[SIZE_RADII]))[0],
        WIDEST,
    )
    for each, most in LATER:
        few = replace(seen, points=np.ascontiguousarray(seen.points[::each]), each=each)
        end = _descended(few, unknowns, floor, most, hold, hulls)
        unknowns, floor = end.here.unknowns, end.floor
    return _estimate(seen, normal_equations(seen, hulls, unknowns, floor), hold)


class _End(NamedTuple):
    """Where a search ended, and the least scale by then [m]."""

    here: NormalEquations
    floor: float


def _better(one: _End, other: _End) -> _End:
    """Choose the end that explains the points better, by the smaller scale of the two."""
    scale = np.minimum(one.here.scale, other.here.scale)
    return other if other.here.cost(scale, AGREED) < one.here.cost(scale, AGREED) else one


STEP, SIZE_STEP = 10e-3, 0.1
"""Longest step of a joint [m], and of the logarithm of a size."""

FIRST, EASIER, HARDER = 1e-3, 5.0, 10.0
"""Damping of the first step, and its divisor and factor after steps that help and that do not."""

ENOUGH, WASTED = 1e-3, 1e-2
"""The search ends with a step that promises a smaller share of half the sum of squares, and with one that does not
keep a promise of a smaller share: points have changed from one part of the hand to another."""


def _descended(
    seen: Observation,
    unknowns: Float64[np.ndarray, "137"],
    floor: float,
    most: int,
    hold: bool,
    hulls: Hulls | None = None,
) -> _End:
    """Take damped steps until they promise little, with the hulls joined as they are at the start, or as these are."""
    free = JOINTS.stop if hold else COUNT
    damping, steps = FIRST, 0
    hulls = hulls or hand_hulls(joints_in(unknowns), np.exp(unknowns[RADII]))[0]
    here = normal_equations(seen, hulls, unknowns, floor)
    while steps < most:
        steps += 1
        matrix = here.matrix[:free, :free].copy()
        matrix[np.diag_indices(free)] *= 1.0 + damping
        move = -cho_solve(cho_factor(matrix), here.gradient[:free])
        gain = -0.5 * float(here.gradient[:free] @ move)  # what the step promises
        length = float(np.linalg.norm(joints_in(move), axis=1).max())
        move *= min(
            1.0,
            STEP / max(length, 1e-12),
            SIZE_STEP / max(float(np.abs(move[SIZES]).max(initial=0.0)), 1e-12),
        )
        tried = here.unknowns.copy()
        tried[:free] += move
        floor *= SHARPER
        there = normal_equations(seen, hulls, tried, floor)
        better = there.cost(here.scale) < here.cost(here.scale)
        damping = damping / EASIER if better else damping * HARDER
        if better:
            here = there
        enough = (ENOUGH if better else WASTED) * (1.0 + here.cost(here.scale))
        if gain < enough and floor < here.scale.min():
            break
    return _End(here, floor)


# --- what is uncertain ----------------------------------------------------------------------------------------------

SHAPE = np.r_[np.full(FREE, 1.0e-3), np.full(len(PARTS) - FREE, 2.5e-3)]
"""Distance of skin from hulls of balls at best, those of fingers and of the palm, by the example's GLB hand [m]."""

SEEN, UNSEEN = 5, 2.5e-3
"""A hull of a finger with fewer points than the first is as far off as a hull of the palm [m]: 11 such hulls of that
hand in 20 views are 4.1 mm off (rms), 2.6 mm beyond what the covariance explains."""


def skin_spread(found: HandEstimate) -> Float64[np.ndarray, "hulls"]:
    """Return the standard deviation of the skin of each hull (H,) along its normal, averaged all round [m].

    It includes what the shape of the body cannot follow, at least as much as the misfit that
    neighbouring points share.
    """
    ways = np.vstack([np.eye(3), -np.eye(3)])
    own = found.covariance[BODY_BLOCK]
    spread = np.zeros(len(PARTS))
    for hull, part in enumerate(PARTS.tolist()):
        balls = [ball for ball in part if ball >= 0]
        shares = np.vstack([np.eye(len(balls)), np.full((1, len(balls)), 1.0 / len(balls))])
        by_balls = np.zeros((len(shares), len(ways), BALLS, 4))
        by_balls[:, :, balls] = (
            shares[:, None, :, None] * np.column_stack([ways, np.ones(len(ways))])[None, :, None]
        )
        rows = by_body(by_balls.reshape(-1, 4 * BALLS), found.sizes)
        spread[hull] = ((rows @ own) * rows).sum(axis=1).mean()
    points = np.bincount(found.residuals.hull[found.weights > 0.0], minlength=len(PARTS))
    shape = np.where(points < SEEN, np.maximum(SHAPE, UNSEEN), SHAPE)
    return np.sqrt(spread + np.maximum(shape, found.common[KIND]) ** 2)


def _estimate(seen: Observation, here: NormalEquations, hold: bool) -> HandEstimate:
    """Find the covariance, in which neighbouring points that share their misfit count as one."""
    sizes, common, alike = here.unknowns[SIZES], np.zeros(2), np.ones(2)
    kinds = KIND[here.residuals.hull]
    for kind in range(2):
        own = np.flatnonzero((here.weights > 0.0) & (kinds == kind))
        alike[kind], common[kind] = _alike(
            seen.points[own], here.residuals.distance[own], here.residuals.hull[own]
        )
    matrix = without_points(seen, here.unknowns)[0]
    matrix[BODY_BLOCK] += of_points(
        here.residuals, here.weights / (alike * here.scale**2)[kinds], sizes
    )[0]
    if hold:  # the sizes keep their covariance, whatever this frame shows of them
        follow = np.vstack(
            [-np.linalg.solve(matrix[JOINTS, JOINTS], matrix[JOINTS, SIZES]), np.eye(SIZE_COUNT)]
        )
        covariance = follow @ seen.anatomy.covariance @ follow.T
        covariance[JOINTS, JOINTS] += np.linalg.inv(matrix[JOINTS, JOINTS])
    else:
        covariance = cho_solve(cho_factor(matrix), np.eye(COUNT))
    return HandEstimate(
        joints_in(here.unknowns), sizes, covariance, here.residuals, here.weights, common
    )


CELL = 25e-3
"""Points nearer than this share their misfit, by the same fault of the shape [m]."""

MOST_ALIKE = 80.0
"""Points that count as one at most."""


def _alike(
    points: Float64[np.ndarray, "points 3"],
    off: Float64[np.ndarray, "points"],
    hull: Int64[np.ndarray, "points"],
) -> tuple[float, float]:
    """How many neighbouring points count as one, and how large the misfit is that they share [m]."""
    if len(points) < FEW:
        return 1.0, MOST
    cells = np.column_stack([np.floor(points / CELL).astype(np.int64), hull])
    _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    mean = np.bincount(cell, off) / count
    spread = float(np.var(off))
    within = float(np.sum((off - mean[cell]) ** 2) / max(len(off) - len(count), 1))
    common = max(spread - within, 0.0)
    usual = float((count**2).sum() / count.sum())
    alike = 1.0 + (usual - 1.0) * common / max(spread, 1e-18)
    return min(alike, MOST_ALIKE), float(np.sqrt(common))
