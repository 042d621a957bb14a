"""``airtact export``: a drive or a sequence as the frames of a board, in a file."""

from pathlib import Path

import click

from airtact.cli.console import facts_table, show
from airtact.cli.options import FILE, drive_settings, quiet


@click.command(
    short_help="Write a drive or a sequence as a board's frames.",
    epilog="Example: airtact export out/pinch/drive.h5 --board openmpd --format bin --out frames.bin",
)
@drive_settings
@click.option(
    "--format", "kind", type=click.Choice(("npz", "csv", "h5", "bin")), help="Kind of file, if not its suffix."
)
@click.option("--out", "file", required=True, type=FILE, help="File to write.")
@quiet
def export(drive: Path, board: str, cap: float, kind: str | None, file: Path) -> None:
    """Write DRIVE.h5 as the frames of a board: .npz, .csv, .h5, or .bin, the very bytes that it is sent."""
    from airtact.workflows import export as workflow

    if kind is not None and file.suffix.lower() != f".{kind}":
        file = file.with_name(f"{file.name}.{kind}")
    plan, written = workflow.export(drive, board, file, cap)
    show(facts_table(plan.facts("file")), lines=[f"{written}: {file}"])
