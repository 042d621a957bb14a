"""Drives by linear algebra: time reversal, inverse filter and least peak amplitude."""

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.target import Target
from airtact.drives.drive import Amplitudes, Drive
from airtact.drives.gerchberg_saxton import check_iterations
from airtact.drives.transfer import (
    FociRows,
    TransferMatrix,
    check_solvable,
    foci_rows,
    scaled_to_target,
    suppression_rows,
)
from airtact.errors import positive


def time_reversal(transfer: TransferMatrix, target: Target) -> Drive:
    """Compute the time-reversal drive d = Hᴴ w, where H is the transfer matrix.

    Each element emits, reversed in time, the sound that it would receive from sources at the foci
    (Inoue, Makino and Shinoda, 2014, equations 9 and 10; equation 5 for several foci). The weight
    w_f is the requested pressure of focus f, its share (relative pressure), or 1 if the target
    requests neither. Its phase is the requested phase, or 0 if no phase is requested, as in that
    paper. For one focus, no drive of equal energy Σ|d|² produces more pressure (Cauchy-Schwarz
    inequality). With several foci, each focus also receives the sound meant for the others, so the
    ratios of their pressures differ from the requested ratios. The method ignores suppression
    points.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the foci and their requested pressures.

    Returns
    -------
    A ``Drive`` of E elements, scaled so that the smallest ratio of pressure to request is 1. If
    this requires more than full scale, or if no pressure is requested, the largest amplitude is 1.
    ``achieved_fraction`` returns the ratio of pressure to request at each focus.

    Raises
    ------
    InvalidInput
        If the transfer matrix was computed for other foci, or if the contributions of the foci
        cancel at every element.
    """
    return scaled_to_target(transfer, target, _reversed(transfer, target))


def phase_conjugate(transfer: TransferMatrix, target: Target) -> Drive:
    """Compute the drive with the phases of ``time_reversal`` and equal amplitudes of all elements.

    The phase of element e is that of Σ_f w_f conj(H_fe), where H is the transfer matrix and w_f the
    requested complex pressure or share of focus f, or 1 if none is requested. At equal peak
    amplitude, no other drive produces more pressure at a single focus, because the sound of every
    element arrives in phase. With several foci, the pressures are not balanced. The method ignores
    suppression points.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix H of F foci and E elements.
    target : the foci and their requested pressures, shares and phases.

    Returns
    -------
    A ``Drive`` of E elements with equal amplitudes, or 0 for elements at which the contributions of
    the foci cancel. The amplitude is full scale or, if less is enough for the requested pressures
    at all foci, the lowest amplitude that produces them.

    Raises
    ------
    InvalidInput
        If the transfer matrix was computed for other foci, or if the contributions of the foci
        cancel at every element.
    """
    return scaled_to_target(transfer, target, np.sign(_reversed(transfer, target)))


def _reversed(transfer: TransferMatrix, target: Target) -> Amplitudes:
    return foci_rows(transfer, target).conj().T @ target.wanted


def inverse_filter(
    transfer: TransferMatrix, target: Target, *, weight: float | None = None
) -> Drive:
    """Compute a drive by Tikhonov regularisation, d = Hᴴ (H Hᴴ + weight ‖H‖² I)⁻¹ w.

    H is the transfer matrix, and w_f the requested complex pressure of focus f, or its share. With
    weight 0, every focus gets w_f, including its phase, from the drive of least energy Σ|d|² that
    produces it (Tanter, Thomas and Fink, J. Acoust. Soc. Am. 108 (2000) 223). A larger weight
    reduces the energy at the cost of deviations from w. With the transfer matrix of open air, this
    is the least-squares method of Hasegawa and Shinoda (IEEE World Haptics 2013). Suppression
    points are included as rows of H with w = 0.

    Parameters
    ----------
    transfer : the transfer matrix of the foci, and of the suppression points if the target has
        some.
    target : the foci and their requested pressures; a focus without a requested phase gets phase 0,
        and without pressures or shares, all foci get the same pressure.
    weight : Tikhonov's weight as a fraction of the largest eigenvalue ‖H‖² of H Hᴴ, 0 or more; None
        selects the corner of the L-curve (Hansen and O'Leary, SIAM J. Sci. Comput. 14 (1993) 1487).

    Returns
    -------
    A ``Drive`` of E elements, scaled so that the focus with the smallest ratio of pressure to
    request gets its requested pressure. If this requires more than full scale, or if no pressure is
    requested, the largest amplitude is 1.

    Raises
    ------
    InvalidInput
        If the transfer matrix was computed for other foci or has no rows for the suppression
        points, if there are more foci than elements, if two foci are closer than a tenth of a
        wavelength, if the largest possible pressure at a focus is below 5 % of the median of the
        others, or if the weight is negative.
    """
    check_solvable(transfer, target)
    matrix = np.concatenate([foci_rows(transfer, target), suppression_rows(transfer, target)])
    requests = np.concatenate([target.wanted, np.zeros(len(matrix) - len(target.points))])
    # In the eigenvector basis of H Hᴴ, each weight of the L-curve costs only one division.
    eigenvalues, modes = np.linalg.eigh(matrix @ matrix.conj().T)
    asked = modes.conj().T @ requests
    if weight is None:
        weight = _l_curve_corner(eigenvalues, np.abs(asked) ** 2)
    if weight != 0.0:
        weight = positive(weight, "Tikhonov's weight", "of ‖H‖²")
    # Eigenvalues below rounding error are noise.
    floor = max(weight, np.finfo(float).eps * len(eigenvalues)) * eigenvalues[-1]
    damped = np.maximum(eigenvalues, 0.0) + floor
    return scaled_to_target(transfer, target, matrix.conj().T @ (modes @ (asked / damped)))


