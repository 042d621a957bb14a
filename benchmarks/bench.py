"""The whole bench: airtact beside other packages, the rows of real time, the growth of the cost."""

import argparse
import csv
import json
import os
import platform
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from airtact import _kernels
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.block_matrix import BlockMatrix, blocks_of
from airtact.acoustics.solvers.bem.layer_potentials import NearRule
from airtact.acoustics.solvers.bem.quadrature import place_nodes
from airtact.acoustics.solvers.bem.solutions import DualSurface, dual_surface
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.shared import processor_count
from airtact.acoustics.target import Target
from airtact.drives.linear_methods import time_reversal
from airtact.drives.transfer import transfer_matrix
from airtact.errors import InvalidInput
from airtact.files.atomic import whole_file, writable_folder
from airtact.geometry.panels import panels_of
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.hands.body import Hulls
from airtact.hands.files import load_hand
from airtact.hands.shape import HandShape
from airtact.hands.skin_mesh import midpoints
from airtact.setup.examples import example
from airtact.timing import Progress, no_progress
from airtact.transducers.element import monopole
from airtact.transducers.layout import flat_boards, surrounding_box
from benchmarks.common import Bodies, Timed, reference_pressure, timed, two_fingers
from benchmarks.moving_hand import OpenHand, Phalanges, RealTime, Row
from benchmarks.others import ACCURACIES, EDGES, Solved, case_of, faster, ours, run_case, theirs

FILES = (
    "bench.csv",
    "bench.json",
    "performance.md",
    "error_against_time.png",
    "error_against_time.svg",
    "growth.png",
)
"""Files of a bench, with ``growth.svg``; references are cached in ``references`` beside them."""

OFF = 2e-3
"""Distance of the foci off the pads in the contest [m]: nearer, packages that collocate at centroids fail."""

QUICK_EDGES, QUICK_ACCURACIES = (2.7e-3,), (0.1, 0.03)


@dataclass(frozen=True)
class Grown:
    """Times of one size: of a solve by its unknowns, or of transfer matrix and drive by the elements."""

    size: int
    timed: Timed


@dataclass(frozen=True)
class Bench:
    """All that was measured: the machine, runs of all packages on one scene, rows of real time, growth of the cost.

    ``own_error`` is that of the reference of the runs; ``notes`` give what was left out, and why.
    """

    machine: str
    contest: Sequence[Solved]
    own_error: float
    rows: Sequence[Row]
    unknowns: Sequence[Grown]
    elements: Sequence[Grown]
    notes: Sequence[str]


def bench(
    folder: Path,
    acoustools: str | None = None,
    bempp: str | None = None,
    hand: Path | None = None,
    quick: bool = False,
    report_step: Progress = no_progress,
) -> Bench:
    """Measure everything and write ``FILES`` into a folder, from which references computed before are read.

    The interpreters of environments with AcousTools and bempp-cl, and the pose of an open hand
    (.json), are left out with a note if not given; so is a package that fails. ``InvalidInput`` is
    raised where the folder takes no files, an interpreter cannot be run, or the hand's file is at
    fault.
    """
    others = {"AcousTools": acoustools, "bempp-cl": bempp}
    for package, python in others.items():
        if python is not None and shutil.which(python) is None:
            raise InvalidInput(
                f"{python} is not a program that can be run, so {package} cannot: give the Python of its environment.",
                code="not_supported",
            )
    if hand is not None:
        load_hand(hand)  # a fault shows before minutes of solving
    writable_folder(folder)
    references = folder / "references"
    notes: list[str] = []
    machine, runs = _machine(), 3 if quick else 7
    bodies, elements = contested(), surrounding_box(monopole()).positions
    report_step("the reference of the contest, by fundamental solutions")
    reference = reference_pressure(bodies, elements, bodies.foci, references)
    contest = _contest(bodies, elements, reference.pressure, others, quick, notes, report_step)
    rows = _rows(references, hand, quick, notes, report_step)
    unknowns = by_unknowns(runs, 2000 if quick else 16000, report_step)
    report_step("larger arrays")
    larger = by_elements(runs, BOARDS[:2] if quick else BOARDS)
    found = Bench(machine, contest, reference.own_error, rows, unknowns, larger, notes)
    report_step("writing")
    write(folder, found)
    return found


