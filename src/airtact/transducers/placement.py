"""Whether an array and what stands before it can be real: no element in a body, nothing behind a face."""

import numpy as np
from jaxtyping import Float64, Real
from scipy.spatial import ConvexHull

from airtact.conventions import InvalidInput
from airtact.scene.scene import CONTACT, Scene, check_not_inside
from airtact.transducers.element import check_pattern
from airtact.transducers.layout import PhasedArray
from airtact.validation import counted, in_mm, of_kind

FARTHEST = 10.0
"""Farthest that an element may stand from a focus or the nearest body [m]."""


def check_placement(scene: Scene, array: PhasedArray, foci: Real[np.ndarray, "foci 3"] | None = None) -> None:
    """Refuse an array that cannot stand in a scene.

    Parameters
    ----------
    scene : what is in the air.
    array : the transducers, in the scene's frame.
    foci : (F, 3) points that must lie before the faces of directional elements [m], if any.

    Raises
    ------
    InvalidInput
        If an element reaches into a body (which one, how deep); if, with directional elements, a focus or a body stands
        behind a face (how many faces, which first, how far); if a face is too large for its points at this frequency.
    """
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)")
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    check_pattern(array.element, scene.wavenumber)
    _check_outside_bodies(scene, array)
    if foci is not None:
        check_reach(array, foci)
    if not array.element.directional:
        return
    for index, obstacle in enumerate(scene.obstacles):
        vertices = obstacle.surface.corners.reshape(-1, 3)
        _check_body_before_faces(array, vertices[ConvexHull(vertices).vertices], index)


def _check_outside_bodies(scene: Scene, array: PhasedArray) -> None:
    """Refuse elements whose centre or face points lie in a body; only faces near a skin are looked at in full."""
    depth = scene.depth(array.positions)
    if scene.obstacles:
        _check_far(-depth, "the nearest body")
    if array.element.reach == 0.0:
        check_not_inside(depth, array.positions, "element")
        return
    near = np.flatnonzero(depth > -array.element.reach)
    if len(near):
        depth[near] = scene.depth(array.face_points[near].reshape(-1, 3)).reshape(len(near), -1).max(axis=1)
    inside = np.flatnonzero(depth > CONTACT)
    if len(inside):
        deepest = int(depth.argmax())
        count = counted(len(array), "element", "elements")
        raise InvalidInput(
            f"the faces of {len(inside)} of {count} reach into a body: element {deepest} at "
            f"{in_mm(array.positions[deepest])} by {depth[deepest] * 1e3:.3g} mm; move the array or the body away.",
            code="array_inside_body",
        )


def _check_far(distance: Float64[np.ndarray, "elements"], what: str) -> None:
    farthest = int(distance.argmax())
    if distance[farthest] > FARTHEST:
        raise InvalidInput(
            f"element {farthest} stands {distance[farthest]:.4g} m from {what}, more than {FARTHEST:g} m: is the array "
            "or its pose in millimetres? Give metres.",
            code="too_far",
        )


def check_reach(array: PhasedArray, foci: Real[np.ndarray, "foci 3"]) -> None:
    """Refuse foci that an array cannot reach.

    Parameters
    ----------
    array : the transducers.
    foci : (F, 3) points [m].

    Raises
    ------
    InvalidInput
        If an element stands over 10 m from a focus, or a focus behind the face of a directional element.
    """
    for index, focus in enumerate(foci):
        offsets = array.positions - focus
        _check_far(np.sqrt(np.einsum("ed,ed->e", offsets, offsets)), f"focus {index}")
    if array.element.directional:
        check_before_faces(array, foci, "focus")


def check_before_faces(array: PhasedArray, points: Real[np.ndarray, "points 3"], what: str) -> None:
    """Refuse points behind the faces of an array's elements.

    Parameters
    ----------
    array : the transducers.
    points : (P, 3) points [m].
    what : what a point is called in the message.

    Raises
    ------
    InvalidInput
        If a point stands behind a face: which point, behind how many faces, which first, how far.
    """
    behind = -_height(array, points)
    worst = behind.max(axis=1)
    if worst.max() > CONTACT:
        point = int(np.argmax(worst))
        faces = np.flatnonzero(behind[point] > CONTACT)
        count = counted(len(faces), "element", "elements")
        raise InvalidInput(
            f"{what} {point} stands behind the faces of {count}, first element {faces[0]} by "
            f"{behind[point, faces[0]] * 1e3:.3g} mm: they radiate forwards only, so move it before them.",
            code="behind_faces",
        )


def _check_body_before_faces(array: PhasedArray, vertices: Float64[np.ndarray, "vertices 3"], index: int) -> None:
    """Refuse a body, given by the corners of its convex hull, that reaches behind a face."""
    behind = -_height(array, vertices).min(axis=0)
    faces = np.flatnonzero(behind > CONTACT)
    if len(faces):
        count = counted(len(faces), "element", "elements")
        raise InvalidInput(
            f"body {index} reaches behind the faces of {count}, first element {faces[0]} by "
            f"{behind[faces[0]] * 1e3:.3g} mm: they radiate forwards only, so move it before them.",
            code="behind_faces",
        )


def _height(array: PhasedArray, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points elements"]:
    """Return how far each point stands before each face [m], negative behind."""
    return points @ array.normals.T - np.sum(array.positions * array.normals, axis=1)
