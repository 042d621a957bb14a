"""Sweeps over many processors: their speed, on processes and on Dask, and what killing them leaves.

Run ``PYTHONPATH=. python benchmarks/sweep.py speed``, ``kills`` or ``dask``. 200 poses of the pinch before the box of
996 elements at 3 %, for ``kills`` at 10 %: ten gaps, each at twenty places of the box. Every process has one thread.
"""

import argparse
import os
import random
import resource
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import airtact as at
from airtact.workflows.sweep.sweep import sweep


def varied(places: int) -> tuple[str, str]:
    return "pinch.gap=0.008:0.016:10", f"array.pose.translation[0]=-0.002:0.002:{places}"


def scene(folder: Path, accuracy: float = 0.03) -> Path:
    """Write the example at another accuracy into a folder."""
    file = folder / "pinch.toml"
    file.write_text(
        at.example("pinch").read_text("utf-8").replace("accuracy = 0.01", f"accuracy = {accuracy}"), "utf-8"
    )
    return file


def seconds(folder: Path, places: int, number: int, dask: str | None = None) -> tuple[float, float, float]:
    """Return the time a point from the first results to the last, that of the whole sweep, and the processors' [s].

    The last is per point, of all processes together, their start included: with free processors n processes do n points
    in that time, whatever else the machine has to do while it is measured.
    """
    moments: list[float] = []
    begun, spent = time.perf_counter(), processor_time()
    out = folder / f"{number}-{dask}-{begun}"
    settings = {"number": number, "dask": dask, "pictures": False}
    file = folder / "pinch.toml"
    sweep(file, varied(places), out, lambda *numbers: moments.append(time.perf_counter()), **settings)
    whole, count = time.perf_counter() - begun, 10 * places
    assert len(moments) == count + 1
    a_point = (moments[-1] - moments[1 + number]) / (count - number - 1)
    return a_point, whole, (processor_time() - spent) / count


def processor_time() -> float:
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def compared(repeats: int, places: int, one: tuple[int, str | None], other: tuple[int, str | None]) -> None:
    with TemporaryDirectory() as name:
        folder = Path(name)
        scene(folder)
        runs = [[seconds(folder, places, *kind) for kind in (one, other)] for _ in range(repeats)]
    for index, kind in enumerate((one, other)):
        points, wholes, spent = zip(*(run[index] for run in runs), strict=True)
        print(f"{kind[1] or 'processes'} of {kind[0]}: {1e3 * statistics.median(points):.1f} ms a point, ", end="")
        print(f"{1e3 * statistics.median(spent):.1f} ms of processors, all of it {statistics.median(wholes):.1f} s")
    words = ("a point", "all of it", "processors")
    ratios = [statistics.median(run[0][part] / run[1][part] for run in runs) for part in range(3)]
    print("the first over the second:", ", ".join(f"{w} {r:.2f}" for w, r in zip(words, ratios, strict=True)))


def kills(count: int, seed: int) -> None:
    """Kill one sweep at random moments, take it up again each time, and compare its table with one that ran through."""
    chance = random.Random(seed)
    with TemporaryDirectory() as name:
        folder = Path(name)
        command = [sys.executable, "-m", "airtact", "sweep", str(scene(folder, 0.1)), "--no-pictures", "--quiet"]
        command += [word for axis in varied(20) for word in ("--vary", axis)]
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
    parser.add_argument("--places", type=int, default=20)
    given = parser.parse_args()
    if given.part == "kills":
        kills(20, given.seed)
    elif given.part == "speed":
        compared(given.repeats, given.places, (1, None), (2, None))
    else:
        compared(given.repeats, given.places, (2, None), (2, "local"))
