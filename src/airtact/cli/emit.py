"""``airtact emit``: emit a drive or a sequence on boards."""

from pathlib import Path
from typing import Any

import click

import airtact as at
from airtact.cli.console import facts_table, progress, show
from airtact.cli.options import FILE, Names, agreed, board_address, level_of, quiet


@click.command(
    short_help="Emit a drive or a sequence on boards.",
    epilog="Example: airtact emit out/pinch/drive.h5 --board autd3 --link audit --yes --seconds 2",
)
@click.argument("drive", metavar="DRIVE.h5", type=FILE)
@click.option(
    "--board",
    required=True,
    type=Names("airtact.transducers.boards:BOARDS"),
    help="Kind of board.",
)
@click.option("--cap", type=float, help="Largest amplitude relative to full scale: 0.5 is half.")
@click.option("--full-scale", is_flag=True, help="Emit at full scale, like --cap 1.")
@click.option(
    "--modulate",
    help="Modulation: am:FREQUENCY or am:FREQUENCY:DEPTH, such as am:200, or none.",
)
@click.option(
    "--link",
    required=True,
    type=Names("airtact.emission.links:LINKS", "file"),
    help='Link to the boards; "file" writes the frames to a file.',
)
@click.option(
    "--seconds",
    type=float,
    help="Duration in seconds; by default 2, or one period or cycle with --link file.",
)
@click.option("--yes", is_flag=True, help="Emit without asking for confirmation.")
@board_address
@click.option("--out", type=FILE, help="File to write with --link file: .h5 or .bin.")
@click.option(
    "--log", type=FILE, help="Log file with one line per event: the time and what was sent."
)
@quiet
def emit(
    drive: Path,
    board: str,
    cap: float | None,
    full_scale: bool,
    modulate: str | None,
    link: str,
    seconds: float | None,
    yes: bool,
    out: Path | None,
    log: Path | None,
    **settings: Any,
) -> None:
    """Emit DRIVE.h5 on boards for a few seconds, then silence them.

    Without --cap and --full-scale, the level half a metre from the array is limited to
    110 dB. The amplitude ramps up over 0.2 s. A separate process sends a frame of zeros
    at the end, after an error, and if the command is killed. Boards confirm this frame
    if they can.

    --link file writes the frames to the file --out, at full scale and without confirmation. It
    writes one frame of a drive, one period of a modulated drive, or one cycle of a sequence;
    --seconds sets another duration.
    """
    from airtact.drives.head_level import NO_SAFETY_ASSESSMENT
    from airtact.emission.links import link_to
    from airtact.errors import counted, positive
    from airtact.setup import safe_emission

    if seconds is not None:
        positive(seconds, "the duration", "s")
    if (link == "file") != (out is not None):
        raise at.InvalidInput(
            "--link file and --out FILE must be used together: set both or neither.",
            code="key_missing" if out is None else "options_clash",
        )
    share = level_of(cap, full_scale)
    if share is None and out is not None:
        share = 1.0  # a file emits nothing
    plan = safe_emission.plan(drive, board, share, _modulation(modulate), modulate == "none")
    notes = [NO_SAFETY_ASSESSMENT, *plan.notes()]
    if out is not None:
        count, rate = safe_emission.write(plan, out, seconds)
        words = f"{counted(count, 'frame was', 'frames were')} written to {out}"
        at_rate = "." if rate is None else f" at {rate:g} frames/s."
        show(facts_table(plan.facts(link)), lines=[*notes, words + at_rate])
        return
    to_boards = link_to(
        link, board, plan.poses, safe_emission.sound_speed_of(plan.stored), **settings
    )
    seconds = seconds or 2.0
    show(facts_table(plan.facts(link)), lines=notes)
    if not yes:
        agreed(f"Emit for {seconds:g} s through {link} to {to_boards.devices}?")
    with progress() as report_step:
        played = safe_emission.emit(plan, to_boards, seconds, report_step, log)
    unconfirmed = link == "serial" and board == "sonicsurface"
    lines = [
        f"{counted(to_boards.sent, 'message was', 'messages were')} sent. The last one silences "
        f"the boards, which {'a SonicSurface cannot confirm' if unconfirmed else 'confirmed it'}."
    ]
    if played is not None:
        kind = "sequence" if plan.modulation is None else "modulated drive"
        lines.append(
            f"The {kind} was played at {played.rate:.4g} frames/s: {played.frames} frames, "
            f"{played.dropped} dropped."
        )
    show(lines=lines)


def _modulation(words: str | None) -> Any:
    # None keeps the modulation in the file; "none" is handled by the plan.
    if words in (None, "none"):
        return None
    kind, *numbers = words.split(":")
    try:
        if kind != "am" or len(numbers) > 2:
            raise ValueError
        values = [float(number) for number in numbers]
    except ValueError:
        raise at.InvalidInput(
            f"--modulate {words} is not valid: use none, or am with up to 2 numbers, such as "
            "am:200 or am:200:0.5.",
            code="unknown_name",
        ) from None
    return at.transducers.AmplitudeModulation(*values)
