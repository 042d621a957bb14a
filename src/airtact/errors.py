"""Conventions of all packages: error types, input checks, and text for messages and reprs.

- Phasor p(t) = Re[P e^{-iωt}]; an outgoing wave is e^{+ikr}/r.
- SI units: metre, hertz, pascal, radian. Amplitudes are peak values unless a name ends in ``_rms``.
- Points are (N, 3) float64. Rows of matrices are receivers, and columns are sources.
- A monopole of strength s [Pa·m] in open air gives p = s e^{ikr}/r.

In checks, ``what`` is the name of the value in the message, and ``unit`` is its unit.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Complex128, Float64, Num, Real

Value = TypeVar("Value")

# A point or direction: an array or a tuple of three numbers
Vector = Real[np.ndarray, "3"] | tuple[float | int, float | int, float | int]

# Likely cause of a length that is too large
NOT_METRES = "is it in millimetres? Use metres."

# Largest length of a message [characters]; with its code and prefix, a line has up to 500
LONGEST_SENTENCE = 450

# Largest size of a scene file [bytes]
LARGEST_SCENE_FILE = 4_000_000

# Largest magnitude of a number in a scene file or table
LARGEST_NUMBER = 1e12

# Smallest magnitude of a number in a scene file other than 0
SMALLEST_NUMBER = 1e-60

# Largest number of points of a shape, and by default of foci and suppression points in a scene
MOST_POINTS = 4096

# Largest size of the file of a surface together with the files named in it [bytes]
LARGEST_MESH_FILE = 100_000_000

# Largest size of a file of numbers, and of its unpacked arrays [bytes]
LARGEST_DATA = 2**28


def one_sentence(text: str) -> str:
    r"""Format a message as one line of at most ``LONGEST_SENTENCE`` printable characters.

    Examples
    --------
    >>> one_sentence("two\nlines"), len(one_sentence("x" * 100_000))
    ('two\\nlines', 450)
    """
    escaped = "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode()
        for character in _shortened(text)
    )
    return _shortened(escaped)


def _shortened(text: str) -> str:
    """Omit the middle of a text that is too long."""
    if len(text) <= LONGEST_SENTENCE:
        return text
    head = 2 * LONGEST_SENTENCE // 3
    tail = LONGEST_SENTENCE - head - 5
    return f"{text[:head]} ... {text[-tail:]}"


class InvalidInput(ValueError):  # noqa: N818 (reads well in a traceback)
    """Error raised for invalid input. The message states what is wrong, where, and what to do.

    It is a ``ValueError`` with two additional attributes.

    Attributes
    ----------
    position : (3,) position of the error [m], in the frame of the argument at fault; None if the
        error has no position.
    code : kind of error, such as "inside_body". It does not change if the message is reworded;
        ``docs/errors.md`` lists all codes.
    """

    def __init__(
        self, sentence: str, position: Real[np.ndarray, "3"] | None = None, *, code: str
    ) -> None:
        super().__init__(one_sentence(sentence))
        self.position = position
        self.code = code

    def __reduce__(self) -> Any:
        """Include the keyword ``code``, so that the error can be passed between processes."""
        return partial(type(self), code=self.code), (str(self), self.position)


class NotConverged(RuntimeError):  # noqa: N818
    """Error raised when an iterative solver or fit stops before it reaches its tolerance.

    No result is returned. The message states the cause and, for solvers, the residual.

    Attributes
    ----------
    code : kind of error, such as "not_converged". It does not change if the message is reworded;
        ``docs/errors.md`` lists all codes.
    """

    def __init__(self, sentence: str, *, code: str) -> None:
        super().__init__(one_sentence(sentence))
        self.code = code


@contextmanager
def about(name: str) -> Iterator[None]:
    """Prepend a name to the messages of ``InvalidInput`` errors raised in the ``with`` block.

    Examples
    --------
    >>> with about("hand.stl"):
    ...     raise InvalidInput("the file contains no triangles.", code="empty")
    Traceback (most recent call last):
    ...
    airtact.errors.InvalidInput: hand.stl: the file contains no triangles.
    """
    try:
        yield
    except InvalidInput as fault:
        # Messages about missing files contain the whole path.
        known = fault.code == "file_missing" and name in str(fault)
        words = str(fault) if known else f"{name}: {fault}"
        raise InvalidInput(words, fault.position, code=fault.code) from None


@contextmanager
def extra(name: str, need: str) -> Iterator[None]:
    """If an import in the ``with`` block fails, raise an error that says how to install the extra.

    Parameters
    ----------
    name : name of the extra, as in ``airtact[fem]``.
    need : beginning of the message, up to and including the name of the package, such as "finite
        elements need NGSolve".
    """
    try:
        yield
    except (ImportError, OSError) as fault:
        raise InvalidInput(
            f"{need}, which cannot be imported ({fault}): run pip install 'airtact[{name}]'.",
            code="extra_missing",
        ) from None


def counted(number: int, singular: str, plural: str) -> str:
    """Format a number followed by a noun in the singular or plural.

    Examples
    --------
    >>> counted(1, "edge is", "edges are"), counted(3, "edge is", "edges are")
    ('1 edge is', '3 edges are')
    """
    return f"{number} {singular if number == 1 else plural}"


def in_mm(point: Real[np.ndarray, "3"]) -> str:
    """Format the coordinates of a point [m] in millimetres.

    Examples
    --------
    >>> in_mm(np.array([0.001, -0.02, 0.3]))
    '(1.00, -20.00, 300.00) mm'
    """
    # "z" writes a negative zero without its sign.
    x, y, z = 1e3 * np.asarray(point, dtype=np.float64)
    return f"({x:z.2f}, {y:z.2f}, {z:z.2f}) mm"


def millimetres(length: float, digits: int = 2) -> str:
    """Format a length [m] in millimetres, without an exponent.

    Examples
    --------
    >>> millimetres(0.000123), millimetres(0.1832)
    ('0.12 mm', '180 mm')
    """
    return f"{float(f'{1e3 * length:.{digits}g}'):z.12g} mm"


def of_kind(value: Value, kind: type | UnionType, what: str, instead: str) -> Value:
    """Check that an object has the right type, and return the object.

    ``instead`` describes a valid argument; it ends the error message.
    """
    if not isinstance(value, kind):
        name = kind.__name__ if isinstance(kind, type) else str(kind)
        raise InvalidInput(
            f"{what} is {_described(value)}, but it must be {_with_article(name)}: pass {instead}.",
            code="wrong_kind",
        )
    return value


def path_of(path: str | Path, what: str) -> Path:
    """Check that a path is a text or a ``Path``, and return it as a ``Path``."""
    return Path(of_kind(path, str | Path, what, "the name of a file or folder"))


def shaped(array: Num[np.ndarray, "..."], shape: tuple[int, ...], what: str) -> np.ndarray:
    """Check that an array consists of numbers and has the right shape, and return the array.

    In ``shape``, -1 stands for any length.
    """
    try:
        numbers = np.asarray(array)
    except ValueError:  # rows of different lengths
        numbers = np.asarray(None)
    if numbers.dtype.kind not in "biufc":
        raise InvalidInput(
            f"{what} must be an array of numbers, not {_described(array)}.", code="not_a_number"
        )
    fits = [length in (-1, size) for length, size in zip(shape, numbers.shape, strict=False)]
    if numbers.ndim != len(shape) or not all(fits):
        raise InvalidInput(
            f"the shape of {what} is {numbers.shape}, but it must be "
            f"{str(shape).replace('-1', 'any')}.",
            code="wrong_shape",
        )
    return numbers


def _described(value: object) -> str:
    """Describe a wrong value: arrays by shape, numbers and text literally, others by type."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    if isinstance(value, int | float | complex | str):
        return repr(value)
    size = f" of length {len(value)}" if isinstance(value, list | tuple | dict) else ""
    return _with_article(type(value).__name__) + size


