"""Sweeps over many processors: their speed, on processes and on Dask, and what killing them leaves.

Run ``PYTHONPATH=. python benchmarks/sweep.py speed``, ``kills`` or ``dask``. 200 poses of the pinch before the box of
996 elements at 3 %, for ``kills`` at 10 %: ten gaps, each at twenty places of the box. Every process has one thread.
"""

import argparse
import os
import random
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import airtact as at
from airtact.workflows.sweep.sweep import sweep

VARIED = ("pinch.gap=0.008:0.016:10", "array.pose.translation[0]=-0.002:0.002:20")


def scene(folder: Path, accuracy: float = 0.03) -> Path:
    """Write the example at another accuracy into a folder."""
    file = folder / "pinch.toml"
    file.write_text(
        at.example("pinch").read_text("utf-8").replace("accuracy = 0.01", f"accuracy = {accuracy}"), "utf-8"
    )
    return file


def seconds(folder: Path, number: int, dask: str | None = None) -> tuple[float, float]:
    """Return the time of a sweep from its first result to its last, per point, and of all of it [s].

    What comes before the first result is the start of the processes, which does not grow with the points.
    """
    moments: list[float] = []
    begun = time.perf_counter()
    out = folder / f"{number}-{dask}-{begun}"
    sweep(
        folder / "pinch.toml",
        VARIED,
        out,
        lambda *numbers: moments.append(time.perf_counter()),
        number=number,
        dask=dask,
        pictures=False,
    )
    whole = time.perf_counter() - begun
    assert len(moments) == 201
    return (moments[-1] - moments[1 + number]) / (200 - number - 1), whole


def compared(repeats: int, one: tuple[int, str | None], other: tuple[int, str | None]) -> None:
    with TemporaryDirectory() as name:
        folder = Path(name)
        scene(folder)
        runs = [[seconds(folder, *kind) for kind in (one, other)] for _ in range(repeats)]
    for index, kind in enumerate((one, other)):
        points, wholes = zip(*(run[index] for run in runs), strict=True)
        print(f"{kind[1] or 'processes'} of {kind[0]}: {1e3 * statistics.median(points):.1f} ms a point, ", end="")
        print(f"all of it {statistics.median(wholes):.1f} s ({', '.join(f'{whole:.1f}' for whole in wholes)})")
    ratios = [[run[0][part] / run[1][part] for run in runs] for part in (0, 1)]
    print(f"the first over the second, a point: {statistics.median(ratios[0]):.2f}", end="")
    print(f", all of it: {statistics.median(ratios[1]):.2f}")


def kills(count: int, seed: int) -> None:
    """Kill one sweep at random moments, take it up again each time, and compare its table with one that ran through."""
    chance = random.Random(seed)
    with TemporaryDirectory() as name:
        folder = Path(name)
        command = [sys.executable, "-m", "airtact", "sweep", str(scene(folder, 0.1)), "--no-pictures", "--quiet"]
        command += [word for varied in VARIED for word in ("--vary", varied)]
        begun = time.perf_counter()
        subprocess.run([*command, "--out", str(folder / "whole")], check=True)
        took = time.perf_counter() - begun
        kept = []
        for _ in range(count):
            run = subprocess.Popen([*command, "--out", str(folder / "killed")], start_new_session=True)
            time.sleep(chance.uniform(0.0, 2.0 * took / count + 4.0))
            os.kill(run.pid, signal.SIGKILL)
            run.wait()
            kept.append(len(list((folder / "killed" / "points").glob("*.json"))))
        subprocess.run([*command, "--out", str(folder / "killed")], check=True)
        same = (folder / "killed/sweep.csv").read_bytes() == (folder / "whole/sweep.csv").read_bytes()
        rows = (folder / "killed/sweep.csv").read_text("utf-8").count("\n") - 1
    print(f"killed {count} times, with so many points kept: {kept}")
    print(f"then finished: {rows} rows, the same bytes as without a kill: {same}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=["speed", "kills", "dask"])
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    if given.part == "kills":
        kills(20, given.seed)
    elif given.part == "speed":
        compared(given.repeats, (1, None), (2, None))
    else:
        compared(given.repeats, (2, None), (2, "local"))
