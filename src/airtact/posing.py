"""From a pose or a cloud to the skin of the hand, its file, its picture and what touches. Prints nothing."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from airtact.conventions import InvalidInput
from airtact.report.cloud_figure import draw_cloud
from airtact.report.panel_figure import draw_panels
from airtact.report.panel_files import check_ending, write_panels
from airtact.report.picture_file import write_picture
from airtact.report.whole_file import writable_folder
from airtact.scene.capture import FittedHand, fit_hand
from airtact.scene.cloud_files import load_cloud
from airtact.scene.guards import within
from airtact.scene.hand import Hand, Side
from airtact.scene.hand_files import load_hand, load_landmarks
from airtact.scene.panels import Panels
from airtact.scene.six_nodes import smallest_angles

EDGE = 4e-3
"""Edge of the triangles unless given [m]."""

FINEST, COARSEST = 0.8e-3, 20e-3
"""Edges that are taken [m]."""


@dataclass(frozen=True, eq=False)
class Posed:
    """The skin of a hand that was made and written.

    Attributes
    ----------
    hand : the hand.
    panels : curved panels on its skin.
    file, picture : what was written.
    """

    hand: Hand
    panels: Panels
    file: Path
    picture: Path

    @property
    def smallest_angle(self) -> float:
        """Smallest angle of the worst panel [degrees]."""
        return float(smallest_angles(self.panels.six_nodes).min())


@dataclass(frozen=True, eq=False)
class Fitted(Posed):
    """The skin of a hand that was found in a cloud and written.

    Attributes
    ----------
    fitted : what was found.
    """

    fitted: FittedHand


def pose(
    path: Path,
    file: Path,
    gap: float | None = None,
    edge: float | None = None,
    tell: Callable[[str], None] = lambda step: None,
) -> Posed:
    """Read a pose, make the skin of the hand and write it, with a picture of the same name beside it.

    Parameters
    ----------
    path : a JSON file, see ``load_hand``.
    file : where the skin goes; its ending says how, see ``write_panels``.
    gap : opens thumb and index finger until their last phalanges are so far apart [m]; None leaves the pose.
    edge : of the triangles [m]; 4 mm unless given.
    tell : is told each step as it begins.

    Raises
    ------
    InvalidInput
        The pose or a number is at fault, or the skin cannot be written there.
    """
    tell(f"reading {path.name}")
    check_ending(file)
    if path.resolve() == file.resolve():
        raise InvalidInput(f"the skin would take the place of {path.name}, the 1 file that it is made from.")
    hand = load_hand(path, gap)
    panels, picture = _written(hand, file, edge, tell), file.with_suffix(".png")
    tell(f"drawing {picture.name}")
    write_picture(picture, draw_panels(panels.six_nodes))
    return Posed(hand, panels, file, picture)


def fit(
    cloud: Path,
    landmarks: Path,
    file: Path,
    camera: tuple[float, float, float] | None = None,
    edge: float | None = None,
    tell: Callable[[str], None] = lambda step: None,
) -> Fitted:
    """Read a cloud and rough landmarks, fit a hand to them and write its skin, with a picture beside it.

    Parameters
    ----------
    cloud : see ``load_cloud``.
    landmarks : see ``load_landmarks``.
    file : where the skin goes; its ending says how, see ``write_panels``.
    camera : where all points were seen from [m]; None for from many sides.
    edge : of the triangles [m]; 4 mm unless given.
    tell : is told each step as it begins.

    Raises
    ------
    InvalidInput
        A file or a number is at fault, the hand is refused, or the skin cannot be written there.
    """
    tell(f"reading {cloud.name}")
    check_ending(file)
    if file.resolve() in (cloud.resolve(), landmarks.resolve()):
        raise InvalidInput(f"the skin would take the place of {file.name}, 1 of the files that it is made from.")
    points, (joints, side) = load_cloud(cloud), load_landmarks(landmarks)
    tell(f"fitting a hand to {len(points):,} points")
    eye = None if camera is None else np.array(camera, dtype=np.float64)
    fitted = fit_hand(points, joints, cast("Side | None", side), eye)
    panels, picture = _written(fitted.hand, file, edge, tell), file.with_suffix(".png")
    tell(f"drawing {picture.name}")
    write_picture(picture, draw_cloud(panels.six_nodes, fitted))
    return Fitted(fitted.hand, panels, file, picture, fitted)


def _written(hand: Hand, file: Path, edge: float | None, tell: Callable[[str], None]) -> Panels:
    slip = "is it in millimetres? Give metres."
    edge = EDGE if edge is None else within(edge, FINEST, COARSEST, "edge", "m", slip)
    writable_folder(file.parent)
    tell(f"making triangles of {1e3 * edge:.3g} mm")
    six_nodes = hand.shape.panels(edge)
    ones = np.zeros(len(six_nodes))
    panels = Panels(six_nodes, ones.astype(np.int64), ones, np.zeros(1), np.zeros(1))
    tell(f"writing {file.name}")
    write_panels(file, panels)
    return panels