def _l_curve_corner(
    eigenvalues: Float64[np.ndarray, "rows"], asked: Float64[np.ndarray, "rows"]
) -> float:
    """Return Tikhonov's weight at the largest curvature of log ‖d‖ against log ‖H d − w‖."""
    # Twelve weights per decade, from rounding error to the norm of H Hᴴ itself.
    weights = np.geomspace(1e-10, 1.0, 121)
    relative = np.maximum(eigenvalues / eigenvalues[-1], 0.0)
    damped = relative + weights[:, None]
    missing = 0.5 * np.log(np.sum(asked * (weights[:, None] / damped) ** 2, axis=1))
    norm = 0.5 * np.log(np.sum(asked * relative / damped**2, axis=1))
    # Curvature (x' y'' − x'' y') / (x'² + y'²)^{3/2}; primes are derivatives with respect to log
    # weight.
    step = np.log(weights[1] / weights[0])
    x1 = np.gradient(missing, step)
    y1 = np.gradient(norm, step)
    x2 = np.gradient(x1, step)
    y2 = np.gradient(y1, step)
    return float(weights[np.argmax((x1 * y2 - x2 * y1) / (x1**2 + y1**2) ** 1.5)])


def least_peak(transfer: TransferMatrix, target: Target, *, iterations: int = 50) -> Drive:
    """Compute the drive of least peak amplitude that produces every requested pressure and phase.

    The method minimises max_e |d_e| over all drives with H d = w, the requested complex pressures.
    The dual problem, which minimises Σ_e |h_eᴴ λ| subject to Re wᴴ λ = 1, is solved by iteratively
    reweighted least squares (Daubechies, DeVore, Fornasier and Güntürk, Comm. Pure Appl. Math. 63
    (2010) 1). Every step yields a drive with H d = w, and the drive with the lowest peak is
    returned. Nearly all its elements have the same amplitude, so at full scale it produces more
    pressure at the foci than ``inverse_filter``. The method ignores suppression points.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements; h_e is its column for element e.
    target : the foci and their requested pressures or shares. Without either, the foci get equal
        pressures. If the target requests no phases, the pressures at all foci have phase 0.
    iterations : number of reweighting steps, 1 or more; 50 by default.

    Returns
    -------
    A ``Drive`` of E elements, scaled so that the foci get their requested pressures. If this
    requires more than full scale, or if no pressure is requested, the largest amplitude is 1. The
    pressures have the requested ratios and phases in all these cases.

    Raises
    ------
    InvalidInput
        If the transfer matrix was computed for other foci, if there are more foci than elements, if
        two foci are less than a tenth of a wavelength apart, if a focus is shadowed (its largest
        possible pressure is below 5 % of the median of the others), or if ``iterations`` is below
        1.
    """
    check_solvable(transfer, target)
    check_iterations(iterations)
    return scaled_to_target(
        transfer,
        target,
        exact_amplitudes(foci_rows(transfer, target), target.wanted, iterations),
    )


def exact_amplitudes(
    matrix: FociRows,
    requests: Complex128[np.ndarray, "foci"],
    iterations: int = 50,
    sufficient_peak: float = 0.0,
) -> Amplitudes:
    """Return the amplitudes d with the smallest peak max_e |d_e| that satisfy H d = w.

    H is ``matrix``, and w contains the complex ``requests``. The iteration starts at the amplitudes
    of least energy and stops once the peak is at most ``sufficient_peak``.
    """
    # Rows of equal norm keep the least-squares problem well conditioned for foci at all distances.
    norms = np.linalg.norm(matrix, axis=1)
    matrix = matrix / norms[:, None]
    requests = requests / norms
    back = matrix.conj().T
    weights = np.ones(len(back))
    best = np.zeros(len(back), dtype=np.complex128)
    lowest_peak = np.inf
    for _ in range(iterations):
        sources = np.linalg.lstsq(matrix @ (weights[:, None] * back), requests, rcond=None)[0]
        sent = back @ sources
        amplitudes = weights * sent
        peak = float(np.abs(amplitudes).max())
        if peak < lowest_peak:
            best = amplitudes
            lowest_peak = peak
        if lowest_peak <= sufficient_peak:
            break
        # The floor keeps the weights of weak elements finite.
        weights = 1.0 / np.maximum(np.abs(sent) / np.abs(sent).mean(), 1e-6)
    return best
