"""Drives by gradient descent: amplitudes and phases for the worst focus, and for silence at suppression points."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.target import Target
from airtact.checks import counted
from airtact.drives.constraint import AT_MOST_ONE, Constraint
from airtact.drives.gerchberg_saxton import check_iterations, phase
from airtact.drives.reach import asked_rows, scaled_to_target, suppression_rows
from airtact.drives.transfer import Drive, TransferMatrix
from airtact.drives.weakest_focus import smallest_pressure, strongest_sources, warn_stalled
from airtact.errors import InvalidInput

SOFTNESS = 200.0
"""Power of the mean that approximates the smallest pressure: 16 equal ones count 1.4 % less than one."""

SILENT = 1e-3
"""Suppression points below this fraction of the weakest focus, 60 dB, are silent enough."""

PENALTIES = (1e2, 1e3, 1e4, 1e5)
"""Penalty on passing the allowed loss, per squared neper, in one descent after another."""

Objective = Callable[
    [Complex128[np.ndarray, "elements"]], tuple[float, Complex128[np.ndarray, "elements"]]
]
"""From amplitudes to a value to be minimised and its gradient g, which changes it by Re Σ conj(g_e) δd_e."""


def gradient(
    transfer: TransferMatrix,
    target: Target,
    *,
    loss: float = 0.1,
    iterations: int = 500,
    constraint: Constraint = AT_MOST_ONE,
) -> Drive:
    """Improve the amplitudes and phases of the drive of ``max_min``, and silence the suppression points.

    Without suppression points the method divides each focus's pressure by what it asks, maximises
    the power mean of exponent −``SOFTNESS``, which is close to the smallest, and returns the better
    of start and end. With suppression points it minimises their mean squared pressure, with a
    penalty where the power mean falls below 1 − ``loss`` of its start. The descent is L-BFGS-B
    (Byrd, Lu, Nocedal and Zhu, SIAM J. Sci. Comput. 16 (1995) 1190) on amplitudes between 0 and 1
    and phases, or on phases alone. It ignores the phases that the target asks for.

    Parameters
    ----------
    transfer : the transfer matrix of the foci, and of the suppression points where the target has
        some.
    target : the foci, the pressures asked there, and the suppression points.
    loss : fraction of the starting pressure at the foci that may be lost to the suppression points,
        at least 0 and below 1; the limit is soft.
    iterations : largest number of steps of one descent.
    constraint : the amplitudes and phases that an element can emit; levels are rounded to at the
        end.

    Returns
    -------
    The drive, scaled as ``time_reversal`` scales it and rounded to the levels of the constraint.

    Raises
    ------
    InvalidInput
        As ``gerchberg_saxton``, the suppression points are not those of the matrix, or the loss is out of its range.

    Warns
    -----
    Stalled
        If the steps were too few; the best drive is returned.
    """
    matrix, wanted = asked_rows(transfer, target)
    suppressed = suppression_rows(transfer, target)
    check_iterations(iterations)
    if not 0.0 <= loss < 1.0:
        raise InvalidInput(
            f"the loss at the foci is {loss:g}, but it must be a fraction from 0 up to 1.",
            code="out_of_range",
        )
    matrix = matrix / wanted[:, None]
    start = phase(matrix.conj().T @ strongest_sources(matrix, 300))
    silenced = suppressed / (SILENT * smallest_pressure(matrix * wanted[:, None], start))
    least, found, done = _soft_smallest(matrix, start)[0] + np.log1p(-loss), start, True
    for penalty in PENALTIES if len(suppressed) else PENALTIES[:1]:
        objective = _objective(matrix, silenced, least, penalty)
        found, done = _descend(objective, found, iterations, constraint.phase_only)
    if not len(suppressed) and smallest_pressure(matrix, found) < smallest_pressure(matrix, start):
        found = start
    if not done:
        steps = f"after {counted(iterations, 'step', 'steps')}, still improving"
        warn_stalled("gradient", matrix, smallest_pressure(matrix, found), steps)
    return scaled_to_target(transfer, target, found, constraint)


def _objective(
    matrix: Complex128[np.ndarray, "foci elements"],
    suppressed: Complex128[np.ndarray, "suppressed elements"],
    least: float,
    penalty: float,
) -> Objective:
    """Minimise minus the smallest pressure, or the suppressed level with the smallest pressure above ``least``."""

    def objective(
        amplitudes: Complex128[np.ndarray, "elements"],
    ) -> tuple[float, Complex128[np.ndarray, "elements"]]:
        smallest, smallest_gradient = _soft_smallest(matrix, amplitudes)
        if not len(suppressed):
            return -smallest, -smallest_gradient
        level, level_gradient = _suppressed_level(suppressed, amplitudes)
        missing = max(least - smallest, 0.0)
        return (
            level + penalty * missing**2,
            level_gradient - 2.0 * penalty * missing * smallest_gradient,
        )

    return objective


def _soft_smallest(
    matrix: Complex128[np.ndarray, "foci elements"], amplitudes: Complex128[np.ndarray, "elements"]
) -> tuple[float, Complex128[np.ndarray, "elements"]]:
    """Logarithm of the mean of the power −``SOFTNESS`` of the pressures over what is asked, and its gradient."""
    pressure = matrix @ amplitudes
    logs = np.log(np.maximum(np.abs(pressure), np.finfo(float).tiny))
    weights = np.exp(SOFTNESS * (logs.min() - logs))
    smallest = logs.min() - np.log(weights.mean()) / SOFTNESS
    shares = weights / weights.sum()
    return float(smallest), matrix.conj().T @ (shares * pressure / np.exp(2.0 * logs))


def _suppressed_level(
    suppressed: Complex128[np.ndarray, "suppressed elements"],
    amplitudes: Complex128[np.ndarray, "elements"],
) -> tuple[float, Complex128[np.ndarray, "elements"]]:
    """Logarithm of the root of 1 and the mean squared pressure in the suppression points, and its gradient."""
    pressure = suppressed @ amplitudes
    energy = float(np.vdot(pressure, pressure).real) + len(suppressed)
    return 0.5 * np.log(energy / len(suppressed)), suppressed.conj().T @ pressure / energy


def _descend(
    objective: Objective,
    start: Complex128[np.ndarray, "elements"],
    iterations: int,
    phase_only: bool,
) -> tuple[Complex128[np.ndarray, "elements"], bool]:
    """Return the amplitudes at the end of the descent, and whether it converged."""
    from scipy.optimize import minimize

    count, full = len(start), np.abs(start)

    def amplitudes_of(
        numbers: Float64[np.ndarray, "numbers"],
    ) -> Complex128[np.ndarray, "elements"]:
        return (full if phase_only else numbers[count:]) * np.exp(1j * numbers[:count])

    def value(
        numbers: Float64[np.ndarray, "numbers"],
    ) -> tuple[float, Float64[np.ndarray, "numbers"]]:
        amplitudes = amplitudes_of(numbers)
        least, derivative = objective(amplitudes)
        by_phase = np.real(np.conj(derivative) * 1j * amplitudes)
        by_amplitude = np.real(np.conj(derivative) * np.exp(1j * numbers[:count]))
        return least, by_phase if phase_only else np.concatenate([by_phase, by_amplitude])

    numbers = np.angle(start) if phase_only else np.concatenate([np.angle(start), full])
    bounds = [(None, None)] * count + [(0.0, 1.0)] * (len(numbers) - count)
    options = {"maxiter": iterations, "maxfun": 2 * iterations, "ftol": 1e-4}
    found = minimize(value, numbers, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return amplitudes_of(found.x), found.status == 0
