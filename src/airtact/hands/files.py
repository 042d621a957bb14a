"""Functions that read hands, tracker landmarks and point clouds from files."""

import io
import re
import warnings
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float64

from airtact.errors import InvalidInput, about, path_of, points_of, positive
from airtact.files.bounded import json_of, text_of
from airtact.files.meshes import SUFFIXES, read_node_positions, read_vertices
from airtact.hands.hand import Hand, hand_from_joints
from airtact.hands.joints import NAMES, Points, Side, side_named

# File name extensions of point clouds.
CLOUD_ENDINGS = (".ply", ".xyz")


class Pose(msgspec.Struct, forbid_unknown_fields=True):
    """The contents of a JSON file with the pose of a hand; ``load_hand`` reads and checks it.

    Attributes
    ----------
    positions_m : positions of 25 joints in WebXR order, 26 in OpenXR order or 21 in MediaPipe order
        [m]. Their frame becomes the frame of the hand.
    joints : the 25 names of WebXR in order; None if the file does not contain them.
    radii_m : radius of the skin around each joint [m]; None for a generic hand of the same size.
    side : "right" or "left"; None to infer the side from how the fingers bend.
    """

    positions_m: list[tuple[float, float, float]]
    joints: list[str] | None = None
    radii_m: list[float] | None = None
    side: str | None = None


def load_hand(path: str | Path, gap: float | None = None) -> Hand:
    """Read a hand's pose from a JSON file.

    Parameters
    ----------
    path : a JSON file with the key ``positions_m``, an array of 25 points in WebXR order, 26 in
        OpenXR order or 21 in MediaPipe order [m]. Optional keys are ``radii_m`` (one radius for
        each point [m]; by default those of a generic hand of the same size), ``side`` ("left" or
        "right"; by default inferred from how the fingers bend), and ``joints`` (the 25 names of
        WebXR in order, as a check).
    gap : distance to set between the skins of the last phalanges of thumb and index finger [m],
        above 0 and at most 0.15. Both fingers are turned at their roots to set this gap. None, the
        default, leaves the pose unchanged.

    Returns
    -------
    The ``Hand`` in the pose that the file contains, in the frame of the file.

    Raises
    ------
    InvalidInput
        If the file is unreadable or does not contain a pose, if the joints do not form a plausible
        hand, or if the gap cannot be reached. The message begins with the name of the file.
    """
    path = path_of(path, "the path of a hand")
    with about(path.name or str(path)):
        pose = _read_pose(path)
        hand = hand_from_joints(
            np.array(pose.positions_m),
            None if pose.radii_m is None else np.array(pose.radii_m),
            side=side_named(pose.side),
        )
        return hand if gap is None else hand.open_to(gap)


def load_landmarks(path: str | Path) -> tuple[Float64[np.ndarray, "joints 3"], Side | None]:
    """Read joint positions from a file, without checking that they form a plausible hand.

    Parameters
    ----------
    path : a JSON file in the format of ``load_hand``; its radii are ignored.

    Returns
    -------
    The joints as in the file, (25, 3) in WebXR order, (26, 3) in OpenXR order or (21, 3) in
    MediaPipe order [m], and the side: ``"right"``, ``"left"``, or None if the file does not state
    it. ``fit_hand`` takes 25 or 21 joints as ``landmarks``, and the side.

    Raises
    ------
    InvalidInput
        If the file is unreadable or does not contain a pose. The message begins with the name of
        the file.
    """
    path = path_of(path, "the path of a hand")
    with about(path.name or str(path)):
        pose = _read_pose(path)
        return np.array(pose.positions_m), side_named(pose.side)


