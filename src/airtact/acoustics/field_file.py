"""A solved field as one HDF5 file whose user block, its first 512 bytes, holds a checksum.

The field's dataclasses become a tree in JSON and its arrays datasets. Scene and sources are not
stored: the caller has them.
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
from typing import Any

import numpy as np

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput

# Size of the user block, which holds the checksum [bytes]
USER_BLOCK = 512


class DamagedError(Exception):
    """The file is not what was written."""


def packed(field: RadiatedField, key: str) -> bytes:
    """Pack a field into the bytes of its file.

    Raise "wrong_kind" for objects of other libraries.
    """
    import h5py

    arrays: list[np.ndarray] = []
    tree = _to_tree(field, arrays, {id(field.scene): "scene", id(field.sources): "sources"})
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=USER_BLOCK) as file:
        file.attrs["key"] = key
        file["field"] = json.dumps(tree)
        for index, array in enumerate(arrays):
            file[f"arrays/{index}"] = array
    content = stream.getvalue()
    # HDF5 leaves its user block to others, so the checksum needs no second file.
    return _user_block(content) + content[USER_BLOCK:]


def unpacked(content: bytes, key: str, scene: Scene, sources: Monopoles) -> RadiatedField:
    """Restore a field; raise ``DamagedError`` for changed bytes or another key."""
    import h5py

    if content[:USER_BLOCK] != _user_block(content):
        raise DamagedError
    try:
        file: Any
        with h5py.File(io.BytesIO(content), "r") as file:
            if file.attrs["key"] != key:
                raise DamagedError
            tree = json.loads(file["field"][()])
            group = file.get("arrays", {})
            arrays = [group[str(index)][()] for index in range(len(group))]
        for array in arrays:
            array.flags.writeable = False
        field = _from_tree(tree, arrays, {"scene": scene, "sources": sources})
    except Exception as error:  # the checksum fits, but another program wrote the file
        raise DamagedError from error
    if not isinstance(field, RadiatedField):
        raise DamagedError
    return field


def save(path: Path, content: bytes) -> None:
    """Write a file that appears only once all its bytes are on the disk.

    After an ``OSError`` nothing of it is left.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.partial")
    try:
        with partial.open("xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        # Renaming is atomic: readers find the old file or the whole new one.
        os.replace(partial, path)
        if hasattr(os, "O_DIRECTORY"):  # Windows opens no folder
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
    finally:
        partial.unlink(missing_ok=True)


def _user_block(content: bytes) -> bytes:
    checksum = hashlib.sha256(memoryview(content)[USER_BLOCK:]).hexdigest()
    return f"airtact solved field 1 {checksum}".encode().ljust(USER_BLOCK, b"\0")


def _to_tree(value: object, arrays: list[np.ndarray], references: Mapping[int, str]) -> Any:
    """Describe a value in JSON; append its arrays to a list."""
    if id(value) in references:
        return {"reference": references[id(value)]}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return _to_tree(value.item(), arrays, references)
    if isinstance(value, complex):
        return {"complex": [value.real, value.imag]}
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        # JSON has no arrays: each becomes a dataset, and the tree its number.
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, tuple):
        return {"tuple": [_to_tree(item, arrays, references) for item in value]}
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        items = {key: _to_tree(item, arrays, references) for key, item in value.items()}
        return {"table": items}
    kind = type(value)
    if is_dataclass(value) and kind.__module__.startswith("airtact."):
        parts = {
            part.name: _to_tree(getattr(value, part.name), arrays, references)
            for part in fields(value)
            if part.init and part.compare
        }
        return {"module": kind.__module__, "class": kind.__qualname__, "fields": parts}
    raise InvalidInput(f"a {kind.__qualname__} cannot be written into a file.", code="wrong_kind")


def _from_tree(tree: Any, arrays: list[np.ndarray], references: Mapping[str, object]) -> Any:
    """Restore the value that a tree describes."""
    if not isinstance(tree, dict):
        return tree

    def restored(table: Mapping[str, Any]) -> dict[str, Any]:
        return {key: _from_tree(item, arrays, references) for key, item in table.items()}

    match tree:
        case {"reference": name}:
            return references[name]
        case {"complex": [real, imaginary]}:
            return complex(real, imaginary)
        case {"array": index}:
            return arrays[index]
        case {"tuple": items}:
            return tuple(_from_tree(item, arrays, references) for item in items)
        case {"table": table}:
            return restored(table)
        case {"module": str(module), "class": name, "fields": table} if module.startswith(
            "airtact."
        ):
            # Only dataclasses of airtact are made again, whatever the file names.
            kind = getattr(importlib.import_module(module), name)
            if isinstance(kind, type) and is_dataclass(kind):
                return kind(**restored(table))
    raise DamagedError
