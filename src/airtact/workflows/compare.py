"""From a scene file to a page that compares all ways to make its drive on one transfer matrix. Prints nothing."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from airtact.acoustics.solvers.problem import RadiatedField
from airtact.drives.bounds import upper_bound
from airtact.drives.default_method import best, method_for
from airtact.drives.methods import FOR_SAMPLES, METHODS
from airtact.drives.rounding import quantise
from airtact.drives.transfer import Drive, TransferMatrix
from airtact.errors import InvalidInput
from airtact.evaluation.metrics import radiate_drives
from airtact.files.atomic import whole_file, writable_folder
from airtact.reports.field_figure import Cut, cut_bodies
from airtact.reports.methods_page import Contender, Contest, Ranked, write_methods_page
from airtact.reports.plane_figure import behind_planes
from airtact.setup.building import Setup, read_scene
from airtact.setup.steps import (
    drive_names,
    named,
    other_samples,
    plane_of_foci,
    reach_cautions,
    save_drives,
    seen_by_array,
    solve_beacons,
    stored,
    synthesise,
    verification_solver,
    with_control,
)
from airtact.timing import Clock, Progress, no_progress
from airtact.workflows.scene_view import scene_view

FILES = ("methods.csv", "methods.html")
"""What a comparison writes beside the drives, in this order."""

WAYS = tuple(name for name in METHODS if name != "best" and name not in FOR_SAMPLES)
"""The methods that are compared, and those for samples where something is in doubt; `best` is one of them."""


def compare(
    path: Path,
    folder: Path,
    report_step: Progress = no_progress,
    store: Path | None = None,
    *,
    pictures: bool = True,
) -> Ranked:
    """Make the drive of a scene file by every method, verify all in one more accurate solve, and write a page.

    `FILES` go into the folder and, below ``drives``, one HDF5 file for each method. Solved fields
    are stored in the folder ``store`` and found again, if one is given. The method that the scene
    file names is not used. Without ``pictures`` no page is written.

    Raises
    ------
    InvalidInput
        The scene file or the folder is at fault; nothing was solved then. Or no method makes a drive.
    NotConverged
        A solver stopped early; drives that were written stay.
    """
    clock = Clock(report_step)
    with clock.step("scene", f"reading {path.name}"):
        setup = _fresh_setup(path, folder)
    known = solve_beacons(setup, clock, store)
    transfer, beacons = seen_by_array(setup, known, clock)
    ways = WAYS if setup.uncertainty is None else (*WAYS, *FOR_SAMPLES)
    with clock.step("drives", f"making the drive by {len(ways)} methods"):
        drives, seconds, notes = _all_drives(setup, transfer, ways)
        bound = upper_bound(transfer, setup.target).worst
    files = {
        folder / "drives" / f"{name.replace(' ', '_')}.h5": drive for name, drive in drives.items()
    }
    save_drives(files, setup, transfer, beacons)
    emitted = {name: quantise(drive, setup.levels).drive() for name, drive in drives.items()}
    words = (
        f"verifying {len(drives)} drives by a more accurate solve with all transducers as sources"
    )
    with clock.step("verify", words):
        solver = stored(verification_solver(setup), store)
        field = radiate_drives(
            setup.scene, setup.array, list(emitted.values()), setup.target, solver
        )
        at_foci, suppressed = (
            np.abs(field.at(at).T) for at in (setup.target.points, setup.target.suppression_points)
        )
    kept = _kept(setup, known, emitted, clock)
    contenders = [
        Contender(
            name, drives[name], emitted[name], pressures, level, seconds[name], kept.get(name)
        )
        for name, pressures, level in zip(emitted, at_foci, suppressed, strict=True)
    ]
    ranked = Ranked(
        title=path.stem.replace("_", " "),
        text=setup.text,
        target=setup.target,
        foci=setup.foci,
        bodies=setup.bodies,
        default=method_for(setup.target).__name__.replace("_", " "),
        contenders=contenders,
        notes=[*reach_cautions(setup), *notes, *named(field.report.warnings, setup.bodies)],
        transfer=transfer,
        bound=bound,
        report=field.report,
        seconds=clock.seconds,
    )
    _write_table(folder / FILES[0], ranked)
    return _draw(ranked, setup, field, folder, clock, report_step) if pictures else ranked


def _draw(
    ranked: Ranked,
    setup: Setup,
    field: RadiatedField,
    folder: Path,
    clock: Clock,
    report_step: Progress,
) -> Contest:
    """Write the page."""
    emitted = {one.name: one.emitted for one in ranked.contenders}
    with clock.step("cuts", "computing the fields in the pictures"):
        cut = _cut(setup, field, list(emitted))
    with clock.step("scene in space", "computing the fields in the scene to turn"):
        view = scene_view(
            setup, field, emitted, np.ones(len(emitted)), cut.window, "the levels that they emit"
        )
    report_step("drawing the page")
    contest = Contest(**vars(ranked), cut=cut, view=view)
    write_methods_page(folder / FILES[1], contest)
    return contest


def _fresh_setup(path: Path, folder: Path) -> Setup:
    setup = read_scene(path)
    writable_folder(folder / "drives")
    for name in FILES:
        (folder / name).unlink(missing_ok=True)
    return setup


def _all_drives(
    setup: Setup, transfer: TransferMatrix, ways: Sequence[str]
) -> tuple[dict[str, Drive], dict[str, float], list[str]]:
    """Make a drive by each method: drives, seconds, and warnings of those that raised or stalled."""
    drives, all_notes, clock = {}, [], Clock()
    for name in ways:
        words = name.replace("_", " ")
        try:
            with clock.step(words):
                drives[words], notes = synthesise(METHODS[name], transfer, setup.target)
        except InvalidInput as fault:
            notes = (f"{words} made no drive: {fault}",)
        all_notes += notes
    if not drives:
        raise InvalidInput(f"0 of {len(ways)} methods make a drive; {all_notes[0]}", code="empty")
    with clock.step(drive_names(setup.bodies)[-1]):
        drives |= with_control(setup, best)
    return drives, clock.seconds, all_notes


def _kept(
    setup: Setup, beacons: RadiatedField, drives: Mapping[str, Drive], clock: Clock
) -> dict[str, float]:
    """Return what the weakest focus gets 9 of 10 times under each drive [Pa]; nothing where nothing is in doubt."""
    if setup.uncertainty is None:
        return {}
    asked = np.flatnonzero(setup.target.weights > 0.0)
    with clock.step("doubt", "trying them on other samples of what is in doubt"):
        samples = other_samples(setup, beacons)
        weakest = {
            name: np.abs(samples.pressures(one)[:, asked]).min(axis=1)
            for name, one in drives.items()
        }
    return {name: float(np.quantile(values, 0.1)) for name, values in weakest.items()}


def _cut(setup: Setup, field: RadiatedField, names: list[str]) -> Cut:
    """Cut the field of each drive, one right-hand side a name, through the foci."""
    window, solid = plane_of_foci(setup)
    outlines = cut_bodies(window, solid) + behind_planes(window, setup.scene.planes)
    return Cut(window, dict(zip(names, field.at(window.points).T, strict=True)), outlines)


def _write_table(file: Path, contest: Ranked) -> None:
    """Write a row for each method and focus."""
    with whole_file(file) as partial, partial.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["method", "focus", "pressure_Pa", "weight", "energy", "seconds"])
        for one in contest.contenders:
            for focus, pressure, weight in zip(
                contest.foci, one.pressures, contest.target.weights, strict=True
            ):
                numbers = [
                    f"{pressure:.6g}",
                    f"{weight:.6g}",
                    f"{one.energy:.6g}",
                    f"{one.seconds:.3g}",
                ]
                writer.writerow([one.name, focus, *numbers])
