"""``airtact hand``: compute the skin of a hand from a pose, a recording or a point cloud."""

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

    from airtact.geometry.mesh.triangles import QuadraticTriangles
    from airtact.geometry.mesh_shape import MeshShape
    from airtact.hands.shape import HandShape

# Default edge length of the triangles [m]
EDGE = 4e-3


@click.command(
    short_help="Compute the skin of a hand from a pose, a recording or a point cloud.",
    epilog="Example: airtact hand pinch.json --gap 0.012 --out hand.ply",
)
@click.argument("path", metavar="POSE_RECORDING_OR_CLOUD", type=INPUT)
@click.option(
    "--gap", type=float, help="Gap to which thumb and index finger are opened, in metres."
)
@click.option("--edge", type=float, help="Edge length of the triangles in metres; 4e-3 by default.")
@click.option("--out", "file", required=True, type=FILE, help="File to which the skin is written.")
@click.option("--frame", type=int, help="Number of the frame in a recording; by default the first.")
@click.option("--leave-out", is_flag=True, help="Skip and count unusable frames of a recording.")
@click.option(
    "--landmarks", type=INPUT, help="Pose file (.json) with approximate joints for a point cloud."
)
@click.option(
    "--camera",
    type=(float, float, float),
    help="Position of the camera for a point cloud, in metres.",
)
@quiet
def hand(
    path: Path,
    file: Path,
    gap: float | None,
    edge: float | None,
    frame: int | None,
    leave_out: bool,
    landmarks: Path | None,
    camera: tuple[float, float, float] | None,
) -> None:
    """Compute the closed skin of a hand from its joints: 25 (WebXR) or 21 (MediaPipe, Leap).

    A pose is a .json file. The skin is written as flat triangles in metres to a .ply, .stl or .glb
    file, or as curved triangles to a .vtkhdf file for ParaView. A picture (.png) is written next to
    it.

    A recording is a .jsonl file, or a file from IWER, vuer, VisionProTeleop (.json) or
    hand-tracking-streamer (.txt); only one frame is used. A point cloud is a .ply or .xyz file and
    requires approximate joints (--landmarks). The command fits a hand to the cloud, and the picture
    shows the distances of the points from its skin.
    """
    from airtact.errors import within
    from airtact.hands.files import CLOUD_ENDINGS
    from airtact.hands.tracking.recordings import is_recording
    from airtact.setup.exports import check_output, write_triangles

    kind = "recording" if is_recording(path) else "pose"
    if landmarks is not None:
        kind = "cloud"
    elif kind == "pose" and path.suffix.lower() in CLOUD_ENDINGS:
        raise at.InvalidInput(
            f"{path.name} is a point cloud, which requires approximate joints: set --landmarks.",
            code="data_missing",
        )
    for option, of_kind, is_given in (
        ("gap", "pose", gap is not None),
        ("frame", "recording", frame is not None),
        ("leave-out", "recording", leave_out),
        ("camera", "cloud", camera is not None),
    ):
        if is_given and of_kind != kind:
            raise at.InvalidInput(
                f"{path.name} is a {kind}, but --{option} only applies to a {of_kind}: omit it.",
                code="options_clash",
            )
    # Fitting takes minutes, so check the output file first.
    check_output(file, path, *([] if landmarks is None else [landmarks]))
    if edge is not None:
        within(edge, 0.8e-3, 20e-3, "edge", "m")
    with progress() as report_step:
        from airtact.reports.page import write_picture

        if landmarks is not None:
            facts, notes, triangles, figure = _fit(path, landmarks, file, camera, edge, report_step)
        else:
            facts, notes, triangles, figure = _skin(
                path, file, gap, frame, leave_out, edge or EDGE, report_step
            )
        report_step(f"writing {file.name}")
        write_triangles(file, triangles)
        picture = file.with_suffix(".png")
        report_step(f"drawing {picture.name}")
        write_picture(picture, figure)
    show(facts_table(facts), lines=[*notes, f"Skin: {file}", f"Picture: {picture}"])


