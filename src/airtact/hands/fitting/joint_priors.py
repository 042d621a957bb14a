"""What the joints of a hand obey: constant lengths, limits of bends, and the landmarks of a tracker.

Each rule is a residual over its standard deviation, with its exact derivatives by the unknowns.

Sources
-------
- E. Y. S. Chao, K.-N. An, W. P. Cooney, R. L. Linscheid, *Biomechanics of the Hand*, World
  Scientific (1989): ranges of motion of the joints.
- H. Rijpkema, M. Girard, SIGGRAPH Comput. Graph. 25, 339 (1991): the last joint of a finger bends
  by two thirds of what its middle one does.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from airtact.hands.fitting.unknowns import COUNT, JOINTS, SIZE_LENGTHS, SIZES, SPANS, TIES
from airtact.hands.joints import CHAINS, unit
from airtact.hands.kinematics import LAST_SHARE, bending_axis

BACKWARDS = ((-0.5, -0.15, -0.25), (-0.5, -0.3))
"""Least sine of the bend at the knuckle, middle and last joint of a finger, and at those of the thumb."""

FARTHEST = ((-0.35, -0.35, 0.0), (0.2, 0.0))
"""Least cosines of those bends, either way."""

SIDEWAYS = 0.45
"""Largest sine of the turn of a finger to a side."""

SPARE, PLANE = 0.05, 0.08
"""Standard deviations of those sines and cosines beyond their limits, and of a finger's twist out of its plane."""

COUPLED = 0.3
"""Standard deviation of the bend of a finger's last joint from its usual share of the middle joint's bend [rad]."""

BENT = (-0.3, 2.0)
"""Bends of middle joints beyond which last ones turn no farther [rad]."""

ENDS = np.array([pair for chain in CHAINS for pair in pairwise(chain)])
"""Joints at both ends of the bones of the fingers, the thumb's three first."""

FIRST = np.array([4, 8, 12, 16])
"""The first phalanges among them, without the thumb's."""

BENDS = np.array(
    [(0, 1), (1, 2), *((bone + k, bone + k + 1) for bone in (3, 7, 11, 15) for k in range(3))]
)
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

KNUCKLES = np.array([chain[1] for chain in CHAINS[1:]])


class Rules(NamedTuple):
    """Residuals over their standard deviations, and their derivatives.

    Attributes
    ----------
    residuals : (R,).
    gradients : (R, 137) derivatives by joints [1/m] and logarithms of sizes.
    """

    residuals: Float64[np.ndarray, "rules"]
    gradients: Float64[np.ndarray, "rules unknowns"]


def crossed(
    a: Float64[np.ndarray, "rows 3"], b: Float64[np.ndarray, "rows 3"]
) -> Float64[np.ndarray, "rows 3"]:
    """Return the cross products of short tables, in a fifth of the time of ``np.cross``."""
    return a[:, AHEAD] * b[:, BACK] - a[:, BACK] * b[:, AHEAD]


BONE, CARPUS, PALM = 0.5e-3, 1.0e-3, 2.0e-3
"""Standard deviations of the length of a bone from frame to frame, at the wrist, and of ties across the palm [m]."""

SPAN_ENDS = np.array(SPANS)

SPREAD = np.r_[
    np.full(5, CARPUS), np.full(len(SPANS) - 5 - len(TIES), BONE), np.full(len(TIES), PALM)
]
"""Standard deviations of the lengths of ``SPANS`` [m]."""


def length_rules(joints: Float64[np.ndarray, "25 3"], sizes: Float64[np.ndarray, "sizes"]) -> Rules:
    """Hold the lengths of bones and ties between joints (25, 3) [m] to the logarithms of sizes (62,)."""
    starts, ends = SPAN_ENDS.T
    along = joints[ends] - joints[starts]
    length = np.sqrt((along**2).sum(axis=1))
    wanted = np.exp(sizes[SIZE_LENGTHS])
    rows = np.arange(len(SPANS))
    gradients = np.zeros((len(SPANS), COUNT))
    by_joint = gradients[:, JOINTS].reshape(-1, 25, 3)
    way = along / (length * SPREAD)[:, None]
    by_joint[rows, ends] += way
    by_joint[rows, starts] -= way
    gradients[rows, SIZES.start + rows] = -wanted / SPREAD
    return Rules((length - wanted) / SPREAD, gradients)


