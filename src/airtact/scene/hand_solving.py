"""The hand that explains a cloud best: Gauss-Newton steps with exact derivatives, stray points weighted down.

Sources
-------
- A. E. Beaton, J. W. Tukey, Technometrics 16, 147 (1974): the weights of points that are far off.
- F. R. Hampel, J. Am. Stat. Assoc. 69, 383 (1974): the scale of the misfit from its median.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.linalg import cho_factor, cho_solve

from airtact.scene.hand_anatomy import SPANS, HandAnatomy
from airtact.scene.hand_feet import Gaps, gaps_to
from airtact.scene.hand_hulls import Hulls
from airtact.scene.hand_limits import (
    UNKNOWNS,
    bend_rules,
    bending_axes,
    firmness,
    landmark_cost,
    landmark_rules,
    length_rules,
)
from airtact.scene.hand_outline import Outline
from airtact.scene.hand_parts import FREE, PARTS, WEB_BALL, hand_hulls
from airtact.scene.printing import in_short

TUKEY = 4.685
"""Points off by more than this over the scale of the misfit count for nothing."""

NORMAL = 1.4826
"""Standard deviation of a normal distribution over the median of its magnitudes."""

REACH = 15e-3
"""Points farther than this say nothing of the misfit's scale [m]."""

LEAST, MOST = 0.02e-3, 4e-3
"""Bounds of that scale [m]."""

WIDEST, SHARPER = 3e-3, 0.7
"""It is at least this in the first step, and that share of it in each later one: a finger that is off may come [m]."""

STEP, SIZE_STEP = 10e-3, 0.1
"""Longest step of a joint [m], and of the logarithm of a size."""

ENOUGH = 1e-3
"""The search ends with a step that promises a smaller share of half the sum of squares."""

STEPS = 40
"""Steps at most."""

FIRST, EASIER, HARDER = 1e-3, 5.0, 10.0
"""Damping of the first step, and what it is divided and multiplied by after steps that help and that do not."""

CELL = 12e-3
"""Points nearer than this are off together, by the same fault of the shape [m]."""

ALIKE = 7.0
"""Points that count as one."""

MOST_ALIKE = 12.0
"""Points that count as one at most."""

SHAPE = np.r_[np.full(FREE, 1.0e-3), np.full(len(PARTS) - FREE, 2.5e-3)]
"""How far skin is from hulls of balls at best, those of fingers and of the palm, by the example's GLB hand [m]."""

SIZES = slice(75, UNKNOWNS)
RADII = slice(75 + len(SPANS), UNKNOWNS)


def _balls() -> Float64[np.ndarray, "104 100"]:
    """How centres and radii of the balls follow from joints and radii."""
    rows = np.zeros((26, 4, 100))
    for ball in range(25):
        rows[ball, range(3), range(3 * ball, 3 * ball + 3)] = 1.0
        rows[ball, 3, 75 + ball] = 1.0
    rows[WEB_BALL] = 0.5 * (rows[1] + rows[2])
    rows[WEB_BALL, 3] = 0.4 * (rows[1, 3] + rows[2, 3])
    return rows.reshape(104, 100)


BALLS = _balls()

