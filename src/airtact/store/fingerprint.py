"""One short name for all that determines a field: scene, sources, solver and the sources of airtact itself."""

import hashlib
import struct
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

from airtact import _kernels, conventions
from airtact.conventions import InvalidInput
from airtact.scene.scene import Scene
from airtact.scene.sources import Monopoles
from airtact.solvers.problem import Solver

ROOMS = ("conventions.py", "scene", "solvers")
"""What of airtact a solved field follows from, beside the compiled loops."""


def fingerprint(solver: Solver, scene: Scene, sources: Monopoles, made_by: str | None = None) -> str:
    """Name a field by everything that it follows from, to the last bit.

    That is every field of the dataclasses that solver, scene and sources are made of, but for those that take no part
    in comparisons (``field(compare=False)``: what is only kept for speed): each vertex and mid-edge point, boundary,
    medium, frequency, position, strength and setting; and ``made_by``.

    Parameters
    ----------
    solver, scene, sources : as given to ``radiate``.
    made_by : what computes it; by default the version of airtact with the bytes of its scenes, solvers and loops.

    Returns
    -------
    40 hexadecimal digits.

    Raises
    ------
    InvalidInput
        Something of a kind whose bytes nobody knows, such as a shape or a solver that is no dataclass.
    """
    digest = hashlib.blake2b(digest_size=20)
    for part in (made_by or program(), solver, scene, sources):
        _feed(digest.update, part)
    return digest.hexdigest()


@cache
def program() -> str:
    """Version of airtact, and a digest of the files that a solved field follows from."""
    digest, root = hashlib.blake2b(digest_size=20), Path(conventions.__file__).parent
    files = [file for room in ROOMS for file in sorted([root / room, *(root / room).rglob("*.py")]) if file.is_file()]
    for file in (*files, Path(str(_kernels.__file__))):
        digest.update(file.name.encode() + file.read_bytes())
    return f"airtact {version('airtact')} {digest.hexdigest()}"


def _feed(update: Callable[[bytes], None], value: object) -> None:
    """Hand over the kind, the length and the bytes of a value, so that no two values give the same bytes."""
    kind = type(value)
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        update(f"array {value.dtype.str} {value.shape} ".encode())
        update(np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value):
        some = [field.name for field in fields(value) if field.compare]
        update(f"{kind.__module__}.{kind.__qualname__} {len(some)} ".encode())
        for name in some:
            update(f"{name} ".encode())
            _feed(update, getattr(value, name))
    elif value is None or isinstance(value, bool | int | str | np.bool_ | np.integer):
        words = f"{value}".encode()
        update(f"{'text' if isinstance(value, str) else 'whole'} {len(words)} ".encode() + words)
    elif isinstance(value, float | complex | np.floating | np.complexfloating):
        update(b"number " + struct.pack("<dd", complex(value).real, complex(value).imag))
    elif isinstance(value, tuple | list):
        update(f"list {len(value)} ".encode())
        for one in value:
            _feed(update, one)
    elif isinstance(value, Mapping):
        update(f"table {len(value)} ".encode())
        for key in sorted(value):
            _feed(update, key)
            _feed(update, value[key])
    else:
        raise InvalidInput(f"a {kind.__qualname__} cannot be told from another one, for it is no dataclass of numbers.")
