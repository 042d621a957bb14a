"""The inverse filter: the drive whose pressures at the foci are those asked, phases and all; and the way there."""

import numpy as np
from jaxtyping import Float64

from airtact.conventions import InvalidInput
from airtact.scene.target import Target
from airtact.synthesis.reach import check_solvable, foci_rows, scaled_to_target, suppression_rows
from airtact.transfer import Drive, TransferMatrix
from airtact.validation import positive


def inverse_filter(transfer: TransferMatrix, target: Target, *, weight: float | None = None) -> Drive:
    """Least squares with Tikhonov's weight: d = Hᴴ (H Hᴴ + weight ‖H‖² I)⁻¹ w.

    With weight 0 every focus gets its pressure with its phase, by the drive of least energy that can. Tanter, Thomas
    and Fink, J. Acoust. Soc. Am. 108 (2000) 223; on the matrix of open air it is the least-squares method of
    Hasegawa and Shinoda (IEEE World Haptics 2013). Suppression points are rows that ask for 0.

    Parameters
    ----------
    transfer : the transfer matrix, of the suppression points too where the target has some.
    target : the foci and what they ask, with phases where they matter (0 otherwise).
    weight : Tikhonov's weight over the largest eigenvalue ‖H‖² of H Hᴴ; None for the corner of the L-curve (Hansen and
        O'Leary, SIAM J. Sci. Comput. 14 (1993) 1487).

    Returns
    -------
    The drive, scaled as ``time_reversal`` scales it.

    Raises
    ------
    InvalidInput
        If the target does not fit the matrix, ``check_solvable`` refuses its foci, it lacks suppression points, or the
        weight is negative.
    """
    check_solvable(transfer, target)
    matrix = np.concatenate([foci_rows(transfer, target), suppression_rows(transfer, target)])
    wanted = np.concatenate([target.wanted, np.zeros(len(matrix) - len(target.points))])
    squares, modes = np.linalg.eigh(matrix @ matrix.conj().T)
    asked = modes.conj().T @ wanted
    share = _corner(squares, np.abs(asked) ** 2) if weight is None else _weight(weight)
    # Below rounding an eigenvalue holds nothing but noise.
    damped = np.maximum(squares, 0.0) + max(share, np.finfo(float).eps * len(squares)) * squares[-1]
    return scaled_to_target(transfer, target, matrix.conj().T @ (modes @ (asked / damped)))


def iterated_time_reversal(transfer: TransferMatrix, target: Target, *, passes: int = 5) -> Drive:
    """Play, listen at the foci, and send back in reversed time what is still missing, pass after pass.

    d_0 = 0, d_{n+1} = d_n + Hᴴ s_n, s_n from the missing pressure w − H d_n, so that one pass is ``time_reversal`` with
    each focus made equally well heard, and many passes are ``inverse_filter`` with weight 0. Montaldo, Tanter and Fink,
    J. Acoust. Soc. Am. 115 (2004) 768; the steps are those of conjugate gradients (Craig's method, Saad, Iterative
    Methods for Sparse Linear Systems, 2003, algorithm 8.5), with as many products as theirs. Suppression points are
    not heeded.

    Parameters
    ----------
    transfer : the transfer matrix.
    target : the foci and what they ask, with phases where they matter (0 otherwise).
    passes : how often to play and listen.

    Returns
    -------
    The drive, scaled as ``time_reversal`` scales it.

    Raises
    ------
    InvalidInput
        If the target does not fit the matrix, ``check_solvable`` refuses its foci, or there is less than one pass.
    """
    check_solvable(transfer, target)
    matrix = foci_rows(transfer, target)
    if passes < 1:
        raise InvalidInput(f"{passes} passes of time reversal make no drive; give at least 1.")
    loudness = np.linalg.norm(matrix, axis=1)
    equal = matrix / np.where(loudness > 0.0, loudness, 1.0)[:, None]
    missing = target.wanted / np.where(loudness > 0.0, loudness, 1.0)
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


def _weight(weight: float) -> float:
    return 0.0 if weight == 0 else positive(weight, "Tikhonov's weight", "of ‖H‖²")


def _corner(squares: Float64[np.ndarray, "rows"], asked: Float64[np.ndarray, "rows"]) -> float:
    """Tikhonov's weight where log ‖d‖ against log ‖H d − w‖ turns most sharply."""
    weights = np.geomspace(1e-10, 1.0, 121)
    heard = np.maximum(squares / squares[-1], 0.0)
    damped = heard + weights[:, None]
    missing = 0.5 * np.log(np.sum(asked * (weights[:, None] / damped) ** 2, axis=1))
    loudness = 0.5 * np.log(np.sum(asked * heard / damped**2, axis=1))
    step = np.log(weights[1] / weights[0])
    (x1, y1), (x2, y2) = (
        [np.gradient(line, step) for line in (missing, loudness)],
        [np.gradient(np.gradient(line, step), step) for line in (missing, loudness)],
    )
    return float(weights[np.argmax((x1 * y2 - x2 * y1) / (x1**2 + y1**2) ** 1.5)])
