"""The skin of a hand that moves: triangles that are made once and carried along by the bones."""

import numpy as np
from jaxtyping import Float64

from airtact.hands.body import Hulls, hand_hulls
from airtact.hands.joints import hand_length, radii_of
from airtact.hands.shape import hull_weights, moved_with_hulls
from airtact.hands.skin_mesh import HandMesh, even_skin

EDGE = 5e-3
"""Edge of the triangles [m], over half a wavelength at 40 kHz: a processor that draws them feels each."""

LARGEST_CHANGE = 0.1
"""A hand whose length changed by this share is another one, and gets triangles of its own."""


class MovingSkin:
    """The skin of one hand, made from the first pose and carried along by its bones.

    Parameters
    ----------
    radii : (25,) of the skin round each joint [m], or None for those of a generic hand.

    Attributes
    ----------
    triangles : (T, 3) vertices of each triangle; none before the first pose.
    """

    def __init__(self, radii: Float64[np.ndarray, "25"] | None) -> None:
        self._given = radii
        self._first: tuple[Hulls, HandMesh, Float64[np.ndarray, "vertices hulls"]] | None = None
        self.triangles = np.zeros((0, 3), dtype=np.int64)

    def at(
        self, joints: Float64[np.ndarray, "25 3"]
    ) -> tuple[Float64[np.ndarray, "vertices 3"], Float64[np.ndarray, "vertices 3"]]:
        """Return vertices on the skin (V, 3) [m] and the unit normals there (V, 3)."""
        if self._first is None or abs(hand_length(joints) / self._length - 1.0) > LARGEST_CHANGE:
            self._radii, self._length = radii_of(self._given, None, joints), hand_length(joints)
            hulls, _ = hand_hulls(joints, self._radii)
            mesh = even_skin(hulls, EDGE)
            self._first = hulls, mesh, hull_weights(hulls, mesh.vertices)
            self.triangles = mesh.triangles
        now, _ = hand_hulls(joints, self._radii)
        before, mesh, weight = self._first
        vertices = now.project(moved_with_hulls(before, now, mesh.vertices, weight))
        normals = now.look(vertices).gradient
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        return vertices, normals
