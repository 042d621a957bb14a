"""Saying that a method stopped before it was done."""

import warnings

import numpy as np
from jaxtyping import Complex128

from airtact.synthesis.upper_bound import relaxed_bound
from airtact.validation import counted

OPEN = 0.03
"""A larger part of the pressure that more turns would still bring means that a method stalled."""


class Stalled(UserWarning):
    """A method stopped before it was done and gave its best; the sentence has the gap to the certified bound.

    Attributes
    ----------
    reached : smallest pressure of the foci, over what they ask, as a part of the certified bound.
    """

    def __init__(self, sentence: str, reached: float) -> None:
        super().__init__(sentence)
        self.reached = reached


def tell_if_stalled(
    method: str,
    matrix: Complex128[np.ndarray, "foci elements"],
    sources: Complex128[np.ndarray, "foci"],
    turns: int,
) -> None:
    """Warn with ``Stalled`` where more turns with the same phases at the foci would bring over ``OPEN``.

    With the phases c_f fixed the best drive is a convex problem, whose dual says how much more there is: no drive has
    min_f Re(conj(c_f) h_f d) above Σ_e |Σ_f s_f conj(h_fe)| / Σ_f |s_f| for sources s_f of those phases.

    Parameters
    ----------
    method : its name.
    matrix : (F, E) rows over what each focus asks.
    sources : (F,) at which it stopped, playing the phases of Hᴴ s.
    turns : after how many.
    """
    sent = matrix.conj().T @ sources
    loudness = np.abs(sent)
    worst = worst_share(matrix, sent / np.maximum(loudness, np.finfo(float).tiny))
    left = 1.0 - worst * np.abs(sources).sum() / loudness.sum()
    if left > OPEN:
        after = counted(turns, "turn", "turns")
        warn_stalled(method, matrix, worst, f"after {after}, {left:.1%} of the pressure short of where they lead")


def warn_stalled(method: str, matrix: Complex128[np.ndarray, "foci elements"], worst: float, where: str) -> None:
    """Warn with ``Stalled``, computing the bound.

    Parameters
    ----------
    method : its name.
    matrix : (F, E) rows over what each focus asks.
    worst : smallest share that its best drive gives.
    where : where it stopped, to follow "stalled".
    """
    reached = worst / relaxed_bound(matrix, 1e-2)[0].worst
    warnings.warn(
        Stalled(
            f"{method} stalled {where}; its best drive gives the worst focus {reached:.1%} of the certified bound, a "
            f"gap of {1.0 - reached:.1%}: allow more turns, or let gradient climb on.",
            reached,
        ),
        stacklevel=4,
    )


def worst_share(
    matrix: Complex128[np.ndarray, "foci elements"], amplitudes: Complex128[np.ndarray, "elements"]
) -> float:
    """Smallest |h_f d| over the rows."""
    return float(np.abs(matrix @ amplitudes).min())
