"""Made-up motions of a hand, for streams, recordings and prediction."""

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from airtact.hands.hand import hand_from_joints
from airtact.hands.tracking.frame import HandFrame
from references.hand_poses import example

JOINTS, RADII = example("pinch")

SPEED = 0.5
"""Largest speed of the whole hand in ``Pinching`` [m/s]."""


def pinch_pose() -> tuple[np.ndarray, np.ndarray]:
    """Return joints (25, 3) and radii (25,) of the pinch pose [m]."""
    return JOINTS, RADII


def still(sequence: int, time: float | None = None, **changed) -> HandFrame:
    """Make a frame of the pinch pose, 30 in a second unless told otherwise."""
    fields = {"side": "left", "landmarks": JOINTS, "cloud": None} | changed
    return HandFrame(sequence / 30 if time is None else time, sequence=sequence, **fields)


def mirrored(sequence: int, time: float | None = None) -> HandFrame:
    """Make a frame of a right hand."""
    return still(sequence, time, side="right", landmarks=JOINTS * [-1, 1, 1])


def _minimum_jerk(time: float, reach: float, lasts: float, rest: float) -> float:
    """Displacement of a hand that reaches out and back [m]: minimum jerk, as people reach.

    Source: T. Flash, N. Hogan, "The coordination of arm movements", J. Neurosci. 5, 1688 (1985).
    """
    turn, since = divmod(time, lasts + rest)
    share = min(since / lasts, 1.0)
    moved = reach * (10 * share**3 - 15 * share**4 + 6 * share**5)
    return reach - moved if int(turn) % 2 else moved


def reached(time: float) -> float:
    """Displacement of the hand in ``Pinching`` [m]: 0.15 m to and fro, with rests of 0.25 s."""
    return _minimum_jerk(time, 0.15, 1.875 * 0.15 / SPEED, 0.25)


class Clock:
    """A clock that goes when told, or while someone sleeps."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Pinching:
    """The pinch pose opens and closes from 5 to 45 mm once a second while the hand reaches to and fro along x.

    Joints between gaps that are computed are interpolated.
    """

    def __init__(self, count: int = 17) -> None:
        hand = hand_from_joints(JOINTS, RADII)
        self.radii = RADII
        self.gaps = np.linspace(0.005, 0.045, count)
        self.joints = np.array([hand.open_to(gap).joints for gap in self.gaps])

    def at(self, time: float) -> np.ndarray:
        """Joints (25, 3) at a time [m]."""
        gap = 0.025 - 0.02 * np.cos(2 * np.pi * time)
        index = np.interp(gap, self.gaps, np.arange(len(self.gaps)))
        low = min(int(index), len(self.gaps) - 2)
        joints = self.joints[low] + (index - low) * (self.joints[low + 1] - self.joints[low])
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
    """Position of the hand of ``reaching.jsonl`` (3,) [m]: 60 mm towards boards and back every 2 s."""
    return np.array([_minimum_jerk(time, 0.06, 0.6, 0.4) - 0.03, 0.0, 0.0])


@cache
def reaching_recording() -> list[HandFrame]:
    """Make the frames of ``examples/hands/reaching.jsonl``: 4 s at 60 frames/s, which can be played in a loop."""
    motion = Pinching()
    frames = []
    for index in range(240):
        time = index / 60
        gone = np.array([reached(time), 0.0, 0.0])
        joints = motion.at(time) - gone + to_and_fro(time)
        frames.append(HandFrame(time, "left", index, joints))
    return frames


SMALL = 0.8
"""Size of the hand that fits into the paper's box, relative to the pinch pose."""

UPRIGHT = (0.954, 0.373, -0.933)
"""Its rotation vector [rad]: of 40,000, the one whose hand is farthest from the walls."""


BETWEEN_FINGERS = np.array([-0.01606, 0.00563, -0.01817])
"""Middle of the gap between its thumb and index finger [m], before it is moved to the ball."""


@cache
def grasping_recording() -> list[HandFrame]:
    """Make the frames of ``examples/hands/grasping.jsonl``: 2 s at 30 frames/s, which can be played in a loop.

    Thumb and index finger close from 34.5 to 20.5 mm around the ball of ``touch_ball``, at the origin.
    """
    turn = Rotation.from_rotvec(UPRIGHT)
    motion = Pinching()
    poses = SMALL * turn.apply(motion.joints.reshape(-1, 3)).reshape(motion.joints.shape)
    frames = []
    for index in range(60):
        gap = 0.0275 + 0.007 * np.cos(np.pi * index / 30)
        position = np.interp(gap / SMALL, motion.gaps, np.arange(len(motion.gaps)))
        low = min(int(position), len(motion.gaps) - 2)
        joints = poses[low] + (position - low) * (poses[low + 1] - poses[low]) - BETWEEN_FINGERS
        frames.append(HandFrame(index / 30, "left", index, np.round(joints, 5)))
    return frames
