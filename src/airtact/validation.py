"""Sentences for bad input that every constructor of a scene says the same way."""

from types import UnionType
from typing import TypeVar

import numpy as np
from jaxtyping import Complex128, Float64, Num, Real

from airtact.conventions import InvalidInput

Given = TypeVar("Given")


def counted(number: int, one: str, many: str) -> str:
    """Say how many, in the singular for one.

    Parameters
    ----------
    number : how many.
    one, many : what follows the number, for one and for others.

    Examples
    --------
    >>> counted(1, "edge is", "edges are"), counted(3, "edge is", "edges are")
    ('1 edge is', '3 edges are')
    """
    return f"{number} {one if number == 1 else many}"


def of_kind(value: Given, kind: type | UnionType, what: str, instead: str) -> Given:
    """Return an object, or refuse it where it is of the wrong kind, before it fails somewhere inside.

    Parameters
    ----------
    value : what the caller gave.
    kind : what it must be.
    what : its name, for the sentence.
    instead : what to give, for the sentence.

    Raises
    ------
    InvalidInput
        Saying what was given and what to give.
    """
    if not isinstance(value, kind):
        given = f"the class {value.__name__}" if isinstance(value, type) else _kind_of(value)
        name = kind.__name__ if isinstance(kind, type) else str(kind)
        wanted = f"{_article(name)} {name}"
        raise InvalidInput(f"{what} is {given}, but it must be {wanted}: give {instead}.")
    return value


def _kind_of(value: object) -> str:
    if isinstance(value, bool | int | float | complex | str):
        return f"{value!r}"
    shape = f" of shape {value.shape}" if isinstance(value, np.ndarray) else ""
    size = f" of length {len(value)}" if isinstance(value, list | tuple | dict) else ""
    name = "array" if isinstance(value, np.ndarray) else type(value).__name__
    return f"{_article(name)} {name}{shape}{size}"


def _article(name: str) -> str:
    return "an" if name[0] in "AEIOUaeiou" else "a"


def number(value: float, what: str, unit: str) -> float:
    """Return a real number as a float, or refuse what is none; NaN and infinity pass.

    Parameters
    ----------
    value : the number.
    what, unit : its name and unit, for the sentence.

    Raises
    ------
    InvalidInput
        When it is a string, an array, a complex number or nothing.
    """
    given = np.asarray(value if np.isscalar(value) or isinstance(value, np.ndarray) else None)
    if given.ndim != 0 or given.dtype.kind not in "iuf":
        raise InvalidInput(f"{what} is {_kind_of(value)}, but it must be one real number, in {unit}.")
    return float(given)


def positive(value: float, what: str, unit: str) -> float:
    """Return a number as a float, or refuse it.

    Parameters
    ----------
    value : the number.
    what, unit : its name and unit, for the sentence.

    Raises
    ------
    InvalidInput
        When the value is no number, not finite or not above zero.

    Examples
    --------
    >>> positive(40e3, "frequency", "Hz")
    40000.0
    """
    given = number(value, what, unit)
    if not np.isfinite(given) or given <= 0.0:
        raise InvalidInput(f"{what} is {given:g} {unit}, but it must be a finite number above zero.")
    return given


def within(value: float, low: float, high: float, what: str, unit: str, slip: str) -> float:
    """Return a number as a float, or refuse one so small or large that its unit must be wrong.

    Parameters
    ----------
    value : the number.
    low, high : what it may be at least and at most.
    what, unit : its name and unit, for the sentence.
    slip : the question to ask, such as "is it in kHz?".

    Raises
    ------
    InvalidInput
        When it is no number, not finite, not above zero or outside the range.

    Examples
    --------
    >>> within(40, 1e3, 1e6, "frequency", "Hz", "is it in kHz?")
    Traceback (most recent call last):
    ...
    airtact.conventions.InvalidInput: frequency is 40 Hz, but it must lie between 1000 and 1e+06 Hz: is it in kHz?
    """
    given = positive(value, what, unit)
    if not low <= given <= high:
        raise InvalidInput(f"{what} is {given:g} {unit}, but it must lie between {low:g} and {high:g} {unit}: {slip}")
    return given


