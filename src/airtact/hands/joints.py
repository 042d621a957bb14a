"""Check the joints of a hand that trackers give: 25 of WebXR, or 21 of MediaPipe and Leap.

Sources
-------
- *WebXR Hand Input Module* (W3C): names and order of the 25 joints.
- Meta Platforms, iwer 2.5.0 (MIT): skin radii of a generic hand, ``examples/hands/README.md``.
- A. Buryanov, V. Kotiuk, "Proportions of hand segments", Int. J. Morphol. 28, 755 (2010): lengths
    of phalanges.
"""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Literal

import numpy as np
from jaxtyping import Float64, Real

from airtact.checks import check_finite, counted, fixed, points_of, real_numbers, within
from airtact.errors import InvalidInput

Side = Literal["right", "left"]

FINGERS = ("thumb", "index", "middle", "ring", "pinky")

NAMES = (
    "wrist",
    *(f"thumb-{bone}" for bone in ("metacarpal", "phalanx-proximal", "phalanx-distal", "tip")),
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
"""The 25 joints of WebXR, in its order."""

CHAINS = (
    (1, 2, 3, 4),
    (5, 6, 7, 8, 9),
    (10, 11, 12, 13, 14),
    (15, 16, 17, 18, 19),
    (20, 21, 22, 23, 24),
)
"""Joints of each finger, from the wrist to the tip."""

BONES = tuple((0, chain[0]) for chain in CHAINS) + tuple(
    pair for chain in CHAINS for pair in pairwise(chain)
)
"""Joints at both ends of every bone."""

RADII = fixed(
    1e-3
    * np.array(
        [21.461, 19.383, 12.283, 9.769, 8.769, 21.228, 10.295, 8.538, 7.636, 6.636]
        + [21.232, 11.174, 8.031, 7.629, 6.629, 19.088, 9.922, 7.612, 7.231, 6.231]
        + [18.088, 8.483, 6.764, 6.426, 5.426]
    )
)
"""Radius of the skin round each joint of a hand of ``LENGTH`` [m]."""

LENGTH = 0.1942
"""Length of that hand: wrist to middle tip along the bones [m], without the tip's own radius."""

LENGTHS = (0.08, 0.3)
"""Lengths that hands have [m]."""

KNUCKLE = 0.41
"""Share of the way from wrist to knuckle at which the base of the metacarpal lies, where it is not tracked."""

LARGEST = 1.0
"""Joints farther apart than this cannot be metres [m]."""

LONGEST = (0.08, 0.11, 0.08, 0.06, 0.05)
"""Longest bones there are: wrist to metacarpal, metacarpal, proximal, intermediate and last phalanx [m]."""

SHORTEST = (0.01, 0.025, 0.018, 0.01, 0.008)
"""Shortest bones there are, a child's [m]."""

_BOUNDS = np.array([SHORTEST, LONGEST])[:, [0] * 5 + [1, 2, 4] + 4 * [1, 2, 3, 4]]
"""Those of each of ``BONES``, shortest and longest; the thumb has no intermediate phalanx."""

ORDERED = 5e-3
"""By so much may knuckles, or the thumb between its neighbours, be out of order [m]."""

STRAIGHT = 0.2
"""Sum of the sines of all bends below which the side of a hand is unknown."""

RADIUS = (0.003, 0.035)
"""Radii that the skin round a joint may have [m]."""


def joints_of(
    given: Real[np.ndarray, "joints 3"], rough: float = 0.0, what: str = "joint"
) -> Float64[np.ndarray, "25 3"]:
    """Return the 25 joints of WebXR [m] of these, or of the 21 of MediaPipe and Leap; raise for joints no hand has.

    Bones of rough joints may be longer or shorter than any by ``rough`` [m]; ``what`` is a joint's
    name in sentences.
    """
    joints = real_numbers(given, f"{what}s of a hand")
    if joints.shape in ((21, 3), (25, 3)) and not np.isfinite(joints).all():
        bad = np.flatnonzero(~np.isfinite(joints).all(axis=1))
        first = NAMES[bad[0]] if len(joints) == 25 else NAMES[_TRACKED[bad[0]]]
        are = counted(len(bad), f"{what} is", f"{what}s are")
        raise InvalidInput(
            f"{are} NaN or infinite, the first is {what} {bad[0]}, {first}: the tracker lost it; leave this frame out.",
            code="not_finite",
        )
    joints = points_of(joints, f"{what}s of a hand")
    if len(joints) not in (21, 25):
        are = counted(len(joints), f"{what} is", f"{what}s are")
        raise InvalidInput(
            f"{are} given, but a hand has 25 (WebXR) or 21 (MediaPipe, Leap).", code="joint_count"
        )
    spread = float(np.ptp(joints, axis=0).max())
    if spread > LARGEST:
        sentence = f"the {what}s span {spread:.4g} m: are they in millimetres? Give metres."
        raise InvalidInput(sentence, code="not_in_metres")
    if len(joints) == 21:
        tracked, joints = joints, np.empty((25, 3))
        joints[_TRACKED] = tracked
        for chain in CHAINS[1:]:
            joints[chain[0]] = (1.0 - KNUCKLE) * joints[0] + KNUCKLE * joints[chain[1]]
    _check_bone_lengths(joints, rough)
    return fixed(joints)


def named_joints(given: Mapping[str, Real[np.ndarray, "3"]]) -> Float64[np.ndarray, "25 3"]:
    """Put joints that are given by WebXR's names, three coordinates each [m], into its order; raise where any lacks."""
    missing = [name for name in NAMES if name not in given]
    if missing:
        count = counted(len(missing), "joint is", "joints are")
        raise InvalidInput(f"{count} missing, the first is {missing[0]}.", code="joint_missing")
    unknown = [name for name in given if name not in NAMES]
    if unknown:
        raise InvalidInput(f"{unknown[0]} is not 1 of the 25 joints of WebXR.", code="unknown_name")
    return joints_of(real_numbers(np.array([given[name] for name in NAMES]), "joints of a hand"))


def radii_of(
    given: Real[np.ndarray, "joints"] | None,
    length: float | None,
    joints: Float64[np.ndarray, "25 3"],
) -> Float64[np.ndarray, "25"]:
    """Return the radius of the skin round each joint [m], those of the generic hand where None are given.

    That hand is scaled to the ``length`` from the wrist to the tip of the middle finger [m], or
    else to the joints.
    """
    if given is None and length is not None:
        length = within(
            length, *LENGTHS, "the length of a hand", "m", "is it in millimetres? Give metres."
        )
        return fixed(length / LENGTH * RADII)
    full = hand_length(joints) / LENGTH * RADII
    if given is None:
        return fixed(full)
    radii = real_numbers(given, "radii of a hand")
    if radii.shape not in ((25,), (21,)):
        sentence = f"radii of a hand have shape {radii.shape}, but there are 25, or 21, one for each joint."
        raise InvalidInput(sentence, code="wrong_shape")
    check_finite(radii, "radii of a hand")
    if len(radii) == 21:
        full[_TRACKED] = radii
        radii = fixed(full)
    wrong = np.flatnonzero((radii < RADIUS[0]) | (radii > RADIUS[1]))
    if len(wrong):
        raise InvalidInput(
            f"the radius at {NAMES[wrong[0]]} is {1e3 * radii[wrong[0]]:.4g} mm, but skin lies {1e3 * RADIUS[0]:g} to "
            f"{1e3 * RADIUS[1]:g} mm from a joint: are the radii in metres?",
            code="out_of_range",
        )
    return radii


def hand_length(joints: Float64[np.ndarray, "25 3"]) -> float:
    """Length of a hand along its bones, wrist to the tip of the middle finger [m]."""
    chain = joints[[0, 11, 12, 13, 14]]
    return float(np.linalg.norm(np.diff(chain, axis=0), axis=1).sum())


def checked_side(
    joints: Float64[np.ndarray, "25 3"],
    side: str | None,
    what: str = "joints",
    clear: float = STRAIGHT,
) -> Side:
    """Return the side of a hand, found from its bends unless given; raise where these leave it open or contradict it.

    Bends distinguish a left hand from a right one where the magnitude of ``evidence_of`` is at
    least ``clear``.
    """
    if side not in ("right", "left", None):
        raise InvalidInput(
            f"the side of a hand is {side!r}, but there are 2: 'right' and 'left'.",
            code="unknown_name",
        )
    evidence = evidence_of(joints)
    seen = "right" if evidence > 0.0 else "left"
    if side is None and abs(evidence) < clear:
        raise InvalidInput(
            f"the {what} do not distinguish a left hand from a right one ({evidence:+.2f}, beyond {clear:g} they "
            "would): the fingers are too straight; give side.",
            code="side_unclear",
        )
    if side is not None and side != seen and abs(evidence) >= clear:
        raise InvalidInput(
            f"the {what} are given as those of a {side} hand, but the fingers bend and the thumb points as those of a "
            f"{seen} one ({evidence:+.2f}, above 0 being right): are they mirrored?",
            code="wrong_side",
        )
    return side or seen


def evidence_of(joints: Float64[np.ndarray, "25 3"]) -> float:
    """Sum the sines of all bends of the fingers and of the thumb's lean, positive for a right hand."""
    across = unit(joints[6] - joints[21])
    back = unit(cross(joints[11] - joints[0], across))
    bones = np.diff(joints[_LONG_FINGERS], axis=1)
    bones /= np.linalg.norm(bones, axis=2, keepdims=True)
    bends = np.cross(bones[:, :-1], bones[:, 1:]) @ across
    return float(bends.sum()) - float(unit(joints[4] - joints[1]) @ back)


_LONG_FINGERS = np.array(CHAINS[1:])
"""Joints of each finger but the thumb."""


def check_finger_order(joints: Float64[np.ndarray, "25 3"], rough: float = 0.0) -> None:
    """Raise where joints known to ``rough`` [m] have knuckles out of order, or the thumb at the little finger."""
    knuckles = np.array([chain[1] for chain in CHAINS[1:]])
    across = (joints[knuckles] - joints[knuckles[0]]) @ unit(
        joints[knuckles[-1]] - joints[knuckles[0]]
    )
    steps = np.diff(across)
    worst = int(steps.argmin())
    if steps[worst] < -ORDERED - 0.5 * rough:
        raise InvalidInput(
            f"the knuckle of the {FINGERS[worst + 2]} finger is {-1e3 * steps[worst]:.3g} mm nearer to the index "
            f"finger's than that of the {FINGERS[worst + 1]} finger: are fingers swapped?",
            joints[knuckles[worst]],
            code="hand_implausible",
        )
    far = [float(np.linalg.norm(joints[CHAINS[0][1]] - joints[knuckles[end]])) for end in (0, -1)]
    if far[1] < far[0] - ORDERED - 0.5 * rough:
        raise InvalidInput(
            f"the thumb is {1e3 * far[1]:.3g} mm from the little finger's knuckle and {1e3 * far[0]:.3g} mm from the "
            "index finger's: are fingers swapped?",
            joints[CHAINS[0][1]],
            code="hand_implausible",
        )


def unit(vector: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
    """Bring a vector (3,) to length 1."""
    return vector / math.sqrt(vector @ vector)


def cross(
    one: Float64[np.ndarray, "3"], other: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "3"]:
    """Cross product of two vectors (3,), in a tenth of the time that ``numpy.cross`` takes for one pair."""
    (x, y, z), (u, v, w) = one.tolist(), other.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


_TRACKED = np.array(
    [0, 1, 2, 3, 4, *(start + k for start in (5, 10, 15, 20) for k in (1, 2, 3, 4))]
)
"""Which of the 25 the 21 are."""


def _check_bone_lengths(joints: Float64[np.ndarray, "25 3"], rough: float) -> None:
    ends = np.array(BONES)
    lengths = np.linalg.norm(joints[ends[:, 0]] - joints[ends[:, 1]], axis=1)
    low, high = _BOUNDS
    wrong = np.flatnonzero((lengths < low - rough) | (lengths > high + rough))
    if len(wrong) == 0:
        return
    first = int(wrong[0])
    one, two = (NAMES[index] for index in ends[first])
    others = "; give those joints anew."
    if len(wrong) > 1:
        more = counted(len(wrong) - 1, "more bone is", "more bones are")
        others = f", and {more} as wrong: are joints swapped or the same?"
    raise InvalidInput(
        f"the bone from {one} to {two} is {1e3 * lengths[first]:.4g} mm long, but such bones are "
        f"{1e3 * low[first]:g} to {1e3 * high[first]:g} mm{others}",
        joints[ends[first]].mean(axis=0),
        code="bone_length",
    )
