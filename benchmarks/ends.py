"""Ways to lose a link, its feeder or the room on a disk: how often something is loud, crashes, hangs or is lost.

Run as ``python -m benchmarks.ends [TRIALS] [ends|render|live|sweep|sense ...]``. The rows of full disks need root, to mount a small disk.
"""

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

TRIALS = 20


class TracedLink(RecordingLink):
    """Appends the time and loudness of each frame to a file; may hang once, or refuse silence some times."""

    def __init__(self, trace: Path, hangs: bool = False, refusals: int = 0) -> None:
        super().__init__()
        self.trace = trace
        self.hangs = hangs
        self.refusals = refusals

    def _transmit(self, frame: at.drives.Frame) -> None:
        if self.hangs and self.last is not None and not frame.silent:
            time.sleep(1e6)
        if frame.silent and self.last is not None and self.refusals:
            self.refusals -= 1
            raise OSError(5, "refused")
        with self.trace.open("a") as file:
            file.write(f"{time.monotonic():.6f} {int(frame.amplitude.max())}\n")
        super()._transmit(frame)


FEEDER = """
import sys, numpy as np, airtact as at
from benchmarks.ends import TracedLink
from pathlib import Path
link = TracedLink(Path(sys.argv[1]), sys.argv[2] == "hangs", int(sys.argv[3]))
drive = at.Drive(np.exp(2j * np.pi * np.arange(249) / 7))
with at.Emission(link, cap=1.0, ramp=0.0) as emission:
    emission.send(drive)
    print(emission.process, flush=True)
    if sys.argv[2] == "hangs":
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


def to_silence(folder: Path, kind: str, refusals: int, signals: list) -> float:
    """End an emission; return the time from the first signal, or the hang, until silence [s]."""
    trace = folder / f"{time.monotonic_ns()}.txt"
    command = [sys.executable, "-c", FEEDER, str(trace), kind, str(refusals)]
    nothing = subprocess.DEVNULL
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=nothing, text=True) as feeder:
        assert feeder.stdout is not None
        link = int(feeder.stdout.readline())
        begun = time.monotonic()
        for whom, name, pause in signals:
            time.sleep(random.uniform(0.0, 2.0) if pause is None else pause)
            with suppress(ProcessLookupError):  # it has ended already
                os.kill(link if whom == "link" else feeder.pid, getattr(signal, name))
        silent = np.inf
        while silent == np.inf and time.monotonic() < begun + 10.0:
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
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else TRIALS
    names = sys.argv[2:] or ["ends", *DISKS]
    random.seed(1)
    with tempfile.TemporaryDirectory() as folder:
        if "ends" in names:
            print(
                "| end | trials | not silent | over 1 s | median, longest [ms] |\n|---|---|---|---|---|"
            )
            for words, kind, refusals, signals in ENDS:
                took = np.array(
                    [to_silence(Path(folder), kind, refusals, signals) for _ in range(trials)]
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
