"""``airtact render``: from a scene file to the drive, the field and a page."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.markup import escape

from airtact.cli.console import open_page, plain_table, progress, show
from airtact.cli.options import Names, as_json, open_result, pictures, quiet, results, scene, store

if TYPE_CHECKING:
    from rich.table import Table

    from airtact.reports.run_page import Rendered


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
    help="Method, whatever the scene says; airtact compare lists all.",
)
@store
@pictures
@open_result
@as_json
@quiet
def render(
    scene: Path, folder: Path, method: str | None, store: Path | None, pictures: bool, opened: bool
) -> None:
    """Compute the drive and the field for SCENE and write drive.csv, drive.h5, field.vtkhdf and report.html.

    SCENE is scene.toml by default, which airtact init writes; or one of the examples that come with
    airtact: air_letters, live_pinch, open_hand, palm_circle, pinch, pinch_pose, suppressed_pinch.
    With --no-pictures only the drive is written. Foci that move, by [drive.modulation] in the
    scene, are in sequence.h5.
    """
    with progress() as report_step:
        report_step("starting")
        from airtact.workflows import render as workflow

        try:
            run = workflow.render(
                scene, folder, report_step, store, method=method, pictures=pictures
            )
        except KeyboardInterrupt:
            kept = (
                ", ".join(name for name in workflow.FILES if (folder / name).exists()) or "0 files"
            )
            raise KeyboardInterrupt(f"{kept} in {folder} kept, each complete") from None
    written = {
        name: str(folder / name) for name in (workflow.FILES if pictures else workflow.FILES[:2])
    }
    last = folder / list(written)[-1]
    line = f"Report: {last}" if pictures else f"Drive: {last}"
    show(
        _table(run),
        first=[run.headline, *run.remarks],
        warnings=run.notes,
        lines=[*run.sensation, line],
        record={**_record(run), "files": written},
    )
    if opened:
        open_page(folder / "report.html")


def _record(run: "Rendered") -> dict[str, Any]:
    """List what a run found, for ``--json``."""
    asked = run.target.pressures
    wanted = [None] * len(run.foci) if asked is None else asked.tolist()
    foci = [
        {"name": name, "position": point.tolist(), "pressure": float(got), "asked": pressure}
        for name, point, got, pressure in zip(
            run.foci, run.target.points, run.reached, wanted, strict=True
        )
    ]
    return {
        "method": run.method,
        "headline": run.headline,
        "remarks": list(run.remarks),
        "foci": foci,
        "sensation": list(run.sensation),
        "estimated_error": run.comparison.report.estimated_error,
        "seconds": dict(run.seconds),
    }


def _table(run: "Rendered") -> "Table":
    """Tabulate what each focus gets, beside the control where there is one."""
    asked, names = run.target.pressures, run.comparison.names
    table = plain_table("focus", "pressure", *([] if asked is None else ["asked"]), *names[1:])
    scale = run.reached / run.comparison.pressures["equal energy"][0]
    for index, name in enumerate(run.foci):
        wanted = [] if asked is None else [f"{asked[index]:,.0f} Pa"]
        others = [
            f"{scale[index] * got[index]:,.0f} Pa"
            for got in run.comparison.pressures["equal energy"][1:]
        ]
        table.add_row(escape(name), f"{run.reached[index]:,.0f} Pa", *wanted, *others)
    return table
