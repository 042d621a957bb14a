"""Rows of a transfer matrix for a target's foci, and the pressures of a drive there."""

import numpy as np
from jaxtyping import Complex, Complex128, Float64
from scipy.spatial import KDTree

from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.transfer import TransferMatrix
from airtact.errors import InvalidInput, counted, in_mm, millimetres, of_kind

FociRows = Complex128[np.ndarray, "foci elements"]
"""Rows of a transfer matrix at foci, often divided by the request of each focus."""

MIN_FOCUS_DISTANCE = 0.1
"""Smallest distance between two foci that can be separated [wavelengths]."""


def check_foci(transfer: TransferMatrix, target: Target) -> None:
    """Raise ``InvalidInput`` if the target and the transfer matrix have different points.

    The rows of the matrix are the target's foci, or its foci followed by its suppression points.
    """
    of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
    of_kind(target, Target, "the target", "Target(points, pressures)")
    rows = len(transfer.matrix)
    foci = len(target.points)
    suppressed = len(target.suppression_points)
    if rows not in (foci, foci + suppressed):
        points = counted(suppressed, "suppression point", "suppression points")
        raise InvalidInput(
            f"a transfer matrix for {counted(rows, 'focus', 'foci')} does not fit a target of "
            f"{foci}{f' and {points}' if suppressed else ''}.",
            code="sizes_differ",
        )
    if transfer.foci is not None:
        points = np.concatenate([target.points, target.suppression_points])[:rows]
        apart = np.linalg.norm(points - transfer.foci, axis=1)
        if apart.max() > 1e-6:  # metres
            raise InvalidInput(
                f"focus {int(apart.argmax())} of the target is {millimetres(apart.max(), 3)} from "
                "the corresponding focus of the matrix. Use the target for which the matrix was "
                "computed, in the obstacles' frame.",
                code="sizes_differ",
            )


def foci_rows(transfer: TransferMatrix, target: Target) -> FociRows:
    """Return the rows of the matrix at the foci, after checking them with ``check_foci``."""
    check_foci(transfer, target)
    return transfer.matrix[: len(target.points)]


def asked_rows(
    transfer: TransferMatrix, target: Target
) -> tuple[FociRows, Float64[np.ndarray, "foci"]]:
    """Return the matrix rows of foci with a requested pressure or share, and these requests."""
    rows = check_solvable(transfer, target)
    asked = target.weights > 0.0
    # If all foci have a request, nothing is copied.
    return (rows, target.weights) if asked.all() else (rows[asked], target.weights[asked])


def check_solvable(transfer: TransferMatrix, target: Target) -> FociRows:
    """Return the rows at the foci, after checking that a drive can separate and reach all foci.

    Without this check, methods that balance the foci might diverge. The function raises
    ``InvalidInput``:

    - under the conditions of ``check_foci``;
    - if there are more foci than elements;
    - if two foci are less than λ/10 apart or, for an unknown wavelength λ, their rows are parallel;
    - if the largest pressure that a focus can receive is less than 5 % (−26 dB) of the median for
      the other foci.
    """
    rows = foci_rows(transfer, target)
    if len(rows) > rows.shape[1]:
        raise InvalidInput(
            f"there are {len(rows)} foci, but the array has only {rows.shape[1]} elements. Use "
            "fewer foci.",
            code="too_many",
        )
    points = target.points
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    # Without a wavelength, two foci count as the same place if their rows are parallel to 1e-4.
    if transfer.wavelength is None:
        norms = np.maximum(np.linalg.norm(rows, axis=1), np.finfo(float).tiny)
        near = np.abs(rows @ rows.conj().T) > (1.0 - 1e-4) * norms[:, None] * norms
    else:
        near = apart < MIN_FOCUS_DISTANCE * transfer.wavelength
    np.fill_diagonal(near, False)
    if near.any():
        first, second = divmod(int(np.argmin(np.where(near, apart, np.inf))), len(points))
        raise InvalidInput(
            f"foci {first} and {second} are {millimetres(apart[first, second], 3)} apart, at "
            f"{in_mm(points[first])} and {in_mm(points[second])}, which is too close to separate "
            "them. Remove one, or move them at least a tenth of the wavelength apart.",
            points[first],
            code="foci_unreachable",
        )
    asked = np.flatnonzero(target.weights > 0.0)
    attainable = np.abs(rows).sum(axis=1)[asked]
    shares = attainable / target.weights[asked]
    worst = int(shares.argmin())
    # A shadowed focus gets little pressure, both in pascals and relative to its request. Both are
    # checked because a focus with a twenty times larger request may get as much as the others. The
    # comparison uses the median, so one strong focus does not make all others count as shadowed.
    if len(asked) > 1 and all(
        values[worst] < 0.05 * np.median(np.delete(values, worst))
        for values in (attainable, shares)
    ):
        point = target.points[asked[worst]]
        rest = np.median(np.delete(attainable, worst))
        raise InvalidInput(
            f"focus {asked[worst]} at {in_mm(point)} is shadowed: the pressure there can reach at "
            f"most {attainable[worst]:.3g} Pa, while the median for the other foci is {rest:.3g} "
            "Pa. Move it, remove it or request less pressure there.",
            point,
            code="foci_unreachable",
        )
    return rows


