"""Smallest change to a drive that yields most of the attainable pressure at the foci."""

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.gerchberg_saxton import asked_rows, weighted_gerchberg_saxton
from airtact.drives.max_min import upper_bound
from airtact.drives.transfer import TransferMatrix
from airtact.errors import between, of_kind

Phases = Float64[np.ndarray, "elements"]


def nearest_drive(
    transfer: TransferMatrix, target: Target, drive: Drive, share: float = 0.95
) -> Drive:
    """Change the phases of a drive as little as possible until every focus is strong enough.

    Use it to adapt the drive of another program to a hand. The goal is that the weakest focus, with
    the smallest ratio of pressure to request, reaches the fraction ``share`` of its ``upper_bound``
    for drives with the same amplitudes. The amplitudes do not change. The method of multipliers
    (J. Nocedal, S. J. Wright, *Numerical Optimization*, Springer 2006, section 17.4) minimises the
    mean of 1 − cos of the phase changes; a change common to all elements is ignored.

    Parameters
    ----------
    transfer : (F, E) transfer matrix, for example with the hand in place.
    target : the F foci and their requested pressures or shares. Only the ratios between the
        requested pressures matter.
    drive : the drive of E elements to change, for example one from another program.
    share : fraction of the bound that the weakest focus must reach, from 0 to 1. It is unrelated to
        the shares of the target.

    Returns
    -------
    The changed ``Drive``, or ``drive`` itself if it already reaches the goal. If the search finds
    no phases that reach the goal, the weakest focus gets the pressure that
    ``weighted_gerchberg_saxton`` reaches with the amplitudes of ``drive``, to within 0.2 %.

    Raises
    ------
    InvalidInput
        If the drive is silent or does not have as many elements as the matrix, if ``share`` is not
        between 0 and 1, if the matrix was computed for other foci, if there are more foci than
        elements, if two foci are less than a tenth of a wavelength apart, or if a focus is shadowed
        (its attainable pressure is below 5 % of the median for the other foci).

    Examples
    --------
    >>> import airtact as at
    >>> transfer = at.TransferMatrix(np.exp(1j * np.arange(30.0))[None], 1.0)
    >>> target = at.Target((0.0, 0.0, 0.1))
    >>> corrected = nearest_drive(transfer, target, at.Drive(np.ones(30, complex)))
    >>> round(float(np.abs(transfer.pressure(corrected)[0])), 1)
    28.5
    """
    between(share, 0.0, 1.0, "the share", "of the bound", "95 per cent is 0.95.")
    of_kind(
        transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)"
    ).check_fits(drive)
    weighted = TransferMatrix(transfer.matrix * drive.magnitudes, float("nan"))
    rows, requests = asked_rows(weighted, target)
    rows = rows / requests[:, None]
    goal = share * upper_bound(weighted, target).worst
    begin = drive.phases
    if np.abs(rows @ np.exp(1j * begin)).min() >= goal:
        return drive
    attained = np.angle(weighted_gerchberg_saxton(weighted, target).amplitudes)
    reached = float(np.abs(rows @ np.exp(1j * attained)).min())
    # Phase changes alone may not be able to reach the goal.
    goal = min(goal, 0.999 * reached)
    turned = attained - np.angle(np.sum(np.exp(1j * (attained - begin))))
    found = [_nearest(rows, goal, begin, start) for start in (begin, turned)]
    served = [
        phases for phases in found if np.abs(rows @ np.exp(1j * phases)).min() >= 0.999 * goal
    ]
    phases = min(served or [turned], key=lambda phases: _move(phases, begin)[0])
    return Drive(drive.magnitudes * np.exp(1j * phases))


def _move(phases: Phases, begin: Phases) -> tuple[float, Phases]:
    """Return 1 − |mean of e^{i change}|, which ignores a common phase, and its gradient."""
    moved = np.exp(1j * (phases - begin))
    mean = moved.mean()
    gradient = np.imag(np.conj(mean) * moved) / (max(abs(mean), 1e-12) * len(phases))
    return 1.0 - abs(mean), gradient


def _nearest(rows: np.ndarray, goal: float, begin: Phases, start: Phases) -> Phases:
    from scipy.optimize import minimize

    multipliers = np.zeros(len(rows))
    stiffness = 10.0
    phases = start

    def lagrangian(phases: Phases) -> tuple[float, Phases]:
        move, gradient = _move(phases, begin)
        waves = rows * np.exp(1j * phases) / goal
        sums = waves.sum(axis=1)
        levels = np.abs(sums)
        # Shortfall of each focus, with its multiplier
        force = np.maximum(multipliers + stiffness * (1.0 - levels), 0.0)
        units = np.conj(sums) / np.maximum(levels, 1e-12)
        gradient = gradient + force @ np.imag(units[:, None] * waves)
        return move + float(np.sum(force**2)) / (2.0 * stiffness), gradient

    for _ in range(8):
        phases = minimize(
            lagrangian, phases, jac=True, method="L-BFGS-B", options={"maxiter": 300}
        ).x
        levels = np.abs(rows @ np.exp(1j * phases)) / goal
        multipliers = np.maximum(multipliers + stiffness * (1.0 - levels), 0.0)
        if levels.min() > 0.9995:
            break
        stiffness *= 3.0
    return phases
