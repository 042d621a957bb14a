"""Gerchberg-Saxton and its kin: to and fro between elements at full scale and foci at the pressures asked.

The foci choose their phases themselves, so phases that a target asks for are not heeded; nor are its quiet points.
"""

import numpy as np
from jaxtyping import Complex128

from airtact.conventions import InvalidInput
from airtact.scene.target import Target
from airtact.synthesis.constraint import AT_MOST_ONE, Constraint
from airtact.synthesis.reach import foci_rows, scaled_to_target
from airtact.transfer import Drive, TransferMatrix


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
        If the target does not fit the matrix, or there is less than one iteration.
    """
    return _to_and_fro(transfer, target, iterations, constraint, weighted=False)


def weighted_gerchberg_saxton(
    transfer: TransferMatrix, target: Target, *, iterations: int = 50, constraint: Constraint = AT_MOST_ONE
) -> Drive:
    """Gerchberg-Saxton in which a focus that lags is given more weight at every turn; the best turn is kept.

    Di Leonardo, Ianni and Ruocco, Opt. Express 15 (2007) 1913; for sound Marzo and Drinkwater, PNAS 116 (2019) 84.
    Parameters, result and refusals as ``gerchberg_saxton``.
    """
    return _to_and_fro(transfer, target, iterations, constraint, weighted=True)


def gs_pat(
    transfer: TransferMatrix, target: Target, *, iterations: int = 50, constraint: Constraint = AT_MOST_ONE
) -> Drive:
    """Gerchberg-Saxton on what the foci hear of each other, H Hᴴ, of foci by foci alone.

    Plasencia, Hirayama, Montano-Murillo and Subramanian, ACM Trans. Graph. 39 (2020) 138: each turn is s -> w · phase(H
    Hᴴ s); at the end the sources are weighed by w²/|p|, and every element is brought to full scale. Parameters, result
    and refusals as ``gerchberg_saxton``.
    """
    matrix = foci_rows(transfer, target)
    _check_iterations(iterations)
    heard = matrix @ matrix.conj().T
    pressure = target.weights.astype(np.complex128)
    for _ in range(iterations):
        pressure = heard @ (target.weights * _phase(pressure))
    loud = np.abs(pressure)
    sources = target.weights**2 * _phase(pressure) / np.where(loud > 0.0, loud, 1.0)
    return scaled_to_target(transfer, target, _phase(matrix.conj().T @ sources), constraint)


def _to_and_fro(
    transfer: TransferMatrix, target: Target, iterations: int, constraint: Constraint, weighted: bool
) -> Drive:
    matrix = foci_rows(transfer, target)
    _check_iterations(iterations)
    asked = target.weights > 0.0
    matrix, wanted = matrix[asked], target.weights[asked]
    back = np.ascontiguousarray(matrix.conj().T)
    sources, weights, best = wanted.astype(np.complex128), wanted, -np.inf
    kept = np.zeros(matrix.shape[1], dtype=np.complex128)
    for _ in range(iterations):
        amplitudes = constraint.nearest(_phase(back @ sources))
        pressure = matrix @ amplitudes
        got = np.abs(pressure) / wanted
        if not weighted or got.min() > best:
            kept, best = amplitudes, got.min()
        if weighted:
            weights = weights * got.mean() / np.maximum(got, 1e-3 * got.mean())
            weights = weights / weights.max()
        sources = weights * _phase(pressure)
    return scaled_to_target(transfer, target, kept, constraint)


def _phase(numbers: Complex128[np.ndarray, "numbers"]) -> Complex128[np.ndarray, "numbers"]:
    """Numbers of magnitude 1 with the same phases; 0 stays 0."""
    magnitude = np.abs(numbers)
    return numbers / np.where(magnitude > 0.0, magnitude, 1.0)


def _check_iterations(iterations: int) -> None:
    if iterations < 1:
        raise InvalidInput(f"{iterations} iterations make no drive; give at least 1.")
