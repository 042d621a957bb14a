"""A pressure at the worst focus that no drive exceeds, with a certificate that anyone can check."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.target import Target
from airtact.checks import counted, positive
from airtact.drives.reach import asked_rows
from airtact.drives.relaxation import Relaxed, iterated, starting_point
from airtact.drives.transfer import Drive, TransferMatrix
from airtact.printing import one_line

MOST_ITERATIONS = 1000
BETWEEN_CHECKS = 10


@dataclass(frozen=True, eq=False)
class UpperBound:
    """A bound on the worst focus under any drive of amplitudes at most 1, with its dual certificate.

    For multipliers μ_f ≥ 0 that add up to 1, and y_e > 0 with diag(y) − Σ_f μ_f h_fᴴ h_f positive
    semidefinite, h_f being the row of focus f over what it asks, every drive has min_f |h_f d|² ≤
    Σ_f μ_f |h_f d|² ≤ Σ_e y_e |d_e|² ≤ Σ_e y_e.

    Attributes
    ----------
    worst : √Σ_e y_e: an upper bound of the smallest fraction of the pressures asked, or of the
        smallest pressure [Pa] where the foci ask for shares or for as much as possible.
    relaxed : what drives that share their time reach, so that no other multipliers bring ``worst``
        below it.
    multipliers : (F,) μ_f, 0 for foci that ask for nothing.
    elements : (E,) y_e.
    """

    worst: float
    relaxed: float
    multipliers: Float64[np.ndarray, "foci"]
    elements: Float64[np.ndarray, "elements"]

    def __repr__(self) -> str:
        return one_line(
            self,
            f"worst focus {self.worst:.4g}",
            counted(len(self.multipliers), "focus", "foci"),
            f"{len(self.elements)} elements",
        )

    def eigenvalue(self, transfer: TransferMatrix, target: Target) -> float:
        """Largest eigenvalue of √μ H diag(1/y) Hᴴ √μ (F, F): the bound is proved where it is at most 1.

        By Schur's complement that is equivalent to diag(y) − Hᴴ diag(μ) H being positive
        semidefinite.
        """
        matrix, _ = asked_rows(transfer, target)
        weights = self.multipliers[target.weights > 0.0] / target.weights[target.weights > 0.0] ** 2
        return _eigenvalue(matrix, weights, self.elements)

    def reached(self, transfer: TransferMatrix, target: Target, drive: Drive) -> float:
        """Return the smallest fraction or pressure under a drive over the bound: 1 is the best possible."""
        matrix, wanted = asked_rows(transfer, target)
        return float((np.abs(matrix @ drive.amplitudes) / wanted).min() / self.worst)


def upper_bound(transfer: TransferMatrix, target: Target, *, tolerance: float = 1e-3) -> UpperBound:
    """Bound the pressure that any drive with amplitudes at most 1 can give its worst focus.

    This is the dual of the semidefinite relaxation of Inoue, Makino and Shinoda (IEEE World Haptics
    2015). Drives of phases only, or of a number of levels, also have amplitudes of at most 1, so
    the bound holds for them too. It ignores suppression points.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the foci and the pressures asked there.
    tolerance : relative gap to the relaxation at which the iteration stops. It also stops after
        1000 iterations; the bound holds then too.

    Returns
    -------
    The bound and its certificate: a fraction of the pressures asked for, or a pressure [Pa] if none are.

    Raises
    ------
    InvalidInput
        As ``gerchberg_saxton``, or the tolerance is not above zero.
    """
    matrix, wanted = asked_rows(transfer, target)
    positive(tolerance, "the tolerance", "of the bound")
    bound, _ = relaxed_bound(matrix / wanted[:, None], tolerance)
    multipliers = np.zeros(len(target.points))
    multipliers[target.weights > 0.0] = bound.multipliers
    return replace(bound, multipliers=multipliers)


def relaxed_bound(
    matrix: Complex128[np.ndarray, "foci elements"], tolerance: float
) -> tuple[UpperBound, Relaxed]:
    """Return the bound and the end of the relaxation, for rows over what each focus asks."""
    relaxed, bound, reached = starting_point(matrix), None, 0.0
    for _ in range(0, MOST_ITERATIONS, BETWEEN_CHECKS):
        before = iterated(matrix, relaxed, BETWEEN_CHECKS - 1)
        relaxed = iterated(matrix, before, 1)
        reached = max(reached, float(relaxed.pressures.min()))
        found = _certified(matrix, before.weights, relaxed.norms)
        if bound is None or found.worst < bound.worst:
            bound = found
        if bound.worst <= (1.0 + tolerance) * reached:
            break
    assert bound is not None
    return replace(bound, relaxed=reached), relaxed


def _certified(
    matrix: Complex128[np.ndarray, "foci elements"],
    weights: Float64[np.ndarray, "foci"],
    norms: Float64[np.ndarray, "elements"],
) -> UpperBound:
    """Make a feasible point of the dual from any weights and norms: scale y until the eigenvalue is 1."""
    multipliers = weights / weights.sum()
    # An element that reaches no focus needs no y, but a little keeps 1/y finite.
    elements = np.maximum(norms, 1e-12 * norms.max())
    elements = elements * (_eigenvalue(matrix, multipliers, elements) * (1.0 + 1e-12))
    return UpperBound(float(np.sqrt(elements.sum())), 0.0, multipliers, elements)


def _eigenvalue(
    matrix: Complex128[np.ndarray, "foci elements"],
    multipliers: Float64[np.ndarray, "foci"],
    elements: Float64[np.ndarray, "elements"],
) -> float:
    half = np.sqrt(multipliers)[:, None] * matrix / np.sqrt(elements)
    return float(np.linalg.eigvalsh(half @ half.conj().T)[-1])
