"""What joints of a hand obey: lengths that they keep, bends that they have, and the landmarks that a tracker gave.

Each rule is a residual over its standard deviation, with its exact derivatives by the joints.

Sources
-------
- E. Y. S. Chao, K.-N. An, W. P. Cooney, R. L. Linscheid, *Biomechanics of the Hand*, World Scientific (1989): ranges of
  motion of the joints.
- H. Rijpkema, M. Girard, SIGGRAPH Comput. Graph. 25, 339 (1991): the last joint of a finger bends by two thirds of what
  its middle one does.
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from airtact.hand.fitting.size_prior import COUNT, SPANS, TIES
from airtact.hand.joints import CHAINS, unit
from airtact.hand.kinematics import LAST_SHARE, bending_axis

BONE, CARPUS, PALM = 0.5e-3, 1.0e-3, 2.0e-3
"""Standard deviations of the length of a bone from frame to frame, at the wrist, and of ties across the palm [m]."""

BACKWARDS = ((-0.5, -0.15, -0.25), (-0.5, -0.3))
"""Least sine of the bend at the knuckle, middle and last joint of a finger, and at those of the thumb."""

FARTHEST = ((-0.35, -0.35, 0.0), (0.2, 0.0))
"""Least cosines of those bends, either way."""

SIDEWAYS = 0.45
"""Largest sine of the turn of a finger to a side."""

SPARE, PLANE = 0.05, 0.08
"""Standard deviations of those sines and cosines where they are passed, and of a finger's twist out of its plane."""

COUPLED = 0.3
"""Standard deviation of the bend of a finger's last joint from the share of its middle one's that it usually has
[rad]."""

BENT = (-0.3, 2.0)
"""Bends of middle joints beyond which last ones turn no farther [rad]."""

ENDS = np.array([pair for chain in CHAINS for pair in pairwise(chain)])
"""Joints at both ends of the bones of the fingers, the thumb's three first."""

FIRST = np.array([4, 8, 12, 16])
"""The first phalanges among them, without the thumb's."""

BENDS = np.array([(0, 1), (1, 2), *((bone + k, bone + k + 1) for bone in (3, 7, 11, 15) for k in range(3))])
"""Bones on both sides of each joint that bends."""

LEAST = np.array([*BACKWARDS[1], *(4 * BACKWARDS[0])])
"""Least sines of those bends."""

LOWEST = np.array([*FARTHEST[1], *(4 * FARTHEST[0])])
"""Least cosines of those bends."""

BEND_FINGER = np.array([0, 0, *np.repeat([1, 2, 3, 4], 3)])

HINGES = np.array([(bone, bone + k) for bone in FIRST for k in (1, 2)])
"""Bones that turn no farther to a side than the first phalanx does, beyond it."""

HINGE_FINGER = np.repeat([1, 2, 3, 4], 2)

AHEAD, BACK = np.array([1, 2, 0]), np.array([2, 0, 1])

SPAN_ENDS = np.array(SPANS)

SPARE_LENGTH = np.r_[np.full(5, CARPUS), np.full(len(SPANS) - 5 - len(TIES), BONE), np.full(len(TIES), PALM)]
"""Standard deviations of the lengths of ``SPANS`` [m]."""

KNUCKLES = np.array([chain[1] for chain in CHAINS[1:]])

UNKNOWNS = 75 + COUNT
"""Coordinates of 25 joints, then the logarithms of the sizes of the hand."""


class Rules(NamedTuple):
    """Residuals over their standard deviations, and their derivatives.

    Attributes
    ----------
    residuals : (R,).
    slopes : (R, 137) derivatives by joints [1/m] and logarithms of sizes.
    """

    residuals: Float64[np.ndarray, "rules"]
    slopes: Float64[np.ndarray, "rules unknowns"]


def crossed(a: Float64[np.ndarray, "rows 3"], b: Float64[np.ndarray, "rows 3"]) -> Float64[np.ndarray, "rows 3"]:
    """Cross products of short tables, in a fifth of the time of ``np.cross``."""
    return a[:, AHEAD] * b[:, BACK] - a[:, BACK] * b[:, AHEAD]


def length_rules(joints: Float64[np.ndarray, "25 3"], sizes: Float64[np.ndarray, "sizes"]) -> Rules:
    """Hold the lengths of bones and ties to the sizes of the hand.

    Parameters
    ----------
    joints : (25, 3) [m].
    sizes : (62,) logarithms.
    """
    ends, spare = SPAN_ENDS, SPARE_LENGTH
    along = joints[ends[:, 1]] - joints[ends[:, 0]]
    length = np.sqrt((along**2).sum(axis=1))
    wanted = np.exp(sizes[: len(SPANS)])
    rows = np.arange(len(SPANS))
    slopes = np.zeros((len(SPANS), UNKNOWNS))
    by_joint = slopes[:, :75].reshape(-1, 25, 3)
    way = along / (length * spare)[:, None]
    by_joint[rows, ends[:, 1]] += way
    by_joint[rows, ends[:, 0]] -= way
    slopes[rows, 75 + rows] = -wanted / spare
    return Rules((length - wanted) / spare, slopes)


def bending_axes(joints: Float64[np.ndarray, "25 3"], side: str) -> Float64[np.ndarray, "5 3"]:
    """Find the unit axes (5, 3) about which the fingers bend.

    Parameters
    ----------
    joints : (25, 3) [m].
    side : "right" or "left".
    """
    across = unit(joints[6] - joints[21]) * (1.0 if side == "right" else -1.0)
    palm = joints[KNUCKLES] - joints[0]
    aside = across - (palm @ across / (palm**2).sum(axis=1))[:, None] * palm
    return np.vstack([bending_axis(joints, side, 0), aside / np.sqrt((aside**2).sum(axis=1))[:, None]])


