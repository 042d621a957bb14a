"""A field as one file: an HDF5 file whose first 512 bytes hold a checksum of the others.

The field's dataclasses become a tree in JSON, its arrays datasets; scene and sources are not
stored, because who looks for the field has them.
"""

import hashlib
import importlib
import io
import json
import os
import secrets
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Num

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput

HEAD = 512
"""Bytes before the HDF5 file proper: its user block."""

MARK = b"airtact solved field 1 "

Tree: TypeAlias = str | int | float | bool | dict[str, Any] | list[Any] | None


class DamagedError(Exception):
    """An entry that is not what was written."""


def written(field: RadiatedField, key: str) -> bytes:
    """Return the bytes of a field's file; raises "wrong_kind" for such as a factorised matrix of another library."""
    import h5py

    arrays: list[Num[np.ndarray, ...]] = []
    given = {id(field.scene): "scene", id(field.sources): "sources"}
    tree = _taken_apart(field, arrays, given)
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=HEAD) as file:
        file.attrs["key"] = key
        file["field"] = json.dumps(tree)
        for index, array in enumerate(arrays):
            file[f"arrays/{index}"] = array
    whole = stream.getvalue()
    return (MARK + _checksum(whole)).ljust(HEAD, b"\0") + whole[HEAD:]


def read(whole: bytes, key: str, scene: Scene, sources: Monopoles) -> RadiatedField:
    """Restore the field from its file; raises ``DamagedError`` for bytes not as written, or for another key."""
    if whole[:HEAD] != (MARK + _checksum(whole)).ljust(HEAD, b"\0"):
        raise DamagedError
    try:
        return _restored(whole, key, scene, sources)
    except Exception as error:  # of an entry that something else wrote, with a checksum that fits
        raise DamagedError from error


def _restored(whole: bytes, key: str, scene: Scene, sources: Monopoles) -> RadiatedField:
    import h5py

    with h5py.File(io.BytesIO(whole), "r") as file:
        if file.attrs["key"] != key:
            raise DamagedError
        stored: dict[str, Any] = {}
        file.visititems(
            lambda name, item: stored.update({name: item[()]} if hasattr(item, "dtype") else {})
        )
    tree, arrays = (
        json.loads(stored.pop("field")),
        [stored[f"arrays/{index}"] for index in range(len(stored))],
    )
    for array in arrays:
        array.flags.writeable = False
    field = _put_together(tree, arrays, {"scene": scene, "sources": sources})
    if not isinstance(field, RadiatedField):
        raise DamagedError
    return field


def save(path: Path, whole: bytes) -> None:
    """Write a file that appears with all its bytes on the disk, even if others write it or the process is killed.

    Nothing of it is left after an ``OSError``.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.partial")
    try:
        with partial.open("xb") as stream:
            stream.write(whole)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(partial, path)
        if hasattr(os, "O_DIRECTORY"):  # Windows opens no folder
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
    finally:
        partial.unlink(missing_ok=True)


def _checksum(whole: bytes) -> bytes:
    return hashlib.sha256(memoryview(whole)[HEAD:]).hexdigest().encode()


def _taken_apart(
    value: object, arrays: list[Num[np.ndarray, "..."]], given: Mapping[int, str]
) -> Tree:
    """Describe a value in JSON; its arrays are appended to a list."""
    if id(value) in given:
        return {"given": given[id(value)]}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return _taken_apart(value.item(), arrays, given)
    if isinstance(value, complex):
        return {"complex": [value.real, value.imag]}
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, tuple):
        return {"tuple": [_taken_apart(one, arrays, given) for one in value]}
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {"table": {key: _taken_apart(one, arrays, given) for key, one in value.items()}}
    kind = type(value)
    if is_dataclass(value) and kind.__module__.startswith("airtact."):
        kept = {
            one.name: getattr(value, one.name) for one in fields(value) if one.init and one.compare
        }
        parts: dict[str, Tree] = {
            name: _taken_apart(part, arrays, given) for name, part in kept.items()
        }
        return {"module": kind.__module__, "class": kind.__qualname__, "fields": parts}
    raise InvalidInput(f"a {kind.__qualname__} cannot be written into a file.", code="wrong_kind")


def _put_together(
    tree: Tree, arrays: list[Num[np.ndarray, "..."]], given: Mapping[str, object]
) -> object:
    """Make the value again that a tree describes."""
    if not isinstance(tree, dict):
        return tree
    match tree:
        case {"given": str(name)}:
            return given[name]
        case {"complex": [float(real), float(imaginary)]}:
            return complex(real, imaginary)
        case {"array": int(index)}:
            return arrays[index]
        case {"tuple": list(parts)}:
            return tuple(_put_together(part, arrays, given) for part in parts)
        case {"table": dict(table)}:
            return {key: _put_together(part, arrays, given) for key, part in table.items()}
        case {"module": str(module), "class": str(name), "fields": dict(table)} if (
            module.startswith("airtact.")
        ):
            kind = getattr(importlib.import_module(module), name)
            if not isinstance(kind, type) or not is_dataclass(kind):
                raise DamagedError
            return kind(**{key: _put_together(part, arrays, given) for key, part in table.items()})
    raise DamagedError
