"""What joints of a hand obey: lengths that they keep, bends that they have, and the landmarks that a tracker gave.

Each rule is a residual over its standard deviation, with its exact derivatives by the joints.

Source: E. Y. S. Chao, K.-N. An, W. P. Cooney, R. L. Linscheid, *Biomechanics of the Hand*, World Scientific (1989):
ranges of motion of the joints.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from airtact.scene.hand_anatomy import COUNT, SPANS, TIES
from airtact.scene.hand_bending import bending_axis
from airtact.scene.joints import CHAINS, unit

BONE, CARPUS, PALM = 0.5e-3, 1.0e-3, 2.0e-3
"""Standard deviations of the length of a bone from frame to frame, at the wrist, and of ties across the palm [m]."""

BACKWARDS = ((-0.5, -0.15, -0.25), (-0.5, -0.3))
"""Least sine of the bend at the knuckle, middle and last joint of a finger, and at those of the thumb."""

FARTHEST = -0.35
"""Least cosine of a bend, either way."""

SIDEWAYS = 0.45
"""Largest sine of the turn of a finger to a side."""

SPARE, PLANE = 0.05, 0.08
"""Standard deviations of those sines and cosines where they are passed, and of a finger's twist out of its plane."""

UNKNOWNS = 75 + COUNT
"""Coordinates of 25 joints, then the logarithms of the sizes of the hand."""


Rule = tuple[float, dict[int, Float64[np.ndarray, "3"]]]
"""A residual, and its derivatives by joints."""


class Rules(NamedTuple):
    """Residuals over their standard deviations, and their derivatives.

    Attributes
    ----------
    residuals : (R,).
    slopes : (R, 137) derivatives by joints [1/m] and logarithms of sizes.
    """

    residuals: Float64[np.ndarray, "rules"]
    slopes: Float64[np.ndarray, "rules unknowns"]


def length_rules(joints: Float64[np.ndarray, "25 3"], sizes: Float64[np.ndarray, "sizes"]) -> Rules:
    """Hold the lengths of bones and ties to the sizes of the hand.

    Parameters
    ----------
    joints : (25, 3) [m].
    sizes : (62,) logarithms.
    """
    ends = np.array(SPANS)
    along = joints[ends[:, 1]] - joints[ends[:, 0]]
    length = np.linalg.norm(along, axis=1)
    spare = np.full(len(SPANS), BONE)
    spare[:5], spare[len(SPANS) - len(TIES) :] = CARPUS, PALM
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
    axes = [bending_axis(joints, side, 0)]
    for chain in CHAINS[1:]:
        palm = unit(joints[chain[1]] - joints[0])
        axes.append(unit(across - (across @ palm) * palm))
    return np.array(axes)


def bend_rules(joints: Float64[np.ndarray, "25 3"], axes: Float64[np.ndarray, "5 3"]) -> Rules:
    """Hold the bends of fingers within the limits of their joints, and fingers in their planes.

    Parameters
    ----------
    joints : (25, 3) [m].
    axes : (5, 3) about which they bend, which are held fixed.
    """
    found: list[Rule] = []
    for finger, chain in enumerate(CHAINS):
        axis = axes[finger]
        bones = list(pairwise(chain))
        for least, (one, two) in zip(BACKWARDS[int(finger == 0)], pairwise(bones), strict=True):
            u, v = _way(joints, one), _way(joints, two)
            back = least - float(np.cross(u, v) @ axis)
            if back > 0.0:
                found.append(_rule(joints, back / SPARE, {one: np.cross(v, axis), two: np.cross(axis, u)}, -SPARE))
            far = FARTHEST - float(u @ v)
            if far > 0.0:
                found.append(_rule(joints, far / SPARE, {one: v, two: u}, -SPARE))
        if finger > 0:
            found += _plane_rules(joints, bones, axis)
    slopes = np.zeros((len(found), UNKNOWNS))
    for row, (_, by_joint) in enumerate(found):
        for joint, slope in by_joint.items():
            slopes[row, 3 * joint : 3 * joint + 3] += slope
    return Rules(np.array([value for value, _ in found]), slopes)


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
    """Twice the cost of landmarks, whose slope ``landmark_rules`` has.

    Parameters
    ----------
    off : (25, 3) from landmarks to joints [m].
    spread : (25,) standard deviation of each of their coordinates [m].
    """
    far = np.linalg.norm(off, axis=1) / (3.0 * spread)
    return 9.0 * float(np.log1p(far**2).sum())


def landmark_rules(off: Float64[np.ndarray, "25 3"], firm: Float64[np.ndarray, "25"]) -> Rules:
    """Hold joints near the landmarks of a tracker.

    Parameters
    ----------
    off : (25, 3) from landmarks to joints [m].
    firm : (25,) weights of the landmarks, held fixed [1/m].
    """
    slopes = np.zeros((75, UNKNOWNS))
    slopes[np.arange(75), np.arange(75)] = np.repeat(firm, 3)
    return Rules((off * firm[:, None]).ravel(), slopes)


def _plane_rules(
    joints: Float64[np.ndarray, "25 3"], bones: list[tuple[int, int]], axis: Float64[np.ndarray, "3"]
) -> list[Rule]:
    first, middle, last = bones[1:]
    u, v, w = _way(joints, first), _way(joints, middle), _way(joints, last)
    found = []
    for bone, way in ((middle, v), (last, w)):  # a hinge lets them turn no farther to a side than the first one
        twist = float((way - u) @ axis)
        found.append(_rule(joints, twist / PLANE, {bone: axis, first: -axis}, PLANE))
    side = float(u @ axis)
    if abs(side) > SIDEWAYS:
        over = side - np.sign(side) * SIDEWAYS
        found.append(_rule(joints, over / SPARE, {first: axis}, SPARE))
    return found


def _way(joints: Float64[np.ndarray, "25 3"], bone: tuple[int, int]) -> Float64[np.ndarray, "3"]:
    return unit(joints[bone[1]] - joints[bone[0]])


def _rule(
    joints: Float64[np.ndarray, "25 3"],
    value: float,
    by_way: dict[tuple[int, int], Float64[np.ndarray, "3"]],
    spare: float,
) -> Rule:
    """Turn derivatives by the unit directions of bones, over a standard deviation, to those by joints."""
    by_joint = {joint: np.zeros(3) for bone in by_way for joint in bone}
    for bone, slope in by_way.items():
        along = joints[bone[1]] - joints[bone[0]]
        length = float(np.linalg.norm(along))
        way = along / length
        moved = (slope - (slope @ way) * way) / (length * spare)
        by_joint[bone[1]] += moved
        by_joint[bone[0]] -= moved
    return value, by_joint
