"""Amplitude modulation, which makes a constant focus of ultrasound perceptible."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.errors import InvalidInput, within

# Default frequency of amplitude modulation [Hz].
DEFAULT_FREQUENCY = 200.0


@dataclass(frozen=True)
class AmplitudeModulation:
    """A factor common to all elements, which makes the force at each focus vary as a cosine.

    The skin hardly feels a constant force. It is most sensitive to vibration at 200 to 300 Hz
    (S. J. Bolanowski et al., J. Acoust. Soc. Am. 84, 1680, 1988).

    Attributes
    ----------
    frequency : frequency of the force [Hz].
    depth : depth of the modulation, above 0 and at most 1. The force varies between 1 − depth and 1
        times its maximum.

    Raises
    ------
    InvalidInput
        If the frequency is not above 0 and at most 1000 Hz, or the depth is not above 0 and at most
        1.
    """

    frequency: float = DEFAULT_FREQUENCY
    depth: float = 1.0

    def __post_init__(self) -> None:
        hint = "the skin only feels vibration up to about 1000 Hz."
        frequency = within(
            self.frequency, 0.0, 1000.0, "the frequency of the modulation", "Hz", hint
        )
        hint = "for 5 per cent, use depth=0.05."
        depth = within(self.depth, 0.0, 1.0, "the depth of the modulation", "of the force", hint)
        object.__setattr__(self, "frequency", frequency)
        object.__setattr__(self, "depth", depth)

    def envelope(self, frames: int) -> Float64[np.ndarray, "frames"]:
        """Return the amplitude factors (N,) for N frames in one period, beginning with 1.

        The radiation force is proportional to the square of the pressure, so the factor for frame n
        is √(1 − depth (1 − cos 2πn/N)/2).

        Examples
        --------
        >>> (AmplitudeModulation(depth=1.0).envelope(4) ** 2).round(12).tolist()
        [1.0, 0.5, 0.0, 0.5]
        """
        # Rounding errors must not make the argument of the root negative.
        angle = 2.0 * np.pi * np.arange(frames) / frames
        return np.sqrt(np.maximum(1.0 - self.depth * (1.0 - np.cos(angle)) / 2.0, 0.0))


def check_rate(rate: float, clock: float, slowest: int, board: str) -> None:
    """Check that a rate is the rate of a clock [Hz] divided by an integer up to ``slowest``."""
    # A frame lasts a whole number of ticks of the board's clock.
    divide = min(max(round(clock / rate), 1), slowest)
    if abs(clock / divide - rate) > 1e-6 * rate:
        raise InvalidInput(
            f"{rate:g} frames/s is not {clock:g} Hz divided by a whole number up to {slowest}: the "
            f"nearest rate that {board} can play is {clock / divide:.7g} frames/s.",
            code="out_of_range",
        )
