"""Tactile thresholds of modulated ultrasound, and the level of a drive relative to them."""

from typing import Literal

import numpy as np

Modulation = Literal["amplitude", "spatiotemporal"]

# Smallest perceptible peak pressure [Pa], for amplitude modulation at 200 Hz or a moving focus.
# From T. Howard et al. 2019.
THRESHOLDS: dict[str, float] = {"amplitude": 557.0, "spatiotemporal": 334.0}


def constant_force_note(fastest: float = np.inf) -> str:
    """Return a note that recommends amplitude modulation at 200 Hz, or at ``fastest`` if lower.

    Examples
    --------
    >>> constant_force_note(44.1).partition(": ")[2]
    'set kind = "am" and frequency = 44 in [drive.modulation] of the scene file, or play the ...
    """
    frequency = min(int(fastest), 200) if np.isfinite(fastest) else 200
    keys = 'kind = "am"' if frequency == 200 else f'kind = "am" and frequency = {frequency}'
    return (
        f"The skin hardly feels a constant force: set {keys} in [drive.modulation] of the "
        f"scene file, or play the drive with --modulate am:{frequency}."
    )


def sensation(
    pressure: float,
    modulation: Modulation | None,
    depth: float = 1.0,
    fastest: float = np.inf,
) -> str:
    """Describe the level of a focus relative to the detection threshold, and cite the threshold.

    Parameters
    ----------
    pressure : peak pressure at the weakest focus [Pa].
    modulation : kind of modulation; None for a constant drive.
    depth : modulation depth of the force.
    fastest : highest modulation frequency of the boards [Hz].

    Examples
    --------
    >>> sensation(5570.0, "amplitude").partition(" with ")[0]
    'The weakest focus is 20 dB above the threshold of detection'
    """
    if modulation is None:
        return constant_force_note(fastest)
    # The depth refers to the force, which is proportional to the square of the pressure.
    felt = max(pressure * np.sqrt(depth), np.finfo(float).tiny)
    # Nine digits hide the rounding of the logarithm.
    level = round(20.0 * float(np.log10(felt / THRESHOLDS[modulation])), 9)
    return (
        f"The weakest focus is {abs(level):.0f} dB {'above' if level >= 0 else 'below'} the "
        f"threshold of detection with {modulation} modulation, {THRESHOLDS[modulation]:g} Pa "
        "(T. Howard et al. 2019, measured with an Ultraleap STRATOS and cited from a secondary "
        "source that states neither peak nor rms; thresholds vary between people and places on "
        "the skin by several decibels)."
    )
