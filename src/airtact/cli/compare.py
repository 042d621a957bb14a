"""``airtact compare``: the drive of a scene by every method."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from airtact.cli.console import open_page, plain_table, progress, show
from airtact.cli.options import as_json, open_result, pictures, quiet, results, scene, store

if TYPE_CHECKING:
    from rich.table import Table

    from airtact.reports.methods_page import Ranked


@click.command(
    short_help="Make the drive of a scene by all methods and compare them.",
    epilog="Example: airtact compare pinch --out out/methods",
)
@scene
@results
@store
@pictures
@open_result
@as_json
@quiet
def compare(scene: Path, folder: Path, store: Path | None, pictures: bool, opened: bool) -> None:
    """Make the drive of SCENE by every method, verify all, and write methods.csv, methods.html and drives/*.h5.

    All drives come from one transfer matrix and are verified by one more accurate solution.
    """
    with progress() as report_step:
        report_step("starting")
        from airtact.workflows import compare as workflow

        contest = workflow.compare(scene, folder, report_step, store, pictures=pictures)
    written = {
        name: str(folder / name) for name in (workflow.FILES if pictures else workflow.FILES[:1])
    }
    line = (
        f"Report: {folder / workflow.FILES[1]}"
        if pictures
        else f"Methods: {folder / workflow.FILES[0]}"
    )
    show(
        _table(contest),
        warnings=contest.notes,
        lines=[line],
        record={**_record(contest), "files": written},
    )
    if opened:
        open_page(folder / workflow.FILES[1])


def _record(contest: "Ranked") -> dict[str, Any]:
    """List what each method reached, best first, for ``--json``."""
    methods = [
        {
            "name": one.name,
            "pressures": one.pressures.tolist(),
            "of_the_bound": float(contest.of_the_bound(one)),
            "seconds": one.seconds,
            "kept": one.kept,
            "suppression_level": one.suppression_level,
        }
        for one in sorted(contest.contenders, key=contest.of_the_bound, reverse=True)
    ]
    error = contest.report.estimated_error
    facts = {"foci": list(contest.foci), "default": contest.default, "methods": methods}
    return {**facts, "bound": contest.bound, "estimated_error": error}


def _table(contest: "Ranked") -> "Table":
    """Tabulate what the worst focus gets by each method, best first."""
    suppressed = ["suppression points"] if len(contest.target.suppression_points) else []
    doubted = ["9 of 10 times"] if contest.contenders[0].kept is not None else []
    table = plain_table(
        "method", "worst focus", *doubted, "of the bound", "mean", "time", *suppressed
    )
    table.title = "What the foci get; of the bound: at full scale, over what no drive exceeds"
    for one in sorted(contest.contenders, key=contest.of_the_bound, reverse=True):
        worst, mean = one.pressures.min(), one.pressures.mean()
        share = contest.of_the_bound(one)
        level = [f"{one.suppression_level:+.1f} dB"] if suppressed else []
        time = f"{1e3 * one.seconds:,.3g} ms" if one.seconds < 1.0 else f"{one.seconds:.1f} s"
        kept = [] if one.kept is None else [f"{one.kept:,.0f} Pa"]
        table.add_row(
            contest.label(one),
            f"{worst:,.0f} Pa",
            *kept,
            f"{share:.0%}",
            f"{mean:,.0f} Pa",
            time,
            *level,
        )
    return table