def bending_axes(joints: Float64[np.ndarray, "25 3"], side: str) -> Float64[np.ndarray, "5 3"]:
    """Find the unit axes (5, 3) about which the fingers of a right or left hand bend."""
    across = unit(joints[6] - joints[21]) * (1.0 if side == "right" else -1.0)
    palm = joints[KNUCKLES] - joints[0]
    aside = across - (palm @ across / (palm**2).sum(axis=1))[:, None] * palm
    return np.vstack(
        [bending_axis(joints, side, 0), aside / np.sqrt((aside**2).sum(axis=1))[:, None]]
    )


def usual_last_bones(
    joints: Float64[np.ndarray, "25 3"], axes: Float64[np.ndarray, "5 3"]
) -> Float64[np.ndarray, "4 3"]:
    """Find the usual unit directions (4, 3) of the last bones of fingers that bend about axes (5, 3)."""
    along = joints[ENDS[:, 1]] - joints[ENDS[:, 0]]
    ways, axis = along / np.sqrt((along**2).sum(axis=1))[:, None], axes[1:]
    u, v = ways[FIRST], ways[FIRST + 1]
    bend = np.arctan2(np.einsum("fi,fi->f", crossed(u, v), axis), np.einsum("fi,fi->f", u, v))
    turn = LAST_SHARE * np.clip(bend, *BENT)[:, None]
    return np.cos(turn) * v + np.sin(turn) * crossed(axis, v)


def bend_rules(
    joints: Float64[np.ndarray, "25 3"],
    axes: Float64[np.ndarray, "5 3"],
    usual: Float64[np.ndarray, "4 3"],
) -> Rules:
    """Hold fingers in their planes, bends within the limits of joints, and last bones near their usual directions.

    The axes (5, 3) and the usual directions (4, 3) are held fixed in the derivatives.
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
    gradients = np.concatenate([_by_joints(parts, ways, length) for parts in by_way])
    return Rules(np.concatenate([back, far, twist, aside, drawn]), gradients)


def _by_joints(
    parts: Sequence[tuple[Int64[np.ndarray, "rules"], Float64[np.ndarray, "rules 3"]]],
    ways: Float64[np.ndarray, "bones 3"],
    length: Float64[np.ndarray, "bones"],
) -> Float64[np.ndarray, "rules unknowns"]:
    """Turn derivatives of rules by the unit directions of bones, one bone each, to those by joints."""
    rows = np.arange(len(parts[0][0]))
    gradients = np.zeros((len(rows), COUNT))
    by_joint = gradients[:, JOINTS].reshape(-1, 25, 3)
    for bone, gradient in parts:
        way = ways[bone]
        moved = (gradient - np.einsum("ri,ri->r", gradient, way)[:, None] * way) / length[
            bone, None
        ]
        by_joint[rows, ENDS[bone, 1]] += moved
        by_joint[rows, ENDS[bone, 0]] -= moved
    return gradients


def landmark_pull(
    off: Float64[np.ndarray, "25 3"], spread: Float64[np.ndarray, "25"]
) -> tuple[Float64[np.ndarray, "25"], float]:
    """Weight landmarks [1/m] that are ``off`` [m] by the density of Cauchy's distribution of a ``spread`` [m].

    Also returns twice their cost, whose gradient is twice the squares of the weights times ``off``.
    """
    far = np.linalg.norm(off, axis=1) / (3.0 * spread)
    return 1.0 / (spread * np.sqrt(1.0 + far**2)), 9.0 * float(np.log1p(far**2).sum())
