"""The sound pressure level at a head, and the limit under which ``emit`` and ``live`` keep it."""

import numpy as np
from jaxtyping import Complex, Float64, Num, Real

MAX_HEAD_LEVEL = 110.0
"""Occupational limit at 40 kHz, in a third of an octave [dB SPL].

Most organisations agree on it (C. Q. Howard, C. H. Hansen, A. C. Zander, J. Occup. Health Saf.
Aust. N. Z. 21, 253 (2005))."""

NO_SAFETY_ASSESSMENT = (
    "This is no safety assessment: the head itself is not in the scene, the sensitivity of the "
    "elements is not calibrated, and the effects of ultrasound in air on people are little known "
    "(ICNIRP 2024, 10.1097/HP.0000000000001800, calls the evidence limited; "
    f"{MAX_HEAD_LEVEL:g} dB at 40 kHz is the usual occupational limit: C. Q. Howard et al., J. "
    "Occup. Health Saf. Aust. N. Z. 21, 253, 2005)."
)
"""The note beside every level at a head."""


def sound_pressure_level(pressure: Num[np.ndarray, "points"]) -> Float64[np.ndarray, "points"]:
    """Return the level of sound [dB SPL]: 20 log10 of the rms pressure over 20 µPa.

    Parameters
    ----------
    pressure : (P,) peak pressures [Pa], complex or not.

    Returns
    -------
    (P,) levels [dB SPL], -inf in silence.

    Examples
    --------
    >>> sound_pressure_level(np.array([np.sqrt(2.0), np.sqrt(2.0) * 20e-6])).round(2).tolist()
    [93.98, 0.0]
    """
    rms = np.abs(pressure) / np.sqrt(2.0)
    with np.errstate(divide="ignore"):
        return 20.0 * np.log10(rms / 20e-6)  # over 20 µPa


def pressures_around(
    positions: Real[np.ndarray, "elements 3"],
    drives: Complex[np.ndarray, "frames elements"],
    sensitivity: float,
    wavenumber: float,
    distance: float = 0.5,
) -> tuple[float, float]:
    """Largest pressures [Pa] on a sphere around an array, ``distance`` [m] beyond it.

    Elements radiate equally in all directions in open air, with a peak pressure of ``sensitivity``
    [Pa·m]. Bodies scatter the sound elsewhere, and a real transducer radiates less backwards: the
    result is a warning, not a measurement.

    Returns
    -------
    The peak pressure in the strongest frame, and the root mean square over the frames, each where
    it is largest.
    """
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2.0
    radius = float(np.linalg.norm(positions - middle, axis=1).max()) + distance

    def pressures(
        directions: Real[np.ndarray, "directions 3"], parts: int
    ) -> Float64[np.ndarray, "two directions"]:
        # In parts, which bounds the memory for the distances.
        values = []
        for part in np.array_split(directions, parts):
            lengths = np.linalg.norm((middle + radius * part)[:, None] - positions[None], axis=-1)
            frames = np.abs((np.exp(1j * wavenumber * lengths) / lengths) @ drives.T)
            values.append([frames.max(axis=1), np.sqrt(np.mean(frames**2, axis=1))])
        return np.concatenate(values, axis=1)

    directions = _directions(2000)
    coarse = pressures(directions, 20)
    # A beam may be narrower than the step between two directions: refine around the 12 largest
    # pressures, with 100 directions each up to one step away.
    steps = (
        _directions(100)[None]
        * np.sqrt(4.0 * np.pi / len(directions))
        * np.linspace(0.2, 1.0, 100)[None, :, None]
    )
    around = (directions[np.argsort(coarse[0])[-12:], None] + steps).reshape(-1, 3)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    fine = pressures(around, 10)
    peak, average = np.maximum(coarse.max(axis=1), fine.max(axis=1))
    return sensitivity * float(peak), sensitivity * float(average)


def _directions(count: int) -> Float64[np.ndarray, "directions 3"]:
    """Evenly spread unit vectors: a spiral from pole to pole."""
    index = np.arange(count) + 0.5
    height = 1.0 - 2.0 * index / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * index
    width = np.sqrt(1.0 - height**2)
    return np.stack([width * np.cos(turn), width * np.sin(turn), height], axis=1)
