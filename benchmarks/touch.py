"""Closed-loop truth of touch: what drives for virtual objects bring to the true hand.

Run ``python -m benchmarks.touch [--setting ball] [--seconds 10] [--emulated]``, or first with
``--record FOLDER``, which takes as long as the motions and wants a quiet machine, and then with
``--judge FOLDER``. Two fingers grasp and release a ball of 30 mm at 0.5 Hz; an index finger presses
a button at 1 Hz in the paper's box; a flat hand strokes a textured plane. Frames of the known
motion, 60 per second, with 0 or 1 mm of noise and 15 ms of latency, go by a web socket through the
real loop. Every 20th drive, or with ``--instants 20`` the drive in the air at 20 instants that all
runs share, is tried on the true hand by a solution of the whole hand at 2 %, at the contacts that
the true hand then has. Kept is the pressure at the weakest
focus, in proportion to its strength, over that of the drive made from the true hand, at equal
energy; a contact deeper than 2 mm without a focus counts as 0. With ``--emulated`` the clock is
virtual, and a solution takes 20 ms, so that a busy machine does not matter. ``--find`` prints the
processor times to find the contacts of a hand with three objects. The medians of three runs, as a
table, in 12 minutes: ``--runs 3 --seconds 6 --instants 20 --table FILE``.
"""

import argparse
import tempfile
import threading
import time
from bisect import bisect
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.spatial import KDTree
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import airtact as at
from airtact.drives.gerchberg_saxton import weighted_gerchberg_saxton
from airtact.hands.hand import Hand
from airtact.hands.kinematics import turned
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.hands.tracking.messages import to_json
from airtact.live.drives.moving_skin import MovingSkin
from airtact.live.drives.skin_solver import SkinRequest, SkinSolver
from airtact.live.drives.solver_process import SolverProcess, solved_ahead
from airtact.live.drives.touching import TouchAware
from airtact.live.moment import Controls, Moment
from airtact.live.scene import LiveScene
from airtact.touch import Box, Button, Grating, HalfSpace, TouchState, skin_of
from airtact.touch.finding import find
from references.hand_poses import example
from references.motions import Pinching

LATENCY = 0.015
"""From the picture to the frame's arrival [s]."""

RATE = 60.0
"""Frames per second."""

JUDGED, ACCURACY = 20, 0.02
"""Every so many drives one is judged, by a solution of this accuracy."""

SOLVING, MAKING, OFTEN = 0.02, 0.006, 1.0 / 66.0
"""Where the clock is virtual: time to solve, to make a drive, and between two drives [s]."""

WARMING = 1.0
"""Time before the first drive that is judged [s]."""

GOLDEN = 0.618034
"""Fractional part of the golden ratio."""

RUN = ", run "
"""What stands before the number of a run in the name of its session."""


@dataclass(frozen=True)
class Setting:
    """A scene with objects, and the motion of the hand in it: joints (25, 3) at a time [m]."""

    scene: LiveScene
    motion: Callable[[float], np.ndarray]
    name: str

    def hand(self, then: float) -> Hand:
        """Return the true hand at a time [s]."""
        assert self.scene.radii is not None
        return Hand(np.asarray(self.motion(then)), self.scene.radii, self.scene.side)


# --- settings ---------------------------------------------------------------------------------


def scene_of(array: at.PhasedArray, side, radii, thing: at.VirtualObject) -> LiveScene:
    """Make a scene with an object, for a hand of this side and these radii."""
    nothing = np.zeros(0)
    return LiveScene(
        at.air(celsius=22), 40e3, array, side, radii, (), nothing, objects=(thing,), both=True
    )


