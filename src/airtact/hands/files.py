"""Read hands from JSON and from rigs of mesh files, landmarks of trackers, and point clouds."""

import io
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from airtact.errors import InvalidInput, about, of_kind, points_of, positive
from airtact.files.bounded import array_of, text_of
from airtact.files.meshes import read_node_positions, read_vertices
from airtact.hands.hand import Hand, hand_from_joints
from airtact.hands.joints import NAMES, Points, Side, named_joints

ROOM = 0.2
"""Largest distance of a focus from a place of a hand [m]."""

CLOUD_ENDINGS = (".ply", ".xyz", ".npy")
"""Endings of the names of files that clouds are read from."""


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
        The file cannot be read or is no pose, no hand has these joints, or no turn gives the gap;
        the sentence begins with the file's name.
    """
    path = Path(path)
    with about(path.name or str(path)):
        pose = _read_pose(path)
        points = _numbers(pose, "positions_m", (3,))
        radii = _numbers(pose, "radii_m", ()) if "radii_m" in pose else None
        names = pose.get("joints")
        if radii is not None:
            _check_count(radii, points, "radii")
        # Other orders need all 25 names; radii are brought into the same order.
        if names is not None and tuple(names) != NAMES:
            _check_count(names, points, "names")
            order = {name: index for index, name in enumerate(names)}
            if len(order) < len(names):
                raise InvalidInput("joints are given twice.", code="given_twice")
            points = named_joints({name: points[index] for name, index in order.items()})
            if radii is not None:
                radii = radii[[order[name] for name in NAMES]]
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
        pose = _read_pose(path)
        points = _numbers(pose, "positions_m", (3,))
        names = pose.get("joints")
        if names is not None and tuple(names) != NAMES:
            raise InvalidInput(
                f"the {len(names)} joints are not named in the order of WebXR; give them in it.",
                code="hand_implausible",
            )
        return points, pose.get("side")


def _read_pose(path: Path) -> dict[str, Any]:
    """Read a JSON file, and raise where it holds no pose."""
    text = text_of(path, 1_000_000)
    try:
        pose = json.loads(text)
    # Deep nesting or endless digits must not end in a traceback.
    except RecursionError:
        raise InvalidInput(
            "this is no pose of a hand: its brackets are nested too deep.", code="wrong_kind"
        ) from None
    except json.JSONDecodeError as error:
        raise InvalidInput(
            f"this is not JSON: line {error.lineno} is at fault.", code="file_unreadable"
        ) from None
    except ValueError as error:  # a number of too many digits
        raise InvalidInput(f"a number cannot be read: {error}.", code="file_unreadable") from None
    if not isinstance(pose, dict) or not isinstance(pose.get("positions_m"), list):
        raise InvalidInput(
            "this is no pose of a hand; give a list of points as positions_m.", code="wrong_kind"
        )
    keys = ("joints", "positions_m", "radii_m", "side")
    unknown = [key for key in pose if key not in keys]
    if unknown:
        raise InvalidInput(
            f"{unknown[0]} is no key of a pose; the keys are {', '.join(keys)}.",
            code="unknown_key",
        )
    for key in ("joints", "radii_m"):
        if key in pose and not isinstance(pose[key], list):
            raise InvalidInput(
                f"{key} is {pose[key]!r}; give a list with an entry for each joint.",
                code="wrong_kind",
            )
    for index, name in enumerate(pose.get("joints", ())):
        if not isinstance(name, str):
            raise InvalidInput(
                f"joint {index} is named {name!r}; give a name of WebXR, such as 'wrist'.",
                code="unknown_name",
            )
    return pose


def _numbers(
    pose: dict[str, Any], key: str, shape: tuple[int, ...]
) -> Float64[np.ndarray, "joints *shape"]:
    """Return the numbers under a key, an array of ``shape`` for each joint."""
    # Nested lists of unequal lengths and texts raise different errors, reported by one sentence.
    try:
        numbers = np.array(pose[key], dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (len(pose[key]), *shape):
        form = "[x, y, z] in metres" if shape else "one number in metres"
        raise InvalidInput(
            f"{key} must hold {form} for each of its {len(pose[key])} joints.",
            code="not_a_number",
        )
    return numbers


def _check_count(values: Any, points: Float64[np.ndarray, "joints 3"], name: str) -> None:
    if len(values) != len(points):
        raise InvalidInput(
            f"there are {len(values)} {name} for {len(points)} positions; give one for each.",
            code="sizes_differ",
        )


def load_rigged_hand(path: str | Path, scale: float = 1.0, side: Side | None = None) -> Hand:
    """Read the hand of the joints that the rig of a mesh file has.

    The nodes and their transforms are those of *glTF 2.0* (Khronos Group), section 3.5.

    Parameters
    ----------
    path : a GLB file whose nodes have the 25 names of WebXR, at rest where its mesh is.
    scale : metres per unit of the file, as for ``load_surface``.
    side : ``"right"`` or ``"left"``; found from the bends of the fingers unless given.

    Raises
    ------
    InvalidInput
        The file cannot be read, its rig lacks joints (how many, and the first names), or no hand
        has these joints.
    """
    of_kind(path, str | Path, "the path of a hand", "the name of a file")
    path = Path(path)
    scale = positive(scale, "scale", "m per unit of the file")
    nodes = read_node_positions(path)
    with about(path.name):
        joints = {name: scale * nodes[name] for name in NAMES if name in nodes}
        return hand_from_joints(named_joints(joints), side=side)


def load_cloud(path: Path) -> Points:
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
    suffix = path.suffix.lower()
    if suffix not in CLOUD_ENDINGS:
        raise InvalidInput(
            f"{path} ends in {path.suffix!r}, but clouds are read from {', '.join(CLOUD_ENDINGS)}.",
            code="unknown_format",
        )
    if suffix == ".npy":
        points = array_of(path)
    elif suffix == ".ply":
        points = read_vertices(path)
    else:
        points = _points_in_text(path)
    with about(path.name):
        return points_of(points, "points of a cloud")


def _points_in_text(path: Path) -> Points:
    """Read the first three numbers of each line, between spaces or commas."""
    text = text_of(path).replace(",", " ")
    try:
        with warnings.catch_warnings():
            # A file without a line gives no points, which load_cloud reports.
            warnings.simplefilter("ignore")
            return np.loadtxt(io.StringIO(text), usecols=(0, 1, 2), ndmin=2)
    except ValueError as fault:
        raise InvalidInput(
            f"{path.name} does not hold x, y, z in each line: {fault}.", code="file_unreadable"
        ) from None
