"""Drives by climbing: amplitudes and phases along the gradient of the worst focus, and of the quiet."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.conventions import InvalidInput
from airtact.scene.target import Target
from airtact.synthesis.constraint import AT_MOST_ONE, Constraint
from airtact.synthesis.gerchberg_saxton import check_iterations, phase
from airtact.synthesis.max_min import strongest_sources
from airtact.synthesis.reach import asked_rows, scaled_to_target, suppression_rows
from airtact.synthesis.stalling import warn_stalled, worst_share
from airtact.transfer import Drive, TransferMatrix
from airtact.validation import counted

SOFTNESS = 200.0
"""Power of the mean that stands for the smallest share: 16 equal shares count 1.4 % less than one."""

SILENCE = 1e-3
"""Suppression points that get less than this of the weakest focus are quiet enough; 60 dB."""

STEEPNESS = (1e2, 1e3, 1e4, 1e5)
"""What passing the allowed loss costs, per squared neper, in climbs one after another."""

Climb = Callable[[Complex128[np.ndarray, "elements"]], tuple[float, Complex128[np.ndarray, "elements"]]]
"""From amplitudes to what shall be small and its gradient g, by which it changes by Re Σ conj(g_e) δd_e."""


def gradient(
    transfer: TransferMatrix,
    target: Target,
    *,
    loss: float = 0.1,
    iterations: int = 500,
    constraint: Constraint = AT_MOST_ONE,
) -> Drive:
    """Climb from the drive of ``max_min`` with amplitudes and phases free, and make the suppression points quiet.

    Without suppression points the smallest share grows, by a mean of the power −``SOFTNESS``, and the better of
    start and end is kept. With suppression points their mean squared pressure falls while the smallest share may
    fall by ``loss``. The climb is L-BFGS-B (Byrd, Lu, Nocedal and Zhu, SIAM J. Sci. Comput. 16 (1995) 1190) on
    amplitudes between 0 and 1 and phases, or on phases alone. Phases that the target asks for are not heeded.

    Parameters
    ----------
    transfer : the transfer matrix, of the suppression points too where the target has some.
    target : the foci and what they ask.
    loss : part of the pressure at the foci that may be given for the suppression points, from 0 up to 1.
    iterations : most steps of a climb.
    constraint : what an element can play; levels are rounded to at the end.

    Returns
    -------
    The drive, scaled as ``time_reversal`` scales it, its levels those of the constraint.

    Raises
    ------
    InvalidInput
        If the target misfits the matrix, ``check_solvable`` refuses its foci, it lacks suppression points, the loss
        is not from 0 up to 1, or there is less than one iteration.

    Warns
    -----
    Stalled
        If the steps were too few; the best drive is returned.
    """
    matrix, wanted = asked_rows(transfer, target)
    quiet = suppression_rows(transfer, target)
    check_iterations(iterations)
    if not 0.0 <= loss < 1.0:
        raise InvalidInput(f"the loss at the foci is {loss:g}, but it must be a share from 0 up to 1.")
    matrix = matrix / wanted[:, None]
    start = phase(matrix.conj().T @ strongest_sources(matrix, 300))
    heard = quiet / (SILENCE * worst_share(matrix * wanted[:, None], start))
    least, found, done = _soft_smallest(matrix, start)[0] + np.log1p(-loss), start, True
    for steepness in STEEPNESS if len(quiet) else STEEPNESS[:1]:
        climb = _height(matrix, heard, least, steepness)
        found, done = _descend(climb, found, iterations, constraint.phase_only)
    if not len(quiet) and worst_share(matrix, found) < worst_share(matrix, start):
        found = start
    if not done:
        warn_stalled(
            "gradient",
            matrix,
            worst_share(matrix, found),
            f"after {counted(iterations, 'step', 'steps')}, still climbing",
        )
    return scaled_to_target(transfer, target, found, constraint)


def _height(
    matrix: Complex128[np.ndarray, "foci elements"],
    quiet: Complex128[np.ndarray, "suppressed elements"],
    least: float,
    steepness: float,
) -> Climb:
    """Return what shall be small: minus the smallest share, or the noise with the smallest share above ``least``."""

    def climb(amplitudes: Complex128[np.ndarray, "elements"]) -> tuple[float, Complex128[np.ndarray, "elements"]]:
        smallest, steeper = _soft_smallest(matrix, amplitudes)
        if not len(quiet):
            return -smallest, -steeper
        noise, louder = _noise(quiet, amplitudes)
        missing = max(least - smallest, 0.0)
        return noise + steepness * missing**2, louder - 2.0 * steepness * missing * steeper

    return climb


def _soft_smallest(
    matrix: Complex128[np.ndarray, "foci elements"], amplitudes: Complex128[np.ndarray, "elements"]
) -> tuple[float, Complex128[np.ndarray, "elements"]]:
    """Logarithm of the mean of the power −``SOFTNESS`` of the shares, and its gradient."""
    pressure = matrix @ amplitudes
    logs = np.log(np.maximum(np.abs(pressure), np.finfo(float).tiny))
    weights = np.exp(SOFTNESS * (logs.min() - logs))
    smallest = logs.min() - np.log(weights.mean()) / SOFTNESS
    shares = weights / weights.sum()
    return float(smallest), matrix.conj().T @ (shares * pressure / np.exp(2.0 * logs))


def _noise(
    quiet: Complex128[np.ndarray, "suppressed elements"], amplitudes: Complex128[np.ndarray, "elements"]
) -> tuple[float, Complex128[np.ndarray, "elements"]]:
    """Logarithm of the root of 1 and the mean squared pressure in the suppression points, and its gradient."""
    pressure = quiet @ amplitudes
    energy = float(np.vdot(pressure, pressure).real) + len(quiet)
    return 0.5 * np.log(energy / len(quiet)), quiet.conj().T @ pressure / energy


def _descend(
    climb: Climb, start: Complex128[np.ndarray, "elements"], iterations: int, phase_only: bool
) -> tuple[Complex128[np.ndarray, "elements"], bool]:
    """Return the amplitudes at the end of the climb, and whether it came to an end."""
    from scipy.optimize import minimize

    count, full = len(start), np.abs(start)

    def amplitudes_of(numbers: Float64[np.ndarray, "numbers"]) -> Complex128[np.ndarray, "elements"]:
        return (full if phase_only else numbers[count:]) * np.exp(1j * numbers[:count])

    def value(numbers: Float64[np.ndarray, "numbers"]) -> tuple[float, Float64[np.ndarray, "numbers"]]:
        amplitudes = amplitudes_of(numbers)
        height, slope = climb(amplitudes)
        turning = np.real(np.conj(slope) * 1j * amplitudes)
        swelling = np.real(np.conj(slope) * np.exp(1j * numbers[:count]))
        return height, turning if phase_only else np.concatenate([turning, swelling])

    numbers = np.angle(start) if phase_only else np.concatenate([np.angle(start), full])
    bounds = [(None, None)] * count + [(0.0, 1.0)] * (len(numbers) - count)
    options = {"maxiter": iterations, "maxfun": 2 * iterations, "ftol": 1e-4}
    found = minimize(value, numbers, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return amplitudes_of(found.x), found.status == 0
