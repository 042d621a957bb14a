"""``airtact compare-scan``: compare a measured scan with the prediction."""

import csv
from pathlib import Path
from typing import Any

import click

import airtact as at
from airtact.cli.console import facts_table, progress, show
from airtact.cli.options import (
    INPUT,
    as_json,
    given,
    microphone_face,
    pictures,
    quiet,
    results,
    setup_for,
)


@click.command(
    name="compare-scan",
    short_help="Compare a measured scan with the prediction for a scene.",
    epilog="Example: airtact compare-scan pinch_scan.csv pinch --out out/scan",
)
@click.argument("scan", type=INPUT)
@click.argument("scene", type=INPUT)
@results
@microphone_face
@click.option(
    "--housing",
    type=float,
    help="Length of the housing behind the face in metres; 0.05 by default.",
)
@pictures
@as_json
@quiet
def compare_scan(scan: Path, scene: Path, folder: Path, pictures: bool, **microphone: Any) -> None:
    """Predict the readings of a microphone in SCENE, and compare them with the measured SCAN.

    SCAN is a .csv file with the columns x, y, z (metres, in the obstacles' frame), pressure (any
    unit) and, if measured, phase (radians). The prediction is for the drive of SCENE, rounded to
    the levels of the boards. The command writes overlay.csv and overlay.png.
    """
    with progress(f"reading {scan.name} and {scene.name}") as report_step:
        import numpy as np

        from airtact.errors import about
        from airtact.files.atomic import whole_file
        from airtact.setup.solving import emitted_drive, verification_solver
        from airtact.timing import Clock

        face = at.evaluation.Microphone(**given(**microphone))
        measured = at.evaluation.load_scan(scan)
        setup = setup_for(folder, scene)
        emitted, stalled = emitted_drive(setup, Clock(report_step))
        report_step("predicting the field by a solve with all transducers as sources")
        field = verification_solver(setup).radiate(
            setup.scene, at.evaluation.drive_sources(setup.array, [emitted], setup.scene)
        )
        report_step(f"evaluating the microphone at {len(measured.points)} positions")
        predicted = face.read(field, measured.points)[:, 0]
        with about(scan.name):
            overlay = at.evaluation.overlay_scan(measured, predicted)
        shifted = []
        if overlay.error > 0.2:
            report_step("searching for a shift of the scan that fits better")
            shift, left = at.evaluation.best_shift(
                measured, lambda points: face.read(field, points)[:, 0]
            )
            if left < 0.5 * overlay.error:
                millimetres = " ".join(f"{1e3 * part:+z.2g}" for part in shift)
                shifted.append(
                    f"the relative error is {left:.1%} if the scan's positions are shifted by "
                    f"{millimetres} mm along x, y and z: check its origin."
                )
        files = [folder / "overlay.csv"]
        with (
            whole_file(files[0]) as partial,
            partial.open("w", newline="", encoding="utf-8") as stream,
        ):
            writer = csv.writer(stream)
            writer.writerow(
                ["x", "y", "z", "measured", "measured_phase", "predicted", "predicted_phase"]
            )
            for point, pressure, expected in zip(
                measured.points, measured.pressures, overlay.scale * overlay.predicted, strict=True
            ):
                writer.writerow(
                    [
                        *(f"{number:.9g}" for number in point),
                        f"{np.abs(pressure):.6g}",
                        f"{np.angle(pressure):.6g}" if measured.phased else "",
                        f"{np.abs(expected):.6g}",
                        f"{np.angle(expected):.6g}",
                    ]
                )
        if pictures:
            from airtact.reports.page import write_picture
            from airtact.reports.plots import draw_overlay

            files.append(folder / "overlay.png")
            write_picture(files[1], draw_overlay(overlay))
    report = field.report
    quantity = (
        "complex pressures" if measured.phased else "magnitudes, because no phase was measured"
    )
    turn = f" at {np.degrees(np.angle(overlay.scale)):.1f}°" if measured.phased else ""
    facts = [
        (
            "relative error",
            f"{overlay.error:.1%} of the {quantity}, after fitting one scale factor",
        ),
        ("positions", f"{int(overlay.used.sum())} of {len(overlay.used)} compared"),
        ("scale", f"{abs(overlay.scale):.4g} units of the scan per predicted pascal{turn}"),
        ("predicted by", f"{report.solver}, estimated error {report.estimated_error:.2%}"),
    ]
    show(
        facts_table(facts),
        warnings=[*stalled, *shifted, *overlay.warnings, *report.warnings],
        lines=[f"Overlay: {files[-1]}"],
        record={
            "error": overlay.error,
            "positions": len(overlay.used),
            "compared": int(overlay.used.sum()),
            "scale": [overlay.scale.real, overlay.scale.imag],
            "phased": measured.phased,
            "estimated_error": report.estimated_error,
            "files": {file.name: str(file) for file in files},
        },
    )
