"""Closed-loop truth of the live loop: what the drives that it made for a moving hand bring to the true hand.

Run ``python -m benchmarks.live [--setting pinch] [--seconds 5] [--emulated]``,
or first with ``--record FOLDER``, which takes as long as the motion and wants a quiet machine, and
then with ``--judge FOLDER``, which takes minutes on any. Frames of a known motion, with a tracker's
noise and 15 ms of latency, go by a web socket through the real loop in real time. Afterwards every
20th drive is tried on the true hand of the instant at which it was in the air, by a solution of the
whole hand at 2 %. Kept is the pressure at the weakest focus over that of the drive that "best"
makes from the true hand, at equal energy. With ``--runs 3`` all is done so often, and medians of
the runs are printed too. With ``--emulated`` the clock is virtual, and solutions take the times
that are given, so that a busy machine does not matter; ``--corrected`` then tries frames as perfect
echoes would correct them, each so much later and one after the other, too. ``--solves`` prints how
many hands a second one thread solves, and nothing else.
"""

import argparse
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import airtact as at
from airtact.drives.gerchberg_saxton import weighted_gerchberg_saxton
from airtact.hands.hand import hand_from_joints
from airtact.hands.kinematics import turned
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.hands.tracking.messages import to_json
from airtact.live.drives.bending import BendingHand, SkinSources
from airtact.live.drives.factors import HandFactors, PartSolver
from airtact.live.drives.maker import HandAware, solved_for
from airtact.live.drives.solver_process import Request, SolverProcess, solved_ahead
from airtact.live.moment import Controls, Rule
from airtact.live.scene import LiveScene, foci_on
from references.hand_poses import example
from references.motions import Pinching, reached

LATENCY = 0.015
"""From the picture to the frame's arrival [s]."""

JUDGED, ACCURACY = 20, 0.02
"""Every so many drives one is judged, by a solution of this accuracy."""

SECONDS: dict[Rule, float] = {"phalanges": 0.015, "hand": 0.5, "carried": 0.025}
"""How long solutions take where the clock is virtual [s]."""

TO_CARRY = 0.15
"""How long a whole hand that is carried along takes to solve where the clock is virtual [s]."""

MAKING, OFTEN = 0.006, 1.0 / 66.0
"""How long a drive takes from its beginning to the air, and between two of them, where the clock is virtual [s]."""

BOX_SIZE, BOX_AXIS = 0.8, (0.954, 0.373, -0.933)
"""Size of the hand in the box and its rotation vector [rad], of 40,000 the one farthest from the walls."""

LONGEST_START = 60.0
"""Time for which the processes are waited for at most [s]."""

RUN = ", run "
"""What stands before the number of a run in the name of its session."""

CORRECTED = 0.05e-3
"""Noise that is left in frames that echoes corrected, as if these told all of the hand [m]."""

WARMING = 1.0
"""Time before the first drive that is judged [s]."""


@dataclass(frozen=True)
class Setting:
    """A scene and the motion of the hand in it: joints (25, 3) at a time [m]."""

    scene: LiveScene
    motion: Callable[[float], np.ndarray]
    name: str = ""


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
    return Setting(
        LiveScene(at.air(celsius=22), 40e3, array, "left", motion.radii, places, offsets), motion.at
    )


def box() -> Setting:
    """Put the pinch into the box of the paper, where it sways by 4 mm, as a hand of 0.8 of the size, which fits."""
    motion = Pinching(9)
    middle = hand_from_joints(motion.joints[4], motion.radii, side="left").pads[:2].mean(axis=0)
    upright = at.Pose.turn(BOX_AXIS, float(np.linalg.norm(BOX_AXIS)))

    def joints(then: float) -> np.ndarray:
        pose = motion.at(then) - np.array([reached(then), 0.0, 0.0])
        sway = 0.004 * np.array(
            [np.sin(np.pi * then), np.sin(1.3 * np.pi * then), np.sin(0.7 * np.pi * then)]
        )
        return BOX_SIZE * upright.apply(pose - middle) + sway

    places, offsets, radii = ("thumb.pad", "index.pad"), np.full(2, 1e-3), BOX_SIZE * motion.radii
    return Setting(
        LiveScene(at.air(celsius=22), 40e3, at.surrounding_box(), "left", radii, places, offsets),
        joints,
    )


