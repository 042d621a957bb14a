"""``airtact bench``: times and errors, beside other packages."""

from pathlib import Path

import click

from airtact.cli.console import progress, show
from airtact.cli.options import INPUT, quiet, results


@click.command(
    short_help="Measure times and errors, beside other packages.",
    epilog="Example: airtact bench --out out/bench --hand relaxed.json",
)
@results
@click.option(
    "--acoustools", metavar="PYTHON", help="Interpreter of an environment with AcousTools."
)
@click.option("--bempp", metavar="PYTHON", help="Interpreter of an environment with bempp-cl.")
@click.option("--hand", type=INPUT, help="Pose of an open hand, .json, for its rows.")
@click.option("--quick", is_flag=True, help="Do less of everything.")
@quiet
def bench(
    folder: Path, acoustools: str | None, bempp: str | None, hand: Path | None, quick: bool
) -> None:
    """Measure the speed and the accuracy of airtact, beside other packages if their interpreters are given.

    Writes bench.csv, bench.json, performance.md, error_against_time and growth (.png, .svg).
    Reference solutions take minutes the first time and are stored in the folder.
    """
    with progress() as report_step:
        report_step("starting")
        from airtact.workflows import bench as workflow

        page, notes = workflow.bench(folder, acoustools, bempp, hand, quick, report_step)
    click.echo(page.read_text(encoding="utf-8"))
    show(warnings=notes, lines=[f"Report: {page}"])
