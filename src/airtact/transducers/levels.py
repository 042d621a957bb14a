"""What a board can emit: levels of amplitude and of phase, in the phasor Re[d e^{−iωt}]."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float64, Int64, Real, UInt8

from airtact.checks import real_numbers
from airtact.errors import InvalidInput
from airtact.printing import in_short

FULL_SCALE = 1.0 + 1e-9
"""Largest magnitude of a drive: full scale, and what rounding adds to it."""

MOST_LEVELS = 256
"""Levels are stored in bytes."""

ON = 1e-3
"""A board with two levels of amplitude switches on every element above this share of full scale."""


@dataclass(frozen=True, eq=False)
class Levels:
    """The amplitudes and phases that a board can emit.

    Attributes
    ----------
    amplitudes : (A,) share of full scale that each level of amplitude gives, rising from 0 to 1; A
        is 2 to 256. Two levels are a board that can only switch an element on and off.
    phases : number of levels of phase, 2 to 256; level k is k/phases of a turn.

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
            raise InvalidInput(
                f"levels of amplitude are 2 to {MOST_LEVELS} shares, not of shape {amplitudes.shape}.",
                code="out_of_range",
            )
        if amplitudes[0] != 0.0 or amplitudes[-1] != 1.0 or not np.all(np.diff(amplitudes) > 0.0):
            raise InvalidInput(
                f"levels of amplitude must rise from 0 to 1, not from {amplitudes[0]:g} to {amplitudes[-1]:g}.",
                code="out_of_range",
            )
        object.__setattr__(self, "phases", _count(self.phases, "phase"))
        object.__setattr__(self, "amplitudes", amplitudes)

    @classmethod
    def even(cls, amplitudes: int = 256, phases: int = 256) -> "Levels":
        """Build levels of amplitude at equal steps from 0 to full scale.

        Parameters
        ----------
        amplitudes, phases : number of levels of each, 2 to 256.

        Raises
        ------
        InvalidInput
            If a number is not 2 to 256.

        Examples
        --------
        >>> Levels.even(amplitudes=5, phases=16)
        Levels(amplitudes=[0.0, 0.25, 0.5, 0.75, 1.0], phases=16)
        """
        count = _count(amplitudes, "amplitude")
        return cls(np.arange(count) / float(count - 1), phases)

    @property
    def phase_only(self) -> bool:
        """Whether the board can only switch an element off or emit at full scale."""
        return len(self.amplitudes) == 2

    def same_as(self, other: "Levels") -> bool:
        """Whether both are the same levels."""
        return self.phases == other.phases and np.array_equal(self.amplitudes, other.amplitudes)

    def nearest(self, shares: Real[np.ndarray, "*elements"]) -> Int64[np.ndarray, "*elements"]:
        """Find the nearest level to each share of full scale; with two levels, all above ``ON`` are on."""
        if self.phase_only:
            return (shares > ON).astype(np.int64)
        return np.searchsorted(
            (self.amplitudes[1:] + self.amplitudes[:-1]) / 2, shares, side="right"
        ).astype(np.int64)

    def rounded(
        self, drives: Complex[np.ndarray, "*elements"]
    ) -> tuple[UInt8[np.ndarray, "*elements"], UInt8[np.ndarray, "*elements"]]:
        """Round complex drives to a level of amplitude and one of phase; off elements get phase level 0."""
        amplitude = self.nearest(np.abs(drives))
        turns = np.rint(np.angle(drives) * (self.phases / (2.0 * np.pi))).astype(np.int64)
        phase = np.where(amplitude > 0, turns % self.phases, 0)
        return amplitude.astype(np.uint8), phase.astype(np.uint8)


def _count(levels: int, what: str) -> int:
    if (
        isinstance(levels, bool)
        or not isinstance(levels, int | np.integer)
        or not 2 <= levels <= MOST_LEVELS
    ):
        raise InvalidInput(
            f"there are 2 to {MOST_LEVELS} levels of {what}, not {levels}.", code="out_of_range"
        )
    return int(levels)


EIGHT_BITS = Levels.even(256, 256)
"""256 amplitudes and 256 phases, as the paper's array and AUTD3 have them."""
