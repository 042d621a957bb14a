"""Deform the mesh of a hand from one pose to another: the triangles stay, their corners move with the bones."""

import numpy as np
from jaxtyping import Float64

from airtact.hand.skin_mesh import HandMesh, settled
from airtact.hand.sphere_mesh import Hulls
from airtact.pose import nearest_motion

BLEND = 3e-3
"""Corners move with the hulls nearest to them, weighted over about this distance [m]."""

LEAST_ANGLE = 20.0
"""A deformed mesh with a smaller angle is rejected [degrees]."""

LONGEST = 2.0
"""So is one with an edge longer than this, over the edge wanted there."""


def motion(before: Hulls, now: Hulls) -> float:
    """Find how far the farthest ball has moved [m], the rigid motion of the whole hand taken out."""
    turn, shift = nearest_motion(before.balls[:, :3], now.balls[:, :3])
    return float(np.linalg.norm(before.balls[:, :3] @ turn.T + shift - now.balls[:, :3], axis=1).max())


def deformed(before: Hulls, mesh: HandMesh, now: Hulls, edge: float) -> HandMesh | None:
    """Deform the mesh of a body, made with an edge [m], to another pose in which the same hulls are joined.

    The triangles stay the same; None where one gets too thin or too long.
    """
    moved = HandMesh(_moved_with_hulls(before, now, mesh.vertices), mesh.triangles, mesh.sizes)
    found = settled(now, moved, edge)
    ends = np.roll(found.triangles, -1, axis=1)
    lengths = np.linalg.norm(found.vertices[found.triangles] - found.vertices[ends], axis=2)
    wanted = mesh.sizes[found.triangles].max(axis=1, keepdims=True)
    good = found.angles.min() >= LEAST_ANGLE and (lengths / wanted).max() <= LONGEST
    return found if good else None


def _moved_with_hulls(
    before: Hulls, now: Hulls, vertices: Float64[np.ndarray, "vertices 3"]
) -> Float64[np.ndarray, "vertices 3"]:
    turn, shift = nearest_motion(before.balls[:, :3], now.balls[:, :3])
    distance = before.each(vertices)
    weight = np.exp(-((distance - distance.min(axis=1, keepdims=True)) / BLEND))
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
