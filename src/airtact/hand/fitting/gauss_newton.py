"""The hand that explains a cloud best: Gauss-Newton steps with exact derivatives, stray points weighted down."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import cho_factor, cho_solve

from airtact.hand.anatomy_parts import FREE, PARTS, hand_hulls
from airtact.hand.fitting.joint_priors import UNKNOWNS
from airtact.hand.fitting.normal_equations import (
    DIAGONAL,
    FEW,
    KIND,
    MOST,
    OF_POINTS,
    SIZES,
    Crease,
    Seen,
    System,
    added,
    by_unknowns,
    ruled,
    system_at,
    weighed,
)
from airtact.hand.fitting.size_prior import SPANS
from airtact.hand.fitting.skin_residuals import Gaps
from airtact.printing import in_short

WIDEST, SHARPER = 3e-3, 0.7
"""It is at least this in the first step, and that share of it in each later one: a finger that is off may come [m]."""

STEP, SIZE_STEP = 10e-3, 0.1
"""Longest step of a joint [m], and of the logarithm of a size."""

ENOUGH, WASTED = 1e-3, 1e-2
"""The search ends with a step that promises a smaller share of half the sum of squares, and with one that does not
keep a promise of a smaller share: points have changed from one part of the hand to another."""

STEPS = 40
"""Steps at most in a first frame."""

LATER = ((6, 8), (1, 4))
"""In later ones, one point stands for so many, with so many steps at most: few points first, then all."""

AGREED = 0.3
"""Weight of the rules where two ends of the search are compared: a pose that joints and landmarks hardly allow is
likelier than points that nothing explains."""

FIRST, EASIER, HARDER = 1e-3, 5.0, 10.0
"""Damping of the first step, and what it is divided and multiplied by after steps that help and that do not."""

CELL = 25e-3
"""Points nearer than this are off together, by the same fault of the shape [m]."""

MOST_ALIKE = 80.0
"""Points that count as one at most."""

SHAPE = np.r_[np.full(FREE, 1.0e-3), np.full(len(PARTS) - FREE, 2.5e-3)]
"""How far skin is from hulls of balls at best, those of fingers and of the palm, by the example's GLB hand [m]."""


@dataclass(frozen=True, eq=False)
class Solved:
    """The hand found.

    Attributes
    ----------
    joints : (25, 3) [m].
    sizes : (62,) logarithms.
    covariance : (137, 137) of joints and sizes.
    gaps : from points to its skin.
    weights : (N,) of the points, 0 for strays.
    together : (2,) standard deviation of the part of the misfit that neighbouring points have alike, at fingers and at
        the palm [m].
    steps : how many it took.
    """

    joints: Float64[np.ndarray, "25 3"]
    sizes: Float64[np.ndarray, "62"]
    covariance: Float64[np.ndarray, "137 137"]
    gaps: Gaps
    weights: Float64[np.ndarray, "points"]
    together: Float64[np.ndarray, "2"]
    steps: int

    __repr__ = in_short

    @property
    def radii(self) -> Float64[np.ndarray, "25"]:
        """Radii of the skin round the joints (25,) [m]."""
        return np.exp(self.sizes[len(SPANS) :])


def solved(
    seen: Seen, starts: Sequence[Float64[np.ndarray, "25 3"]], sizes: Float64[np.ndarray, "62"], hold: bool
) -> Solved:
    """Find the hand that explains a cloud best, from each of some beginnings and once more from the best end.

    Parameters
    ----------
    seen : what is known.
    starts : joints (25, 3) to begin with [m].
    sizes : (62,) logarithms to begin with.
    hold : keeps the sizes as they are.
    """
    ends = [_descended(seen, np.concatenate([joints.ravel(), sizes]), WIDEST, STEPS, hold) for joints in starts]
    best = ends[0]
    for end in ends[1:]:
        best = _better(best, end)
    if len(starts) > 1:
        best = _better(best, _descended(seen, best.here.place, WIDEST, STEPS, hold))
    return _told(seen, best.here, best.steps, hold)


def followed(seen: Seen, joints: Float64[np.ndarray, "25 3"], sizes: Float64[np.ndarray, "62"], hold: bool) -> Solved:
    """Find the hand that explains a cloud best where the frame before says about where: few points lead the steps.

    Parameters
    ----------
    seen : what is known.
    joints : (25, 3) of the frame before [m].
    sizes : (62,) logarithms to begin with.
    hold : keeps the sizes as they are.
    """
    place, crease = np.concatenate([joints.ravel(), sizes]), _crease(joints, sizes)
    total, floor = 0, WIDEST
    for each, most in LATER:
        few = replace(seen, points=np.ascontiguousarray(seen.points[::each]), each=each)
        end = _descended(few, place, floor, most, hold, crease)
        place, total, floor = end.here.place, total + end.steps, end.floor
    return _told(seen, system_at(seen, crease, place, floor), total, hold)


