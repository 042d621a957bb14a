"""``airtact boards``: list the supported boards."""

import click

from airtact.cli.console import plain_table, show
from airtact.cli.options import as_json, quiet


@click.command(short_help="List the supported boards.", epilog="Example: airtact boards")
@as_json
@quiet
def boards() -> None:
    """List the supported boards, their links, and the serial ports of this computer."""
    from airtact.emission.links import links_of
    from airtact.transducers.boards import BOARDS

    table = plain_table("board", "elements", "levels", "boards per link")
    for board in BOARDS.values():
        amplitudes = "on, off" if board.amplitudes == 2 else str(board.amplitudes)
        table.add_row(
            board.name,
            str(len(board)),
            f"{amplitudes} x {board.phases} phases",
            "1" if board.max_boards == 1 else f"1 to {board.max_boards}",
        )
    links = [
        f"{board.name}: {board.title}, through {', '.join(links_of(board.name))}"
        for board in BOARDS.values()
    ]
    try:
        from airtact.emission.serial_link import serial_ports

        ports = list(serial_ports())
        words = ", ".join(ports) or "none"
    except ImportError:
        ports = None
        words = "unknown without pyserial: run pip install 'airtact[serial]'"
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
