"""How soon the live loop is silent: after the emergency stop, and after the last good frame of a hand.

Run it from the root of the project: ``python -m benchmarks.live_safety``. The boards are AUTD3's
own model of them.
"""

import tempfile
import time
from pathlib import Path
from threading import Thread

import numpy as np

import airtact as at
from airtact.emission.links import link_to
from airtact.hands.tracking.recordings import Recording
from airtact.hands.tracking.stream import StreamHealth
from airtact.setup import Setup

TRIALS = 5


def stops(setup: Setup, folder: Path) -> list[float]:
    """Time from the emergency stop to the silence that the boards confirm, by the link's log [s]."""
    scene, took = at.live.live_scene(setup), []
    motion = at.hands.load_recording(at.example("reaching.jsonl"))
    for trial in range(TRIALS):
        log = folder / f"{trial}.log"
        boards = at.live.Output(
            link_to("audit", "autd3", setup.poses, setup.medium.sound_speed), log
        )
        pressed = []

        def press(
            after: float = 0.1 * trial, boards: at.live.Output = boards, pressed: list = pressed
        ) -> None:
            time.sleep(after)
            pressed.append(time.monotonic())
            boards.stop()

        fingers = [Thread(target=press)]

        def reported(status: at.live.Status, fingers: list = fingers) -> None:
            if status.state == "playing" and fingers:
                fingers.pop().start()

        hands, maker = at.live.RecordedHands(motion), at.live.HandAware(scene, solvers=[])
        at.live.follow(scene, hands, maker, output=boards, seconds=3.0, report=reported)
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
            ("emergency stop to silence", stops),
            ("last good frame to silence", fades),
        ):
            took = 1e3 * np.array(measure(setup, Path(folder)))
            print(
                f"{what}: median {np.median(took):.0f} ms, longest {took.max():.0f} ms of {len(took)}"
            )


if __name__ == "__main__":
    main()
