"""The twenty poses of a left hand that cameras are tried with, and the views of them."""

import numpy as np

from airtact.geometry.pose import Pose
from airtact.hands.hand import Hand, hand_from_joints
from airtact.hands.joints import CHAINS
from references.hand_pictures import facing
from references.hand_poses import example, turned

BENDS = ((-15, 35), (0, 35), (0, 20))
"""How much knuckle, middle and last joint of each finger are bent beyond those of the relaxed hand [degrees]."""

GAPS = (0.01, 0.02, 0.03, 0.04, 0.05)
"""Gaps of the five pinches among the twenty [m]."""


def twenty(turns: float = 20.0) -> list[tuple[Hand, Pose]]:
    """Make the hands and where they stand before the camera: the palm seen, turned up to so many degrees each way."""
    rest, radii = example("relaxed")
    pinch, pinch_radii = example("pinch")
    pinched = hand_from_joints(pinch, pinch_radii)
    seen = []
    for seed in range(20):
        random = np.random.default_rng(1000 + seed)
        if seed % 4 == 3:
            hand = pinched.open_to(GAPS[seed // 4])
        else:
            hand = hand_from_joints(_bent(rest, random), radii, side="left")
        turn = np.radians(random.uniform(-turns, turns, 3))
        place = random.uniform((-0.05, -0.03, 0.35), (0.05, 0.03, 0.5))
        seen.append((hand, facing(hand, turn, tuple(place))))
    return seen


def _bent(rest: np.ndarray, random: np.random.Generator) -> np.ndarray:
    joints = rest.copy()
    axis = rest[21] - rest[6]  # the fingers of a left hand bend about it
    for chain in CHAINS[1:]:
        for index, limits in enumerate(BENDS, start=1):
            hinge, beyond = joints[chain[index]], list(chain[index + 1 :])
            joints[beyond] = hinge + turned(joints[beyond] - hinge, axis, random.uniform(*limits))
    return joints
