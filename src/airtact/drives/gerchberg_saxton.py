"""Gerchberg-Saxton and its variants: alternating projections between elements at full scale and foci as asked.

The methods choose the phases at the foci; phases and suppression points of the target have no
effect.
"""

import numpy as np
from jaxtyping import Complex64, Complex128, Float32, Float64, Int64

from airtact import _kernels
from airtact.acoustics.target import Target
from airtact.drives.constraint import AT_MOST_ONE, Constraint
from airtact.drives.reach import asked_rows, scaled_to_target
from airtact.drives.transfer import Drive, TransferMatrix
from airtact.errors import InvalidInput

LAGGING = 1e-3
"""Below this fraction of the mean pressure, a focus gains no more weight for a lower pressure still."""

WEIGHTED_ITERATIONS = 10
"""Iterations of weighted Gerchberg-Saxton after GS-PAT."""

FOCI_ITERATIONS = 50
"""Iterations of GS-PAT before weighted Gerchberg-Saxton where there are many sets."""

SINGLE = np.float32(1.0 - 2e-7)
"""Factor that brings magnitudes of 1 in single precision to at most 1."""


def gerchberg_saxton(
    transfer: TransferMatrix,
    target: Target,
    *,
    iterations: int = 50,
    constraint: Constraint = AT_MOST_ONE,
) -> Drive:
    """Find phases for the elements by alternating d = phase(Hᴴ s) and s_f = w_f · phase((H d)_f).

    w_f is the pressure or share that focus f asks for. Gerchberg and Saxton, Optik 35 (1972) 237;
    for sound Marzo and Drinkwater, PNAS 116 (2019) 84.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the foci and the pressures asked there.
    iterations : how often to alternate between elements and foci.
    constraint : the amplitudes and phases that an element can emit.

    Returns
    -------
    The drive, scaled as ``phase_conjugate`` scales it and rounded to the levels of the constraint.

    Raises
    ------
    InvalidInput
        If the foci of the target are not those of the matrix, there are more foci than elements, two foci are too
        close together, a focus is shadowed, or there is less than one iteration.
    """
    return _projected(transfer, target, iterations, constraint, weighted=False)


def weighted_gerchberg_saxton(
    transfer: TransferMatrix,
    target: Target,
    *,
    iterations: int = 50,
    constraint: Constraint = AT_MOST_ONE,
) -> Drive:
    """Alternate as ``gerchberg_saxton``, with more weight at every iteration on a focus that lags; keep the best.

    Di Leonardo, Ianni and Ruocco, Opt. Express 15 (2007) 1913; for sound Marzo and Drinkwater, PNAS
    116 (2019) 84. The method starts from the foci in phase and from the elements in phase, and
    returns the better drive. Where the weights oscillate, as they can between two foci with nearly
    equal rows of H, it shortens their steps. With ``constraint.phase_bits`` it starts from the
    elements in phase alone and does neither. Phases and suppression points of the target have no
    effect. Parameters, result and errors are those of ``gerchberg_saxton``.
    """
    return _projected(transfer, target, iterations, constraint, weighted=True)


def gs_pat(
    transfer: TransferMatrix,
    target: Target,
    *,
    iterations: int = 50,
    constraint: Constraint = AT_MOST_ONE,
) -> Drive:
    """Alternate on the (F, F) matrix H Hᴴ between the foci alone, which is fast where elements are many.

    Plasencia, Hirayama, Montano-Murillo and Subramanian, ACM Trans. Graph. 39 (2020) 138: each
    iteration is s -> w · phase(H Hᴴ s); at the end the sources are weighted by w²/|p|, and every
    element is set to full scale. A few iterations of ``weighted_gerchberg_saxton``, which the paper
    does not have, recover what full scale costs the worst focus; they never make it worse.
    Parameters, result and errors are those of ``gerchberg_saxton``.
    """
    matrix, wanted = asked_rows(transfer, target)
    check_iterations(iterations)
    start = wanted[None].astype(np.complex128)
    sources = best_sources(matrix, wanted, start, WEIGHTED_ITERATIONS, foci_iterations=iterations)
    return scaled_to_target(transfer, target, phase(matrix.conj().T @ sources), constraint)


