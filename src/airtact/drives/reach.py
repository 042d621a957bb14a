"""The pressure that a drive gives the foci over what they ask, its scale, and checks that a target can be served."""

import numpy as np
from jaxtyping import Complex, Complex128, Float64
from scipy.spatial import KDTree

from airtact.acoustics.target import Target
from airtact.checks import counted, in_mm, of_kind
from airtact.drives.constraint import AT_MOST_ONE, Constraint
from airtact.drives.transfer import Drive, TransferMatrix
from airtact.errors import InvalidInput

SAME_PLACE = 1e-6
"""Foci nearer than this to each other are the same [m]."""

NEAREST = 0.1
"""Foci nearer to each other than this cannot be separated [wavelengths]."""

ALIKE = 1.0 - 1e-4
"""Foci whose rows of the matrix correlate more than this cannot be separated, where no wavelength is known."""

SHADOWED = 0.05
"""A focus that can get less than this fraction of the median of the others is shadowed; 26 dB."""


def check_foci(transfer: TransferMatrix, target: Target) -> None:
    """Raise ``InvalidInput`` for a target whose points are not those of the transfer matrix.

    The rows of the matrix are the target's foci, or its foci and after them its suppression points.
    """
    of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
    of_kind(target, Target, "the target", "Target(points, pressures)")
    rows, count = len(transfer.matrix), len(target.points)
    if rows not in (count, count + len(target.suppression_points)):
        points = counted(len(target.suppression_points), "suppression point", "suppression points")
        raise InvalidInput(
            f"a transfer matrix for {counted(rows, 'focus', 'foci')} does not fit a target of {count}"
            f"{f' and {points}' if len(target.suppression_points) else ''}.",
            code="sizes_differ",
        )
    if transfer.foci is not None:
        points = np.concatenate([target.points, target.suppression_points])[:rows]
        apart = np.linalg.norm(points - transfer.foci, axis=1)
        if apart.max() > SAME_PLACE:
            raise InvalidInput(
                f"focus {int(apart.argmax())} of the target is {1e3 * apart.max():.3g} mm from where the transfer "
                "matrix has it; give the target whose beacons were solved, in the obstacles' frame.",
                code="sizes_differ",
            )


def foci_rows(transfer: TransferMatrix, target: Target) -> Complex128[np.ndarray, "foci elements"]:
    """Return the rows of the matrix at the foci, after ``check_foci``."""
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
    """Check that a drive can separate and reach the foci; methods that balance them would diverge otherwise.

    It raises ``InvalidInput`` as ``check_foci``; or where there are more foci than elements, two
    foci are nearer than λ/10 or, where the matrix does not know λ, have parallel rows, or a focus
    can get under ``SHADOWED`` of the others.
    """
    rows = foci_rows(transfer, target)
    if len(rows) > rows.shape[1]:
        raise InvalidInput(
            f"{len(rows)} foci are more than the {counted(rows.shape[1], 'element', 'elements')} of the array, which "
            "cannot serve them separately; ask for fewer.",
            code="too_many",
        )
    _check_near_foci(transfer, target, rows)
    asked = target.weights > 0.0
    attainable = np.abs(rows).sum(axis=1)[asked]
    shares = attainable / target.weights[asked]
    worst = int(shares.argmin())
    if shares[worst] >= SHADOWED * shares.max() or shares[worst] >= SHADOWED * np.median(
        np.delete(shares, worst)
    ):
        return
    index, others = (
        int(np.flatnonzero(asked)[worst]),
        float(np.median(np.delete(attainable, worst))),
    )
    raise InvalidInput(
        f"focus {index} at {in_mm(target.points[index])} is shadowed: it can get {attainable[worst]:.3g} Pa at most, "
        f"the rest {others:.3g} Pa in the median; move it, leave it out or ask for less there.",
        target.points[index],
        code="foci_unreachable",
    )


def nearest_foci(points: Float64[np.ndarray, "foci 3"]) -> tuple[int, int, float]:
    """Return the two of at least two foci that are nearest to each other, and their distance [m]."""
    distances, others = map(np.asarray, KDTree(points).query(points, k=2))
    one = int(distances[:, 1].argmin())
    other = int(next(index for index in others[one] if index != one))
    return min(one, other), max(one, other), float(distances[one, 1])


