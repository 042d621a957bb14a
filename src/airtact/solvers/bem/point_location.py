"""Which points are inside the bodies, outside, near the surface, or on it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real

from airtact import _kernels
from airtact.scene.scene import Scene
from airtact.solvers.bem.layer_potentials import NearRule, double_layer_pressure, in_box, project_contacts
from airtact.solvers.bem.quadrature import OFF_SURFACE, Nodes, near_lists


@dataclass(frozen=True, eq=False)
class Located:
    """Points [m], those in contact with the surface projected onto their panel, and where they are.

    Near ones need near integrals; ``outside`` are those outside the bodies or in contact.
    """

    points: Float64[np.ndarray, "points 3"]
    near: Bool[np.ndarray, "points"]
    contact: Bool[np.ndarray, "points"]
    outside: Bool[np.ndarray, "points"]


def locate(scene: Scene, nodes: Nodes, points: Real[np.ndarray, "points 3"], near_rule: NearRule) -> Located:
    """Locate points (P, 3) [m] by the solid angle that the panels subtend.

    Near the panels that takes near integrals. Where a point is farther from the scene's own surfaces than the panels
    may deviate from them, their signed distance decides; everywhere if all surfaces are closed forms.
    """
    located, contact = np.array(points, dtype=np.float64), np.zeros(len(points), dtype=bool)
    first, panel = near_lists(nodes, located, near_rule.reach * nodes.radii)
    near = np.diff(first) > 0
    touch = np.zeros(len(located))
    if len(panel):
        touch[near] = np.maximum.reduceat(nodes.contact[panel], first[:-1][near])
    outside, doubtful = np.ones(len(located), dtype=bool), in_box(nodes, located)  # all others are outside
    if not near.any() and not doubtful.any():
        return Located(located, near, contact, outside)
    closed = all(obstacle.surface.primitive is not None for obstacle in scene.obstacles)
    known = np.flatnonzero(near | doubtful) if closed else np.flatnonzero(near)
    depth = scene.depth(located[known])
    outside[known] = depth < 0
    doubtful[known] = False
    outside[doubtful] = _unfilled(nodes, located[doubtful])
    some = known[np.abs(depth) < OFF_SURFACE * touch[known]]
    located[some], contact[some] = project_contacts(nodes, located[some])
    outside[contact] = True
    some = known[(np.abs(depth) < touch[known]) & ~contact[known]]
    ones = np.ones((len(nodes.points), 1), dtype=np.complex128)
    outside[some] = _less_than_half(double_layer_pressure(located[some], nodes, ones, 0j, near_rule, "float32"))
    return Located(located, near, contact, outside)


def _unfilled(nodes: Nodes, points: Float64[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
    """Whether points away from the surface are outside; there each panel counts as one node."""
    whole = nodes.weighted_normals.reshape(-1, 6, 3).sum(axis=1)
    filled = np.empty((len(points), 1), dtype=np.complex128)
    ones = np.ones((len(whole), 1), dtype=np.complex128)
    _kernels.apply_double_layer_float32(points, nodes.centres, whole, ones, 0j, 0.0, filled)
    return _less_than_half(filled)


def _less_than_half(filled: Complex128[np.ndarray, "points 1"]) -> Bool[np.ndarray, "points"]:
    return np.real(filled[:, 0]) > -0.5
