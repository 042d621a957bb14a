"""``airtact listen``: record the hands that trackers send."""

from pathlib import Path

import click

from airtact.cli.console import progress, show
from airtact.cli.options import FILE, quiet


@click.command(
    short_help="Record the hands that trackers send.",
    epilog="Example: airtact listen --seconds 10 --out session.jsonl",
)
@click.option(
    "--seconds", type=float, required=True, help="How long to listen; Ctrl-C ends it early."
)
@click.option(
    "--websocket",
    type=int,
    default=8765,
    show_default=True,
    help="Port for frames in JSON by websocket.",
)
@click.option("--osc", type=int, help="Port for OSC over UDP; none unless given.")
@click.option("--out", "file", required=True, type=FILE, help="Recording: .jsonl or .npz.")
@quiet
def listen(seconds: float, websocket: int, osc: int | None, file: Path) -> None:
    """Receive frames from trackers on this computer and write them to a recording.

    Frames that cannot be used are left out and counted. Port 0 takes any free port and shows its
    number.
    """
    from airtact.workflows import listen as workflow

    with progress() as report_step:
        health = workflow.listen(file, seconds, websocket, osc, report_step)
    show(lines=[f"Messages: {health}", f"Recording: {file}"])
