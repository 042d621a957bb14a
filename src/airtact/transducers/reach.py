"""The largest pressure of an array at a point in open air, before anything is solved."""

import numpy as np
from jaxtyping import Float64, Real

from airtact import _kernels
from airtact.transducers.layout import PhasedArray


def open_air_bound(
    array: PhasedArray, points: Real[np.ndarray, "points 3"], wavenumber: float
) -> Float64[np.ndarray, "points"]:
    """Return the peak pressure at points with all elements at full scale and in phase.

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
    element = array.element
    strengths = element.sensitivity * np.abs(array.gains)
    targets = array.face_points.reshape(-1, 3)
    unit = np.ones((1, 1), dtype=np.complex128)
    bounds = np.empty(len(points))
    for index, point in enumerate(np.asarray(points, dtype=np.float64)):
        received = _kernels.apply_monopoles(
            targets, point[None], unit, complex(wavenumber), "float64"
        )
        # All elements arrive in phase, so the magnitudes add up.
        waves = np.abs(received.reshape(len(array), -1) @ element.weights)
        if element.directional:
            before = np.einsum("ed,ed->e", point - array.positions, array.normals) > 0.0
            waves = np.where(before, waves, 0.0)
        bounds[index] = strengths @ waves
    return bounds


def strongest_open_air(array: PhasedArray, wavenumber: float) -> float:
    """Return the largest ``open_air_bound`` of points before the faces and among them [Pa]."""
    # Points before the middle of the array and before some 15 elements, 30 mm off any element.
    chosen = slice(None, None, max(1, len(array) // 15))
    middle = array.positions.mean(axis=0)
    axis = array.normals.mean(axis=0)
    points = [middle]
    for distance in (0.05, 0.1, 0.2):
        points.append(middle + distance * axis)
        points.extend(array.positions[chosen] + distance * array.normals[chosen])
    # Nearer points would show a single element, not the array.
    clear = [
        point for point in points if np.linalg.norm(array.positions - point, axis=1).min() > 30e-3
    ]
    return float(open_air_bound(array, np.array(clear), wavenumber).max())