def contested() -> Bodies:
    """Two fingers of 16 mm x 60 mm, 12 mm apart, a focus 2 mm off each pad."""
    bodies = two_fingers()
    foci = bodies.foci.copy()
    foci[:, 0] = np.sign(foci[:, 0]) * (6e-3 - OFF)
    return replace(bodies, foci=foci)


def write(folder: Path, found: Bench) -> None:
    """Write tables and figures."""
    with (
        whole_file(folder / FILES[0]) as partial,
        partial.open("w", newline="", encoding="utf-8") as stream,
    ):
        writer = csv.writer(stream)
        writer.writerow(
            ["what", "setting", "unknowns", "median_s", "least_s", "most_s", "error", "peak_byte"]
        )
        for one in found.contest:
            times = [
                f"{value:.6g}"
                for value in (one.timed.median, min(one.timed.seconds), max(one.timed.seconds))
            ]
            writer.writerow(
                [one.package, one.setting, one.unknowns, *times, f"{one.error:.6g}", one.peak]
            )
        for row in found.rows:
            seconds = row.numbers.get("seconds", ())
            times = [f"{f(seconds):.6g}" if seconds else "" for f in (np.median, np.min, np.max)]  # pyright: ignore
            numbers = [row.numbers.get(name, "") for name in ("unknowns", "error")]
            writer.writerow([row.what, row.asked, numbers[0], *times, numbers[1], ""])
    with whole_file(folder / FILES[1]) as partial:
        partial.write_text(json.dumps(asdict(found), indent=1), encoding="utf-8")
    with whole_file(folder / FILES[2]) as partial:
        partial.write_text(page_of(found), encoding="utf-8")
    draw_contest(folder, found.contest, found.own_error)
    draw_growth(folder, found.unknowns, found.elements)


def _contest(
    bodies: Bodies,
    elements: np.ndarray,
    matrix: np.ndarray,
    others: dict[str, str | None],
    quick: bool,
    notes: list[str],
    report_step: Progress,
) -> list[Solved]:
    runs, accuracies = (7, QUICK_ACCURACIES) if quick else (9, ACCURACIES)
    contest = ours(bodies, elements, matrix, runs, accuracies, report_step)
    for package, python in others.items():
        if python is None:
            option = package.lower().removesuffix("-cl")
            notes.append(f"{package} is left out: no --{option} PYTHON was given.")
            continue
        try:
            edges = QUICK_EDGES if quick else EDGES[package]
            contest += theirs(
                package, python, bodies, elements, matrix, 1 if quick else 3, edges, report_step
            )
        except InvalidInput as fault:
            notes.append(f"{package} is left out: {fault}")
    return contest


def row_jobs(references: Path, hand: Path | None, runs: int) -> dict[str, Callable[[], list[Row]]]:
    """Return the job of every row by its name; those of the hand only where its pose (.json) is given."""
    fingers = RealTime(references, runs)
    last = Phalanges(runs)
    single = fingers.jobs() | {"phalanges": last.rigid, "anew": last.meshed_anew}
    if hand is not None:
        open_hand = OpenHand(load_hand(hand), references, runs)
        single |= {"hand-drive": open_hand.drive_only, "hand": open_hand.pressures}
    single["memory"] = memory_over_matrix
    jobs: dict[str, Callable[[], list[Row]]] = {
        name: lambda job=job: [job()] for name, job in single.items()
    }
    return jobs | {
        "accuracies": fingers.at_accuracies,
        "kernels": partial(kernels_against_product, runs),
    }


def _rows(
    references: Path, hand: Path | None, quick: bool, notes: list[str], report_step: Progress
) -> list[Row]:
    if hand is None:
        notes.append("The open hand is left out: no --hand POSE.json was given.")
    rows: list[Row] = []
    for name, job in row_jobs(references, hand, 3 if quick else 9).items():
        if not (quick and name == "memory"):
            report_step(f"rows of real time: {name}")
            try:
                rows += job()
            except (
                InvalidInput
            ) as fault:  # an extra that is not installed; what was measured is kept
                notes.append(f"The rows of {name!r} are left out: {fault}")
    return rows


def _machine() -> str:
    cores = processor_count()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0  # Windows counts none
    busy = (
        f"; others kept it busy (load {load:.1f}): times are too long" if load > 0.5 * cores else ""
    )
    return f"{platform.machine()}, {cores} cores, {_kernels.active_variant()}{busy}"


UNKNOWNS = (1000, 2000, 4000, 8000, 16000)
BOARDS = (1, 2, 4, 8)
"""Boards along each side of the array: 249, 996, 3984 and 15936 elements."""

