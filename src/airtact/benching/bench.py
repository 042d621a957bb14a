"""The whole bench: airtact beside other packages, the rows of real time, the growth of the cost."""

import csv
import json
import os
import platform
import shutil
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np

from airtact import _kernels
from airtact.acoustics.solvers.memory import processor_count
from airtact.benching.contest import ACCURACIES, EDGES, Solved, ours, theirs
from airtact.benching.growth import BOARDS, by_elements, by_unknowns
from airtact.benching.machine import kernels_against_product, memory_over_matrix
from airtact.benching.performance_page import Bench, draw_contest, draw_growth, page_of
from airtact.benching.phalanges import Phalanges
from airtact.benching.real_time import OpenHand, RealTime, Row
from airtact.benching.references import reference_pressure
from airtact.benching.scenes import Bodies, two_fingers
from airtact.errors import InvalidInput
from airtact.files.atomic import whole_file, writable_folder
from airtact.hands.files import load_hand
from airtact.timing import Progress, no_progress
from airtact.transducers.element import monopole
from airtact.transducers.layout import surrounding_box

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
