"""How much of what a target asks a drive gives, and the scale that gives it."""

import numpy as np
from jaxtyping import Complex, Complex128, Float64

from airtact.conventions import InvalidInput
from airtact.scene.target import Target
from airtact.synthesis.constraint import AT_MOST_ONE, Constraint
from airtact.transfer import Drive, TransferMatrix
from airtact.validation import counted, in_mm, of_kind

SAME_PLACE = 1e-6
"""Foci nearer than this to each other are the same [m]."""

NEAREST = 0.1
"""Foci nearer than this cannot be told apart [wavelengths]."""

ALIKE = 1.0 - 1e-4
"""Foci whose rows of the matrix are parallel to this are heard alike, which counts where no wavelength is known."""

SHADOWED = 0.05
"""A focus that can get less than this of what the others can in the median is in a shadow; 26 dB."""


def check_foci(transfer: TransferMatrix, target: Target) -> None:
    """Refuse a target whose points are not those of the transfer matrix (``InvalidInput``: how many, how far off).

    The rows of the matrix are the target's foci, or its foci and after them its suppression points.
    """
    of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
    of_kind(target, Target, "the target", "Target(points, pressures)")
    rows, count = len(transfer.matrix), len(target.points)
    if rows not in (count, count + len(target.suppression_points)):
        quiet = (
            f" and {counted(len(target.suppression_points), 'suppression point', 'suppression points')}"
            if len(target.suppression_points)
            else ""
        )
        raise InvalidInput(
            f"a transfer matrix for {counted(rows, 'focus', 'foci')} does not fit a target of {count}{quiet}."
        )
    if transfer.foci is not None:
        points = np.concatenate([target.points, target.suppression_points])[:rows]
        apart = np.linalg.norm(points - transfer.foci, axis=1)
        if apart.max() > SAME_PLACE:
            raise InvalidInput(
                f"focus {int(apart.argmax())} of the target is {1e3 * apart.max():.3g} mm from where the transfer "
                "matrix has it; give the target whose beacons were solved, in the obstacles' frame."
            )


def foci_rows(transfer: TransferMatrix, target: Target) -> Complex128[np.ndarray, "foci elements"]:
    """Return the rows of the matrix that hear the foci, after ``check_foci``."""
    check_foci(transfer, target)
    return transfer.matrix[: len(target.points)]


def asked_rows(
    transfer: TransferMatrix, target: Target
) -> tuple[Complex128[np.ndarray, "asked elements"], Float64[np.ndarray, "asked"]]:
    """Return the rows of the foci that ask for something, and what they ask, after ``check_solvable``."""
    check_solvable(transfer, target)
    rows, wanted = foci_rows(transfer, target), target.weights
    asked = wanted > 0.0
    return (rows, wanted) if asked.all() else (rows[asked], wanted[asked])


def check_solvable(transfer: TransferMatrix, target: Target) -> None:
    """Refuse foci that a drive cannot tell apart or reach, which methods that balance foci would do anything for.

    Raises
    ------
    InvalidInput
        As ``check_foci``; or there are more foci than elements (both numbers), two foci are nearer than λ/10 (which,
        how near) or, where the matrix does not know λ, heard alike by every element, or what a focus can get at most,
        over what it asks, is under ``SHADOWED`` of that of the rest (both pressures).
    """
    rows = foci_rows(transfer, target)
    if len(rows) > rows.shape[1]:
        raise InvalidInput(
            f"{len(rows)} foci are more than the {counted(rows.shape[1], 'element', 'elements')} of the array, which "
            "cannot serve them separately; ask for fewer."
        )
    _check_near_foci(transfer, target)
    asked = target.weights > 0.0
    attainable = np.abs(rows).sum(axis=1)[asked]
    shares = attainable / target.weights[asked]
    worst = int(shares.argmin())
    if shares[worst] >= SHADOWED * shares.max() or shares[worst] >= SHADOWED * np.median(np.delete(shares, worst)):
        return
    index, others = int(np.flatnonzero(asked)[worst]), float(np.median(np.delete(attainable, worst)))
    raise InvalidInput(
        f"focus {index} at {in_mm(target.points[index])} is shadowed: it can get {attainable[worst]:.3g} Pa at most, "
        f"the rest {others:.3g} Pa in the median; move it, leave it out or ask for less there.",
        target.points[index],
    )


