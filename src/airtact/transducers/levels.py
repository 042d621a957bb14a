"""Levels of amplitude and phase that a board emits, for the phasor Re[d e^{−iωt}]; modulation."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float64, Int64, Real, UInt8

from airtact.errors import InvalidInput, in_short, real_numbers, within

# Largest magnitude of a drive: full scale, with a tolerance for rounding.
FULL_SCALE = 1.0 + 1e-9


@dataclass(frozen=True, eq=False)
class Levels:
    """The amplitudes and phases that a board can emit, to which ``quantise`` rounds a drive.

    Attributes
    ----------
    amplitudes : (A,) amplitude of each level as a fraction of full scale, increasing from 0 to 1,
        with A from 2 to 256. A board with two levels only switches elements on and off.
    phases : number of phase levels, 2 to 256. Level k, from 0, is the phase 2π k/phases [rad] of
        the complex amplitude, so the levels are evenly spaced over a full turn.

    Raises
    ------
    InvalidInput
        If either number of levels is not between 2 and 256, or the amplitudes do not increase from
        0 to 1.

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
        if amplitudes.ndim != 1:
            raise InvalidInput(
                f"the amplitude levels have shape {amplitudes.shape}, but must be one-dimensional.",
                code="out_of_range",
            )
        _check_count(len(amplitudes), "amplitude")
        if amplitudes[0] != 0.0 or amplitudes[-1] != 1.0 or not np.all(np.diff(amplitudes) > 0.0):
            raise InvalidInput(
                "the amplitude levels must start at 0, increase at each step and end at 1, but "
                f"they start at {amplitudes[0]:g} and end at {amplitudes[-1]:g}.",
                code="out_of_range",
            )
        # ``vars`` bypasses the frozen dataclass.
        vars(self).update(amplitudes=amplitudes, phases=_check_count(self.phases, "phase"))

    @classmethod
    def even(cls, amplitudes: int = 256, phases: int = 256) -> "Levels":
        """Return levels with amplitudes in equal steps from 0 to full scale.

        Parameters
        ----------
        amplitudes, phases : number of levels of amplitude and of phase, 2 to 256
            each.

        Raises
        ------
        InvalidInput
            If a number is not between 2 and 256.

        Examples
        --------
        >>> Levels.even(amplitudes=5, phases=16)
        Levels(amplitudes=[0.0, 0.25, 0.5, 0.75, 1.0], phases=16)
        """
        count = _check_count(amplitudes, "amplitude")
        return cls(np.arange(count) / float(count - 1), phases)

    @property
    def phase_only(self) -> bool:
        """Whether elements can only be off or at full scale."""
        return len(self.amplitudes) == 2

    def same_as(self, levels: "Levels") -> bool:
        """Return whether ``levels`` has the same amplitudes and phases as this object."""
        return self.phases == levels.phases and np.array_equal(self.amplitudes, levels.amplitudes)

    def nearest(self, shares: Real[np.ndarray, "*elements"]) -> Int64[np.ndarray, "*elements"]:
        """Return the index of the level nearest to each fraction of full scale.

        With two levels, every element whose amplitude exceeds a thousandth of full scale is
        switched on.
        """
        if self.phase_only:
            return (shares > 1e-3).astype(np.int64)
        # A fraction halfway between two levels is rounded up.
        middles = (self.amplitudes[1:] + self.amplitudes[:-1]) / 2
        return np.searchsorted(middles, shares, side="right").astype(np.int64)

    def rounded(
        self, drives: Complex[np.ndarray, "*elements"]
    ) -> tuple[UInt8[np.ndarray, "*elements"], UInt8[np.ndarray, "*elements"]]:
        """Return the nearest amplitude and phase levels, with phase level 0 for silent elements."""
        amplitude = self.nearest(np.abs(drives))
        turns = np.rint(np.angle(drives) * (self.phases / (2.0 * np.pi))).astype(np.int64)
        # Silent elements all get the same phase, so that equal frames compare equal.
        phase = np.where(amplitude > 0, turns % self.phases, 0)
        return amplitude.astype(np.uint8), phase.astype(np.uint8)


def _check_count(levels: int, name: str) -> int:
    # Levels are stored as bytes. Booleans count as integers in Python, but are not valid here.
    integer = isinstance(levels, int | np.integer) and not isinstance(levels, bool)
    if not integer or not 2 <= levels <= 256:
        raise InvalidInput(
            f"the number of {name} levels must be between 2 and 256, not {levels}.",
            code="out_of_range",
        )
    return int(levels)


# 256 amplitudes and 256 phases, as in surrounding_box() and AUTD3.
EIGHT_BITS = Levels.even(256, 256)


# Default frequency of amplitude modulation [Hz].
DEFAULT_FREQUENCY = 200.0


@dataclass(frozen=True)
class AmplitudeModulation:
    """A factor common to all elements, which makes the force at each focus vary as a cosine.

    The skin hardly feels a constant force. It is most sensitive to vibration at 200 to 300 Hz
    (S. J. Bolanowski et al., J. Acoust. Soc. Am. 84, 1680, 1988). Pass the modulation to ``Setup``
    or ``Drive.save``.

    Attributes
    ----------
    frequency : frequency of the force [Hz], above 0 and at most 1000; 200 by default.
    depth : depth of the modulation, above 0 and at most 1; 1 by default. The radiation force, which
        is proportional to the square of the pressure, varies between 1 − depth and 1 times its
        maximum.

    Raises
    ------
    InvalidInput
        If the frequency is not above 0 or exceeds 1000 Hz, or the depth is not above 0 or exceeds
        1.
    """

    frequency: float = DEFAULT_FREQUENCY
    depth: float = 1.0

    def __post_init__(self) -> None:
        vars(self).update(
            frequency=within(
                self.frequency,
                0.0,
                1000.0,
                "the frequency of the modulation",
                "Hz",
                "the skin only feels vibration up to about 1000 Hz.",
            ),
            depth=within(
                self.depth,
                0.0,
                1.0,
                "the depth of the modulation",
                "of the force",
                "for 5 per cent, use depth=0.05.",
            ),
        )

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
