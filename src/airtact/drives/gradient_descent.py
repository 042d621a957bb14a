"""Gradient descent on amplitudes and phases, for the weakest focus and for suppression points."""

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.target import Target
from airtact.drives.drive import Amplitudes, Drive
from airtact.drives.gerchberg_saxton import check_iterations, phase
from airtact.drives.max_min import smallest_pressure, strongest_sources, warn_stalled
from airtact.drives.reach import FociRows, asked_rows, scaled_to_target, suppression_rows
from airtact.drives.transfer import TransferMatrix
from airtact.errors import InvalidInput, counted

SHARPNESS = 200.0
"""Negative exponent of the power mean that approximates the smallest pressure.

With 16 foci, the mean exceeds the smallest pressure by at most 1.4 %."""

Suppressed = Complex128[np.ndarray, "suppressed elements"]
"""Rows of the transfer matrix at the suppression points."""


def gradient(
    transfer: TransferMatrix, target: Target, *, loss: float = 0.1, iterations: int = 500
) -> Drive:
    """Improve the drive from ``max_min``, and reduce the pressure at the suppression points.

    The pressure of each focus is divided by its requested pressure. Without suppression points the
    method maximises the power mean of these ratios with exponent −200, which is close to the
    smallest ratio. It returns the start or the end of the descent, whichever is better. With
    suppression points it minimises their mean squared pressure, with a penalty if the power mean
    falls below 1 − ``loss`` times its initial value. The descent is L-BFGS-B (Byrd, Lu, Nocedal and
    Zhu, SIAM J. Sci. Comput. 16 (1995) 1190) on phases and on amplitudes between 0 and 1. The
    method ignores requested phases.

    Parameters
    ----------
    transfer : the transfer matrix of the foci, and of the suppression points if the target has
        some.
    target : the foci, their requested pressures and the suppression points.
    loss : fraction of the initial pressure at the foci that may be lost in favour of the
        suppression points, at least 0 and below 1; the limit is soft.
    iterations : largest number of steps of one descent.

    Returns
    -------
    The drive, scaled like the result of ``time_reversal``.

    Raises
    ------
    InvalidInput
        Under the conditions listed in ``weighted_gerchberg_saxton``, if the matrix has no rows for
        the suppression points, or if the loss is out of range.

    Warns
    -----
    Stalled
        If the descent did not converge within ``iterations`` steps. The best drive is still
        returned.
    """
    matrix, requests = asked_rows(transfer, target)
    suppressed = suppression_rows(transfer, target)
    check_iterations(iterations)
    if not 0.0 <= loss < 1.0:
        raise InvalidInput(
            f"the loss at the foci is {loss:g}, but it must be at least 0 and less than 1.",
            code="out_of_range",
        )
    matrix = matrix / requests[:, None]
    # The descent is local, so it starts from the best known drive.
    start = phase(matrix.conj().T @ strongest_sources(matrix, 300))
    if len(suppressed):
        # Suppression points 60 dB below the weakest focus are quiet enough. The penalty grows from
        # one descent to the next, so the first descents may exceed the allowed loss.
        silenced = suppressed / (1e-3 * smallest_pressure(matrix * requests[:, None], start))
        lowest = _soft_smallest(matrix, start)[0] + np.log1p(-loss)
        drive = start
        converged = True
        for penalty in (1e2, 1e3, 1e4, 1e5):
            drive, converged = _descend(matrix, silenced, lowest, penalty, drive, iterations)
    else:
        drive, converged = _descend(matrix, suppressed, 0.0, 0.0, start, iterations)
        # The power mean may rise while the smallest pressure falls.
        if smallest_pressure(matrix, drive) < smallest_pressure(matrix, start):
            drive = start
    if not converged:
        steps = f"after {counted(iterations, 'step', 'steps')}, still improving"
        warn_stalled("gradient", matrix, smallest_pressure(matrix, drive), steps)
    return scaled_to_target(transfer, target, drive)


def _descend(
    matrix: FociRows,
    suppressed: Suppressed,
    lowest: float,
    penalty: float,
    start: Amplitudes,
    iterations: int,
) -> tuple[Amplitudes, bool]:
    """Minimise −smallest, or level + penalty · max(lowest − smallest, 0)² with suppression points.

    ``smallest`` is the logarithm of the smallest pressure, and ``level`` is the logarithm of the
    pressure at the suppression points. Return the amplitudes and whether the descent converged.
    """
    from scipy.optimize import minimize

    count = len(start)

    def by_coordinates(
        coordinates: Float64[np.ndarray, "coordinates"],
    ) -> tuple[float, Float64[np.ndarray, "coordinates"]]:
        """Return the loss, and its gradient with respect to the phases and then the magnitudes."""
        turns = np.exp(1j * coordinates[:count])
        amplitudes = coordinates[count:] * turns
        # The value changes by Re Σ conj(g_e) δd_e with the gradient g.
        smallest, slope = _soft_smallest(matrix, amplitudes)
        value = -smallest
        gradient = -slope
        if len(suppressed):
            level, level_gradient = _suppressed_level(suppressed, amplitudes)
            missing = max(lowest - smallest, 0.0)
            value = level + penalty * missing**2
            gradient = level_gradient - 2.0 * penalty * missing * slope
        # The chain rule for d = r e^{iφ}: ∂d/∂φ = i d, ∂d/∂r = e^{iφ}.
        by_phase = np.real(np.conj(gradient) * 1j * amplitudes)
        return value, np.concatenate([by_phase, np.real(np.conj(gradient) * turns)])

    end = minimize(
        by_coordinates,
        np.concatenate([np.angle(start), np.abs(start)]),
        jac=True,
        method="L-BFGS-B",
        bounds=[(None, None)] * count + [(0.0, 1.0)] * count,
        options={"maxiter": iterations, "maxfun": 2 * iterations, "ftol": 1e-4},
    )
    return end.x[count:] * np.exp(1j * end.x[:count]), end.status == 0


def _soft_smallest(matrix: FociRows, amplitudes: Amplitudes) -> tuple[float, Amplitudes]:
    """Return the log of the power mean of the ratios of pressure to request, and its gradient."""
    pressure = matrix @ amplitudes
    logs = np.log(np.maximum(np.abs(pressure), np.finfo(float).tiny))
    # The logarithms are taken relative to the smallest one, so that no power overflows.
    weights = np.exp(SHARPNESS * (logs.min() - logs))
    smallest = logs.min() - np.log(weights.mean()) / SHARPNESS
    # ∂ log|p| / ∂ conj(p) has the direction p / |p|².
    shares = weights / weights.sum()
    return float(smallest), matrix.conj().T @ (shares * pressure / np.exp(2.0 * logs))


def _suppressed_level(suppressed: Suppressed, amplitudes: Amplitudes) -> tuple[float, Amplitudes]:
    """Return log √(1 + mean squared pressure) at the suppression points, and its gradient."""
    pressure = suppressed @ amplitudes
    # The 1 under the root removes any reward for suppression beyond 60 dB.
    energy = float(np.vdot(pressure, pressure).real) + len(suppressed)
    return 0.5 * np.log(energy / len(suppressed)), suppressed.conj().T @ pressure / energy
