"""The smallest forces and pressures that people feel, and the level of a drive above them."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from airtact.errors import InvalidInput

Modulation = Literal["amplitude", "spatiotemporal"]


@dataclass(frozen=True)
class Threshold:
    """The smallest force on the skin [N] or pressure in the focus [Pa] felt in an experiment.

    The sound was modulated in amplitude (at 200 Hz) or spatiotemporally (a focus that moves). The
    source is a publication, with its reservations.
    """

    modulation: Modulation
    quantity: Literal["force", "pressure"]
    value: float
    source: str

    def level(self, value: float) -> float:
        """Level of a force [N] or peak pressure [Pa] above the threshold [dB]; -inf for none.

        Force goes with the square of the pressure, so both kinds of threshold share one scale.

        Examples
        --------
        >>> THRESHOLDS[0].level(4e-3), THRESHOLDS[1].level(5570.0)
        (10.0, 20.0)
        """
        if not value > 0.0:
            return -np.inf
        factor = 10.0 if self.quantity == "force" else 20.0
        # Nine digits hide the rounding of the logarithm.
        return round(factor * float(np.log10(value / self.value)), 9)


_HOWARD = (
    "T. Howard et al. 2019 on an Ultraleap STRATOS, quoted at second hand: peak or rms is not "
    "stated"
)

THRESHOLDS = (
    Threshold(
        "amplitude",
        "force",
        0.4e-3,
        "D. Dalecki et al., J. Acoust. Soc. Am. 97, 3165 (1995): about 0.4 mN on a finger with a "
        "reflecting disc of 1.8 cm², 2.2 MHz switched on and off at 200 Hz",
    ),
    Threshold("amplitude", "pressure", 557.0, _HOWARD),
    Threshold("spatiotemporal", "pressure", 334.0, _HOWARD),
)
"""The known thresholds; people and places of the skin differ by several decibel."""


def thresholds_of(modulation: str) -> tuple[Threshold, ...]:
    """Return the thresholds of a modulation; raise ``InvalidInput`` where none is known."""
    thresholds = tuple(each for each in THRESHOLDS if each.modulation == modulation)
    if not thresholds:
        raise InvalidInput(
            f'no threshold is known for "{modulation}" modulation; give amplitude or '
            "spatiotemporal.",
            code="unknown_name",
        )
    return thresholds


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
    threshold = next(each for each in thresholds_of(modulation) if each.quantity == "pressure")
    # The depth is that of the force, which goes with the square of the pressure.
    level = threshold.level(pressure * np.sqrt(depth))
    return (
        f"The weakest focus is {abs(level):.0f} dB {'above' if level >= 0 else 'below'} the "
        f"threshold of detection with {modulation} modulation, {threshold.value:g} Pa "
        f"({threshold.source}; people and places of the skin differ by several decibel)."
    )