def _with_article(name: str) -> str:
    return f"an {name}" if name[0] in "AEIOUaeiou" else f"a {name}"


def check_choice(value: str, what: str, choices: Sequence[str]) -> None:
    """Raise an error if a value is not one of the choices."""
    if value not in choices:
        raise InvalidInput(
            f"{what} is {value!r}, but it must be one of {', '.join(map(repr, choices))}.",
            code="unknown_name",
        )


def number(value: float, what: str, unit: str) -> float:
    """Check that a value is a real number, possibly NaN or infinite, and return it as a float."""
    array = np.asarray(value if np.isscalar(value) or isinstance(value, np.ndarray) else None)
    if array.ndim != 0 or array.dtype.kind not in "iuf":
        in_unit = f", in {unit}" if unit else ""
        raise InvalidInput(
            f"{what} is {_described(value)}, but it must be a single real number{in_unit}.",
            code="not_a_number",
        )
    return float(array)


def positive(value: float, what: str, unit: str) -> float:
    """Check that a number is finite and above zero, and return it as a float.

    Examples
    --------
    >>> positive(40e3, "frequency", "Hz")
    40000.0
    """
    result = number(value, what, unit)
    if not np.isfinite(result) or result <= 0.0:
        raise InvalidInput(
            f"{what} is {result:g} {unit}, but it must be a finite number above zero.",
            code="out_of_range",
        )
    return result


