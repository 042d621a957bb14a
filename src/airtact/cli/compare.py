"""``airtact compare``: the drive of a scene by every method."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from airtact.cli.console import plain_table, progress, show
from airtact.cli.options import INPUT, results, store

if TYPE_CHECKING:
    from rich.table import Table

    from airtact.pages.methods_page import Contest


@click.command(
    short_help="Make the drive of a scene by all methods and compare them.",
    epilog="Example: airtact compare pinch --out out/methods",
)
@click.argument("scene", type=INPUT)
@results
@store
def compare(scene: Path, folder: Path, store: Path | None) -> None:
    """Make the drive of SCENE by every method, verify all, and write methods.csv, methods.html and drives/*.h5.

    All drives come from one transfer matrix and are verified by one more accurate solution.
    """
    with progress() as report_step:
        report_step("starting")
        from airtact.workflows import compare as workflow

        contest = workflow.compare(scene, folder, report_step, store)
    show(_table(contest), warnings=contest.notes, lines=[f"Report: {folder / 'methods.html'}"])


def _table(contest: "Contest") -> "Table":
    """Tabulate what the worst focus gets by each method, best first."""
    suppressed = ["suppression points"] if len(contest.target.suppression_points) else []
    table = plain_table("method", "worst focus", "of the bound", "mean", "time", *suppressed)
    table.title = "What the foci get; of the bound: at full scale, over what no drive exceeds"
    for one in sorted(contest.contenders, key=contest.of_the_bound, reverse=True):
        worst, mean = one.pressures.min(), one.pressures.mean()
        share = contest.of_the_bound(one)
        level = [f"{one.suppression_level:+.1f} dB"] if suppressed else []
        time = f"{1e3 * one.seconds:,.3g} ms" if one.seconds < 1.0 else f"{one.seconds:.1f} s"
        table.add_row(one.name, f"{worst:,.0f} Pa", f"{share:.0%}", f"{mean:,.0f} Pa", time, *level)
    return table
