"""Motions of a hand that never were, to try streams, recordings and prediction on."""

import functools

import numpy as np

from airtact.hands.hand import hand_from_joints
from airtact.hands.tracking.frame import HandFrame
from references.hand_poses import example

SPEED = 0.5
"""Fastest that the whole hand moves in ``Pinching`` [m/s]."""

REACH, REST = 0.15, 0.25
"""How far it reaches [m], and how long it rests between [s]."""


@functools.cache
def pinch_pose() -> tuple[np.ndarray, np.ndarray]:
    """Return joints (25, 3) and radii (25,) of the pinch pose [m]."""
    return example("pinch")


def still(sequence: int, time: float | None = None, **changed) -> HandFrame:
    """Make a frame of the pinch pose, 30 in a second unless told otherwise."""
    joints, _ = pinch_pose()
    fields = {"side": "left", "landmarks": joints, "cloud": None} | changed
    return HandFrame(sequence / 30 if time is None else time, sequence=sequence, **fields)


def reached(time: float) -> float:
    """How far a hand is on its way to and fro [m]: minimum jerk, as people reach.

    Source: T. Flash, N. Hogan, "The coordination of arm movements", J. Neurosci. 5, 1688 (1985).
    """
    lasts = 1.875 * REACH / SPEED
    turn, since = divmod(time, lasts + REST)
    share = min(since / lasts, 1.0)
    there = REACH * (10 * share**3 - 15 * share**4 + 6 * share**5)
    return REACH - there if int(turn) % 2 else there


class Pinching:
    """The pinch pose opens and closes from 5 to 45 mm once a second while the hand reaches to and fro along x.

    Joints between gaps that are computed are interpolated.
    """

    def __init__(self, count: int = 17) -> None:
        joints, radii = pinch_pose()
        hand = hand_from_joints(joints, radii)
        self.radii, self.gaps = radii, np.linspace(0.005, 0.045, count)
        self.joints = np.array([hand.open_to(gap).joints for gap in self.gaps])

    def at(self, time: float) -> np.ndarray:
        """Joints (25, 3) at a time [m]."""
        gap = 0.025 - 0.02 * np.cos(2 * np.pi * time)
        place = np.interp(gap, self.gaps, np.arange(len(self.gaps)))
        low = min(int(place), len(self.gaps) - 2)
        joints = self.joints[low] + (place - low) * (self.joints[low + 1] - self.joints[low])
        return joints + np.array([reached(time), 0.0, 0.0])

    def frames(
        self, rate: float, seconds: float, noise: float = 0.0, seed: int = 0
    ) -> list[HandFrame]:
        """Frames of a tracker with so much noise in each coordinate [m]."""
        random = np.random.default_rng(seed)
        times = np.arange(round(seconds * rate)) / rate
        return [
            HandFrame(time, "left", index, self.at(time) + noise * random.normal(size=(25, 3)))
            for index, time in enumerate(times)
        ]


def to_and_fro(time: float) -> np.ndarray:
    """Where the hand of ``reaching.jsonl`` is (3,) [m]: 60 mm towards boards and back every 2 s, by minimum jerk."""
    turn, since = divmod(time, 1.0)
    share = min(since / 0.6, 1.0)
    there = 0.06 * (10 * share**3 - 15 * share**4 + 6 * share**5)
    return np.array([(0.06 - there if int(turn) % 2 else there) - 0.03, 0.0, 0.0])


def reaching_recording() -> list[HandFrame]:
    """Make the frames of ``examples/hands/reaching.jsonl``: 4 s at 60 frames/s, which can be played in a loop."""
    motion = Pinching()
    gone = [np.array([reached(index / 60), 0.0, 0.0]) for index in range(240)]
    return [
        HandFrame(
            index / 60, "left", index, motion.at(index / 60) - gone[index] + to_and_fro(index / 60)
        )
        for index in range(240)
    ]