def _read_pose(path: Path) -> Pose:
    if path.suffix.lower() in SUFFIXES:
        raise InvalidInput(
            f"a pose is a .json file with the joints of a hand, but {path.suffix} files contain "
            f'meshes: in a scene file, set surface = "{path.name}" instead; in Python, use '
            "load_surface for the skin and load_rigged_hand for the joints of a .glb file.",
            code="unknown_format",
        )
    text = text_of(path, 1_000_000)
    try:
        pose = msgspec.convert(json_of(text), Pose)
    # Deep nesting must not cause a traceback.
    except (ValueError, RecursionError) as error:  # msgspec raises subclasses of ValueError
        raise InvalidInput(
            "the file does not contain a hand pose: "
            f"{error or 'its brackets are nested too deeply'}.",
            code="wrong_kind",
        ) from None
    if not pose.positions_m or (pose.joints is not None and tuple(pose.joints) != NAMES):
        raise InvalidInput(
            f"positions_m contains {len(pose.positions_m)} points, and joints contains "
            f"{len(pose.joints or ())} names. Omit joints, or list the 25 names of WebXR in order, "
            "with one position for each.",
            code="hand_implausible",
        )
    if pose.radii_m is not None and len(pose.radii_m) != len(pose.positions_m):
        raise InvalidInput(
            f"there are {len(pose.radii_m)} radii for {len(pose.positions_m)} positions; use one "
            "for each.",
            code="sizes_differ",
        )
    return pose


def load_rigged_hand(path: str | Path, scale: float = 1.0, side: Side | None = None) -> Hand:
    """Build a hand from the joints of the rig in a mesh file; the mesh itself is not used.

    The skin is a generic one around the joints. For the skin in the file, use ``load_surface`` and
    ``places_on``. The nodes and their transforms are defined in *glTF 2.0* (Khronos Group), section
    3.5.

    Parameters
    ----------
    path : a GLB file with nodes that have the 25 joint names of WebXR, such as "wrist" and
        "index-finger-tip". Other nodes are ignored.
    scale : metres per unit of length in the file, above 0; 1 by default, as glTF specifies.
    side : ``"right"`` or ``"left"``; by default it is inferred from how the fingers bend.

    Returns
    -------
    The ``Hand``, in metres, in the pose of the nodes and in the frame of the file.

    Raises
    ------
    InvalidInput
        If the file is unreadable, if its rig lacks joints, if the scale is not above 0, if the
        joints do not form a plausible hand, or if they bend like those of the other side or too
        little to infer the side.
    """
    path = path_of(path, "the path of a hand")
    scale = positive(scale, "scale", "m per unit of the file")
    nodes = read_node_positions(path)
    with about(path.name):
        missing = [name for name in NAMES if name not in nodes]
        if missing:
            listed = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
            raise InvalidInput(
                f"{len(missing)} of the 25 joints of WebXR are missing ({listed}): give the nodes "
                "of the joints their WebXR names.",
                code="joint_missing",
            )
        return hand_from_joints(scale * np.array([nodes[name] for name in NAMES]), side=side)


def load_cloud(path: str | Path) -> Points:
    """Read a point cloud from a file, such as a depth camera's view of a hand for ``fit_hand``.

    Parameters
    ----------
    path : a PLY file (.ply; only its vertices are used), or a text file (.xyz) whose lines begin
        with x, y and z, separated by spaces or commas. Both are in metres.

    Returns
    -------
    The points (P, 3) [m], in the order and the frame of the file.

    Raises
    ------
    InvalidInput
        If the file is missing or unreadable, contains no points or a coordinate that is not finite,
        or does not end in .ply or .xyz.
    """
    path = path_of(path, "the path of a cloud")
    suffix = path.suffix.lower()
    if suffix not in CLOUD_ENDINGS:
        raise InvalidInput(
            f"{path} ends in {path.suffix!r}, but a point cloud must end in "
            f"{' or '.join(CLOUD_ENDINGS)}.",
            code="unknown_format",
        )
    points = read_vertices(path) if suffix == ".ply" else _points_in_text(path)
    with about(path.name):
        return points_of(points, "points of a cloud")


def _points_in_text(path: Path) -> Points:
    text = text_of(path)
    if re.search(r"[0-9],[0-9]\S*[ \t]+\S*[0-9],[0-9]", text):
        raise InvalidInput(
            f"{path.name} has commas within numbers; use decimal points.", code="file_unreadable"
        )
    text = text.replace(",", " ")
    try:
        with warnings.catch_warnings():
            # load_cloud reports empty files.
            warnings.simplefilter("ignore")
            return np.loadtxt(io.StringIO(text), usecols=(0, 1, 2), ndmin=2)
    except ValueError as fault:
        raise InvalidInput(
            f"each line of {path.name} must begin with x, y and z: {fault}.",
            code="file_unreadable",
        ) from None
