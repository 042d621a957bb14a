"""The least peak: pressures and phases exactly as asked, with the strongest element as weak as possible."""

import numpy as np
from jaxtyping import Complex128

from airtact.acoustics.target import Target
from airtact.drives.gerchberg_saxton import check_iterations
from airtact.drives.reach import check_solvable, foci_rows, scaled_to_target
from airtact.drives.transfer import Drive, TransferMatrix

SMALLEST = 1e-6
"""Elements that matter less than this part of the mean keep their weight."""


def least_peak(transfer: TransferMatrix, target: Target, *, iterations: int = 50) -> Drive:
    """Give every focus exactly the pressure and phase that it asks for, with the least peak amplitude.

    The method minimises max_e |d_e| over all drives with H d = w. The dual, Σ_e |h_eᴴ λ| at least
    with Re wᴴ λ = 1, is solved by iteratively reweighted least squares (Daubechies, DeVore,
    Fornasier and Güntürk, Comm. Pure Appl. Math. 63 (2010) 1), of which every step gives a drive
    with H d = w; the one of least peak is returned. Nearly all elements then have the same
    amplitude, so at full scale the foci get more than by ``inverse_filter``. The method ignores
    suppression points.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the foci and the pressures asked there; a focus that asks for no phase gets phase 0.
    iterations : number of steps.

    Returns
    -------
    The drive, scaled as ``time_reversal`` scales it; its pressures have the ratios and phases asked at any scale.

    Raises
    ------
    InvalidInput
        As ``gerchberg_saxton``.
    """
    check_solvable(transfer, target)
    check_iterations(iterations)
    return scaled_to_target(
        transfer, target, exactly(foci_rows(transfer, target), target.wanted, iterations)
    )


def exactly(
    matrix: Complex128[np.ndarray, "foci elements"],
    wanted: Complex128[np.ndarray, "foci"],
    iterations: int = 50,
    enough: float = 0.0,
) -> Complex128[np.ndarray, "elements"]:
    """Return the amplitudes of least peak with H d = w, or the first on the way there whose peak is ``enough``.

    The way begins at the amplitudes of least energy.
    """
    norms = np.linalg.norm(matrix, axis=1)
    matrix, wanted = matrix / norms[:, None], wanted / norms
    back = matrix.conj().T
    weights, best, least = np.ones(len(back)), np.zeros(len(back), dtype=np.complex128), np.inf
    for _ in range(iterations):
        sources = np.linalg.lstsq(matrix @ (weights[:, None] * back), wanted, rcond=None)[0]
        sent = back @ sources
        amplitudes = weights * sent
        peak = float(np.abs(amplitudes).max())
        if peak < least:
            best, least = amplitudes, peak
        if least <= enough:
            break
        magnitudes = np.abs(sent) / np.abs(sent).mean()
        weights = 1.0 / np.maximum(magnitudes, SMALLEST)
    return best
