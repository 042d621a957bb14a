"""Time and memory of the jobs: every speed figure of benchmarks/MEASUREMENTS.md, measured anew.

Run ``make bench``, or ``python -m benchmarks.speed [row ...]`` with the first
words of the rows wanted. Times are medians with the least and the most, errors are against
fundamental solutions or, for a hand, against a more accurate solution; these references take some
minutes the first time and are cached in ``out/bench/references``.
"""

import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from airtact import _kernels
from airtact.live.drives.bending import BendingHand
from benchmarks import live
from benchmarks.bench import row_jobs
from benchmarks.moving_hand import Row

ROOT = Path(__file__).parent.parent
EXAMPLES = ROOT / "src/airtact/setup/examples"
CACHE = ROOT / "out/bench/references"


def pinch_seconds() -> tuple[float, float]:
    """Solve the paper's pinch and make its drive: best of five [s], and the peak memory [GB]."""
    import airtact as at

    best = float("inf")
    for _ in range(5):
        fingers = at.pinch()
        scene = at.Scene(
            at.Medium(343.1, 1.293), [at.sound_hard(surface) for surface in fingers.surfaces]
        )
        target = at.Target(fingers.foci())
        array = at.surrounding_box()
        began = time.perf_counter()
        beacons = at.BoundaryElement().radiate(scene, target.beacons())
        at.quantise(at.time_reversal(at.transfer_matrix(beacons, array), target))
        best = min(best, time.perf_counter() - began)
    return best, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def render_seconds(name: str) -> tuple[float, float]:
    """Render an example with all its files and pictures [s], and the peak memory [GB]."""
    command = [
        str(Path(sys.executable).parent / "airtact"),
        "render",
        str(EXAMPLES / name),
        "--out",
        f"out/bench/{name}",
    ]
    began = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6


def import_seconds() -> float:
    """Import airtact in a fresh interpreter, best of five [s]."""
    code = "import time; t = time.perf_counter(); import airtact; print(time.perf_counter() - t)"
    runs = [
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
        for _ in range(5)
    ]
    return min(float(run.stdout) for run in runs)


def quickest_import() -> list[Row]:
    return [Row("`import airtact`", "1.2 s", f"{import_seconds():.2f} s, the best of 5", "")]


def pinch() -> list[Row]:
    seconds, memory = pinch_seconds()
    measured = f"{seconds:.2f} s, {memory:.2f} GB, the best of 5"
    return [Row("the example `pinch`: solve and drive", "0.5 s, 1 GB", measured, "")]


def carried(runs: int = 8) -> list[Row]:
    """Carry the sound of a solved hand to other poses, as the live loop does: the least processor time."""
    setting, seconds = live.open_hand(), []
    solver = BendingHand(setting.scene)
    solver.keep(solver.solved(setting.motion(0.3), 0.0))
    for frame in range(runs):
        joints, began = setting.motion(0.32 + 0.02 * frame), time.process_time()
        solver.carried(joints, 0.0)
        seconds.append(time.process_time() - began)
    return [
        Row(
            "sound of a whole hand carried to a new pose",
            "-",
            f"{1e3 * min(seconds):.1f} ms of processor",
            "",
        )
    ]


def rendered(name: str, asked: str) -> list[Row]:
    seconds, memory = render_seconds(name)
    return [Row(f"`airtact render {name}`", asked, f"{seconds:.0f} s, {memory:.2f} GB", "")]


def rows(runs: int = 7) -> dict[str, Callable[[], list[Row]]]:
    """Every row by the word that chooses it."""
    return {
        "import": quickest_import,
        **row_jobs(CACHE, EXAMPLES / "hands/relaxed.json", runs),
        "carried": carried,
        "pinch": pinch,
        "render-pinch": partial(rendered, "pinch.toml", "-"),
        "render-hand": partial(rendered, "open_hand.toml", "60 s, 6 GB"),
    }


if __name__ == "__main__":
    load, cores = os.getloadavg()[0], len(os.sched_getaffinity(0))
    print(
        f"{cores} cores, {_kernels.active_variant()}, load before {load:.1f}: medians of 7 (least to most)\n"
    )
    print("| figure | asked | measured | error | where the time went |\n|---|---|---|---|---|")
    for name, measure in rows().items():
        for row in measure() if name in sys.argv[1:] or not sys.argv[1:] else []:
            print(
                f"| {row.what} | {row.asked} | {row.measured} | {row.error} | {row.profile} |",
                flush=True,
            )