def between(
    value: float, low: float, high: float, what: str, unit: str, slip: str = NOT_METRES
) -> float:
    """Check that a number lies between ``low`` and ``high``, and return it as a float.

    ``slip`` is a likely cause, such as "is it in kHz?", which is added to the message. The default
    is for lengths in metres.

    Examples
    --------
    >>> between(5, 0, 1, "gain", "", "5 % is 0.05.")
    Traceback (most recent call last):
    ...
    airtact.errors.InvalidInput: gain is 5, but it must lie between 0 and 1: 5 % is 0.05.
    """
    result = number(value, what, unit)
    if not low <= result <= high:
        unit = f" {unit}" if unit else ""
        raise InvalidInput(
            f"{what} is {result:g}{unit}, but it must lie between {low:g} and {high:g}{unit}: "
            f"{slip}",
            code="out_of_range",
        )
    return result


def within(
    value: float, low: float, high: float, what: str, unit: str, slip: str = NOT_METRES
) -> float:
    """Check that a number is above zero and lies between ``low`` and ``high``, and return it."""
    return between(positive(value, what, unit), low, high, what, unit, slip)


def check_frequency(frequency: float) -> float:
    """Check that a frequency lies between 1 kHz and 1 MHz, and return it as a float [Hz]."""
    return between(frequency, 1e3, 1e6, "frequency", "Hz", "is it in kHz? Use hertz.")


def check_seed(seed: int) -> None:
    """Raise an error unless a seed for random numbers is a non-negative integer."""
    if not isinstance(seed, int | np.integer) or isinstance(seed, bool) or seed < 0:
        raise InvalidInput(
            f"a seed must be a whole number of at least 0, not {seed!r}.", code="out_of_range"
        )


def fixed(array: Real[np.ndarray, "..."]) -> Float64[np.ndarray, "..."]:
    """Copy an array to read-only float64, so that it cannot change after it has been checked."""
    copy = np.array(array, dtype=np.float64, order="C")
    copy.flags.writeable = False
    return copy


def real_numbers(array: Real[np.ndarray, "..."], what: str) -> Float64[np.ndarray, "..."]:
    """Convert an array, or nested lists, of real numbers to read-only float64.

    Rows of different lengths, complex numbers, text and other objects raise an error.
    """
    try:
        numbers = np.asarray(array)
    except ValueError:
        raise InvalidInput(
            f"{what} are {_described(array)} whose rows differ in length; use an array.",
            code="wrong_shape",
        ) from None
    if numbers.dtype.kind not in "iuf" and numbers.size:
        raise InvalidInput(
            f"{what} are {_described(array)} of type {numbers.dtype} and shape {numbers.shape}; "
            "use real numbers.",
            code="not_a_number",
        )
    return fixed(numbers)


def complex_numbers(array: Num[np.ndarray, "..."], what: str) -> Complex128[np.ndarray, "..."]:
    """Return a copy of an array of numbers as complex128."""
    try:
        return np.array(array, dtype=np.complex128)
    except (TypeError, ValueError):
        raise InvalidInput(
            f"{what} are {_described(array)}, but they must be an array of numbers.",
            code="not_a_number",
        ) from None


def points_of(
    array: Real[np.ndarray, "..."], what: str, least: int = 1
) -> Float64[np.ndarray, "points 3"]:
    """Convert an array of at least ``least`` (0 or 1) points to read-only float64 (P, 3).

    Raise an error if the shape is wrong, there are too few points, or a number is not finite. A
    single point of shape (3,) is not accepted.
    """
    points = real_numbers(array, what)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InvalidInput(
            f"{what} have shape {points.shape}, but points must have shape (number of points, 3).",
            code="wrong_shape",
        )
    if len(points) < least:
        raise InvalidInput(f"{what} are empty; pass at least one.", code="empty")
    check_finite(points, what)
    return points


