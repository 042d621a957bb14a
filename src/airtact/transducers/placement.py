"""Checks of an array in a scene: no element in a body, nothing behind a face."""

import numpy as np
from jaxtyping import Bool, Float64, Real
from scipy.spatial import ConvexHull

from airtact.acoustics.planes import Plane, check_before_planes
from airtact.acoustics.scene import CONTACT, Scene, check_not_inside
from airtact.checks import counted, in_mm, of_kind
from airtact.errors import InvalidInput
from airtact.transducers.boards import kind_of_array
from airtact.transducers.element import check_pattern
from airtact.transducers.layout import PhasedArray
from airtact.transducers.plates import strength_in

LET_IN = 1e-9
"""Elements on a plane whose normals are the plane's but for this, 1 less the cosine, are part of it."""

MAX_ELEMENT_DISTANCE = 10.0
"""Largest distance of an element from a focus or the nearest body [m]."""


def check_placement(
    scene: Scene, array: PhasedArray, foci: Real[np.ndarray, "foci 3"] | None = None
) -> None:
    """Raise where an array cannot be where it is in a scene; ``foci`` (F, 3) must be in front of directional elements.

    Raises
    ------
    InvalidInput
        "bodies_overlap", "inside_body": an element reaches into a body; "behind_plane": or behind a plane;
        "behind_faces": a focus or a body, or its image in a plane, is behind the face of a directional element; bodies
        may be where the scene has the array's boards, which shade them; "not_supported": an element is not in the
        face of these; "out_of_range", "out_of_range", "wrong_kind".
    """
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)")
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    check_pattern(array.element, scene.wavenumber)
    _check_outside_bodies(scene, array)
    check_before_planes(scene.planes, array.face_points.reshape(-1, 3), "face")
    if foci is not None:
        check_reach(array, foci)
    if strength_in(scene, array) != 1.0 or not array.element.directional:
        return
    for index, obstacle in enumerate(scene.obstacles):
        _check_body(array, obstacle.surface.corners.reshape(-1, 3), f"body {index} reaches")
    for plane in scene.planes:
        _check_images(plane, scene, array, foci)


def _check_body(
    array: PhasedArray,
    vertices: Float64[np.ndarray, "vertices 3"],
    what: str,
    some: Bool[np.ndarray, "elements"] | None = None,
) -> None:
    """Raise where a body reaches behind the face of an element, or of some of them."""
    middle = vertices.mean(axis=0)
    radius = np.sqrt(np.max(np.sum((vertices - middle) ** 2, axis=1)))
    if _height(array, middle[None]).min() > radius:
        return
    hull = vertices[ConvexHull(vertices).vertices]
    behind = -_height(array, hull).min(axis=0)
    _check_behind(array, behind if some is None else np.where(some, behind, 0.0), what)


def _check_images(
    plane: Plane, scene: Scene, array: PhasedArray, foci: Real[np.ndarray, "foci 3"] | None = None
) -> None:
    """Raise where the image of a body or a focus is behind a face: that of the element would sound backwards."""
    reflecting = off_plane(plane, array)
    for index, height in enumerate(_height(array, plane.image(foci)) if foci is not None else ()):
        _check_behind(
            array,
            np.where(reflecting, -height, 0.0),
            f"the image of focus {index} in the plane stands",
        )
    for index, obstacle in enumerate(scene.obstacles):
        mirrored = plane.image(obstacle.surface.corners.reshape(-1, 3))
        _check_body(array, mirrored, f"the image of body {index} in the plane reaches", reflecting)


def off_plane(plane: Plane, array: PhasedArray) -> Bool[np.ndarray, "elements"]:
    """Which elements radiate towards a plane: all but those let into it, whose faces are part of it."""
    let_in = (array.normals @ plane.normal > 1.0 - LET_IN) & (
        np.abs(plane.height(array.positions)) < CONTACT
    )
    return ~let_in


