"""What a board can play: levels of amplitude and of phase, in our own phasor."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64, Real, UInt8

from airtact.conventions import InvalidInput
from airtact.printing import in_short
from airtact.transfer import Drive, TransferMatrix, check_drive
from airtact.validation import counted, of_kind, real_numbers

MOST_LEVELS = 256
"""Levels are kept in bytes."""

SPEAKS = 1e-3
"""A board without levels of amplitude plays every element over this share of full scale, and no other."""


@dataclass(frozen=True, eq=False)
class Levels:
    """The amplitudes and phases that a board can play.

    Attributes
    ----------
    amplitudes : (A,) share of full scale that each level of amplitude gives, rising from 0 to 1; A is 2 to 256. Two
        levels are a board that can only switch an element off.
    phases : how many levels a turn has, 2 to 256; they are k/phases of a turn.

    Raises
    ------
    InvalidInput
        If there are fewer than 2 or more than 256 of either, or the amplitudes do not rise from 0 to 1.

    Examples
    --------
    >>> Levels(np.array([0.0, 1.0]), phases=32)
    Levels(amplitudes=[0.0, 1.0], phases=32)
    """

    amplitudes: Float64[np.ndarray, "levels"]
    phases: int

    __repr__ = in_short

    def __post_init__(self) -> None:
        amplitudes = real_numbers(self.amplitudes, "levels of amplitude")
        if amplitudes.ndim != 1 or not 2 <= len(amplitudes) <= MOST_LEVELS:
            raise InvalidInput(f"levels of amplitude are 2 to {MOST_LEVELS} shares, not of shape {amplitudes.shape}.")
        if amplitudes[0] != 0.0 or amplitudes[-1] != 1.0 or not np.all(np.diff(amplitudes) > 0.0):
            raise InvalidInput(
                f"levels of amplitude must rise from 0 to 1, not from {amplitudes[0]:g} to {amplitudes[-1]:g}."
            )
        if not isinstance(self.phases, int | np.integer) or not 2 <= self.phases <= MOST_LEVELS:
            raise InvalidInput(f"a turn has 2 to {MOST_LEVELS} levels of phase, not {self.phases}.")
        object.__setattr__(self, "amplitudes", amplitudes)

    @property
    def phase_only(self) -> bool:
        """Whether the board can only switch an element off or play it at full scale."""
        return len(self.amplitudes) == 2

    def same_as(self, other: "Levels") -> bool:
        """Whether both are the same levels."""
        return self.phases == other.phases and np.array_equal(self.amplitudes, other.amplitudes)

    def nearest(self, shares: Real[np.ndarray, "elements"]) -> Int64[np.ndarray, "elements"]:
        """Find the nearest level to each share of full scale; all that speak are on where there are only two levels.

        Parameters
        ----------
        shares : (E,) 0 to 1.
        """
        if self.phase_only:
            return (shares > SPEAKS).astype(np.int64)
        return np.searchsorted((self.amplitudes[1:] + self.amplitudes[:-1]) / 2, shares, side="right").astype(np.int64)


EIGHT_BITS = Levels(np.arange(256) / 255.0, phases=256)
"""256 amplitudes and 256 phases, as the paper's array and AUTD3 have them."""


