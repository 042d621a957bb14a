"""Sweeps over many processors: their speed, on processes and on Dask, and what killing them leaves.

Run ``python -m benchmarks.sweep speed``, ``kills`` or ``dask``. 200 poses of the pinch
before the box of 996 elements at 3 %, for ``kills`` at 10 %: ten gaps, each at twenty places of the
box. Every process has one thread.
"""

import argparse
import os
import random
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import airtact as at
from airtact.cli.sweep import grid_of
from airtact.setup.sweeping import processes, scene_points, sweep


def varied(places: int) -> tuple[str, str]:
    return "pinch.gap=0.008:0.016:10", f"array.pose.translation[0]=-0.002:0.002:{places}"


def scene(folder: Path, accuracy: float = 0.03) -> Path:
    """Write the example at another accuracy into a folder."""
    file = folder / "pinch.toml"
    file.write_text(
        at.example("pinch").read_text("utf-8").replace("accuracy = 0.01", f"accuracy = {accuracy}"),
        "utf-8",
    )
    return file


@contextmanager
def executor_of(count: int, dask: bool) -> Iterator[Executor]:
    """Start processes, or a Dask cluster of as many."""
    if not dask:
        with processes(count) as pool:
            yield pool
        return
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        yield client.get_executor()


def compared(batches: int, places: int, one: tuple[int, bool], other: tuple[int, bool]) -> None:
    """Compute batches of points by one and the other in turn, both started and warm, so that both get the same load."""
    kinds = (one, other)
    with TemporaryDirectory() as name, ExitStack() as stack:
        function = scene_points(scene(Path(name)))
        pools = [stack.enter_context(executor_of(number, dask)) for number, dask in kinds]
        points = grid_of(varied(places))
        for pool in pools:
            sweep(function, points[:4], pool)
        runs: list[list[float]] = [[], []]
        for batch in range(batches):
            part = points[batch * len(points) // batches : (batch + 1) * len(points) // batches]
            for index, pool in enumerate(pools):
                begun = time.perf_counter()
                rows = sweep(function, part, pool)
                assert not any(row["error"] for row in rows), rows[0]
                runs[index].append((time.perf_counter() - begun) / len(part))
    for (number, dask), found in zip(kinds, runs, strict=True):
        middle, all_of_it = statistics.median(found), ", ".join(f"{1e3 * one:.0f}" for one in found)
        print(
            f"{'Dask' if dask else 'processes'} of {number}: {1e3 * middle:.1f} ms a point ({all_of_it})"
        )
    ratios = [first / second for first, second in zip(*runs, strict=True)]
    print(
        f"the first over the second: {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
    )


def kills(count: int, seed: int) -> None:
    """Kill one sweep at random moments, take it up again each time, and compare its table with one that ran through."""
    chance = random.Random(seed)
    with TemporaryDirectory() as name:
        folder = Path(name)
        command = [
            sys.executable,
            "-m",
            "airtact",
            "sweep",
            str(scene(folder, 0.1)),
            "--no-pictures",
            "--quiet",
        ]
        command += [word for axis in varied(20) for word in ("--vary", axis)]
        begun = time.perf_counter()
        subprocess.run([*command, "--out", str(folder / "whole")], check=True)
        took = time.perf_counter() - begun
        kept = []
        for _ in range(count):
            run = subprocess.Popen(
                [*command, "--out", str(folder / "killed")], start_new_session=True
            )
            time.sleep(chance.uniform(0.0, 2.0 * took / count + 4.0))
            os.kill(run.pid, signal.SIGKILL)
            run.wait()
            kept.append(len(list((folder / "killed" / "points").glob("*.json"))))
        subprocess.run([*command, "--out", str(folder / "killed")], check=True)
        same = (folder / "killed/sweep.csv").read_bytes() == (
            folder / "whole/sweep.csv"
        ).read_bytes()
        rows = (folder / "killed/sweep.csv").read_text("utf-8").count("\n") - 1
    print(f"killed {count} times, with so many points kept: {kept}")
    print(f"then finished: {rows} rows, the same bytes as without a kill: {same}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=["speed", "kills", "dask"])
    parser.add_argument("--batches", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--places", type=int, default=20)
    given = parser.parse_args()
    if given.part == "kills":
        kills(20, given.seed)
    elif given.part == "speed":
        compared(given.batches, given.places, (1, False), (2, False))
    else:
        compared(given.batches, given.places, (2, False), (2, True))
