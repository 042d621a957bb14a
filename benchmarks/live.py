"""Closed-loop truth of the live loop: what the drives that it made for a moving hand bring to the true hand.

Run ``PYTHONPATH=.:tests python benchmarks/live.py [--setting pinch] [--seconds 5] [--emulated]``. Frames of a known
motion, with a tracker's noise and 15 ms of latency, go by a web socket through the real loop in real time. Afterwards
every 20th drive is tried on the true hand of the instant at which it was in the air, by a solution of the whole hand at
2 %. Kept is the pressure at the weakest focus over that of the drive which the same method makes from the true hand, at
equal energy. With ``--emulated`` the clock is virtual, and solutions take the times that are given, so that a busy
machine does not matter.
"""

import argparse
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import airtact as at
from airtact.hand.hand import hand_from_joints
from airtact.hand.kinematics import turned
from airtact.live.distances import foci_on
from airtact.live.drives.factors import HandFactors, PartSolver
from airtact.live.drives.maker import HandAware
from airtact.live.drives.solver_process import Asked, Plan, ShapeSolver
from airtact.live.parts import Controls, LiveScene, Rule
from airtact.synthesis.gerchberg_saxton import weighted_gerchberg_saxton
from airtact.tracking.frame import HandFrame
from airtact.tracking.messages import to_json
from hand.hand_poses import example
from tracking.motions import Pinching, reached

LATENCY = 0.015
"""From the picture to the frame's arrival [s]."""

JUDGED, ACCURACY = 20, 0.02
"""Every so many drives one is judged, by a solution of this accuracy."""

SECONDS: dict[Rule, float] = {"phalanges": 0.015, "hand": 0.5}
"""How long solutions take where the clock is virtual [s]."""

MAKING, OFTEN = 0.006, 1.0 / 66.0
"""How long a drive takes from its beginning to the air, and between two of them, where the clock is virtual [s]."""

BOX_SIZE, BOX_AXIS = 0.8, (0.954, 0.373, -0.933)
"""Size of the hand in the box and its rotation vector [rad], of 40,000 the one farthest from the walls."""

LONGEST_START = 60.0
"""Time for which the processes are waited for at most [s]."""

WARMING = 1.0
"""Time before the first drive that is judged [s]."""


@dataclass(frozen=True)
class Setting:
    """A scene and the motion of the hand in it: joints (25, 3) at a time [m]."""

    scene: LiveScene
    motion: Callable[[float], np.ndarray]


@dataclass(frozen=True)
class Played:
    """A drive, when it was in the air [s], and what it was made from."""

    time: float
    amplitudes: np.ndarray
    rule: str
    kept: float


# --- settings -------------------------------------------------------------------------------------------------------


def pinch() -> Setting:
    """Let the pinch reach to and fro, 200 mm before 2 x 2 flat boards."""
    motion = Pinching(9)
    hand = hand_from_joints(motion.at(0.25), motion.radii, side="left")
    array = at.flat_boards(2, 2).facing(hand.pads[:2].mean(axis=0), (1.0, 0.0, 0.0), 0.2 + 0.075)
    array = array.moved(at.Pose(np.eye(3), np.array([0.075, 0.0, 0.0])))
    places, offsets = ("thumb.pad", "index.pad"), np.full(2, 1e-3)
    return Setting(LiveScene(at.air(celsius=22), 40e3, array, "left", motion.radii, places, offsets), motion.at)


def box() -> Setting:
    """Put the pinch into the box of the paper, where it sways by 4 mm, as a hand of 0.8 of the size, which fits."""
    motion = Pinching(9)
    middle = hand_from_joints(motion.joints[4], motion.radii, side="left").pads[:2].mean(axis=0)
    upright = at.Pose.turn(BOX_AXIS, float(np.linalg.norm(BOX_AXIS)))

    def joints(then: float) -> np.ndarray:
        pose = motion.at(then) - np.array([reached(then), 0.0, 0.0])
        sway = 0.004 * np.array([np.sin(np.pi * then), np.sin(1.3 * np.pi * then), np.sin(0.7 * np.pi * then)])
        return BOX_SIZE * upright.apply(pose - middle) + sway

    places, offsets, radii = ("thumb.pad", "index.pad"), np.full(2, 1e-3), BOX_SIZE * motion.radii
    return Setting(LiveScene(at.air(celsius=22), 40e3, at.surrounding_box(), "left", radii, places, offsets), joints)