LOWEST, HIGHEST = 1e3, 1e6
"""The frequencies that sound in the air of a scene may have [Hz]."""


def check_frequency(frequency: float) -> float:
    """Return a frequency [Hz] as a float, or refuse it.

    Raises
    ------
    InvalidInput
        When it is no number or outside ``LOWEST`` to ``HIGHEST``, asking whether it is in kHz.
    """
    return within(frequency, LOWEST, HIGHEST, "frequency", "Hz", "is it in kHz? Give hertz.")


def fixed(array: Real[np.ndarray, "..."]) -> Float64[np.ndarray, "..."]:
    """Copy an array to float64 that nobody can write to, so that what was checked stays true.

    Parameters
    ----------
    array : any shape.
    """
    copy = np.array(array, dtype=np.float64, order="C")
    copy.flags.writeable = False
    return copy


def points_of(array: Real[np.ndarray, "..."], what: str, least: int = 1) -> Float64[np.ndarray, "points 3"]:
    """Return points (P, 3) as read-only float64, or refuse them.

    Parameters
    ----------
    array : what the caller gave; one point (3,) is not taken for a list of points.
    what : name of the points, for the sentence.
    least : 1, or 0 where an empty list (0, 3) makes sense.

    Raises
    ------
    InvalidInput
        When they are no real numbers, the shape is not (P, 3), P is below ``least``, or a coordinate is NaN or
        infinite.
    """
    points = real_numbers(array, what)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InvalidInput(f"{what} have shape {points.shape}, but points are an array of shape (number of points, 3).")
    if len(points) < least:
        raise InvalidInput(f"{what} are empty (0 points); give at least one.")
    check_finite(points, what)
    return points


def real_numbers(array: Real[np.ndarray, "..."], what: str) -> Float64[np.ndarray, "..."]:
    """Return numbers of any shape as read-only float64, or refuse what is no array of real numbers.

    Parameters
    ----------
    array : what the caller gave: an array, or nested lists of numbers.
    what : name of the numbers, for the sentence.

    Raises
    ------
    InvalidInput
        When it holds rows of different lengths, complex numbers, text or other things.
    """
    try:
        given = np.asarray(array)
    except ValueError:
        raise InvalidInput(f"{what} are {_kind_of(array)} whose rows differ in length; give an array.") from None
    if given.dtype.kind not in "iuf" and given.size:
        raise InvalidInput(
            f"{what} are {_kind_of(array)} of type {given.dtype} and shape {given.shape}; give real numbers."
        )
    return fixed(given)


def complex_numbers(array: Num[np.ndarray, "..."], what: str) -> Complex128[np.ndarray, "..."]:
    """Return numbers of any shape as a complex128 copy, or refuse what is no array of numbers.

    Parameters
    ----------
    array : what the caller gave: an array, or nested lists of numbers.
    what : name of the numbers, for the sentence.

    Raises
    ------
    InvalidInput
        When it holds rows of different lengths, text or other things.
    """
    try:
        return np.array(array, dtype=np.complex128)
    except (TypeError, ValueError):
        raise InvalidInput(f"{what} are {_kind_of(array)}, but they must be an array of numbers.") from None


def check_finite(array: np.ndarray, what: str) -> None:
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
    finite = np.isfinite(array)
    if not finite.all():
        bad = np.argwhere(~finite)
        where = [int(i) for i in bad[0]]
        values = counted(len(bad), "NaN or infinite value", "NaN or infinite values")
        raise InvalidInput(f"{what} hold {values}, the first at index {where}.")


def in_mm(point: Real[np.ndarray, "3"]) -> str:
    """Say a point in millimetres.

    Parameters
    ----------
    point : (3,) [m].

    Examples
    --------
    >>> in_mm(np.array([0.001, -0.02, 0.3]))
    '(1.00, -20.00, 300.00) mm'
    """
    x, y, z = 1e3 * np.asarray(point, dtype=np.float64)
    return f"({x:.2f}, {y:.2f}, {z:.2f}) mm"
