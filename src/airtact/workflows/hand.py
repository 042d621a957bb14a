"""From a pose or a cloud to the skin of the hand, its file, its picture and what touches. Prints nothing."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Float64
from matplotlib.figure import Figure

from airtact.errors import InvalidInput
from airtact.files.atomic import writable_folder
from airtact.geometry.mesh.arrays import QuadraticTriangles
from airtact.geometry.mesh.quadratic_triangles import enclosed_volume, panel_areas, smallest_angles
from airtact.geometry.mesh_shape import MeshShape
from airtact.hands.files import CLOUD_ENDINGS as CLOUDS
from airtact.hands.files import load_cloud, load_hand, load_landmarks
from airtact.hands.fitting.fit import FittedHand, fit_hand
from airtact.hands.hand import Hand, Side
from airtact.hands.joints import CHAINS, FINGERS
from airtact.hands.shape import HandShape
from airtact.hands.tracking.recordings import ENDINGS as RECORDINGS
from airtact.reports.body_figure import draw_cloud, draw_panels
from airtact.reports.page import write_picture
from airtact.setup.panel_files import EDGE, check_ending, checked_edge, write_triangles
from airtact.timing import Progress, no_progress
from airtact.workflows.recording import Replayed, replay_recording


@dataclass(frozen=True, eq=False)
class Posed:
    """The skin of a hand that was made and written, with its triangles (T, 6, 3) [m]."""

    hand: Hand
    shape: HandShape | MeshShape
    quadratic_triangles: QuadraticTriangles
    file: Path
    picture: Path

    @property
    def places(self) -> Mapping[str, Float64[np.ndarray, "3"]]:
        """Points of the skin that a target can name (3,) [m]."""
        return {name: point for name, (point, _) in self.hand.places.items()}

    @property
    def smallest_angle(self) -> float:
        """Smallest angle of the worst triangle [degrees]."""
        return float(smallest_angles(self.quadratic_triangles).min())

    @property
    def size(self) -> tuple[float, float]:
        """Area of the triangles [m²], and the volume that they enclose [m³]."""
        return float(panel_areas(self.quadratic_triangles).sum()), enclosed_volume(
            self.quadratic_triangles
        )


@dataclass(frozen=True, eq=False)
class Fitted(Posed):
    """The skin of a hand that was found in a cloud, and the distances of its points from it, positive outside [m]."""

    fitted: FittedHand
    distances: Float64[np.ndarray, "points"]

    @property
    def places(self) -> Mapping[str, Float64[np.ndarray, "3"]]:
        """Points of the skin that a target can name (3,) [m]."""
        points = np.array([point for point, _ in self.hand.places.values()])
        return dict(zip(self.hand.places, self.shape.project(points), strict=True))

    @property
    def errors(self) -> Mapping[str, float]:
        """Standard deviation of the position of each place, by that of the joints beside it [m]."""
        beside = {
            f"{finger}.pad": list(chain[-2:]) for finger, chain in zip(FINGERS, CHAINS, strict=True)
        }
        beside["palm"] = [joint for chain in CHAINS[1:] for joint in chain[:2]]
        return {
            name: float(np.sqrt(np.mean(self.fitted.joint_errors[own] ** 2)))
            for name, own in beside.items()
        }

    @property
    def usual(self) -> float:
        """Median distance of the points, outliers left out [m]."""
        return float(np.median(np.abs(self.distances[~self.fitted.outliers])))


def pose(
    path: Path,
    file: Path,
    gap: float | None = None,
    edge: float | None = None,
    report_step: Progress = no_progress,
) -> Posed:
    """Read a pose, make the skin of the hand and write it, with a picture of the same name beside it.

    ``gap`` opens thumb and index finger to that distance of their last phalanges [m]; ``edge`` is
    of the triangles [m].

    Raises
    ------
    InvalidInput
        The pose or a number is at fault, or the skin cannot be written there.
    """
    report_step(f"reading {path.name}")
    check_ending(file)
    if path.resolve() == file.resolve():
        raise InvalidInput(
            f"the skin would overwrite {path.name}, the 1 file that it is made from.",
            code="would_overwrite",
        )
    edge = EDGE if edge is None else checked_edge(edge)
    hand = load_hand(path, gap)
    writable_folder(file.parent)
    report_step(f"making triangles of {1e3 * edge:.3g} mm")
    triangles = hand.shape.panels(edge)
    picture = _written(triangles, file, draw_panels, report_step)
    return Posed(hand, hand.shape, triangles, file, picture)


def fit(
    cloud: Path,
    landmarks: Path,
    file: Path,
    camera: tuple[float, float, float] | None = None,
    edge: float | None = None,
    report_step: Progress = no_progress,
) -> Fitted:
    """Read a cloud and rough landmarks, fit a hand to them and write its skin, with a picture beside it.

    The skin is the one that was brought to the points, ``FittedHand.surface``, with its edges
    unless ``edge`` [m] is given. ``camera`` is where all points were seen from [m]; None for from
    many sides.

    Raises
    ------
    InvalidInput
        A file or a number is at fault, no hand explains the cloud, or the skin cannot be written there.
    """
    report_step(f"reading {cloud.name}")
    check_ending(file)
    if file.resolve() in (cloud.resolve(), landmarks.resolve()):
        raise InvalidInput(
            f"the skin would overwrite {file.name}, 1 of the files that it is made from.",
            code="would_overwrite",
        )
    edge = None if edge is None else checked_edge(edge)
    points, (joints, side) = load_cloud(cloud), load_landmarks(landmarks)
    writable_folder(file.parent)
    eye = None if camera is None else np.array(camera, dtype=np.float64)
    fitted = fit_hand(points, joints, cast("Side | None", side), eye, progress=report_step)
    report_step("bringing its skin to the points")
    shape = cast(
        "HandShape | MeshShape", (fitted.surface if edge is None else fitted.skin(edge)).shape
    )
    triangles = (
        shape.quadratic_triangles if isinstance(shape, MeshShape) else shape.panels(edge or EDGE)
    )
    distances = -shape.depth(fitted.points)
    picture = _written(
        triangles, file, lambda drawn: draw_cloud(drawn, fitted, distances), report_step
    )
    return Fitted(fitted.hand, shape, triangles, file, picture, fitted, distances)


def _written(
    triangles: QuadraticTriangles,
    file: Path,
    draw: Callable[[QuadraticTriangles], Figure],
    report_step: Progress,
) -> Path:
    """Write a skin, and its picture of the same name beside it."""
    report_step(f"writing {file.name}")
    write_triangles(file, triangles)
    picture = file.with_suffix(".png")
    report_step(f"drawing {picture.name}")
    write_picture(picture, draw(triangles))
    return picture


def hand(
    path: Path,
    file: Path,
    *,
    gap: float | None = None,
    edge: float | None = None,
    frames: tuple[int, ...] = (),
    leave_out: bool = False,
    landmarks: Path | None = None,
    camera: tuple[float, float, float] | None = None,
    report_step: Progress = no_progress,
) -> Posed | Fitted | Replayed:
    """Make the skin of a hand by ``pose``, ``replay_recording`` or ``fit``, which the settings are passed to.

    Raises
    ------
    InvalidInput
        "options_clash", "data_missing", or as these.
    """
    of_recordings = bool(frames) or leave_out
    if landmarks is not None:
        if gap is not None or of_recordings:
            sentence = f"{path.name} is 1 cloud; leave --gap, --frame and --leave-out out."
            raise InvalidInput(sentence, code="options_clash")
        return fit(path, landmarks, file, camera, edge, report_step)
    if camera is not None:
        sentence = f"a camera is for a cloud with --landmarks, and {path.name} came with 0 of them."
        raise InvalidInput(sentence, code="options_clash")
    if path.suffix in RECORDINGS:
        if gap is not None:
            sentence = f"a gap of {gap:g} m is for 1 pose, not for a recording; leave --gap out."
            raise InvalidInput(sentence, code="options_clash")
        return replay_recording(
            path, file, frames, leave_out, EDGE if edge is None else edge, report_step
        )
    if path.suffix.lower() in CLOUDS:
        sentence = (
            f"{path.name} is a cloud of points, and came with 0 landmarks; give rough --landmarks."
        )
        raise InvalidInput(sentence, code="data_missing")
    if of_recordings:
        sentence = f"{path.name} is 1 pose, no recording; leave --frame and --leave-out out."
        raise InvalidInput(sentence, code="options_clash")
    return pose(path, file, gap, edge, report_step)
