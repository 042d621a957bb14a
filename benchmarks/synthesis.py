"""Pressures and times of the synthesis methods: every figure of benchmarks/MEASUREMENTS.md about drives, measured anew.

Run ``python -m benchmarks.synthesis``, with ``--acoustools PYTHON`` the Python
of an environment where AcousTools is installed (it needs PyTorch), else that comparison is left
out. The transfer matrices of 300 points beside the pinch and 300 beside the open hand, 0.5 to 10 mm
off the skin, are solved once and cached in ``out/bench``. A set is a random choice of them, no two
nearer than λ/10.
"""

import argparse
import functools
import json
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import airtact as at
from airtact.drives.gerchberg_saxton import SINGLE, alternating_projections
from airtact.drives.max_min import relaxed_bound
from airtact.setup.building import read_scene

ROOT = Path(__file__).parent.parent
CACHE = ROOT / "out/bench/synthesis.npz"
POINTS = 300
SETS = 200
STARTS = 50


def beside(scene: at.Scene, random: np.random.Generator) -> np.ndarray:
    corners = np.concatenate([obstacle.surface.vertices for obstacle in scene.obstacles])
    found = np.empty((0, 3))
    while len(found) < POINTS:
        points = random.uniform(corners.min(axis=0) - 0.01, corners.max(axis=0) + 0.01, (4000, 3))
        off = -scene.depth(points)
        found = np.concatenate([found, points[(off > 0.5e-3) & (off < 10e-3)]])
    return found[:POINTS]


def transfers() -> dict[str, at.TransferMatrix]:
    """Matrices to points beside the pinch and the open hand, solved once."""
    names = ("pinch", "open_hand")
    if not CACHE.exists():
        random, arrays = np.random.default_rng(5), {}
        for name in names:
            setup = read_scene(at.example(name))
            target = at.Target(beside(setup.scene, random))
            transfer = at.transfer_matrix(
                setup.solver.radiate(setup.scene, target.beacons()), setup.array
            )
            arrays |= {f"{name}_matrix": transfer.matrix, f"{name}_points": target.points}
            arrays[f"{name}_wavelength"] = np.array(setup.scene.wavelength)
        CACHE.parent.mkdir(parents=True, exist_ok=True)
        np.savez(CACHE, **arrays)
    with np.load(CACHE) as cached:
        return {
            name: at.TransferMatrix(
                cached[f"{name}_matrix"],
                0.0,
                cached[f"{name}_points"],
                float(cached[f"{name}_wavelength"]),
            )
            for name in names
        }


def choose(
    whole: at.TransferMatrix, count: int, random: np.random.Generator, apart: float = 0.1
) -> np.ndarray:
    assert whole.foci is not None
    assert whole.wavelength is not None
    chosen: list[int] = []
    for index in random.permutation(len(whole.foci)):
        near = (
            np.linalg.norm(whole.foci[chosen] - whole.foci[index], axis=1)
            < apart * whole.wavelength
        )
        if not near.any():
            chosen.append(int(index))
        if len(chosen) == count:
            return np.array(chosen)
    raise ValueError(f"no {count} points are {apart} wavelengths apart")


def part(whole: at.TransferMatrix, rows: np.ndarray) -> tuple[at.TransferMatrix, at.Target]:
    assert whole.foci is not None
    return at.TransferMatrix(
        whole.matrix[rows], 0.0, whole.foci[rows], whole.wavelength
    ), at.Target(whole.foci[rows])


def sets(
    least: int, most: int, count: int, apart: float = 0.1
) -> Iterator[tuple[at.TransferMatrix, at.Target]]:
    """Draw sets beside the pinch and the open hand in turn, again where a focus is shadowed."""
    random, wholes = np.random.default_rng(11), list(transfers().values())
    made = 0
    while made < count:
        whole = wholes[made % len(wholes)]
        transfer, target = part(
            whole, choose(whole, int(random.integers(least, most + 1)), random, apart)
        )
        try:
            at.upper_bound(transfer, target, tolerance=1.0)
        except at.InvalidInput:
            continue
        made += 1
        yield transfer, target


def smallest(transfer: at.TransferMatrix, drive: at.Drive) -> float:
    return float(np.abs(transfer.pressure(drive)).min())


