"""Amplitudes of a drive under a cap and at a share of it, rounded to levels."""

import numpy as np
from jaxtyping import Complex

from airtact.checks import number
from airtact.drives.frame import Frame
from airtact.errors import InvalidInput
from airtact.transducers.levels import Levels

GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
"""Multiples of the golden ratio's fraction spread evenly over 0 to 1, however many are taken."""


def frame_at(amplitudes: Complex[np.ndarray, "elements"], levels: Levels, share: float) -> Frame:
    """Round the amplitudes of a drive to levels, at a share of them.

    Boards with levels of amplitude reduce every element. Boards without switch on that share of
    their elements, spread evenly over the order of the elements: the pressure at a focus is
    proportional to their number.
    """
    if not levels.phase_only:
        return Frame(*levels.rounded(share * amplitudes), levels)
    order = (np.arange(len(amplitudes)) + 0.5) * GOLDEN % 1.0
    return Frame(*levels.rounded(np.where(order < share, amplitudes, 0.0)), levels)


def share_under_cap(
    drives: Complex[np.ndarray, "frames elements"], levels: Levels, cap: float
) -> float:
    """Return the factor that brings the largest amplitude of some drives under a cap, a share of full scale.

    Without levels of amplitude, the cap is the share of elements that are on. Raise as
    ``check_cap``.
    """
    cap = check_cap(cap)
    if levels.phase_only:
        return cap
    return min(1.0, cap / max(float(np.abs(drives).max()), 1e-12))


def check_cap(cap: float) -> float:
    """Return a cap on amplitudes; raise "out_of_range" unless it is a share of full scale, above 0 and at most 1."""
    cap = number(cap, "the cap", "shares of full scale")
    if not 0.0 < cap <= 1.0:
        percent = f": for {cap:g} per cent give {cap / 100.0:g}" if 1.0 < cap <= 100.0 else ""
        raise InvalidInput(
            f"the cap is {cap:g}, but it is a share of full scale, above 0 and at most 1{percent}.",
            code="out_of_range",
        )
    return cap
