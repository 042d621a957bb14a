"""One line for objects that hold arrays."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Real


@runtime_checkable
class _Dataclass(Protocol):
    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]


def in_short(self: _Dataclass) -> str:
    """Write a dataclass in one line, its larger parts by type and shape.

    A class uses it by ``__repr__ = in_short``.

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
    """Write an object as its type with the few facts that matter, leaving out empty ones.

    Examples
    --------
    >>> one_line(1.5, "3 foci", "", "1500 Pa")
    'float(3 foci, 1500 Pa)'
    """
    return f"{type(self).__name__}({', '.join(fact for fact in facts if fact)})"


def sides_in_mm(points: Real[np.ndarray, "points 3"]) -> str:
    """Write the sides of the upright box round points (P, 3) [m].

    Examples
    --------
    >>> sides_in_mm(np.array([[0.0, 0, 0], [0.01, 0.0204, 0]]))
    '10 x 20.4 x 0 mm'
    """
    return " x ".join(f"{round(side, 1) + 0.0:g}" for side in 1e3 * np.ptp(points, axis=0)) + " mm"


def span(values: Iterable[float], unit: str, form: str = ".4g") -> str:
    """Write the range of some values with their unit, or the one value that all have.

    Examples
    --------
    >>> span([1480.0, 1500.0], "Pa"), span([2.0, 2.0], "Pa")
    ('1480 to 1500 Pa', '2 Pa')
    """
    numbers = list(values)
    low, high = format(min(numbers), form), format(max(numbers), form)
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