def open_hand(rates: Sequence[float] = (1.0, 1.0, 1.0, 1.0)) -> Setting:
    """Hold an open hand before the boards, foci at the palm and all fingertips, and wave the fingers at these rates."""
    rest, radii = example("relaxed")
    hand = hand_from_joints(rest, radii)
    side = hand.side
    places = tuple(hand.places)
    middle, (_, normal) = rest.mean(axis=0), hand.places["palm"]
    array = at.flat_boards(2, 2).facing(tuple(middle), tuple(normal), 0.2)

    def joints(then: float) -> np.ndarray:
        moved = rest
        for finger in range(1, 5):
            phase = 2 * np.pi * rates[finger - 1] * then - 0.5 * finger
            moved = turned(moved, side, finger, -0.25 * (1.0 - np.cos(phase)))
        return moved + 0.01 * np.sin(np.pi * then) * np.array([1.0, 0.0, 0.0])

    scene = LiveScene(
        at.air(celsius=22), 40e3, array, side, radii, places, np.full(len(places), 2e-3)
    )
    return Setting(scene, joints)


def restless() -> Setting:
    """Wave each finger of the open hand at a rate of its own, so that no pose comes back."""
    return open_hand((0.87, 1.0, 1.13, 0.71))


SETTINGS = {"pinch": pinch, "box": box, "open": open_hand, "restless": restless}


def frames_of(
    setting: Setting, rate: float, seconds: float, noise: float, seed: int = 0
) -> list[HandFrame]:
    """Frames of a tracker with white noise in each coordinate [m]; those that are no possible hand are left out."""
    random = np.random.default_rng(seed)
    times = np.arange(round(seconds * rate)) / rate
    clean = [setting.motion(float(then)) for then in times]
    seen = [joints + noise * random.normal(size=(25, 3)) for joints in clean]
    frames = []
    for index, (then, joints) in enumerate(zip(times, seen, strict=True)):
        with suppress(FaultyFrame):  # as a stream does
            frames.append(HandFrame(then, setting.scene.side, index, joints))
    return frames


# --- makers ---------------------------------------------------------------------------------------------------------


class NotReposed(HandAware):
    """Plays the newest solution as it was solved."""

    def _rows(self, posed, solution):
        return (
            super()._rows(posed, None)
            if solution is None
            else self._open_air.rows(solution.foci) * solution.factors
        )


def maker_of(which: str, setting: Setting, virtual: bool) -> HandAware:
    """Make a maker by its name."""
    kind = NotReposed if which == "not re-posed" else HandAware
    solvers = emulated_for(setting.scene) if virtual else None
    return kind(setting.scene, solvers=[] if which == "distances" else solvers)


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


def real(
    setting: Setting, maker: HandAware, frames: Sequence[HandFrame], seconds: float, path: Path
) -> list[float]:
    """Send frames to the real loop by a web socket, which records its session; return what ``at_the_link`` prints."""
    warm(maker, frames[0])
    begun = maker.solutions
    hands = at.live.ReceivedHands(0)
    address = hands.words

    def send() -> None:
        with suppress(ConnectionClosed), connect(address) as connection:
            begun = time.monotonic()
            for frame in frames:
                time.sleep(max(begun + frame.time + LATENCY - time.monotonic(), 0.0))
                connection.send(to_json(frame).decode())

    session = at.live.SessionWriter(path, setting.scene)
    sender = threading.Thread(target=send, daemon=True)
    sender.start()
    done = at.live.follow(
        setting.scene, hands, maker, seconds=seconds, session=session, latency=LATENCY
    )
    sender.join()
    age, oldest = 1e3 * (done.age - LATENCY), 1e3 * (done.oldest - LATENCY)
    found = [done.rate, 1e3 * done.delay, age, oldest, (maker.solutions - begun) / seconds]
    at_the_link(path.stem, found)
    return found


