"""The strongest worst focus: from the optimum of the relaxation down to one drive."""

import numpy as np
from jaxtyping import Complex128

from airtact.scene.target import Target
from airtact.synthesis.constraint import AT_MOST_ONE, Constraint
from airtact.synthesis.gerchberg_saxton import check_iterations, in_levels, phase, plain_starts, to_and_fro
from airtact.synthesis.reach import asked_rows, scaled_to_target
from airtact.synthesis.relaxation import to_one_slot
from airtact.synthesis.stalling import tell_if_stalled
from airtact.synthesis.upper_bound import relaxed_bound
from airtact.transfer import Drive, TransferMatrix

RELAXED_TO = 1e-2
"""How near the relaxation is brought to its optimum before its slots are dropped; nearer changes nothing."""


def max_min(
    transfer: TransferMatrix, target: Target, *, iterations: int = 300, constraint: Constraint = AT_MOST_ONE
) -> Drive:
    """Make the worst focus as strong as is known how to.

    The relaxation of ``upper_bound`` is solved, in which every element may play several time slots; its weakest slots
    are dropped a few at a time, going to and fro in between, until one is left; and weighted Gerchberg-Saxton goes on
    from there to where it cannot improve. It also goes from where ``weighted_gerchberg_saxton`` starts, and the best is
    kept; nothing is drawn at random. The relaxation is that of Inoue, Makino and Shinoda (IEEE World Haptics 2015); the
    way down to one slot is our own. With many dozens of foci beside each other the turns may not settle; ``gradient``
    climbs on from there.

    Parameters
    ----------
    transfer : the transfer matrix.
    target : the foci and what they ask; phases and suppression points are not heeded.
    iterations : how often to go to and fro at the end.
    constraint : what an element can play.

    Returns
    -------
    The drive, scaled as ``phase_conjugate`` scales it, its levels those of the constraint.

    Raises
    ------
    InvalidInput
        If the target does not fit the matrix, ``check_solvable`` refuses its foci, or there is less than one iteration.

    Warns
    -----
    Stalled
        If the iterations were too few; the best drive is returned.
    """
    matrix, wanted = asked_rows(transfer, target)
    check_iterations(iterations)
    sources = strongest_sources(matrix / wanted[:, None], iterations)
    tell_if_stalled("max_min", matrix / wanted[:, None], sources, iterations)
    if constraint.phase_bits is None:
        amplitudes = phase(matrix.conj().T @ (sources / wanted))
    else:
        amplitudes = in_levels(matrix, wanted, sources / wanted, iterations, constraint)
    return scaled_to_target(transfer, target, amplitudes, constraint)


def strongest_sources(
    matrix: Complex128[np.ndarray, "foci elements"], iterations: int
) -> Complex128[np.ndarray, "foci"]:
    """Return the sources s whose phases of Hᴴ s are the drive.

    Parameters
    ----------
    matrix : (F, E) rows over what each focus asks.
    iterations : how often to go to and fro at the end.
    """
    alike = np.ones(len(matrix))
    way_down = to_one_slot(matrix, relaxed_bound(matrix, RELAXED_TO)[1])
    starts = np.concatenate([way_down[None], plain_starts(matrix, alike)])
    sets = np.tile(np.arange(len(matrix)), (len(starts), 1))
    turns = to_and_fro(matrix, sets, np.tile(alike, (len(starts), 1)), starts, iterations)
    return turns.sources[turns.worst.argmax()].astype(np.complex128)