Crease = tuple[Float64[np.ndarray, "hulls hulls"], Float64[np.ndarray, "hulls hulls"]]
"""``blend`` and ``apart`` of the hulls of a hand."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What is known of a hand in one frame.

    Attributes
    ----------
    points : (N, 3) of its skin, thinned out [m].
    landmarks : (25, 3) rough joints [m].
    spread : (25,) standard deviation of each of their coordinates [m].
    side : "right" or "left".
    anatomy : what its sizes may be.
    camera : (3,) that saw the points [m], or None.
    outline : what that camera saw of the hand, or None.
    """

    points: Float64[np.ndarray, "points 3"]
    landmarks: Float64[np.ndarray, "25 3"]
    spread: Float64[np.ndarray, "25"]
    side: str
    anatomy: HandAnatomy
    camera: Float64[np.ndarray, "3"] | None
    outline: Outline | None

    __repr__ = in_short

    @cached_property
    def known(self) -> Float64[np.ndarray, "62 62"]:
        """How firmly the sizes are known: the inverse of their covariance."""
        return np.linalg.inv(self.anatomy.covariance)


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
    scale : standard deviation of the misfit [m].
    together : standard deviation of the part of it that neighbouring points have alike [m].
    steps : how many it took.
    """

    joints: Float64[np.ndarray, "25 3"]
    sizes: Float64[np.ndarray, "62"]
    covariance: Float64[np.ndarray, "137 137"]
    gaps: Gaps
    weights: Float64[np.ndarray, "points"]
    scale: float
    together: float
    steps: int

    __repr__ = in_short

    @property
    def radii(self) -> Float64[np.ndarray, "25"]:
        """Radii of the skin round the joints (25,) [m]."""
        return np.exp(self.sizes[len(SPANS) :])


def solved(seen: Seen, joints: Float64[np.ndarray, "25 3"], sizes: Float64[np.ndarray, "62"], hold: bool) -> Solved:
    """Find the hand that explains a cloud best.

    Parameters
    ----------
    seen : what is known.
    joints, sizes : (25, 3) [m] and (62,) logarithms to begin with.
    hold : keeps the sizes as they are.
    """
    place = np.concatenate([joints.ravel(), sizes])
    free = 75 if hold else UNKNOWNS
    hulls, _ = hand_hulls(joints, np.exp(sizes[len(SPANS) :]))
    crease = (hulls.blend, hulls.apart)
    damping, steps, floor = FIRST, 0, WIDEST
    here = _system(seen, crease, place, floor)
    while steps < STEPS:
        steps += 1
        matrix = (here.rules + here.points)[:free, :free]
        matrix += damping * np.diag(np.diag(matrix))
        move = -cho_solve(cho_factor(matrix), here.slope[:free])
        gain = -0.5 * float(here.slope[:free] @ move)  # what the step promises
        length = float(np.linalg.norm(move[:75].reshape(25, 3), axis=1).max())
        move *= min(1.0, STEP / max(length, 1e-12), SIZE_STEP / max(float(np.abs(move[75:]).max(initial=0.0)), 1e-12))
        tried = place.copy()
        tried[:free] += move
        floor *= SHARPER
        there = _system(seen, crease, tried, floor)
        better = there.cost(here.scale) < here.cost(here.scale)
        damping = damping / EASIER if better else damping * HARDER
        if better:
            place, here = tried, there
        if gain < ENOUGH * (1.0 + here.cost(here.scale)) and floor < here.scale:
            break
    return _told(seen, place, here, steps, hold)


def skin_spread(found: Solved) -> Float64[np.ndarray, "hulls"]:
    """Say how far the skin of each hull (H,) may be off along its normal, as standard deviation all round [m].

    What the shape of the body cannot follow is in it, at least as much as neighbouring points are off alike.

    Parameters
    ----------
    found : the hand.
    """
    ways = np.vstack([np.eye(3), -np.eye(3)])
    own = found.covariance[OF_POINTS]
    spread = np.zeros(len(PARTS))
    for hull, part in enumerate(PARTS.tolist()):
        balls = [ball for ball in part if ball >= 0]
        shares = np.vstack([np.eye(len(balls)), np.full((1, len(balls)), 1.0 / len(balls))])
        slopes = np.zeros((len(shares), len(ways), 26, 4))
        slopes[:, :, balls] = shares[:, None, :, None] * np.column_stack([ways, np.ones(len(ways))])[None, :, None]
        rows = by_unknowns(slopes.reshape(-1, 104), found.sizes)
        spread[hull] = np.einsum("ri,ij,rj->r", rows, own, rows).mean()
    return np.sqrt(spread + np.maximum(SHAPE, found.together) ** 2)


def by_unknowns(
    slopes: Float64[np.ndarray, "rows 104"], sizes: Float64[np.ndarray, "62"]
) -> Float64[np.ndarray, "rows 100"]:
    """Turn derivatives by balls to those by joints and the logarithms of radii.

    Parameters
    ----------
    slopes : (R, 104).
    sizes : (62,) logarithms.
    """
    found = slopes @ BALLS
    found[:, 75:] *= np.exp(sizes[len(SPANS) :])
    return found


OF_POINTS = np.ix_(*2 * [np.r_[np.arange(75), np.arange(RADII.start, RADII.stop)]])
"""The unknowns that a point speaks of: joints and radii."""


@dataclass(frozen=True, eq=False)
class _System:
    """The normal equations of a step, those of the points apart, and what the cost is made of."""

    rules: Float64[np.ndarray, "137 137"]
    points: Float64[np.ndarray, "137 137"]
    slope: Float64[np.ndarray, "137"]
    squares: float
    gaps: Gaps
    weights: Float64[np.ndarray, "points"]
    scale: float

    def cost(self, scale: float) -> float:
        """Half the sum of squares of the rules, and of Tukey's function of the points."""
        reach = TUKEY * scale
        share = np.minimum((self.gaps.distance / reach) ** 2, 1.0)
        return 0.5 * self.squares + reach**2 / (6.0 * ALIKE * scale**2) * float((1.0 - (1.0 - share) ** 3).sum())


