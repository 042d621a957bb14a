"""The command that shows the skin of a hand in a pose."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from airtact.cli.console import progress
from airtact.conventions import InvalidInput

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.table import Table

    from airtact.workflows.hand import Posed


@click.command(
    short_help="Make the skin of a hand from a pose, a recording or a point cloud.",
    epilog="Example: airtact hand examples/hands/pinch.json --gap 0.012 --out hand.ply",
)
@click.argument("pose", metavar="POSE_RECORDING_OR_CLOUD", type=click.Path(path_type=Path))
@click.option("--gap", type=float, help="Open thumb and index finger to this gap in metres.")
@click.option("--edge", type=float, help="Edge of the triangles in metres; 4e-3 by default.")
@click.option("--out", "file", required=True, type=click.Path(path_type=Path), help="File for the skin.")
@click.option("--frame", "frames", type=int, multiple=True, help="Frame of a recording; again for more. The first.")
@click.option("--leave-out", is_flag=True, help="Leave out and count faulty frames of a recording.")
@click.option("--landmarks", type=click.Path(path_type=Path), help="Rough joints, a pose as JSON, for a cloud.")
@click.option("--camera", type=(float, float, float), help="Where a cloud was seen from, in metres.")
def hand(
    pose: Path,
    gap: float | None,
    edge: float | None,
    file: Path,
    frames: tuple[int, ...],
    leave_out: bool,
    landmarks: Path | None,
    camera: tuple[float, float, float] | None,
) -> None:
    """Make the closed skin of a hand from its joints in metres: 25 of WebXR, or 21 of MediaPipe or Leap.

    A pose is a .json file. The skin is written as flat triangles in metres to .ply, .stl or .glb, or curved to .vtkhdf
    for ParaView; a picture of it, .png, stands beside it. Of a recording, .jsonl or .npz, the skins of chosen frames
    are written, and a picture of the pads over time. To a cloud of points, .ply, .xyz or .npy, with rough --landmarks a
    hand is fitted, and the picture shows how far the points are from its skin.
    """
    from rich.console import Console

    from airtact.cli.tracking import show_recording
    from airtact.hand.fitting.cloud_files import ENDINGS as CLOUDS
    from airtact.tracking.recordings import ENDINGS

    if landmarks is not None:
        if gap is not None or frames or leave_out:
            raise InvalidInput(f"{pose.name} is 1 cloud; leave --gap, --frame and --leave-out out.")
        _show_cloud(pose, landmarks, file, camera, edge)
        return
    if camera is not None:
        raise InvalidInput(f"a camera is for a cloud with --landmarks, and {pose.name} came with 0 of them.")
    if pose.suffix in ENDINGS:
        if gap is not None:
            raise InvalidInput(f"a gap of {gap:g} m is for 1 pose, not for a recording; leave --gap out.")
        show_recording(pose, file, frames, leave_out, edge)
        return
    if pose.suffix.lower() in CLOUDS:
        raise InvalidInput(f"{pose.name} is a cloud of points, and came with 0 landmarks; give rough --landmarks.")
    if frames or leave_out:
        raise InvalidInput(f"{pose.name} is 1 pose, no recording; leave --frame and --leave-out out.")

    with progress() as report_step:
        from airtact.workflows.hand import pose as run_pose

        posed = run_pose(pose, file, gap, edge, report_step)
    console = Console()
    console.print(_facts(posed))
    for touch in posed.hand.touches:
        console.print(f"Merged: {touch.note}.", soft_wrap=True, highlight=False)
    console.print(f"The skin: {posed.file}, its picture: {posed.picture}", soft_wrap=True, highlight=False)


def _show_cloud(
    cloud: Path, landmarks: Path, file: Path, camera: tuple[float, float, float] | None, edge: float | None
) -> None:
    from rich.console import Console

    with progress() as report_step:
        from airtact.workflows.hand import fit

        done = fit(cloud, landmarks, file, camera, edge, report_step)
    console, fitted = Console(), done.fitted
    table = _facts(done, done.errors)
    used = ~fitted.strays
    near = f"half of them within {1e3 * done.usual:.1f} mm of the skin"
    table.add_row("points used", f"{used.sum():,} of {len(used):,} thinned out; {near}")
    errors = ", ".join(f"{part} {1e3 * error:.1f}" for part, error in fitted.part_errors.items())
    table.add_row("skin uncertain by", f"{errors} mm")
    console.print(table)
    console.print(f"The skin: {done.file}, its picture: {done.picture}", soft_wrap=True, highlight=False)


def _facts(posed: "Posed", errors: "Mapping[str, float] | None" = None) -> "Table":
    from rich.box import SIMPLE
    from rich.table import Table

    shape = posed.shape
    table = Table(box=SIMPLE, show_header=False)
    table.add_row("hand", f"{posed.hand.side}, {1e3 * shape.extent:.0f} mm across")
    table.add_row("area, volume", f"{1e4 * posed.area:.0f} cm², {1e6 * posed.volume:.0f} cm³")
    table.add_row("panels", f"{len(posed.quadratic_triangles):,}, smallest angle {posed.smallest_angle:.0f}°")
    for name, point in posed.places.items():
        depth = float(shape.depth(point[None])[0])
        where = ", ".join(f"{1e3 * number:.1f}" for number in point)
        sure = "" if errors is None else f", off by some {1e3 * errors[name]:.0f} mm"
        table.add_row(name, f"({where}) mm{sure}" + (f", {1e3 * depth:.1f} mm inside the body" if depth > 1e-6 else ""))
    return table
