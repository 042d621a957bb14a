"""The elements of an array as spherical waves about the bodies, and the echoes that follow from a scattering matrix.

By reciprocity an element receives with the waves that it emits with: with w_e the regular waves of
element e of unit strength, E[r, e] = w_rᵀ T w_e/(4πik). When the bodies move, all w_e are
multiplied by one matrix D, so that the array is expanded once, about where the bodies are believed
to be, and every pose nearby follows in closed form.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Int64

from airtact.errors import InvalidInput
from airtact.sensing.scattering import ScatteringMatrix
from airtact.sensing.waves import Waves, monopole_waves
from airtact.transducers.layout import PhasedArray

AT_ONCE = 1000
"""Points of faces that are expanded at once."""


@dataclass(frozen=True, eq=False)
class ArrayWaves:
    """Elements of an array as regular waves about the centre of a scattering matrix.

    Attributes
    ----------
    waves : (W, E) of each element at unit drive, times its gain, without the sensitivity.
    scale : sensitivity/(4πik) [Pa·m²], by which products of waves become pressures.
    """

    waves: Waves
    scale: complex

    def echo(
        self, scattering: ScatteringMatrix, codes: Complex128[np.ndarray, "elements transmissions"]
    ) -> Complex128[np.ndarray, "elements transmissions"]:
        """Scattered pressure at every element (E, M) [Pa] with the bodies where they were when this was made."""
        some = self.waves[: len(scattering.matrix)]
        return self.scale * (some.T @ (scattering.matrix @ (some @ codes)))


def array_waves(
    scattering: ScatteringMatrix, array: PhasedArray, order: int, *, single: bool = False
) -> ArrayWaves:
    """Expand the elements of an array, which is in the frame of the bodies; in ``single`` precision it is quicker.

    Raises
    ------
    InvalidInput
        "bodies_overlap": an element stands within the ball about the bodies.
    """
    faces, weights = (
        array.face_points - scattering.centre,
        array.gains[:, None] * array.element.weights,
    )
    nearest = np.linalg.norm(faces, axis=2).min(axis=1)
    element = int(nearest.argmin())
    if nearest[element] <= scattering.radius:
        raise InvalidInput(
            f"element {element} of {len(array)} stands {1e3 * nearest[element]:.3g} mm from the middle of the bodies, "
            f"within the ball of {1e3 * scattering.radius:.3g} mm around them, where spherical waves do not hold: move "
            "the bodies away from the array, or leave out parts of them that are far from the foci.",
            code="bodies_overlap",
        )
    wavenumber, count = scattering.scene.wavenumber, weights.shape[1]
    parts, at_once = [], max(AT_ONCE // count, 1)
    for first in range(0, len(array), at_once):
        some = slice(first, first + at_once)
        points, strengths = (
            faces[some].reshape(-1, 3),
            weights[some].reshape(-1).astype(np.complex128),
        )
        alone = monopole_waves(order, points, wavenumber, strengths, single)
        parts.append(alone if count == 1 else alone.reshape(len(alone), -1, count).sum(axis=2))
    waves = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
    scale = array.element.sensitivity / (4j * np.pi * scattering.scene.wavenumber)
    return ArrayWaves(waves, scale)


def direct_sound(
    array: PhasedArray, wavenumber: complex, codes: Complex128[np.ndarray, "elements transmissions"]
) -> Float64[np.ndarray, "elements transmissions"]:
    """Root of the summed squares of the pressures (E, M) [Pa] that arrive at each element from each of the others.

    In open air, each by its distance and the far patterns of both elements; one with a front
    neither emits nor receives behind its face, and to neighbours in the plane of its face as at 90
    degrees.
    """
    offsets = array.positions[:, None, :] - array.positions[None, :, :]
    distance = np.linalg.norm(offsets, axis=-1)
    np.fill_diagonal(distance, 1.0)
    power = np.exp(-2 * wavenumber.imag * distance) / distance**2
    np.fill_diagonal(power, 0.0)
    if array.element.directional:
        angles = np.radians(np.arange(91.0))
        along = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
        pattern = np.abs(array.element.far_pattern(along, wavenumber.real)) ** 2
        for cosine in (
            np.einsum("red,ed->re", offsets, array.normals) / distance,
            np.einsum("red,rd->re", -offsets, array.normals) / distance,
        ):
            power *= np.where(
                cosine < -1e-9, 0.0, np.interp(cosine, np.cos(angles[::-1]), pattern[::-1])
            )
    gains = np.abs(array.gains) ** 2
    power *= array.element.sensitivity**2 * gains[:, None] * gains
    return np.sqrt(power @ np.abs(codes) ** 2)


def emitted_by_faces(
    array: PhasedArray, codes: Complex128[np.ndarray, "elements transmissions"]
) -> Complex128[np.ndarray, "points transmissions"]:
    """Strengths of the points on the faces of all elements in each transmission [Pa·m]."""
    driven = (array.element.sensitivity * array.gains)[:, None, None] * array.element.weights[
        :, None
    ]
    return (driven * codes[:, None, :]).reshape(-1, codes.shape[1])


def heard_by_faces(
    array: PhasedArray,
    receivers: Int64[np.ndarray, "receivers"],
    pressures: Complex128[np.ndarray, "points transmissions"],
) -> Complex128[np.ndarray, "receivers transmissions"]:
    """Return what elements get of the pressures at the points on their faces [Pa]: their mean times the gain."""
    weights = array.element.weights
    over_faces = pressures.reshape(len(receivers), len(weights), -1)
    return array.gains[receivers, None] * np.einsum("q,rqm->rm", weights, over_faces)
