"""From a scene file to a folder of results: the drive, the field and the page. Prints nothing."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.planes import Plane
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.target import Target
from airtact.acoustics.target_points import outward
from airtact.drives.bounds import upper_bound
from airtact.drives.conjugation import time_reversal
from airtact.drives.methods import FOR_SAMPLES, METHODS
from airtact.drives.reach import fraction
from airtact.drives.rounding import quantise
from airtact.drives.samples.robust import robust
from airtact.drives.transfer import Drive, TransferMatrix
from airtact.evaluation.comparison import Comparison, compare
from airtact.evaluation.headline import FULL, beyond_linear, body_word, headline, shortfalls
from airtact.evaluation.held_out import HeldOut, held_out, shift_map
from airtact.evaluation.windows import Window, box_around, close_up
from airtact.files.atomic import writable_folder
from airtact.reports.field_figure import Cut, cut_bodies
from airtact.reports.plane_figure import behind_planes
from airtact.reports.run_page import Rendered, Run, write_page
from airtact.setup.building import Setup, check_method, read_scene
from airtact.setup.steps import (
    method_words,
    named,
    other_samples,
    plane_of_foci,
    reach_cautions,
    save_drives,
    seen_by_array,
    solve_beacons,
    solver_of_samples,
    stored,
    synthesise,
    verification_solver,
    with_control,
)
from airtact.setup.vtkhdf import write_field
from airtact.timing import Clock, Progress, no_progress
from airtact.transducers.drive_file import SEQUENCE_FILE
from airtact.workflows.modulated import sensations, write_sequence
from airtact.workflows.scene_view import scene_view

FILES = ("drive.csv", "drive.h5", "field.vtkhdf", "report.html")
"""What a run writes, in this order."""

DOUBTFUL = 1.5
"""Difference between both solutions at a focus, over the accuracy asked, from which a run warns."""

TRIED = 300
"""About so many points of a window have the error estimated over them."""


def render(
    path: Path,
    folder: Path,
    report_step: Progress = no_progress,
    store: Path | None = None,
    *,
    method: str | None = None,
    pictures: bool = True,
) -> Rendered:
    """Compute what a scene file asks for and write it into a folder, each file as soon as it is complete.

    These are `FILES`, and `SEQUENCE_FILE` where foci move. Solved fields are stored in the folder
    ``store`` if given. ``method``, one of ``METHODS``, takes the place of the scene file's. Without
    ``pictures`` only the drive is written.

    Raises
    ------
    InvalidInput
        The scene file or the folder is at fault; nothing was solved then.
    NotConverged
        A solver stopped early; what was written before stays.
    """
    clock = Clock(report_step)
    with clock.step("scene", f"reading {path.name}"):
        setup = read_scene(path)
        setup = setup if method is None else _by_method(setup, method)
        writable_folder(folder)
    field = solve_beacons(setup, clock, store)
    transfer, beacons = seen_by_array(setup, field, clock)
    with clock.step("drive", f"making the drive by {method_words(setup)}"):
        drive, notes = synthesise(setup.synthesise, transfer, setup.target)
    # An older run's field and page must not stand beside this run's drive.
    for name in (*FILES, SEQUENCE_FILE):
        (folder / name).unlink(missing_ok=True)
    save_drives({folder / name: drive for name in FILES[:2]}, setup, transfer, beacons)
    moving, noted = write_sequence(folder / SEQUENCE_FILE, setup, transfer, clock, store)
    drives, comparison = _verify(setup, drive, clock, store)
    drive = _scaled(setup.target, drive, comparison)
    save_drives({folder / name: drive for name in FILES[:2]}, setup, transfer, beacons)
    reached = float(np.abs(drive.amplitudes).max()) * comparison.pressures["equal peak"][0]
    rendered = Rendered(
        title=path.stem.replace("_", " "),
        text=setup.text,
        scene=setup.scene,
        bodies=setup.bodies,
        array=setup.array,
        target=setup.target,
        foci=setup.foci,
        method=method_words(setup),
        drive=drive,
        frame=quantise(drive, setup.levels),
        transfer=transfer,
        beacons=beacons,
        reached=reached,
        comparison=comparison,
        doubt=(doubt := _doubt(setup, field, transfer, drive, clock)),
        **_sentences(
            setup, transfer, drive, comparison, (*reach_cautions(setup), *notes, *noted), doubt
        ),
        sensation=sensations(setup, reached, moving),
        seconds=clock.seconds,
    )
    return _draw(rendered, drives, setup, folder, clock, report_step) if pictures else rendered


def _draw(
    rendered: Rendered,
    drives: Mapping[str, Drive],
    setup: Setup,
    folder: Path,
    clock: Clock,
    report_step: Progress,
) -> Run:
    """Write the field around the foci, and the page."""
    comparison, bodies = (
        rendered.comparison,
        [obstacle.surface for obstacle in setup.scene.obstacles],
    )
    peak = float(np.abs(rendered.drive.amplitudes).max())
    with clock.step("field", "computing the field around the foci"):
        box = box_around(setup.target.points, setup.scene.wavelength)
        write_field(
            folder / "field.vtkhdf",
            box,
            peak * comparison.at(box.points)[comparison.names[0]],
            bodies,
        )
    scales = _scales(comparison, peak)
    with clock.step("cuts", "computing the field in the pictures"):
        plane, close_ups = _cuts(setup, comparison, scales)
    with clock.step("scene in space", "computing the field in the scene to turn"):
        view = scene_view(setup, comparison.field, drives, scales, plane.window, "equal energy")
    report_step("drawing the report")
    run = Run(**vars(rendered), plane=plane, close_ups=close_ups, view=view)
    write_page(folder / "report.html", run)
    return run


def _verify(
    setup: Setup, drive: Drive, clock: Clock, store: Path | None
) -> tuple[dict[str, Drive], Comparison]:
    """Compare the drive with the one by the same method without the bodies, the strongest element at full scale."""
    drives = with_control(setup, setup.synthesise, drive)
    with clock.step(
        "verify", "verifying it by a more accurate solve with all transducers as sources"
    ):
        solver = stored(verification_solver(setup), store)
        comparison = compare(setup.scene, setup.array, drives, setup.target, solver=solver)
    return {
        name: Drive(one.amplitudes / np.abs(one.amplitudes).max()) for name, one in drives.items()
    }, comparison


def _scaled(target: Target, drive: Drive, comparison: Comparison) -> Drive:
    """Scale the drive so that the weakest focus gets what it asks by the verification, where full scale allows that."""
    peak = float(np.abs(drive.amplitudes).max())
    share = (
        np.nanmin(fraction(peak * comparison.pressures["equal peak"][0], target))
        if target.pressures is not None
        else 1
    )
    return Drive(drive.amplitudes / max(share, peak)) if peak < 1.0 else drive


def _sentences(
    setup: Setup,
    transfer: TransferMatrix,
    drive: Drive,
    comparison: Comparison,
    notes: Sequence[str],
    doubt: HeldOut | None,
) -> dict[str, Any]:
    """Return the headline of a run, the remarks under it, and the warnings: those there are and those of the solves."""
    peak = float(np.abs(drive.amplitudes).max())
    reached = peak * comparison.pressures["equal peak"][0]
    missing = shortfalls(setup.target, setup.foci, reached, peak)
    return {
        "headline": headline(comparison, peak, body_word(setup.bodies)),
        "remarks": (
            *missing,
            *(() if doubt is None else (doubt.sentence(),)),
            _share_of_bound(setup, transfer, drive),
        ),
        "notes": (
            *notes,
            *beyond_linear(reached),
            *_doubts(setup, transfer, drive, reached),
            *named(comparison.report.warnings, setup.bodies),
        ),
    }


def _by_method(setup: Setup, method: str) -> Setup:
    check_method(method, setup.uncertainty is not None)
    return replace(setup, method=method, synthesise=METHODS[method])


def _doubt(
    setup: Setup, beacons: RadiatedField, transfer: TransferMatrix, drive: Drive, clock: Clock
) -> HeldOut | None:
    """Try the drive where hand, air and transducers are not as expected, beside the robust one and time reversal."""
    if setup.uncertainty is None:
        return None
    with clock.step("doubt", "trying the drive on other samples of what is in doubt"):
        drives = {setup.method.replace("_", " "): drive}
        if setup.method not in FOR_SAMPLES:
            drives["robust"] = robust(transfer, setup.target)
        if setup.method != "time_reversal":
            drives["time reversal"] = time_reversal(transfer, setup.target)
        found = held_out(other_samples(setup, beacons), setup.target, drives)
        given = beacons, setup.array, setup.target, drives
        windows = _shifts(setup, setup.uncertainty.shift)
        solver = solver_of_samples(setup)
        return replace(
            found, maps=tuple(shift_map(*given, window, solver=solver) for window in windows)
        )


def _shifts(setup: Setup, deviation: float) -> list[Window]:
    """Return shifts in the plane of the foci and across it, up to three standard deviations of the hand's place.

    Before a rigid plane they are along it, which one solve serves, and towards it.
    """
    plane, wavelength = plane_of_foci(setup)[0], setup.scene.wavelength
    reach = 2.0 * float(np.clip(3.0 * deviation, 0.25 * wavelength, 2.0 * wavelength))
    axes = np.stack([plane.right, plane.up, plane.normal])
    right, up, normal = axes if not setup.scene.planes else _along(setup.scene.planes[0], axes)
    across = normal * np.sign(normal[np.argmax(np.abs(normal))])
    return [Window(np.zeros(3), right, one, reach, reach, reach / 16) for one in (up, across)]


def _along(plane: Plane, axes: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "3 3"]:
    """Return right, up and normal, the first two in a plane: the axis that lies best in it keeps its direction."""
    flat = axes - np.outer(axes @ plane.normal, plane.normal)
    right = flat[np.argmax(np.linalg.norm(flat, axis=1).round(3))]
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(plane.normal, right), plane.normal])


def _share_of_bound(setup: Setup, transfer: TransferMatrix, drive: Drive) -> str:
    """Say how near the drive comes to the certified bound, before and after rounding."""
    frame = quantise(drive, setup.levels)
    bound = upper_bound(transfer, setup.target, tolerance=1e-2)
    exact, rounded = (bound.reached(transfer, setup.target, one) for one in (drive, frame.drive()))
    levels = (
        f"{len(frame.levels.amplitudes)} levels of amplitude and {frame.levels.phases} of phase"
    )
    if np.abs(drive.amplitudes).max() < FULL:
        left = f"At full scale no drive exceeds {1.0 / exact:.1f} times that"
        return f"{left}; rounded to {levels} it is {rounded / exact:.1%} of it.".replace("%", " %")
    words = (
        f"That is {exact:.0%} of the upper bound for any drive, {rounded:.0%} rounded to {levels}."
    )
    return words.replace("%", " %")


def _doubts(
    setup: Setup, transfer: TransferMatrix, drive: Drive, reached: Float64[np.ndarray, "foci"]
) -> list[str]:
    """Say where the two solutions disagree by more than was asked."""
    predicted = np.abs(transfer.pressure(drive))[: len(reached)]
    apart = np.abs(predicted / reached - 1.0)
    worst = int(np.argmax(apart))
    if not apart[worst] > DOUBTFUL * setup.accuracy:
        return []
    return [
        f"the solution that the drive is made from and the one that verifies it differ by {apart[worst]:.1%} at "
        f"{setup.foci[worst]}, and {setup.accuracy:.1%} was asked: give a smaller accuracy under [solver]."
    ]


def _scales(comparison: Comparison, peak: float) -> Float64[np.ndarray, "drives"]:
    """Factors that bring each drive of a comparison to the energy of the first, which has this largest amplitude."""
    columns = [comparison.column(name) for name in comparison.names]
    energy = np.sum(np.abs(comparison.field.sources.strengths[:, columns]) ** 2, axis=0)
    return peak * np.sqrt(energy[0] / energy)


def _error_over(window: Window, scene: Scene, comparison: Comparison) -> float:
    """Estimate the relative error of the pressures in a window, at some of its points outside the bodies."""
    outside = window.points[scene.depth(window.points) < 0.0]
    some = outside[:: max(1, len(outside) // TRIED)]
    return float(np.max(comparison.field.error_at(some))) if len(some) else float("nan")


def _cuts(
    setup: Setup, comparison: Comparison, scales: Float64[np.ndarray, "drives"]
) -> tuple[Cut, list[Cut]]:
    """Cut the field through the foci, and across each of them where one plane cannot show them all."""
    scene, foci = setup.scene, setup.target.points
    window, solid = plane_of_foci(setup)

    def cut(window: Window) -> Cut:
        pressures = zip(comparison.at(window.points).items(), scales, strict=True)
        scaled = {name: p * scale for (name, p), scale in pressures}
        outlines = cut_bodies(window, solid) + behind_planes(window, scene.planes)
        return Cut(window, scaled, outlines, _error_over(window, scene, comparison))

    plane = cut(window)
    if len(foci) < 3 or not scene.obstacles:
        return plane, []
    outwards = outward(scene.depth, foci)
    return plane, [
        cut(close_up(*pair, scene.wavelength)) for pair in zip(foci, outwards, strict=True)
    ]