class _End(NamedTuple):
    """Where a search ended, how many steps it took, and the least scale by then [m]."""

    here: System
    steps: int
    floor: float


def _crease(joints: Float64[np.ndarray, "25 3"], sizes: Float64[np.ndarray, "62"]) -> Crease:
    hulls, _ = hand_hulls(joints, np.exp(sizes[len(SPANS) :]))
    return hulls.blend, hulls.apart


def _better(one: _End, other: _End) -> _End:
    """Choose the end that explains the points better, by the smaller scale of the two."""
    scale = np.minimum(one.here.scale, other.here.scale)
    return other if other.here.cost(scale, AGREED) < one.here.cost(scale, AGREED) else one


def _descended(
    seen: Seen, place: Float64[np.ndarray, "137"], floor: float, most: int, hold: bool, crease: Crease | None = None
) -> _End:
    """Take steps until they promise little."""
    free = 75 if hold else UNKNOWNS
    damping, steps = FIRST, 0
    crease = crease or _crease(place[:75].reshape(25, 3), place[75:])
    here = system_at(seen, crease, place, floor)
    while steps < most:
        steps += 1
        matrix = here.matrix[:free, :free].copy()
        matrix[DIAGONAL[:free], DIAGONAL[:free]] *= 1.0 + damping
        move = -cho_solve(cho_factor(matrix), here.slope[:free])
        gain = -0.5 * float(here.slope[:free] @ move)  # what the step promises
        length = float(np.linalg.norm(move[:75].reshape(25, 3), axis=1).max())
        move *= min(1.0, STEP / max(length, 1e-12), SIZE_STEP / max(float(np.abs(move[75:]).max(initial=0.0)), 1e-12))
        tried = here.place.copy()
        tried[:free] += move
        floor *= SHARPER
        there = system_at(seen, crease, tried, floor)
        better = there.cost(here.scale) < here.cost(here.scale)
        damping = damping / EASIER if better else damping * HARDER
        if better:
            here = there
        enough = (ENOUGH if better else WASTED) * (1.0 + here.cost(here.scale))
        if gain < enough and floor < here.scale.min():
            break
    return _End(here, steps, floor)


def skin_spread(found: Solved) -> Float64[np.ndarray, "hulls"]:
    """Say how far the skin of each hull (H,) may be off along its normal, as standard deviation all round [m].

    What the shape of the body cannot follow is in it, at least as much as neighbouring points are off alike.

    Parameters
    ----------
    found : the hand.
    """
    ways = np.vstack([np.eye(3), -np.eye(3)])
    own = found.covariance[np.ix_(OF_POINTS, OF_POINTS)]
    spread = np.zeros(len(PARTS))
    for hull, part in enumerate(PARTS.tolist()):
        balls = [ball for ball in part if ball >= 0]
        shares = np.vstack([np.eye(len(balls)), np.full((1, len(balls)), 1.0 / len(balls))])
        slopes = np.zeros((len(shares), len(ways), 26, 4))
        slopes[:, :, balls] = shares[:, None, :, None] * np.column_stack([ways, np.ones(len(ways))])[None, :, None]
        rows = by_unknowns(slopes.reshape(-1, 104), found.sizes)
        spread[hull] = ((rows @ own) * rows).sum(axis=1).mean()
    return np.sqrt(spread + np.maximum(SHAPE, found.together[KIND]) ** 2)


def _told(seen: Seen, here: System, steps: int, hold: bool) -> Solved:
    """Say what was found, neighbouring points that are off alike counting as one."""
    sizes, together, alike = here.place[75:], np.zeros(2), np.ones(2)
    kinds = KIND[here.gaps.hull]
    for kind in range(2):
        own = np.flatnonzero((here.weights > 0.0) & (kinds == kind))
        alike[kind], together[kind] = _alike(seen.points[own], here.gaps.distance[own], here.gaps.hull[own])
    matrix = ruled(seen, here.place)[0]
    added(matrix, weighed(here.gaps, here.weights / (alike * here.scale**2)[kinds], sizes)[0])
    if hold:  # sizes are as sure as they were, whatever this frame says of them
        follow = np.vstack([-np.linalg.solve(matrix[:75, :75], matrix[:75, SIZES]), np.eye(UNKNOWNS - 75)])
        covariance = follow @ seen.anatomy.covariance @ follow.T
        covariance[:75, :75] += np.linalg.inv(matrix[:75, :75])
    else:
        covariance = cho_solve(cho_factor(matrix), np.eye(UNKNOWNS))
    joints = here.place[:75].reshape(25, 3)
    return Solved(joints, sizes, covariance, here.gaps, here.weights, together, steps)


def _alike(
    points: Float64[np.ndarray, "points 3"], off: Float64[np.ndarray, "points"], hull: Int64[np.ndarray, "points"]
) -> tuple[float, float]:
    """How many neighbouring points are as good as one, their misfit being alike, and how large that common part is."""
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
