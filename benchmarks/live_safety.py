"""How soon the live loop is silent: after the emergency stop, and after the last good frame of a hand.

Run it from the root of the project: ``python -m benchmarks.live_safety [TRIALS]``. The boards are
AUTD3's own model of them. A raw client of the page stops them too, alone and beside 20 others that
never read what the page sends.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from threading import Thread

import numpy as np
from websockets.sync.client import connect

import airtact as at
from airtact.emission.links import link_to
from airtact.hands.tracking.recordings import Recording
from airtact.hands.tracking.stream import StreamHealth
from airtact.live.page.process import PageProcess
from airtact.setup import Setup

TRIALS = int(sys.argv[1]) if len(sys.argv) > 1 else 5


def stops(setup: Setup, folder: Path, beside: int | None = None) -> list[float]:
    """Return the times from the emergency stop to the silence that the boards confirm [s].

    The program itself presses it, or a client of the page beside others that read nothing.
    """
    scene, took = at.live.live_scene(setup), []
    motion = at.hands.load_recording(at.example("reaching.jsonl"))
    for trial in range(TRIALS):
        log = folder / f"{beside}-{trial}.log"
        boards = at.live.Output(
            link_to("audit", "autd3", setup.poses, setup.medium.sound_speed), log
        )
        pressed = []
        page = None
        stop = boards.stop
        with ExitStack() as closing:
            if beside is not None:
                page = closing.enter_context(PageProcess(scene, 0, on_emergency=boards.stop))
                address = page.address.replace("http", "ws")
                for _ in range(beside + 1):
                    client = connect(address, proxy=None, max_size=None, ping_interval=None)
                    closing.enter_context(client)
                    stop = partial(client.send, '{"emergency": true}')

            def press(
                after: float = 0.1 * trial,
                stop: Callable[[], None] = stop,
                pressed: list[float] = pressed,
            ) -> None:
                time.sleep(after)
                pressed.append(time.monotonic())
                stop()

            fingers = [Thread(target=press)]

            def reported(status: at.live.Status, fingers: list = fingers) -> None:
                if status.state == "playing" and fingers:
                    fingers.pop().start()

            hands, maker = at.live.RecordedHands(motion), at.live.HandAware(scene, solvers=[])
            at.live.follow(
                scene, hands, maker, output=boards, seconds=3.0, report=reported, page=page
            )
        line = next(line for line in log.read_text().splitlines() if "silence confirmed" in line)
        took.append(float(line.split()[0]) - pressed[0])
    return took


def fades(setup: Setup, folder: Path) -> list[float]:
    """Time from the last good frame to the zero drive, by the session [s]."""
    scene, took = at.live.live_scene(setup), []
    frames = at.hands.load_recording(at.example("reaching.jsonl")).frames[:130]
    kept = tuple(frame for frame in frames if not 60 <= frame.sequence < 120)
    for trial in range(TRIALS):
        file = folder / f"{trial}.h5"
        hands = at.live.RecordedHands(Recording(kept, StreamHealth()))
        at.live.follow(
            scene,
            hands,
            at.live.HandAware(scene, solvers=[]),
            session=at.live.SessionWriter(file, scene),
        )
        session = at.live.read_session(file)
        silent = ~session.amplitudes.any(axis=1) & (session.time_in_air > kept[59].time)
        took.append(float(session.time_in_air[silent][0] - kept[59].time))
    return took


def main() -> None:
    setup = at.read_scene(at.example("live_pinch"))
    with tempfile.TemporaryDirectory() as folder:
        for what, measure in (
            ("emergency stop of the program to silence", stops),
            ("emergency stop of a raw client to silence", partial(stops, beside=0)),
            ("emergency stop of a raw client beside 20", partial(stops, beside=20)),
            ("last good frame to silence", fades),
        ):
            took = 1e3 * np.array(measure(setup, Path(folder)))
            print(
                f"{what}: median {np.median(took):.0f} ms, longest {took.max():.0f} ms of {len(took)}"
            )


if __name__ == "__main__":
    main()
