"""Joints of a hand: their names and order, plausible sizes, and checks of a tracker's joints.

Trackers provide 25 joints (WebXR), 26 (OpenXR, the palm first) or 21 (MediaPipe, Leap).

Sources
-------
- *WebXR Hand Input Module* (W3C): names and order of the 25 joints.
- Meta Platforms, iwer 2.5.0 (MIT): skin radii of a generic hand, ``examples/hands/README.md``.
- A. Buryanov, V. Kotiuk, "Proportions of hand segments", Int. J. Morphol. 28, 755 (2010): lengths
  of phalanges.
"""

import math
from itertools import pairwise
from typing import Literal

import numpy as np
from jaxtyping import Float64, Real

from airtact.errors import (
    InvalidInput,
    check_finite,
    counted,
    fixed,
    millimetres,
    points_of,
    real_numbers,
    within,
)

Side = Literal["right", "left"]
Joints = Float64[np.ndarray, "25 3"]
Radii = Float64[np.ndarray, "25"]

# A position [m], or a unit direction.
Point = Float64[np.ndarray, "3"]
Points = Float64[np.ndarray, "points 3"]
PerPoint = Float64[np.ndarray, "points"]

# A point on the skin [m] and the outward unit normal there.
Place = tuple[Point, Point]

FINGERS = ("thumb", "index", "middle", "ring", "pinky")

# Names of the 25 joints of WebXR, in its order.
NAMES = (
    *("wrist", "thumb-metacarpal"),
    *("thumb-phalanx-proximal", "thumb-phalanx-distal", "thumb-tip"),
    *(
        f"{finger}-finger-{bone}"
        for finger in FINGERS[1:]
        for bone in (
            "metacarpal",
            "phalanx-proximal",
            "phalanx-intermediate",
            "phalanx-distal",
            "tip",
        )
    ),
)

# Joints of each finger, from the wrist to the tip.
CHAINS = ((1, 2, 3, 4), *(tuple(range(start, start + 5)) for start in (5, 10, 15, 20)))

# Joints at both ends of every bone.
BONES = (
    *((0, chain[0]) for chain in CHAINS),
    *(bone for chain in CHAINS for bone in pairwise(chain)),
)

# Shortest and longest bones [mm] of hands that are 0.5 to 1.5 times as large as an adult's: wrist
# to metacarpal, metacarpal, proximal, intermediate and last phalanx (no intermediate for the
# thumb).
_BONE_LIMITS = 1e-3 * np.array([[8, 13, 12, 7, 6], [80, 110, 80, 60, 50]])
_BONE_LIMITS = _BONE_LIMITS[:, [0] * 5 + [1, 2, 4] + 4 * [1, 2, 3, 4]]

# Index of each of the 21 joints of MediaPipe and Leap among the 25 of WebXR.
TRACKED = np.array([0, 1, 2, 3, 4, *(joint for chain in CHAINS[1:] for joint in chain[1:])])

# Radius of the skin around each joint of the generic hand [m].
GENERIC_RADII = fixed(
    1e-3
    * np.array(
        [21.461, 19.383, 12.283, 9.769, 8.769, 21.228, 10.295, 8.538, 7.636, 6.636]
        + [21.232, 11.174, 8.031, 7.629, 6.629, 19.088, 9.922, 7.612, 7.231, 6.231]
        + [18.088, 8.483, 6.764, 6.426, 5.426]
    )
)

# Length of the generic hand [m], as ``hand_length`` measures it.
GENERIC_LENGTH = 0.1942


def joints_of(
    joints: Real[np.ndarray, "joints 3"], tolerance: float = 0.0, word: str = "joint"
) -> Joints:
    """Check 25, 26 or 21 joints of a tracker, and return the 25 joints of WebXR (25, 3) [m].

    Parameters
    ----------
    joints : (25, 3) joints in WebXR order, (26, 3) in OpenXR order, where the palm comes first, or
        (21, 3) in MediaPipe and Leap order [m].
    tolerance : largest accepted deviation from plausible bone lengths [m].
    word : noun for a joint in error messages, such as "landmark".
    """
    points = real_numbers(joints, f"{word}s of a hand")
    if points.shape == (26, 3):
        points = points[1:]
    # Trackers mark lost joints with NaN. The message names the first of them.
    lost = np.flatnonzero(~np.isfinite(points).all(axis=-1)) if points.ndim == 2 else []
    if points.shape in ((21, 3), (25, 3)) and len(lost):
        name = NAMES[lost[0] if len(points) == 25 else TRACKED[lost[0]]]
        raise InvalidInput(
            f"{counted(len(lost), f'{word} is', f'{word}s are')} NaN or infinite; the first is "
            f"{word} {lost[0]}, {name}. The tracker lost it; skip this frame.",
            code="not_finite",
        )
    points = points_of(points, f"{word}s of a hand")
    if len(points) not in (21, 25):
        raise InvalidInput(
            f"there are {counted(len(points), word, f'{word}s')}; use 25 (WebXR), 26 (OpenXR) or "
            "21 (MediaPipe, Leap).",
            code="joint_count",
        )
    span = float(np.ptp(points, axis=0).max())
    if span > 1.0:
        raise InvalidInput(
            f"the {word}s span {span:.4g} m: are they in millimetres? Use metres.",
            code="not_in_metres",
        )
    points = completed(points)
    _check_bone_lengths(points, tolerance)
    return fixed(points)


