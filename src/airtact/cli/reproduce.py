"""``airtact reproduce``: a published experiment, computed again."""

from pathlib import Path

import click

import airtact as at
from airtact.cli.console import open_page, progress, show
from airtact.cli.options import Names, open_result, quiet, results


@click.command(
    short_help="Compute a paper's experiment again and write a page about it.",
    epilog="Example: airtact reproduce inoue2014 --out out/inoue2014 --quick",
)
@click.argument("paper", type=Names("airtact.experiments:PAPERS"))
@results
@click.option(
    "--quick", is_flag=True, help="Do less of everything, in about three minutes instead of twenty."
)
@open_result
@quiet
def reproduce(paper: str, folder: Path, quick: bool, opened: bool) -> None:
    """Compute the experiment of PAPER again and write index.html, with the numbers behind each figure in data/.

    inoue2014: S. Inoue, Y. Makino, H. Shinoda, "Producing Airborne Ultrasonic 3D Tactile Image by
    Time Reversal Field Rendering", SICE 2014. Up to twenty minutes on two cores. The page is
    written after each part, so that Ctrl-C or a part that fails leaves all that was done before.
    """
    with progress() as report_step:
        report_step(f"starting {paper}")
        from airtact.workflows import reproduce as workflow

        done = workflow.reproduce(paper, folder, quick, report_step)
    facts = [f"{number:>8}  {what}" for number, what in done.facts]
    show(lines=[*facts, f"Report: {done.page} ({done.seconds:.0f} s)"])
    if opened:
        open_page(done.page)
    if done.failed:
        title, why = next(iter(done.failed.items()))
        raise at.NotConverged(
            f"{len(done.failed)} of the parts failed, the others are on the page; {title!r}: {why}",
            code="child_failed",
        )