def _check_outside_bodies(scene: Scene, array: PhasedArray) -> None:
    """Raise where the centre or a face point of an element lies in a body; only faces near a surface are evaluated."""
    depth = scene.depth(array.positions)
    if scene.obstacles:
        _check_far(-depth, "the nearest body")
    if array.element.reach == 0.0:
        check_not_inside(depth, array.positions, "element")
        return
    near = np.flatnonzero(depth > -array.element.reach)
    if len(near):
        faces = (
            scene.depth(array.face_points[near].reshape(-1, 3)).reshape(len(near), -1).max(axis=1)
        )
        depth[near] = np.maximum(depth[near], faces)
    inside = np.flatnonzero(depth > CONTACT)
    if len(inside):
        deepest = int(depth.argmax())
        count = counted(len(array), "element", "elements")
        raise InvalidInput(
            f"the faces of {len(inside)} of {count} reach into a body: element {deepest} at "
            f"{in_mm(array.positions[deepest])} by {depth[deepest] * 1e3:.3g} mm; move the array or the body away.",
            code="bodies_overlap",
        )


def _check_far(distance: Float64[np.ndarray, "elements"], what: str) -> None:
    farthest = int(distance.argmax())
    if distance[farthest] > MAX_ELEMENT_DISTANCE:
        raise InvalidInput(
            f"element {farthest} stands {distance[farthest]:.4g} m from {what}, more than "
            f"{MAX_ELEMENT_DISTANCE:g} m: is the array or its pose in millimetres? Give metres.",
            code="not_in_metres",
        )


def check_reach(array: PhasedArray, foci: Real[np.ndarray, "foci 3"]) -> None:
    """Raise "out_of_range" for a focus (F, 3) over 10 m from an element; as ``check_before_faces`` for directional ones."""
    for index, focus in enumerate(foci):
        offsets = array.positions - focus
        _check_far(np.sqrt(np.einsum("ed,ed->e", offsets, offsets)), f"focus {index}")
    if array.element.directional:
        check_before_faces(array, foci, "focus")


def check_before_faces(array: PhasedArray, points: Real[np.ndarray, "points 3"], what: str) -> None:
    """Raise "behind_faces" for a point (P, 3) behind the face of an element; ``what`` names one point."""
    behind = -_height(array, points)
    point = int(np.argmax(behind.max(axis=1)))
    _check_behind(array, behind[point], f"{what} {point} stands")


def _check_behind(array: PhasedArray, behind: Float64[np.ndarray, "elements"], what: str) -> None:
    """Raise where something is behind a face; ``behind`` is how far it is behind each [m]."""
    faces = np.flatnonzero(behind > CONTACT)
    if len(faces):
        _check_boards(array, behind, what)
        count = counted(len(faces), "element", "elements")
        raise InvalidInput(
            f"{what} behind the faces of {count}, first element {faces[0]} by "
            f"{behind[faces[0]] * 1e3:.3g} mm: they radiate forwards only, so move it before them.",
            code="behind_faces",
        )


def _check_boards(array: PhasedArray, behind: Float64[np.ndarray, "elements"], what: str) -> None:
    """Raise for a board that has something behind all its faces, if the array consists of boards."""
    if (found := kind_of_array(array.positions, array.normals)) is None:
        return
    board, poses = found
    depths = behind.reshape(len(poses), len(board)).min(axis=1)
    index = int(np.argmax(depths > CONTACT))
    if depths[index] > CONTACT:
        raise InvalidInput(
            f"{what} {depths[index] * 1e3:.3g} mm behind board {index} of {len(poses)} ({board.name}, {len(board)} "
            f"elements), which radiates forwards only, along {np.round(poses[index].rotation[:, 2], 3) + 0.0}: turn or "
            "move that board.",
            code="behind_faces",
        )


def _height(
    array: PhasedArray, points: Real[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "points elements"]:
    """Distance of each point in front of each face [m], negative behind."""
    return points @ array.normals.T - np.sum(array.positions * array.normals, axis=1)
