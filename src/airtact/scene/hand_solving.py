"""The hand that explains a cloud best: Gauss-Newton steps with exact derivatives, stray points weighted down.

Sources
-------
- A. E. Beaton, J. W. Tukey, Technometrics 16, 147 (1974): the weights of points that are far off.
- F. R. Hampel, J. Am. Stat. Assoc. 69, 383 (1974): the scale of the misfit from its median.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64
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
    length_rules,
    usual_last_bones,
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

ENOUGH, WASTED = 1e-3, 1e-2
"""The search ends with a step that promises a smaller share of half the sum of squares, and with one that does not
keep a promise of a smaller share: points have changed from one part of the hand to another."""

STEPS = 40
"""Steps at most in a first frame."""

LATER = ((6, 8), (3, 4))
"""In later ones, one point stands for so many, with so many steps at most: few points, then twice as many."""

FIRST, EASIER, HARDER = 1e-3, 5.0, 10.0
"""Damping of the first step, and what it is divided and multiplied by after steps that help and that do not."""

CELL = 25e-3
"""Points nearer than this are off together, by the same fault of the shape [m]."""

ALIKE = np.array([4.0, 12.0])
"""Points of fingers and of the palm that count as one: a palm is farther from hulls of balls, and misfits alike."""

MOST_ALIKE = 80.0
"""Points that count as one at most."""

FEW = 20
"""Fewer points of fingers, or of the palm, do not tell the scale of their own misfit."""

KIND = (np.arange(len(PARTS)) >= FREE).astype(np.int64)
"""0 for the hulls of fingers, 1 for those of the palm."""

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

DIAGONAL = np.arange(UNKNOWNS)

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
    each : how many points each of these stands for.
    """

    points: Float64[np.ndarray, "points 3"]
    landmarks: Float64[np.ndarray, "25 3"]
    spread: Float64[np.ndarray, "25"]
    side: str
    anatomy: HandAnatomy
    camera: Float64[np.ndarray, "3"] | None
    outline: Outline | None
    each: int = 1

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
    seen: Seen, joints: Float64[np.ndarray, "25 3"], sizes: Float64[np.ndarray, "62"], hold: bool, near: bool = False
) -> Solved:
    """Find the hand that explains a cloud best.

    Parameters
    ----------
    seen : what is known.
    joints, sizes : (25, 3) [m] and (62,) logarithms to begin with.
    hold : keeps the sizes as they are.
    near : the joints are about right, by the frame before: few points lead the first steps.
    """
    place = np.concatenate([joints.ravel(), sizes])
    hulls, _ = hand_hulls(joints, np.exp(sizes[len(SPANS) :]))
    crease = (hulls.blend, hulls.apart)
    if not near:
        here, steps, _ = _descended(seen, crease, place, WIDEST, STEPS, hold)
        return _told(seen, here, steps, hold)
    total, floor = 0, WIDEST
    for each, most in LATER:
        few = replace(seen, points=np.ascontiguousarray(seen.points[::each]), each=each)
        here, steps, floor = _descended(few, crease, place, floor, most, hold)
        place, total = here.place, total + steps
    return _told(seen, _system(seen, crease, place, floor), total, hold)


def _descended(
    seen: Seen, crease: Crease, place: Float64[np.ndarray, "137"], floor: float, most: int, hold: bool
) -> "tuple[_System, int, float]":
    """Take steps until they promise little: where they end, how many they were, and the least scale by then."""
    free = 75 if hold else UNKNOWNS
    damping, steps = FIRST, 0
    here = _system(seen, crease, place, floor)
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
        there = _system(seen, crease, tried, floor)
        better = there.cost(here.scale) < here.cost(here.scale)
        damping = damping / EASIER if better else damping * HARDER
        if better:
            here = there
        enough = (ENOUGH if better else WASTED) * (1.0 + here.cost(here.scale))
        if gain < enough and floor < here.scale.min():
            break
    return here, steps, floor


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


OF_POINTS = np.r_[np.arange(75), np.arange(RADII.start, RADII.stop)]
"""The unknowns that a point speaks of: joints and radii."""


@dataclass(frozen=True, eq=False)
class _System:
    """The normal equations of a step, and what the cost is made of."""

    place: Float64[np.ndarray, "137"]
    matrix: Float64[np.ndarray, "137 137"]
    slope: Float64[np.ndarray, "137"]
    squares: float
    gaps: Gaps
    weights: Float64[np.ndarray, "points"]
    scale: Float64[np.ndarray, "2"]
    each: int

    def cost(self, scale: Float64[np.ndarray, "2"]) -> float:
        """Half the sum of squares of the rules, and of Tukey's function of the points."""
        kind = KIND[self.gaps.hull]
        share = np.minimum((self.gaps.distance / (TUKEY * scale[kind])) ** 2, 1.0)
        points = float(((1.0 - (1.0 - share) ** 3) / ALIKE[kind]).sum())
        return 0.5 * self.squares + self.each * TUKEY**2 / 6.0 * points


