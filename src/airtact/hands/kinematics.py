"""The kinematics of fingers: the axes of their joints, and opening two fingers to a gap."""

import math
from itertools import pairwise
from typing import cast

import numpy as np
from jaxtyping import Float64
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from airtact.errors import InvalidInput
from airtact.hands.anatomy_parts import OWNER, PARTS
from airtact.hands.joints import BONES, CHAINS, FINGERS, cross, unit
from airtact.hands.sphere_mesh import Hulls

THUMB_TILT = 0.5
"""How much the thumb's pad faces away from the back of the hand, over how much it faces the index finger's root."""

STEADY = 0.3
"""Weight of the palm's own axis beside the axis of the bends of a finger."""

LAST_SHARE = 2.0 / 3.0
"""Share of the bend of a finger's middle joint that its last one usually has, by the tendon that they share."""

BENDS_TRIED = np.radians(np.arange(0.0, 111.0, 2.0))
"""Bends of middle joints that are tried [rad]."""

SHORT = 1e-3
"""A tip nearer than this to its knuckle, or to the axis that it bends about, does not determine the plane [m]."""

ROOTS = (1, 6, 11, 16, 21)
"""Joint at the root of each finger, which opens it."""

ANGLES = np.radians(np.concatenate([np.arange(0.0, 61.0, 3.0), -np.arange(3.0, 46.0, 3.0)]))
"""Angles that both fingers are turned by in the search for a gap, positive ones straightening them [rad]."""


def bending_axis(
    joints: Float64[np.ndarray, "25 3"], side: str, finger: int
) -> Float64[np.ndarray, "3"]:
    """Find the unit axis (3,) about which a positive angle bends a finger, 0 to 4 from thumb to little finger."""
    sign = 1.0 if side == "right" else -1.0
    across = unit(joints[6] - joints[21])
    chain = CHAINS[finger]
    bones = np.diff(joints[list(chain[-4:])], axis=0)
    bones = bones / np.linalg.norm(bones, axis=1, keepdims=True)
    if finger == 0:
        back = sign * unit(cross(joints[11] - joints[0], across))
        towards = unit(0.5 * (joints[6] + joints[7]) - joints[4]) - THUMB_TILT * back
        return unit(cross(bones[-1], towards))
    axis, seen = sign * across, sum(cross(*pair) for pair in pairwise(bones))
    axis = unit(STEADY * axis + (seen if seen @ axis > 0.0 else 0.0))
    return unit(axis - (axis @ bones[-1]) * bones[-1])


def turned(
    joints: Float64[np.ndarray, "25 3"], side: str, finger: int, angle: float
) -> Float64[np.ndarray, "25 3"]:
    """Straighten a finger at its root by an angle [rad]."""
    root = ROOTS[finger]
    outer = [joint for joint in CHAINS[finger] if joint > root]
    turn = Rotation.from_rotvec(-angle * bending_axis(joints, side, finger))
    moved = joints.copy()
    moved[outer] = joints[root] + turn.apply(joints[outer] - joints[root])
    return moved


def evenly_bent(
    landmarks: Float64[np.ndarray, "25 3"], lengths: Float64[np.ndarray, "bones"], side: str
) -> Float64[np.ndarray, "25 3"]:
    """Bend fingers, with ``lengths`` of ``BONES`` [m], so that they reach from rough knuckles to rough tips.

    Landmarks that are off by the length of a bone do not show the bends between them, but the
    distance from a knuckle to a tip still does; the bends at the joints between are usual ones.
    """
    joints = landmarks.copy()
    across = unit(landmarks[6] - landmarks[21]) * (1.0 if side == "right" else -1.0)
    for finger, chain in enumerate(CHAINS):
        outer = chain[-4:] if finger else chain[-3:]
        bones = lengths[[BONES.index(pair) for pair in pairwise(outer)]]
        bends = np.outer(BENDS_TRIED, np.cumsum([0.0, 1.0, LAST_SHARE][: len(bones)]))
        ahead, aside = (
            np.cos(bends) @ bones,
            np.sin(bends) @ bones,
        )  # of the tip, in the plane of the finger
        reach = landmarks[outer[-1]] - landmarks[outer[0]]
        best = int(np.abs(np.hypot(ahead, aside) - np.linalg.norm(reach)).argmin())
        axis = across if finger else bending_axis(landmarks, side, 0)
        if np.linalg.norm(np.cross(axis, reach)) < SHORT:
            continue
        along, up = unit(reach), unit(np.cross(axis, reach))
        angles = bends[best] - np.arctan2(aside[best], ahead[best])
        ways = np.outer(np.cos(angles), along) + np.outer(np.sin(angles), up)
        joints[list(outer[1:])] = landmarks[outer[0]] + np.cumsum(bones[:, None] * ways, axis=0)
    return joints


def gap_of(
    joints: Float64[np.ndarray, "25 3"], radii: Float64[np.ndarray, "25"], fingers: tuple[int, int]
) -> float:
    """Return the distance of the skins of two fingers' last phalanges [m], negative where they overlap."""
    one, other = (int(np.flatnonzero(finger == OWNER)[-1]) for finger in fingers)
    zero = np.zeros((1, 1))
    balls = np.column_stack([joints, radii])
    alone = Hulls(balls, PARTS[other : other + 1], zero, zero)
    low, high = 0.0, 1.0
    gap = math.inf
    for _ in range(5):
        shares = np.linspace(low, high, 13)[:, None]
        spheres = (1.0 - shares) * balls[PARTS[one, 0]] + shares * balls[PARTS[one, 1]]
        gaps = alone.each(np.ascontiguousarray(spheres[:, :3]))[:, 0] - spheres[:, 3]
        best, step = int(gaps.argmin()), (high - low) / 12.0
        gap = float(gaps[best])
        low, high = max(shares[best, 0] - step, 0.0), min(shares[best, 0] + step, 1.0)
    return gap


def opened(
    joints: Float64[np.ndarray, "25 3"],
    radii: Float64[np.ndarray, "25"],
    side: str,
    pair: tuple[int, int],
    gap: float,
) -> Float64[np.ndarray, "25 3"]:
    """Turn two fingers at their roots by the same angle until the skins of their last phalanges are a gap [m] apart.

    Raises where no angle gives the gap, with the nearest and farthest that they come.
    """

    def both(angle: float) -> Float64[np.ndarray, "25 3"]:
        moved = joints
        for finger in pair:
            moved = turned(moved, side, finger, angle)
        return moved

    def missing(angle: float) -> float:
        return gap_of(both(angle), radii, pair) - gap

    found = np.array([missing(float(angle)) for angle in ANGLES])
    for way in (np.flatnonzero(ANGLES >= 0.0), np.r_[0, np.flatnonzero(ANGLES < 0.0)]):
        for start, end in pairwise(way):
            if found[start] <= 0.0 <= found[end] or found[end] <= 0.0 <= found[start]:
                return both(
                    float(cast("float", brentq(missing, ANGLES[start], ANGLES[end], xtol=1e-9)))
                )
    one, other = (FINGERS[finger] for finger in pair)
    raise InvalidInput(
        f"the {one} and the {other} cannot be brought {1e3 * gap:g} mm apart: turning their roots leaves them "
        f"{1e3 * (found.min() + gap):.3g} to {1e3 * (found.max() + gap):.3g} mm apart; give such a gap, or "
        "another pose.",
        code="misplaced",
    )
