"""The normal equations of a hand in a cloud: what rules, landmarks, outline and points say of joints and sizes.

Sources
-------
- A. E. Beaton, J. W. Tukey, Technometrics 16, 147 (1974): the weights of points that are far off.
- F. R. Hampel, J. Am. Stat. Assoc. 69, 383 (1974): the scale of the misfit from its median.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from airtact.hand.anatomy_parts import FREE, PARTS, WEB_BALL
from airtact.hand.fitting.joint_priors import (
    UNKNOWNS,
    bend_rules,
    bending_axes,
    firmness,
    landmark_cost,
    length_rules,
    usual_last_bones,
)
from airtact.hand.fitting.silhouette import Outline
from airtact.hand.fitting.size_prior import SPANS, HandAnatomy
from airtact.hand.fitting.skin_residuals import Gaps, gaps_to
from airtact.hand.sphere_mesh import Hulls
from airtact.printing import in_short

TUKEY = 4.685
"""Points off by more than this over the scale of the misfit count for nothing."""

NORMAL = 1.4826
"""Standard deviation of a normal distribution over the median of its magnitudes."""

REACH = 15e-3
"""Points farther than this say nothing of the misfit's scale [m]."""

LEAST, MOST = 0.02e-3, 4e-3
"""Bounds of that scale [m]."""

ALIKE = np.array([4.0, 12.0])
"""Points of fingers and of the palm that count as one: a palm is farther from hulls of balls, and misfits alike."""

FEW = 20
"""Fewer points of fingers, or of the palm, do not tell the scale of their own misfit."""

KIND = (np.arange(len(PARTS)) >= FREE).astype(np.int64)
"""0 for the hulls of fingers, 1 for those of the palm."""

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

OF_POINTS = np.r_[np.arange(75), np.arange(RADII.start, RADII.stop)]
"""The unknowns that a point speaks of: joints and radii."""


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
class System:
    """The normal equations of a step, and what the cost is made of.

    Attributes
    ----------
    place : (137,) joints [m] and sizes that they hold at.
    matrix, slope : (137, 137) and (137,).
    squares : sum of squares of the rules.
    gaps : from points to the skin.
    weights : (N,) of the points, 0 for strays.
    scale : (2,) of the misfit at fingers and at the palm [m].
    each : how many points each of them stands for.
    """

    place: Float64[np.ndarray, "137"]
    matrix: Float64[np.ndarray, "137 137"]
    slope: Float64[np.ndarray, "137"]
    squares: float
    gaps: Gaps
    weights: Float64[np.ndarray, "points"]
    scale: Float64[np.ndarray, "2"]
    each: int

    def cost(self, scale: Float64[np.ndarray, "2"], agreed: float = 1.0) -> float:
        """Half the sum of squares of the rules, and Tukey's function of the points.

        Parameters
        ----------
        scale : (2,) of the misfit at fingers and at the palm [m].
        agreed : weight of the rules.
        """
        kind = KIND[self.gaps.hull]
        share = np.minimum((self.gaps.distance / (TUKEY * scale[kind])) ** 2, 1.0)
        points = float(((1.0 - (1.0 - share) ** 3) / ALIKE[kind]).sum())
        return 0.5 * agreed * self.squares + self.each * TUKEY**2 / 6.0 * points


def system_at(seen: Seen, crease: Crease, place: Float64[np.ndarray, "137"], floor: float) -> System:
    """Write down the normal equations.

    Parameters
    ----------
    seen : what is known.
    crease : how the hulls of the hand are joined.
    place : (137,) joints [m] and logarithms of sizes.
    floor : least scale of the misfit [m].
    """
    matrix, slope, squares = ruled(seen, place)
    sizes = place[75:]
    gaps, weights, scale = misfit(seen, Hulls(balls_at(place), PARTS, *crease), floor)
    kind = KIND[gaps.hull]
    by_unknown, pull = weighed(gaps, seen.each * weights / (ALIKE * scale**2)[kind], sizes)
    added(matrix, by_unknown)
    slope[OF_POINTS] += pull
    return System(place, matrix, slope, squares, gaps, weights, scale, seen.each)


def ruled(
    seen: Seen, place: Float64[np.ndarray, "137"]
) -> tuple[Float64[np.ndarray, "137 137"], Float64[np.ndarray, "137"], float]:
    """Write down the normal equations without the points: matrix, slope, and twice the cost.

    Parameters
    ----------
    seen : what is known.
    place : (137,) joints [m] and logarithms of sizes.
    """
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
        beyond, by_ball, cost = seen.outline.beyond(balls_at(place))
        by_unknown = by_unknowns(by_ball, sizes)
        added(matrix, by_unknown.T @ by_unknown)
        slope[OF_POINTS] += by_unknown.T @ beyond
        squares += cost
    return matrix, slope, squares


def weighed(
    gaps: Gaps, weights: Float64[np.ndarray, "points"], sizes: Float64[np.ndarray, "62"]
) -> tuple[Float64[np.ndarray, "100 100"], Float64[np.ndarray, "100"]]:
    """Find what points add to the normal equations.

    Parameters
    ----------
    gaps : from points to the skin.
    weights : (N,) of the points [1/m²].
    sizes : (62,) logarithms.
    """
    own = np.flatnonzero(weights)
    root = np.sqrt(weights[own])
    rows = gaps.slopes[own] * root[:, None]
    pull = (root * gaps.distance[own]) @ rows
    both = by_unknowns(np.vstack([rows.T @ rows, pull]), sizes)
    return by_unknowns(np.ascontiguousarray(both[:-1].T), sizes), both[-1]


def added(matrix: Float64[np.ndarray, "137 137"], part: Float64[np.ndarray, "100 100"]) -> None:
    """Add what points say to a matrix of all unknowns, in place.

    Parameters
    ----------
    matrix : (137, 137).
    part : (100, 100).
    """
    matrix[:75, :75] += part[:75, :75]
    matrix[:75, RADII] += part[:75, 75:]
    matrix[RADII, :75] += part[75:, :75]
    matrix[RADII, RADII] += part[75:, 75:]


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


def balls_at(place: Float64[np.ndarray, "137"]) -> Float64[np.ndarray, "26 4"]:
    """Find centres and radii (26, 4) of the balls of a hand [m].

    Parameters
    ----------
    place : (137,) joints [m] and logarithms of sizes.
    """
    return (BALLS @ np.concatenate([place[:75], np.exp(place[RADII])])).reshape(26, 4)


def misfit(
    seen: Seen, hulls: Hulls, floor: float
) -> tuple[Gaps, Float64[np.ndarray, "points"], Float64[np.ndarray, "2"]]:
    """Find the distances of points from the skin of a hand, their weights, and the scales of the misfit [m].

    Parameters
    ----------
    seen : what is known.
    hulls : the body.
    floor : least scale [m].
    """
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
