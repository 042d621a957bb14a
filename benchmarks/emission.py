"""What the process of a link costs, and how soon the boards are silent when a process dies. Prints one table.

Run as ``python -m benchmarks.emission [TRIALS]``.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import airtact as at
from airtact.emission import Link, LinkFailed, RecordingLink

FRAMES, TRIALS = 1000, 10
DRIVE = at.Drive(np.exp(2j * np.pi * np.arange(996) / 7))

FEEDER = """
import sys, numpy as np, airtact as at
from airtact.emission import RecordingLink
link = RecordingLink("autd3", 4) if sys.argv[1] == "recording" else at.AUTD3Link([at.Pose.identity()] * 4)
drive = at.Drive(np.exp(2j * np.pi * np.arange(996) / 7))
with at.Emission(link, cap=1.0, log=sys.argv[2]) as emission:
    emission.send(drive)
    print("emits", flush=True)
    while True:
        emission.send(drive)
"""


def link_of(name: str) -> Link:
    return (
        RecordingLink("autd3", 4) if name == "recording" else at.AUTD3Link([at.Pose.identity()] * 4)
    )


TIMES = (
    "opening takes longer by [s]",
    "frame of 996 elements that the boards have, median [ms]",
    "99 of 100 within [ms]",
    "frame of 996 elements on its way, median [ms]",
    "99 of 100 within [ms]",
    "stop [ms]",
)


def times_of_frames(name: str) -> tuple[float, ...]:
    """Return the values of ``TIMES``."""
    begun = time.perf_counter()
    link = link_of(name)
    link.open()
    link.close()
    alone = time.perf_counter() - begun
    begun = time.perf_counter()
    with at.Emission(link_of(name), cap=1.0) as emission:
        longer = time.perf_counter() - begun - alone
        emission.send(DRIVE)
        took = {True: [], False: []}
        for wait, times in took.items():
            for _ in range(FRAMES):
                begun = time.perf_counter()
                emission.send(DRIVE, wait)
                times.append(time.perf_counter() - begun)
                time.sleep(0.002)
        begun = time.perf_counter()
        emission.stop()
        stopped = time.perf_counter() - begun
    frames = [
        float(value) for times in took.values() for value in 1e3 * np.percentile(times, [50, 99])
    ]
    return longer, *frames, 1e3 * stopped


def killed_to_silent(name: str, trials: int) -> list[float]:
    """Kill processes that send as fast as they can; return the times until silence was confirmed [ms]."""
    found = []
    for _ in range(trials):
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "log"
            command = [sys.executable, "-c", FEEDER, name, str(log)]
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as feeder:
                assert feeder.stdout is not None
                feeder.stdout.readline()
                killed = time.monotonic()
                feeder.kill()
            while not log.read_text().endswith("closed\n"):
                time.sleep(0.01)
            silent = next(
                line for line in log.read_text().splitlines() if line.endswith("silence confirmed")
            )
            found.append(1e3 * (float(silent.split()[0]) - killed))
    return found


def lost_to_known(trials: int) -> tuple[list[float], list[float]]:
    """Kill link processes while their feeders hold; return the times until they know, and until silence [ms]."""
    known, silent = [], []
    for _ in range(trials):
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "log"
            try:
                with at.Emission(link_of("audit"), cap=1.0, log=log) as emission:
                    emission.send(DRIVE)
                    process = emission.process
                    assert process is not None
                    killed = time.monotonic()
                    os.kill(process, signal.SIGKILL)
                    try:
                        emission.hold(5.0)
                    except LinkFailed:
                        known.append(1e3 * (time.monotonic() - killed))
            except LinkFailed:
                pass  # leaving the block raises it again: the link process was killed
            line = next(
                line for line in log.read_text().splitlines() if line.endswith("silence confirmed")
            )
            silent.append(1e3 * (float(line.split()[0]) - killed))
    return known, silent


def main() -> None:
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else TRIALS
    print("| what | recording | audit |\n|---|---|---|")
    rows = {name: times_of_frames(name) for name in ("recording", "audit")}
    for index, what in enumerate(TIMES):
        print(f"| {what} | {rows['recording'][index]:.2f} | {rows['audit'][index]:.2f} |")
    silent = {name: killed_to_silent(name, trials) for name in rows}
    words = [f"{np.median(one):.1f}, at most {max(one):.1f}" for one in silent.values()]
    print(
        f"| feeder killed until silence is confirmed, {trials} trials [ms] | {words[0]} | {words[1]} |"
    )
    known, rescued = lost_to_known(trials)
    print(
        f"| link process killed until the feeder knows [ms] | | {np.median(known):.1f}, at most {max(known):.1f} |"
    )
    print(
        f"| and until another has silenced the boards [ms] | | {np.median(rescued):.0f}, at most {max(rescued):.0f} |"
    )


if __name__ == "__main__":
    main()
