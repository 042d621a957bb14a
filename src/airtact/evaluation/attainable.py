"""The most that one focus alone could get from an array, in closed form."""

import numpy as np
from jaxtyping import Float64

from airtact.conventions import InvalidInput
from airtact.transfer import TransferMatrix
from airtact.validation import of_kind


def attainable(transfer: TransferMatrix, energy: float | None = None) -> Float64[np.ndarray, "foci"]:
    """Largest pressure that each focus could get if the array served it alone [Pa], peak.

    With every element at most at full scale that is Σ_e |H_fe|: all arrive in phase, so it is also the most of phases
    alone. With a given energy Σ|d|² it is √energy · (Σ_e |H_fe|²)^½, by Cauchy-Schwarz, and never more than the first.

    Parameters
    ----------
    transfer : the transfer matrix.
    energy : Σ|d|² allowed, or None for full scale.

    Returns
    -------
    (F,) one for every row of the matrix.

    Raises
    ------
    InvalidInput
        If the energy is negative or not finite.

    Examples
    --------
    >>> transfer = TransferMatrix(np.array([[3.0 + 0j, 4j]]), 0.0)
    >>> attainable(transfer).tolist(), attainable(transfer, energy=1.0).tolist()
    ([7.0], [5.0])
    """
    of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
    loudness = np.abs(transfer.matrix)
    full = loudness.sum(axis=1)
    if energy is None:
        return full
    if not (np.isfinite(energy) and energy >= 0.0):
        raise InvalidInput(f"the energy is {energy:g}, but Σ|d|² is finite and not negative.")
    return np.minimum(full, np.sqrt(energy) * np.linalg.norm(loudness, axis=1))
