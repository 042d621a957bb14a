"""On which side of the skin points stand, and which of them are near it or touch it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real

from airtact import _kernels
from airtact.scene.scene import Scene
from airtact.solvers.bem.layer_potentials import NearRule, double_layer_pressure, in_box, project_contacts
from airtact.solvers.bem.quadrature import OFF_SKIN, Nodes, near_lists


@dataclass(frozen=True, eq=False)
class Sides:
    """How points stand to the skin.

    Attributes
    ----------
    places : (P, 3) the points, those that touch the skin put on their panel [m].
    near : (P,) whether near integrals are needed there.
    contact : (P,) whether they touch the skin.
    outside : (P,) whether they are outside the bodies or touch them.
    """

    places: Float64[np.ndarray, "points 3"]
    near: Bool[np.ndarray, "points"]
    contact: Bool[np.ndarray, "points"]
    outside: Bool[np.ndarray, "points"]


def sides_of(scene: Scene, nodes: Nodes, points: Real[np.ndarray, "points 3"], near_rule: NearRule) -> Sides:
    """Tell the sides of points (P, 3) [m] by the solid angle that the panels fill as seen from there.

    Near the panels that takes near integrals, so where the scene's own skins are farther off than panels may be from
    them, these tell; everywhere if all of them are closed forms.
    """
    places, contact = np.array(points, dtype=np.float64), np.zeros(len(points), dtype=bool)
    first, panel = near_lists(nodes, places, near_rule.reach * nodes.radii)
    near = np.diff(first) > 0
    touch = np.zeros(len(places))
    if len(panel):
        touch[near] = np.maximum.reduceat(nodes.contact[panel], first[:-1][near])
    outside, doubtful = np.ones(len(places), dtype=bool), in_box(nodes, places)  # all others are outside
    if not near.any() and not doubtful.any():
        return Sides(places, near, contact, outside)
    closed = all(obstacle.surface.primitive is not None for obstacle in scene.obstacles)
    told = np.flatnonzero(near | doubtful) if closed else np.flatnonzero(near)
    depth = scene.depth(places[told])
    outside[told] = depth < 0
    doubtful[told] = False
    outside[doubtful] = _unfilled(nodes, places[doubtful])
    some = told[np.abs(depth) < OFF_SKIN * touch[told]]
    places[some], contact[some] = project_contacts(nodes, places[some])
    outside[contact] = True
    some = told[(np.abs(depth) < touch[told]) & ~contact[told]]
    ones = np.ones((len(nodes.points), 1), dtype=np.complex128)
    outside[some] = _less_than_half(double_layer_pressure(places[some], nodes, ones, 0j, near_rule, "float32"))
    return Sides(places, near, contact, outside)


def _unfilled(nodes: Nodes, points: Float64[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
    """Whether points away from the skin are outside: there a panel's own area will do for its nodes."""
    whole = nodes.weighted_normals.reshape(-1, 6, 3).sum(axis=1)
    filled = np.empty((len(points), 1), dtype=np.complex128)
    ones = np.ones((len(whole), 1), dtype=np.complex128)
    _kernels.apply_double_layer_float32(points, nodes.centres, whole, ones, 0j, 0.0, filled)
    return _less_than_half(filled)


def _less_than_half(filled: Complex128[np.ndarray, "points 1"]) -> Bool[np.ndarray, "points"]:
    return np.real(filled[:, 0]) > -0.5
