"""Time reversal: each element emits, reversed in time, what it would receive from sources at the foci."""

import numpy as np
from jaxtyping import Complex128

from airtact.acoustics.target import Target
from airtact.drives.reach import foci_rows, scaled_to_target
from airtact.drives.transfer import Drive, TransferMatrix


def time_reversal(transfer: TransferMatrix, target: Target) -> Drive:
    """Make the time reversal drive d = Hᴴ w, amplitudes and phases, H being the transfer matrix.

    Equations 9 and 10 of the paper, with its equation 5 for several foci: w_f is the pressure or
    share that focus f asks for (1 where the target asks for none), with the phase that it asks for,
    or phase 0 as in the paper. For one focus no drive of equal energy Σ|d|² gives more pressure
    (Cauchy-Schwarz). With several foci, each also receives the sound meant for the others, so their
    shares differ from those asked. The method ignores suppression points.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the foci and the pressures asked there.

    Returns
    -------
    The drive of E elements. It is scaled so that the worst focus gets the pressure it asked for; if that takes more
    than full scale, or no pressure is asked, the largest amplitude is 1. ``achieved_fraction`` gives the pressure of
    each focus over the pressure asked.

    Raises
    ------
    InvalidInput
        If the foci of the target are not those of the matrix, or the contributions of the foci cancel at every
        element.
    """
    return scaled_to_target(transfer, target, _reversed(transfer, target))


def phase_conjugate(transfer: TransferMatrix, target: Target) -> Drive:
    """Keep the phases of ``time_reversal`` and give every element the same amplitude.

    At equal peak amplitude, one focus gets more pressure from this than from any other drive: the
    sound of every element arrives in phase, and every element is at full scale, or all are scaled
    down alike where the worst focus asks for less. The pressures or shares asked weigh the foci
    before the amplitudes are dropped. The method ignores suppression points. Parameters and errors
    are those of ``time_reversal``.
    """
    return scaled_to_target(transfer, target, np.sign(_reversed(transfer, target)))


def _reversed(transfer: TransferMatrix, target: Target) -> Complex128[np.ndarray, "elements"]:
    """Σ_f w_f conj(H_fe) for every element e."""
    return foci_rows(transfer, target).conj().T @ target.wanted
