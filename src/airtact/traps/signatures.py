"""Signatures, which convert the drive for a focus into the drive for a trap at the same point.

Source: A. Marzo, S. A. Seah, B. W. Drinkwater, D. R. Sahoo, B. Long, S. Subramanian,
"Holographic acoustic elements for manipulation of levitated objects", Nat. Commun. 6,
8661 (2015).
"""

from typing import Literal

import numpy as np

from airtact.drives.drive import Drive, check_drive
from airtact.errors import InvalidInput, Vector, check_choice, counted, of_kind, point_of
from airtact.transducers.layout import PhasedArray


def signature(
    array: PhasedArray,
    drive: Drive,
    kind: Literal["twin", "vortex", "bottle"] = "twin",
    axis: Vector = (0, 1, 0),
) -> Drive:
    """Add the signature of a trap to the drive for a focus, so that the pressure there is zero.

    A signature only shifts phases. It depends on the positions of the elements relative to the mean
    position of the array.

    Parameters
    ----------
    array : the transducers.
    drive : drive that creates a focus at the position of the trap.
    kind : "twin" shifts the elements in the half of the array toward which ``axis`` points by π.
        "vortex" adds to each phase the angle of the element around the array's front direction.
        "bottle" shifts the elements within a radius of that direction by π; the radius is chosen so
        that they have about half of the total amplitude.
    axis : (3,) axis of the trap, a vector of any length above zero. If the array has no front
        direction, because its elements face each other, vortices and bottles are built around
        ``axis``.

    Returns
    -------
    A drive with the same amplitudes and shifted phases.

    Raises
    ------
    InvalidInput
        If the drive does not have as many elements as the array, if the kind is unknown, if the
        axis is zero, or if all elements lie on one side.

    Examples
    --------
    >>> places = np.array([[0, -0.1, 0], [0, 0.1, 0]])
    >>> pair = PhasedArray(places, np.array([[0, 1, 0], [0, -1, 0]]))
    >>> signature(pair, Drive(np.array([1, 1 + 0j]))).amplitudes.real.tolist()
    [1.0, -1.0]
    """
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    check_drive(drive, "the drive")
    if len(drive) != len(array):
        raise InvalidInput(
            f"the drive is for {counted(len(drive), 'element', 'elements')}, but the array has "
            f"{len(array)}. Use the array for which the drive was computed.",
            code="sizes_differ",
        )
    check_choice(kind, "the kind of trap", ("twin", "vortex", "bottle"))
    axis = point_of(axis, "the axis of a trap")
    if not np.linalg.norm(axis) > 0.0:
        raise InvalidInput(
            "the axis of a trap has length 0; use a nonzero vector.", code="all_zero"
        )
    axis = axis / np.linalg.norm(axis)
    offsets = array.positions - array.positions.mean(axis=0)

    if kind == "twin":
        height = offsets @ axis
        # Along its normal, positions of a flat board differ only by rounding.
        if np.ptp(height) < 1e-6:
            raise InvalidInput(
                "the axis of a twin trap is perpendicular to the array, so it does not divide the "
                "elements. Choose an axis in the plane of the array.",
                code="misplaced",
            )
        return Drive(drive.amplitudes * np.where(height > 0.0, -1.0, 1.0))

    # The mean of the normals is close to 0 if elements face each other, and 0.5 for a hemispherical
    # bowl.
    front = array.normals.mean(axis=0)
    if np.linalg.norm(front) < 0.3:
        front = axis
    front = front / np.linalg.norm(front)
    across = offsets - (offsets @ front)[:, None] * front
    distance = np.linalg.norm(across, axis=1)
    if distance.max() < 1e-6:
        raise InvalidInput(
            f"all elements lie on the axis of the {kind} trap. Use another axis.",
            code="misplaced",
        )
    if kind == "vortex":
        # The angle can start in any direction perpendicular to the front direction.
        start = np.cross(front, np.eye(3)[np.abs(front).argmin()])
        start = start / np.linalg.norm(start)
        angle = np.arctan2(across @ np.cross(front, start), across @ start)
        return Drive(drive.amplitudes * np.exp(1j * angle))
    # Find the element at whose radius the amplitude is divided most evenly. Elements at equal
    # distances, apart from rounding, stay together.
    inside = distance <= distance[:, None] + 1e-6
    halves = np.abs(inside @ drive.magnitudes - 0.5 * drive.magnitudes.sum())
    return Drive(drive.amplitudes * np.where(inside[halves.argmin()], -1.0, 1.0))
