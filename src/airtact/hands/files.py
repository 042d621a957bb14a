"""Read hands and landmarks from JSON files, and point clouds."""

import io
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from airtact.checks import counted, points_of
from airtact.errors import LARGEST_POSE, InvalidInput, about
from airtact.files.bounded import array_of, text_of
from airtact.geometry.files import bare_vertices
from airtact.hands.hand import Hand, hand_from_joints
from airtact.hands.joints import NAMES, named_joints

KEYS = ("joints", "positions_m", "radii_m", "side")
"""Keys of a pose: names of joints, their positions and radii [m], "left" or "right"."""

ROOM = 0.2
"""Largest distance of a focus from a place of a hand [m]."""


def load_hand(path: str | Path, gap: float | None = None) -> Hand:
    """Read a hand's pose from a JSON file.

    Parameters
    ----------
    path : a file with ``positions_m``, 25 points in the order of WebXR or 21 in that of MediaPipe
        [m]; ``joints``, the 25 names of WebXR, only where the 25 points are in another order;
        ``radii_m``, a number for each point, and ``side``, where they are known.
    gap : turns thumb and index finger until the skins of their last phalanges are this far apart
        [m], above 0 and at most 0.15; None leaves the pose.

    Raises
    ------
    InvalidInput
        The file cannot be read or is no pose, no hand has these joints, or no turn gives the gap; the sentence begins
        with the file's name.
    """
    path = Path(path)
    with about(path.name or str(path)):
        pose = _pose_in(path)
        radii = _numbers(pose, "radii_m", ()) if "radii_m" in pose else None
        names = pose.get("joints")
        points = _numbers(pose, "positions_m", (3,))
        if radii is not None and len(radii) != len(points):
            sentence = f"{len(radii)} joints have radii and {len(points)} have positions; give one for one."
            raise InvalidInput(sentence, code="sizes_differ")
        if names is not None and tuple(names) != NAMES:
            if len(names) != len(points):
                sentence = f"{len(names)} joints have names and {len(points)} have positions; give one for one."
                raise InvalidInput(sentence, code="sizes_differ")
            order = {name: index for index, name in enumerate(names)}
            if len(order) < len(names):
                twice = counted(len(names) - len(order), "joint is", "joints are")
                raise InvalidInput(f"{twice} there twice.", code="given_twice")
            points = named_joints({name: points[index] for name, index in order.items()})
            radii = None if radii is None else radii[[order[name] for name in NAMES]]
        hand = hand_from_joints(points, radii, side=pose.get("side"))
        return hand if gap is None else hand.open_to(gap)


def load_landmarks(path: Path) -> tuple[Float64[np.ndarray, "joints 3"], str | None]:
    """Read the rough joints of a tracker.

    Parameters
    ----------
    path : a JSON file of a pose, as for ``load_hand``; radii are ignored.

    Returns
    -------
    (25, 3) or (21, 3) joints [m], and ``"right"``, ``"left"`` or None.

    Raises
    ------
    InvalidInput
        The file cannot be read or is no pose; the sentence begins with the file's name.
    """
    with about(path.name or str(path)):
        pose = _pose_in(path)
        points, names = _numbers(pose, "positions_m", (3,)), pose.get("joints")
        if names is not None and tuple(names) != NAMES:
            sentence = f"the {len(names)} joints are not named in the order of WebXR: give them in that order."
            raise InvalidInput(sentence, code="hand_implausible")
        return points, pose.get("side")


def _numbers(
    pose: dict[str, Any], key: str, each: tuple[int, ...]
) -> Float64[np.ndarray, "joints *each"]:
    """Return the numbers under a key, an array of shape ``each`` for each joint."""
    count, what = len(pose[key]), "3 numbers" if each else "number"
    try:
        numbers = np.array(pose[key], dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (count, *each):
        sentence = (
            f"{key} holds no {what} for each of its {count} joints; give [x, y, z] in metres."
        )
        raise InvalidInput(sentence, code="not_a_number")
    return numbers


def _pose_in(path: Path) -> dict[str, Any]:
    """Read a JSON file, and raise where it holds no pose."""
    try:
        pose = json.loads(text_of(path, LARGEST_POSE))
    except RecursionError:
        raise InvalidInput(
            f"this is no pose of a hand: {path.stat().st_size} bytes of brackets in brackets.",
            code="wrong_kind",
        ) from None
    except json.JSONDecodeError as error:
        raise InvalidInput(
            f"this is not JSON: line {error.lineno} is at fault.", code="file_unreadable"
        ) from None
    except InvalidInput:
        raise
    except ValueError as error:  # a number of too many digits
        raise InvalidInput(
            f"a number of it cannot be read: {error}.", code="file_unreadable"
        ) from None
    if not isinstance(pose, dict) or not isinstance(pose.get("positions_m"), list):
        raise InvalidInput(
            "this is no pose of a hand: it has 0 points under positions_m.", code="wrong_kind"
        )
    unknown = [key for key in pose if key not in KEYS]
    if unknown:
        raise InvalidInput(
            f"{unknown[0]} is not 1 of the keys of a pose: {', '.join(KEYS)}.", code="unknown_key"
        )
    for key in ("joints", "radii_m"):
        if key in pose and not isinstance(pose[key], list):
            sentence = f"{key} is {pose[key]!r}, but it must be a list, one for each of the joints."
            raise InvalidInput(sentence, code="wrong_kind")
    for index, name in enumerate(pose.get("joints", ())):
        if not isinstance(name, str):
            sentence = (
                f"joint {index} is named {name!r}, but names are those of WebXR, such as 'wrist'."
            )
            raise InvalidInput(sentence, code="unknown_name")
    return pose


CLOUD_ENDINGS = (".ply", ".xyz", ".npy")
"""Endings of the names of files that clouds are read from."""


def load_cloud(path: Path) -> Float64[np.ndarray, "points 3"]:
    """Read a point cloud.

    Parameters
    ----------
    path : a PLY file, of which only the vertices are read; XYZ text; or a (N, 3) array of NumPy
        [m].

    Raises
    ------
    InvalidInput
        The file does not exist, cannot be read or holds no points.
    """
    if path.suffix.lower() not in CLOUD_ENDINGS:
        sentence = (
            f"{path} ends in {path.suffix!r}, but clouds are read from {', '.join(CLOUD_ENDINGS)}."
        )
        raise InvalidInput(sentence, code="unknown_format")
    if not path.is_file():
        raise InvalidInput(
            f"the file {path} does not exist; 0 points were read.", code="file_missing"
        )
    suffix = path.suffix.lower()
    points = (
        array_of(path)
        if suffix == ".npy"
        else bare_vertices(path)
        if suffix == ".ply"
        else _points_in_text(path)
    )
    with about(path.name):
        return points_of(points, "points of a cloud")


def _points_in_text(path: Path) -> Float64[np.ndarray, "points 3"]:
    """Read the first three numbers of each line, between spaces or commas."""
    text = text_of(path).replace(",", " ")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore"
            )  # of a file without a line, which is said by who asks for points
            return np.loadtxt(io.StringIO(text), usecols=(0, 1, 2), ndmin=2)
    except ValueError as fault:
        raise InvalidInput(
            f"{path.name} cannot be read as x, y, z in 1 line: {fault}.", code="file_unreadable"
        ) from None