def open_hand() -> Setting:
    """Hold an open hand before the boards, foci at the palm and all fingertips, and wave the fingers once a second."""
    rest, radii = example("relaxed")
    hand = hand_from_joints(rest, radii)
    side = hand.side
    places = tuple(hand.places)
    middle, (_, normal) = rest.mean(axis=0), hand.places["palm"]
    array = at.flat_boards(2, 2).facing(tuple(middle), tuple(normal), 0.2)

    def joints(then: float) -> np.ndarray:
        moved = rest
        for finger in range(1, 5):
            moved = turned(moved, side, finger, -0.25 * (1.0 - np.cos(2 * np.pi * then - 0.5 * finger)))
        return moved + 0.01 * np.sin(np.pi * then) * np.array([1.0, 0.0, 0.0])

    scene = LiveScene(at.air(celsius=22), 40e3, array, side, radii, places, np.full(len(places), 2e-3))
    return Setting(scene, joints)


SETTINGS = {"pinch": pinch, "box": box, "open": open_hand}


def frames_of(setting: Setting, rate: float, seconds: float, noise: float) -> list[HandFrame]:
    """Frames of a tracker with white noise in each coordinate [m]."""
    random = np.random.default_rng(0)
    times = np.arange(round(seconds * rate)) / rate
    clean = [setting.motion(float(then)) for then in times]
    seen = [joints + noise * random.normal(size=(25, 3)) for joints in clean]
    return [
        HandFrame(then, setting.scene.side, i, joints) for i, (then, joints) in enumerate(zip(times, seen, strict=True))
    ]


# --- makers ---------------------------------------------------------------------------------------------------------


class NotReposed(HandAware):
    """Plays the newest solution as it was solved."""

    def _rows(self, riding, solution):
        return (
            super()._rows(riding, None) if solution is None else self._open_air.rows(solution.foci) * solution.factors
        )


def maker_of(which: str, setting: Setting, noise: float, virtual: bool) -> HandAware:
    """Make a maker by its name; the noise of its filter is the tracker's, a tenth of a millimetre at least [m]."""
    kind = NotReposed if which == "not re-posed" else HandAware
    solvers = [Emulated(setting.scene, part) for part in SECONDS] if virtual else None
    return kind(setting.scene, max(noise, 1e-4), solvers=[] if which == "distances" else solvers)


# --- the real loop --------------------------------------------------------------------------------------------------


def warm(maker: HandAware, frame: HandFrame) -> None:
    """Wait for the first solutions, as the processes take seconds to start."""
    until = time.monotonic() + LONGEST_START
    wanted = 20 if maker._solvers else 0
    for count in range(10**6):
        if maker.solutions >= wanted or time.monotonic() > until:
            return
        maker.take(replace(frame, time=frame.time - 2.0 * LONGEST_START + 0.02 * count))
        maker.make(frame.time - 2.0 * LONGEST_START + 0.02 * count, Controls())
        time.sleep(0.02)


def real(setting: Setting, maker: HandAware, frames: Sequence[HandFrame], seconds: float) -> list[Played]:
    """Send frames to the real loop by a web socket, and read its session."""
    warm(maker, frames[0])
    begun = maker.solutions
    hands = at.live.ReceivedHands("websocket", 0)
    address = hands.words

    def send() -> None:
        with suppress(ConnectionClosed), connect(address) as connection:
            begun = time.monotonic()
            for frame in frames:
                time.sleep(max(begun + frame.time + LATENCY - time.monotonic(), 0.0))
                connection.send(to_json(frame).decode())

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session.h5"
        session = at.live.SessionWriter(path, setting.scene)
        sender = threading.Thread(target=send, daemon=True)
        sender.start()
        done = at.live.follow(setting.scene, hands, maker, seconds=seconds, session=session, latency=LATENCY)
        sender.join()
        found = at.live.read_session(path)
    print(
        f"  {done.rate:.0f} drives/s; age of the frame in the air {1e3 * (done.age - LATENCY):.1f} ms without the "
        f"camera, 95 of 100 under {1e3 * (done.oldest - LATENCY):.1f} ms; "
        f"{(maker.solutions - begun) / seconds:.1f} solutions/s"
    )
    rows = zip(found.time_in_air, found.amplitudes, found.rules, found.states, found.kept, strict=True)
    return [
        Played(float(t), np.array(d, dtype=complex), rule, k) for t, d, rule, state, k in rows if state == "playing"
    ]


# --- the virtual clock ----------------------------------------------------------------------------------------------


class Emulated(ShapeSolver):
    """Solves one part, each solution being ready after a given time of a clock that ``advance`` sets."""

    def __init__(self, scene: LiveScene, part: Rule) -> None:
        self._scene, self._part, self._lasts = scene, part, SECONDS[part]
        self._plan = Plan((part,))
        self._plan.seconds[part] = self._lasts
        self._asked: tuple[float, Asked] | None = None
        self._running: tuple[float, HandFactors | str] | None = None
        self._ready: list[HandFactors | str] = []
        self._solver = PartSolver(scene)
        self._now = 0.0

    def advance(self, now: float) -> None:
        """Set the clock [s]."""
        self._now = now
        if self._running is not None and self._running[0] <= now:
            self._ready.append(self._running[1])
            self._running = None
        if self._running is None and self._asked is not None:
            self._running = now + self._lasts, self._solve(now)

    def _solve(self, now: float) -> HandFactors | str:
        assert self._asked is not None
        then, asked = self._asked
        try:
            part, ahead = self._plan.next(self._scene, asked)
            ahead = min(ahead + now - then, 0.06)
            joints, then = asked.after(ahead), asked.time + ahead
            return self._solver.solved(joints, part, then)
        except (at.InvalidInput, at.NotConverged) as fault:
            return str(fault)

    def ask(self, asked: Asked) -> None:
        self._asked = self._now, asked

    def found(self) -> list[HandFactors | str]:
        ready, self._ready = self._ready, []
        return ready

    def close(self) -> None:
        pass


