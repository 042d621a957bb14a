"""The live loop against trackers that lie, jump, stall and flood it, by real sockets.

Run it from the root of the project: ``python -m benchmarks.attacks [NAME]``. Each scenario sends
frames of a moving hand, damaged in its way, to a loop in a process of its own. Sound is wrong if its
foci are over 30 mm from every place where the hand was in the last 0.3 s, if there was no frame for
0.3 s, or if the scenario is one of silence. Tracebacks and loops that do not end are counted as well.
"""

import json
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import connect

import airtact as at
from airtact.live.scene import foci_on, hand_in
from airtact.live.sources import moved_to

SECONDS = 2.5

Frame = dict


def serve(file: str) -> None:
    """Follow the hand of a tracker, and note when which sound was sent with foci where."""
    setup = at.read_scene(at.example("live_pinch"))
    hands = at.live.ReceivedHands(0)
    noted = []
    foci = []

    class Noted(at.live.HandAware):
        def make(self, time, controls):
            moment = super().make(time, controls)
            if moment.foci is not None:  # a fade keeps the last ones
                foci[:] = moment.foci.mean(axis=0)
            return moment

    class Boards(at.live.Output):
        def send(self, amplitudes, at=None):
            loud = float(np.abs(amplitudes).max())
            noted.append([time.monotonic(), loud, *(foci or [np.nan] * 3)])

    scene = at.live.live_scene(setup)
    print(hands.words, flush=True)
    done = at.live.follow(
        scene, hands, Noted(scene, solvers=[]), output=Boards(), seconds=SECONDS + 1.5
    )
    np.save(file, np.array(noted).reshape(-1, 5))
    print(f"{done.state} | {done.health}")


# --- damaged frames: a function changes the frame with this index -------------------------------


def shifted(frame: Frame, shift: object) -> Frame:
    return frame | {"landmarks": (np.array(frame["landmarks"]) + shift).tolist()}


def sized(frame: Frame, size: float) -> Frame:
    points = np.array(frame["landmarks"])
    pads = points[[4, 9]].mean(axis=0)  # stays in place
    return frame | {"landmarks": (pads + size * (points - pads)).tolist()}


def once_at(time: float) -> Callable[[Frame, int], Frame]:
    return lambda frame, index: frame | ({"time": time} if index == 50 else {})


def by(**changed: Callable[[Frame, int], object]) -> Callable[[Frame, int], Frame]:
    return lambda frame, index: frame | {name: new(frame, index) for name, new in changed.items()}


def timed(new: Callable[[float, int], float]) -> Callable[[Frame, int], Frame]:
    return by(time=lambda frame, index: new(frame["time"], index))


def repeated_after(count: int) -> Callable[[Frame, int], Frame]:
    """Send the same frame again and again after so many."""
    kept: list[Frame] = []

    def damage(frame: Frame, index: int) -> Frame:
        if index <= count:
            kept[:] = [frame]
        return kept[0]

    return damage


def drifting(frame: Frame, index: int) -> Frame:
    """Move the tip of the index finger away from the hand, 1 mm per frame."""
    points = np.array(frame["landmarks"])
    points[8] += [0.0, 0.05 + 1e-3 * index, 0.0]
    return frame | {"landmarks": points.tolist()}


random = np.random.default_rng(1)
BEGUN = time.monotonic()
order = [*range(24, -1, -1)]