def completed(points: Float64[np.ndarray, "joints 3"]) -> Joints:
    """Return the 25 joints (25, 3) of a hand; if only 21 are given, estimate the other four.

    MediaPipe and Leap do not report the bases of the four fingers. The function also completes
    joint velocities.
    """
    if len(points) == 25:
        return points
    joints = np.empty((25, 3))
    joints[TRACKED] = points
    for chain in CHAINS[1:]:
        # The base of a metacarpal lies 41 % of the way from the wrist to the knuckle.
        joints[chain[0]] = (1.0 - 0.41) * joints[0] + 0.41 * joints[chain[1]]
    return joints


def _check_bone_lengths(joints: Joints, tolerance: float) -> None:
    ends = np.array(BONES)
    lengths = np.linalg.norm(joints[ends[:, 0]] - joints[ends[:, 1]], axis=1)
    low, high = _BONE_LIMITS
    wrong = np.flatnonzero((lengths < low - tolerance) | (lengths > high + tolerance))
    if len(wrong) == 0:
        return
    first = int(wrong[0])
    start, end = ends[first]
    fault = (
        f"the bone from {NAMES[start]} to {NAMES[end]} is {1e3 * lengths[first]:.4g} mm long, but "
        f"such bones are {1e3 * low[first]:g} to {1e3 * high[first]:g} mm"
    )
    # Size of the hand relative to the middle of the limits, which are 0.5 and 1.5 times an adult's.
    size = float(np.median(lengths / np.sqrt(low * high)))
    together = len(joints) - len(np.unique(joints, axis=0))
    # If OpenXR's 26 joints lack the last one, each joint is in the place of the previous one.
    shifted = np.linalg.norm(joints[1:][ends[:-1, 0]] - joints[1:][ends[:-1, 1]], axis=1)
    code = "bone_length"
    if together > 2:
        fault = f"{together + 1} joints are at the same position"
        advice = ": were matrices read by rows instead of columns?"
    elif ((shifted >= low[:-1] - tolerance) & (shifted <= high[:-1] + tolerance)).all():
        advice = ": are these the first 25 of OpenXR's 26 joints? Omit the first joint, the palm."
    elif size > 1.8 or size < 0.5:
        fault = f"the bones are {size:.2g} times as long as those of a hand"
        advice = ": are these image coordinates, or are they in another unit? Use metres."
        code = "not_in_metres"
    elif len(wrong) == 1:
        advice = "; send these two joints again."
    else:
        advice = (
            f", and {counted(len(wrong) - 1, 'more bone is', 'more bones are')} out of range: are "
            "joints swapped or identical?"
        )
    raise InvalidInput(fault + advice, joints[ends[first]].mean(axis=0), code=code)


def radii_of(
    radii: Real[np.ndarray, "joints"] | None, length: float | None, joints: Joints
) -> Radii:
    """Return the checked radii of the skin (25,) [m], or generic ones if ``radii`` is None.

    ``radii`` may contain 25 or 21 numbers. Generic radii are scaled to a hand's ``length`` from the
    wrist to the tip of the middle finger [m], which by default is measured from the joints.
    """
    if radii is None and length is not None:
        length = within(length, 0.08, 0.3, "the length of a hand", "m")
        return fixed(length / GENERIC_LENGTH * GENERIC_RADII)
    generic = hand_length(joints) / GENERIC_LENGTH * GENERIC_RADII
    if radii is None:
        return fixed(generic)
    radii = real_numbers(radii, "radii of a hand")
    if radii.shape == (26,):
        radii = fixed(radii[1:])  # without the palm
    if radii.shape not in ((25,), (21,)):
        raise InvalidInput(
            f"the radii of a hand have shape {radii.shape}; use 25 or 21 radii, one per joint.",
            code="wrong_shape",
        )
    check_finite(radii, "radii of a hand")
    if len(radii) == 21:
        generic[TRACKED] = radii
        radii = fixed(generic)
    # The range covers a child's fingertip and the wrist of a large hand.
    wrong = np.flatnonzero((radii < 3e-3) | (radii > 35e-3))
    if len(wrong):
        raise InvalidInput(
            f"the radius at {NAMES[wrong[0]]} is {1e3 * radii[wrong[0]]:.4g} mm, but skin lies "
            "3 to 35 mm from a joint; pass the radii in metres.",
            code="out_of_range",
        )
    return radii


def hand_length(joints: Joints) -> float:
    """Return the length [m] of a hand along its bones, from the wrist to the middle fingertip."""
    return float(np.linalg.norm(np.diff(joints[[0, 11, 12, 13, 14]], axis=0), axis=1).sum())


