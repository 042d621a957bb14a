"""What every element of a board emits, in levels."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

import airtact
from airtact.checks import counted
from airtact.errors import InvalidInput
from airtact.printing import in_short
from airtact.transducers.levels import EIGHT_BITS, Levels


@dataclass(frozen=True, eq=False)
class Frame:
    """What every element emits, in levels.

    Attributes
    ----------
    amplitude : (E,) uint8; with eight bits 255 is full scale, and pressure is linear in it.
    phase : (E,) uint8; levels of a turn in the phasor Re[d e^{−iωt}]: with eight bits +64 delays
        the wave by a quarter of a period.
    levels : what the numbers stand for; eight bits of each unless given.

    Raises
    ------
    InvalidInput
        If an array is not a row of uint8, there is no element, the two differ in length, or a level does not exist.
    """

    amplitude: UInt8[np.ndarray, "elements"]
    phase: UInt8[np.ndarray, "elements"]
    levels: Levels = EIGHT_BITS

    __repr__ = in_short

    def __post_init__(self) -> None:
        counts = {"amplitude": len(self.levels.amplitudes), "phase": self.levels.phases}
        for name, given in (("amplitude", self.amplitude), ("phase", self.phase)):
            levels = np.asarray(given)
            if levels.dtype != np.uint8 or levels.ndim != 1 or len(levels) == 0:
                raise InvalidInput(
                    f"the {name} of a frame is one uint8 per element, not {levels.dtype} of shape {levels.shape}.",
                    code="wrong_shape",
                )
            if levels.max() >= counts[name]:
                raise InvalidInput(
                    f"the {name} of a frame is below {counts[name]}, but one is {levels.max()}.",
                    code="out_of_range",
                )
            fixed = levels.copy()
            fixed.flags.writeable = False
            object.__setattr__(self, name, fixed)
        if len(self.amplitude) != len(self.phase):
            raise InvalidInput(
                f"a frame of {counted(len(self.amplitude), 'amplitude', 'amplitudes')} has "
                f"{counted(len(self.phase), 'phase', 'phases')}; give one of each per element.",
                code="sizes_differ",
            )

    def __len__(self) -> int:
        return len(self.amplitude)

    @property
    def silent(self) -> bool:
        """Whether no element emits."""
        return not self.amplitude.any()

    def same_as(self, other: "Frame") -> bool:
        """Whether both frames are the same in every level."""
        return np.array_equal(self.amplitude, other.amplitude) and np.array_equal(
            self.phase, other.phase
        )

    def drive(self) -> "airtact.drives.transfer.Drive":
        """Return the drive that the levels stand for: with eight bits amplitude/255 · exp(2πi phase/256)."""
        from airtact.drives.transfer import Drive

        turns = self.phase / self.levels.phases
        return Drive(self.levels.amplitudes[self.amplitude] * np.exp(2j * np.pi * turns))
