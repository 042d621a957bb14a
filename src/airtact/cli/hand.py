"""``airtact hand``: the skin of a hand from a pose, a recording or a point cloud."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from airtact.cli.console import plain_table, progress, show
from airtact.cli.options import FILE, INPUT, quiet

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.table import Table

    from airtact.workflows.hand import Fitted, Posed
    from airtact.workflows.recording import Replayed


@click.command(
    short_help="Make the skin of a hand from a pose, a recording or a point cloud.",
    epilog="Example: airtact hand pinch.json --gap 0.012 --out hand.ply",
)
@click.argument("path", metavar="POSE_RECORDING_OR_CLOUD", type=INPUT)
@click.option("--gap", type=float, help="Open thumb and index finger to this gap in metres.")
@click.option("--edge", type=float, help="Edge of the triangles in metres; 4e-3 by default.")
@click.option("--out", "file", required=True, type=FILE, help="File for the skin.")
@click.option(
    "--frame",
    "frames",
    type=int,
    multiple=True,
    help="Frame of a recording; again for more. The first.",
)
@click.option("--leave-out", is_flag=True, help="Leave out and count faulty frames of a recording.")
@click.option("--landmarks", type=INPUT, help="Rough joints, a pose as JSON, for a cloud.")
@click.option(
    "--camera", type=(float, float, float), help="Position from which a cloud was seen, in metres."
)
@quiet
def hand(path: Path, file: Path, **settings: Any) -> None:
    """Make the closed skin of a hand from its joints in metres: 25 of WebXR, or 21 of MediaPipe or Leap.

    A pose is a .json file. The skin is written as flat triangles in metres to .ply, .stl or .glb,
    or curved to .vtkhdf for ParaView; a picture of it, .png, stands beside it. Of a recording,
    .jsonl or .npz, the skins of chosen frames are written, and a picture of the pads over time. To
    a cloud of points, .ply, .xyz or .npy, with rough --landmarks a hand is fitted, and the picture
    shows how far the points are from its skin.
    """
    with progress() as report_step:
        from airtact.workflows import hand as workflow
        from airtact.workflows.recording import Replayed

        made = workflow.hand(path, file, **settings, report_step=report_step)
    if isinstance(made, Replayed):
        skins = ", ".join(str(skin) for skin in made.skins)
        show(_recording_table(made), lines=[f"Skin: {skins}", f"Pads over time: {made.picture}"])
    elif isinstance(made, workflow.Fitted):
        show(_cloud_table(made), lines=[f"Skin: {made.file}", f"Picture: {made.picture}"])
    else:
        merged = [f"Merged: {touch.note}." for touch in made.hand.touches]
        show(_table(made), lines=[*merged, f"Skin: {made.file}", f"Picture: {made.picture}"])


def _table(posed: "Posed", errors: "Mapping[str, float] | None" = None) -> "Table":
    shape, (area, volume) = posed.shape, posed.size
    table = plain_table()
    table.add_row("hand", f"{posed.hand.side}, {1e3 * shape.extent:.0f} mm across")
    table.add_row("area, volume", f"{1e4 * area:.0f} cm², {1e6 * volume:.0f} cm³")
    table.add_row(
        "panels", f"{len(posed.quadratic_triangles):,}, smallest angle {posed.smallest_angle:.0f}°"
    )
    for name, point in posed.places.items():
        depth = float(shape.depth(point[None])[0])
        position = ", ".join(f"{1e3 * number:.1f}" for number in point)
        sure = "" if errors is None else f", off by some {1e3 * errors[name]:.0f} mm"
        inside = f", {1e3 * depth:.1f} mm inside the body" if depth > 1e-6 else ""
        table.add_row(name, f"({position}) mm{sure}{inside}")
    return table


def _cloud_table(made: "Fitted") -> "Table":
    fitted, table = made.fitted, _table(made, made.errors)
    used = ~fitted.outliers
    near = f"half of them within {1e3 * made.usual:.1f} mm of the skin"
    table.add_row("points used", f"{used.sum():,} of {len(used):,} thinned out; {near}")
    errors = ", ".join(f"{part} {1e3 * error:.1f}" for part, error in fitted.part_errors.items())
    table.add_row("skin uncertain by", f"{errors} mm")
    return table


def _recording_table(replayed: "Replayed") -> "Table":
    table = plain_table()
    table.add_row("messages", str(replayed.recording.health))
    for track in replayed.tracks:
        seconds = track.times[-1] - track.times[0]
        about = f"{len(track.times):,} frames in {seconds:.2f} s, the longest gap {1e3 * track.longest_gap:.0f} ms"
        table.add_row(f"{track.side} hand", f"{about}, pads at most {track.fastest:.2f} m/s")
    return table
