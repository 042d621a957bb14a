"""The strongest worst focus: from the relaxation to one drive; and the warning of a method that stalls."""

import warnings

import numpy as np
from jaxtyping import Complex128

from airtact.acoustics.target import Target
from airtact.checks import counted
from airtact.drives.bounds import relaxed_bound
from airtact.drives.constraint import AT_MOST_ONE, Constraint
from airtact.drives.gerchberg_saxton import (
    best_sources,
    check_iterations,
    phase,
    quantised_projections,
    starting_sources,
)
from airtact.drives.reach import asked_rows, scaled_to_target
from airtact.drives.relaxation import to_rank_one
from airtact.drives.transfer import Drive, TransferMatrix

RELAXED_TO = 1e-2
"""Relative gap to which the relaxation is solved before its rank is reduced; a smaller gap changes nothing."""

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


def max_min(
    transfer: TransferMatrix,
    target: Target,
    *,
    iterations: int = 300,
    constraint: Constraint = AT_MOST_ONE,
) -> Drive:
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
    constraint : the amplitudes and phases that an element can emit.

    Returns
    -------
    The drive. All elements have the same amplitude: full scale, or less if the worst focus asks for less. It is rounded
    to the levels of the constraint.

    Raises
    ------
    InvalidInput
        As ``gerchberg_saxton``.

    Warns
    -----
    Stalled
        If the worst focus stays more than 3 % below what the same phases allow; the best drive is returned.
    """
    matrix, wanted = asked_rows(transfer, target)
    check_iterations(iterations)
    sources = strongest_sources(matrix / wanted[:, None], iterations)
    _warn_if_stalled(matrix / wanted[:, None], sources, iterations)
    if constraint.phase_bits is None:
        amplitudes = phase(matrix.conj().T @ (sources / wanted))
    else:
        amplitudes = quantised_projections(matrix, wanted, sources / wanted, iterations, constraint)
    return scaled_to_target(transfer, target, amplitudes, constraint)


def strongest_sources(
    matrix: Complex128[np.ndarray, "foci elements"], iterations: int
) -> Complex128[np.ndarray, "foci"]:
    """Return sources s (F,) such that the drive has the phases of Hᴴ s; ``matrix`` has rows over what each asks."""
    alike = np.ones(len(matrix))
    reduced = to_rank_one(matrix, relaxed_bound(matrix, RELAXED_TO)[1])
    starts = np.concatenate([reduced[None], starting_sources(matrix, alike)])
    return best_sources(matrix, alike, starts, iterations)


def _warn_if_stalled(
    matrix: Complex128[np.ndarray, "foci elements"],
    sources: Complex128[np.ndarray, "foci"],
    iterations: int,
) -> None:
    """Warn with ``Stalled`` where more iterations with the same phases at the foci would bring over ``STALLED_FROM``.

    With the phases c_f fixed the best drive is a convex problem, whose dual bounds what is left: no
    drive has min_f Re(conj(c_f) h_f d) above Σ_e |Σ_f s_f conj(h_fe)| / Σ_f |s_f| for sources s_f
    of those phases. ``matrix`` has rows over what each focus asks; the elements emit the phases of
    Hᴴ s.
    """
    sent = matrix.conj().T @ sources
    magnitudes = np.abs(sent)
    worst = smallest_pressure(matrix, sent / np.maximum(magnitudes, np.finfo(float).tiny))
    left = 1.0 - worst * np.abs(sources).sum() / magnitudes.sum()
    if left > STALLED_FROM:
        after = counted(iterations, "iteration", "iterations")
        warn_stalled(
            "max_min",
            matrix,
            worst,
            f"after {after}, {left:.1%} of the pressure short of where they lead",
        )


def warn_stalled(
    method: str, matrix: Complex128[np.ndarray, "foci elements"], worst: float, where: str
) -> None:
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
