"""Drives from distances alone: what "ignore the hand" plays, and what every other drive is compared with."""

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.target import Target
from airtact.drives.transfer import focus_by_distance
from airtact.errors import InvalidInput
from airtact.hands.hand import Hand
from airtact.hands.joints import check_finger_order, joints_of, radii_of
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.prediction import Predictor
from airtact.live.parts import Controls, DriveMaker, LiveScene, Moment


def hand_in(scene: LiveScene, landmarks: Float64[np.ndarray, "landmarks 3"]) -> Hand:
    """Return the hand of a scene with landmarks of a frame, or joints (25, 3) [m].

    Raises
    ------
    InvalidInput
        As ``hand_from_joints``; the side is not checked, as it was with the frame.
    """
    joints = joints_of(landmarks)
    check_finger_order(joints)
    return Hand(joints, radii_of(scene.radii, None, joints), scene.side)


def foci_on(
    hand: Hand, scene: LiveScene, offset: float | None = None
) -> Float64[np.ndarray, "foci 3"]:
    """Return where the foci of a scene are on a hand (F, 3) [m]; ``offset`` is in place of the scene's [m]."""
    places = [hand.position(name) for name in scene.places]
    offsets = scene.offsets if offset is None else np.full(len(places), offset)
    return np.array(
        [point + off * normal for (point, normal), off in zip(places, offsets, strict=True)]
    )


class Distances(DriveMaker):
    """Focuses by the distances from the elements to the foci, as if there were no hand.

    Parameters
    ----------
    scene : what stays the same.
    """

    def __init__(self, scene: LiveScene) -> None:
        self._scene = scene
        self._predictor = Predictor(latency=0.0, noise=None)
        self._newest: HandFrame | None = None

    def take(self, frame: HandFrame) -> None:
        """Take the newest frame; raises as ``Predictor.take``."""
        self._predictor.take(frame)
        self._newest = frame

    def make(self, time: float, controls: Controls) -> Moment:
        """Focus where the foci are predicted at a time [s]; zeros where the hand is lost."""
        scene, newest = self._scene, self._newest
        silent = np.zeros(len(scene.array), dtype=np.complex128)
        if newest is None or newest.lost:
            return Moment(
                time, time if newest is None else newest.time, None, None, silent, state="silent"
            )
        predicted = self._predictor.at(max(time, newest.time))
        if predicted.lost:
            return Moment(time, newest.time, None, None, silent, state="silent")
        try:
            hand = predicted.hand(scene.radii)
        except InvalidInput:  # what was predicted is no hand
            hand = newest.hand(scene.radii)
        foci = foci_on(hand, scene, controls.offset)
        drive = focus_by_distance(scene.array, Target(foci), scene.medium, scene.frequency)
        return Moment(time, newest.time, hand.joints, foci, drive.amplitudes)

    def close(self) -> None:
        """End nothing: nothing runs beside the loop."""
