"""Unknowns and priors of the fit: sizes, joint limits and inaccurate landmarks.

The 137 unknowns are the 75 coordinates of the joints [m], followed by the logarithms of 62 sizes:
37 lengths [m], in the order of ``SPANS``, and the radii at 25 joints [m]. The 100 unknowns of the
body are its joints and radii. Each prior is a residual divided by its standard deviation, with
exact derivatives with respect to the unknowns.

Sources
-------
- Meta Platforms, iwer 2.5.0 (MIT): proportions of a generic hand, from
  ``examples/hands/relaxed.json``.
- A. Buryanov, V. Kotiuk, "Proportions of hand segments", Int. J. Morphol. 28, 755 (2010): hands
  differ from the mean proportions by about a tenth.
- E. Y. S. Chao, K.-N. An, W. P. Cooney, R. L. Linscheid, *Biomechanics of the Hand*, World
  Scientific (1989): ranges of motion of the joints.
- H. Rijpkema, M. Girard, SIGGRAPH Comput. Graph. 25, 339 (1991): the last joint of a finger bends
  by two thirds of the angle of the middle joint.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from airtact.errors import fixed, in_short
from airtact.hands.body import WEB_BALL
from airtact.hands.joints import BONES, CHAINS, GENERIC_RADII, Joints, crossed, unit
from airtact.hands.kinematics import LAST_BEND_SHARE, bending_axis

Unknowns = Float64[np.ndarray, "137"]
UnknownsMatrix = Float64[np.ndarray, "137 137"]
Sizes = Float64[np.ndarray, "62"]
SizesMatrix = Float64[np.ndarray, "62 62"]
Axes = Float64[np.ndarray, "5 3"]

# --- the unknowns -----------------------------------------------------------------------------

# Joints at both ends of the 37 constant lengths of a hand.
SPANS = (
    *BONES,
    # joints of the palm at constant distances, without a bone between them
    *((5, 10), (10, 15), (15, 20), (6, 11), (11, 16), (16, 21), (1, 5)),
    *((5, 11), (10, 6), (10, 16), (15, 11), (15, 21), (20, 16)),
)

# Slices of the unknowns: joint coordinates, logarithms of sizes, and logarithms of radii.
JOINTS = slice(0, 75)
SIZES = slice(75, 137)
RADII = slice(112, 137)

# Slices of the sizes: lengths and radii.
SIZE_LENGTHS = slice(0, 37)
SIZE_RADII = slice(37, 62)

# Unknowns of the body, and their block in a matrix of all unknowns.
BODY = np.r_[JOINTS, RADII]
BODY_BLOCK = np.ix_(BODY, BODY)


def _balls_by_body() -> Float64[np.ndarray, "104 100"]:
    """Return the derivatives of the 26 balls (centres, radii) with respect to joints and radii."""
    rows = np.zeros((26, 4, 100))
    for ball in range(25):
        rows[ball, range(3), range(3 * ball, 3 * ball + 3)] = 1.0
        rows[ball, 3, 75 + ball] = 1.0
    rows[WEB_BALL] = 0.5 * (rows[1] + rows[2])
    rows[WEB_BALL, 3] = 0.4 * (rows[1, 3] + rows[2, 3])
    return rows.reshape(104, 100)


_BALLS_BY_BODY = _balls_by_body()


def joints_in(unknowns: Unknowns) -> Joints:
    """Return the joints [m] from a vector of unknowns."""
    return unknowns[JOINTS].reshape(25, 3)


def balls_at(unknowns: Unknowns) -> Float64[np.ndarray, "26 4"]:
    """Return the centres and radii of the balls of a hand [m]."""
    body = np.concatenate([unknowns[JOINTS], np.exp(unknowns[RADII])])
    return (_BALLS_BY_BODY @ body).reshape(26, 4)


def by_body(
    by_balls: Float64[np.ndarray, "rows 104"], sizes: Sizes
) -> Float64[np.ndarray, "rows 100"]:
    """Convert derivatives with respect to balls to derivatives with respect to joints and sizes."""
    derivatives = by_balls @ _BALLS_BY_BODY
    derivatives[:, 75:] *= np.exp(sizes[SIZE_RADII])
    return derivatives


# --- sizes of a person ------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class HandAnatomy:
    """Sizes of one person's hand, as a normal distribution of their natural logarithms.

    ``fit_hand`` returns it as ``FittedHand.anatomy``. Pass it to the fit of the next frame of the
    same person, to learn the sizes over several frames.

    Attributes
    ----------
    mean : (62,) mean logarithms of 24 bone lengths, of 13 distances between joints of the palm, and
        of the radii at the 25 joints in WebXR order, all in metres.
    covariance : (62, 62) covariance of the logarithms.
    frames : number of frames from which the sizes were learned; 0 for the sizes of a population.
    """

    mean: Sizes
    covariance: SizesMatrix
    frames: int

    __repr__ = in_short

    @property
    def settled(self) -> bool:
        """Whether the sizes were learned from at least 8 frames and now stay fixed."""
        return self.frames >= 8

    def learned(self, sizes: Sizes, covariance: SizesMatrix) -> "HandAnatomy":
        """Return the anatomy averaged with one more frame, of given sizes (62,) and covariance.

        The covariance is not divided by the number of frames, because the shape of the model has
        the same error in every frame.
        """
        share = 1.0 / (self.frames + 1)
        return HandAnatomy(
            fixed((1.0 - share) * self.mean + share * sizes),
            fixed((1.0 - share) * self.covariance + share * covariance),
            self.frames + 1,
        )


# Lengths of ``SPANS`` of the generic hand [m].
_GENERIC_LENGTHS = 1e-3 * np.array(
    [49.4, 43.2, 35.9, 39.0, 42.8, 33.0, 34.3, 25.0, 60.6, 38.5, 24.7, 22.7, 62.6, 43.6]
    + [28.0, 25.4, 54.8, 39.6, 27.0, 24.8, 46.4, 31.2, 20.6, 22.3]
    + [16.7, 19.0, 8.9, 22.7, 21.1, 22.2, 12.7, 63.5, 65.9, 59.3, 64.2, 48.9, 55.8]
)


def population_prior(joints: Joints) -> HandAnatomy:
    """Return the distribution of hand sizes, scaled to the distances from wrist to knuckles."""
    knuckles = [chain[1] for chain in CHAINS[1:]]
    metacarpals = [SPANS.index((chain[0], chain[1])) for chain in CHAINS[1:]]
    generic = _GENERIC_LENGTHS[1:5] + _GENERIC_LENGTHS[metacarpals]
    scale = float(np.linalg.norm(joints[knuckles] - joints[0], axis=1).sum() / generic.sum())
    # Standard deviation of the logarithm of each size. Last bones vary most, because trackers
    # define their ends differently. The radii at the wrist and at the bases of the metacarpals are
    # nearly fixed; otherwise they would grow to fit the flat side of the palm.
    alone = np.full(62, 0.08)  # bones
    alone[:5] = 0.15  # bones at the wrist
    alone[[SPANS.index((chain[-2], chain[-1])) for chain in CHAINS]] = 0.3  # last bones
    alone[len(BONES) : len(SPANS)] = 0.2  # across the palm
    alone[SIZE_RADII] = 0.05
    alone[SIZE_RADII.start + np.array([0, *(chain[0] for chain in CHAINS)])] = 0.02
    # Long hands are slender: radii grow as the length to the power of 0.6.
    growth = np.ones(62)
    growth[SIZE_RADII] = 0.6
    # These are the correlations of all sizes, of all radii, and of the radii of a finger.
    covariance = np.diag(alone**2) + 0.15**2 * np.outer(growth, growth)
    covariance[SIZE_RADII, SIZE_RADII] += 0.05**2
    for chain in CHAINS:
        rows = SIZE_RADII.start + np.array(chain[1:])
        covariance[np.ix_(rows, rows)] += 0.03**2
    mean = np.log(np.r_[_GENERIC_LENGTHS, GENERIC_RADII]) + np.log(scale) * growth
    return HandAnatomy(fixed(mean), fixed(covariance), 0)


# --- rules of lengths and bends ---------------------------------------------------------------


class Rules(NamedTuple):
    """Residuals of the priors, divided by their standard deviations, and their derivatives.

    Attributes
    ----------
    residuals : (R,) residuals, each divided by its standard deviation.
    gradients : (R, 137) derivatives with respect to joints [1/m] and logarithms of sizes.
    """

    residuals: Float64[np.ndarray, "rules"]
    gradients: Float64[np.ndarray, "rules 137"]


_SPAN_ENDS = np.array(SPANS)

# Standard deviations of the lengths of SPANS between frames [m]: bones at the wrist, other bones,
# and distances across the palm.
_SPAN_SPREAD = np.repeat([1.0e-3, 0.5e-3, 2.0e-3], [5, len(BONES) - 5, len(SPANS) - len(BONES)])

# Joints at both ends of the 19 bones of the fingers, with the three of the thumb first; indices of
# the first phalanges without the thumb; and bones on both sides of the 14 joints that bend.
_FINGER_BONES = np.array([pair for chain in CHAINS for pair in pairwise(chain)])
_FIRST = np.array([4, 8, 12, 16])
_BENDS = np.array(
    [(0, 1), (1, 2), *((bone + k - 1, bone + k) for bone in _FIRST for k in range(3))]
)

# Smallest sines and cosines of these bends: two of the thumb, then the knuckle, middle and last
# joint of each finger. A negative sine is a backward bend.
_MIN_SINES = np.array([-0.5, -0.3, *(4 * [-0.5, -0.15, -0.25])])
_MIN_COSINES = np.array([0.2, 0.0, *(4 * [-0.35, -0.35, 0.0])])


def length_rules(joints: Joints, sizes: Sizes) -> Rules:
    """Return residuals that compare bone lengths and palm widths with those in ``sizes`` (62,)."""
    starts, ends = _SPAN_ENDS.T
    along = joints[ends] - joints[starts]
    length = np.sqrt((along**2).sum(axis=1))
    expected = np.exp(sizes[SIZE_LENGTHS])
    rows = np.arange(len(SPANS))
    gradients = np.zeros((len(SPANS), 137))
    by_joint = gradients[:, JOINTS].reshape(-1, 25, 3)
    way = along / (length * _SPAN_SPREAD)[:, None]
    by_joint[rows, ends] += way
    by_joint[rows, starts] -= way
    gradients[rows, SIZES.start + rows] = -expected / _SPAN_SPREAD
    return Rules((length - expected) / _SPAN_SPREAD, gradients)


def bending_axes(joints: Joints, side: str) -> Axes:
    """Return the unit axes (5, 3) about which the fingers of a right or left hand bend."""
    across = unit(joints[6] - joints[21]) * (1.0 if side == "right" else -1.0)
    palm = joints[[chain[1] for chain in CHAINS[1:]]] - joints[0]
    aside = across - (palm @ across / (palm**2).sum(axis=1))[:, None] * palm
    axes = aside / np.sqrt((aside**2).sum(axis=1))[:, None]
    return np.vstack([bending_axis(joints, side, 0), axes])


def usual_last_bones(joints: Joints, axes: Axes) -> Float64[np.ndarray, "4 3"]:
    """Return the usual directions (4, 3) of the last bones of fingers with bending axes (5, 3)."""
    along = joints[_FINGER_BONES[:, 1]] - joints[_FINGER_BONES[:, 0]]
    ways = along / np.sqrt((along**2).sum(axis=1))[:, None]
    first = ways[_FIRST]
    middle = ways[_FIRST + 1]
    axis = axes[1:]
    sine = np.einsum("fi,fi->f", crossed(first, middle), axis)
    bend = np.arctan2(sine, np.einsum("fi,fi->f", first, middle))
    # Outside these limits, the last joint does not bend any further.
    turn = LAST_BEND_SHARE * np.clip(bend, -0.3, 2.0)[:, None]
    return np.cos(turn) * middle + np.sin(turn) * crossed(axis, middle)


def bend_rules(joints: Joints, axes: Axes, usual: Float64[np.ndarray, "4 3"]) -> Rules:
    """Return the residuals of the priors on the bends, planes and last bones of the fingers.

    Of the 52 residuals, 14 are for backward bends, 14 for excessive bends, 8 for middle and last
    phalanges out of the plane of the first, 4 for sideways turns, and 12 for the directions of 4
    last bones. The derivatives treat the axes (5, 3) and the usual directions (4, 3) as constant.
    """
    beyond_limit = 0.05  # standard deviation of sines and cosines beyond their limits
    out_of_plane = 0.08
    off_usual = 0.3  # [rad]
    along = joints[_FINGER_BONES[:, 1]] - joints[_FINGER_BONES[:, 0]]
    length = np.sqrt((along**2).sum(axis=1))
    ways = along / length[:, None]
    u = ways[_BENDS[:, 0]]
    v = ways[_BENDS[:, 1]]
    axis = np.repeat(axes, [2, 3, 3, 3, 3], axis=0)
    sines = np.einsum("bi,bi->b", crossed(u, v), axis)
    backwards = np.maximum(_MIN_SINES - sines, 0.0) / beyond_limit
    too_far = np.maximum(_MIN_COSINES - np.einsum("bi,bi->b", u, v), 0.0) / beyond_limit
    first = np.repeat(_FIRST, 2)
    outer = first + np.tile([1, 2], 4)
    plane = np.repeat(axes[1:], 2, axis=0)
    twist = np.einsum("hi,hi->h", ways[outer] - ways[first], plane) / out_of_plane
    turn = np.einsum("fi,fi->f", ways[_FIRST], axes[1:])
    aside = np.sign(turn) * np.maximum(np.abs(turn) - 0.45, 0.0) / beyond_limit
    last = (ways[_FIRST + 2] - usual) / off_usual
    residuals = np.concatenate([backwards, too_far, twist, aside, last.ravel()])

    bends_back = -(backwards != 0.0).astype(np.float64)[:, None] / beyond_limit
    bends_far = -(too_far != 0.0).astype(np.float64)[:, None] / beyond_limit
    turns_aside = (aside != 0.0)[:, None] * axes[1:] / beyond_limit
    by_last = np.tile(np.eye(3) / off_usual, (4, 1))
    gradients = [
        _by_joints(
            ways,
            length,
            (_BENDS[:, 0], bends_back * crossed(v, axis)),
            (_BENDS[:, 1], bends_back * crossed(axis, u)),
        ),
        _by_joints(ways, length, (_BENDS[:, 0], bends_far * v), (_BENDS[:, 1], bends_far * u)),
        _by_joints(ways, length, (first, -plane / out_of_plane), (outer, plane / out_of_plane)),
        _by_joints(ways, length, (_FIRST, turns_aside)),
        _by_joints(ways, length, (np.repeat(_FIRST + 2, 3), by_last)),
    ]
    return Rules(residuals, np.concatenate(gradients))


def _by_joints(
    ways: Float64[np.ndarray, "19 3"],
    length: Float64[np.ndarray, "19"],
    *parts: tuple[Int64[np.ndarray, "rules"], Float64[np.ndarray, "rules 3"]],
) -> Float64[np.ndarray, "rules 137"]:
    """Convert derivatives with respect to bone directions to derivatives with respect to joints.

    Each of the ``parts`` contains the index of one bone for each rule, and the derivative of the
    rule with respect to the direction of this bone.
    """
    rows = np.arange(len(parts[0][0]))
    gradients = np.zeros((len(rows), 137))
    by_joint = gradients[:, JOINTS].reshape(-1, 25, 3)
    for bone, gradient in parts:
        # Only motions of the joints perpendicular to the bone change its direction.
        way = ways[bone]
        across = gradient - np.einsum("ri,ri->r", gradient, way)[:, None] * way
        moved = across / length[bone, None]
        by_joint[rows, _FINGER_BONES[bone, 1]] += moved
        by_joint[rows, _FINGER_BONES[bone, 0]] -= moved
    return gradients


def landmark_pull(
    off: Joints, spread: Float64[np.ndarray, "25"]
) -> tuple[Float64[np.ndarray, "25"], float]:
    """Return the weights [1/m] of landmark errors ``off`` (25, 3) [m], and twice the errors' cost.

    The errors have a Cauchy distribution of width ``spread`` (25,) [m]. For weights w, the gradient
    of twice the cost is 2 w² ``off``.
    """
    excess = np.linalg.norm(off, axis=1) / (3.0 * spread)
    return 1.0 / (spread * np.sqrt(1.0 + excess**2)), 9.0 * float(np.log1p(excess**2).sum())