def usual_last_bones(
    joints: Float64[np.ndarray, "25 3"], axes: Float64[np.ndarray, "5 3"]
) -> Float64[np.ndarray, "4 3"]:
    """Find the unit directions (4, 3) that the last bones of fingers have where they bend as they usually do.

    Parameters
    ----------
    joints : (25, 3) [m].
    axes : (5, 3) about which they bend.
    """
    along = joints[ENDS[:, 1]] - joints[ENDS[:, 0]]
    ways, axis = along / np.sqrt((along**2).sum(axis=1))[:, None], axes[1:]
    u, v = ways[FIRST], ways[FIRST + 1]
    bend = np.arctan2(np.einsum("fi,fi->f", crossed(u, v), axis), np.einsum("fi,fi->f", u, v))
    turn = LAST_SHARE * np.clip(bend, *BENT)[:, None]
    return np.cos(turn) * v + np.sin(turn) * crossed(axis, v)


def bend_rules(
    joints: Float64[np.ndarray, "25 3"], axes: Float64[np.ndarray, "5 3"], usual: Float64[np.ndarray, "4 3"]
) -> Rules:
    """Hold fingers in their planes and their bends within the limits of joints, the last ones near their usual share.

    Parameters
    ----------
    joints : (25, 3) [m].
    axes : (5, 3) about which they bend, held fixed.
    usual : (4, 3) where last bones usually point, held fixed.
    """
    along = joints[ENDS[:, 1]] - joints[ENDS[:, 0]]
    length = np.sqrt((along**2).sum(axis=1))
    ways = along / length[:, None]
    axis = axes[BEND_FINGER]
    u, v = ways[BENDS[:, 0]], ways[BENDS[:, 1]]
    back = np.maximum(LEAST - np.einsum("bi,bi->b", crossed(u, v), axis), 0.0) / SPARE
    far = np.maximum(LOWEST - np.einsum("bi,bi->b", u, v), 0.0) / SPARE
    hinge = axes[HINGE_FINGER]
    twist = np.einsum("hi,hi->h", ways[HINGES[:, 1]] - ways[HINGES[:, 0]], hinge) / PLANE
    turn = np.einsum("fi,fi->f", ways[FIRST], axes[1:])
    aside = np.sign(turn) * np.maximum(np.abs(turn) - SIDEWAYS, 0.0) / SPARE
    active = [-(rule != 0.0).astype(np.float64)[:, None] / SPARE for rule in (back, far)]
    by_way = (
        ((BENDS[:, 0], active[0] * crossed(v, axis)), (BENDS[:, 1], active[0] * crossed(axis, u))),
        ((BENDS[:, 0], active[1] * v), (BENDS[:, 1], active[1] * u)),
        ((HINGES[:, 0], -hinge / PLANE), (HINGES[:, 1], hinge / PLANE)),
        ((FIRST, (aside != 0.0)[:, None] * axes[1:] / SPARE),),
        ((np.repeat(FIRST + 2, 3), np.tile(np.eye(3) / COUPLED, (4, 1))),),
    )
    drawn = ((ways[FIRST + 2] - usual) / COUPLED).ravel()
    slopes = np.concatenate([_by_joints(parts, ways, length) for parts in by_way])
    return Rules(np.concatenate([back, far, twist, aside, drawn]), slopes)


def _by_joints(
    parts: Iterable[tuple[Int64[np.ndarray, "rules"], Float64[np.ndarray, "rules 3"]]],
    ways: Float64[np.ndarray, "bones 3"],
    length: Float64[np.ndarray, "bones"],
) -> Float64[np.ndarray, "rules unknowns"]:
    """Turn derivatives of rules by the unit directions of bones, one bone each, to those by joints."""
    parts = list(parts)
    rows = np.arange(len(parts[0][0]))
    slopes = np.zeros((len(rows), UNKNOWNS))
    by_joint = slopes[:, :75].reshape(-1, 25, 3)
    for bone, slope in parts:
        way = ways[bone]
        moved = (slope - np.einsum("ri,ri->r", slope, way)[:, None] * way) / length[bone, None]
        by_joint[rows, ENDS[bone, 1]] += moved
        by_joint[rows, ENDS[bone, 0]] -= moved
    return slopes


def firmness(off: Float64[np.ndarray, "25 3"], spread: Float64[np.ndarray, "25"]) -> Float64[np.ndarray, "25"]:
    """Weight landmarks (25,) [1/m], less where they are far off, as Cauchy's distribution does.

    Parameters
    ----------
    off : (25, 3) from landmarks to joints [m].
    spread : (25,) standard deviation of each of their coordinates [m].
    """
    far = np.linalg.norm(off, axis=1) / (3.0 * spread)
    return 1.0 / (spread * np.sqrt(1.0 + far**2))


def landmark_cost(off: Float64[np.ndarray, "25 3"], spread: Float64[np.ndarray, "25"]) -> float:
    """Twice the cost of landmarks, whose slope is twice the square of ``firmness`` times how far they are off.

    Parameters
    ----------
    off : (25, 3) from landmarks to joints [m].
    spread : (25,) standard deviation of each of their coordinates [m].
    """
    far = np.linalg.norm(off, axis=1) / (3.0 * spread)
    return 9.0 * float(np.log1p(far**2).sum())
