"""``airtact live``: make the sound follow a moving hand."""

from pathlib import Path
from typing import Any

import click

import airtact as at
from airtact.cli.console import facts_table, plain_table, progress, show, status_line
from airtact.cli.options import FILE as OUT_FILE
from airtact.cli.options import (
    INPUT,
    Names,
    agreed,
    as_json,
    board_address,
    level_of,
    page_address,
    quiet,
    results,
)


@click.command(
    short_help="Make the sound follow a moving hand.",
    epilog="Example: airtact live live_pinch --seconds 5 --no-page --out out/live",
)
@click.argument("scene", type=INPUT, default="live_pinch")
@results
@click.option(
    "--from",
    "source",
    metavar="FILE.jsonl|SESSION.h5|websocket|osc|page",
    help="Source of the hand: a recording, the session of an earlier run, trackers and "
    "applications (websocket:PORT or osc:PORT; the default ports are 8765 and 8766), or page to "
    "move the hand on the page or with a headset. By default, an example motion.",
)
@click.option(
    "--seconds",
    type=float,
    help="Duration in seconds; by default until Ctrl-C or the end of the recording.",
)
@click.option(
    "--record",
    "recording",
    type=OUT_FILE,
    help="Record the frames received by --from websocket or osc to a .jsonl file, without drives.",
)
@click.option(
    "--verify",
    "session",
    type=OUT_FILE,
    help="Verify ten drives of an earlier session (session.h5 or its folder); each takes seconds.",
)
@click.option(
    "--latency",
    type=float,
    default=0.0,
    help="Smallest delay between the tracker's picture and the emission, in seconds; 0 by default.",
)
@click.option(
    "--ignore-hand",
    is_flag=True,
    help="Ignore the hand: compute drives from distances only.",
)
@click.option("--full-scale", is_flag=True, help="Emit at full scale, like --cap 1.")
@click.option("--cap", type=float, help="Largest amplitude relative to full scale: 0.5 is half.")
@click.option(
    "--board",
    type=Names("airtact.transducers.boards:BOARDS"),
    help="Kind of board; by default, nothing is emitted.",
)
@click.option("--link", type=Names("airtact.emission.links:LINKS"), help="Link to the boards.")
@click.option("--yes", is_flag=True, help="Emit without asking for confirmation.")
@board_address
@click.option(
    "--no-page", "page", is_flag=True, flag_value=False, default=True, help="Do not serve the page."
)
@page_address
@click.option(
    "--certificate",
    type=INPUT,
    help="PEM file with a certificate and its key, to serve the page over HTTPS for headsets.",
)
@as_json
@quiet
def live(
    scene: Path,
    folder: Path,
    source: str | None,
    recording: Path | None,
    session: Path | None,
    seconds: float | None,
    latency: float,
    ignore_hand: bool,
    cap: float | None,
    full_scale: bool,
    board: str | None,
    link: str | None,
    yes: bool,
    page: bool,
    page_port: int,
    host: str,
    certificate: Path | None,
    **settings: Any,
) -> None:
    """Make the sound follow the hand of SCENE, and record the run in session.h5.

    SCENE is a scene file or the name of an example, by default live_pinch. Its foci are points
    where hands touch [[objects]], as in touch_ball and touch_button, or named points of a hand,
    such as at = "thumb.pad". Without --board, drives are computed and recorded, but nothing is
    emitted. The sound fades to silence if the hand is lost, leaves the workspace, or is not seen
    for 150 ms. Without --cap and --full-scale, the level half a metre from the array is limited to
    110 dB. Ctrl-C ends the run and silences the boards. The file session.h5 is written to the
    folder --out.

    --record writes the frames from trackers to a recording and does not read SCENE. --verify
    evaluates ten drives of a recorded session with an accurate solve for the hand, and compares
    them with the best possible drives.
    """
    share = level_of(cap, full_scale)
    if session is not None:
        with progress(f"reading {session}") as report_step:
            recorded = at.live.read_session(session)
            verified = at.live.verify_session(recorded, report_step=report_step)
        table = plain_table("emitted at", "based on", "weakest focus", "of the attainable")
        rows = []
        for index, pressures, kept in zip(
            verified.indices, verified.pressures.tolist(), verified.kept.tolist(), strict=True
        ):
            # Drives with fewer foci than others are padded with NaN.
            pressures = [pressure for pressure in pressures if pressure == pressure]
            time = float(recorded.time_in_air[index] - recorded.time_in_air[0])
            table.add_row(
                f"{time:.2f} s",
                recorded.rules[index],
                f"{min(pressures):,.0f} Pa",
                f"{kept:.0%}",
            )
            rows.append({"index": index, "time": time, "pressures": pressures, "kept": kept})
        show(table, record={"foci": list(recorded.scene.places), "verified": rows})
        return
    if recording is not None:
        with progress() as report_step:
            health = at.live.record(recording, source or "websocket", seconds, report_step)
        show(lines=[f"Messages: {health}", f"Recording: {recording}"])
        return
    with progress("reading the scene") as report_step:
        from airtact.drives.frame import check_cap
        from airtact.drives.head_level import MAX_HEAD_LEVEL, NO_SAFETY_ASSESSMENT
        from airtact.files.atomic import writable_folder
        from airtact.live.session import FILE

        # Check these settings before connecting to trackers and boards.
        if share is not None:
            check_cap(share)
        setup = at.read_scene(scene, moving=True)
        writable_folder(folder)
        output = at.live.output_to(setup, folder, board, link, **settings)
        notes = []
        # The level changes with the hand, so estimate it for the hand at rest.
        if share is None and board is not None:
            from airtact.setup.safe_emission import safe_cap

            report_step("choosing the cap for 110 dB at a head")
            share, full = safe_cap(at.live.drive_at_rest(setup), board)
            if share < 1.0:
                notes.append(
                    f"The cap of {share:g} limits the level at a head to {MAX_HEAD_LEVEL:g} dB for "
                    f"the hand at rest. --full-scale emits up to {full:.0f} dB; --cap sets another "
                    "limit."
                )
        hands = at.live.hands_from(setup, source, folder)
    if board is not None:
        show(lines=[NO_SAFETY_ASSESSMENT, *notes])
        if not yes:
            agreed(f"Follow {hands.words}, {output.words}?")
    with status_line() as report:
        done = at.live.run(
            setup,
            hands,
            output,
            folder=folder,
            seconds=seconds,
            latency=latency,
            cap=1.0 if share is None else share,
            ignore_hand=ignore_hand,
            page=(page_port, host) if page else None,
            certificate=certificate,
            report_step=report,
            report=report,
        )
    show(
        facts_table(done.facts()),
        lines=[f"Session: {folder / FILE}"],
        record={**done.record(), "files": {"session": str(folder / FILE)}},
    )
