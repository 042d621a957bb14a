"""The strongest worst focus (``max_min``), and the warning of a method that stalls."""

import warnings

import numpy as np

from airtact.acoustics.target import Target
from airtact.drives.bounds import relaxed_bound, to_rank_one
from airtact.drives.drive import Amplitudes, Drive
from airtact.drives.gerchberg_saxton import (
    Sources,
    best_sources,
    check_iterations,
    phase,
    starting_sources,
)
from airtact.drives.reach import FociRows, asked_rows, scaled_to_target
from airtact.drives.transfer import TransferMatrix
from airtact.errors import counted


class Stalled(UserWarning):
    """A method stopped before it converged and returned its best drive; the message has the gap.

    Attributes
    ----------
    reached : smallest pressure of the foci, over what they ask, as a part of the certified bound.
    """

    def __init__(self, sentence: str, reached: float) -> None:
        super().__init__(sentence)
        self.reached = reached


def max_min(transfer: TransferMatrix, target: Target, *, iterations: int = 300) -> Drive:
    """Make the worst focus as strong as possible, with phases at the foci that the method chooses.

    The method first solves the semidefinite relaxation of ``upper_bound`` (Inoue, Makino and
    Shinoda, IEEE World Haptics 2015), in which every element may emit several signals in turn. It
    then drops the weakest of them, a few at a time with iterations in between, until one is left
    (our own scheme), and runs ``iterations`` steps of weighted Gerchberg-Saxton from there. It also
    starts from where ``weighted_gerchberg_saxton`` starts, and returns the best drive. The result
    is deterministic. With many dozens of foci close to each other the iterations may not converge;
    ``gradient`` continues from there. Phases and suppression points of the target have no effect.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the foci and the pressures asked there.
    iterations : number of weighted Gerchberg-Saxton steps at the end.

    Returns
    -------
    The drive. All elements have the same amplitude: full scale, or less if the worst focus asks for
    less.

    Raises
    ------
    InvalidInput
        As ``weighted_gerchberg_saxton``.

    Warns
    -----
    Stalled
        If the worst focus stays more than 3 % below what the same phases allow; the best drive is
        returned.
    """
    matrix, requests = asked_rows(transfer, target)
    check_iterations(iterations)
    rows = matrix / requests[:, None]
    sources = strongest_sources(rows, iterations)
    # With the phases c_f at the foci fixed the best drive is a convex problem, whose dual bounds
    # the rest: no drive has min_f Re(conj(c_f) h_f d) above Σ_e |Σ_f s_f conj(h_fe)| / Σ_f |s_f|
    # for sources s_f of those phases.
    sent = rows.conj().T @ sources
    lowest = smallest_pressure(rows, phase(sent))
    missing = 1.0 - lowest * np.abs(sources).sum() / np.abs(sent).sum()
    if missing > 0.03:
        after = counted(iterations, "iteration", "iterations")
        warn_stalled("max_min", rows, lowest, f"after {after}, {missing:.1%} below its limit")
    return scaled_to_target(transfer, target, phase(matrix.conj().T @ (sources / requests)))


def strongest_sources(matrix: FociRows, iterations: int) -> Sources:
    """Return the sources s of the drive phase(Hᴴ s); ``matrix`` has rows over what each asks."""
    alike = np.ones(len(matrix))
    # A smaller gap than 1e-2 of the relaxation changes nothing after the rank is reduced.
    reduced = to_rank_one(matrix, relaxed_bound(matrix, 1e-2)[1])
    # The relaxation need not be tight, so the plain starts compete with it.
    starts = np.concatenate([reduced[None], starting_sources(matrix, alike)])
    return best_sources(matrix, alike, starts, iterations)


def warn_stalled(method: str, matrix: FociRows, worst: float, where: str) -> None:
    """Warn that a method stalled; ``matrix`` and the pressure ``worst`` are over what is asked."""
    reached = worst / relaxed_bound(matrix, 1e-2)[0].worst
    warnings.warn(
        Stalled(
            f"{method} stalled {where}; its best drive gives the worst focus {reached:.1%} of the "
            f"certified bound, a gap of {1.0 - reached:.1%}: allow more iterations, or continue "
            "with gradient.",
            reached,
        ),
        stacklevel=3,  # the caller of the method
    )


def smallest_pressure(matrix: FociRows, amplitudes: Amplitudes) -> float:
    """Smallest |h_f d| over the rows."""
    return float(np.abs(matrix @ amplitudes).min())
