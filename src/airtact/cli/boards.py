"""``airtact boards``: the boards that a drive can be sent to."""

import click

from airtact.cli.console import plain_table, show
from airtact.cli.options import as_json, quiet


@click.command(short_help="List the boards that can be driven.", epilog="Example: airtact boards")
@as_json
@quiet
def boards() -> None:
    """List the boards that can be driven, their links, and the serial ports of this computer."""
    from airtact.emission.links import links_of
    from airtact.transducers.boards import BOARDS

    table = plain_table("board", "elements", "levels", "a link")
    for board in BOARDS.values():
        amplitudes = "on, off" if board.amplitudes == 2 else str(board.amplitudes)
        table.add_row(
            board.name,
            str(len(board)),
            f"{amplitudes} x {board.phases} phases",
            "1 board" if board.max_boards == 1 else f"1 to {board.max_boards} boards",
        )
    links = [
        f"{board.name}: {board.title}, by {', '.join(links_of(board.name))}"
        for board in BOARDS.values()
    ]
    ports = _ports()
    missing = "not searched, pyserial is not installed: pip install 'airtact[serial]'"
    words = missing if ports is None else ", ".join(ports) or "none"
    show(
        table,
        lines=[*links, f"Serial ports: {words}"],
        record={
            "boards": [
                {
                    "name": board.name,
                    "title": board.title,
                    "elements": len(board),
                    "amplitudes": board.amplitudes,
                    "phases": board.phases,
                    "most": board.max_boards,
                    "links": list(links_of(board.name)),
                }
                for board in BOARDS.values()
            ],
            "serial_ports": ports,
        },
    )


def _ports() -> list[str] | None:
    """List the serial ports; None where they cannot be searched."""
    try:
        from airtact.emission.serial_link import serial_ports

        return list(serial_ports())
    except ImportError:
        return None
