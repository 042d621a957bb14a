"""Tactile thresholds of modulated ultrasound, and the level of a drive above them."""

from typing import Literal

import numpy as np

Modulation = Literal["amplitude", "spatiotemporal"]

THRESHOLDS: dict[str, float] = {"amplitude": 557.0, "spatiotemporal": 334.0}
"""Smallest peak pressure felt by modulation [Pa]: in amplitude at 200 Hz, or by a moving focus.

They are those of T. Howard et al. 2019."""

CONSTANT_FORCE_NOTE = (
    'Skin hardly feels a constant force: give [drive.modulation] with kind = "am" in the scene '
    "file, or play the drive with --modulate am:200."
)
"""The note beside a drive that is not modulated."""


def sensation(pressure: float, modulation: Modulation | None, depth: float = 1.0) -> str:
    """Describe how far a focus is above the threshold of detection, and that threshold's source.

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
        return CONSTANT_FORCE_NOTE
    # The depth is that of the force, which goes with the square of the pressure.
    felt = max(pressure * np.sqrt(depth), np.finfo(float).tiny)
    # Nine digits hide the rounding of the logarithm.
    level = round(20.0 * float(np.log10(felt / THRESHOLDS[modulation])), 9)
    return (
        f"The weakest focus is {abs(level):.0f} dB {'above' if level >= 0 else 'below'} the "
        f"threshold of detection with {modulation} modulation, {THRESHOLDS[modulation]:g} Pa "
        "(T. Howard et al. 2019 on an Ultraleap STRATOS, quoted at second hand: peak or rms is not "
        "stated; people and places of the skin differ by several decibel)."
    )
