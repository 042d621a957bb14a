"""The warning of a method that stopped before it converged."""

import warnings

import numpy as np
from jaxtyping import Complex128

from airtact.synthesis.upper_bound import relaxed_bound
from airtact.validation import counted

STALLED_FROM = 0.03
"""A method stalled where more iterations would still bring more than this part of the pressure."""


class Stalled(UserWarning):
    """A method stopped before it converged and returned its best drive; the sentence has the gap to the bound.

    Attributes
    ----------
    reached : smallest pressure of the foci, over what they ask, as a part of the certified bound.
    """

    def __init__(self, sentence: str, reached: float) -> None:
        super().__init__(sentence)
        self.reached = reached


def warn_if_stalled(
    method: str,
    matrix: Complex128[np.ndarray, "foci elements"],
    sources: Complex128[np.ndarray, "foci"],
    iterations: int,
) -> None:
    """Warn with ``Stalled`` where more iterations with the same phases at the foci would bring over ``STALLED_FROM``.

    With the phases c_f fixed the best drive is a convex problem, whose dual bounds what is left: no drive has
    min_f Re(conj(c_f) h_f d) above Σ_e |Σ_f s_f conj(h_fe)| / Σ_f |s_f| for sources s_f of those phases. ``matrix`` has
    rows over what each focus asks; the elements emit the phases of Hᴴ s.
    """
    sent = matrix.conj().T @ sources
    magnitudes = np.abs(sent)
    worst = smallest_pressure(matrix, sent / np.maximum(magnitudes, np.finfo(float).tiny))
    left = 1.0 - worst * np.abs(sources).sum() / magnitudes.sum()
    if left > STALLED_FROM:
        after = counted(iterations, "iteration", "iterations")
        warn_stalled(method, matrix, worst, f"after {after}, {left:.1%} of the pressure short of where they lead")


def warn_stalled(method: str, matrix: Complex128[np.ndarray, "foci elements"], worst: float, where: str) -> None:
    """Warn that a method stalled ``where``, its best drive giving ``worst``; rows and pressures over what is asked."""
    reached = worst / relaxed_bound(matrix, 1e-2)[0].worst
    warnings.warn(
        Stalled(
            f"{method} stalled {where}; its best drive gives the worst focus {reached:.1%} of the certified bound, a "
            f"gap of {1.0 - reached:.1%}: allow more iterations, or continue with gradient.",
            reached,
        ),
        stacklevel=4,
    )


def smallest_pressure(
    matrix: Complex128[np.ndarray, "foci elements"], amplitudes: Complex128[np.ndarray, "elements"]
) -> float:
    """Smallest |h_f d| over the rows."""
    return float(np.abs(matrix @ amplitudes).min())
