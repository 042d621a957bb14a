"""Ways to lose a link, its feeder or the room on a disk: how often something is loud, crashes, hangs or is lost.

Run as ``python -m benchmarks.ends [TRIALS] [ends|udp|render|live|sweep|sense ...]``: ends on a link that records, and on AUTD3
boards with UDP, as their emulator hears them. The rows of full disks need root, to mount a small disk.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import numpy as np

import airtact as at
from airtact.emission.link import RecordingLink
from airtact.emission.udp_link import UDPLink
from references.udp_boards import UDPBoards


class Faulty:
    """A link that may hang once, or refuse silence some times."""

    hangs = False
    refusals = 0

    def _transmit(self, frame: at.drives.Frame) -> None:
        if self.hangs and self.last is not None and not frame.silent:
            time.sleep(1e6)
        super()._transmit(frame)

    def _silence(self) -> None:
        if self.last is not None and self.refusals:
            self.refusals -= 1
            raise OSError(5, "refused")
        super()._silence()


class TracedLink(Faulty, RecordingLink):
    """Appends the time and loudness of each frame to a file."""

    def __init__(self, trace: str) -> None:
        super().__init__()
        self.trace = Path(trace)

    def _transmit(self, frame: at.drives.Frame) -> None:
        super()._transmit(frame)
        with self.trace.open("a") as file:
            file.write(f"{time.monotonic():.6f} {int(frame.amplitude.max())}\n")


class FaultyUDP(Faulty, UDPLink):
    """One board at an address."""

    def __init__(self, address: str) -> None:
        super().__init__([at.Pose.identity()], address)


FEEDER = """
import sys, numpy as np, airtact as at
from benchmarks import ends
link = getattr(ends, sys.argv[1])(sys.argv[2])
link.hangs = sys.argv[3] == "hangs"
link.refusals = int(sys.argv[4])
drive = at.Drive(np.exp(2j * np.pi * np.arange(249) / 7))
with at.Emission(link, cap=1.0, ramp=0.0) as emission:
    emission.send(drive)
    print(emission.process, flush=True)
    if link.hangs:
        emission.send(drive)
    emission.hold(60.0)
