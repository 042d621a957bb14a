"""The command that shows the skin of a hand in a pose."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.table import Table

    from airtact.posing import Posed


@click.command(
    short_help="Make the skin of a hand from a pose and say what touches.",
    epilog="Example: airtact hand examples/hands/pinch.json --gap 0.012 --out hand.ply",
)
@click.argument("pose", metavar="POSE.json", type=click.Path(path_type=Path))
@click.option("--gap", type=float, help="Open thumb and index finger to this gap in metres.")
@click.option("--edge", type=float, help="Edge of the triangles in metres; 4e-3 by default.")
@click.option("--out", "file", required=True, type=click.Path(path_type=Path), help="File for the skin.")
def hand(pose: Path, gap: float | None, edge: float | None, file: Path) -> None:
    """Make the closed skin of the hand in POSE.json: 25 joints of WebXR, or 21 of MediaPipe or Leap, in metres.

    The skin is written as flat triangles in metres to .ply, .stl or .glb, or curved to .vtkhdf for ParaView; a picture
    of it, .png, stands beside it.
    """
    from rich.console import Console

    from airtact.cli import _progress

    with _progress(Console(stderr=True)) as tell:
        from airtact.posing import pose as run_pose

        posed = run_pose(pose, file, gap, edge, tell)
    console = Console()
    console.print(_facts(posed))
    for touch in posed.hand.surface.mended:
        console.print(f"Merged: {touch}.", soft_wrap=True, highlight=False)
    console.print(f"The skin: {posed.file}, its picture: {posed.picture}", soft_wrap=True, highlight=False)


def _facts(posed: "Posed") -> "Table":
    from rich.box import SIMPLE
    from rich.table import Table

    shape = posed.hand.shape
    table = Table(box=SIMPLE, show_header=False)
    table.add_row("hand", f"{posed.hand.side}, {1e3 * shape.extent:.0f} mm across")
    table.add_row("area, volume", f"{1e4 * shape.area:.0f} cm², {1e6 * shape.volume:.0f} cm³")
    table.add_row("panels", f"{len(posed.panels.six_nodes):,}, smallest angle {posed.smallest_angle:.0f}°")
    for name, (point, _) in posed.hand.places.items():
        depth = float(shape.depth(point[None])[0])
        where = ", ".join(f"{1e3 * number:.1f}" for number in point)
        table.add_row(name, f"({where}) mm" + (f", {1e3 * depth:.1f} mm inside the body" if depth > 1e-6 else ""))
    return table