def emulated(maker: HandAware, frames: Sequence[HandFrame], seconds: float) -> list[Played]:
    """Run the maker on a virtual clock: a drive for each frame, and every ``OFTEN``."""
    arrivals = [frame.time + LATENCY for frame in frames]
    ticks = sorted([*((then, frame) for then, frame in zip(arrivals, frames, strict=True))], key=lambda one: one[0])
    played, now, index = [], arrivals[0], 0
    while now < seconds:
        for step in np.linspace(now - OFTEN, now, 5)[1:]:
            for solver in maker._solvers:
                solver.advance(float(step))
        while index < len(ticks) and ticks[index][0] <= now + 1e-9:
            maker.take(ticks[index][1])
            index += 1
        moment = maker.make(now + MAKING, Controls())
        if moment.joints is not None:
            played.append(Played(now + MAKING, moment.amplitudes, moment.rule, moment.kept or np.nan))
        nearest = arrivals[index] if index < len(arrivals) else np.inf
        now = min(now + OFTEN, nearest)
    return played


# --- the true hand --------------------------------------------------------------------------------------------------


class Judge:
    """Tries drives on the true hand, solved as a whole."""

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        self._matrix = cache(self._solved)

    def _solved(self, then: float) -> tuple[np.ndarray, float]:
        scene = self._setting.scene
        hand = hand_from_joints(self._setting.motion(then), scene.radii, side=scene.side)
        air = at.Scene(scene.medium, [at.sound_hard(hand.surface)], frequency=scene.frequency)
        target = at.Target(foci_on(hand, scene))
        field = at.BoundaryElement(accuracy=ACCURACY).radiate(air, target.beacons())  # exact beside the walls of a box
        transfer = at.transfer_matrix(field, scene.array)
        best = weighted_gerchberg_saxton(transfer, target).amplitudes
        return transfer.matrix, weakest(transfer.matrix, best)

    def kept(self, one: Played) -> float:
        """Share of the attainable pressure at the weakest focus, at equal energy."""
        matrix, attainable = self._matrix(round(one.time, 3))
        return weakest(matrix, one.amplitudes) / attainable


def weakest(matrix: np.ndarray, amplitudes: np.ndarray) -> float:
    return float(np.abs(matrix @ amplitudes).min() / np.linalg.norm(amplitudes))


def measure(
    name: str, rate: float, noise: float, seconds: float, virtual: bool, judge: Judge, setting: Setting, every: int
) -> None:
    frames = frames_of(setting, rate, seconds, noise)
    print(f"{name}, {rate:.0f} frames/s, noise {1e3 * noise:g} mm" + ", virtual clock" * virtual, flush=True)
    for which in ("airtact", "distances", "not re-posed"):
        maker = maker_of(which, setting, noise, virtual)
        played = emulated(maker, frames, seconds) if virtual else real(setting, maker, frames, seconds)
        some = [one for one in played if one.time > WARMING][::every]
        kept = np.array([judge.kept(one) for one in some])
        rules = ", ".join(f"{rule} {count}" for rule, count in Counter(one.rule for one in some).most_common())
        off = np.median([abs(one.kept - got) for one, got in zip(some, kept, strict=True)])
        median, tenth = np.median(kept), np.quantile(kept, 0.1)
        print(
            f"  {which:13} kept {median:.3f}, lowest tenth {tenth:.3f} of {len(kept)} ({rules}); "
            f"the expected share is {off:.3f} off",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--setting", choices=[*SETTINGS, "all"], default="all")
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--rates", type=float, nargs="+", default=[60.0, 120.0])
    parser.add_argument("--noises", type=float, nargs="+", default=[0.0, 1e-3], help="of the tracker [m]")
    parser.add_argument("--every", type=int, default=JUDGED, help="so many drives, one is judged")
    parser.add_argument("--emulated", action="store_true", help="use a virtual clock")
    given = parser.parse_args()
    for name in SETTINGS if given.setting == "all" else [given.setting]:
        setting = SETTINGS[name]()
        judge = Judge(setting)
        for rate in given.rates:
            for noise in given.noises:
                measure(name, rate, noise, given.seconds, given.emulated, judge, setting, given.every)


if __name__ == "__main__":
    main()
