"""Random poses of a hand within the limits of its joints, by its bones' own lengths."""

import json

import numpy as np
from scipy.spatial.transform import Rotation

from airtact.hands.joints import CHAINS
from airtact.setup.examples import example as packaged

FLEXION = ((-20, 90), (0, 110), (0, 80))
"""Bending of knuckle, middle and last joint of a finger [degrees]."""

SPREAD = 15
"""Largest turn of a finger to a side [degrees]; straight fingers only, bent ones cannot."""

THUMB = ((-25, 25), (-20, 45), (0, 55), (-15, 80))
"""Turn of the thumb's root within the palm's plane and out of it, bending of its two other joints [degrees]."""


def example(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return joints (25, 3) and radii (25,) of an example [m]."""
    pose = json.loads(packaged(f"{name}.json").read_text())
    return np.array(pose["positions_m"]), np.array(pose["radii_m"])


def turned(vectors: np.ndarray, axis: np.ndarray, degrees: float) -> np.ndarray:
    return Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).apply(vectors)


def random_pose(seed: int, rest: np.ndarray) -> np.ndarray:
    """Bend every joint of a left hand at rest by chance: in a third of all poses all fingers alike."""
    random = np.random.default_rng(seed)
    joints = rest.copy()
    across = (rest[6] - rest[21]) / np.linalg.norm(rest[6] - rest[21])
    alike, bends = random.random() < 1 / 3, random.uniform(size=3)
    for chain in CHAINS[1:]:
        knuckle, lengths = (
            rest[chain[1]],
            np.linalg.norm(np.diff(rest[list(chain[1:])], axis=0), axis=1),
        )
        straight = rest[chain[1]] - (0.8 * rest[0] + 0.2 * rest[chain[0]])
        straight = straight / np.linalg.norm(straight)
        axis = -(across - (across @ straight) * straight)  # a left hand's fingers bend about it
        shares = bends + random.normal(scale=0.05, size=3) if alike else random.uniform(size=3)
        angles = [
            low + np.clip(share, 0, 1) * (high - low)
            for share, (low, high) in zip(shares, FLEXION, strict=True)
        ]
        side = random.uniform(-SPREAD, SPREAD) * (1 - max(angles[0], 0) / 90)
        dorsal = np.cross(straight, axis)
        bone, place = turned(straight, dorsal, side), knuckle
        axis = turned(axis, dorsal, side)
        for joint, angle, length in zip(chain[2:], angles, lengths, strict=True):
            bone = turned(bone, axis, angle)
            place = place + length * bone
            joints[joint] = place
    _pose_thumb(joints, rest, random)
    return joints


def _pose_thumb(joints: np.ndarray, rest: np.ndarray, random: np.random.Generator) -> None:
    bones = np.diff(rest[1:5], axis=0)
    back = np.cross(rest[6] - rest[21], rest[11] - rest[0])
    back = back / np.linalg.norm(back)
    sideways, outwards, middle, last = (random.uniform(*limits) for limits in THUMB)
    first = turned(turned(bones, back, sideways), np.cross(bones[0], back), outwards)
    to_index = 0.5 * (rest[6] + rest[7]) - rest[1] - first.sum(axis=0)
    axis = np.cross(first[-1], to_index / np.linalg.norm(to_index) - 0.5 * back)
    first[1:] = turned(first[1:], axis, middle)
    first[2:] = turned(first[2:], axis, last)
    joints[2:5] = rest[1] + np.cumsum(first, axis=0)
