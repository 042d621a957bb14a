"""The strongest worst focus: from the optimum of the relaxation to one drive."""

import numpy as np
from jaxtyping import Complex128

from airtact.scene.target import Target
from airtact.synthesis.constraint import AT_MOST_ONE, Constraint
from airtact.synthesis.gerchberg_saxton import (
    alternating_projections,
    check_iterations,
    phase,
    quantised_projections,
    starting_sources,
)
from airtact.synthesis.reach import asked_rows, scaled_to_target
from airtact.synthesis.relaxation import to_rank_one
from airtact.synthesis.stalling import warn_if_stalled
from airtact.synthesis.upper_bound import relaxed_bound
from airtact.transfer import Drive, TransferMatrix

RELAXED_TO = 1e-2
"""Relative gap to which the relaxation is solved before its rank is reduced; a smaller gap changes nothing."""


def max_min(
    transfer: TransferMatrix, target: Target, *, iterations: int = 300, constraint: Constraint = AT_MOST_ONE
) -> Drive:
    """Make the worst focus as strong as possible, with phases at the foci that the method chooses.

    The method first solves the semidefinite relaxation of ``upper_bound`` (Inoue, Makino and Shinoda, IEEE World
    Haptics 2015), in which every element may emit several signals in turn. It then drops the weakest of them, a few at
    a time with iterations in between, until one is left (our own scheme), and runs ``iterations`` steps of weighted
    Gerchberg-Saxton from there. It also starts from where ``weighted_gerchberg_saxton`` starts, and returns the best
    drive. The result is deterministic. With many dozens of foci close to each other the iterations may not converge;
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
        If the foci of the target are not those of the matrix, there are more foci than elements, two foci are too
        close together, a focus is shadowed, or there is less than one iteration.

    Warns
    -----
    Stalled
        If the worst focus stays more than 3 % below what the same phases allow; the best drive is returned.
    """
    matrix, wanted = asked_rows(transfer, target)
    check_iterations(iterations)
    sources = strongest_sources(matrix / wanted[:, None], iterations)
    warn_if_stalled("max_min", matrix / wanted[:, None], sources, iterations)
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
    sets = np.tile(np.arange(len(matrix)), (len(starts), 1))
    found = alternating_projections(matrix, sets, np.tile(alike, (len(starts), 1)), starts, iterations)
    return found.sources[found.worst.argmax()].astype(np.complex128)