AFAR = np.array([[0.0, 0.0, 0.03], [5e-3, 0.0, 0.035]])
"""Foci so far above the fingertips that the panels need no refinement there [m]."""


def by_unknowns(runs: int, most: int, report_step: Progress = no_progress) -> list[Grown]:
    """Time solves of two fingers with increasing unknowns, a third of the runs from 8000 unknowns on."""
    scene, beacons, found = evenly_covered(two_fingers()).scene, Target(AFAR).beacons(), []
    for wanted in (one for one in UNKNOWNS if one <= most):
        report_step(f"solving {wanted} unknowns")
        solver = BoundaryElement(accuracy=_accuracy_for(wanted, scene))
        count = runs if wanted < 8000 else max(1, runs // 3)
        took, fields = timed([partial(solver.radiate, scene, beacons)] * (count + 1))
        found.append(Grown(fields[0].report.nodes, took))
    return found


def by_elements(runs: int, boards: tuple[int, ...] = BOARDS) -> list[Grown]:
    """Time transfer matrix and drive of a solved shape for increasing arrays, ``boards`` along each side."""
    bodies = two_fingers()
    beacons = BoundaryElement(accuracy=0.03).radiate(bodies.scene, bodies.target.beacons())
    found = []
    for side in boards:
        array = flat_boards(side, side, monopole()).seen_from(
            Pose(np.eye(3), np.array([0.0, 0.0, 0.2]))
        )
        jobs = [
            lambda array=array: time_reversal(transfer_matrix(beacons, array), bodies.target)
        ] * (runs + 1)
        found.append(Grown(len(array), timed(jobs)[0]))
    return found


def power(grown: list[Grown]) -> float:
    """Exponent of the time as a power of the size, over the upper half of the sizes."""
    upper = grown[len(grown) // 2 - 1 :]
    sizes, seconds = [one.size for one in upper], [one.timed.median for one in upper]
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def evenly_covered(bodies: Bodies) -> Bodies:
    """Replace capsules by sphere meshes, which take panels of any size: those of capsules come in few sizes."""
    surfaces = []
    for one in bodies.capsules:
        balls = np.array([[*end, one.radius] for end in one.axis])
        shape = HandShape(
            Hulls(balls, np.array([[0, 1, -1]]), np.zeros((1, 1)), np.zeros((1, 1))),
            Pose.identity(),
        )
        skin = shape.skin(3e-3)
        surfaces.append(
            Surface(skin.vertices, skin.triangles, midpoints(shape.hulls, skin), primitive=shape)
        )
    return Bodies(tuple(surfaces), bodies.foci)


def _accuracy_for(unknowns: int, scene: Scene) -> float:
    """Choose the accuracy that gives bodies about so many unknowns."""
    beacons, low, high = Target(AFAR).beacons(), 2e-4, 0.3
    for _ in range(10):
        middle = float(np.sqrt(low * high))
        if BoundaryElement(accuracy=middle).unknowns(scene, beacons) > unknowns:
            low = middle
        else:
            high = middle
    return high


FLOPS = 56
"""Operations of one kernel evaluation, the gradient of a Green's function along a normal."""

PRODUCT = 2048
"""Side of the matrices whose product is timed."""


def kernels_against_product(runs: int = 7) -> list[Row]:
    """Evaluate the far field of a matrix by every compiled variant, a single-precision matrix product beside each."""
    bodies = two_fingers()
    scene = bodies.scene
    panels = panels_of(**BoundaryElement(accuracy=0.02)._covering(scene, bodies.foci))
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    surface = dual_surface(nodes, scene.wavenumber, NearRule(1.6, (4, 4)), "float32")
    before, rows = _kernels.active_variant(), []
    try:
        for variant in _kernels.variants():
            _kernels.use_variant(variant)
            rows.append(_kernel_row(variant, surface, runs))
    finally:
        _kernels.use_variant(before)
    return rows


def _kernel_row(variant: str, surface: DualSurface, runs: int) -> Row:
    nodes, shifted = surface.nodes, surface.shifted
    count = len(nodes.points)
    blocks = blocks_of(count)
    matrix = BlockMatrix.empty(count, "bfloat16", np.ones((blocks, blocks), dtype=bool))
    near, near_shifted = (
        _kernels.NearRows(
            np.zeros(points + 1, dtype=np.int64),
            np.zeros(0, dtype=np.int64),
            np.zeros((0, 6), dtype=np.complex128),
        )
        for points in (count, len(shifted))
    )
    fill = partial(
        _kernels.dual_blocks,
        nodes.points,
        shifted,
        nodes.layer(surface.wavenumber),
        diagonal=0.5,
        near=near,
        near_shifted=near_shifted,
        whole=matrix.whole,
        out=matrix.blocks,
    )
    fill()  # the pages are touched before the clock starts
    left = np.random.default_rng(0).normal(size=(PRODUCT, PRODUCT)).astype(np.float32)
    products, fills = [], []
    for _ in range(runs):  # in turn, so that both meet the same machine
        products += timed([partial(np.matmul, left, left)] * 2)[0].seconds
        fills += timed([fill] * 2)[0].seconds
    kernels = count * (count + len(shifted)) / Timed(tuple(fills)).median
    product = 2.0 * PRODUCT**3 / Timed(tuple(products)).median
    share = FLOPS * kernels / product
    return Row(
        f"kernel evaluations, {variant}, {FLOPS} flop each, against sgemm",
        "70 % (AVX-512)",
        f"{share:.0%}: {kernels / 1e9:.2f} G/s beside {product / 1e9:.0f} Gflop/s",
        "see the kernels' tests",
        f"{count} nodes, {Timed(tuple(fills))} a matrix",
        {"share": share, "kernels": kernels, "product": product, "seconds": tuple(fills)},
    )


def memory_over_matrix(accuracy: float = 0.0018) -> Row:
    """Solve two fingers in a process of its own, and compare its peak memory with the matrix in single precision."""
    bodies = two_fingers()
    case = case_of(bodies, bodies.foci + [0.0, 0.0, 0.1], 0, accuracy, estimate=True)
    answer = run_case("airtact", sys.executable, case)
    share = answer.peak / (8.0 * answer.unknowns**2)
    return Row(
        "peak memory above the process's base, over the matrix (8 bytes an entry)",
        "1.3, 8k unknowns or more",
        f"{share:.2f}",
        "",
        f"{answer.unknowns} unknowns, matrix {8e-9 * answer.unknowns**2:.2f} GB",
        {"share": share, "unknowns": answer.unknowns},
    )


COLOURS = ("#1b6ca8", "#5fb0d8", "#d1495b", "#8a6f2a")
MARKS = ("o", "v", "s", "^")

HEAD = """# Performance

The speed of airtact, with the error beside every time. Made by

```sh
python -m benchmarks.bench --out out/bench --acoustools PYTHON --bempp PYTHON
```

where each PYTHON is the interpreter of an environment with that package; what is not given is left out. Times are
medians, with the least and the most in brackets.
"""

CONTEST = """## Beside other packages

Two capsules of 16 mm x 60 mm, 12 mm apart, a focus 2 mm off each pad, 996 elements as monopoles. Each package runs in
an interpreter of its own, one after the other, warmed up, from bodies in memory to the transfer matrix: airtact and
bempp-cl solve for a beacon in each focus, AcousTools for all elements, as it is made; airtact once with its estimate of
the error, which is a second solve, and once without. AcousTools is given points
inside the bodies (CHIEF), without which it does not converge; bempp-cl runs Galerkin with linear elements, Burton-
Miller and OpenCL on the processor. Their flat triangles are even and hold the exact volume. The error is that of the
worse focus over all elements, against fundamental solutions, which share no code with any of them and are themselves
{own:.2%} off. Memory is the peak above what the process held after a small run.
"""


def page_of(found: Bench) -> str:
    """Return the page in Markdown."""
    parts = [
        HEAD,
        f"Machine: {found.machine}.\n",
        CONTEST.format(own=found.own_error),
        _contest_section(found),
        _rows_section(found),
    ]
    parts.append(_growth_section(found))
    if found.notes:
        parts.append(
            "## Left out\n\n" + "\n".join(f"- {sentence}" for sentence in found.notes) + "\n"
        )
    return "\n".join(parts)


def _contest_section(found: Bench) -> str:
    mine = [one for one in found.contest if one.package.startswith("airtact")]
    lines = [
        "| package | setting | unknowns | time | error | memory | airtact at equal or smaller error |"
    ]
    lines.append("|---|---|---|---|---|---|---|")
    for one in found.contest:
        numbers = f"{one.unknowns} | {one.timed} | {one.error:.2%} | {one.peak / 1e6:.0f} MB"
        ratio = "" if one in mine else _ratio(mine, one)
        lines.append(f"| {one.package} | {one.setting} | {numbers} | {ratio} |")
    return "\n".join([*lines, "", "![Error against time](error_against_time.svg)\n"])


def _ratio(mine: list[Solved], one: Solved) -> str:
    found = faster(mine, one)
    if found is None:
        return "none of these runs is as accurate"
    times, best = found
    return f"{times:.0f} times faster ({best.timed}, {best.error:.2%})"


def _rows_section(found: Bench) -> str:
    lines = ["## A hand that moves\n", "| what | asked | measured | error | where the time went |"]
    lines.append("|---|---|---|---|---|")
    lines += [
        f"| {one.what} | {one.asked} | {one.measured} | {one.error} | {one.profile} |"
        for one in found.rows
    ]
    return "\n".join([*lines, ""])


def _growth_section(found: Bench) -> str:
    lines = ["## How the cost grows\n"]
    for name, what, grown in (
        ("unknowns", "a solve of two fingers, 2 foci", found.unknowns),
        ("elements", "transfer matrix and drive of a solved shape", found.elements),
    ):
        lines += [f"| {name} | {what} |", "|---|---|"]
        lines += [f"| {one.size} | {one.timed} |" for one in grown]
        if len(grown) > 1:
            lines.append(
                f"\nOver the larger half it grows as the power {power(list(grown)):.1f} of the {name}."
            )
        lines.append("")
    return "\n".join([*lines, "![How the cost grows](growth.svg)\n"])


def draw_contest(folder: Path, contest: Sequence[Solved], own_error: float) -> None:
    """Draw error against time, one line a package, least to most of the runs as bars."""
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.add_subplot(xscale="log", yscale="log")
    packages = list(dict.fromkeys(one.package for one in contest))
    for package, colour, mark in zip(packages, COLOURS, MARKS, strict=False):
        runs = [one for one in contest if one.package == package]
        middle = [one.timed.median for one in runs]
        low = [one.timed.median - min(one.timed.seconds) for one in runs]
        high = [max(one.timed.seconds) - one.timed.median for one in runs]
        errors = [100 * one.error for one in runs]
        axes.errorbar(
            middle, errors, xerr=(low, high), color=colour, marker=mark, capsize=3, label=package
        )
    axes.axhline(100 * own_error, color="0.6", linestyle=":", label="the reference's own error")
    axes.set(xlabel="time from bodies to transfer matrix, 996 elements, 2 foci [s]")
    axes.set(ylabel="error of the transfer matrix [%]")
    axes.grid(which="both", color="0.92")
    axes.legend(frameon=False)
    _save(figure, folder / "error_against_time")


def draw_growth(folder: Path, unknowns: Sequence[Grown], elements: Sequence[Grown]) -> None:
    """Draw the time against unknowns and against elements."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    pair = figure.subplots(1, 2, subplot_kw={"xscale": "log", "yscale": "log"})
    says = "time of a solve [s]", "time to the drive of a solved shape [s]"
    for axes, size, label, grown in zip(
        pair, ("unknowns", "elements"), says, (unknowns, elements), strict=True
    ):
        axes.plot(
            [one.size for one in grown],
            [one.timed.median for one in grown],
            color=COLOURS[0],
            marker="o",
        )
        axes.set(xlabel=size, ylabel=label)
        axes.grid(which="both", color="0.92")
        if len(grown) > 1:
            axes.set_title(f"grows as the power {power(list(grown)):.1f}", fontsize="medium")
    _save(figure, folder / "growth")


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path.with_suffix(".png"), dpi=150)
    figure.savefig(path.with_suffix(".svg"))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, write the page and print it."""
    parser = argparse.ArgumentParser(description="Measure times and errors, beside other packages.")
    parser.add_argument("--out", type=Path, default=Path("out/bench"), help="folder of results")
    parser.add_argument("--acoustools", metavar="PYTHON", help="of an environment with AcousTools")
    parser.add_argument("--bempp", metavar="PYTHON", help="of an environment with bempp-cl")
    hand = example("relaxed.json")
    parser.add_argument("--hand", type=Path, default=hand, help="pose of an open hand, .json")
    parser.add_argument("--quick", action="store_true", help="do less of everything")
    given = parser.parse_args(arguments)
    report = partial(print, flush=True)
    found = bench(given.out, given.acoustools, given.bempp, given.hand, given.quick, report)
    print(page_of(found))


if __name__ == "__main__":
    main()
