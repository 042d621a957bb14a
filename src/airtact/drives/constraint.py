"""The drives that an array can emit: any amplitude to full scale, phases only, or a number of levels of each."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128

from airtact.errors import InvalidInput

MOST_BITS = 16


@dataclass(frozen=True)
class Constraint:
    """The drives that an array can emit.

    Attributes
    ----------
    phase_only : whether every element that emits is at full scale; else amplitudes go from 0 to 1.
    phase_bits : b for 2^b phases evenly spaced over 2π, or None for any phase.
    amplitude_bits : b for the 2^b amplitudes n/(2^b − 1), or None for any amplitude.

    Raises
    ------
    InvalidInput
        If a number of bits is not from 1 to 16.

    Examples
    --------
    >>> coarse = Constraint(phase_bits=1, amplitude_bits=2)
    >>> coarse.nearest(np.array([0.9 + 0.1j, -0.3j - 0.4])).real.round(3).tolist()
    [1.0, -0.667]
    """

    phase_only: bool = False
    phase_bits: int | None = None
    amplitude_bits: int | None = None

    def __post_init__(self) -> None:
        for what, bits in (("phase", self.phase_bits), ("amplitude", self.amplitude_bits)):
            if bits is not None and not 1 <= bits <= MOST_BITS:
                raise InvalidInput(
                    f"{bits} bits of {what} are not possible; give 1 to {MOST_BITS}, or None for any.",
                    code="out_of_range",
                )

    def nearest(
        self, amplitudes: Complex128[np.ndarray, "*batch elements"]
    ) -> Complex128[np.ndarray, "*batch elements"]:
        """Round amplitudes of at most 1 to those that the array can emit: magnitude and phase, each to its nearest."""
        if self == AT_MOST_ONE:
            return amplitudes
        magnitude, phase = np.abs(amplitudes), np.angle(amplitudes)
        if self.phase_only:
            magnitude = np.sign(magnitude)
        elif self.amplitude_bits is not None:
            steps = 2**self.amplitude_bits - 1
            magnitude = np.rint(magnitude * steps) / steps
        if self.phase_bits is not None:
            step = 2.0 * np.pi / 2**self.phase_bits
            phase = np.rint(phase / step) * step
        return magnitude * np.exp(1j * phase)


AT_MOST_ONE = Constraint()
"""Any amplitude to full scale and any phase."""
