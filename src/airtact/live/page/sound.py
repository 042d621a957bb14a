"""The direct sound of a drive, without what the hand scatters: what a hand receives, and shown until it was solved."""

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.solvers.monopoles import monopole_pressure
from airtact.acoustics.sources import Monopoles
from airtact.live.parts import LiveScene

ALIKE = 0.99
"""Elements whose normals have a larger cosine are one face of the array."""


class DirectSound:
    """The direct sound of an array's drives.

    Each element is one point, with the strength that it radiates towards ``middle``: near there the
    pressure is that of the whole element. A test compares both.

    Parameters
    ----------
    scene : its medium, frequency and array.
    """

    def __init__(self, scene: LiveScene) -> None:
        self._sounding, self._array = scene.sounding, scene.sounding.array
        self._wavenumber = scene.medium.wavenumber(scene.frequency)
        self._faces = _faces(self._array.normals)

    def at(
        self,
        points: Float64[np.ndarray, "points 3"],
        amplitudes: Complex128[np.ndarray, "elements"],
        middle: Float64[np.ndarray, "3"],
    ) -> Complex128[np.ndarray, "points"]:
        """Return the pressure in open air at points (P, 3) [m]: (P,) [Pa]."""
        return self._of_faces(points, self._strengths(amplitudes, middle)[:, None])[:, 0]

    def sources(
        self, amplitudes: Complex128[np.ndarray, "elements"], middle: Float64[np.ndarray, "3"]
    ) -> Monopoles:
        """Return the elements and their images as points that radiate towards ``middle`` [m] as they do."""
        return Monopoles(self._array.positions, self._strengths(amplitudes, middle)[:, None])

    def on_skin(
        self,
        points: Float64[np.ndarray, "points 3"],
        normals: Float64[np.ndarray, "points 3"],
        amplitudes: Complex128[np.ndarray, "elements"],
        middle: Float64[np.ndarray, "3"],
    ) -> Float64[np.ndarray, "points"]:
        """Return the magnitude on a hard skin (P,) [Pa]: the direct sound, doubled where it meets the skin, else 0.

        It is the Kirchhoff approximation: no part of the hand casts a shadow on another, or sends
        sound to it. The sound of each face of the array comes from that face's middle.

        Source: A. D. Pierce, *Acoustics* (3rd edition), section 9.2: twice the incident pressure on
        the lit side.
        """
        strengths = self._strengths(amplitudes, middle)[:, None] * self._faces
        arrived = self._of_faces(points, strengths)
        weight = np.abs(strengths) + 1e-300
        middles = weight.T @ self._array.positions / weight.sum(axis=0)[:, None]
        lit = np.einsum("pfd,pd->pf", middles[None] - points[:, None], normals) > 0.0
        return 2.0 * np.abs((arrived * lit).sum(axis=1))

    def _strengths(
        self, amplitudes: Complex128[np.ndarray, "elements"], middle: Float64[np.ndarray, "3"]
    ) -> Complex128[np.ndarray, "sounding"]:
        array = self._array
        ways = middle - array.positions
        ways = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)
        ahead = np.einsum("ed,ed->e", ways, array.normals)
        along = np.einsum("ed,ed->e", ways, array.tangents)
        across = np.einsum("ed,ed->e", ways, np.cross(array.normals, array.tangents))
        pattern = array.element.far_pattern(
            np.stack([along, across, ahead], axis=1), self._wavenumber.real
        )
        if array.element.directional:
            pattern = pattern * (ahead > 0.0)
        return (
            array.element.sensitivity * array.gains * pattern * self._sounding.unfolded(amplitudes)
        )

    def _of_faces(
        self,
        points: Float64[np.ndarray, "points 3"],
        strengths: Complex128[np.ndarray, "elements faces"],
    ) -> Complex128[np.ndarray, "points faces"]:
        return monopole_pressure(
            points, self._array.positions, strengths, self._wavenumber, "float32"
        )


def _faces(normals: Float64[np.ndarray, "elements 3"]) -> Float64[np.ndarray, "elements faces"]:
    """Return which elements are on which face: those that look one way."""
    faces = []
    left = np.ones(len(normals), dtype=bool)
    while left.any():
        one = left & (normals @ normals[int(np.argmax(left))] > ALIKE)
        faces.append(one.astype(np.float64))
        left &= ~one
    return np.stack(faces, axis=1)
