"""Sentences for bad input that every constructor of a scene says the same way."""

import numpy as np
from jaxtyping import Float64, Real

from airtact.conventions import InvalidInput


def positive(value: float, what: str, unit: str) -> float:
    """Return a number as a float, or refuse it.

    Parameters
    ----------
    value : the number.
    what, unit : its name and unit, for the sentence.

    Raises
    ------
    InvalidInput
        When the value is not finite or not above zero.

    Examples
    --------
    >>> positive(40e3, "frequency", "Hz")
    40000.0
    """
    number = float(value)
    if not np.isfinite(number) or number <= 0.0:
        raise InvalidInput(f"{what} is {number:g} {unit}, but it must be a finite number above zero.")
    return number


def fixed(array: Real[np.ndarray, "..."]) -> Float64[np.ndarray, "..."]:
    """Copy an array to float64 that nobody can write to, so that what was checked stays true.

    Parameters
    ----------
    array : any shape.
    """
    copy = np.array(array, dtype=np.float64, order="C")
    copy.flags.writeable = False
    return copy


def points_of(array: Real[np.ndarray, "..."], what: str) -> Float64[np.ndarray, "points 3"]:
    """Return points (P, 3) as read-only float64, or refuse them.

    Parameters
    ----------
    array : what the caller gave; one point (3,) is not taken for a list of points.
    what : name of the points, for the sentence.

    Raises
    ------
    InvalidInput
        When the shape is not (P, 3), P is 0, or a coordinate is NaN or infinite.
    """
    points = fixed(array)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InvalidInput(f"{what} have shape {points.shape}, but points are an array of shape (number of points, 3).")
    if len(points) == 0:
        raise InvalidInput(f"{what} are empty (0 points); give at least one.")
    refuse_not_finite(points, what)
    return points


def refuse_not_finite(array: np.ndarray, what: str) -> None:
    """Refuse NaN and infinity.

    Parameters
    ----------
    array : any shape, real or complex.
    what : name of the values, for the sentence.

    Raises
    ------
    InvalidInput
        Saying how many values are not finite and where the first is.
    """
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        where = [int(i) for i in bad[0]]
        raise InvalidInput(f"{what} hold {len(bad)} NaN or infinite values, the first at index {where}.")


def place(point: Real[np.ndarray, "3"]) -> str:
    """Say a point in millimetres.

    Parameters
    ----------
    point : (3,) [m].

    Examples
    --------
    >>> place(np.array([0.001, -0.02, 0.3]))
    '(1.00, -20.00, 300.00) mm'
    """
    x, y, z = 1e3 * np.asarray(point, dtype=np.float64)
    return f"({x:.2f}, {y:.2f}, {z:.2f}) mm"