def _system(seen: Seen, crease: Crease, place: Float64[np.ndarray, "137"], floor: float) -> _System:
    matrix, slope, squares = _ruled(seen, place)
    sizes = place[75:]
    gaps, weights, scale = _misfit(seen, Hulls(_balls_at(place), PARTS, *crease), floor)
    kind = KIND[gaps.hull]
    by_unknown, pull = _weighed(gaps, seen.each * weights / (ALIKE * scale**2)[kind], sizes)
    _add(matrix, by_unknown)
    slope[OF_POINTS] += pull
    return _System(place, matrix, slope, squares, gaps, weights, scale, seen.each)


def _ruled(
    seen: Seen, place: Float64[np.ndarray, "137"]
) -> tuple[Float64[np.ndarray, "137 137"], Float64[np.ndarray, "137"], float]:
    """Write down the normal equations without the points: matrix, slope, and twice the cost."""
    joints, sizes = place[:75].reshape(25, 3), place[75:]
    axes = bending_axes(joints, seen.side)
    rules = (length_rules(joints, sizes), bend_rules(joints, axes, usual_last_bones(joints, axes)))
    residuals, slopes = (np.concatenate(part) for part in zip(*rules, strict=True))
    matrix, slope = slopes.T @ slopes, slopes.T @ residuals
    off = joints - seen.landmarks
    firm = np.repeat(firmness(off, seen.spread) ** 2, 3)
    matrix[DIAGONAL[:75], DIAGONAL[:75]] += firm
    slope[:75] += firm * off.ravel()
    from_mean = sizes - seen.anatomy.mean
    matrix[SIZES, SIZES] += seen.known
    slope[SIZES] += seen.known @ from_mean
    squares = landmark_cost(off, seen.spread) + float(residuals @ residuals + from_mean @ seen.known @ from_mean)
    if seen.outline is not None:
        beyond, by_ball, cost = seen.outline.beyond(_balls_at(place))
        by_unknown = by_unknowns(by_ball, sizes)
        _add(matrix, by_unknown.T @ by_unknown)
        slope[OF_POINTS] += by_unknown.T @ beyond
        squares += cost
    return matrix, slope, squares


def _weighed(
    gaps: Gaps, weights: Float64[np.ndarray, "points"], sizes: Float64[np.ndarray, "62"]
) -> tuple[Float64[np.ndarray, "100 100"], Float64[np.ndarray, "100"]]:
    """Find what points add to the normal equations."""
    own = np.flatnonzero(weights)
    root = np.sqrt(weights[own])
    rows = gaps.slopes[own] * root[:, None]
    pull = (root * gaps.distance[own]) @ rows
    both = by_unknowns(np.vstack([rows.T @ rows, pull]), sizes)
    return by_unknowns(np.ascontiguousarray(both[:-1].T), sizes), both[-1]


def _add(matrix: Float64[np.ndarray, "137 137"], part: Float64[np.ndarray, "100 100"]) -> None:
    """Add what points say to a matrix of all unknowns."""
    matrix[:75, :75] += part[:75, :75]
    matrix[:75, RADII] += part[:75, 75:]
    matrix[RADII, :75] += part[75:, :75]
    matrix[RADII, RADII] += part[75:, 75:]


def _balls_at(place: Float64[np.ndarray, "137"]) -> Float64[np.ndarray, "26 4"]:
    return (BALLS @ np.concatenate([place[:75], np.exp(place[RADII])])).reshape(26, 4)


def _misfit(
    seen: Seen, hulls: Hulls, floor: float
) -> tuple[Gaps, Float64[np.ndarray, "points"], Float64[np.ndarray, "2"]]:
    """Distances of points from the skin of a hand, their weights, and the scales of the misfit [m]."""
    scale = np.full(2, MOST)
    if len(seen.points) == 0:
        return Gaps(np.zeros(0), np.zeros((0, 104)), np.zeros(0, dtype=np.int64)), np.zeros(0), scale
    gaps = gaps_to(seen.points, hulls, seen.camera)
    off, kinds = np.abs(gaps.distance), KIND[gaps.hull]
    for kind in range(2):
        near = off[(off < REACH) & (kinds == kind)]
        near = near if len(near) >= FEW else off[off < REACH]
        if len(near):
            scale[kind] = np.clip(NORMAL * np.median(near), max(floor, LEAST), MOST)
    return gaps, np.maximum(1.0 - (off / (TUKEY * scale[kinds])) ** 2, 0.0) ** 2, scale


def _told(seen: Seen, here: _System, steps: int, hold: bool) -> Solved:
    """Say what was found, neighbouring points that are off alike counting as one."""
    sizes, together, alike = here.place[75:], np.zeros(2), np.ones(2)
    kinds = KIND[here.gaps.hull]
    for kind in range(2):
        own = np.flatnonzero((here.weights > 0.0) & (kinds == kind))
        alike[kind], together[kind] = _alike(seen.points[own], here.gaps.distance[own], here.gaps.hull[own])
    matrix = _ruled(seen, here.place)[0]
    _add(matrix, _weighed(here.gaps, here.weights / (alike * here.scale**2)[kinds], sizes)[0])
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
