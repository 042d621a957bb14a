"""``airtact live``: the sound follows a hand that moves."""

from pathlib import Path
from typing import Any

import click

from airtact.cli.console import facts_table, progress, show, status_line
from airtact.cli.options import FILE as OUT_FILE
from airtact.cli.options import (
    INPUT,
    Names,
    agreed,
    as_json,
    board_address,
    level_of,
    quiet,
    results,
)

EXAMPLE = "live_pinch"
"""The scene that is followed unless one is named."""


@click.command(
    short_help="Let the sound follow a hand that moves.",
    epilog="Example: airtact live live_pinch --seconds 5 --no-page --out out/live",
)
@click.argument("scene", type=INPUT, default=EXAMPLE)
@results
@click.option(
    "--from",
    "source",
    metavar="FILE.jsonl|SESSION.h5|websocket|osc|page",
    help="Where the hand comes from: a recording, another run's session, trackers (websocket:PORT for another port "
    "than 8765, osc:PORT than 9000), or the page; a motion that comes along by default.",
)
@click.option(
    "--seconds", type=float, help="How long; until Ctrl-C, or the end of the recording, by default."
)
@click.option(
    "--record",
    "recording",
    type=OUT_FILE,
    help="Make no drives; record what trackers send to --from websocket or osc: .jsonl or .npz.",
)
@click.option(
    "--latency",
    type=float,
    default=0.0,
    help="Least time from picture to frame in seconds; 0 by default.",
)
@click.option("--ignore-hand", is_flag=True, help="Make drives from distances alone.")
@click.option("--full-scale", is_flag=True, help="Emit at full scale: --cap 1.")
@click.option(
    "--cap", type=float, help="Largest amplitude of an element, a share of full scale: 0.5 is half."
)
@click.option(
    "--board",
    type=Names("airtact.transducers.boards:BOARDS"),
    help="Kind of board; none by default.",
)
@click.option("--link", type=Names("airtact.emission.links:LINKS"), help="Way to the boards.")
@click.option("--yes", is_flag=True, help="Emit without asking.")
@board_address
@click.option(
    "--no-page", "page", is_flag=True, flag_value=False, default=True, help="Do not serve the page."
)
@click.option(
    "--page-port",
    type=int,
    default=8940,
    show_default=True,
    help="Port of the page; 0 takes a free one.",
)
@click.option(
    "--host", default="127.0.0.1", show_default=True, help="Address that the page is served at."
)
@as_json
@quiet
def live(
    scene: Path,
    folder: Path,
    recording: Path | None,
    seconds: float | None,
    latency: float,
    ignore_hand: bool,
    cap: float | None,
    full_scale: bool,
    yes: bool,
    page: bool,
    page_port: int,
    host: str,
    **settings: Any,
) -> None:
    """Let the sound follow the hand of SCENE, frame by frame, and record what is done in session.h5.

    SCENE is the example live_pinch by default. Its foci must ride on a hand (at = "thumb.pad"). A
    hand that is lost, leaves the workspace or is not seen for 150 ms fades to silence. Without
    --cap and --full-scale the level half a metre off the array is kept to 110 dB. Ctrl-C ends it in
    silence. --record writes the frames of trackers to a recording instead; SCENE is not read then.
    """
    from airtact.checks import positive

    share = level_of(cap, full_scale)
    if seconds is not None:
        positive(seconds, "how long to go on", "s")
    if recording is not None:
        from airtact.live.running import record

        with progress() as report_step:
            health = record(recording, settings["source"] or "websocket", seconds, report_step)
        show(lines=[f"Messages: {health}", f"Recording: {recording}"])
        return
    with progress() as report_step:
        report_step("starting")
        from airtact.evaluation.head_level import NO_SAFETY_ASSESSMENT
        from airtact.live.running import run
        from airtact.live.session import FILE
        from airtact.workflows import live as workflow

        made = workflow.prepare(scene, folder, cap=share, report_step=report_step, **settings)
    if settings["board"] is not None:
        show(lines=[NO_SAFETY_ASSESSMENT, *made.notes])
        if not yes:
            agreed(f"Let the sound follow {made.hands.words}, {made.output.words}?")
    with status_line() as report:
        done = run(
            made.setup,
            made.hands,
            made.output,
            folder=folder,
            seconds=seconds,
            latency=latency,
            cap=made.cap,
            ignore_hand=ignore_hand,
            page=(page_port, host) if page else None,
            report_step=report,
            report=report,
        )
    session = str(folder / FILE)
    show(
        facts_table(done.facts()),
        lines=[f"Session: {session}"],
        record={**done.record(), "files": {"session": session}},
    )
