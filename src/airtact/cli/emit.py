"""``airtact emit``: a drive or a sequence on boards."""

from pathlib import Path
from typing import Any

import click

from airtact.cli.console import facts_table, progress, show
from airtact.cli.options import (
    FILE,
    Names,
    agreed,
    board_address,
    drive_settings,
    level_of,
    modulation_of,
    quiet,
)


@click.command(
    short_help="Emit a drive or a sequence on boards.",
    epilog="Example: airtact emit out/pinch/drive.h5 --board autd3 --link audit --yes --seconds 2",
)
@drive_settings
@click.option(
    "--link", required=True, type=Names("airtact.emission.links:LINKS"), help="Way to the boards."
)
@click.option("--seconds", type=float, default=2.0, help="How long; 2 by default.")
@click.option("--yes", is_flag=True, help="Emit without asking.")
@board_address
@click.option("--out", type=FILE, help="File, for --link file: .npz, .csv, .h5 or .bin.")
@click.option(
    "--log", type=FILE, help="File for a line on each event: what the boards got, and when."
)
@quiet
def emit(
    drive: Path,
    board: str,
    cap: float | None,
    full_scale: bool,
    modulate: str | None,
    link: str,
    seconds: float,
    yes: bool,
    log: Path | None,
    **where: Any,
) -> None:
    """Emit DRIVE.h5 on boards for some seconds, then silence them.

    Without --cap and --full-scale the level half a metre off the array is kept to 110 dB, a usual
    limit. The amplitude rises over 0.2 s. At the end, when anything fails, and whatever ends this
    process, a process of the link's own sends a frame of zeros, confirmed as far as the boards can.
    """
    from airtact.checks import counted, positive
    from airtact.evaluation.head_level import NO_SAFETY_ASSESSMENT
    from airtact.workflows import emit as workflow

    positive(seconds, "how long to emit", "s")
    share = level_of(cap, full_scale)
    if share is None and link == "file":
        share = workflow.FULL  # a file emits nothing
    plan = workflow.plan(drive, board, share, modulation_of(modulate), modulate == "none")
    way = workflow.link_for(plan, link, **where)
    show(facts_table(plan.facts(link)), lines=[NO_SAFETY_ASSESSMENT, *plan.notes()])
    if not yes:
        agreed(f"Emit for {seconds:g} s through {link} to {way.devices}?")
    with progress() as report_step:
        played = workflow.emit(plan, way, seconds, report_step, log)
    if way.real_time:
        unanswered = link == "serial" and board == "sonicsurface"
        confirmed = (
            "written to the port (a SonicSurface never answers)" if unanswered else "and confirmed"
        )
        show(
            lines=[
                f"{counted(way.sent, 'frame was', 'frames were')} sent; the last was silence, {confirmed}."
            ]
        )
    else:
        show(lines=[f"{counted(way.sent, 'frame was', 'frames were')} written."])
    if played is not None:
        what = "sequence" if plan.modulation is None else "modulated drive"
        rate = f"The {what} was played at {played.rate:.4g} frames/s"
        show(lines=[f"{rate}, {played.frames} frames, {played.dropped} dropped."])
