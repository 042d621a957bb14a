"""``Stored``: a solver that caches its fields in a folder.

An entry consists of a checksum and a NumPy archive. The archive contains the field's arrays, and
its dataclasses as a JSON tree. Scene and sources are not stored, because the caller supplies them.
"""

import hashlib
import importlib
import io
import json
import time
from collections.abc import Mapping
from contextlib import suppress
from copy import copy
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from airtact import _kernels, errors
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField, Solver, SolveReport
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput, number, of_kind
from airtact.files.atomic import whole_file
from airtact.files.bounded import bytes_of
from airtact.timing import Progress

SUFFIX = ".field"


def name_of(*values: object) -> str:
    """Return a hash of values and of airtact's code, as 40 hexadecimal digits.

    All fields of dataclasses are hashed, except caches and callbacks (``field(compare=False)``).

    Raises
    ------
    InvalidInput
        If a value cannot be hashed, such as a solver that is not a dataclass.
    """
    arrays: list[np.ndarray] = []
    tree = json.dumps([_tree(value, arrays, {}) for value in values], sort_keys=True)
    digest = hashlib.blake2b((program() + tree).encode(), digest_size=20)
    for array in arrays:
        digest.update(f"{array.dtype.str} {array.shape} ".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


@cache
def program(package: Path = Path(errors.__file__).parent) -> str:
    """Return a hash of airtact's Python files and compiled kernels."""
    digest = hashlib.blake2b(digest_size=20)
    # Another version of airtact may compute different numbers.
    for file in [*sorted(package.rglob("*.py")), Path(str(_kernels.__file__))]:
        digest.update(file.name.encode() + hashlib.blake2b(file.read_bytes()).digest())
    return digest.hexdigest()


def packed(field: RadiatedField, key: str) -> bytes:
    """Return the bytes of the file in which a field is stored.

    The function raises an error if the field contains objects of other libraries.
    """
    arrays: list[np.ndarray] = []
    tree = _tree(field, arrays, {id(field.scene): "scene", id(field.sources): "sources"})
    stream = io.BytesIO()
    np.savez(stream, *arrays, tree=np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8))
    content = stream.getvalue()
    return _checksum(key, content) + content


def unpacked(content: bytes, key: str, scene: Scene, sources: Monopoles) -> RadiatedField | None:
    """Return the field stored in the bytes; None if they are damaged or have a different key."""
    archive = content[64:]
    if content[:64] != _checksum(key, archive):
        return None
    try:
        with np.load(io.BytesIO(archive)) as file:
            tree = json.loads(file["tree"].tobytes())
            arrays = [file[f"arr_{index}"] for index in range(len(file.files) - 1)]
        for array in arrays:
            array.flags.writeable = False
        field = _value(tree, arrays, {"scene": scene, "sources": sources})
    except Exception:  # another program wrote the file with a valid checksum
        return None
    return field if isinstance(field, RadiatedField) else None


def _checksum(key: str, archive: bytes) -> bytes:
    return hashlib.sha256(key.encode() + archive).hexdigest().encode()


def _tree(value: object, arrays: list[np.ndarray], references: Mapping[int, str]) -> Any:
    if id(value) in references:
        return {"reference": references[id(value)]}
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, complex):
        return {"complex": [value.real, value.imag]}
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        # JSON has no NumPy arrays, so the tree contains the index of each array.
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, tuple | list):
        return {"tuple": [_tree(item, arrays, references) for item in value]}
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {"table": {key: _tree(value[key], arrays, references) for key in sorted(value)}}
    kind = type(value)
    if is_dataclass(value) and not isinstance(value, type):
        parts = {
            part.name: _tree(getattr(value, part.name), arrays, references)
            for part in fields(value)
            if part.init and part.compare
        }
        return {"module": kind.__module__, "class": kind.__qualname__, "fields": parts}
    raise InvalidInput(
        f"a {kind.__qualname__} cannot be stored: it is not a number, a string, an array or a "
        "dataclass.",
        code="wrong_kind",
    )


def _value(tree: Any, arrays: list[np.ndarray], references: Mapping[str, object]) -> Any:

    def restored(table: Mapping[str, Any]) -> dict[str, Any]:
        return {key: _value(item, arrays, references) for key, item in table.items()}

    match tree:
        case {"reference": name}:
            return references[name]
        case {"complex": [real, imaginary]}:
            return complex(real, imaginary)
        case {"array": index}:
            return arrays[index]
        case {"tuple": items}:
            return tuple(_value(item, arrays, references) for item in items)
        case {"table": table}:
            return restored(table)
        case {"module": str(module), "class": name, "fields": table}:
            # Only airtact's dataclasses are created, even if a damaged file names others.
            if not module.startswith("airtact."):
                raise ValueError(module)
            kind: Any = getattr(importlib.import_module(module), name)
            if not (isinstance(kind, type) and is_dataclass(kind)):
                raise ValueError(name)
            return kind(**restored(table))
    return tree