"""

# Name, kind of link, refusals of silence, and signals: whom, which, and how long after the one before [s].
ENDS = [
    ("link SIGSTOP", "plain", 0, [("link", "SIGSTOP", 0.0)]),
    ("link SIGSTOP, feeder SIGINT", "plain", 0, [("link", "SIGSTOP", 0.0), ("feeder", "SIGINT", 0.0)]),
    ("link SIGSTOP, feeder SIGKILL", "plain", 0, [("link", "SIGSTOP", 0.0), ("feeder", "SIGKILL", 0.0)]),
    ("link hangs", "hangs", 0, []),
    ("link hangs, feeder SIGINT", "hangs", 0, [("feeder", "SIGINT", 0.1)]),
    ("link hangs, feeder SIGKILL", "hangs", 0, [("feeder", "SIGKILL", 0.1)]),
    ("link SIGKILL, feeder SIGKILL at once", "plain", 0, [("link", "SIGKILL", 0.0), ("feeder", "SIGKILL", 0.0)]),
    ("link SIGKILL, feeder SIGKILL within 2 s", "plain", 0, [("link", "SIGKILL", 0.0), ("feeder", "SIGKILL", None)]),
    ("feeder SIGKILL, link SIGKILL at once", "plain", 0, [("feeder", "SIGKILL", 0.0), ("link", "SIGKILL", 0.0)]),
    ("feeder SIGKILL, link SIGKILL within 2 s", "plain", 0, [("feeder", "SIGKILL", 0.0), ("link", "SIGKILL", None)]),
    ("feeder SIGSTOP, link SIGKILL", "plain", 0, [("feeder", "SIGSTOP", 0.0), ("link", "SIGKILL", 0.0)]),
    ("feeder SIGKILL", "plain", 0, [("feeder", "SIGKILL", 0.0)]),
    ("silence fails 3 times, feeder SIGINT", "plain", 3, [("feeder", "SIGINT", 0.0)]),
    ("silence fails 5 times, feeder SIGINT", "plain", 5, [("feeder", "SIGINT", 0.0)]),
    ("silence fails 5 times, feeder SIGKILL", "plain", 5, [("feeder", "SIGKILL", 0.0)]),
]  # fmt: skip


def to_silence(folder: Path, on: str, kind: str, refusals: int, signals: list) -> float:
    """End an emission; return the time from the first signal, or the hang, until silence [s]."""
    trace = folder / f"{time.monotonic_ns()}.txt"
    boards = UDPBoards() if on == "udp" else None
    link = ["TracedLink", str(trace)] if boards is None else ["FaultyUDP", boards.address]
    command = [sys.executable, "-c", FEEDER, *link, kind, str(refusals)]
    nothing = subprocess.DEVNULL
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=nothing, text=True) as feeder:
        assert feeder.stdout is not None
        process = int(feeder.stdout.readline())
        begun = time.monotonic()
        for whom, name, pause in signals:
            time.sleep(random.uniform(0.0, 2.0) if pause is None else pause)
            with suppress(ProcessLookupError):  # it has ended already
                os.kill(process if whom == "link" else feeder.pid, getattr(signal, name))
        silent = np.inf
        if boards is not None:
            # What comes in the next 1.5 s must not sound either.
            ended = time.monotonic()
            while time.monotonic() < max(boards.sounded, ended) + 1.5 < begun + 10.0:
                time.sleep(0.05)
            if boards.sounded < begun + 8.0:
                silent = max(boards.sounded - begun, 0.0)
            boards.close()
        while boards is None and silent == np.inf and time.monotonic() < begun + 10.0:
            time.sleep(0.02)
            at_time, loudness = trace.read_text().splitlines()[-1].split()
            if loudness == "0":
                silent = float(at_time) - begun
        feeder.kill()
    return silent


DISKS = {
    "render": ["render", "touch_ball"],
    "live": ["live", "live_pinch", "--no-page", "--seconds", "6"],
    "sweep": ["sweep", "pinch", "--vary", "foci[0].offset=0.001:0.002:2"],
    "sense": ["sense", "pinch", "--simulate"],
}


def on_full_disk(folder: Path, name: str) -> tuple[str, str]:
    """Run a command on a small disk with an earlier result; return what went wrong, and its status."""
    disk = folder / "disk"
    disk.mkdir(exist_ok=True)
    size = int(10 ** random.uniform(4.6, 6.7))
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(disk)]
    subprocess.run(mount, check=True)
    wrong = ""
    try:
        earlier = [disk / "probe", disk / "notes.txt"]
        for file in earlier:
            file.write_text("of the user")
        command = [sys.executable, "-m", "airtact", *DISKS[name], "--out", str(disk)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=180)
        except subprocess.TimeoutExpired:
            return f"{name} of {size} bytes hangs", "hang"
        full = "No space left" in done.stdout + done.stderr
        if done.returncode not in (0, 2) or "Traceback" in done.stderr:
            wrong = f"{name} of {size} bytes: {done.returncode}, {done.stderr[-300:]}"
        elif any(file.read_text() != "of the user" for file in earlier) or list(disk.glob(".*")):
            wrong = f"{name} of {size} bytes: files lost or left"
        elif name == "live" and (disk / "session.h5").exists():
            at.live.read_session(disk)
        status = f"{done.returncode}{', told' if full else ''}"
    except at.InvalidInput as error:
        wrong = f"{name} of {size} bytes: {error}"
        status = "unreadable"
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)
    return wrong, status


def main() -> None:
    rows = ["ends", "udp", *DISKS]
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ends", usage=argparse.SUPPRESS)
    parser.add_argument("trials", type=int, nargs="?", default=20)
    parser.add_argument("names", nargs="*")
    asked = parser.parse_args()
    trials, names = asked.trials, asked.names or rows
    for name in names:
        if name not in rows:
            parser.error(f"there are no rows {name!r}; give some of {', '.join(rows)}.")
    random.seed(1)
    with tempfile.TemporaryDirectory() as folder:
        for on in [name for name in names if name in ("ends", "udp")]:
            print(
                f"| end on {on} | trials | not silent | over 1 s | median, longest [ms] |\n|---|---|---|---|---|"
            )
            for words, kind, refusals, signals in ENDS:
                took = np.array(
                    [to_silence(Path(folder), on, kind, refusals, signals) for _ in range(trials)]
                )
                known = 1e3 * took[np.isfinite(took)]
                times = f"{np.median(known):.0f}, {known.max():.0f}" if len(known) else ""
                lost = int(np.isinf(took).sum())
                print(
                    f"| {words} | {trials} | {lost} | {int((took > 1.0).sum())} | {times} |",
                    flush=True,
                )
        for name in DISKS:
            if name in names:
                results = [on_full_disk(Path(folder), name) for _ in range(trials)]
                wrong = [words for words, _ in results if words]
                counts = {status: [s for _, s in results].count(status) for _, status in results}
                print(
                    f"| full disk, {name} | {trials} | {len(wrong)} wrong | {counts} |",
                    *wrong,
                    sep="\n",
                    flush=True,
                )


if __name__ == "__main__":
    main()