def _skin(
    path: Path,
    file: Path,
    gap: float | None,
    number: int | None,
    leave_out: bool,
    edge: float,
    report_step: Progress,
) -> "tuple[list[tuple[str, str]], list[str], QuadraticTriangles, Figure]":
    """Return facts, notes, skin and picture of a pose, or of a frame of a recording."""
    from airtact.files.atomic import writable_folder
    from airtact.hands.tracking.recordings import is_recording, load_recording
    from airtact.reports.body_figure import draw_panels

    report_step(f"reading {path.name}")
    messages = []
    if is_recording(path):
        recording = load_recording(path, leave_out)
        messages = [("messages", str(recording.health))]
        if recording.note:
            messages.append(("format", recording.note))
        # Frames without landmarks have no skin.
        frames = {item.sequence: item for item in recording.frames if item.landmarks is not None}
        number = min(frames, default=0) if number is None else number
        if number not in frames:
            raise at.InvalidInput(
                f"{path.name} has no frame {number} with landmarks. {len(frames)} of "
                f"{len(recording.frames)} frames have landmarks: choose one of these, or fit a "
                "hand to the point clouds.",
                code="data_missing",
            )
        posed = frames[number].hand()
    else:
        posed = at.load_hand(path, gap)
    writable_folder(file.parent)
    report_step(f"meshing the skin with triangles of {1e3 * edge:.3g} mm")
    triangles = posed.shape.panels(edge)
    places = {name: point for name, (point, _) in posed.places.items()}
    return (
        messages + _facts(posed.side, posed.shape, triangles, places),
        [f"Note: {touch.note}." for touch in posed.touches],
        triangles,
        draw_panels(triangles),
    )


def _fit(
    cloud: Path,
    landmarks: Path,
    file: Path,
    camera: tuple[float, float, float] | None,
    edge: float | None,
    report_step: Progress,
) -> "tuple[list[tuple[str, str]], list[str], QuadraticTriangles, Figure]":
    # Without ``edge``, the fitted surface keeps its triangles.
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
    report_step("fitting the skin of the hand to the points")
    surface = fitted.surface if edge is None else fitted.skin(edge)
    shape = cast("HandShape | MeshShape", surface.shape)
    triangles = (
        shape.quadratic_triangles if isinstance(shape, MeshShape) else shape.panels(edge or EDGE)
    )
    distances = -shape.depth(fitted.points)  # positive outside
    points = np.array([point for point, _ in fitted.hand.places.values()])
    places = dict(zip(fitted.hand.places, shape.project(points), strict=True))
    # Outliers, such as points on a sleeve, are not part of the skin.
    used = ~fitted.outliers
    usual = np.median(np.abs(distances[used]))
    joint_error = np.sqrt(np.mean(fitted.joint_errors**2))
    facts = [
        *_facts(fitted.hand.side, shape, triangles, places),
        (
            "points used",
            f"{used.sum():,} of {len(used):,} after downsampling; median distance from the skin "
            f"{1e3 * usual:.1f} mm",
        ),
        ("standard deviation of the joints", f"{1e3 * joint_error:.1f} mm"),
    ]
    return facts, [], triangles, draw_cloud(triangles, fitted, distances)


def _facts(
    side: str,
    shape: "HandShape | MeshShape",
    triangles: "QuadraticTriangles",
    places: "Mapping[str, np.ndarray]",
) -> list[tuple[str, str]]:
    from airtact.geometry.mesh.triangles import (
        enclosed_volume,
        panel_areas,
        smallest_angles,
    )

    facts = [
        ("hand", f"{side}, {1e3 * shape.extent:.0f} mm across"),
        (
            "area, volume",
            f"{1e4 * panel_areas(triangles).sum():.0f} cm², "
            f"{1e6 * enclosed_volume(triangles):.0f} cm³",
        ),
        (
            "panels",
            f"{len(triangles):,}, smallest angle {smallest_angles(triangles).min():.0f}°",
        ),
    ]
    for name, point in places.items():
        depth = float(shape.depth(point[None])[0])
        words = f"({', '.join(f'{1e3 * number:z.1f}' for number in point)}) mm"
        # Pads that touch lie inside the merged body, where no focus is possible.
        if depth > 1e-6:
            words += f", {1e3 * depth:.1f} mm inside the body"
        facts.append((name, words))
    return facts
