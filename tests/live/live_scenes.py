"""Scenes, doubles and a virtual clock for the live loop and its page."""

from threading import Event, Thread

import numpy as np

import airtact as at
from airtact.acoustics.solvers.shared import monopole_pressure
from airtact.live.drives.solver_process import SolverProcess
from airtact.live.moment import Moment, silent_moment
from airtact.live.page.process import PageProcess
from airtact.live.page.sound import element_sources
from references.motions import pinch_pose


def one_board() -> at.live.LiveScene:
    """One board 0.2 m under a left hand that pinches, with foci at thumb and index finger."""
    joints, radii = pinch_pose()
    middle = at.hand_from_joints(joints, radii, side="left").pads[:2].mean(axis=0)
    array = at.autd3_board().facing(tuple(middle), (0.0, 0.2, -1.0), 0.2)
    return at.live.LiveScene(
        at.air(),
        40e3,
        array,
        "left",
        radii,
        ("thumb.pad", "index.pad"),
        np.full(2, 1e-3),
        modulation=at.transducers.AmplitudeModulation(),
    )


def open_pinch(gap: float) -> np.ndarray:
    joints, radii = pinch_pose()
    return np.array(at.hand_from_joints(joints, radii, side="left").open_to(gap).joints)


def direct_sound(
    scene: at.live.LiveScene, points: np.ndarray, amplitudes: np.ndarray
) -> np.ndarray:
    """Pressure in open air near some points, by the elements that the page takes for points."""
    sources = element_sources(scene, amplitudes, points.mean(axis=0))
    strengths = np.ascontiguousarray(sources.strengths)
    wavenumber = scene.wavenumber
    return monopole_pressure(points, sources.positions, strengths, wavenumber, "float64")[:, 0]


def distances(scene: at.live.LiveScene) -> at.live.HandAware:
    return at.live.HandAware(scene, solvers=[])


def playing(scene: at.live.LiveScene, time: float = 0.0) -> Moment:
    joints, radii = pinch_pose()
    hand = at.hand_from_joints(joints + [0.0, 0.0, 0.01 * np.sin(6.0 * time)], radii, side="left")
    foci = np.array([hand.places[name][0] + 1e-3 * hand.places[name][1] for name in scene.places])
    drive = at.focus_by_distance(scene.array, at.Target(foci), scene.medium, scene.frequency)
    pressures = np.abs(direct_sound(scene, foci, drive.amplitudes))
    shape = {"rule": "phalanges", "shape_age": 0.045, "kept": 0.9}
    return Moment(time, time - 0.02, hand.joints, foci, drive.amplitudes, pressures, **shape)


def correlations(rows: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Correlation of the rows of two transfer matrices, 1 where they are the same but for a factor."""
    overlap = np.abs(np.sum(rows.conj() * reference, axis=1))
    return overlap / np.linalg.norm(rows, axis=1) / np.linalg.norm(reference, axis=1)


class Ready(SolverProcess):
    """Has some solutions, and keeps what it was asked last."""

    asked = None

    def __init__(self, *solutions):
        self.ready = list(solutions)

    def ask(self, request):
        self.asked = request

    def solutions(self):
        ready, self.ready = self.ready, []
        return ready

    def close(self):
        pass


class VirtualClock:
    """Stands for the module ``time`` in the loop; only waiting takes time."""

    def __init__(self) -> None:
        self.now = 1.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Scheduled(at.live.HandSource):
    """Frames that come at their own times of a virtual clock."""

    def __init__(self, clock: VirtualClock, frames, due=None) -> None:
        super().__init__("scheduled frames")
        self.clock, self.frames = clock, list(frames)
        times = [frame.time - self.frames[0].time for frame in self.frames] if due is None else due
        self.due = [clock.now + time for time in times]
        self.stream = at.hands.HandStream(on_frame=self._arrived, clock=clock.monotonic)

    def begin(self, on_frame):
        self._on_frame = on_frame
        return self

    @property
    def health(self):
        return self.stream.health

    def _arrived(self, frame):
        self._on_frame(frame, self.clock.now)

    def wait(self, timeout: float):
        if self.frames and self.due[0] <= self.clock.now + timeout:
            self.clock.now = max(self.clock.now, self.due.pop(0))
            self.stream.feed(self.frames.pop(0))
            return self.stream.wait(0.0)
        self.clock.now += timeout
        self.ended = not self.frames
        return self.stream.wait(0.0)

    def close(self):
        pass


class Kept(at.live.Output):
    """Keeps what it is sent, may take a while for it, and presses the emergency stop itself after so many drives."""

    def __init__(self, clock: VirtualClock, seconds: float = 1e-3, stop_after: int = 0) -> None:
        self.clock, self.seconds, self.stop_after = clock, seconds, stop_after
        self.sent, self.times, self.cycled, self.asked = [], [], [], []

    def send(self, amplitudes, at=None) -> None:
        self.clock.sleep(self.seconds)
        self.sent.append(amplitudes)
        self.asked.append(at)
        self.times.append(self.clock.now)
        if len(self.sent) == self.stop_after:
            self.stop()

    def cycle(self, frames, rate) -> None:
        self.clock.sleep(self.seconds)
        self.cycled.append(frames)


class Loop:
    """Shows moments as the live loop does, with and without a hand on the page."""

    def __init__(self, dragged: bool = False, world=None) -> None:
        self.scene, self.pressed = one_board(), Event()
        self.stream = at.hands.HandStream() if dragged else None
        hand = pinch_pose()[0] if dragged else None
        self.page = PageProcess(
            self.scene,
            0,
            hand=hand,
            stream=self.stream,
            on_emergency=self.pressed.set,
            world=world,
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
        number = 0
        while not self._ended.wait(1 / 60):
            at_rest = self.pressed.is_set() or not self.page.controls.playing
            silent = silent_moment(self.scene, 0.0, 0.0)
            self.page.show(silent if at_rest else moments[number % len(moments)])
            number += 1