def point_of(vector: Vector, what: str) -> Float64[np.ndarray, "3"]:
    """Convert a point to read-only float64 (3,).

    Raise an error if the shape is wrong or a coordinate is not finite.
    """
    point = real_numbers(np.asarray(vector), what)
    if point.shape != (3,):
        raise InvalidInput(
            f"{what} has shape {point.shape}, but a point must have shape (3,).", code="wrong_shape"
        )
    check_finite(point, what)
    return point


def direction_of(vector: Vector, what: str, code: str = "all_zero") -> Float64[np.ndarray, "3"]:
    """Return the unit vector along a vector (3,); raise an error if its length is 0."""
    direction = point_of(vector, what)
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        raise InvalidInput(f"{what} has length 0; use a nonzero vector.", code=code)
    return fixed(direction / length)


def check_finite(array: np.ndarray, what: str) -> None:
    """Raise an error if an array contains NaN or infinity."""
    finite = np.isfinite(array)
    if not finite.all():
        bad = np.argwhere(~finite)
        values = counted(len(bad), "value is", "values are")
        raise InvalidInput(
            f"{values} NaN or infinite in {what}, the first at index {bad[0].tolist()}.",
            code="not_finite",
        )


def file_fault(path: Path, error: OSError) -> InvalidInput:
    """Return the error for a file that is missing or cannot be read."""
    if isinstance(error, FileNotFoundError):
        examples = Path(__file__).parent / "setup" / "examples"
        copies = [file for file in examples.rglob("*") if file.name == path.name]
        hint = f" To use airtact's example of this name, copy {copies[0]}." if copies else ""
        return InvalidInput(f"the file {path} does not exist.{hint}", code="file_missing")
    return InvalidInput(
        f"cannot read the file {path}: {error.strerror or error}.", code="file_unreadable"
    )


def in_short(self: Any) -> str:
    """Format a dataclass on one line, with large fields replaced by their type and shape.

    Classes use it as ``__repr__ = in_short``.

    Examples
    --------
    >>> from airtact.acoustics.sources import Monopoles
    >>> Monopoles(np.zeros((2, 3)), np.ones(2))
    Monopoles(positions=[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], strengths=[[(1+0j)], [(1+0j)]])
    >>> Monopoles(np.zeros((20, 3)), np.eye(20))
    Monopoles(positions=float64 (20, 3), strengths=complex128 (20, 20))
    """
    parts = [
        f"{field.name}={_short(getattr(self, field.name))}"
        for field in dataclasses.fields(self)
        if field.repr
    ]
    return f"{type(self).__name__}({', '.join(parts)})"


def _short(value: object) -> str:
    if isinstance(value, np.ndarray) and value.size <= 9:  # such as a rotation or three points
        return str(value.tolist())
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape}"
    written = repr(value)
    if len(written) <= 60 and "\n" not in written:
        return written
    name = type(value).__name__
    return f"{len(value)} in a {name}" if isinstance(value, Mapping | Sequence) else f"{name}(…)"


def one_line(self: object, *facts: str) -> str:
    """Format an object as its type name, followed by the non-empty facts in brackets.

    Examples
    --------
    >>> one_line(1.5, "3 foci", "", "1500 Pa")
    'float(3 foci, 1500 Pa)'
    """
    return f"{type(self).__name__}({', '.join(fact for fact in facts if fact)})"


def sides_in_mm(points: Real[np.ndarray, "points 3"]) -> str:
    """Format the side lengths of the axis-aligned box around points (P, 3) [m] in millimetres.

    Examples
    --------
    >>> sides_in_mm(np.array([[0.0, 0, 0], [0.01, 0.0204, 0]]))
    '10 x 20.4 x 0 mm'
    """
    return " x ".join(f"{round(side, 1) + 0.0:g}" for side in 1e3 * np.ptp(points, axis=0)) + " mm"


def as_sentence(words: str) -> str:
    """Begin a text with a capital letter and end it with a full stop.

    Examples
    --------
    >>> as_sentence("the solver is slow"), as_sentence("Is it?")
    ('The solver is slow.', 'Is it?')
    """
    return words[:1].upper() + words[1:] + ("" if words.endswith((".", "!", "?")) else ".")


def span(values: Iterable[float], unit: str, form: str = ".4g") -> str:
    """Format the range of some values with their unit, or a single value if all are equal.

    Examples
    --------
    >>> span([1480.0, 1500.0], "Pa"), span([2.0, 2.0], "Pa")
    ('1480 to 1500 Pa', '2 Pa')
    """
    numbers = list(values)
    low, high = format(min(numbers), form), format(max(numbers), form)
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