def weighted_gerchberg_saxton_sets(
    transfer: TransferMatrix,
    sets: Int64[np.ndarray, "sets foci"],
    weights: Float64[np.ndarray, "sets foci"] | None = None,
    *,
    iterations: int = 10,
) -> list[Drive]:
    """Make one drive for each of many sets of foci on one matrix: by ``gs_pat``, then weighted Gerchberg-Saxton.

    Parameters
    ----------
    transfer : the (P, E) transfer matrix of all P points.
    sets : (S, F) rows of the matrix that are the foci of each set.
    weights : (S, F) pressures asked in proportion, 0 where a set has fewer than F foci; 1 for all
        by default.
    iterations : of weighted Gerchberg-Saxton, after ``FOCI_ITERATIONS`` of GS-PAT.

    Returns
    -------
    S drives, all elements at full scale.

    Raises
    ------
    InvalidInput
        If a row is not in the matrix, a weight is negative or not finite, a set asks for nothing, or there is less than
        one iteration.
    """
    check_iterations(iterations)
    points = len(transfer.matrix)
    if sets.min(initial=0) < 0 or sets.max(initial=0) >= points:
        wrong = sets[(sets < 0) | (sets >= points)][0]
        raise InvalidInput(
            f"a set of foci has the row {wrong}, but the transfer matrix has rows 0 to {points - 1}.",
            code="out_of_range",
        )
    wanted = np.ones(sets.shape) if weights is None else weights
    if wanted.shape != sets.shape or not (np.isfinite(wanted) & (wanted >= 0.0)).all():
        raise InvalidInput(
            f"weights of sets are {sets.shape} numbers from 0 up; {wanted.min(initial=0):g} is there.",
            code="all_zero",
        )
    silent = np.flatnonzero(wanted.max(axis=1, initial=0.0) == 0.0)
    if len(silent):
        raise InvalidInput(
            f"set {silent[0]} asks every focus for 0; ask at least one focus for more.",
            code="empty",
        )
    start = wanted.astype(np.complex128)
    *_, drives = alternating_projections(
        transfer.matrix, sets, wanted, start, iterations, True, FOCI_ITERATIONS
    )
    return [Drive(phases) for phases in (SINGLE * drives).astype(np.complex128)]


def alternating_projections(
    matrix: Complex128[np.ndarray, "points elements"],
    sets: Int64[np.ndarray, "sets foci"],
    wanted: Float64[np.ndarray, "sets foci"],
    sources: Complex128[np.ndarray, "sets foci"],
    iterations: int,
    weighted: bool = True,
    foci_iterations: int = 0,
) -> tuple[
    Complex64[np.ndarray, "sets foci"],
    Float32[np.ndarray, "sets"],
    Complex64[np.ndarray, "sets elements"],
]:
    """Alternate between elements and foci with phases only, for many sets of foci at once, in single precision.

    ``sets`` has the rows of the matrix that are the foci of each set, ``wanted`` the pressures
    asked in proportion, and the magnitudes of ``sources``, to start from, are the weights. If
    ``weighted``, foci that lag get more weight, and the best iteration is returned, else the last;
    ``foci_iterations`` of GS-PAT come first. Of each set are returned the sources at the foci, the
    smallest pressure over what was asked (the largest of which counts 1) [Pa], and the phasors of
    the elements.
    """
    single = matrix.astype(np.complex64)
    real, imag = np.ascontiguousarray(single.real), np.ascontiguousarray(single.imag)
    asked = (wanted / wanted.max(axis=1, keepdims=True)).astype(np.float32)
    found, worst = sources.astype(np.complex64), np.empty(len(sets), dtype=np.float32)
    drives = np.empty((len(sets), matrix.shape[1]), dtype=np.complex64)
    _kernels.gerchberg_saxton(
        real,
        imag,
        np.ascontiguousarray(sets),
        asked,
        foci_iterations,
        iterations,
        weighted,
        found,
        worst,
        drives,
    )
    return found, worst, drives