class Stored(Solver):
    """A solver that stores every field in a folder and reads it back when it is needed again.

    Each field is stored under a key. The key includes everything that affects the field, to the
    last bit: vertices and mid-edge points, boundary conditions, medium, frequency, sources,
    settings of the solver, and airtact's code. Code outside airtact is not part of the key, so use
    another folder after changing your own solver. A file is written completely or not at all, even
    if several processes write at the same time or a process is killed. A damaged file is detected
    by its checksum, and its field is solved again. If the folder exceeds ``most_bytes``, the least
    recently used files are deleted. A field that cannot be stored, such as a field of finite
    elements, is still solved, and a warning in its report states the reason. Errors raised by
    ``solver`` are passed on.

    Parameters
    ----------
    solver : solver for fields that are not stored yet, such as ``BoundaryElement()``.
    folder : folder for the files; it is created if necessary. Any number of processes may share it.
    most_bytes : largest total size of the files [bytes], at least 1; 1 GB by default.

    Raises
    ------
    InvalidInput
        If an argument has the wrong type, or ``most_bytes`` is below 1.

    Examples
    --------
    >>> import tempfile
    >>> import airtact as at
    >>> import numpy as np
    >>> scene = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(at.sphere(5e-3, 2e-3))])
    >>> source = at.Monopoles(np.array([[0, 0, 0.01]]), np.ones(1))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     solved = at.Stored(at.BoundaryElement(accuracy=0.1), folder).radiate(scene, source)
    ...     again = at.Stored(at.BoundaryElement(accuracy=0.1), folder).radiate(scene, source)
    >>> list(again.report.seconds)
    ['store']
    """

    solver: Solver
    folder: Path
    most_bytes: int

    def __init__(self, solver: Solver, folder: str | Path, most_bytes: int = 10**9) -> None:
        of_kind(solver, Solver, "the solver of a store", "one such as BoundaryElement()")
        of_kind(folder, str | Path, "the folder of a store", "a path")
        if not 1 <= number(most_bytes, "most_bytes", "bytes") < float("inf"):
            raise InvalidInput(
                f"most_bytes is {most_bytes}, but a folder needs at least 1 byte.",
                code="out_of_range",
            )
        self.solver = solver
        self.folder = Path(folder)
        self.most_bytes = int(most_bytes)

    def reporting(self, progress: Progress | None) -> "Stored":
        """Return a copy whose solver passes the name of each step to a callback."""
        return Stored(self.solver.reporting(progress), self.folder, self.most_bytes)

    def radiate(self, scene: Scene, sources: Monopoles) -> RadiatedField:
        """Return the field of the monopoles, read from the folder if possible, otherwise computed.

        Errors raised by the solver are passed on. If the field was read from the folder, ``store``
        is the only step in ``seconds`` of its report.
        """
        begun = time.perf_counter()
        try:
            key = name_of(self.solver, scene, sources)
        except InvalidInput as fault:
            return _with_warning(self.solver.radiate(scene, sources), str(fault))
        path = self.folder / (key + SUFFIX)
        with suppress(InvalidInput):
            field = unpacked(bytes_of(path, self.most_bytes), key, scene, sources)
            if field is not None:
                with suppress(OSError):
                    path.touch()  # records when the entry was last used
                seconds = {"store": time.perf_counter() - begun}
                return _with_report(field, replace(field.report, seconds=seconds))
        field = self.solver.radiate(scene, sources)
        try:
            self._keep(path, key, field, scene)
        except (InvalidInput, OSError) as fault:
            return _with_warning(field, str(fault))
        return field

    def _keep(self, path: Path, key: str, field: RadiatedField, scene: Scene) -> None:
        if field.scene is not scene:
            # An entry is read with the scene of its key.
            raise InvalidInput(
                "fields with reflecting boards are not stored, so each call solves them again; "
                "call it without a store to avoid this warning.",
                code="not_supported",
            )
        content = packed(field, key)
        if len(content) > self.most_bytes:
            raise InvalidInput(
                f"the field takes {len(content)} bytes, but {self.folder} is limited to "
                f"{self.most_bytes} bytes.",
                code="too_many",
            )
        self.folder.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as partial:
            partial.write_bytes(content)
        entries = []
        # Partial files of killed processes count as well.
        for entry in self.folder.glob(f"*{SUFFIX}*"):
            with suppress(FileNotFoundError):  # another process may delete it at the same time
                state = entry.stat()
                entries.append((state.st_mtime_ns, state.st_size, entry))
        total = sum(size for _, size, _ in entries)
        for _, size, entry in sorted(entries):
            if total <= self.most_bytes:
                break
            entry.unlink(missing_ok=True)
            total -= size


def _with_warning(field: RadiatedField, reason: str) -> RadiatedField:
    sentence = f"this field is not stored: {reason}"
    return _with_report(field, replace(field.report, warnings=(*field.report.warnings, sentence)))


def _with_report(field: RadiatedField, report: SolveReport) -> RadiatedField:
    copied = copy(field)
    object.__setattr__(copied, "report", report)
    return copied
