"""From a measured scan and a scene file to how well they agree. Prints nothing."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airtact.acoustics.solvers.problem import SolveReport
from airtact.drives.drive import quantise
from airtact.errors import about
from airtact.evaluation.field import drive_sources
from airtact.evaluation.microphone import Microphone
from airtact.evaluation.scan import Overlay, load_scan, overlay_scan
from airtact.files.atomic import whole_file, writable_folder
from airtact.reports.page import write_picture
from airtact.reports.plots import draw_overlay
from airtact.setup.building import read_scene
from airtact.setup.solving import solve_foci, synthesise, verification_solver
from airtact.timing import Clock, Progress, no_progress

FILES = ("overlay.csv", "overlay.png")
"""What a comparison with a scan writes."""


@dataclass(frozen=True, eq=False)
class Compared:
    """A scan beside its prediction, how the latter was solved, and warnings of a method that stopped early."""

    overlay: Overlay
    report: SolveReport
    notes: tuple[str, ...]


def compare_scan(
    scan_file: Path,
    scene_file: Path,
    folder: Path,
    microphone: Microphone,
    report_step: Progress = no_progress,
    pictures: bool = True,
) -> Compared:
    """Predict what a microphone reads in a scene, and compare a measured scan with it after one complex scale.

    The scan has the columns x, y, z [m] in the obstacles' frame, pressure and perhaps phase [rad].
    The drive of the scene file, rounded to its levels, is emitted. `FILES` go into the folder,
    which is made if it is not there; without ``pictures`` only the first.

    Raises
    ------
    InvalidInput
        A file or the folder is at fault, or too few positions can be predicted.
    NotConverged
        A solver stopped early.
    """
    clock = Clock(report_step)
    with clock.step("scene", f"reading {scan_file.name} and {scene_file.name}"):
        scan, setup = load_scan(scan_file), read_scene(scene_file)
        writable_folder(folder)
    transfer, _ = solve_foci(setup, clock)
    made, notes = synthesise(setup.synthesise, transfer, setup.target)
    drive = quantise(made, setup.levels).drive()
    with clock.step(
        "verify", "predicting by a more accurate solve with all transducers as sources"
    ):
        field = verification_solver(setup).radiate(
            setup.scene, drive_sources(setup.array, [drive], setup.scene)
        )
    with clock.step("scan", f"evaluating the microphone at {len(scan.points)} positions"):
        predicted = microphone.read(field, scan.points)[:, 0]
    with about(scan_file.name):
        compared = Compared(overlay_scan(scan, predicted), field.report, notes)
    _write_table(folder / FILES[0], compared.overlay)
    if pictures:
        write_picture(folder / FILES[1], draw_overlay(compared.overlay))
    return compared


def _write_table(file: Path, found: Overlay) -> None:
    """Write a row for each position: what was measured, and what was predicted times the scale."""
    with whole_file(file) as partial, partial.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(
            ["x", "y", "z", "measured", "measured_phase", "predicted", "predicted_phase"]
        )
        for point, measured, predicted in zip(
            found.scan.points, found.scan.pressures, found.scale * found.predicted, strict=True
        ):
            phase = f"{np.angle(measured):.6g}" if found.scan.phased else ""
            numbers = [
                f"{np.abs(measured):.6g}",
                phase,
                f"{np.abs(predicted):.6g}",
                f"{np.angle(predicted):.6g}",
            ]
            writer.writerow([*(f"{number:.9g}" for number in point), *numbers])
