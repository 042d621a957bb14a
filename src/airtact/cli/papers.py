"""The command that does a published experiment again."""

from pathlib import Path

import click

from airtact.cli.console import progress
from airtact.conventions import NotConverged

PAPERS = ("inoue2014",)


@click.command(
    short_help="Do a paper's experiment again and write a page about it.",
    epilog="Example: airtact reproduce inoue2014 --out out/inoue2014 --quick",
)
@click.argument("paper", type=click.Choice(PAPERS))
@click.option("--out", "folder", required=True, type=click.Path(path_type=Path), help="Folder for the results.")
@click.option("--quick", is_flag=True, help="Do less of everything, in about three minutes in place of twenty.")
def reproduce(paper: str, folder: Path, quick: bool) -> None:
    """Do the experiment of PAPER again and write index.html, with the numbers behind each figure in data/.

    inoue2014: S. Inoue, Y. Makino, H. Shinoda, "Producing Airborne Ultrasonic 3D Tactile Image by Time Reversal Field
    Rendering", SICE 2014. Up to twenty minutes on two cores. The page is written after each part, so that Ctrl-C or a
    part that fails leaves all that was done before.
    """
    from rich.console import Console

    with progress() as report_step:
        report_step(f"starting {paper}")
        from airtact.experiments.inoue2014 import reproduce as run

        done = run(folder, quick, report_step)
    console = Console()
    for number, what in done.facts:
        console.print(f"{number:>8}  {what}", highlight=False)
    console.print(f"The page: {done.page} ({done.seconds:.0f} s)", soft_wrap=True, highlight=False)
    if done.failed:
        title, why = next(iter(done.failed.items()))
        raise NotConverged(f"{len(done.failed)} of the parts failed, the others are on the page; {title!r}: {why}")