def best_sources(
    matrix: Complex128[np.ndarray, "foci elements"],
    wanted: Float64[np.ndarray, "foci"],
    starts: Complex128[np.ndarray, "starts foci"],
    iterations: int,
    weighted: bool = True,
    foci_iterations: int = 0,
) -> Complex128[np.ndarray, "foci"]:
    """Alternate on one set of foci from several starts, and return the sources with the strongest worst focus."""
    sets, asked = (np.tile(some, (len(starts), 1)) for some in (np.arange(len(wanted)), wanted))
    found, worst, _ = alternating_projections(
        matrix, sets, asked, starts, iterations, weighted, foci_iterations
    )
    return found[worst.argmax()].astype(np.complex128)


def starting_sources(
    matrix: Complex128[np.ndarray, "foci elements"], wanted: Float64[np.ndarray, "foci"]
) -> Complex128[np.ndarray, "2 foci"]:
    """Return sources to start from: the foci in phase, and those after one iteration from the elements in phase."""
    pressure = matrix.sum(axis=1)
    floor = LAGGING * max(float(np.abs(pressure).max()), np.finfo(float).tiny)
    from_elements = wanted**2 * phase(pressure) / np.maximum(np.abs(pressure), floor)
    if not from_elements.all():
        from_elements = wanted.astype(np.complex128)
    return np.stack([wanted.astype(np.complex128), from_elements / np.abs(from_elements).max()])


def phase(numbers: Complex128[np.ndarray, "*shape"]) -> Complex128[np.ndarray, "*shape"]:
    """Numbers of magnitude 1 with the same phases; 0 stays 0."""
    return numbers / np.maximum(np.abs(numbers), np.finfo(float).tiny)


def _projected(
    transfer: TransferMatrix,
    target: Target,
    iterations: int,
    constraint: Constraint,
    weighted: bool,
) -> Drive:
    matrix, wanted = asked_rows(transfer, target)
    check_iterations(iterations)
    starts = starting_sources(matrix, wanted)[: 2 if weighted else 1]
    if constraint.phase_bits is not None:
        amplitudes = quantised_projections(
            matrix, wanted, starts[-1], iterations, constraint, weighted
        )
        return scaled_to_target(transfer, target, amplitudes, constraint)
    sources = best_sources(matrix, wanted, starts, iterations, weighted)
    return scaled_to_target(transfer, target, phase(matrix.conj().T @ sources), constraint)


def quantised_projections(
    matrix: Complex128[np.ndarray, "foci elements"],
    wanted: Float64[np.ndarray, "foci"],
    sources: Complex128[np.ndarray, "foci"],
    iterations: int,
    constraint: Constraint,
    weighted: bool = True,
) -> Complex128[np.ndarray, "elements"]:
    """Alternate with the phases that the constraint has, so that the iterations compensate the rounding."""
    back = np.ascontiguousarray(matrix.conj().T)
    weights, largest, best = wanted, -np.inf, np.zeros(matrix.shape[1], dtype=np.complex128)
    for _ in range(iterations):
        amplitudes = constraint.nearest(phase(back @ sources))
        pressure = matrix @ amplitudes
        got = np.abs(pressure) / wanted
        if not weighted or got.min() > largest:
            best, largest = amplitudes, got.min()
        if weighted:
            weights = weights * got.mean() / np.maximum(got, LAGGING * got.mean())
            weights = weights / weights.max()
        sources = weights * phase(pressure)
    return best


def check_iterations(iterations: int) -> None:
    """Raise ``InvalidInput`` for fewer than one iteration."""
    if iterations < 1:
        raise InvalidInput(
            f"{iterations} iterations make no drive; give at least 1.", code="too_few"
        )