DAMAGED: dict[str, Callable[[Frame, int], Frame | None]] = {
    "nominal": lambda frame, index: frame,
    **{f"{ahead:g} s ahead once": (lambda a: timed(lambda t, i: t + a * (i == 60)))(ahead)
       for ahead in (0.1, 0.4, 0.6, 1.0, 30.0, 3600.0, 1e17, 4e18, -0.1, -1.0, -30.0, -1e6, -1e300)},
    **{f"time {time:g} once": once_at(time) for time in (1e103, 1e200, 1e308)},
    **{f"time in units of 1e-{power} s": (lambda p: timed(lambda t, i: t * 10.0**p))(power)
       for power in (3, 6, 9)},
    "milliseconds from 0": timed(lambda t, i: 1e3 * (t - BEGUN)),
    "milliseconds from frame 60": timed(lambda t, i: t * (1e3 if i > 60 else 1.0)),
    "seconds from frame 60": timed(lambda t, i: t * (1.0 if i > 60 else 1e3)),
    "time 10 % slow": timed(lambda t, i: BEGUN + 0.9 * (t - BEGUN)),
    "time of day": timed(lambda t, i: t + time.time() - time.monotonic()),
    "time from 0": timed(lambda t, i: t - BEGUN),
    "time constant": timed(lambda t, i: 5.0),
    "time twice as fast": timed(lambda t, i: BEGUN + 2.0 * (t - BEGUN)),
    "time 10 % fast": timed(lambda t, i: BEGUN + 1.1 * (t - BEGUN)),
    "time half as fast": timed(lambda t, i: BEGUN + 0.5 * (t - BEGUN)),
    "10 s back": timed(lambda t, i: t - 10.0 * (i > 60)),
    "1 h on": timed(lambda t, i: t + 3600.0 * (i > 60)),
    "1 s back each second": timed(lambda t, i: t - i // 60),
    "1 s on each second": timed(lambda t, i: t + i // 60),
    "0.2 s back each tenth": timed(lambda t, i: t - 0.2 * (i % 10 == 9)),
    **{f"jitter of {jitter} ms": (lambda j: timed(lambda t, i: t + random.normal(0.0, 1e-3 * j)))(
        jitter) for jitter in (3, 10, 30, 100)},
    "times at random": timed(lambda t, i: float(random.uniform(0.0, 1e6))),
    "restart from 0": by(
        time=lambda f, i: f["time"] - 1e4 * (i > 60), sequence=lambda f, i: i - 61 * (i > 60)
    ),
    "numbers random": by(sequence=lambda f, i: int(random.integers(2**40))),
    "numbers 0": by(sequence=lambda f, i: 0),
    "numbers backwards": by(sequence=lambda f, i: 10_000 - i),
    "number 2^53 once": by(sequence=lambda f, i: 2**53 if i == 60 else i),
    **{f"an outlier of {step:g} m": (
        lambda s: lambda f, i: shifted(f, [0.0, s * (i % 30 == 29), 0.0]))(step)
       for step in (0.1, 0.3, 1.0, 1e9)},
    "repeated after 60 frames": repeated_after(60),
    "each frame with more keys": by(confidence=lambda f, i: 0.9, device=lambda f, i: ["x"] * 9),
    "size that pulses": lambda f, i: sized(f, 1.0 + 0.2 * np.sin(0.1 * i)),
    "half of the frames missing": lambda f, i: f if random.random() < 0.5 else None,
    "side in capitals": by(side=lambda f, i: "LEFT"),
    "0.1 m to and fro": lambda f, i: shifted(f, [0.0, 0.1 * (i % 2), 0.0]),
    "every second frame NaN": lambda f, i: shifted(f, np.nan if i % 2 else 0.0),
    "lost every second frame": lambda f, i: f | ({"landmarks": None} if i % 2 else {}),
    "gaps of 100 ms": lambda f, i: f if i % 60 >= 6 else None,
    "gaps of 200 ms": lambda f, i: f if i % 60 >= 12 else None,
    "gaps of 300 ms": lambda f, i: f if i % 60 >= 18 else None,
    "left and right": lambda f, i: f | ({"side": "right"} if i % 2 else {}),
    **{f"size {size:g}": (lambda s: lambda f, i: sized(f, s))(size)
       for size in (0.5, 0.6, 0.75, 0.8, 0.9, 1.2, 1.4, 1.5)},
    # Silence is due in all that follow.
    "SILENT right hand labelled left": lambda f, i: f | {
        "landmarks": (np.array(f["landmarks"]) * [1, 1, -1]).tolist()},
    "SILENT only right": lambda f, i: f | {
        "side": "right", "landmarks": (np.array(f["landmarks"]) * [1, 1, -1]).tolist()},
    "SILENT through the array": lambda f, i: shifted(f, [0.22, 0.0, 0.0]),
    "SILENT behind the array": lambda f, i: shifted(f, [0.3, 0.0, 0.0]),
    "SILENT 0.8 m away": lambda f, i: shifted(f, [-0.8, 0.0, 0.0]),
    "SILENT all NaN": lambda f, i: shifted(f, np.nan),
    "SILENT a landmark null": lambda f, i: f | {"landmarks": [None, *f["landmarks"][1:]]},
    "SILENT lost": lambda f, i: f | {"landmarks": None},
    "SILENT millimetres": lambda f, i: f | {"landmarks": (1e3 * np.array(f["landmarks"])).tolist()},
    **{f"SILENT size {size:g}": (lambda s: lambda f, i: sized(f, s))(size)
       for size in (0.01, 0.2, 0.3, 2.0, 10.0)},
    "SILENT centimetres": lambda f, i: f | {
        "landmarks": (1e2 * np.array(f["landmarks"])).tolist()},
    "SILENT all at one point": lambda f, i: f | {"landmarks": [[0.0, 0.0, 0.0]] * 25},
    "SILENT 24 landmarks": lambda f, i: f | {"landmarks": f["landmarks"][:24]},
    "SILENT text for numbers": lambda f, i: f | {"landmarks": [["0", "0", "0"]] * 25},
    "SILENT no side": by(side=lambda f, i: None),
    "SILENT time null": by(time=lambda f, i: None),
    "SILENT a tip that drifts off": drifting,
    "SILENT landmarks reversed": lambda f, i: f | {"landmarks": f["landmarks"][::-1]},
    "SILENT fingers swapped": lambda f, i: f | {
        "landmarks": [*f["landmarks"][:5], *f["landmarks"][20:], *f["landmarks"][5:20]]},
}  # fmt: skip


# --- attacks beside a tracker: generators that begin, yield, and end ------------------------------


def flood(url: str, count: int, message: Callable[[int], str | bytes], seconds: float) -> None:
    """Send messages over many connections for a while."""
    with ExitStack() as closing:
        opened = [closing.enter_context(connect(url, proxy=None)) for _ in range(count)]
        end = time.monotonic() + seconds
        number = 0
        while time.monotonic() < end:
            for tracker in opened:
                number += 1
                with suppress(ConnectionClosed):
                    tracker.send(message(number))
            time.sleep(0.005)


def raw(url: str, data: bytes, count: int) -> list[socket.socket]:
    port = int(url.rpartition(":")[2])
    opened = []
    for _ in range(count):
        sender = socket.create_connection(("127.0.0.1", port))
        sender.sendall(data)
        opened.append(sender)
    return opened


def aside(url: str, name: str, frames: list[Frame]) -> None:
    """Attack the loop while another tracker sends a hand."""
    if name == "200 idle before":
        for _ in range(200):
            raw(url, b"", 0)
            IDLE.append(connect(url, proxy=None))
    elif name == "300 half handshakes":
        IDLE.extend(raw(url, b"GET / HTTP/1.1\r\nHost: x\r\n", 300))
    elif name == "wrong connections":
        IDLE.extend(raw(url, b"\x00\xff nothing\r\n\r\n", 20))
        for origin in ("https://evil.example", "null", "http://127.0.0.1.evil.com"):
            with suppress(InvalidHandshake):
                connect(url, origin=origin, proxy=None)
    elif name == "garbage by 40":
        flood(url, 40, lambda number: "[" * 1000, SECONDS)
    elif name == "clouds by 10":
        cloud = json.dumps([[0.0, 0.0, 0.001 * (i % 100)] for i in range(20_000)])
        start = '{"side": "left", "landmarks": null, "cloud": ' + cloud
        flood(url, 10, lambda n: f'{start}, "sequence": {n}, "time": {time.monotonic()}}}', SECONDS)
    elif name in ("messages of 1 MB", "messages of 5 MB"):
        size = int(name.split()[2]) * 1_000_000
        flood(url, 2, lambda number: b"x" * size, SECONDS)
    elif name == "broken frames":
        IDLE.extend(raw(url, b"\xff\x7f" * 100, 100))
    elif name == "nothing by 40":
        flood(url, 40, lambda number: "{}", SECONDS)
    elif name == "the other hand":

        def other(number: int) -> str:
            frame = shifted(frames[number % len(frames)], [0.0, 0.2, 0.0])
            return json.dumps(
                frame | {"side": "right", "time": time.monotonic(), "sequence": number}
            )

        flood(url, 1, other, SECONDS)
    elif name == "pings":
        with connect(url, proxy=None) as tracker:
            for _ in range(5000):
                tracker.ping()
    else:  # a second tracker of the same hand, 0.15 m beside it
        step = {"two, same numbers": 0, "two, +5000": 5000, "two, a flood": 10**6}[name]

        def false(number: int) -> str:
            index = int((time.monotonic() - BEGUN) * 60.0)
            frame = shifted(frames[number % len(frames)], [0.0, 0.15, 0.0])
            return json.dumps(frame | {"time": time.monotonic(), "sequence": index + step})

        # The first tracker ends later, as the second may follow it then.
        flood(url, 20 if "flood" in name else 1, false, SECONDS - 1.0)


IDLE: list = []
ASIDE = [
    "200 idle before", "300 half handshakes", "wrong connections", "garbage by 40", "clouds by 10",
    "messages of 1 MB", "messages of 5 MB", "broken frames", "nothing by 40", "the other hand",
    "pings", "two, same numbers", "two, +5000", "two, a flood",
]  # fmt: skip
ENDS = ["closed", "reset", "within a frame", "other tracker, other clock"]
RATES = {
    "2 Hz": 2,
    "5 Hz": 5,
    "10 Hz": 10,
    "15 Hz": 15,
    "30 Hz": 30,
    "120 Hz": 120,
    "240 Hz": 240,
    "500 Hz": 500,
    "2000 Hz": 2000,
}


def frames_of_hand() -> tuple[list[Frame], np.ndarray]:
    """Frames of a hand that reaches to and fro, and the centres of its foci (N, 3) [m]."""
    setup = at.read_scene(at.example("live_pinch"))
    scene = at.live.live_scene(setup)
    motion = moved_to(at.hands.load_recording(at.example("reaching.jsonl")), setup.hands[0])
    joints = [frame.landmarks for frame in motion.frames]
    centres = [foci_on(hand_in(scene, landmarks), scene).mean(axis=0) for landmarks in joints]
    frames = [{"side": "left", "landmarks": landmarks.tolist()} for landmarks in joints]
    return frames, np.array(centres)


def sent(url: str, name: str, frames: list[Frame]) -> Iterator[tuple[float, float]]:
    """Send the frames of a scenario; yield times and indices of frames that may sound."""
    damage = DAMAGED.get(name, DAMAGED["nominal"])
    rate = RATES.get(name, 60)
    count = round(SECONDS * rate)
    tracker = connect(url, proxy=None)
    begun = time.monotonic()
    offset = 0.0
    for index in range(count):
        time.sleep(max(begun + index / rate - time.monotonic(), 0.0))
        now = time.monotonic()
        # The exact place, as a sender that was late sends frames soon after each other.
        place = (now - begun) * 60.0 % (len(frames) - 1)
        before, after = (frames[int(place) + step]["landmarks"] for step in (0, 1))
        landmarks = np.array(before) + place % 1.0 * (np.array(after) - before)
        if index == count // 2 and name in ENDS:
            if name == "closed":
                return
            if name == "reset":
                tracker.socket.shutdown(socket.SHUT_RDWR)
                return
            if name == "within a frame":
                tracker.socket.sendall(b"\x81\xfe\x10\x00abcd{")
                time.sleep(1.0)
                return
            tracker.close()
            tracker = connect(url, proxy=None)
            offset = 12345.0
        frame = frames[0] | {"landmarks": landmarks.tolist(), "time": now + offset}
        frame = damage(frame | {"sequence": index}, index)
        if frame is not None:
            yield now, place
            with suppress(ConnectionClosed):
                tracker.send(json.dumps(frame))
    tracker.close()


def run(name: str, frames: list[Frame], centres: np.ndarray) -> dict[str, object]:
    """Run one scenario and count what is wrong."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "sent.npy"
        child = subprocess.Popen(
            [sys.executable, "-c", f"from benchmarks.attacks import serve; serve({str(file)!r})"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert child.stdout
        url = child.stdout.readline().strip()
        true = []
        with ThreadPoolExecutor(1) as attackers:
            if name in ASIDE and "before" in name:
                aside(url, name, frames)
            for index, place in enumerate(sent(url, name, frames)):
                true.append(place)
                if index == 15 and name in ASIDE and "before" not in name:
                    attackers.submit(aside, url, name, frames)
        try:
            out, said = child.communicate(timeout=30)
            hung = False
        except subprocess.TimeoutExpired:
            child.kill()
            out, said = child.communicate()
            hung = True
        noted = np.load(file) if file.exists() else np.zeros((0, 5))
    for connection in IDLE:
        with suppress(OSError):
            connection.close()
    times = np.array([now for now, _ in true])

    def places(at: np.ndarray) -> np.ndarray:
        """Return where the hand is, which moves on when frames are missing."""
        indices = (true[0][1] + 60.0 * (at - times[0])) % (len(centres) - 1)
        return np.array([np.interp(indices, np.arange(len(centres)), axis) for axis in centres.T]).T

    off = []
    wrong = 0
    loud = noted[noted[:, 1] > 0.0]
    for now, _, *foci in loud:
        # A fade of 85 ms follows 150 ms without a frame; a busy machine adds some.
        recent = places(np.linspace(now - 0.3, now, 61))
        distance = np.linalg.norm(recent - foci, axis=1).min(initial=np.inf)
        frame_age = now - times[times <= now].max(initial=-np.inf)
        if name.startswith("SILENT") or distance > 0.03 or frame_age > 0.3:
            wrong += 1
            print(f"  {name}: {1e3 * distance:.0f} mm off, {1e3 * frame_age:.0f} ms after a frame")
        off.append(np.linalg.norm(recent[-1] - foci))
    return {
        "name": name,
        "wrong": wrong,
        "loud": len(loud),
        "off": 1e3 * float(np.median(off)) if off else np.nan,
        "tracebacks": said.count("Traceback"),
        "hung": hung,
        "end": (out.strip().splitlines() or [said[-300:]])[-1],
    }


def main() -> None:
    names = sys.argv[1:] or [*DAMAGED, *RATES, *ENDS, *ASIDE]
    total = {"wrong": 0, "tracebacks": 0, "hung": 0}
    print(f"{'scenario':34} {'wrong':>5} {'sounding':>8} {'off [mm]':>8} {'tracebacks':>10} hung")
    frames, centres = frames_of_hand()
    with ThreadPoolExecutor(2) as two:
        for row in two.map(lambda name: run(name, frames, centres), names):
            for key in total:
                total[key] += int(bool(row[key]))
            print(
                f"{row['name']:34} {row['wrong']:5} {row['loud']:8} {row['off']:8.2f} "
                f"{row['tracebacks']:10} {row['hung']!s:5} {row['end']}",
                flush=True,
            )
    print(f"{len(names)} scenarios; with sound where silence is due, tracebacks, hangs: {total}")


if __name__ == "__main__":
    main()