def at_the_link(title: str, found: Sequence[float]) -> None:
    """Print drives a second, times [ms] and solutions a second."""
    rate, delay, age, oldest, solutions = found
    print(
        f"  {title}: {rate:.0f} drives/s, 95 of 100 frames at the link after {delay:.1f} ms; age of the frame in the "
        f"air {age:.1f} ms without the camera, 95 of 100 under {oldest:.1f} ms; {solutions:.1f} solutions/s",
        flush=True,
    )


def recorded(path: Path) -> list[Played]:
    """Read the drives of a session."""
    found = at.live.read_session(path)
    rows = zip(
        found.time_in_air, found.amplitudes, found.rules, found.states, found.kept, strict=True
    )
    return [
        Played(float(t), np.array(d, dtype=complex), rule, k)
        for t, d, rule, state, k in rows
        if state == "playing"
    ]


# --- the virtual clock ----------------------------------------------------------------------------------------------


class Emulated(SolverProcess):
    """Solves one part, each solution being ready after a given time of a clock that ``advance`` sets."""

    def __init__(self, scene: LiveScene, part: Rule) -> None:
        self._scene, self._part, self._lasts = scene, part, SECONDS[part]
        self._asked: tuple[float, Request] | None = None
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
            answer = self._solve(now)
            self._running = None if answer is None else (now + self._lasts, answer)

    def _solve(self, now: float) -> HandFactors | str | None:
        assert self._asked is not None
        then, asked = self._asked
        try:
            ahead = min(solved_ahead(self._lasts) + now - then, 0.06)
            return self._found(asked.after(ahead), asked.time + ahead)
        except (at.InvalidInput, at.NotConverged) as fault:
            return str(fault)

    def _found(self, joints: np.ndarray, then: float) -> HandFactors | None:
        return self._solver.solved(joints, self._part, then)

    def ask(self, asked: Request) -> None:
        self._asked = self._now, asked

    def solutions(self) -> list[HandFactors | str]:
        ready, self._ready = self._ready, []
        return ready

    def close(self) -> None:
        pass


class EmulatedCarrying(Emulated):
    """Solves whole hands, each ready after ``TO_CARRY``, and carries the one most like the pose asked for."""

    def __init__(self, scene: LiveScene) -> None:
        super().__init__(scene, "carried")
        self._hand = BendingHand(scene)
        self._solving: tuple[float, SkinSources] | None = None

    def advance(self, now: float) -> None:
        if self._solving is not None and self._solving[0] <= now:
            self._hand.keep(self._solving[1])
            self._solving = None
        if self._solving is None and self._asked is not None:
            then, asked = self._asked
            ahead = 0.03 + now - then
            self._solving = (
                now + TO_CARRY,
                self._hand.solved(asked.after(ahead), asked.time + ahead),
            )
        super().advance(now)

    def _found(self, joints: np.ndarray, then: float) -> HandFactors | None:
        return self._hand.carried(joints, then)


def emulated_for(scene: LiveScene) -> list[Emulated]:
    """Emulate the processes that solve for a scene."""
    parts = solved_for(scene)
    return [
        EmulatedCarrying(scene) if part == "carried" else Emulated(scene, part) for part in parts
    ]


