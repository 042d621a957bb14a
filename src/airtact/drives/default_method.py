"""The default: the method that serves a target best, by what the target asks."""

import warnings
from collections.abc import Callable

import numpy as np

from airtact.acoustics.target import Target
from airtact.drives.conjugation import phase_conjugate
from airtact.drives.gradient_descent import gradient
from airtact.drives.least_squares import inverse_filter
from airtact.drives.peak_limited import exactly, least_peak
from airtact.drives.reach import asked_rows, check_foci
from airtact.drives.transfer import Drive, TransferMatrix
from airtact.drives.weakest_focus import Stalled, max_min
from airtact.transducers.levels import FULL_SCALE


def best(transfer: TransferMatrix, target: Target) -> Drive:
    """Make the drive by the method that gives the weakest focus most, for what the target asks.

    ================================== =====================================================================
    the target asks for                method
    ================================== =====================================================================
    one focus                          ``phase_conjugate``, at full scale the attainable maximum
    several foci                       ``max_min``, continued by ``gradient`` where it stalls
    phases at several foci             ``least_peak``
    suppression points                 ``gradient``; the foci lose a tenth of their pressure at most
    suppression points and phases      ``inverse_filter``
    ================================== =====================================================================

    Where pressures are asked without suppression points and full scale is enough, each focus gets
    exactly what it asks: the drive keeps the phases at the foci, and its energy is the least where
    that leaves every element within full scale. Where full scale is not enough, the weakest focus
    gets as large a part as it can.

    Parameters
    ----------
    transfer : the transfer matrix of the foci, and of the suppression points where the target has
        some.
    target : the foci, what is asked there, and the suppression points.

    Returns
    -------
    The drive, scaled as ``time_reversal`` scales it. ``achieved_fraction`` gives the pressure of each focus over the
    pressure asked, and ``upper_bound`` what no drive exceeds.

    Raises
    ------
    InvalidInput
        As the method that is chosen, or what is given is of another kind.

    Warns
    -----
    Stalled
        If the iterations were too few; the best drive is returned.

    Examples
    --------
    >>> transfer = TransferMatrix(np.array([[3.0 + 0j, 4j]]), 0.0)
    >>> transfer.pressure(best(transfer, Target(np.zeros((1, 3))))).real.round(9).tolist()
    [7.0]
    """
    check_foci(transfer, target)
    method = method_for(target)
    drive = _settled(transfer, target) if method is max_min else method(transfer, target)
    if target.pressures is None or len(target.suppression_points):
        return drive
    return _exact(transfer, target, drive)


def _settled(transfer: TransferMatrix, target: Target) -> Drive:
    """Make the drive by ``max_min``, and continue with ``gradient`` where that stalls."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", Stalled)
        drive = max_min(transfer, target)
    return gradient(transfer, target) if caught else drive


def method_for(target: Target) -> Callable[[TransferMatrix, Target], Drive]:
    """Return the method by which ``best`` makes the drive for a target."""
    phases = target.phases is not None
    if len(target.suppression_points):
        return inverse_filter if phases else gradient
    if np.count_nonzero(target.weights) == 1:
        return phase_conjugate
    return least_peak if phases else max_min


def _exact(transfer: TransferMatrix, target: Target, drive: Drive) -> Drive:
    """Give each focus exactly what it asks, with the phases of a drive; that drive where full scale is not enough."""
    matrix, wanted = asked_rows(transfer, target)
    pressure = matrix @ drive.amplitudes
    amplitudes = exactly(matrix, wanted * np.exp(1j * np.angle(pressure)), enough=1.0)
    return Drive(amplitudes) if np.abs(amplitudes).max() <= FULL_SCALE else drive