def side_named(side: str | None) -> Side | None:
    """Return "right" or "left" for a side in upper or lower case, such as MediaPipe's "Left"."""
    lower = side.lower() if isinstance(side, str) else side
    if lower not in ("right", "left", None):
        raise InvalidInput(
            f"the side of a hand is {side!r}; use 'right' or 'left'.", code="unknown_name"
        )
    return lower


def checked_side(
    joints: Joints, side: str | None, word: str = "joints", min_evidence: float = 0.2
) -> Side:
    """Return the side of a hand; by default, infer it from the bends of the fingers.

    The function raises ``InvalidInput`` if the bends contradict ``side``, or if no side is given
    and the magnitude of ``side_evidence`` is below ``min_evidence``.
    """
    known = side_named(side)
    evidence = side_evidence(joints)
    bent_as: Side = "right" if evidence > 0.0 else "left"
    if known is None and abs(evidence) < min_evidence:
        raise InvalidInput(
            f"the {word} do not show whether this is a left or a right hand, because the fingers "
            f"are too straight. The sum of their bends is {evidence:+z.2f}, but its magnitude must "
            f"be at least {min_evidence:g}. Set side.",
            code="side_unclear",
        )
    if known not in (None, bent_as) and abs(evidence) >= min_evidence:
        raise InvalidInput(
            f"the {word} are labelled as a {known} hand, but fingers and thumb bend like those of "
            f"a {bent_as} hand. The sum of bends is {evidence:+z.2f}; it is positive for a right "
            f"hand. Are the {word} mirrored?",
            code="wrong_side",
        )
    return known or bent_as


def side_evidence(joints: Joints) -> float:
    """Return a number that is positive for a right hand and negative for a left hand.

    The result is the sum of the sines of all bends and of the angle of the thumb from the palm.
    Small bends are ignored, because they could be backward bends of the other hand: up to 30
    degrees at a knuckle, and up to 9 and 17 degrees at the next joints. For larger bends, the sine
    of the limit is subtracted from the sine of the bend. Straight fingers add about 0.
    """
    # Fingers bend toward the palm. Viewed across the palm from the little finger, all bends of a
    # right hand turn one way, and those of a left hand the other way.
    across = unit(joints[6] - joints[21])
    back = unit(cross(joints[11] - joints[0], across))
    bones = np.diff(joints[np.array(CHAINS[1:])], axis=1)
    bones /= np.linalg.norm(bones, axis=2, keepdims=True)
    bends = np.cross(bones[:, :-1], bones[:, 1:]) @ across
    lean = -float(unit(joints[4] - joints[1]) @ back)
    sines = np.append(bends, lean)
    backwards = np.array([0.5, 0.15, 0.3] * 4 + [0.2])
    return float((sines - np.clip(sines, -backwards, backwards)).sum())


def check_finger_order(joints: Joints, tolerance: float = 0.0) -> None:
    """Raise an error if the knuckles are out of order or the thumb is beside the little finger.

    ``tolerance`` is the largest expected error of the joints [m].
    """
    slack = 5e-3 + 0.5 * tolerance
    knuckles = np.array([chain[1] for chain in CHAINS[1:]])
    # The steps are along the line of the knuckles, from the index finger to the little finger.
    from_index = joints[knuckles] - joints[knuckles[0]]
    steps = np.diff(from_index @ unit(from_index[-1]))
    worst = int(steps.argmin())
    if steps[worst] < -slack:
        raise InvalidInput(
            f"the knuckle of the {FINGERS[worst + 2]} finger is {millimetres(-steps[worst], 3)} "
            f"nearer to the index finger than the knuckle of the {FINGERS[worst + 1]} finger. "
            "Check the order of the joints; fingers may be swapped.",
            joints[knuckles[worst]],
            code="hand_implausible",
        )
    thumb = joints[CHAINS[0][1]]
    to_index = float(np.linalg.norm(thumb - joints[knuckles[0]]))
    to_pinky = float(np.linalg.norm(thumb - joints[knuckles[-1]]))
    if to_pinky < to_index - slack:
        raise InvalidInput(
            f"the thumb is {millimetres(to_pinky, 3)} from the little finger's knuckle and "
            f"{millimetres(to_index, 3)} from the index finger's. Check the order "
            "of the joints; fingers may be swapped.",
            thumb,
            code="hand_implausible",
        )


def unit(vector: Point) -> Point:
    """Scale a vector (3,) to length 1."""
    return vector / math.sqrt(vector @ vector)


def cross(a: Point, b: Point) -> Point:
    """Return the cross product of two vectors (3,), ten times faster than ``numpy.cross``."""
    x, y, z = a.tolist()
    u, v, w = b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def crossed(a: Float64[np.ndarray, "... 3"], b: Float64[np.ndarray, "... 3"]) -> np.ndarray:
    """Return cross products of small arrays, three times faster than ``numpy.cross``."""
    ahead = [1, 2, 0]
    back = [2, 0, 1]
    return a[..., ahead] * b[..., back] - a[..., back] * b[..., ahead]