def between_fingers(joints: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Return the middle of the gap between thumb and index finger (3,) [m]."""
    skin = skin_of(Hand(joints, radii, "left"))
    thumb, index = (skin.points[skin.place == place] for place in (0, 1))
    distances, nearest = KDTree(index).query(thumb)
    first = int(distances.argmin())
    return 0.5 * (thumb[first] + index[nearest[first]])


def ball() -> Setting:
    """Thumb and index finger at a ball of 30 mm, 200 mm before 2 x 2 flat boards."""
    pinching = Pinching(17)

    def joints(then: float) -> np.ndarray:
        gap = 0.0345 + 0.0095 * np.cos(np.pi * then)
        index = np.interp(gap, pinching.gaps, np.arange(len(pinching.gaps)))
        low = min(int(index), len(pinching.gaps) - 2)
        step = pinching.joints[low + 1] - pinching.joints[low]
        return pinching.joints[low] + (index - low) * step

    centre = tuple(between_fingers(joints(1.0), pinching.radii))
    array = at.flat_boards(2, 2).facing(centre, (1.0, 0.0, 0.0), 0.2)
    thing = at.VirtualObject(at.sphere(15e-3, 3e-3, centre), name="ball")
    return Setting(scene_of(array, "left", pinching.radii, thing), joints, "ball")


def button() -> Setting:
    """Press a button with an index finger of 0.8 of the size in the paper's box."""
    # Of 40,000 rotation vectors [rad], the one whose hand is farthest from the walls.
    axis = (0.954, 0.373, -0.933)
    upright = at.Pose.turn(axis, float(np.linalg.norm(axis)))
    pinching = Pinching(17)
    radii = 0.8 * pinching.radii
    rest = 0.8 * upright.apply(pinching.joints[10])
    rest = rest - between_fingers(rest, radii)

    def joints(then: float) -> np.ndarray:
        return turned(rest, "left", 1, 0.06 - 0.06 * np.cos(2.0 * np.pi * (then + 0.5)))

    # The button faces the pad of the finger when it is pressed farthest.
    pressed = Hand(joints(0.5), radii, "left")
    point, normal = pressed.place("index.pad")
    top = point - 3e-3 * normal
    thing = at.VirtualObject(Button(tuple(top), 5e-3, 4e-3, tuple(-normal)), name="button")
    return Setting(scene_of(at.surrounding_box(), "left", radii, thing), joints, "button")


def plane() -> Setting:
    """Stroke a textured plane with a flat hand, 200 mm over 2 x 2 flat boards."""
    rest, radii = example("relaxed")
    hand = at.hand_from_joints(rest, radii)
    side = hand.side
    middle, (_, facing) = rest.mean(axis=0), hand.places["palm"]
    array = at.flat_boards(2, 2).facing(tuple(middle), tuple(facing), 0.2)
    flat = turned(rest, side, 0, 0.4)
    for finger in range(1, 5):
        flat = turned(flat, side, finger, 0.15)
    # Turn each finger until its pad is as high as the palm over the plane through all of them.
    points = np.array([point for point, _ in Hand(flat, radii, side).places.values()])
    normal = np.linalg.svd(points - points.mean(axis=0))[2][2]
    normal = normal * np.sign(normal @ facing)
    for finger in range(5):

        def height(angle: float, finger: int = finger, start: np.ndarray = flat) -> float:
            pad = Hand(turned(start, side, finger, angle), radii, side).pads[finger]
            return float((pad - points[5]) @ normal)

        flat = turned(flat, side, finger, brentq(height, -0.4, 0.4))
    across = np.cross(normal, [0.0, 1.0, 0.3])
    across /= np.linalg.norm(across)
    skin = skin_of(Hand(flat, radii, side)).points
    top = skin[(skin @ normal).argmax()] - 5e-3 * normal
    thing = at.VirtualObject(
        HalfSpace(tuple(top), tuple(-normal)),
        name="plane",
        style="texture",
        texture=Grating(8e-3, tuple(across)),
    )
    return Setting(
        scene_of(array, side, radii, thing),
        lambda then: flat + 0.03 * np.sin(np.pi * then) * across,
        "plane",
    )


SETTINGS = {"ball": ball, "button": button, "plane": plane}


def frames_of(setting: Setting, seconds: float, noise: float, seed: int) -> list[HandFrame]:
    """Make the frames of a tracker with white noise in each coordinate [m]."""
    random = np.random.default_rng(seed)
    frames = []
    for index in range(round(seconds * RATE)):
        joints = setting.motion(index / RATE) + noise * random.normal(size=(25, 3))
        with suppress(FaultyFrame):  # as a stream does
            frames.append(HandFrame(index / RATE, setting.scene.side, index, joints))
    return frames


# --- the real loop ----------------------------------------------------------------------------


@dataclass
class Played:
    """A drive, when it was in the air [s], and its foci by name."""

    time: float
    amplitudes: np.ndarray
    names: tuple[str, ...]
    foci: np.ndarray
    strengths: np.ndarray
    frame_time: float


class Noting(TouchAware):
    """Keeps what it makes, because sessions do not hold the names of foci."""

    def __init__(self, scene: LiveScene, solvers: Sequence[SolverProcess] | None = None) -> None:
        super().__init__(scene, solvers=solvers)
        self.made: list[Moment] = []

    def make(self, time: float, controls: Controls) -> Moment:
        moment = super().make(time, controls)
        self.made.append(moment)
        return moment


def real(
    setting: Setting, maker: Noting, frames: Sequence[HandFrame], path: Path
) -> dict[str, float]:
    """Send frames to the real loop by a web socket, and keep what it does in a file."""
    # The process that solves needs seconds to start.
    until = time.monotonic() + 60.0
    touching = frames[round(RATE)]
    count = 0
    while maker._solvers and maker.solutions < 5 and time.monotonic() < until:
        maker.take(replace(touching, time=touching.time - 200.0 + 0.02 * count))
        maker.make(touching.time - 200.0 + 0.02 * count, Controls())
        count += 1
        time.sleep(0.02)
    begun = maker.solutions
    maker.made.clear()
    hands = at.live.ReceivedHands(0)
    seconds = frames[-1].time

    def send() -> None:
        with suppress(ConnectionClosed), connect(hands.words) as connection:
            start = time.monotonic()
            for frame in frames:
                time.sleep(max(start + frame.time + LATENCY - time.monotonic(), 0.0))
                connection.send(to_json(frame).decode())

    session = at.live.SessionWriter(path.with_suffix(".h5"), setting.scene)
    sender = threading.Thread(target=send, daemon=True)
    sender.start()
    done = at.live.follow(
        setting.scene, hands, maker, seconds=seconds, session=session, latency=LATENCY
    )
    sender.join()
    figures = {
        "drives/s": done.rate,
        "ms from 95 of 100 frames to the link": 1e3 * done.delay,
        "solutions/s": (maker.solutions - begun) / seconds,
    }
    tell(path.stem, figures)
    kept = at.live.read_session(path.with_suffix(".h5"))
    emitted = dict(zip(kept.drive_frame_time.tolist(), kept.time_in_air.tolist(), strict=True))
    played = [played_of(moment) for moment in maker.made if moment.foci is not None]
    for one in played:
        one.time = max(one.time, emitted.get(one.frame_time, one.time))
    np.save(path, np.array(played, dtype=object), allow_pickle=True)
    return figures


def tell(title: str, figures: dict[str, float]) -> None:
    """Print one line per figure."""
    for name, figure in figures.items():
        print(f"  {title}: {figure:.4g} {name}", flush=True)


def played_of(moment: Moment) -> Played:
    """Return what matters of a moment."""
    assert moment.foci is not None
    assert moment.strengths is not None
    return Played(
        moment.time,
        moment.amplitudes,
        moment.names,
        moment.foci,
        moment.strengths,
        moment.frame_time,
    )


# --- the virtual clock ------------------------------------------------------------------------


class Emulated(SolverProcess):
    """Solves requests, each ready after a given time of a clock that ``advance`` sets."""

    def __init__(self, scene: LiveScene) -> None:
        self._solver = SkinSolver(scene)
        self._asked: tuple[float, SkinRequest] | None = None
        self._running: tuple[float, object] | None = None
        self._ready: list[object] = []
        self.now = 0.0

    def advance(self, now: float) -> None:
        """Set the clock [s]."""
        self.now = now
        if self._running is not None and self._running[0] <= now:
            self._ready.append(self._running[1])
            self._running = None
        if self._running is None and self._asked is not None:
            then, asked = self._asked
            self._asked = None
            ahead = solved_ahead(SOLVING) + now - then
            with suppress(at.InvalidInput, at.NotConverged):
                answer = self._solver.solved(asked.after(ahead), asked.time + ahead)
                if answer is not None:
                    self._running = (now + SOLVING, answer)

    def ask(self, request) -> None:
        self._asked = (self.now, request)

    def solutions(self) -> list[object]:
        ready, self._ready = self._ready, []
        return ready

    def close(self) -> None:
        pass


def emulated(maker: Noting, frames: Sequence[HandFrame]) -> list[Played]:
    """Run the maker on a virtual clock: a drive for each frame, and every ``OFTEN``."""
    arrivals = [frame.time + LATENCY for frame in frames]
    played = []
    now = arrivals[0]
    index = 0
    while now < frames[-1].time:
        for solver in maker._solvers:
            for step in np.linspace(now - OFTEN, now, 5)[1:]:
                solver.advance(float(step))
        while index < len(frames) and arrivals[index] <= now + 1e-9:
            maker.take(frames[index])
            index += 1
        moment = maker.make(now + MAKING, Controls())
        if moment.foci is not None:
            played.append(played_of(moment))
        now = min(now + OFTEN, arrivals[index] if index < len(arrivals) else np.inf)
    return played


# --- the true hand ----------------------------------------------------------------------------


class Judge:
    """Tries drives on the true hand, solved as a whole."""

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        # The skin has the points of the loop's, so that foci on a flat palm have the same places.
        self._skin = MovingSkin()
        self._skin.at(setting.hand(0.0))
        self._matrix = cache(self._solved)

    def true_foci(self, then: float) -> at.touch.TouchFoci:
        """Return the foci of the true hand, at full level."""
        state = TouchState(self._setting.scene.objects)
        skin = self._skin.at(self._setting.hand(then))
        state.update(skin, 0.0)
        return state.update(skin, 1.0)

    def depths(self, then: float) -> dict[str, float]:
        """Return the depth of the deepest contact of each part of the true hand [m]."""
        skin = self._skin.at(self._setting.hand(then))
        found = find(skin, self._setting.scene.objects)
        deepest: dict[str, float] = {}
        for place, depth in zip(found.places, found.depths.tolist(), strict=True):
            name = skin.places[place]
            deepest[name] = max(depth, deepest.get(name, 0.0))
        return deepest

    def _solved(self, then: float) -> tuple[np.ndarray, at.touch.TouchFoci]:
        scene = self._setting.scene
        foci = self.true_foci(then)
        hand = self._setting.hand(then)
        air = at.Scene(scene.medium, [at.sound_hard(hand.surface)], frequency=scene.frequency)
        # Beside the walls of a box, the pressure at an element needs both equations.
        near = bool((hand.surface.depth(scene.array.positions) > -12e-3).any())
        solver = at.BoundaryElement(accuracy=ACCURACY, estimate=near)
        field = solver.radiate(air, at.Target(foci.points).beacons())
        return at.transfer_matrix(field, scene.array).matrix, foci

    def kept(self, one: Played, then: float) -> float:
        """Share of the attainable pressure at the weakest true contact with a focus at a time [s]."""
        if not len(self.true_foci(then).points):
            return float("nan")  # foci fade after the contact
        matrix, foci = self._matrix(then)
        # Each true focus is compared with the nearest played one on the same part of the hand.
        chosen = []
        strengths = []
        for index, name in enumerate(foci.names):
            same = [
                played for played, other in enumerate(one.names) if other.split(".", 1)[-1] == name
            ]
            apart = [np.linalg.norm(one.foci[other] - foci.points[index]) for other in same]
            if apart and min(apart) < 8e-3:
                strength = one.strengths[same[int(np.argmin(apart))]]
                # Others drown a focus that is weaker than a tenth of the strongest.
                if strength > 0.1 * one.strengths.max():
                    chosen.append(index)
                    strengths.append(strength)
        if not chosen:
            return float("nan")
        rows = matrix[chosen]
        shares = np.array(strengths)
        transfer = at.TransferMatrix(rows, float("nan"))
        target = at.Target(foci.points[chosen], shares=shares)
        ideal = weighted_gerchberg_saxton(transfer, target).amplitudes
        return weakest(rows, one.amplitudes, shares) / weakest(rows, ideal, shares)


def weakest(matrix: np.ndarray, amplitudes: np.ndarray, shares: np.ndarray) -> float:
    received = np.abs(matrix @ amplitudes) / shares
    return float(received.min() / max(np.linalg.norm(amplitudes), 1e-12))


def judge(
    played: Sequence[Played], title: str, tried: Judge, every: int, instants: Sequence[float]
) -> dict[str, float]:
    """Print what drives bring to the true hand, missed and false contacts, and delays.

    Judge every so many drives when they reach the air, or those in the air at some instants [s].
    """
    later = [one for one in played if one.time > WARMING]
    chosen = [(one, one.time) for one in later if sounds(one)][::every]
    if len(instants):
        times = [one.time for one in later]
        newest = [later[max(bisect(times, then) - 1, 0)] for then in instants]
        chosen = [(one, then) for one, then in zip(newest, instants, strict=True) if sounds(one)]
    kept = np.array([tried.kept(one, then) for one, then in chosen])
    kept = kept[np.isfinite(kept)]
    missed = 0
    false = 0
    for one in later:
        depths = tried.depths(one.time)
        parts = {name.split(" at ")[0].split(".")[-1] for name in one.names}
        missed += any(depth > 2e-3 and part not in parts for part, depth in depths.items())
        # Foci fade for 20 ms and skin is released 1 mm outside.
        near = {name for then in (one.time - 0.03, one.time) for name in find_parts(tried, then)}
        false += any(part not in near for part in parts)
    if not len(kept):
        print(f"  {title}: nothing to judge, the loop was silent", flush=True)
        return {}
    figures = {
        "kept, median": np.median(kept),
        "kept, lowest tenth": np.quantile(kept, 0.1),
        "drives judged": len(kept),
        "drives": len(later),
        "drives miss a contact deeper than 2 mm": missed,
        "drives have a focus without a contact": false,
    }
    waited = 1e3 * delays(played, tried)
    if len(waited):
        text = "ms from the first frame with a contact to the first drive with its focus"
        figures[f"{text}, median"] = np.median(waited)
        figures[f"{text}, 95 of 100"] = np.quantile(waited, 0.95)
    tell(title, figures)
    return figures


def sounds(one: Played) -> bool:
    """Whether a drive has a focus that can be felt."""
    return len(one.strengths) > 0 and one.strengths.max() > 0.05


def find_parts(tried: Judge, then: float) -> set[str]:
    """Return the parts of the true hand inside an object, or at most 1 mm outside."""
    skin = tried._skin.at(tried._setting.hand(then))
    found = find(skin, tried._setting.scene.objects, 1e-3)
    return {skin.places[place] for place in found.places}


def delays(played: Sequence[Played], tried: Judge) -> np.ndarray:
    """Return the times from the arrival of the first frame with a contact to its first drive [s]."""
    waited = []
    before: set[str] = set()
    for index in range(round(played[-1].time * RATE)):
        then = index / RATE
        now = set(tried.depths(then))
        for part in now - before if index else ():
            for one in played:
                parts = {name.split(" at ")[0].split(".")[-1] for name in one.names}
                if one.time > then - 0.05 and part in parts:
                    waited.append(max(one.time - then - LATENCY, 0.0))
                    break
        before = now
    return np.array(waited)


# --- finding contacts -------------------------------------------------------------------------


def worlds(hand: Hand) -> dict[str, list[at.VirtualObject]]:
    """Three objects each: none touched, two fingers and the palm, nearly the whole hand."""
    index, outwards = hand.places["index.pad"]
    thumb, _ = hand.places["thumb.pad"]
    palm, normal = hand.places["palm"]
    thing = at.VirtualObject(at.sphere(15e-3, 3e-3, tuple(index + 13e-3 * outwards)), name="ball")
    box = at.VirtualObject(Box((0.02, 0.02, 0.02), tuple(thumb)), name="box")
    block = at.VirtualObject(Box((0.06, 0.06, 0.03), tuple(palm + 14e-3 * normal)), name="block")
    table = at.VirtualObject(HalfSpace(tuple(palm), tuple(-normal)), name="table")
    away = at.Pose.shift((0.3, 0.0, 0.0))
    return {
        "none touched": [one.moved(away) for one in (thing, box, block)],
        "thumb, index finger and palm": [thing, box, block],
        "also a plane through the hand": [thing, box, table],
    }


def finding() -> None:
    """Print the processor time to find contacts: medians of 500 frames of a moving skin."""
    hand = at.load_hand(at.example("relaxed.json"))
    skin = MovingSkin().at(hand)
    for name, objects in worlds(hand).items():
        state = TouchState(objects)
        times = []
        for frame in range(500):
            begun = time.process_time()
            found = find(skin, objects)
            between = time.process_time()
            state.update(skin, frame / RATE)
            times.append((between - begun, time.process_time() - between))
        once, all_of_it = 1e3 * np.median(times, axis=0)
        print(
            f"{len(skin.points):,} points, {name}: {len(found.depths)} contacts; find "
            f"{once:.2f} ms; with foci, hysteresis and ramps {all_of_it:.2f} ms"
        )


def main() -> None:
    """Print the results of the given settings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--setting", choices=[*SETTINGS, "all"], default="all")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--noises", type=float, nargs="+", default=[0.0, 1e-3], help="[m]")
    parser.add_argument("--every", type=int, default=JUDGED, help="so many drives, one is judged")
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--instants", type=int, default=0, help="so many instants are judged")
    parser.add_argument("--table", type=Path, help="file for the medians of all runs, in Markdown")
    parser.add_argument("--emulated", action="store_true", help="use a virtual clock")
    parser.add_argument("--find", action="store_true", help="only time the search for contacts")
    parser.add_argument("--record", type=Path, help="folder for runs that are not judged yet")
    parser.add_argument("--judge", type=Path, help="folder of runs that were recorded before")
    given = parser.parse_args()
    if given.find:
        finding()
        return
    # Instants that no period of a motion divides.
    instants = WARMING + (given.seconds - WARMING) * (np.arange(given.instants) * GOLDEN % 1.0)
    medians: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.judge or given.record or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name in SETTINGS if given.setting == "all" else [given.setting]:
            setting = SETTINGS[name]()
            tried = Judge(setting)
            for noise, which in product(given.noises, ("airtact", "distances")):
                done = []
                what = f"{name}, noise {1e3 * noise:g} mm, {which}"
                for run in range(given.runs):
                    title = f"{what}{RUN}{run + 1}"
                    done.append({})
                    path = folder / f"{title}.npy"
                    if given.judge is None:
                        frames = frames_of(setting, given.seconds, noise, run)
                        solvers = [] if which == "distances" else None
                        if given.emulated:
                            solvers = [] if which == "distances" else [Emulated(setting.scene)]
                            played = emulated(Noting(setting.scene, solvers), frames)
                            np.save(path, np.array(played, dtype=object), allow_pickle=True)
                        else:
                            done[-1] |= real(setting, Noting(setting.scene, solvers), frames, path)
                    if given.record is None and path.exists():
                        played = list(np.load(path, allow_pickle=True))
                        done[-1] |= judge(played, title, tried, given.every, np.sort(instants))
                names = dict.fromkeys(figure for figures in done for figure in figures)
                medians[what] = {
                    figure: float(np.median([one[figure] for one in done if figure in one]))
                    for figure in names
                }
                if given.runs > 1:
                    tell(f"{what}, median of {given.runs} runs", medians[what])
    if given.table is not None:
        text = table_of(medians)
        given.table.write_text(text, encoding="utf-8")
        print(text)


def table_of(medians: dict[str, dict[str, float]]) -> str:
    """Write figures as a table in Markdown, with one row for each setting."""
    figures = list(dict.fromkeys(figure for row in medians.values() for figure in row))
    lines = [f"| setting | {' | '.join(figures)} |", "|---" * (len(figures) + 1) + "|"]
    for what, row in medians.items():
        cells = [f"{row[figure]:.4g}" if figure in row else "-" for figure in figures]
        lines.append(f"| {what} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
