"""Stored: a solver that reads from memory or disk what it has solved before."""

import copy
import hashlib
import struct
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

from airtact import _kernels, errors
from airtact.acoustics.field_file import DamagedError, packed, save, unpacked
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField, Solver, SolveReport
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput, number, of_kind
from airtact.files.bounded import bytes_of
from airtact.timing import Progress

SUFFIX = ".field.h5"

# Age at which a half-written file is taken to have lost its writer [s]
ABANDONED_AFTER = 600.0


def fingerprint(solver: Solver, scene: Scene, sources: Monopoles) -> str:
    """Name a field by everything that determines it, to the last bit: 40 hexadecimal digits.

    Every field of the dataclasses that solver, scene and sources consist of counts, except those
    that take no part in comparisons (``field(compare=False)``: caches and callbacks), and so does
    the version of airtact with the digest of its files.

    Raises
    ------
    InvalidInput
        Something has no known bytes, such as a solver that is no dataclass.
    """
    return name_of(solver, scene, sources)


def name_of(*values: object) -> str:
    """Name some values and the airtact that computes with them; raise as ``fingerprint``."""
    digest = hashlib.blake2b(program().encode(), digest_size=20)
    for value in values:
        _feed(digest.update, value)
    return digest.hexdigest()


@cache
def program(package: Path = Path(errors.__file__).parent) -> str:
    """Version of airtact and a digest of its Python files and compiled kernels."""
    digest = hashlib.blake2b(digest_size=20)
    # A change of the program may change its numbers, so fields of another one are not found.
    for file in [*sorted(package.rglob("*.py")), Path(str(_kernels.__file__))]:
        digest.update(file.name.encode() + hashlib.blake2b(file.read_bytes()).digest())
    return f"airtact {version('airtact')} {digest.hexdigest()}"


def _feed(update: Callable[[bytes], None], value: object) -> None:
    """Feed kind, length and bytes of a value to a digest, unambiguously."""
    # Kind and length go first, so that different values never feed the same bytes.
    kind = type(value)
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        update(f"array {value.dtype.str} {value.shape} ".encode())
        update(np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value):
        names = [field.name for field in fields(value) if field.compare]
        update(f"{kind.__module__}.{kind.__qualname__} {len(names)} ".encode())
        for name in names:
            update(f"{name} ".encode())
            _feed(update, getattr(value, name))
    elif value is None or isinstance(value, bool | int | str | np.bool_ | np.integer):
        text = f"{value}".encode()
        update(f"{'text' if isinstance(value, str) else 'whole'} {len(text)} ".encode() + text)
    elif isinstance(value, float | complex | np.floating | np.complexfloating):
        update(b"number " + struct.pack("<dd", complex(value).real, complex(value).imag))
    elif isinstance(value, tuple | list):
        update(f"list {len(value)} ".encode())
        for item in value:
            _feed(update, item)
    elif isinstance(value, Mapping):
        update(f"table {len(value)} ".encode())
        for key in sorted(value):
            _feed(update, key)
            _feed(update, value[key])
    else:
        raise InvalidInput(
            f"a {kind.__qualname__} cannot be compared with another: it is no dataclass of "
            "numbers.",
            code="does_not_match",
        )


