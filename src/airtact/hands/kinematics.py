"""Axes about which fingers bend, and opening of two fingers to a given gap."""

import math
from itertools import pairwise
from typing import cast

import numpy as np
from jaxtyping import Float64

from airtact.errors import InvalidInput
from airtact.hands.body import OWNER, PARTS, Hulls
from airtact.hands.joints import BONES, CHAINS, FINGERS, Joints, Point, Radii, cross, crossed, unit

# Four outer joints of each finger.
OUTER_JOINTS = np.array([chain[-4:] for chain in CHAINS])

# Usual ratio of the bends of a finger's last joint and middle joint, which share a tendon.
LAST_BEND_SHARE = 2.0 / 3.0


# Directions (5, 3, 3), lengths (5, 3) [m] and hinges (5, 3, 3) of the outer bones of all fingers.
FingerBones = tuple[
    Float64[np.ndarray, "5 3 3"], Float64[np.ndarray, "5 3"], Float64[np.ndarray, "5 3 3"]
]


def finger_bones(joints: Joints, side: str) -> FingerBones:
    """Return directions, lengths [m] and hinges of the three outer bones of all fingers.

    The thumb is the first finger. The hinge of a bone is the unit vector, perpendicular to the
    bone, about which a positive rotation bends the finger.
    """
    bones = np.diff(joints[OUTER_JOINTS], axis=1)
    lengths = np.sqrt(np.sum(bones**2, axis=2))
    along = bones / lengths[..., None]
    palm = (1.0 if side == "right" else -1.0) * unit(joints[6] - joints[21])
    # The axis of the palm, with a weight of 0.3, stabilises the axis of a straight finger.
    bends = crossed(along[:, :-1], along[:, 1:]).sum(axis=1)
    axes = 0.3 * palm + np.where((bends @ palm > 0.0)[:, None], bends, 0.0)
    # The thumb's pad faces the root of the index finger and, half as much, the palm.
    back = unit(cross(joints[11] - joints[0], palm))
    towards = unit(0.5 * (joints[6] + joints[7]) - joints[4]) - 0.5 * back
    axes[0] = cross(along[0, -1], towards)
    axes += 1e-9  # where axis and bone are parallel, any hinge is suitable
    hinges = axes[:, None] - np.sum(axes[:, None] * along, axis=2, keepdims=True) * along
    hinges /= np.sqrt(np.sum(hinges**2, axis=2, keepdims=True))
    return along, lengths, hinges


def bending_axis(joints: Joints, side: str, finger: int) -> Point:
    """Return the hinge (3,) of the last bone of a finger (0 is the thumb); see ``finger_bones``."""
    return finger_bones(joints, side)[2][finger, 2]


def turned(joints: Joints, side: str, finger: int, angle: float) -> Joints:
    """Return the joints with a finger straightened by an angle [rad] at its root."""
    from scipy.spatial.transform import Rotation  # importing it takes 0.2 s

    root = CHAINS[finger][0 if finger == 0 else 1]
    outer = [joint for joint in CHAINS[finger] if joint > root]
    turn = Rotation.from_rotvec(-angle * bending_axis(joints, side, finger))
    moved = joints.copy()
    moved[outer] = joints[root] + turn.apply(joints[outer] - joints[root])
    return moved


def evenly_bent(landmarks: Joints, lengths: Float64[np.ndarray, "bones"], side: str) -> Joints:
    """Replace the joints between knuckles and tips so that the bones have ``lengths`` [m].

    If the errors of the landmarks are as large as a bone, only the distance from knuckle to tip is
    reliable. The joints in between are therefore bent in their usual ratio, until the finger spans
    this distance.
    """
    joints = landmarks.copy()
    across = unit(landmarks[6] - landmarks[21]) * (1.0 if side == "right" else -1.0)
    for finger, chain in enumerate(CHAINS):
        outer = list(chain[-4:] if finger else chain[-3:])
        bones = lengths[[BONES.index(pair) for pair in pairwise(outer)]]
        angles = np.radians(np.arange(0.0, 111.0, 2.0))  # bends of the middle joint
        bends = np.outer(angles, np.cumsum([0.0, 1.0, LAST_BEND_SHARE][: len(bones)]))
        # Position of the tip in the plane of the finger.
        ahead = np.cos(bends) @ bones
        aside = np.sin(bends) @ bones
        reach = landmarks[outer[-1]] - landmarks[outer[0]]
        best = int(np.abs(np.hypot(ahead, aside) - np.linalg.norm(reach)).argmin())
        axis = across if finger else bending_axis(landmarks, side, 0)
        if np.linalg.norm(np.cross(axis, reach)) < 1e-3:
            continue  # the tip is too close to the knuckle or the axis to determine the plane
        up = unit(np.cross(axis, reach))
        directions = bends[best] - np.arctan2(aside[best], ahead[best])
        ways = np.outer(np.cos(directions), unit(reach)) + np.outer(np.sin(directions), up)
        joints[outer[1:]] = landmarks[outer[0]] + np.cumsum(bones[:, None] * ways, axis=0)
    return joints


def gap_of(joints: Joints, radii: Radii, fingers: tuple[int, int]) -> float:
    """Return the gap [m] between the last phalanges of two fingers, negative if they overlap."""
    first, second = (int(np.flatnonzero(finger == OWNER)[-1]) for finger in fingers)
    balls = np.column_stack([joints, radii])
    start, end = balls[PARTS[first, :2]]
    target = Hulls.unblended(balls, PARTS[second : second + 1])
    shares = np.array([0.0, 1.0])
    gaps = np.full(1, math.inf)
    for _ in range(5):
        shares = np.linspace(shares[0], shares[-1], 13)
        spheres = start + shares[:, None] * (end - start)
        gaps = target.each(spheres[:, :3])[:, 0] - spheres[:, 3]
        shares = shares[max(gaps.argmin() - 1, 0) : gaps.argmin() + 2]
    return float(gaps.min())


def opened(joints: Joints, radii: Radii, side: str, pair: tuple[int, int], gap: float) -> Joints:
    """Return the joints after turning two fingers at their roots until they are ``gap`` apart."""

    def both_turned(angle: float) -> Joints:
        moved = joints
        for finger in pair:
            moved = turned(moved, side, finger, angle)
        return moved

    def excess(angle: float) -> float:
        return gap_of(both_turned(angle), radii, pair) - gap

    # A change of sign is sought first by straightening both fingers, then by bending them.
    excesses = []
    for angles in (np.radians(np.arange(0.0, 61.0, 3.0)), -np.radians(np.arange(0.0, 46.0, 3.0))):
        values = [excess(float(angle)) for angle in angles]
        for index in range(len(angles) - 1):
            if min(values[index : index + 2]) <= 0.0 <= max(values[index : index + 2]):
                from scipy.optimize import brentq  # importing it takes 0.2 s

                root = brentq(excess, angles[index], angles[index + 1], xtol=1e-9)
                return both_turned(float(cast("float", root)))
        excesses += values
    raise InvalidInput(
        f"the {FINGERS[pair[0]]} and the {FINGERS[pair[1]]} cannot be opened to a gap of "
        f"{1e3 * gap:g} mm. Turning both at their roots allows gaps from "
        f"{1e3 * (min(excesses) + gap):.3g} to {1e3 * (max(excesses) + gap):.3g} mm. "
        "Use a gap in this range, or another pose.",
        code="misplaced",
    )