def seconds(job: Callable[[], object], runs: int = 20) -> float:
    """Best of several runs [s]."""
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        job()
        times.append(time.perf_counter() - began)
    return min(times)


def row(what: str, asked: str, measured: str) -> None:
    print(f"| {what} | {asked} | {measured} |", flush=True)


def single_focus() -> None:
    worst = 0.0
    for transfer, target in sets(1, 1, 40):
        most = float(np.abs(transfer.matrix).sum())
        reversal = at.time_reversal(transfer, target)
        energy = float(np.linalg.norm(reversal.amplitudes) * np.linalg.norm(transfer.matrix))
        worst = max(
            worst, abs(smallest(transfer, at.drives.phase_conjugate(transfer, target)) / most - 1.0)
        )
        worst = max(worst, abs(smallest(transfer, reversal) / energy - 1.0))
    row("one focus against the analytic optimum, 40 foci", "1e-6", f"{worst:.1e}")


def against_bound() -> None:
    shares, others, rounded = [], [], []
    random = np.random.default_rng(12)
    for transfer, target in sets(2, 16, SETS):
        bound, count = at.upper_bound(transfer, target), len(target.points)
        drive = at.quantise(at.max_min(transfer, target)).drive()
        exact = smallest(transfer, at.max_min(transfer, target))
        starts = np.exp(2j * np.pi * random.uniform(size=(STARTS, count)))
        alike = np.tile(np.arange(count), (STARTS, 1))
        best = alternating_projections(
            transfer.matrix, alike, np.ones((STARTS, count)), starts, 300
        )[1].max()
        shares.append(smallest(transfer, drive) / bound.worst)
        others.append(exact / best)
        rounded.append(smallest(transfer, drive) / exact)
    reached = f"median {np.median(shares):.1%}, least {min(shares):.1%}"
    row(
        f"max_min, 8 + 8 bits, worst focus over the bound, {SETS} sets of 2 to 16",
        "90 %, 85 %",
        reached,
    )
    row(
        f"the same over the best of {STARTS} starts, 300 iterations each",
        "99 %",
        f"least {min(others):.2%}",
    )
    row("what 8 + 8 bits leave of the worst focus", "-", f"least {min(rounded):.2%}")


def certificate() -> None:
    times, over, eigenvalues = [], [], []
    for transfer, target in sets(16, 16, 20):
        times.append(seconds(functools.partial(at.upper_bound, transfer, target), 3))
        bound, tight = (
            at.upper_bound(transfer, target, tolerance=tolerance) for tolerance in (1e-3, 1e-6)
        )
        over.append(bound.worst / tight.worst - 1.0)
        eigenvalues.append(bound.eigenvalue(transfer, target))
    row("bound of 16 foci, slowest of 20 sets", "0.5 s", f"{max(times):.3f} s")
    row("bound above its converged value", "1 %", f"{max(over):.2%}")
    row("largest eigenvalue of its certificates", "1", f"{max(eigenvalues):.12f}")


def another_solver() -> None:
    """Drives made with boundary elements, verified by the series of a sphere."""
    random = np.random.default_rng(3)
    scene = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(at.sphere(0.012, 1e-3))])
    directions = random.normal(size=(8, 3))
    target = at.Target(0.0135 * directions / np.linalg.norm(directions, axis=1)[:, None])
    array = at.surrounding_box()
    transfer = at.transfer_matrix(at.BoundaryElement().radiate(scene, target.beacons()), array)
    worst = 0.0
    for method in (
        at.time_reversal,
        at.drives.inverse_filter,
        at.weighted_gerchberg_saxton,
        at.max_min,
        at.drives.gradient,
    ):
        drive = method(transfer, target)
        verified = at.evaluate(scene, array, drive, target, solver=at.SphereSeries())
        worst = max(
            worst,
            float(np.max(np.abs(np.abs(transfer.pressure(drive)) / verified.magnitudes - 1.0))),
        )
    row(
        "pressure at 8 foci round a sphere, by boundary elements and by series, 5 methods",
        "3 %",
        f"{worst:.2%}",
    )


