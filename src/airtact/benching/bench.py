"""All of it: airtact beside other packages, its rows of real time, how its cost grows; tables and figures."""

import csv
import json
import os
import platform
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from airtact import _kernels
from airtact.atomic import whole_file, writable_folder
from airtact.benching.contest import EDGES, Solved, ours, theirs
from airtact.benching.growth import BOARDS, by_elements, by_unknowns
from airtact.benching.machine import kernels_against_product, memory_over_matrix
from airtact.benching.open_hand import OpenHand
from airtact.benching.performance_page import Bench, page_of
from airtact.benching.real_time import RealTime, Row
from airtact.benching.scenes import Bodies, two_fingers
from airtact.benching.truth import Truth, true_pressure
from airtact.conventions import InvalidInput
from airtact.hand.files import load_hand
from airtact.transducers.layout import surrounding_box

FILES = ("bench.csv", "bench.json", "performance.md", "error_against_time.png", "error_against_time.svg", "growth.png")
"""What a bench writes, and ``growth.svg``; truths are kept in ``truths`` beside them."""

OFF = 2e-3
"""How far the foci stand off the pads in the contest [m]: nearer, packages that collocate at centroids go astray."""

QUICK_EDGES, QUICK_ACCURACIES = (2.7e-3,), (0.1, 0.03)


def bench(
    folder: Path,
    acoustools: str | None = None,
    bempp: str | None = None,
    hand: Path | None = None,
    quick: bool = False,
    report_step: Callable[[str], None] = lambda step: None,
) -> Bench:
    """Measure everything and write it into a folder.

    Parameters
    ----------
    folder : for `FILES`; truths that were computed before are taken from it.
    acoustools, bempp : interpreters of environments with these packages; left out, and notes so, if not given.
    hand : pose of an open hand (.json); its rows are left out if not given.
    quick : do less of everything.
    tell : is told each step as it begins.

    Raises
    ------
    InvalidInput
        The folder takes no files, or the hand's file is at fault. A package that fails is left out and notes.
    """
    writable_folder(folder)
    truths = folder / "truths"
    notes: list[str] = []
    machine = _machine()
    bodies, elements = contested(), surrounding_box().positions
    report_step("the truth of the contest, by fundamental solutions")
    truth = true_pressure(bodies, elements, bodies.foci, truths)
    contest = _contest(
        bodies, elements, truth, {"AcousTools": acoustools, "bempp-cl": bempp}, quick, notes, report_step
    )
    rows = _rows(truths, hand, quick, notes, report_step)
    unknowns = by_unknowns(3 if quick else 7, 2000 if quick else 16000, report_step)
    report_step("larger arrays")
    found = Bench(
        machine,
        tuple(contest),
        truth.own_error,
        tuple(rows),
        tuple(unknowns),
        tuple(by_elements(3 if quick else 7, BOARDS[:2] if quick else BOARDS)),
        tuple(notes),
    )
    report_step("writing")
    write(folder, found)
    return found


def contested() -> Bodies:
    """Two fingers of 16 mm x 60 mm, 12 mm apart, a focus 2 mm off each pad."""
    bodies = two_fingers()
    pads = bodies.foci[:, 0]
    foci = bodies.foci.copy()
    foci[:, 0] = np.sign(pads) * (6e-3 - OFF)
    return replace(bodies, foci=foci)


def write(folder: Path, found: Bench) -> None:
    """Write tables and figures.

    Parameters
    ----------
    folder : is there.
    found : what was measured.
    """
    from airtact.benching.pictures import draw_contest, draw_growth

    with whole_file(folder / FILES[0]) as partial, partial.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["what", "setting", "unknowns", "median_s", "least_s", "most_s", "error", "peak_byte"])
        for one in found.contest:
            times = [f"{value:.6g}" for value in (one.timed.median, min(one.timed.seconds), max(one.timed.seconds))]
            writer.writerow([one.package, one.setting, one.unknowns, *times, f"{one.error:.6g}", one.peak])
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
    truth: Truth,
    others: dict[str, str | None],
    quick: bool,
    notes: list[str],
    report_step: Callable[[str], None],
) -> list[Solved]:
    matrix = truth.pressure
    contest = (
        ours(bodies, elements, matrix, 7, QUICK_ACCURACIES, report_step)
        if quick
        else ours(bodies, elements, matrix, 9, report_step=report_step)
    )
    for package, python in others.items():
        if python is None:
            option = package.lower().removesuffix("-cl")
            notes.append(f"{package} is left out: no --{option} PYTHON was given.")
            continue
        try:
            edges = QUICK_EDGES if quick else EDGES[package]
            contest += theirs(package, python, bodies, elements, matrix, 1 if quick else 3, edges, report_step)
        except InvalidInput as fault:
            notes.append(f"{package} is left out: {fault}")
    return contest


def _rows(
    truths: Path, hand: Path | None, quick: bool, notes: list[str], report_step: Callable[[str], None]
) -> list[Row]:
    fingers = RealTime(truths, 3 if quick else 9)
    jobs: list[Callable[[], Row]] = [
        fingers.deformed_to_drive,
        fingers.moved_each_to_drive,
        fingers.drive_only,
        fingers.whole_moved,
        fingers.new_focus,
        fingers.slice_beside,
    ]
    if hand is None:
        notes.append("The open hand is left out: no --hand POSE.json was given.")
    else:
        open_hand = OpenHand(load_hand(hand), truths, 3 if quick else 7)
        jobs += [open_hand.drive_only, open_hand.pressures]
    if not quick:
        jobs.append(memory_over_matrix)
    rows = []
    for job in jobs:
        report_step(job.__name__.replace("_", " "))
        rows.append(job())
    report_step("other accuracies")
    rows += fingers.at_accuracies()
    report_step("kernels against the matrix product")
    return rows + kernels_against_product(7)


def _machine() -> str:
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    busy = f"; others kept it busy (load {load:.1f}): times are too long" if load > 0.5 * cores else ""
    return f"{platform.machine()}, {cores} cores, {_kernels.active_variant()}{busy}"