def _check_near_foci(transfer: TransferMatrix, target: Target) -> None:
    count = len(target.points)
    apart = np.linalg.norm(target.points[:, None] - target.points, axis=2)
    if transfer.wavelength is None:
        rows = foci_rows(transfer, target)
        loudness = np.maximum(np.linalg.norm(rows, axis=1), np.finfo(float).tiny)
        near = np.abs(rows @ rows.conj().T) > ALIKE * loudness[:, None] * loudness
    else:
        near = apart < NEAREST * transfer.wavelength
    near.flat[:: count + 1] = False
    if near.any():
        one, other = divmod(int(np.argmin(np.where(near, apart, np.inf))), count)
        raise InvalidInput(
            f"foci {one} and {other} are {1e3 * apart[one, other]:.3g} mm apart, at {in_mm(target.points[one])} and "
            f"{in_mm(target.points[other])}, too near to be told apart: leave one out, or move them a tenth of the "
            "wavelength apart or more.",
            target.points[one],
        )


def suppression_rows(transfer: TransferMatrix, target: Target) -> Complex128[np.ndarray, "suppressed elements"]:
    """Return the rows of the matrix that hear the suppression points.

    Raises
    ------
    InvalidInput
        As ``check_foci``, or the target has suppression points (how many) that the matrix does not hear.
    """
    check_foci(transfer, target)
    if len(transfer.matrix) == len(target.points) and len(target.suppression_points):
        raise InvalidInput(
            f"the target keeps {counted(len(target.suppression_points), 'point', 'points')} quiet, but the transfer "
            "matrix has no rows for them; solve for target.beacons(suppression=True)."
        )
    return transfer.matrix[len(target.points) :]


def achieved_fraction(transfer: TransferMatrix, target: Target, drive: Drive) -> Float64[np.ndarray, "foci"]:
    """Pressure that each focus gets over the pressure that it asked for.

    This is how a method says that full scale was not enough: the smallest share is 1 where the target was reached and
    less where it was not.

    Parameters
    ----------
    transfer : the transfer matrix.
    target : the foci and what they ask.
    drive : the drive to judge, by the same matrix that it was made from; ``airtact.evaluate`` judges by another solver.

    Returns
    -------
    (F,) |H d| over the pressure asked, NaN where nothing or 0 Pa was asked.

    Raises
    ------
    InvalidInput
        If foci or elements do not match in number.
    """
    check_foci(transfer, target)
    return share(np.abs(transfer.pressure(drive))[: len(target.points)], target)


def share(magnitudes: Float64[np.ndarray, "foci"], target: Target) -> Float64[np.ndarray, "foci"]:
    """(F,) peak pressures [Pa] over the pressures that the target asks, NaN where nothing or 0 Pa was asked."""
    shares = np.full(len(target.points), np.nan)
    if target.pressures is not None:
        asked = target.pressures > 0.0
        shares[asked] = magnitudes[asked] / target.pressures[asked]
    return shares


def scaled_to_target(
    transfer: TransferMatrix,
    target: Target,
    amplitudes: Complex[np.ndarray, "elements"],
    constraint: Constraint = AT_MOST_ONE,
) -> Drive:
    """Scale amplitudes so that the worst focus gets what it asked, or all that full scale allows.

    Parameters
    ----------
    transfer : the transfer matrix.
    target : the foci and what they ask.
    amplitudes : (E,) complex amplitudes of any size.
    constraint : what an element can play; anything to full scale by default.

    Returns
    -------
    The amplitudes times one positive number: that with which the smallest share of ``achieved_fraction`` is 1, or if
    that takes more than full scale or nothing is asked, the one with which the loudest element is 1; then rounded to
    what the constraint has, which with phases only is full scale.

    Raises
    ------
    InvalidInput
        If every amplitude is 0.
    """
    loudest = np.abs(amplitudes).max()
    if not loudest > 0.0:
        raise InvalidInput(f"all {len(amplitudes)} amplitudes are 0: foci that cancel at every element leave no drive.")
    full = Drive(amplitudes / loudest)
    if target.pressures is None:
        return Drive(constraint.nearest(full.amplitudes))
    worst = np.nanmin(achieved_fraction(transfer, target, full))
    return Drive(constraint.nearest(full.amplitudes / max(worst, 1.0)))
