"""``airtact export``: a drive or a sequence as the frames of a board, in a file."""

from pathlib import Path

import click

from airtact.cli.console import facts_table, show
from airtact.cli.options import FILE, drive_settings, level_of, modulation_of, quiet


@click.command(
    short_help="Write a drive or a sequence as a board's frames.",
    epilog="Example: airtact export out/pinch/drive.h5 --board autd3 --out frames.npz",
)
@drive_settings
@click.option(
    "--format",
    "kind",
    type=click.Choice(("npz", "csv", "h5", "bin")),
    help="Kind of file, if not its suffix.",
)
@click.option("--out", "file", required=True, type=FILE, help="File to write.")
@quiet
def export(
    drive: Path,
    board: str,
    cap: float | None,
    full_scale: bool,
    modulate: str | None,
    kind: str | None,
    file: Path,
) -> None:
    """Write DRIVE.h5 as the frames of a board: .npz, .csv, .h5, or .bin, the very bytes that it is sent.

    A modulated drive gives the frames of one period. They are at full scale unless --cap is given.
    """
    from airtact.workflows import export as workflow

    if kind is not None and file.suffix.lower() != f".{kind}":
        file = file.with_name(f"{file.name}.{kind}")
    share = level_of(cap, full_scale)
    plan, written = workflow.export(
        drive,
        board,
        file,
        1.0 if share is None else share,
        modulation_of(modulate),
        modulate == "none",
    )
    show(facts_table(plan.facts("file")), lines=[*plan.notes(), f"{written}: {file}"])