def _system(seen: Seen, crease: Crease, place: Float64[np.ndarray, "137"], floor: float) -> _System:
    joints, sizes = place[:75].reshape(25, 3), place[75:]
    balls = _balls_at(joints, sizes)
    matrix, slope = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
    off = joints - seen.landmarks
    rules = [
        landmark_rules(off, firmness(off, seen.spread)),
        length_rules(joints, sizes),
        bend_rules(joints, bending_axes(joints, seen.side)),
    ]
    residuals, slopes = (np.concatenate(part) for part in zip(*rules, strict=True))
    matrix, slope = slopes.T @ slopes, slopes.T @ residuals
    squares = landmark_cost(off, seen.spread) + sum(float(residuals @ residuals) for residuals, _ in rules[1:])
    from_mean = sizes - seen.anatomy.mean
    matrix[SIZES, SIZES] += seen.known
    slope[SIZES] += seen.known @ from_mean
    squares += float(from_mean @ seen.known @ from_mean)
    if seen.outline is not None:
        beyond, by_ball, cost = seen.outline.beyond(balls)
        slopes = by_unknowns(by_ball, sizes)
        matrix[OF_POINTS] += slopes.T @ slopes
        slope[OF_POINTS[0].ravel()] += slopes.T @ beyond
        squares += cost
    gaps, weights, scale = _misfit(seen, Hulls(balls, PARTS, *crease), floor)
    weighted = gaps.slopes * (weights / (ALIKE * scale**2))[:, None]
    points = np.zeros((UNKNOWNS, UNKNOWNS))
    points[OF_POINTS] = by_unknowns(by_unknowns(gaps.slopes.T @ weighted, sizes).T, sizes)
    slope[OF_POINTS[0].ravel()] += by_unknowns((weighted.T @ gaps.distance)[None], sizes)[0]
    return _System(matrix, points, slope, squares, gaps, weights, scale)


def _balls_at(joints: Float64[np.ndarray, "25 3"], sizes: Float64[np.ndarray, "62"]) -> Float64[np.ndarray, "26 4"]:
    return (BALLS @ np.concatenate([joints.ravel(), np.exp(sizes[len(SPANS) :])])).reshape(26, 4)


def _misfit(seen: Seen, hulls: Hulls, floor: float) -> tuple[Gaps, Float64[np.ndarray, "points"], float]:
    """Distances of points from the skin of a hand, their weights, and the scale of the misfit [m]."""
    if len(seen.points) == 0:
        return Gaps(np.zeros(0), np.zeros((0, 104)), np.zeros(0, dtype=np.int64)), np.zeros(0), MOST
    gaps = gaps_to(seen.points, hulls, seen.camera)
    off = np.abs(gaps.distance)
    near = off[off < REACH]
    scale = float(np.clip(NORMAL * np.median(near), max(floor, LEAST), MOST)) if len(near) else MOST
    return gaps, np.maximum(1.0 - (off / (TUKEY * scale)) ** 2, 0.0) ** 2, scale


def _told(seen: Seen, place: Float64[np.ndarray, "137"], here: _System, steps: int, hold: bool) -> Solved:
    """Say what was found, neighbouring points that are off alike counting as one."""
    alike, together = _alike(seen.points, here.gaps, here.weights, here.scale)
    matrix = here.rules + here.points * (ALIKE / alike)
    if hold:  # sizes are as sure as they were, whatever this frame says of them
        follow = np.vstack([-np.linalg.solve(matrix[:75, :75], matrix[:75, SIZES]), np.eye(UNKNOWNS - 75)])
        covariance = follow @ seen.anatomy.covariance @ follow.T
        covariance[:75, :75] += np.linalg.inv(matrix[:75, :75])
    else:
        covariance = cho_solve(cho_factor(matrix), np.eye(UNKNOWNS))
    joints = place[:75].reshape(25, 3)
    return Solved(joints, place[75:], covariance, here.gaps, here.weights, here.scale, together, steps)


def _alike(
    points: Float64[np.ndarray, "points 3"], gaps: Gaps, weights: Float64[np.ndarray, "points"], scale: float
) -> tuple[float, float]:
    """How many neighbouring points are as good as one, their misfit being alike, and how large that common part is."""
    used = np.flatnonzero(weights > 0.0)
    if len(used) < 2:
        return 1.0, scale
    cells = np.column_stack([np.floor(points[used] / CELL).astype(np.int64), gaps.hull[used]])
    _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    mean = np.bincount(cell, gaps.distance[used]) / count
    spread = float(np.var(gaps.distance[used]))
    within = float(np.sum((gaps.distance[used] - mean[cell]) ** 2) / max(len(used) - len(count), 1))
    common = max(spread - within, 0.0)
    usual = float((count**2).sum() / count.sum())
    alike = 1.0 + (usual - 1.0) * common / max(spread, 1e-18)
    return min(alike, MOST_ALIKE), float(np.sqrt(common))
