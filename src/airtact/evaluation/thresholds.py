"""Tactile thresholds, and the sound pressure level at a head, in decibel."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Num

from airtact.conventions import InvalidInput

REFERENCE_RMS = 20e-6
"""Pressure of 0 dB SPL, rms [Pa]."""

NO_SAFETY_ASSESSMENT = (
    "This is no safety assessment: the head itself is not in the scene, the sensitivity of the elements is not "
    "calibrated, and what ultrasound in air does to people is little known (ICNIRP 2024, 10.1097/HP.0000000000001800, "
    "calls the evidence limited; 110 dB at 40 kHz is the usual occupational limit)."
)
"""The note beside every level at a head."""


@dataclass(frozen=True)
class Threshold:
    """The smallest force on the skin [N], or pressure in the focus [Pa], that people felt in an experiment.

    The sound was modulated in amplitude (at 200 Hz) or spatiotemporally (a focus that moves). The source is a
    publication, with its reservations.
    """

    modulation: Literal["amplitude", "spatiotemporal"]
    quantity: Literal["force", "pressure"]
    value: float
    source: str

    def level(self, value: float) -> float:
        """Return the level of a force [N] or peak pressure [Pa] above the threshold [dB]; -inf for none.

        Force goes with the square of the pressure, so that both kinds of threshold are on one scale.

        Examples
        --------
        >>> THRESHOLDS[0].level(4e-3), THRESHOLDS[1].level(5570.0)
        (10.0, 20.0)
        """
        if not value > 0.0:
            return -np.inf
        return round((10.0 if self.quantity == "force" else 20.0) * float(np.log10(value / self.value)), 9)


HOWARD = "T. Howard et al. 2019 on an Ultraleap STRATOS, quoted at second hand: peak or rms is not stated"

DALECKI = (
    "D. Dalecki et al., J. Acoust. Soc. Am. 97, 3165 (1995): about 0.4 mN on a finger with a reflecting disc of "
    "1.8 cm², 2.2 MHz switched on and off at 200 Hz"
)

THRESHOLDS = (
    Threshold("amplitude", "force", 0.4e-3, DALECKI),
    Threshold("amplitude", "pressure", 557.0, HOWARD),
    Threshold("spatiotemporal", "pressure", 334.0, HOWARD),
)
"""The thresholds known here; people and places of the skin differ by several decibel."""


def thresholds_of(modulation: str) -> tuple[Threshold, ...]:
    """Return the thresholds of a modulation; raise ``InvalidInput`` where none is known."""
    found = tuple(threshold for threshold in THRESHOLDS if threshold.modulation == modulation)
    if not found:
        known = sorted({threshold.modulation for threshold in THRESHOLDS})
        raise InvalidInput(
            f'"{modulation}" is not one of the {len(known)} modulations with a threshold: {", ".join(known)}.',
            code="unknown_name",
        )
    return found


def sound_pressure_level(pressure: Num[np.ndarray, "points"]) -> Float64[np.ndarray, "points"]:
    """Return the level of sound [dB SPL]: 20 log10 of the rms pressure over 20 µPa. It is no safety assessment.

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
        return 20.0 * np.log10(rms / REFERENCE_RMS)
