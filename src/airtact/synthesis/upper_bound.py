"""What no drive can pass, with a certificate that anyone can check."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.printing import in_short
from airtact.scene.target import Target
from airtact.synthesis.reach import asked_rows
from airtact.synthesis.relaxation import Slots, first_slots, turned
from airtact.transfer import Drive, TransferMatrix
from airtact.validation import positive

MOST_TURNS = 1000
BETWEEN_CHECKS = 10


@dataclass(frozen=True, eq=False)
class UpperBound:
    """No drive of amplitudes at most 1 gives every focus more than its part of this.

    For multipliers μ_f ≥ 0 that add up to 1, and y_e > 0 with diag(y) − Σ_f μ_f h_fᴴ h_f positive semidefinite, h_f
    being the row of focus f over what it asks, every drive has min_f |h_f d|² ≤ Σ_f μ_f |h_f d|² ≤ Σ_e y_e |d_e|² ≤
    Σ_e y_e.

    Attributes
    ----------
    worst : √Σ_e y_e: the smallest share of what the foci ask, or the smallest pressure [Pa] where they ask for shares
        or for as much as possible, is never more.
    relaxed : what drives that share their time reach, so that no other multipliers bring ``worst`` below it.
    multipliers : (F,) μ_f, 0 for foci that ask for nothing.
    elements : (E,) y_e.
    """

    worst: float
    relaxed: float
    multipliers: Float64[np.ndarray, "foci"]
    elements: Float64[np.ndarray, "elements"]

    __repr__ = in_short

    def eigenvalue(self, transfer: TransferMatrix, target: Target) -> float:
        """Largest eigenvalue of √μ H diag(1/y) Hᴴ √μ, foci by foci: the bound holds where it is at most 1.

        By Schur's complement that says the same as diag(y) − Hᴴ diag(μ) H being positive semidefinite.
        """
        matrix, _ = asked_rows(transfer, target)
        weights = self.multipliers[target.weights > 0.0] / target.weights[target.weights > 0.0] ** 2
        return _eigenvalue(matrix, weights, self.elements)

    def reached(self, transfer: TransferMatrix, target: Target, drive: Drive) -> float:
        """Return the smallest share or pressure under a drive over the bound: 1 would be the best that there is."""
        matrix, wanted = asked_rows(transfer, target)
        return float((np.abs(matrix @ drive.amplitudes) / wanted).min() / self.worst)


def upper_bound(transfer: TransferMatrix, target: Target, *, tolerance: float = 1e-3) -> UpperBound:
    """Bound what any drive with amplitudes at most 1 can give its worst focus.

    The relaxation of Inoue, Makino and Shinoda (IEEE World Haptics 2015), in the form of a bound: its dual. What plays
    phases only, or levels, plays such amplitudes too, so the bound holds for it too. Suppression points are not heeded.

    Parameters
    ----------
    transfer : the transfer matrix.
    target : the foci and what they ask.
    tolerance : how far above what its relaxation reaches the bound may stay, relative.

    Raises
    ------
    InvalidInput
        If the target does not fit the matrix, ``check_solvable`` refuses its foci, or the tolerance is not above zero.
    """
    matrix, wanted = asked_rows(transfer, target)
    positive(tolerance, "the tolerance", "of the bound")
    bound, _ = relaxed_bound(matrix / wanted[:, None], tolerance)
    multipliers = np.zeros(len(target.points))
    multipliers[target.weights > 0.0] = bound.multipliers
    return UpperBound(bound.worst, bound.relaxed, multipliers, bound.elements)


def relaxed_bound(matrix: Complex128[np.ndarray, "foci elements"], tolerance: float) -> tuple[UpperBound, Slots]:
    """Return the bound and where the relaxation ended, for rows over what each focus asks."""
    slots, bound, relaxed = first_slots(matrix), None, 0.0
    for _ in range(0, MOST_TURNS, BETWEEN_CHECKS):
        weights_before = turned(matrix, slots, BETWEEN_CHECKS - 1)
        slots = turned(matrix, weights_before, 1)
        relaxed = max(relaxed, float(slots.shares.min()))
        found = _certified(matrix, weights_before.weights, slots.loudness)
        if bound is None or found.worst < bound.worst:
            bound = found
        if bound.worst <= (1.0 + tolerance) * relaxed:
            break
    assert bound is not None
    return UpperBound(bound.worst, relaxed, bound.multipliers, bound.elements), slots


def _certified(
    matrix: Complex128[np.ndarray, "foci elements"],
    weights: Float64[np.ndarray, "foci"],
    loudness: Float64[np.ndarray, "elements"],
) -> UpperBound:
    """Make a dual feasible point of any weights and loudness: scale y until the eigenvalue is 1."""
    multipliers = weights / weights.sum()
    # An element that no focus hears needs no y, but a little keeps 1/y finite.
    elements = np.maximum(loudness, 1e-12 * loudness.max())
    elements = elements * (_eigenvalue(matrix, multipliers, elements) * (1.0 + 1e-12))
    return UpperBound(float(np.sqrt(elements.sum())), 0.0, multipliers, elements)


def _eigenvalue(
    matrix: Complex128[np.ndarray, "foci elements"],
    multipliers: Float64[np.ndarray, "foci"],
    elements: Float64[np.ndarray, "elements"],
) -> float:
    half = np.sqrt(multipliers)[:, None] * matrix / np.sqrt(elements)
    return float(np.linalg.eigvalsh(half @ half.conj().T)[-1])
