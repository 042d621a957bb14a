"""Gerchberg-Saxton and its kin: to and fro between elements at full scale and foci at the pressures asked.

The foci choose their phases themselves; phases and suppression points of the target have no effect.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Complex128, Float32, Float64, Int64

from airtact import _kernels
from airtact.conventions import InvalidInput
from airtact.scene.target import Target
from airtact.synthesis.constraint import AT_MOST_ONE, Constraint
from airtact.synthesis.reach import asked_rows, scaled_to_target
from airtact.transfer import Drive, TransferMatrix

LAGGING = 1e-3
"""A focus that gets less than this of the mean is not given more weight for being quieter still."""

AFTERWARDS = 10
"""Turns of weighted Gerchberg-Saxton after GS-PAT."""

BETWEEN_FOCI = 50
"""Turns of GS-PAT before weighted Gerchberg-Saxton where there are many sets."""

SINGLE = np.float32(1.0 - 2e-7)
"""What brings magnitudes of 1 in single precision to at most 1."""


@dataclass(frozen=True, eq=False)
class Turns:
    """Where going to and fro ended, for every set of foci.

    Attributes
    ----------
    sources : (S, F) the sources in the foci of the best turn, their magnitudes being the weights.
    worst : (S,) smallest pressure over what was asked, the largest of which counts 1 [Pa].
    drives : (S, E) phases of every element, magnitude 1.
    """

    sources: Complex64[np.ndarray, "sets foci"]
    worst: Float32[np.ndarray, "sets"]
    drives: Complex64[np.ndarray, "sets elements"]


def gerchberg_saxton(
    transfer: TransferMatrix, target: Target, *, iterations: int = 50, constraint: Constraint = AT_MOST_ONE
) -> Drive:
    """Phases alone: d = phase(Hᴴ s), s_f = w_f · phase of the pressure at f, again and again.

    Gerchberg and Saxton, Optik 35 (1972) 237; for sound Marzo and Drinkwater, PNAS 116 (2019) 84.

    Parameters
    ----------
    transfer : the transfer matrix.
    target : the foci and what they ask.
    iterations : how often to go to and fro.
    constraint : what an element can play.

    Returns
    -------
    The drive, scaled as ``phase_conjugate`` scales it, its levels those of the constraint.

    Raises
    ------
    InvalidInput
        If the target does not fit the matrix, ``check_solvable`` refuses its foci, or there is less than one iteration.
    """
    return _to_and_fro(transfer, target, iterations, constraint, weighted=False)


def weighted_gerchberg_saxton(
    transfer: TransferMatrix, target: Target, *, iterations: int = 50, constraint: Constraint = AT_MOST_ONE
) -> Drive:
    """Gerchberg-Saxton in which a focus that lags is given more weight at every turn; the best turn is kept.

    Di Leonardo, Ianni and Ruocco, Opt. Express 15 (2007) 1913; for sound Marzo and Drinkwater, PNAS 116 (2019) 84. It
    starts from the foci in phase and from the elements in phase, and keeps the better. Where weights swing to and fro,
    as they can between two foci that are heard alike, their steps are shortened. Parameters, result and refusals
    as ``gerchberg_saxton``.
    """
    return _to_and_fro(transfer, target, iterations, constraint, weighted=True)


def gs_pat(
    transfer: TransferMatrix, target: Target, *, iterations: int = 50, constraint: Constraint = AT_MOST_ONE
) -> Drive:
    """Gerchberg-Saxton on what the foci hear of each other, H Hᴴ, of foci by foci alone.

    Plasencia, Hirayama, Montano-Murillo and Subramanian, ACM Trans. Graph. 39 (2020) 138: each turn is s -> w · phase(H
    Hᴴ s); at the end the sources are weighed by w²/|p|, and every element is brought to full scale. What that costs the
    worst focus is made up for by a few turns of weighted Gerchberg-Saxton, which the paper does not have; they never
    make it worse. Parameters, result and refusals as ``gerchberg_saxton``.
    """
    matrix, wanted = asked_rows(transfer, target)
    check_iterations(iterations)
    alike = np.arange(len(wanted))[None]
    turns = to_and_fro(
        matrix, alike, wanted[None], wanted[None].astype(np.complex128), AFTERWARDS, between_foci=iterations
    )
    sources = turns.sources[0].astype(np.complex128)
    return scaled_to_target(transfer, target, phase(matrix.conj().T @ sources), constraint)


def weighted_gerchberg_saxton_sets(
    transfer: TransferMatrix,
    sets: Int64[np.ndarray, "sets foci"],
    weights: Float64[np.ndarray, "sets foci"] | None = None,
    *,
    iterations: int = 10,
) -> list[Drive]:
    """Make one drive for each of many sets of foci on one matrix: as ``gs_pat``, then weighted Gerchberg-Saxton.

    Parameters
    ----------
    transfer : the transfer matrix of all points.
    sets : (S, F) rows of the matrix that are the foci of each set.
    weights : (S, F) pressures asked in proportion, 0 where a set has fewer than F foci; 1 for all by default.
    iterations : how often to go to and fro, after ``BETWEEN_FOCI`` turns of GS-PAT.

    Returns
    -------
    S drives, all elements at full scale.

    Raises
    ------
    InvalidInput
        If a row is not in the matrix (which), a weight is negative or not finite, a set asks for nothing (which), or
        there is less than one iteration.
    """
    check_iterations(iterations)
    points = len(transfer.matrix)
    if sets.min(initial=0) < 0 or sets.max(initial=0) >= points:
        wrong = sets[(sets < 0) | (sets >= points)][0]
        raise InvalidInput(f"a set of foci has the row {wrong}, but the transfer matrix has rows 0 to {points - 1}.")
    wanted = np.ones(sets.shape) if weights is None else weights
    if wanted.shape != sets.shape or not (np.isfinite(wanted) & (wanted >= 0.0)).all():
        raise InvalidInput(f"weights of sets are {sets.shape} numbers from 0 up; {wanted.min(initial=0):g} is there.")
    silent = np.flatnonzero(wanted.max(axis=1, initial=0.0) == 0.0)
    if len(silent):
        raise InvalidInput(f"set {silent[0]} asks every focus for 0; ask at least one focus for more.")
    turns = to_and_fro(
        transfer.matrix, sets, wanted, wanted.astype(np.complex128), iterations, between_foci=BETWEEN_FOCI
    )
    return [Drive(phases) for phases in (SINGLE * turns.drives).astype(np.complex128)]


def to_and_fro(
    matrix: Complex128[np.ndarray, "points elements"],
    sets: Int64[np.ndarray, "sets foci"],
    wanted: Float64[np.ndarray, "sets foci"],
    sources: Complex128[np.ndarray, "sets foci"],
    iterations: int,
    weighted: bool = True,
    between_foci: int = 0,
) -> Turns:
    """Go to and fro with phases only, for many sets of foci at once, in single precision.

    Parameters
    ----------
    matrix : (P, E) transfer matrix [Pa].
    sets : (S, F) its rows that are the foci of each set.
    wanted : (S, F) pressures asked, in proportion.
    sources : (S, F) where to start; their magnitudes are the weights.
    iterations : how often.
    weighted : whether foci that lag get more weight; the best turn is kept then, else the last.
    between_foci : turns of GS-PAT before.
    """
    single = matrix.astype(np.complex64)
    real, imag = np.ascontiguousarray(single.real), np.ascontiguousarray(single.imag)
    asked = (wanted / wanted.max(axis=1, keepdims=True)).astype(np.float32)
    kept, worst = sources.astype(np.complex64), np.empty(len(sets), dtype=np.float32)
    drives = np.empty((len(sets), matrix.shape[1]), dtype=np.complex64)
    _kernels.gerchberg_saxton(
        real, imag, np.ascontiguousarray(sets), asked, between_foci, iterations, weighted, kept, worst, drives
    )
    return Turns(kept, worst, drives)


def plain_starts(
    matrix: Complex128[np.ndarray, "foci elements"], wanted: Float64[np.ndarray, "foci"]
) -> Complex128[np.ndarray, "2 foci"]:
    """Return sources to start from: the foci in phase, and what they are after one turn from the elements in phase."""
    heard = matrix.sum(axis=1)
    loudness = np.maximum(np.abs(heard), LAGGING * max(float(np.abs(heard).max()), np.finfo(float).tiny))
    from_elements = wanted**2 * phase(heard) / loudness
    if not from_elements.all():
        from_elements = wanted.astype(np.complex128)
    return np.stack([wanted.astype(np.complex128), from_elements / np.abs(from_elements).max()])


def phase(numbers: Complex128[np.ndarray, "*shape"]) -> Complex128[np.ndarray, "*shape"]:
    """Numbers of magnitude 1 with the same phases; 0 stays 0."""
    return numbers / np.maximum(np.abs(numbers), np.finfo(float).tiny)


def _to_and_fro(
    transfer: TransferMatrix, target: Target, iterations: int, constraint: Constraint, weighted: bool
) -> Drive:
    matrix, wanted = asked_rows(transfer, target)
    check_iterations(iterations)
    starts = plain_starts(matrix, wanted)[: 2 if weighted else 1]
    if constraint.phase_bits is not None:
        return scaled_to_target(
            transfer, target, in_levels(matrix, wanted, starts[-1], iterations, constraint, weighted), constraint
        )
    sets = np.tile(np.arange(len(wanted)), (len(starts), 1))
    turns = to_and_fro(matrix, sets, np.tile(wanted, (len(starts), 1)), starts, iterations, weighted)
    sources = turns.sources[turns.worst.argmax()].astype(np.complex128)
    return scaled_to_target(transfer, target, phase(matrix.conj().T @ sources), constraint)


def in_levels(
    matrix: Complex128[np.ndarray, "foci elements"],
    wanted: Float64[np.ndarray, "foci"],
    sources: Complex128[np.ndarray, "foci"],
    iterations: int,
    constraint: Constraint,
    weighted: bool = True,
) -> Complex128[np.ndarray, "elements"]:
    """Go to and fro with the phases that there are, so that the foci make up for the rounding."""
    back = np.ascontiguousarray(matrix.conj().T)
    weights, best, kept = wanted, -np.inf, np.zeros(matrix.shape[1], dtype=np.complex128)
    for _ in range(iterations):
        amplitudes = constraint.nearest(phase(back @ sources))
        pressure = matrix @ amplitudes
        got = np.abs(pressure) / wanted
        if not weighted or got.min() > best:
            kept, best = amplitudes, got.min()
        if weighted:
            weights = weights * got.mean() / np.maximum(got, LAGGING * got.mean())
            weights = weights / weights.max()
        sources = weights * phase(pressure)
    return kept


def check_iterations(iterations: int) -> None:
    """Refuse fewer than one iteration (``InvalidInput``)."""
    if iterations < 1:
        raise InvalidInput(f"{iterations} iterations make no drive; give at least 1.")
