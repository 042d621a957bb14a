"""Named positions on the mesh of a hand: the joints of its rig, or given ones, and the surface nearest to their pads.

Sources
-------
- *WebXR Hand Input Module* (W3C): names of the 25 joints.
- *glTF 2.0* (Khronos Group), section 3.5: nodes and their transforms.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.target_points import outward
from airtact.checks import fixed, of_kind, positive
from airtact.errors import InvalidInput, about
from airtact.geometry.files import node_positions
from airtact.geometry.surface import Surface
from airtact.hands.hand import Hand, hand_from_joints
from airtact.hands.joints import NAMES, Side, named_joints

FARTHEST = 10e-3
"""Largest distance of a hand's pad or palm from the mesh of the same hand [m]: those of four hands in five poses
are within 5 mm."""

STEEPEST = 60.0
"""Largest angle between the normals of the hand and of its mesh there [degrees]; 12 degrees in those hands."""

LISTED = 3
"""So many missing names stand in a sentence."""


def load_rigged_hand(path: str | Path, scale: float = 1.0, side: Side | None = None) -> Hand:
    """Read the hand of the joints that the rig of a mesh file has.

    Parameters
    ----------
    path : a GLB file whose nodes have the 25 names of WebXR, at rest where its mesh is.
    scale : metres per unit of the file, as for ``load_surface``.
    side : ``"right"`` or ``"left"``; found from the bends of the fingers unless given.

    Raises
    ------
    InvalidInput
        The file cannot be read, its rig lacks joints (how many, and the first names), or no hand has these joints.
    """
    of_kind(path, str | Path, "the path of a hand", "the name of a file")
    path, scale = Path(path), positive(scale, "scale", "m per unit of the file")
    nodes = node_positions(path)
    with about(path.name):
        missing = [name for name in NAMES if name not in nodes]
        if missing:
            listed = ", ".join(missing[:LISTED]) + (", ..." if len(missing) > LISTED else "")
            raise InvalidInput(
                f"its nodes lack {len(missing)} of the {len(NAMES)} joints of WebXR ({listed}).",
                code="joint_missing",
            )
        return hand_from_joints(
            named_joints({name: scale * nodes[name] for name in NAMES}), side=side
        )


def places_on(
    surface: Surface, hand: Hand
) -> Mapping[str, tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]]:
    """Find the pads and the palm of a hand on another surface of the same hand, such as a scan.

    Parameters
    ----------
    surface : of the hand, in the frame of the joints.
    hand : built from the joints.

    Returns
    -------
    The point of the surface (3,) [m] nearest to each of ``hand.places``, and the outward unit normal there (3,).

    Raises
    ------
    InvalidInput
        A pad or the palm is farther than 10 mm from the surface, or faces another way by more than 60 degrees, as where
        the joints are of another frame or another pose, or fingers touch there.
    """
    of_kind(surface, Surface, "the surface", "one Surface, such as load_surface(path)")
    of_kind(hand, Hand, "the hand", "one Hand, such as load_rigged_hand(path)")
    points = np.array([point for point, _ in hand.places.values()])
    expected = np.array([normal for _, normal in hand.places.values()])
    found = surface.shape.project(points)
    normals = outward(surface.depth, found)
    away = np.linalg.norm(found - points, axis=1)
    turned = np.degrees(np.arccos(np.clip(np.einsum("pi,pi->p", normals, expected), -1.0, 1.0)))
    for name, point, distance, angle in zip(hand.places, points, away, turned, strict=True):
        far = distance > FARTHEST
        if far or angle > STEEPEST:
            fault = (
                f"{1e3 * distance:.3g} mm from the surface, more than {1e3 * FARTHEST:g} mm"
                if far
                else f"turned from the surface by {angle:.0f} degrees, more than {STEEPEST:g}"
            )
            raise InvalidInput(
                f"{name} of the joints is {fault}: are joints and mesh of one hand, in one pose and one frame, in "
                "metres?",
                point,
                code="misplaced",
            )
    return {
        name: (fixed(found[index]), fixed(normals[index])) for index, name in enumerate(hand.places)
    }
