"""Stored: a solver that answers from memory or disk what it has solved before."""

import copy
import time
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField, Solver, SolveReport
from airtact.acoustics.sources import Monopoles
from airtact.acoustics.store.entry import DamagedError, read, save, written
from airtact.acoustics.store.fingerprint import fingerprint
from airtact.checks import number, of_kind
from airtact.errors import InvalidInput
from airtact.files.bounded import bytes_of
from airtact.timing import Progress

SUFFIX = ".field.h5"

MOST_BYTES = 10**9
"""Bytes that a folder may hold by default."""

MOST_IN_MEMORY = 8
"""Fields that one solver keeps in memory."""

ABANDONED = 600.0
"""Age at which a half-written file is taken to have lost its writer [s]."""


class Stored(Solver):
    """A solver that keeps its fields in memory and in a folder, and reads them instead of solving again.

    A field is found again by everything that determines it, to the last bit: every vertex and
    mid-edge point, boundary, medium, frequency, source, setting of the solver, and airtact itself.
    An entry is written whole or not at all, even if another process writes too or this one is
    killed; a damaged one is noticed by its checksum and solved again. When the folder exceeds
    ``most_bytes``, the entries that were unused for longest are deleted. A field that cannot be
    stored is solved all the same, and its report's warnings give the reason. Finite elements'
    fields stay in memory only.

    Parameters
    ----------
    solver : solves what is not there.
    folder : of the files; made if it is not there. Any number of processes may share it.
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
    ...     found = at.Stored(at.BoundaryElement(accuracy=0.1), folder).radiate(scene, source)
    >>> list(found.report.seconds)
    ['store']
    """

    solver: Solver
    folder: Path
    most_bytes: int

    def __init__(self, solver: Solver, folder: str | Path, most_bytes: int = MOST_BYTES) -> None:
        of_kind(solver, Solver, "the solver of a store", "one such as BoundaryElement()")
        of_kind(folder, str | Path, "the folder of a store", "a path")
        if not 1 <= number(most_bytes, "most_bytes", "bytes") < float("inf"):
            raise InvalidInput(
                f"most_bytes is {most_bytes}, but a folder must be allowed at least 1 byte.",
                code="out_of_range",
            )
        self.solver, self.folder, self.most_bytes = solver, Path(folder), int(most_bytes)
        self._memory: OrderedDict[str, RadiatedField] = OrderedDict()

    def reporting(self, progress: Progress | None) -> "Stored":
        """Return the store with a callback that gets the words of each step of its solver as it begins."""
        again = copy.copy(self)  # it shares the fields in memory
        again.solver = self.solver.reporting(progress)
        return again

    def radiate(self, scene: Scene, sources: Monopoles) -> RadiatedField:
        """Give the field of the monopoles, from memory, from the folder, or solved; errors as of the solver.

        One that was read has ``store`` as the only step in its report's ``seconds``.
        """
        try:
            key = fingerprint(self.solver, scene, sources)
        except InvalidInput as unknown:
            return _with_warning(
                self.solver.radiate(scene, sources), f"this field is not stored: {unknown}"
            )
        field = self._memory.pop(
            key, None
        )  # and last again, in one step each: other threads use it at the same time
        if field is None:
            field = self._from_folder(key, scene, sources)
        if field is None:
            field = self.solver.radiate(scene, sources)
            for sentence in self._into_folder(key, field, scene):
                field = _with_warning(field, sentence)
        self._memory[key] = field
        while len(self._memory) > MOST_IN_MEMORY:
            self._memory.popitem(last=False)
        return field

    def _from_folder(self, key: str, scene: Scene, sources: Monopoles) -> RadiatedField | None:
        begun, path = time.perf_counter(), self.folder / (key + SUFFIX)
        try:
            field = read(bytes_of(path, self.most_bytes), key, scene, sources)
        except InvalidInput:
            return None
        except DamagedError:
            with suppress(OSError):
                path.unlink(missing_ok=True)
            return None
        with suppress(OSError):
            path.touch()  # when it was used last
        return _with_report(
            field, replace(field.report, seconds={"store": time.perf_counter() - begun})
        )

    def _into_folder(self, key: str, field: RadiatedField, scene: Scene) -> Iterator[str]:
        """Write an entry and let the oldest-used go; yields a sentence if it could not be kept."""
        if len(field.scene.obstacles) != len(
            scene.obstacles
        ):  # an entry has the scene that is asked for
            yield "this field is kept in memory only: it is that around the bodies other than reflecting boards"
            return
        try:
            whole = written(field, key)
        except InvalidInput as unfit:
            yield f"this field is kept in memory only: {unfit}"
            return
        if len(whole) > self.most_bytes:
            yield f"this field is not stored: it takes {len(whole)} bytes; {self.folder} may hold {self.most_bytes}."
            return
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            save(self.folder / (key + SUFFIX), whole)
            self._let_go()
        except OSError as error:
            yield f"this field is not stored: {self.folder} takes no file ({error.strerror})."

    def _let_go(self) -> None:
        """Remove the oldest-used entries beyond the bound, and what killed processes left half written."""
        entries = []
        for path in self.folder.iterdir():
            with suppress(FileNotFoundError):  # another process may let go at the same time
                state = path.stat()
                if path.name.endswith(SUFFIX):
                    entries.append((state.st_mtime_ns, state.st_size, path))
                elif path.suffix == ".partial" and time.time() - state.st_mtime > ABANDONED:
                    path.unlink()
        held = sum(size for _, size, _ in entries)
        for _, size, path in sorted(entries):
            if held <= self.most_bytes:
                break
            path.unlink(missing_ok=True)
            held -= size


def _with_warning(field: RadiatedField, sentence: str) -> RadiatedField:
    """Add a warning to a field's report."""
    return _with_report(field, replace(field.report, warnings=(*field.report.warnings, sentence)))


def _with_report(field: RadiatedField, report: SolveReport) -> RadiatedField:
    twin = copy.copy(field)
    object.__setattr__(twin, "report", report)
    return twin