def emulated(
    maker: HandAware,
    frames: Sequence[HandFrame],
    seconds: float,
    latency: float = LATENCY,
    spread: float = 0.0,
    ahead: bool = False,
) -> list[Played]:
    """Run the maker on a virtual clock: a drive for each frame, and every ``OFTEN``.

    With a spread the time to make a drive has the mean ``MAKING`` and this standard deviation [s];
    drives are made for the mean, or sent ahead to boards that play 9 of 10 at their time.
    """
    takes = np.full(10_000, MAKING)
    if spread > 0.0:
        shape = (MAKING / spread) ** 2
        takes = np.random.default_rng(5).gamma(shape, MAKING / shape, 10_000)
    promised = float(np.percentile(takes, 90)) if ahead else MAKING
    arrivals = [frame.time + latency for frame in frames]
    ticks = sorted(
        [*((then, frame) for then, frame in zip(arrivals, frames, strict=True))],
        key=lambda one: one[0],
    )
    played, now, index = [], arrivals[0], 0
    while now < seconds:
        for step in np.linspace(now - OFTEN, now, 5)[1:]:
            for solver in maker._solvers:
                solver.advance(float(step))
        while index < len(ticks) and ticks[index][0] <= now + 1e-9:
            maker.take(ticks[index][1])
            index += 1
        moment = maker.make(now + promised, Controls())
        if moment.joints is not None:
            takes = np.roll(takes, 1)
            acts = now + max(float(takes[0]), promised if ahead else 0.0)
            played.append(Played(acts, moment.amplitudes, moment.rule, moment.kept or np.nan))
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
        field = at.BoundaryElement(accuracy=ACCURACY).radiate(
            air, target.beacons()
        )  # exact beside the walls of a box
        transfer = at.transfer_matrix(field, scene.array)
        best = weighted_gerchberg_saxton(transfer, target).amplitudes
        return transfer.matrix, weakest(transfer.matrix, best)

    def kept(self, one: Played) -> float:
        """Share of the attainable pressure at the weakest focus, at equal energy."""
        matrix, attainable = self._matrix(round(one.time, 3))
        return weakest(matrix, one.amplitudes) / attainable


def weakest(matrix: np.ndarray, amplitudes: np.ndarray) -> float:
    return float(np.abs(matrix @ amplitudes).min() / np.linalg.norm(amplitudes))


MAKERS = ("airtact", "distances", "not re-posed")


def record(
    setting: Setting,
    makers: Sequence[str],
    rate: float,
    noise: float,
    given: argparse.Namespace,
    folder: Path,
) -> None:
    """Let the real loop follow the motion for each maker, and keep its sessions."""
    for which in makers:
        title, found = (
            f"{setting.name}, {rate:.0f} frames a second, noise {1e3 * noise:g} mm, {which}",
            [],
        )
        for run in range(given.runs):
            frames = frames_of(setting, rate, given.seconds, noise, run)
            path = folder / f"{title}{RUN}{run + 1}.h5"
            found.append(
                real(setting, maker_of(which, setting, False), frames, given.seconds, path)
            )
        if given.runs > 1:
            at_the_link(f"{title}, medians of {given.runs} runs", np.median(found, axis=0).tolist())


def judge(played: Sequence[Played], title: str, judge: Judge, every: int) -> tuple[float, float]:
    """Print what drives brought to the true hand; return the median and the lowest tenth."""
    some = [one for one in played if one.time > WARMING][::every]
    if not some:
        print(f"  {title}: nothing to judge, the loop was silent", flush=True)
        return float("nan"), float("nan")
    kept = np.array([judge.kept(one) for one in some])
    rules = ", ".join(
        f"{rule} {count}" for rule, count in Counter(one.rule for one in some).most_common()
    )
    off = np.median([abs(one.kept - got) for one, got in zip(some, kept, strict=True)])
    median, tenth = np.median(kept), np.quantile(kept, 0.1)
    print(
        f"  {title}: kept {median:.3f}, lowest tenth {tenth:.3f} of {len(kept)} ({rules}); "
        f"the expected share is {off:.3f} off",
        flush=True,
    )
    return float(median), float(tenth)


def judged(paths: Sequence[Path], tried: Judge, every: int) -> None:
    """Judge sessions, and print the medians of the runs of each."""
    runs = defaultdict(list)
    for path in paths:
        runs[path.stem.partition(RUN)[0]].append(judge(recorded(path), path.stem, tried, every))
    for title, found in runs.items():
        if len(found) > 1:
            median, tenth = np.median(found, axis=0)
            print(
                f"  {title}, medians of {len(found)} runs: kept {median:.3f}, lowest tenth {tenth:.3f}",
                flush=True,
            )


