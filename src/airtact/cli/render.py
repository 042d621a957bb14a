"""``airtact render``: from a scene file to the drive, the field and a page."""

from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.markup import escape

from airtact.cli.console import plain_table, progress, show
from airtact.cli.options import INPUT, results, store

if TYPE_CHECKING:
    from rich.table import Table

    from airtact.pages.run_page import Run


@click.command(
    short_help="Compute the drive and the field for a scene.",
    epilog="Example: airtact render pinch --out out/pinch",
)
@click.argument("scene", type=INPUT)
@results
@store
def render(scene: Path, folder: Path, store: Path | None) -> None:
    """Compute the drive and the field for SCENE and write drive.csv, drive.h5, field.vtkhdf and report.html.

    SCENE is a file, or one of the examples that come with airtact: air_letters, open_hand, palm_circle, pinch,
    pinch_pose, suppressed_pinch.
    """
    with progress() as report_step:
        report_step("starting")
        from airtact.workflows import render as workflow

        run = workflow.render(scene, folder, report_step, store)
    show(_table(run), warnings=run.notes, lines=[f"Report: {folder / 'report.html'}"])


def _table(run: "Run") -> "Table":
    """Tabulate what each focus gets, and how much of it is left where the drive ignores the hand."""
    ratios = {name: run.comparison.ratios(name)[1] for name in run.comparison.pressures}
    table = plain_table("focus", "pressure", *ratios)
    table.title = "Pressure at the foci, and pressure with the hand ignored over it"
    for index, name in enumerate(run.foci):
        shares = [f"{ratio[index]:.2f} ×" for ratio in ratios.values()]
        table.add_row(escape(name), f"{run.reached[index]:,.0f} Pa", *shares)
    return table
