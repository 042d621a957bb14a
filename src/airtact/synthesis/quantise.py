"""What a board can play: 256 levels of amplitude and 256 of phase, in our own phasor."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from airtact.conventions import InvalidInput
from airtact.scene.guards import counted
from airtact.scene.printing import in_short
from airtact.transfer import Drive, check_drive

LEVELS = 256


@dataclass(frozen=True, eq=False)
class Frame:
    """What every element plays, in bytes.

    Attributes
    ----------
    amplitude : (E,) uint8; 255 is full scale, and pressure is linear in it.
    phase : (E,) uint8; 256 levels of a turn in the phasor Re[d e^{−iωt}]: +64 delays the wave by a quarter period.

    Raises
    ------
    InvalidInput
        If an array is not a row of uint8, there is no element, or the two differ in length.
    """

    amplitude: UInt8[np.ndarray, "elements"]
    phase: UInt8[np.ndarray, "elements"]

    __repr__ = in_short

    def __post_init__(self) -> None:
        for name, given in (("amplitude", self.amplitude), ("phase", self.phase)):
            levels = np.asarray(given)
            if levels.dtype != np.uint8 or levels.ndim != 1 or len(levels) == 0:
                raise InvalidInput(
                    f"the {name} of a frame is one uint8 per element, not {levels.dtype} of shape {levels.shape}."
                )
            fixed = levels.copy()
            fixed.flags.writeable = False
            object.__setattr__(self, name, fixed)
        if len(self.amplitude) != len(self.phase):
            raise InvalidInput(
                f"a frame of {counted(len(self.amplitude), 'amplitude', 'amplitudes')} has "
                f"{counted(len(self.phase), 'phase', 'phases')}; give one of each per element."
            )

    def drive(self) -> Drive:
        """Return the drive that the bytes stand for: amplitude/255 · exp(2πi phase/256)."""
        return Drive(self.amplitude / 255.0 * np.exp(2j * np.pi * (self.phase / LEVELS)))


def quantise(drive: Drive) -> Frame:
    """Round every element to 256 amplitudes and 256 phases, as the paper's array has them (its section 3.4).

    Amplitude byte round(255 |d|), phase byte round(256 arg(d) / 2π) modulo 256. An element whose amplitude byte is 0 is
    silent and gets phase byte 0, so ``quantise(frame.drive())`` is the frame again for every frame made here.

    Parameters
    ----------
    drive : what every element emits.

    Examples
    --------
    >>> frame = quantise(Drive(np.array([1.0, 0.5j, -1.0, 0.0])))
    >>> frame.amplitude.tolist(), frame.phase.tolist()
    ([255, 128, 255, 0], [0, 64, 128, 0])
    """
    check_drive(drive, "what is quantised")
    amplitude = np.rint(np.abs(drive.amplitudes) * 255.0).astype(np.uint8)
    turns = np.rint(np.angle(drive.amplitudes) * (LEVELS / (2.0 * np.pi))).astype(np.int64)
    return Frame(amplitude, np.where(amplitude > 0, turns & 255, 0).astype(np.uint8))
