"""Time reversal: play back, reversed in time, what each element would hear from the foci."""

import numpy as np
from jaxtyping import Complex128

from airtact.scene.target import Target
from airtact.synthesis.reach import foci_rows, scaled_to_target
from airtact.transfer import Drive, TransferMatrix


def time_reversal(transfer: TransferMatrix, target: Target) -> Drive:
    """Time reversal with its amplitudes kept: d = Hᴴ w, the conjugate of what the elements hear.

    Equations 9 and 10 of the paper, with equation 5 for several foci: w is the pressure or share that each focus asks
    for (1 for all where none does), with phase 0, as the paper has it, where the target asks for none. For one focus no
    drive of equal energy Σ|d|² gives more pressure (Cauchy-Schwarz); several foci also hear each other's sound, so that
    their shares differ. Suppression points are not heeded.

    Parameters
    ----------
    transfer : the transfer matrix.
    target : the foci and what they ask.

    Returns
    -------
    The drive, scaled so that the worst focus reaches what it asked; where that takes more than full scale, or no
    pressure is asked, the loudest element is 1. ``achieved_fraction`` tells what each focus gets of what it asked.

    Raises
    ------
    InvalidInput
        If the target has not one focus per row of the matrix, or the foci cancel at every element.
    """
    return scaled_to_target(transfer, target, _reversed(transfer, target))


def phase_conjugate(transfer: TransferMatrix, target: Target) -> Drive:
    """Keep the phases of time reversal and make every element equally loud.

    At equal peak this gives one focus more pressure than any other drive: every element arrives in phase at full scale.

    Parameters
    ----------
    transfer : the transfer matrix.
    target : the foci and what they ask; their pressures or shares weigh the foci before the amplitudes are dropped.

    Returns
    -------
    The drive, all at full scale, or all scaled down alike where the worst focus asks for less. ``achieved_fraction``
    says what each focus gets of what it asked.

    Raises
    ------
    InvalidInput
        If the target has not one focus per row of the matrix, or the foci cancel at every element.
    """
    return scaled_to_target(transfer, target, np.sign(_reversed(transfer, target)))


def _reversed(transfer: TransferMatrix, target: Target) -> Complex128[np.ndarray, "elements"]:
    """Σ_f w_f conj(H_fe) for every element e."""
    return foci_rows(transfer, target).conj().T @ target.wanted
