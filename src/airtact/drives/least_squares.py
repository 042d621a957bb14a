"""Least squares: drives whose pressures at the foci are those asked, with phases as asked or that go well together."""

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.target import Target
from airtact.checks import number, positive
from airtact.drives.reach import check_solvable, foci_rows, scaled_to_target, suppression_rows
from airtact.drives.transfer import Drive, TransferMatrix
from airtact.errors import InvalidInput


def inverse_filter(
    transfer: TransferMatrix, target: Target, *, weight: float | None = None
) -> Drive:
    """Solve least squares with Tikhonov regularisation: d = Hᴴ (H Hᴴ + weight ‖H‖² I)⁻¹ w.

    With weight 0 every focus gets the pressure w_f that it asks for, phase included, by the drive
    of least energy that can give it. Tanter, Thomas and Fink, J. Acoust. Soc. Am. 108 (2000) 223;
    with the transfer matrix of open air this is the least-squares method of Hasegawa and Shinoda
    (IEEE World Haptics 2013). Suppression points are rows of H with w = 0.

    Parameters
    ----------
    transfer : the transfer matrix of the foci, and of the suppression points where the target has
        some.
    target : the foci and the pressures asked there; a focus that asks for no phase gets phase 0.
    weight : Tikhonov's weight over the largest eigenvalue ‖H‖² of H Hᴴ; None for the corner of the
        L-curve (Hansen and O'Leary, SIAM J. Sci. Comput. 14 (1993) 1487).

    Returns
    -------
    The drive, scaled as ``time_reversal`` scales it.

    Raises
    ------
    InvalidInput
        As ``gerchberg_saxton``, the suppression points are not those of the matrix, or the weight is negative.
    """
    check_solvable(transfer, target)
    matrix = np.concatenate([foci_rows(transfer, target), suppression_rows(transfer, target)])
    wanted = np.concatenate([target.wanted, np.zeros(len(matrix) - len(target.points))])
    squares, modes = np.linalg.eigh(matrix @ matrix.conj().T)
    asked = modes.conj().T @ wanted
    share = _corner(squares, np.abs(asked) ** 2) if weight is None else weight
    if share != 0.0:
        share = positive(share, "Tikhonov's weight", "of ‖H‖²")
    # Below rounding an eigenvalue holds nothing but noise.
    damped = np.maximum(squares, 0.0) + max(share, np.finfo(float).eps * len(squares)) * squares[-1]
    return scaled_to_target(transfer, target, matrix.conj().T @ (modes @ (asked / damped)))


def iterated_time_reversal(transfer: TransferMatrix, target: Target, *, passes: int = 5) -> Drive:
    """Emit, measure the pressure at the foci, and time-reverse the pressure that is missing, pass after pass.

    d_0 = 0, d_{n+1} = d_n + Hᴴ s_n, with s_n from the missing pressure w − H d_n. One pass is
    ``time_reversal`` with the rows of H scaled to equal norms, and many passes converge to
    ``inverse_filter`` with weight 0. Montaldo, Tanter and Fink, J. Acoust. Soc. Am. 115 (2004) 768;
    the steps are those of conjugate gradients (Craig's method, Saad, Iterative Methods for Sparse
    Linear Systems, 2003, algorithm 8.5), with as many products as theirs. The method ignores
    suppression points.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the foci and the pressures asked there; a focus that asks for no phase gets phase 0.
    passes : how often to emit and measure.

    Returns
    -------
    The drive, scaled as ``time_reversal`` scales it.

    Raises
    ------
    InvalidInput
        As ``gerchberg_saxton``, or there is less than one pass.
    """
    check_solvable(transfer, target)
    matrix = foci_rows(transfer, target)
    if passes < 1:
        raise InvalidInput(
            f"{passes} passes of time reversal make no drive; give at least 1.", code="too_few"
        )
    norms = np.linalg.norm(matrix, axis=1)
    equal = matrix / np.where(norms > 0.0, norms, 1.0)[:, None]
    missing = target.wanted / np.where(norms > 0.0, norms, 1.0)
    least = np.finfo(float).eps * np.linalg.norm(missing)
    amplitudes = np.zeros(matrix.shape[1], dtype=np.complex128)
    sent, before = np.zeros_like(missing), 1.0
    for _ in range(passes):
        left = np.vdot(missing, missing).real
        if left <= least**2:
            break
        sent, before = missing + left / before * sent, left
        back = equal.conj().T @ sent
        step = left / np.vdot(back, back).real
        amplitudes, missing = amplitudes + step * back, missing - step * (equal @ back)
    return scaled_to_target(transfer, target, amplitudes)


def eigenvector(transfer: TransferMatrix, target: Target, *, evenness: float = 1.0) -> Drive:
    """Choose the phases of the foci by an eigenvector, and solve least squares for the pressures with those phases.

    Long, Seah, Carter and Subramanian, ACM Trans. Graph. 33 (2014) 181. R_fg is the pressure at
    focus f when the array focuses on focus g alone, at the pressure that g asks for. The
    eigenvector of R with the largest eigenvalue gives phases under which the foci reinforce each
    other. The drive is least squares for those pressures with Tikhonov weights σ_e^γ, σ_e² = Σ_f
    |H_fe| w_f / E, which limit the largest amplitudes (their section 4.3). The method ignores the
    phases that the target asks for, and its suppression points.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the foci and the pressures asked there.
    evenness : γ, from 0 (all elements weigh alike) to 1.

    Returns
    -------
    The drive, scaled as ``time_reversal`` scales it.

    Raises
    ------
    InvalidInput
        As ``gerchberg_saxton``, or ``evenness`` is no number.
    """
    check_solvable(transfer, target)
    matrix = foci_rows(transfer, target)
    power = number(evenness, "the evenness", "1")
    wanted = target.weights
    # Where no pressure is asked, about what each focus can have: the weights below compare pascals
    # with pascals.
    if target.pressures is None:
        wanted = wanted / wanted.max() * np.abs(matrix).sum(axis=1).mean() / np.sqrt(len(matrix))
    energy = np.sum(np.abs(matrix) ** 2, axis=1)
    focused = matrix.conj().T * (wanted / np.where(energy > 0.0, energy, 1.0))
    values, vectors = np.linalg.eig(matrix @ focused)
    asked = wanted * np.exp(1j * np.angle(vectors[:, np.argmax(np.real(values))]))
    spread = (np.abs(matrix).T @ wanted / matrix.shape[1]) ** power
    evened = matrix / np.where(spread > 0.0, spread, 1.0)
    inverse = np.linalg.solve(evened @ matrix.conj().T + np.eye(len(matrix)), asked)
    return scaled_to_target(transfer, target, evened.conj().T @ inverse)


def _corner(squares: Float64[np.ndarray, "rows"], asked: Float64[np.ndarray, "rows"]) -> float:
    """Tikhonov's weight at the largest curvature of log ‖d‖ over log ‖H d − w‖."""
    weights = np.geomspace(1e-10, 1.0, 121)
    relative = np.maximum(squares / squares[-1], 0.0)
    damped = relative + weights[:, None]
    missing = 0.5 * np.log(np.sum(asked * (weights[:, None] / damped) ** 2, axis=1))
    norm = 0.5 * np.log(np.sum(asked * relative / damped**2, axis=1))
    step = np.log(weights[1] / weights[0])
    x1, y1 = np.gradient(missing, step), np.gradient(norm, step)
    x2, y2 = np.gradient(x1, step), np.gradient(y1, step)
    return float(weights[np.argmax((x1 * y2 - x2 * y1) / (x1**2 + y1**2) ** 1.5)])
