"""Time and memory of the jobs: every speed figure of docs/performance.md, measured anew.

Run ``make bench``, or ``PYTHONPATH=.:tests python benchmarks/speed.py [row ...]`` with the first words of the rows
wanted. Times are medians with the least and the most, errors are against fundamental solutions or, for a hand, against
a more accurate solution; these references take some minutes the first time and are cached in ``out/bench/references``.
"""

import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from airtact import _kernels
from airtact.benching.bench import row_jobs
from airtact.benching.real_time import Row
from airtact.benching.scenes import two_fingers
from airtact.benching.timing import correlation, timed
from airtact.live.drives.bending import BendingHand
from airtact.live.drives.factors import HandFactors, OpenAir, PartSolver, beacon_points, factors_of, part_of, solved
from airtact.live.drives.riding import ride
from airtact.scene.scene import Scene, sound_hard
from airtact.scene.sources import Monopoles
from airtact.scene.target import Target
from airtact.solvers.bem.solver import BoundaryElement
from airtact.synthesis.time_reversal import time_reversal
from airtact.transducers.element import monopole
from airtact.transducers.layout import surrounding_box
from airtact.transfer import TransferMatrix
from benchmarks import live

ROOT = Path(__file__).parent.parent
EXAMPLES = ROOT / "src/airtact/examples"
CACHE = ROOT / "out/bench/references"


def pinch_seconds() -> tuple[float, float]:
    """Solve the paper's pinch and make its drive: best of five [s], and the peak memory [GB]."""
    import airtact as at

    best = float("inf")
    for _ in range(5):
        fingers = at.pinch()
        scene = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(surface) for surface in fingers.surfaces])
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
    runs = [subprocess.run([sys.executable, "-c", code], check=True, capture_output=True) for _ in range(5)]
    return min(float(run.stdout) for run in runs)


def quickest_import() -> list[Row]:
    return [Row("`import airtact`", "1.2 s", f"{import_seconds():.2f} s, the best of 5", "")]


def pinch() -> list[Row]:
    seconds, memory = pinch_seconds()
    measured = f"{seconds:.2f} s, {memory:.2f} GB, the best of 5"
    return [Row("the example `pinch`: solve and drive", "0.5 s, 1 GB", measured, "")]


def phalanges(runs: int = 20) -> list[Row]:
    """Solve the last phalanges of thumb and forefinger in new poses, as the live loop does, to the drive."""
    solver = PartSolver(live.pinch().scene)
    what = "two last phalanges in a new pose, to the drive, as the live loop solves them"
    return _phalanges(what, "factorised once", lambda joints: solver.solved(joints, "phalanges", 0.0), runs)


def meshed_anew(runs: int = 20) -> list[Row]:
    """Solve the same phalanges where they touch, as one body that is meshed in each pose."""
    scene, what = live.pinch().scene, "two last phalanges in a new pose, to the drive, as one body"
    return _phalanges(what, "meshed anew", lambda joints: solved(scene, joints, "phalanges", 0.0), runs)


def _phalanges(what: str, how: str, solve: Callable[[np.ndarray], HandFactors], runs: int) -> list[Row]:
    setting = live.pinch()
    air, poses = OpenAir(setting.scene), [setting.motion(0.3 + 0.05 * frame) for frame in range(runs + 1)]

    def to_drive(joints: np.ndarray) -> np.ndarray:
        found = solve(joints)
        matrix = air.rows(found.foci) * found.factors
        time_reversal(TransferMatrix(matrix, 0.0), Target(found.foci))
        return matrix

    took, matrices = timed([partial(to_drive, joints) for joints in poses])
    judged = list(zip(poses[1:], matrices, strict=True))[::7]
    alike = min(one for joints, matrix in judged for one in likeness(joints, matrix))
    return [Row(what, "8 ms, correlation 0.995", f"{took}", f"rows {alike:.4f} (against 1 %)", how)]


def likeness(joints: np.ndarray, matrix: np.ndarray) -> list[float]:
    """Correlation of each row of a transfer matrix with that of the same phalanges at 1 %, in the same open air."""
    scene = live.pinch().scene
    riding = ride(scene, joints)
    body = Scene(scene.medium, [sound_hard(part_of(riding.hand, "phalanges", scene.places))], frequency=scene.frequency)
    field = BoundaryElement(accuracy=0.01, estimate=False).radiate(body, Target(beacon_points(scene, riding)).beacons())
    fine = factors_of(scene, riding, "phalanges", 0.0, field.at(scene.array.positions)).factors
    exact = OpenAir(scene).rows(riding.foci) * fine
    return [correlation(one, other) for one, other in zip(matrix, exact, strict=True)]


def carried(runs: int = 8) -> list[Row]:
    """Carry the sound of a solved hand to other poses, as the live loop does: the least processor time."""
    setting, seconds = live.open_hand(), []
    solver = BendingHand(setting.scene)
    solver.keep(solver.solved(setting.motion(0.3), 0.0))
    for frame in range(runs):
        joints, began = setting.motion(0.32 + 0.02 * frame), time.process_time()
        solver.carried(joints, 0.0)
        seconds.append(time.process_time() - began)
    return [Row("sound of a whole hand carried to a new pose", "-", f"{1e3 * min(seconds):.1f} ms of processor", "")]


def codes(runs: int = 7) -> list[Row]:
    """Solve two fingers for 16 coded transmissions of the array, and for two foci at the same accuracy."""
    array, bodies, seconds = surrounding_box(monopole()), two_fingers(), []
    random = np.random.default_rng(1)
    phases = np.exp(2j * np.pi * random.random((len(array), 16)))
    for sources in (bodies.target.beacons(), Monopoles(array.positions, phases)):
        solver = BoundaryElement(accuracy=0.03, estimate=False)
        solve = partial(solver.radiate, bodies.scene, sources)
        seconds.append(timed([solve] * (runs + 1))[0])
    ratio = f"{seconds[1].median / seconds[0].median:.2f} times two foci"
    return [
        Row("two fingers, 16 codes", "2.5 times two foci", ratio, "", f"two foci {seconds[0]}, 16 codes {seconds[1]}")
    ]


def rendered(name: str, asked: str) -> list[Row]:
    seconds, memory = render_seconds(name)
    return [Row(f"`airtact render {name}`", asked, f"{seconds:.0f} s, {memory:.2f} GB", "")]


def rows(runs: int = 7) -> dict[str, Callable[[], list[Row]]]:
    """Every row by the word that chooses it."""
    return {
        "import": quickest_import,
        **row_jobs(CACHE, EXAMPLES / "hands/relaxed.json", runs),
        "phalanges": phalanges,
        "anew": meshed_anew,
        "carried": carried,
        "codes": codes,
        "pinch": pinch,
        "render-pinch": partial(rendered, "pinch.toml", "-"),
        "render-hand": partial(rendered, "open_hand.toml", "60 s, 6 GB"),
    }


if __name__ == "__main__":
    load, cores = os.getloadavg()[0], len(os.sched_getaffinity(0))
    print(f"{cores} cores, {_kernels.active_variant()}, load before {load:.1f}: medians of 7 (least to most)\n")
    print("| figure | asked | measured | error | where the time went |\n|---|---|---|---|---|")
    for name, measure in rows().items():
        for row in measure() if name in sys.argv[1:] or not sys.argv[1:] else []:
            print(f"| {row.what} | {row.asked} | {row.measured} | {row.error} | {row.profile} |", flush=True)
