"""Tactile thresholds, and the sound pressure level at a head, in decibel."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Num

from airtact.errors import InvalidInput

REFERENCE_RMS = 20e-6
"""Pressure of 0 dB SPL, rms [Pa]."""

OCCUPATIONAL_LIMIT = 110.0
"""The usual limit at 40 kHz for people at work, in a third of an octave [dB SPL]: C. Q. Howard, C. H. Hansen,
A. C. Zander, J. Occup. Health Saf. Aust. N. Z. 21, 253 (2005), on which most organisations
agree."""

NO_SAFETY_ASSESSMENT = (
    "This is no safety assessment: the head itself is not in the scene, the sensitivity of the elements is not "
    "calibrated, and what ultrasound in air does to people is little known (ICNIRP 2024, 10.1097/HP.0000000000001800, "
    f"calls the evidence limited; {OCCUPATIONAL_LIMIT:g} dB at 40 kHz is the usual occupational limit: C. Q. Howard et "
    "al., J. Occup. Health Saf. Aust. N. Z. 21, 253, 2005)."
)
"""The note beside every level at a head."""


@dataclass(frozen=True)
class Threshold:
    """The smallest force on the skin [N], or pressure in the focus [Pa], that people felt in an experiment.

    The sound was modulated in amplitude (at 200 Hz) or spatiotemporally (a focus that moves). The
    source is a publication, with its reservations.
    """

    modulation: Literal["amplitude", "spatiotemporal"]
    quantity: Literal["force", "pressure"]
    value: float
    source: str

    def level(self, value: float) -> float:
        """Return the level of a force [N] or peak pressure [Pa] above the threshold [dB]; -inf for none.

        Force goes with the square of the pressure, so that both kinds of threshold are on one
        scale.

        Examples
        --------
        >>> THRESHOLDS[0].level(4e-3), THRESHOLDS[1].level(5570.0)
        (10.0, 20.0)
        """
        if not value > 0.0:
            return -np.inf
        return round(
            (10.0 if self.quantity == "force" else 20.0) * float(np.log10(value / self.value)), 9
        )


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


CONSTANT = (
    'Skin hardly feels a constant force: give [drive.modulation] with kind = "am" in the scene file, or play the drive '
    "with --modulate am:200."
)
"""The note beside a drive that is not modulated."""


def sensation(
    pressure: float, modulation: Literal["amplitude", "spatiotemporal"] | None, depth: float = 1.0
) -> str:
    """Write how far a focus is above the threshold of detection, and where that threshold comes from.

    Parameters
    ----------
    pressure : peak pressure at the weakest focus [Pa].
    modulation : None for a constant drive.
    depth : of the modulation of the force.

    Examples
    --------
    >>> sensation(5570.0, "amplitude").partition(" with ")[0]
    'The weakest focus is 20 dB above the threshold of detection'
    """
    if modulation is None:
        return CONSTANT
    threshold = next(one for one in thresholds_of(modulation) if one.quantity == "pressure")
    level = threshold.level(pressure * np.sqrt(depth))
    off = f"{abs(level):.0f} dB {'above' if level >= 0 else 'below'}"
    return (
        f"The weakest focus is {off} the threshold of detection with {modulation} modulation, {threshold.value:g} Pa "
        f"({threshold.source}; people and places of the skin differ by several decibel)."
    )


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
