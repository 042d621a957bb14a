"""``airtact hand``: make the skin of a hand from a pose, a recording or a point cloud."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

import airtact as at
from airtact.cli.console import facts_table, progress, show
from airtact.cli.options import FILE, INPUT, quiet
from airtact.timing import Progress

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from airtact.geometry.mesh.arrays import QuadraticTriangles
    from airtact.geometry.mesh_shape import MeshShape
    from airtact.hands.hand import Side
    from airtact.hands.shape import HandShape

# Default edge of the triangles [m]
EDGE = 4e-3


@click.command(
    short_help="Make the skin of a hand from a pose, a recording or a point cloud.",
    epilog="Example: airtact hand pinch.json --gap 0.012 --out hand.ply",
)
@click.argument("path", metavar="POSE_RECORDING_OR_CLOUD", type=INPUT)
@click.option("--gap", type=float, help="Gap to which thumb and index finger open, in metres.")
@click.option("--edge", type=float, help="Edge of the triangles in metres; 4e-3 by default.")
@click.option("--out", "file", required=True, type=FILE, help="File for the skin.")
@click.option(
    "--frame",
    "frames",
    type=int,
    multiple=True,
    help="Number of a frame of a recording; may be repeated. The first by default.",
)
@click.option("--leave-out", is_flag=True, help="Leave out and count faulty frames of a recording.")
@click.option("--landmarks", type=INPUT, help="Rough joints, a pose as JSON, for a cloud.")
@click.option(
    "--camera", type=(float, float, float), help="Position from which a cloud was seen, in metres."
)
@quiet
def hand(
    path: Path,
    file: Path,
    gap: float | None,
    edge: float | None,
    frames: tuple[int, ...],
    leave_out: bool,
    landmarks: Path | None,
    camera: tuple[float, float, float] | None,
) -> None:
    """Make the closed skin of a hand from its joints: 25 of WebXR, or 21 of MediaPipe or Leap.

    A pose is a .json file. The skin is written as flat triangles in metres to .ply, .stl or .glb,
    or as curved ones to .vtkhdf for ParaView, with a picture .png beside it.

    A recording is a .jsonl file. The skins of chosen frames are written, and a picture of the pads
    over time. A point cloud is a .ply, .xyz or .npy file and needs rough --landmarks. A hand is
    fitted to it, and the picture shows the distances of the points from its skin.
    """
    from airtact.errors import within
    from airtact.hands.files import CLOUD_ENDINGS
    from airtact.hands.tracking.recordings import ENDING
    from airtact.setup.exports import check_output

    kind = "recording" if path.suffix == ENDING else "pose"
    if landmarks is not None:
        kind = "cloud"
    elif kind == "pose" and path.suffix.lower() in CLOUD_ENDINGS:
        raise at.InvalidInput(
            f"{path.name} is a point cloud: give rough --landmarks.", code="data_missing"
        )
    for option, of_kind, is_given in (
        ("gap", "pose", gap is not None),
        ("frame", "recording", bool(frames)),
        ("leave-out", "recording", leave_out),
        ("camera", "cloud", camera is not None),
    ):
        if is_given and of_kind != kind:
            raise at.InvalidInput(
                f"{path.name} is a {kind}, but --{option} is for a {of_kind}: leave it out.",
                code="options_clash",
            )
    # Fitting takes minutes, so the output is checked first.
    check_output(file, path, *([] if landmarks is None else [landmarks]))
    if edge is not None:
        within(edge, 0.8e-3, 20e-3, "edge", "m", "is it in millimetres? Give metres.")
    with progress() as report_step:
        if landmarks is not None:
            facts, lines = _fit(path, landmarks, file, camera, edge, report_step)
        elif kind == "recording":
            facts, lines = _replay(path, file, frames, leave_out, edge or EDGE, report_step)
        else:
            facts, lines = _pose(path, file, gap, edge or EDGE, report_step)
    show(facts_table(facts), lines=lines)


# Facts by name, and lines that name the files
Shown = tuple[list[tuple[str, str]], list[str]]


def _pose(path: Path, file: Path, gap: float | None, edge: float, report_step: Progress) -> Shown:
    from airtact.files.atomic import writable_folder
    from airtact.reports.body_figure import draw_panels

    report_step(f"reading {path.name}")
    posed = at.load_hand(path, gap)
    writable_folder(file.parent)
    report_step(f"making triangles of {1e3 * edge:.3g} mm")
    triangles = posed.shape.panels(edge)
    lines = _write(triangles, file, draw_panels(triangles), report_step)
    places = {name: point for name, (point, _) in posed.places.items()}
    facts = _facts(posed.side, posed.shape, triangles, places)
    merged = [f"Note: {touch.note}." for touch in posed.touches]
    return facts, [*merged, *lines]


def _fit(
    cloud: Path,
    landmarks: Path,
    file: Path,
    camera: tuple[float, float, float] | None,
    edge: float | None,
    report_step: Progress,
) -> Shown:
    # Without ``edge`` the fitted surface keeps its triangles.
    import numpy as np

    from airtact.files.atomic import writable_folder
    from airtact.geometry.mesh_shape import MeshShape
    from airtact.reports.body_figure import draw_cloud

    report_step(f"reading {cloud.name}")
    points = at.hands.load_cloud(cloud)
    joints, side = at.hands.load_landmarks(landmarks)
    writable_folder(file.parent)
    eye = None if camera is None else np.array(camera, dtype=np.float64)
    fitted = at.fit_hand(points, joints, side, eye, progress=report_step)
    report_step("moving its skin to the points")
    surface = fitted.surface if edge is None else fitted.skin(edge)
    shape = cast("HandShape | MeshShape", surface.shape)
    if isinstance(shape, MeshShape):
        triangles = shape.quadratic_triangles
    else:
        triangles = shape.panels(edge or EDGE)
    distances = -shape.depth(fitted.points)  # positive outside

    lines = _write(triangles, file, draw_cloud(triangles, fitted, distances), report_step)
    points = np.array([point for point, _ in fitted.hand.places.values()])
    places = dict(zip(fitted.hand.places, shape.project(points), strict=True))
    # Outliers, such as points of a sleeve, are not points of the skin.
    used = ~fitted.outliers
    usual = float(np.median(np.abs(distances[used])))
    parts = ", ".join(f"{part} {1e3 * error:.1f}" for part, error in fitted.part_errors.items())
    facts = [
        *_facts(fitted.hand.side, shape, triangles, places),
        (
            "points used",
            f"{used.sum():,} of {len(used):,} after thinning; median distance from the skin "
            f"{1e3 * usual:.1f} mm",
        ),
        ("standard deviation of the skin", f"{parts} mm"),
    ]
    return facts, lines


def _replay(
    path: Path,
    file: Path,
    chosen: tuple[int, ...],
    leave_out: bool,
    edge: float,
    report_step: Progress,
) -> Shown:
    from airtact.errors import about
    from airtact.files.atomic import writable_folder
    from airtact.hands.tracking.recordings import load_recording, pads_over_time
    from airtact.reports.page import write_picture
    from airtact.reports.plots import draw_tracks
    from airtact.setup.exports import write_triangles

    report_step(f"reading {path.name}")
    recording = load_recording(path, leave_out)
    # Frames without landmarks have no skin.
    with_joints = [frame for frame in recording.frames if frame.landmarks is not None]
    numbers = [frame.sequence for frame in with_joints]
    missing = sorted(set(chosen) - set(numbers))
    with about(path.name):
        if not with_joints:
            raise at.InvalidInput(
                f"none of {len(recording.frames)} frames has landmarks: fit a hand to their point "
                "clouds first.",
                code="data_missing",
            )
        if missing:
            raise at.InvalidInput(
                f"there is no frame {missing[0]} with landmarks: give one of {min(numbers)} to "
                f"{max(numbers)}.",
                code="unknown_name",
            )
    frames = [frame for frame in with_joints if frame.sequence in chosen] or with_joints[:1]
    report_step(f"finding the pads in {len(recording.frames):,} frames")
    # Many recordings have frames of one hand only.
    seen = {frame.side for frame in with_joints}
    hands: list[Side] = ["left", "right"]
    tracks = [pads_over_time(recording.frames, side) for side in hands if side in seen]
    writable_folder(file.parent)
    skins = []
    for frame in frames:
        skin = file
        if len(frames) > 1:
            skin = file.with_stem(f"{file.stem}_{frame.side}_{frame.sequence}")
        report_step(f"writing {skin.name}")
        write_triangles(skin, frame.hand().shape.panels(edge))
        skins.append(str(skin))
    picture = file.with_suffix(".png")
    report_step(f"drawing {picture.name}")
    write_picture(picture, draw_tracks(tracks, f"{path.name}: {recording.health}"))
    facts = [("messages", str(recording.health))]
    for track in tracks:
        seconds = track.times[-1] - track.times[0]
        words = (
            f"{len(track.times):,} frames in {seconds:.2f} s, the longest gap "
            f"{1e3 * track.longest_gap:.0f} ms, pads at most {track.fastest:.2f} m/s"
        )
        facts.append((f"{track.side} hand", words))
    return facts, [f"Skin: {', '.join(skins)}", f"Pads over time: {picture}"]


def _write(
    triangles: "QuadraticTriangles", file: Path, figure: "Figure", report_step: Progress
) -> list[str]:
    """Write a skin and its picture; return lines that name the files."""
    from airtact.reports.page import write_picture
    from airtact.setup.exports import write_triangles

    report_step(f"writing {file.name}")
    write_triangles(file, triangles)
    picture = file.with_suffix(".png")
    report_step(f"drawing {picture.name}")
    write_picture(picture, figure)
    return [f"Skin: {file}", f"Picture: {picture}"]


def _facts(
    side: str,
    shape: "HandShape | MeshShape",
    triangles: "QuadraticTriangles",
    places: "Mapping[str, np.ndarray]",
) -> list[tuple[str, str]]:
    from airtact.geometry.mesh.quadratic_triangles import (
        enclosed_volume,
        panel_areas,
        smallest_angles,
    )

    area = 1e4 * panel_areas(triangles).sum()
    volume = 1e6 * enclosed_volume(triangles)
    angle = smallest_angles(triangles).min()
    facts = [
        ("hand", f"{side}, {1e3 * shape.extent:.0f} mm across"),
        ("area, volume", f"{area:.0f} cm², {volume:.0f} cm³"),
        ("panels", f"{len(triangles):,}, smallest angle {angle:.0f}°"),
    ]
    for name, point in places.items():
        depth = float(shape.depth(point[None])[0])
        words = f"({', '.join(f'{1e3 * number:.1f}' for number in point)}) mm"
        # Pads that touch lie inside the merged body, where no focus can be.
        if depth > 1e-6:
            words += f", {1e3 * depth:.1f} mm inside the body"
        facts.append((name, words))
    return facts