@dataclass(frozen=True, eq=False)
class Frame:
    """What every element plays, in levels.

    Attributes
    ----------
    amplitude : (E,) uint8; with the levels of eight bits 255 is full scale, and pressure is linear in it.
    phase : (E,) uint8; levels of a turn in the phasor Re[d e^{−iωt}]: with eight bits +64 delays the wave by a quarter
        of a period.
    levels : what the levels stand for; eight bits of each unless given.

    Raises
    ------
    InvalidInput
        If an array is not a row of uint8, there is no element, the two differ in length, or a level is not there.
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
                    f"the {name} of a frame is one uint8 per element, not {levels.dtype} of shape {levels.shape}."
                )
            if levels.max() >= counts[name]:
                raise InvalidInput(f"the {name} of a frame is below {counts[name]}, but one is {levels.max()}.")
            fixed = levels.copy()
            fixed.flags.writeable = False
            object.__setattr__(self, name, fixed)
        if len(self.amplitude) != len(self.phase):
            raise InvalidInput(
                f"a frame of {counted(len(self.amplitude), 'amplitude', 'amplitudes')} has "
                f"{counted(len(self.phase), 'phase', 'phases')}; give one of each per element."
            )

    def __len__(self) -> int:
        return len(self.amplitude)

    @property
    def silent(self) -> bool:
        """Whether no element speaks."""
        return not self.amplitude.any()

    def same_as(self, other: "Frame") -> bool:
        """Whether both frames are the same in every level."""
        return np.array_equal(self.amplitude, other.amplitude) and np.array_equal(self.phase, other.phase)

    def drive(self) -> Drive:
        """Return the drive that the levels stand for: with eight bits amplitude/255 · exp(2πi phase/256)."""
        turns = self.phase / self.levels.phases
        return Drive(self.levels.amplitudes[self.amplitude] * np.exp(2j * np.pi * turns))


def quantise(drive: Drive, levels: Levels = EIGHT_BITS) -> Frame:
    """Round every element to a level of amplitude and one of phase: 256 of each, as the paper has it (section 3.4).

    Amplitude byte round(255 |d|), phase byte round(256 arg(d) / 2π) modulo 256; other levels alike, by the nearest. An
    element whose amplitude level is 0 is silent and gets phase level 0, so ``quantise(frame.drive())`` is the frame
    again for every frame made here. Where there are only two amplitudes every element that speaks (over a thousandth of
    full scale) is at full scale, as in ``drive.phase_only()``.

    Parameters
    ----------
    drive : what every element emits.
    levels : what the board can play.

    Examples
    --------
    >>> frame = quantise(Drive(np.array([1.0, 0.5j, -1.0, 0.0])))
    >>> frame.amplitude.tolist(), frame.phase.tolist()
    ([255, 128, 255, 0], [0, 64, 128, 0])
    """
    check_drive(drive, "what is quantised")
    of_kind(levels, Levels, "the levels of a frame", "Levels(amplitudes, phases)")
    amplitude = levels.nearest(np.abs(drive.amplitudes))
    turns = np.rint(np.angle(drive.amplitudes) * (levels.phases / (2.0 * np.pi))).astype(np.int64)
    phase = np.where(amplitude > 0, turns % levels.phases, 0)
    return Frame(amplitude.astype(np.uint8), phase.astype(np.uint8), levels)


def rounding_error(transfer: TransferMatrix, drive: Drive, frame: Frame) -> Float64[np.ndarray, "foci"]:
    """Say what rounding costs at each focus: the relative change of its pressure.

    Boards that cannot play amplitudes are loud where the drive was quiet, so there both drives are compared at equal
    energy Σ|d|²; all others as they are.

    Parameters
    ----------
    transfer : pressure at the foci per unit drive.
    drive : what was asked.
    frame : what is played.

    Returns
    -------
    (F,) |p played| / |p asked| − 1; NaN where the drive gives no pressure.

    Raises
    ------
    InvalidInput
        If one is for another number of elements, or the frame is silent.
    """
    of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
    of_kind(frame, Frame, "what is played", "quantise(drive, levels)")
    if frame.silent:
        raise InvalidInput(f"all {len(frame)} elements of the frame are silent, so nothing can be compared.")
    played = frame.drive()
    asked, got = np.abs(transfer.pressure(drive)), np.abs(transfer.pressure(played))
    if frame.levels.phase_only:
        got = got * np.linalg.norm(drive.amplitudes) / np.linalg.norm(played.amplitudes)
    return np.where(asked > 0.0, got / np.where(asked > 0.0, asked, 1.0) - 1.0, np.nan)