def nearest_foci(points: Float64[np.ndarray, "foci 3"]) -> tuple[int, int, float]:
    """Return the indices of the two closest foci, and their distance [m]."""
    distances, neighbours = map(np.asarray, KDTree(points).query(points, k=2))
    first = int(distances[:, 1].argmin())
    # For two foci at the same place the query may list the second before the first.
    second = int(next(index for index in neighbours[first] if index != first))
    return min(first, second), max(first, second), float(distances[first, 1])


def suppression_rows(
    transfer: TransferMatrix, target: Target
) -> Complex128[np.ndarray, "suppressed elements"]:
    """Return the rows at the suppression points, after checking that the matrix contains them."""
    check_foci(transfer, target)
    suppressed = len(target.suppression_points)
    if len(transfer.matrix) == len(target.points) and suppressed:
        raise InvalidInput(
            f"the target has {counted(suppressed, 'suppression point', 'suppression points')}, but "
            "the transfer matrix has no rows for them; solve for "
            "target.beacons(suppression=True).",
            code="data_missing",
        )
    return transfer.matrix[len(target.points) :]


def achieved_fraction(
    transfer: TransferMatrix, target: Target, drive: Drive
) -> Float64[np.ndarray, "foci"]:
    """Return the ratio of the pressure at each focus to the requested one, |H d|_f / p_f.

    The smallest ratio is 1 if the drive reaches the target, and below 1 if full scale is not
    enough.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix from which the drive was computed. To verify the drive
        with another solver, use ``airtact.evaluate``.
    target : the foci and their requested pressures.
    drive : the drive of the E elements.

    Returns
    -------
    (F,) ratios, NaN for foci whose request is 0 Pa or missing.

    Raises
    ------
    InvalidInput
        If the number of foci or of elements does not match.
    """
    check_foci(transfer, target)
    return fraction(np.abs(transfer.pressure(drive))[: len(target.points)], target)


def fraction(
    magnitudes: Float64[np.ndarray, "foci"], target: Target
) -> Float64[np.ndarray, "foci"]:
    """Return the ratio (F,) of peak pressure to requested pressure; NaN where none is requested."""
    fractions = np.full(len(target.points), np.nan)
    if target.pressures is not None:
        asked = target.pressures > 0.0
        fractions[asked] = magnitudes[asked] / target.pressures[asked]
    return fractions


def scaled_to_target(
    transfer: TransferMatrix, target: Target, amplitudes: Complex[np.ndarray, "elements"]
) -> Drive:
    """Scale amplitudes so that the smallest ``achieved_fraction`` is 1.

    If the target requires more than full scale or requests no pressures, the largest amplitude is
    1. The function raises ``InvalidInput`` if every amplitude is 0.
    """
    largest = np.abs(amplitudes).max()
    if not largest > 0.0:
        raise InvalidInput(
            "the contributions of the foci cancel at every element, so all amplitudes are 0. "
            "Request other phases or move a focus.",
            code="all_zero",
        )
    # The fraction at full scale determines whether the drive must be scaled down.
    full = Drive(amplitudes / largest)
    if target.pressures is None:
        return full
    worst = np.nanmin(achieved_fraction(transfer, target, full))
    return Drive(full.amplitudes / max(worst, 1.0))
