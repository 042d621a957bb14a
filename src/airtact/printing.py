"""One line for objects that hold arrays, so that printing a scene does not print every vertex."""

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np


@runtime_checkable
class _Dataclass(Protocol):
    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]


PRINTED_IN_FULL = 9
"""Size of the largest array whose numbers are printed: a rotation, three points."""


def in_short(self: _Dataclass) -> str:
    """Write a dataclass in one line, its larger arrays by their shapes; a class uses it by ``__repr__ = in_short``.

    Examples
    --------
    >>> from airtact.scene.sources import Monopoles
    >>> Monopoles(np.zeros((2, 3)), np.ones(2))
    Monopoles(positions=[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], strengths=[[(1+0j)], [(1+0j)]])
    >>> Monopoles(np.zeros((20, 3)), np.eye(20))
    Monopoles(positions=float64 (20, 3), strengths=complex128 (20, 20))
    """
    parts = [f"{field.name}={_short(getattr(self, field.name))}" for field in dataclasses.fields(self) if field.repr]
    return f"{type(self).__name__}({', '.join(parts)})"


def _short(value: object) -> str:
    if isinstance(value, np.ndarray):
        return str(value.tolist()) if value.size <= PRINTED_IN_FULL else f"{value.dtype} {value.shape}"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key!r}: {_short(part)}" for key, part in value.items()) + "}"
    return repr(value)
