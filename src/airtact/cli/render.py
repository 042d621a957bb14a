"""``airtact render``: compute the drive and the field of a scene, and write a report."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import Any

import click
from rich.markup import escape
from rich.table import Table

import airtact as at
from airtact.cli.console import open_page, plain_table, progress, show
from airtact.cli.options import (
    Names,
    as_json,
    open_result,
    pictures,
    quiet,
    results,
    scene,
    setup_for,
    store,
)

# Files of a rendering: the sequence is only for moving foci, the last two only with pictures
FILES = ("drive.csv", "drive.h5", "sequence.h5", "field.vtkhdf", "report.html")


@click.command(
    short_help="Compute the drive and the field for a scene.",
    epilog="Example: airtact render pinch --out out/pinch",
)
@scene
@results
@click.option(
    "--method",
    type=Names("airtact.drives.methods:METHODS"),
    metavar="NAME",
    help="Method to use instead of the one in the scene; airtact compare lists all methods.",
)
@store
@pictures
@open_result
@as_json
@quiet
def render(
    scene: Path, folder: Path, method: str | None, store: Path | None, pictures: bool, opened: bool
) -> None:
    """Compute the drive and field of SCENE; write drive.csv, drive.h5, field.vtkhdf, report.html.

    SCENE is a scene file, by default scene.toml, or the name of an example:
    air_letters, live_pinch, open_hand, palm_circle, pinch, pinch_pose,
    suppressed_pinch, tinylev, touch_ball, touch_button. The files are written to the
    folder --out. A second solve verifies the drive. With --no-pictures,
    only the drive is written. Drives for moving foci ([drive.modulation]) are written to
    sequence.h5.
    """
    with progress(f"reading {scene.name}") as report_step:
        from airtact.setup.rendering import compute, save_files, verify
        from airtact.timing import Clock

        setup = setup_for(folder, scene)
        if method is not None:
            setup = replace(setup, method=method)
        files: list[Path] = []
        unverified = ""
        clock = Clock(report_step)
        try:
            computed = compute(setup, clock, store)
            report_step(f"writing the drive, which is not yet verified, to {folder}")
            files += save_files(computed, folder)
            unverified = f" The drive in {folder} is not verified."
            if pictures:
                # Import Matplotlib while the kernels verify, because this takes half a second.
                Thread(target=import_module, args=["airtact.reports.run_page"], daemon=True).start()
            result = verify(computed, clock, store)
            if result.drive is not computed.drive:
                report_step("writing the drive, scaled to the requested pressures")
                result.save(folder)
            unverified = ""
            if pictures:
                files += at.write_report(result, folder, progress=report_step)
            _remove_older(folder, files)
        except KeyboardInterrupt:
            if unverified:
                _remove_older(folder, files)
            words = ", ".join(file.name for file in files) or "none of this run"
            raise KeyboardInterrupt(f"complete files in {folder}: {words}.{unverified}") from None
        except (at.InvalidInput, at.NotConverged) as fault:
            # A full disk must not lose the files of an older run. Otherwise an older report beside
            # an unverified drive would mislead.
            if unverified and fault.code != "not_writable":
                _remove_older(folder, files)
            raise type(fault)(f"{fault}{unverified}", code=fault.code) from fault
    lines = list(result.sensation)
    if result.sequence is not None:
        sequence = result.sequence.sequence
        lines.append(
            f"Sequence: {folder / 'sequence.h5'}, {len(sequence)} frames at "
            f"{sequence.rate:,.0f} frames/s, {sequence.rate / len(sequence):.3g} cycles/s"
        )
    report = folder / "report.html"
    lines.append(f"Report: {report}" if pictures else f"Drive: {folder / 'drive.h5'}")
    show(
        _table(result),
        first=[result.headline, *result.remarks],
        warnings=result.warnings,
        lines=lines,
        record={**_record(result), "files": {file.name: str(file) for file in files}},
    )
    if opened:
        open_page(report)


def _remove_older(folder: Path, files: list[Path]) -> None:
    """Remove the files of an older run that this one did not write."""
    for name in {*FILES} - {file.name for file in files}:
        (folder / name).unlink(missing_ok=True)


def _record(result: "at.Rendering") -> dict[str, Any]:
    setup = result.setup
    requested = setup.target.pressures
    touch = setup.contacts
    return {
        "method": result.method,
        "headline": result.headline,
        "remarks": list(result.remarks),
        "foci": [
            {
                "name": setup.foci[index],
                "position": point.tolist(),
                "pressure": float(result.pressures[index]),
                "asked": None if requested is None else float(requested[index]),
                "expected": float(result.evaluation.expected[index]),
                "second_harmonic": float(result.evaluation.second_harmonic[index]),
            }
            for index, point in enumerate(setup.target.points)
        ],
        "contacts": []
        if touch is None
        else [
            {"place": place, "object": name, "depth": float(depth), "position": point.tolist()}
            for place, name, depth, point in zip(
                touch.places, touch.objects, touch.depths, touch.points, strict=True
            )
        ],
        "traps": [
            {
                "point": verdict.point.tolist(),
                "is_trap": verdict.is_trap,
                "stiffness": verdict.stiffness.tolist(),
                "holds": verdict.holds,
            }
            for verdict in result.traps
        ],
        "sequence": None
        if result.sequence is None
        else {
            "frames": len(result.sequence.sequence),
            "pressures": result.sequence.pressures.tolist(),
            "expected": result.sequence.expected.tolist(),
        },
        "sensation": list(result.sensation),
        "estimated_error": result.estimated_error,
        "seconds": dict(result.seconds),
    }


def _table(result: "at.Rendering") -> Table:
    requested = result.setup.target.pressures
    columns = {"pressure": result.pressures}
    if requested is not None:
        columns["requested"] = requested
    if result.control_pressures is not None:
        columns[result.verification.names[1]] = result.control_pressures
    table = plain_table("focus", *columns)
    for name, *pressures in zip(result.setup.foci, *columns.values(), strict=True):
        table.add_row(escape(name), *(f"{pressure:,.0f} Pa" for pressure in pressures))
    return table