def speed() -> None:
    for name, whole in transfers().items():
        random = np.random.default_rng(1)
        transfer, target = part(whole, choose(whole, 16, random))
        bound = at.upper_bound(transfer, target)
        for method in (at.drives.gs_pat, at.weighted_gerchberg_saxton, at.max_min):
            took = seconds(functools.partial(method, transfer, target))
            share = bound.reached(transfer, target, method(transfer, target))
            measured = f"{1e3 * took:.2f} ms, {share:.1%} of the bound"
            row(f"{name}, 16 foci, one set: {method.__name__}", "1 ms", measured)
        many = np.array([choose(whole, 16, random) for _ in range(1000)])
        ones = np.ones(many.shape)
        # 50 iterations of GS-PAT cost little beside 10 of weighted Gerchberg-Saxton.
        arguments = (whole.matrix, many, ones, ones.astype(complex), 10, 50)
        took = seconds(functools.partial(alternating_projections, *arguments), 5)
        *_, phasors = alternating_projections(*arguments)
        shares = []
        for rows, phases in zip(many[:40], phasors, strict=False):
            drive = at.Drive((SINGLE * phases).astype(complex))
            transfer, target = part(whole, rows)
            bound = float(relaxed_bound(transfer.matrix, 1e-3)[0].worst)
            shares.append(smallest(transfer, drive) / bound)
        measured = f"{took:.3f} ms a set, median {np.median(shares):.1%} of the bound"
        row(f"{name}, 1000 sets of 16 at once", "0.15 ms a set", measured)


ACOUSTOOLS = """
import json, sys, time
import numpy, torch
from acoustools.Solvers import gspat, wgs
kept = numpy.load(sys.argv[1])
found = {}
for name, method in (("wgs", wgs), ("gspat", gspat)):
    found[name] = []
    for matrix in kept["matrices"]:
        A = torch.tensor(matrix[None], dtype=torch.complex64)
        times = []
        for _ in range(5):
            began = time.perf_counter()
            drive = method(torch.zeros(1, 3, A.shape[1]), iterations=int(sys.argv[2]), A=A)
            times.append(time.perf_counter() - began)
        drive = drive[0, :, 0].numpy()
        found[name].append((min(times), float(abs(matrix @ (drive / abs(drive))).min())))
print(json.dumps(found))
"""


def against_acoustools(python: str | None) -> None:
    if python is None:
        row(
            "AcousTools",
            "3 times faster, never lower",
            "left out: no --acoustools PYTHON was given",
        )
        return
    drawn = list(sets(16, 16, 40))
    shared = CACHE.with_name("acoustools.npz")
    np.savez(shared, matrices=np.array([transfer.matrix for transfer, _ in drawn]))
    for iterations in (50, 200):
        call = [python, "-W", "ignore", "-c", ACOUSTOOLS, str(shared), str(iterations)]
        answer = subprocess.run(call, capture_output=True, text=True, check=True).stdout
        theirs = {
            name: np.array(rows) for name, rows in json.loads(answer.splitlines()[-1]).items()
        }
        for name, method in (("wgs", at.weighted_gerchberg_saxton), ("gspat", at.drives.gs_pat)):
            jobs = [functools.partial(method, *one, iterations=iterations) for one in drawn]
            ours = np.array(
                [
                    (seconds(job, 5), smallest(one[0], job()))
                    for job, one in zip(jobs, drawn, strict=True)
                ]
            )
            faster, worst = (
                np.median(theirs[name][:, 0] / ours[:, 0]),
                ours[:, 1] / theirs[name][:, 1],
            )
            measured = f"{faster:.1f} times ({1e3 * np.median(ours[:, 0]):.2f} ms), {worst.min():.6f}, median "
            measured += f"{np.median(worst):.3f} of their worst focus"
            row(
                f"AcousTools' {name}, {iterations} iterations, single precision, 40 sets",
                "3 times, 1",
                measured,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--acoustools",
        metavar="PYTHON",
        help="Python of an environment with AcousTools and PyTorch",
    )
    options = parser.parse_args()
    print("| figure | asked | measured |\n|---|---|---|")
    for figure in (single_focus, against_bound, certificate, another_solver, speed):
        figure()
    against_acoustools(options.acoustools)