def _check_near_foci(
    transfer: TransferMatrix, target: Target, rows: Complex128[np.ndarray, "foci elements"]
) -> None:
    count = len(target.points)
    apart = np.linalg.norm(target.points[:, None] - target.points, axis=2)
    if transfer.wavelength is None:
        norms = np.maximum(np.linalg.norm(rows, axis=1), np.finfo(float).tiny)
        near = np.abs(rows @ rows.conj().T) > ALIKE * norms[:, None] * norms
    else:
        near = apart < NEAREST * transfer.wavelength
    near.flat[:: count + 1] = False
    if near.any():
        one, other = divmod(int(np.argmin(np.where(near, apart, np.inf))), count)
        raise InvalidInput(
            f"foci {one} and {other} are {1e3 * apart[one, other]:.3g} mm apart, at {in_mm(target.points[one])} and "
            f"{in_mm(target.points[other])}, too near to be separated: leave one out, or move them a tenth of the "
            "wavelength apart or more.",
            target.points[one],
            code="foci_unreachable",
        )


def suppression_rows(
    transfer: TransferMatrix, target: Target
) -> Complex128[np.ndarray, "suppressed elements"]:
    """Return the rows of the matrix at the suppression points, after ``check_foci``; raise where it has none."""
    check_foci(transfer, target)
    if len(transfer.matrix) == len(target.points) and len(target.suppression_points):
        raise InvalidInput(
            f"the target has {counted(len(target.suppression_points), 'suppression point', 'suppression points')}, but "
            "the transfer matrix has no rows for them; solve for target.beacons(suppression=True).",
            code="data_missing",
        )
    return transfer.matrix[len(target.points) :]


def achieved_fraction(
    transfer: TransferMatrix, target: Target, drive: Drive
) -> Float64[np.ndarray, "foci"]:
    """Pressure that each focus gets over the pressure that it asked for, |H d|_f / p_f.

    The smallest fraction is 1 where the drive reaches the target, and less where full scale was not
    enough.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix that the drive was made from; ``airtact.evaluate``
        verifies by another solver.
    target : the foci and the pressures asked there.
    drive : of the E elements.

    Returns
    -------
    (F,) fractions, NaN where a focus asks for nothing or 0 Pa.

    Raises
    ------
    InvalidInput
        If the foci or the elements do not match in number.
    """
    check_foci(transfer, target)
    return fraction(np.abs(transfer.pressure(drive))[: len(target.points)], target)


def fraction(
    magnitudes: Float64[np.ndarray, "foci"], target: Target
) -> Float64[np.ndarray, "foci"]:
    """(F,) peak pressures [Pa] over the pressures that the target asks, NaN where nothing or 0 Pa was asked."""
    fractions = np.full(len(target.points), np.nan)
    if target.pressures is not None:
        asked = target.pressures > 0.0
        fractions[asked] = magnitudes[asked] / target.pressures[asked]
    return fractions


def scaled_to_target(
    transfer: TransferMatrix,
    target: Target,
    amplitudes: Complex[np.ndarray, "elements"],
    constraint: Constraint = AT_MOST_ONE,
) -> Drive:
    """Scale amplitudes so that the smallest ``achieved_fraction`` is 1, and round them to the constraint's levels.

    If that takes more than full scale, or nothing is asked, the largest amplitude is 1. It raises
    ``InvalidInput`` if every amplitude is 0.
    """
    largest = np.abs(amplitudes).max()
    if not largest > 0.0:
        raise InvalidInput(
            f"all {len(amplitudes)} amplitudes are 0: foci that cancel at every element leave no drive.",
            code="all_zero",
        )
    full = Drive(amplitudes / largest)
    if target.pressures is None:
        return Drive(constraint.nearest(full.amplitudes))
    worst = np.nanmin(achieved_fraction(transfer, target, full))
    return Drive(constraint.nearest(full.amplitudes / max(worst, 1.0)))
