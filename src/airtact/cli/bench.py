"""The command that measures airtact beside other packages."""

from pathlib import Path

import click

from airtact.cli.console import progress, warn


@click.command(
    short_help="Measure times and errors, beside other packages.",
    epilog="Example: airtact bench --out out/bench --hand examples/hands/relaxed.json",
)
@click.option("--out", "folder", required=True, type=click.Path(path_type=Path), help="Folder for the results.")
@click.option("--acoustools", metavar="PYTHON", help="Interpreter of an environment with AcousTools.")
@click.option("--bempp", metavar="PYTHON", help="Interpreter of an environment with bempp-cl.")
@click.option("--hand", type=click.Path(path_type=Path), help="Pose of an open hand, .json, for its rows.")
@click.option("--quick", is_flag=True, help="Do less of everything.")
def bench(folder: Path, acoustools: str | None, bempp: str | None, hand: Path | None, quick: bool) -> None:
    """Measure how quick airtact is and how right, beside other packages if their interpreters are given.

    Writes bench.csv, bench.json, performance.md, error_against_time and growth (.png, .svg). Truths take minutes the
    first time and are kept in the folder.
    """
    from rich.console import Console

    with progress() as report_step:
        report_step("starting")
        from airtact.benching.bench import bench as run
        from airtact.benching.performance_page import page_of

        found = run(folder, acoustools, bempp, hand, quick, report_step)
    console = Console()
    console.print(page_of(found), markup=False, highlight=False, soft_wrap=True)
    warn(console, found.notes)
    console.print(f"The page: {folder / 'performance.md'}", soft_wrap=True, highlight=False)
