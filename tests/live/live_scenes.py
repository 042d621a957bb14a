"""Scenes and moments for the page of the live loop."""

from threading import Event, Thread

import numpy as np

import airtact as at
from airtact.hands.hand import hand_from_joints
from airtact.hands.tracking.stream import HandStream
from airtact.live.moment import Moment
from airtact.live.page.process import PageProcess
from airtact.live.page.sound import DirectSound
from airtact.live.scene import LiveScene
from airtact.transducers.modulation import AmplitudeModulation
from references.motions import pinch_pose


def one_board() -> LiveScene:
    """One board 0.2 m under a left hand that pinches, with foci at thumb and index finger."""
    joints, radii = pinch_pose()
    middle = hand_from_joints(joints, radii, side="left").pads[:2].mean(axis=0)
    array = at.autd3_board().facing(tuple(middle), (0.0, 0.2, -1.0), 0.2)
    places, offsets = ("thumb.pad", "index.pad"), np.full(2, 1e-3)
    return LiveScene(
        at.air(), 40e3, array, "left", radii, places, offsets, modulation=AmplitudeModulation()
    )


def silent(scene: LiveScene, time: float = 0.0) -> Moment:
    """A moment without a hand."""
    return Moment(
        time, time, None, None, np.zeros(len(scene.array), dtype=np.complex128), state="waiting"
    )


def playing(scene: LiveScene, time: float = 0.0) -> Moment:
    """A moment of a drive from distances, at a hand that moves to and fro."""
    joints, radii = pinch_pose()
    hand = hand_from_joints(joints + [0.0, 0.0, 0.01 * np.sin(6.0 * time)], radii, side="left")
    foci = np.array([hand.places[name][0] + 1e-3 * hand.places[name][1] for name in scene.places])
    distance = np.linalg.norm(scene.array.positions[:, None] - foci, axis=2)
    amplitudes = np.exp(-1j * scene.medium.wavenumber(scene.frequency).real * distance).sum(axis=1)
    amplitudes /= np.abs(amplitudes).max()
    pressures = np.abs(DirectSound(scene).at(foci, amplitudes, foci.mean(axis=0)))
    shape = {"rule": "phalanges", "shape_age": 0.045, "kept": 0.9}
    return Moment(time, time - 0.02, hand.joints, foci, amplitudes, pressures, **shape)


class Loop:
    """Shows moments as the live loop does, with and without a hand on the page."""

    def __init__(self, dragged: bool = False) -> None:
        self.scene, self.pressed = one_board(), Event()
        self.stream = HandStream() if dragged else None
        hand = pinch_pose()[0] if dragged else None
        self.page = PageProcess(
            self.scene, 0, hand=hand, stream=self.stream, on_emergency=self.pressed.set
        )
        self._ended, self._thread = Event(), Thread(target=self._run)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *fault):
        self._ended.set()
        self._thread.join()
        self.page.close()

    def _run(self) -> None:
        moments = [playing(self.scene, step / 30) for step in range(31)]
        pass_of_the_loop = 0
        while not self._ended.wait(1 / 60):
            at_rest = self.page.stopped or not self.page.controls.playing
            moment = silent(self.scene) if at_rest else moments[pass_of_the_loop % len(moments)]
            self.page.show(moment)
            pass_of_the_loop += 1