def solves(seconds: float) -> None:
    """Print how many hands of the pinch one thread solves in a second, each part by itself."""
    setting = pinch()
    scene, parts, bending = setting.scene, PartSolver(setting.scene), BendingHand(setting.scene)
    ways: dict[str, Callable[[np.ndarray, float], object]] = {
        "two fingers' phalanges, rigid (40 asked)": lambda joints, then: parts.solved(
            joints, "phalanges", then
        ),
        "the whole hand, on panels that bend (4 asked)": bending.solved,
        "the whole hand, meshed anew": lambda joints, then: PartSolver(scene).meshed(
            joints, "hand", then
        ),
    }
    with threadpool_limits(1):
        for what, solve in ways.items():
            solve(setting.motion(0.0), 0.0)  # what is made once
            begun, processor, count = time.monotonic(), time.process_time(), 0
            while (then := time.monotonic() - begun) < seconds:
                solve(setting.motion(then), then)
                count += 1
            each = (time.process_time() - processor) / count
            print(
                f"  {what}: {count / then:.1f} a second, {1e3 * each:.1f} ms of processor each",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--setting", choices=[*SETTINGS, "all"], default="all")
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--rates", type=float, nargs="+", default=[60.0, 120.0])
    parser.add_argument(
        "--noises", type=float, nargs="+", default=[0.0, 1e-3], help="of the tracker [m]"
    )
    parser.add_argument("--makers", choices=MAKERS, nargs="+", default=MAKERS)
    parser.add_argument("--method", default="best", help="that makes the drives")
    parser.add_argument("--every", type=int, default=JUDGED, help="so many drives, one is judged")
    parser.add_argument(
        "--runs", type=int, default=1, help="of the real loop, whose medians are printed, too"
    )
    parser.add_argument(
        "--solves", action="store_true", help="print how many hands a second are solved, alone"
    )
    parser.add_argument("--emulated", action="store_true", help="use a virtual clock")
    parser.add_argument(
        "--corrected",
        type=float,
        nargs="+",
        default=[],
        help="frames that echoes corrected, so much later each [s]",
    )
    parser.add_argument(
        "--spread", type=float, default=0.0, help="of the time to make a drive, emulated [s]"
    )
    parser.add_argument("--record", type=Path, help="folder for sessions that are not judged yet")
    parser.add_argument("--judge", type=Path, help="folder of sessions that were recorded before")
    given = parser.parse_args()
    if given.solves:
        solves(given.seconds)
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.judge or given.record or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name in SETTINGS if given.setting == "all" else [given.setting]:
            setting = SETTINGS[name]()
            setting = replace(setting, scene=replace(setting.scene, method=given.method), name=name)
            tried = Judge(setting)
            for delay in given.corrected if given.emulated else ():
                frames = frames_of(setting, 1.0 / delay, given.seconds, CORRECTED)
                played = emulated(
                    maker_of("airtact", setting, True), frames, given.seconds, LATENCY + delay
                )
                judge(
                    played,
                    f"{name}, frames corrected within {1e3 * delay:g} ms, emulated",
                    tried,
                    given.every,
                )
            for rate, noise in product(given.rates, given.noises):
                if given.emulated:
                    frames = frames_of(setting, rate, given.seconds, noise)
                    for which in given.makers:
                        for ahead in (False, True) if given.spread else (False,):
                            maker = maker_of(which, setting, True)
                            played = emulated(
                                maker, frames, given.seconds, spread=given.spread, ahead=ahead
                            )
                            sent = ", sent ahead" if ahead else ""
                            judge(
                                played,
                                f"{name}, {rate:.0f}/s, {1e3 * noise:g} mm, {which}, emulated{sent}",
                                tried,
                                given.every,
                            )
                elif given.judge is None:
                    record(setting, given.makers, rate, noise, given, folder)
            if not given.record:
                judged(sorted(folder.glob(f"{name},*.h5")), tried, given.every)


if __name__ == "__main__":
    main()
