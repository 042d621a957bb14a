"""Commands for hands that move: to record what trackers send, and to show a recording."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from airtact.cli.console import progress

if TYPE_CHECKING:
    from rich.table import Table

    from airtact.workflows.recording import Replayed


def show_recording(path: Path, file: Path, chosen: tuple[int, ...], leave_out: bool, edge: float | None) -> None:
    """Show the pads of a recording over time and write skins; ``airtact hand`` does it for recordings.

    Parameters
    ----------
    path, file, chosen, leave_out : see ``replay_recording``.
    edge : of the triangles [m], or None.
    """
    from rich.console import Console

    with progress() as report_step:
        from airtact.files.panels import EDGE
        from airtact.workflows.recording import replay_recording

        replayed = replay_recording(path, file, chosen, leave_out, EDGE if edge is None else edge, report_step)
    console = Console()
    console.print(_facts(replayed))
    skins = ", ".join(str(skin) for skin in replayed.skins)
    console.print(f"The skin: {skins}; the pads over time: {replayed.picture}", soft_wrap=True, highlight=False)


def _facts(replayed: "Replayed") -> "Table":
    from rich.box import SIMPLE
    from rich.table import Table

    table = Table(box=SIMPLE, show_header=False)
    table.add_row("messages", str(replayed.recording.health))
    for track in replayed.tracks:
        lasts = track.times[-1] - track.times[0]
        about = f"{len(track.times):,} frames in {lasts:.2f} s, the longest gap {1e3 * track.longest_gap:.0f} ms"
        table.add_row(f"{track.side} hand", f"{about}, pads at most {track.fastest:.2f} m/s")
    return table


@click.command(
    short_help="Record the hands that trackers send.",
    epilog="Example: airtact listen --seconds 10 --out session.jsonl",
)
@click.option("--seconds", type=float, required=True, help="How long to listen.")
@click.option("--websocket", type=int, default=8765, show_default=True, help="Port for frames in JSON by websocket.")
@click.option("--osc", type=int, help="Port for OSC over UDP; none unless given.")
@click.option("--out", "file", required=True, type=click.Path(path_type=Path), help="Recording: .jsonl or .npz.")
def listen(seconds: float, websocket: int, osc: int | None, file: Path) -> None:
    """Listen to trackers on this computer and write the frames that they send to a recording.

    Frames that cannot be used are left out and counted. Port 0 takes any that is free and says which.
    """
    from contextlib import ExitStack

    from airtact.conventions import InvalidInput
    from airtact.tracking.frame import HandFrame
    from airtact.tracking.receivers import OscReceiver, WebSocketReceiver
    from airtact.tracking.recordings import ENDINGS, save_recording
    from airtact.tracking.stream import HandStream
    from airtact.validation import positive

    positive(seconds, "the time to listen", "s")
    if file.suffix not in ENDINGS:
        raise InvalidInput(f"the ending {file.suffix!r} is not 1 of those of recordings: {', '.join(ENDINGS)}.")
    frames: list[HandFrame] = []
    stream = HandStream(heard=frames.append)
    with ExitStack() as open_sockets:
        ports = [f"ws://127.0.0.1:{open_sockets.enter_context(WebSocketReceiver(stream, websocket)).port}"]
        if osc is not None:
            ports.append(f"OSC at 127.0.0.1:{open_sockets.enter_context(OscReceiver(stream, osc)).port}")
        click.echo(f"listening for {seconds:g} s: {', '.join(ports)}", err=True)
        _wait(seconds)
    click.echo(f"Heard: {stream.health}")
    if not frames:
        raise InvalidInput(f"0 frames were heard in {seconds:g} s ({', '.join(ports)}): does the tracker send there?")
    save_recording(file, frames)
    click.echo(f"The recording: {file}")


def _wait(seconds: float) -> None:
    """Wait, or less where Ctrl-C says that it is enough: what was heard is kept."""
    try:
        time.sleep(seconds)
    except KeyboardInterrupt:
        click.echo("enough", err=True)
