"""The amplitude level and phase level of every element of a board, and caps on amplitudes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, UInt8

import airtact
from airtact.errors import InvalidInput, in_short, within
from airtact.transducers.levels import EIGHT_BITS, Levels


@dataclass(frozen=True, eq=False)
class Frame:
    """The amplitude level and the phase level of every element, as boards emit them.

    ``quantise`` returns the frame for a drive, and ``Link.send`` sends a frame to the boards.

    Attributes
    ----------
    amplitude : (E,) uint8 index of the amplitude of each element in ``levels.amplitudes``. With the
        default levels, the pressure is proportional to the index, and 255 is full scale.
    phase : (E,) uint8 index of the phase of each element. Index k is the phase 2π k/N of the
        phasor d in Re[d e^{−iωt}], with N = ``levels.phases``. With the default levels, 256 is a
        full turn, and +64 delays the wave by a quarter of a period.
    levels : ``Levels`` of the boards; by default 256 equally spaced amplitudes and 256 phases.

    Raises
    ------
    InvalidInput
        If an array is empty, not one-dimensional or not uint8, if the arrays differ in length, or
        if an index is not below the number of levels.
    """

    amplitude: UInt8[np.ndarray, "elements"]
    phase: UInt8[np.ndarray, "elements"]
    levels: Levels = EIGHT_BITS

    __repr__ = in_short

    def __post_init__(self) -> None:
        for name, count in (
            ("amplitude", len(self.levels.amplitudes)),
            ("phase", self.levels.phases),
        ):
            # A copy, so that the levels cannot change after the check.
            levels = np.array(getattr(self, name))
            if levels.dtype != np.uint8 or levels.ndim != 1 or len(levels) == 0:
                raise InvalidInput(
                    f"the {name} of a frame must be one uint8 per element, not {levels.dtype} of "
                    f"shape {levels.shape}.",
                    code="wrong_shape",
                )
            if levels.max() >= count:
                raise InvalidInput(
                    f"levels of {name} must be below {count}, but the largest is {levels.max()}.",
                    code="out_of_range",
                )
            levels.flags.writeable = False
            object.__setattr__(self, name, levels)
        if len(self.amplitude) != len(self.phase):
            raise InvalidInput(
                "a frame needs one amplitude and one phase per element, but has "
                f"{len(self.amplitude)} amplitudes and {len(self.phase)} phases.",
                code="sizes_differ",
            )

    def __len__(self) -> int:
        return len(self.amplitude)

    @property
    def silent(self) -> bool:
        """Whether no element emits."""
        return not self.amplitude.any()

    def same_as(self, frame: "Frame") -> bool:
        """Return whether both frames have the same levels."""
        return np.array_equal(self.amplitude, frame.amplitude) and np.array_equal(
            self.phase, frame.phase
        )

    def drive(self) -> "airtact.Drive":
        """Return the frame as a drive; for eight bits, amplitude/255 · exp(2πi phase/256)."""
        # Imported here because this module is also imported by the process that drives the boards,
        # which must start quickly.
        from airtact.drives.drive import Drive

        turns = self.phase / self.levels.phases
        return Drive(self.levels.amplitudes[self.amplitude] * np.exp(2j * np.pi * turns))


def frame_at(amplitudes: Complex[np.ndarray, "elements"], levels: Levels, share: float) -> Frame:
    """Multiply the amplitudes of a drive by ``share``, and round them to levels.

    On boards with amplitude levels, the amplitude of every element is reduced. On boards without
    amplitude levels, only the fraction ``share`` of the elements is switched on, spread evenly over
    the array. The pressure at a focus is then proportional to the number of active elements.
    """
    if not levels.phase_only:
        return Frame(*levels.rounded(share * amplitudes), levels)
    # The fractional parts of the multiples of the golden ratio are evenly spread over 0 to 1,
    # whatever their number.
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    order = (np.arange(len(amplitudes)) + 0.5) * golden % 1.0
    return Frame(*levels.rounded(np.where(order < share, amplitudes, 0.0)), levels)


def share_under_cap(
    drives: Complex[np.ndarray, "frames elements"], levels: Levels, cap: float
) -> float:
    """Return the factor, at most 1, that reduces the largest amplitude of the drives to ``cap``.

    The cap is a fraction of full scale. For boards without amplitude levels, the cap is the
    fraction of active elements. A cap that is not in the interval (0, 1] raises ``InvalidInput``.
    """
    cap = check_cap(cap)
    if levels.phase_only:
        return cap
    # The floor keeps the factor of a silent drive finite.
    return min(1.0, cap / max(float(np.abs(drives).max()), 1e-12))


def check_cap(cap: float) -> float:
    """Check that a cap on amplitudes is above 0 and at most 1, and return it."""
    return within(cap, 0.0, 1.0, "the cap", "of full scale", "30 per cent is 0.3.")