class Stored(Solver):
    """A solver that keeps its fields in memory and in a folder, and reads them again.

    A field is found again by everything that determines it, to the last bit: every vertex and
    mid-edge point, boundary, medium, frequency, source, setting of the solver, and airtact itself.
    An entry is written whole or not at all, even if another process writes too or this one is
    killed; a damaged one is noticed by its checksum and solved again. When the folder exceeds
    ``most_bytes``, the entries that were unused for longest are deleted. A field that cannot be
    stored is still solved, and its report's warnings give the reason. Fields of finite elements
    stay in memory only. Code outside airtact does not count: after a change to a solver of your
    own, use another folder.

    Parameters
    ----------
    solver : solves what is not stored.
    folder : of the files; made if it does not exist. Any number of processes may share it.
    most_bytes : largest size of the folder.

    Raises
    ------
    InvalidInput
        Something of the wrong kind, or a bound below 1 byte.

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
        self._memory: OrderedDict[str, RadiatedField] = OrderedDict()

    def reporting(self, progress: Progress | None) -> "Stored":
        """Return the store with a callback that gets the words of each step of its solver."""
        reporting = copy.copy(self)  # shares the fields in memory
        reporting.solver = self.solver.reporting(progress)
        return reporting

    def radiate(self, scene: Scene, sources: Monopoles) -> RadiatedField:
        """Field of the monopoles, from memory, from the folder, or solved; errors as of the solver.

        A field from the folder has ``store`` as the only step in its report's ``seconds``.
        """
        try:
            key = fingerprint(self.solver, scene, sources)
        except InvalidInput as fault:
            field = self.solver.radiate(scene, sources)
            return _with_warning(field, f"this field is not stored: {fault}")
        # Taken out and put back as the latest, in one step each: other threads may do the same.
        field = self._memory.pop(key, None) or self._from_folder(key, scene, sources)
        if field is None:
            field = self.solver.radiate(scene, sources)
            fault = self._into_folder(key, field, scene)
            if fault:
                field = _with_warning(field, fault)
        self._memory[key] = field
        # The latest few are enough, and a field takes megabytes.
        while len(self._memory) > 8:
            self._memory.popitem(last=False)
        return field

    def _from_folder(self, key: str, scene: Scene, sources: Monopoles) -> RadiatedField | None:
        begun = time.perf_counter()
        path = self.folder / (key + SUFFIX)
        try:
            field = unpacked(bytes_of(path, self.most_bytes), key, scene, sources)
        except InvalidInput:
            return None
        except DamagedError:
            with suppress(OSError):
                path.unlink(missing_ok=True)
            return None
        with suppress(OSError):
            path.touch()  # records when the entry was used last
        seconds = {"store": time.perf_counter() - begun}
        return _with_report(field, replace(field.report, seconds=seconds))

    def _into_folder(self, key: str, field: RadiatedField, scene: Scene) -> str:
        """Write an entry and delete the oldest-used ones.

        Return why it was not kept, or nothing.
        """
        if len(field.scene.obstacles) != len(scene.obstacles):
            # An entry is read with the scene that is asked for, so it cannot hold another one.
            return "this field is kept in memory only: it is the one without reflecting boards"
        try:
            content = packed(field, key)
        except InvalidInput as fault:
            return f"this field is kept in memory only: {fault}"
        if len(content) > self.most_bytes:
            return (
                f"this field is not stored: it takes {len(content)} bytes; {self.folder} may hold "
                f"{self.most_bytes}."
            )
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            save(self.folder / (key + SUFFIX), content)
            self._make_room()
        except OSError as error:
            return f"this field is not stored: {self.folder} takes no file ({error.strerror})."
        return ""

    def _make_room(self) -> None:
        """Delete the oldest-used entries beyond the bound, and abandoned files."""
        entries = []
        for path in self.folder.iterdir():
            with suppress(FileNotFoundError):  # another process may delete it at the same time
                state = path.stat()
                if path.name.endswith(SUFFIX):
                    entries.append((state.st_mtime_ns, state.st_size, path))
                elif path.suffix == ".partial" and time.time() - state.st_mtime > ABANDONED_AFTER:
                    path.unlink()
        # The time of last use was recorded by _from_folder.
        total = sum(size for _, size, _ in entries)
        for _, size, path in sorted(entries):
            if total <= self.most_bytes:
                break
            path.unlink(missing_ok=True)
            total -= size


def _with_warning(field: RadiatedField, sentence: str) -> RadiatedField:
    return _with_report(field, replace(field.report, warnings=(*field.report.warnings, sentence)))


def _with_report(field: RadiatedField, report: SolveReport) -> RadiatedField:
    copied = copy.copy(field)
    object.__setattr__(copied, "report", report)
    return copied
