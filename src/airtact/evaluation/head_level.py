"""The sound pressure level at a head, and the limit under which ``emit`` and ``live`` keep it."""

import numpy as np
from jaxtyping import Float64, Num

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
