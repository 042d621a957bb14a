"""Meshes that follow a hand from frame to frame: the triangles stay, their corners move with the bones."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.hand.skin_mesh import Skin, settled
from airtact.hand.sphere_mesh import Hulls
from airtact.pose import nearest_motion
from airtact.printing import in_short

FARTHEST = 12e-3
"""A mesh is made anew where a ball has moved farther [m], after the motion of the whole hand is taken out."""

SOFT = 3e-3
"""Corners follow hulls nearly as near as the nearest, those within about this [m]."""

LEAST_ANGLE = 20.0
"""Meshes whose smallest angle would be below this are made anew [degrees]."""

STRETCHED = 2.0
"""So are those with an edge longer than this over the one asked for."""


@dataclass(frozen=True, eq=False)
class Followed:
    """A body of the frame before, with its meshes.

    Attributes
    ----------
    hulls : the body then.
    kept : its meshes by their edge [m].
    """

    hulls: Hulls
    kept: Mapping[float, Skin]

    __repr__ = in_short

    def deformed(self, hulls: Hulls, edge: float) -> Skin | None:
        """Deform the mesh of an edge to a new pose.

        Parameters
        ----------
        hulls : the body now.
        edge : that was asked for [m].

        Returns
        -------
        The mesh with the same triangles, or None where there is none or it would not be good: the hand has moved too
        far, other parts touch, or triangles would get too thin or long.
        """
        if edge not in self.kept or np.any(hulls.apart != self.hulls.apart):
            return None
        turn, shift = _rigid(self.hulls.balls[:, :3], hulls.balls[:, :3])
        carried = self.hulls.balls[:, :3] @ turn.T + shift
        if np.linalg.norm(carried - hulls.balls[:, :3], axis=1).max() > FARTHEST:
            return None
        skin = self.kept[edge]
        moved = _carried(self.hulls, hulls, skin.vertices, turn, shift)
        found = settled(hulls, Skin(moved, skin.triangles, skin.sizes), edge)
        return found if _is_good(found, skin) else None


def _is_good(found: Skin, before: Skin) -> bool:
    ends = np.roll(found.triangles, -1, axis=1)
    lengths = np.linalg.norm(found.vertices[found.triangles] - found.vertices[ends], axis=2)
    wanted = before.sizes[found.triangles].max(axis=1, keepdims=True)
    return bool(found.angles.min() >= LEAST_ANGLE and (lengths / wanted).max() <= STRETCHED)


def _carried(
    before: Hulls,
    now: Hulls,
    vertices: Float64[np.ndarray, "vertices 3"],
    turn: Float64[np.ndarray, "3 3"],
    shift: Float64[np.ndarray, "3"],
) -> Float64[np.ndarray, "vertices 3"]:
    """Move points with the hulls that they lie on."""
    distance = before.each(vertices)
    weight = np.exp(-((distance - distance.min(axis=1, keepdims=True)) / SOFT))
    weight /= weight.sum(axis=1, keepdims=True)
    old, new = before.balls[:, :3] @ turn.T + shift, now.balls[:, :3]
    start = vertices @ turn.T + shift
    moved = np.zeros_like(vertices)
    for hull, part in enumerate(now.parts):
        members = part[part >= 0]
        own_turn, own_shift = _rigid(old[members], new[members])
        moved += weight[:, hull, None] * (start @ own_turn.T + own_shift)
    return moved


def _rigid(
    old: Float64[np.ndarray, "points 3"], new: Float64[np.ndarray, "points 3"]
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]:
    """Rigid motion that brings points nearest to others, without needless twist where they are two."""
    if len(old) > 2:
        return nearest_motion(old, new)
    turn = _shortest_turn(old[1] - old[0], new[1] - new[0])
    return turn, new.mean(axis=0) - turn @ old.mean(axis=0)


def _shortest_turn(start: Float64[np.ndarray, "3"], end: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    one, two = start / np.linalg.norm(start), end / np.linalg.norm(end)
    x, y, z = np.cross(one, two)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + across + across @ across / (1.0 + one @ two)
