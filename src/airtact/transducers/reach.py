"""How much pressure an array can bring to a point at most, in open air and before anything is solved."""

import numpy as np
from jaxtyping import Float64, Real

from airtact import _kernels
from airtact.transducers.layout import PhasedArray

NEAREST = 30e-3
"""Distance from the elements within which no point is tried for the strongest one [m]."""

FORWARDS = (0.0, 0.05, 0.1, 0.2)
"""Distances before the faces at which points are tried [m]."""

TRIED = 15
"""About so many elements have points tried before them."""


def open_air_bound(
    array: PhasedArray, points: Real[np.ndarray, "points 3"], wavenumber: float
) -> Float64[np.ndarray, "points"]:
    """Return the peak pressure of all elements at full scale and in phase at one point, in open air.

    Σ_e |g_e| sensitivity |Σ_j w_j e^{ikr}/r| over the elements e in front of which the point is: no
    drive brings more to it without bodies.

    Parameters
    ----------
    array : the transducers.
    points : (P, 3) points, in the frame of the array [m].
    wavenumber : k [rad/m].

    Returns
    -------
    (P,) pressures [Pa].
    """
    element, found = array.element, np.empty(len(points))
    faces, strengths = array.face_points, element.sensitivity * np.abs(array.gains)
    targets = np.ascontiguousarray(faces.reshape(-1, 3))
    unit, received = (
        np.ones((1, 1), dtype=np.complex128),
        np.empty((len(targets), 1), dtype=np.complex128),
    )
    for index, point in enumerate(np.asarray(points, dtype=np.float64)):
        _kernels.apply_monopoles(
            targets, point[None], unit, complex(wavenumber), "float64", received
        )
        waves = np.abs(received.reshape(len(array), -1) @ element.weights)
        before = np.einsum("ed,ed->e", point - array.positions, array.normals) > 0.0
        found[index] = strengths @ np.where(before | (not element.directional), waves, 0.0)
    return found


def strongest_open_air(array: PhasedArray, wavenumber: float) -> float:
    """Return the largest ``open_air_bound`` of points before the faces and amid them, off the elements [Pa]."""
    some = slice(None, None, max(1, len(array) // TRIED))
    middle = array.positions.mean(axis=0)
    tried = [middle + distance * array.normals.mean(axis=0) for distance in FORWARDS]
    tried += [array.positions[some] + distance * array.normals[some] for distance in FORWARDS[1:]]
    points = np.vstack(tried)
    far = np.array(
        [np.linalg.norm(array.positions - point, axis=1).min() > NEAREST for point in points]
    )
    return float(open_air_bound(array, points[far], wavenumber).max())
