"""The commands that concern boards: list them, emit, export."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from airtact.cli.console import plain_table, progress
from airtact.conventions import InvalidInput
from airtact.hardware.links import LINKS, links_of
from airtact.transducers.boards import BOARDS

if TYPE_CHECKING:
    from rich.table import Table

    from airtact.workflows.emit import Plan

BOARD_NAMES = tuple(BOARDS)
LINK_NAMES = tuple(link.name for link in LINKS)


@click.command(short_help="List the boards that can be spoken to.", epilog="Example: airtact boards")
def boards() -> None:
    """List the boards that can be spoken to: their transducers, levels and links, and the serial ports there are."""
    from rich.console import Console

    from airtact.transducers.boards import known_boards

    console = Console()
    table = plain_table("board", "elements", "levels", "a link")
    for board in known_boards():
        amplitudes = "on, off" if board.amplitudes == 2 else str(board.amplitudes)
        row = (str(len(board)), f"{amplitudes} x {board.phases} phases", f"1 to {board.most} boards")
        table.add_row(board.name, *row)
    console.print(table)
    for board in known_boards():
        console.print(
            f"{board.name}: {board.title}, by {', '.join(links_of(board.name))}", soft_wrap=True, highlight=False
        )
    console.print(f"Serial ports: {_ports()}", soft_wrap=True, highlight=False)


def _ports() -> str:
    try:
        from airtact.hardware.serial_link import serial_ports

        return ", ".join(serial_ports()) or "none"
    except ImportError:
        return "pyserial is not there to look for them: pip install 'airtact[serial]'"


def _drive_settings(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the drive and the board that it is for."""
    for option in (
        click.option(
            "--cap", type=float, default=100.0, help="Loudest an element may be, in per cent; 100 by default."
        ),
        click.option("--board", required=True, type=click.Choice(BOARD_NAMES), help="Kind of board."),
        click.argument("drive", metavar="DRIVE.h5", type=click.Path(path_type=Path)),
    ):
        command = option(command)
    return command


@click.command(
    short_help="Play a drive or a sequence on boards.",
    epilog="Example: airtact emit out/pinch/drive.h5 --board autd3 --link audit --yes --seconds 2",
)
@_drive_settings
@click.option("--link", required=True, type=click.Choice(LINK_NAMES), help="Way to the boards.")
@click.option("--seconds", type=float, default=2.0, help="How long; 2 by default.")
@click.option("--yes", is_flag=True, help="Emit without asking.")
@click.option("--address", help="Interface, AMS net id or host:port, for AUTD3.")
@click.option("--port", help="Serial port, for SonicSurface and Nano16.")
@click.option("--out", type=click.Path(path_type=Path), help="File, for --link file: .npz, .csv, .h5 or .bin.")
def emit(drive: Path, board: str, link: str, cap: float, seconds: float, yes: bool, **where: Any) -> None:
    """Play DRIVE.h5 on boards for some seconds, then silence them.

    The amplitude rises over 0.2 s. At the end, at Ctrl-C, when the process is told to end and when anything goes wrong
    a frame of zeros is sent and confirmed as far as the boards can.
    """
    from rich.console import Console

    from airtact.validation import positive
    from airtact.workflows.emit import emit as run
    from airtact.workflows.emit import link_for, plan

    positive(seconds, "how long to emit", "s")
    made = plan(drive, board, cap)
    way = link_for(made, link, **where)
    console = Console()
    console.print(_plan_table(made, link))
    _print_warnings(made, console)
    if not yes:
        _ask(f"Emit for {seconds:g} s through {link} to {way.devices}?")
    with progress() as report_step:
        played = run(made, way, seconds, report_step)
    console.print(f"{way.sent} frames were sent; the last was silence, {_confirmed(link, board)}.", highlight=False)
    if played is not None:
        console.print(
            f"The sequence was played at {played.rate:.4g} frames/s, {played.frames} frames, {played.dropped} dropped.",
            highlight=False,
        )


@click.command(
    short_help="Write a drive or a sequence as a board's frames.",
    epilog="Example: airtact export out/pinch/drive.h5 --board openmpd --format bin --out frames.bin",
)
@_drive_settings
@click.option(
    "--format", "kind", type=click.Choice(("npz", "csv", "h5", "bin")), help="Kind of file, if not its suffix."
)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="File to write.")
def export(drive: Path, board: str, cap: float, kind: str | None, out: Path) -> None:
    """Write DRIVE.h5 as the frames of a board: .npz, .csv, .h5, or .bin, the very bytes that it is sent."""
    from rich.console import Console

    from airtact.workflows.emit import export as run
    from airtact.workflows.emit import plan

    if kind is not None and out.suffix.lower() != f".{kind}":
        out = out.with_name(f"{out.name}.{kind}")
    made = plan(drive, board, cap)
    done = run(made, out)
    console = Console()
    console.print(_plan_table(made, "file"))
    console.print(f"{done}: {out}", soft_wrap=True, highlight=False)


def _plan_table(made: "Plan", link: str) -> "Table":
    """Say what would be emitted."""
    import numpy as np

    stored = made.stored
    table = plain_table("", "")
    elements = stored.drives.shape[1]
    table.add_row("boards", f"{len(made.poses)} {made.board.title}, {elements} transducers, through {link}")
    if stored.rate is not None and len(stored.drives) > 1:
        table.add_row("sequence", f"{len(stored.drives)} frames at {stored.rate:g} frames/s")
    levels = "on and off" if made.board.amplitudes == 2 else f"{made.board.amplitudes} amplitudes"
    table.add_row("levels", f"{levels}, {made.board.phases} phases")
    if made.rounding is not None:
        worst = float(made.rounding[np.abs(made.rounding).argmax()])
        held = " at equal energy" if made.board.amplitudes == 2 else ""
        table.add_row("rounding", f"{worst:+.2%} at the focus that it changes most{held}")
    loudest = float(np.abs(stored.drives).max())
    table.add_row("loudest", f"{100 * loudest:.3g} % of full scale, cap {made.cap:g} %")
    table.add_row("at a head", f"up to {made.head:.0f} dB SPL, 0.5 m off the array in open air")
    return table


def _print_warnings(made: "Plan", console: Any) -> None:
    from airtact.evaluation.thresholds import NO_SAFETY_ASSESSMENT

    console.print(NO_SAFETY_ASSESSMENT, highlight=False)


def _ask(question: str) -> None:
    """Ask before anything is emitted; without somebody to answer, refuse."""
    if not sys.stdin.isatty():
        raise InvalidInput("nobody is there to be asked, and 0 frames were sent: give --yes to emit without asking.")
    if not click.confirm(question, default=False):
        raise InvalidInput("0 frames were sent, as you answered no.")


def _confirmed(link: str, board: str) -> str:
    if link == "serial" and board == "sonicsurface":
        return "let out by the port (a SonicSurface never answers)"
    return "and confirmed" if link != "file" else "and written"
