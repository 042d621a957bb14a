"""Sweeps: evaluate a function, or the drive of a scene file, at many points on any executor."""

import hashlib
import json
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context, parent_process
from pathlib import Path
from types import FunctionType
from typing import Any

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.shared import available_memory, processor_count
from airtact.acoustics.store import name_of
from airtact.errors import (
    LARGEST_SCENE_FILE,
    InvalidInput,
    NotConverged,
    about,
    of_kind,
    one_sentence,
)
from airtact.files.atomic import whole_file, writable_folder
from airtact.files.bounded import bytes_of, text_of
from airtact.setup.building import read_scene
from airtact.setup.examples import file_or_example
from airtact.setup.parsing import Value, parse_scene
from airtact.setup.sequences import drives_at_foci, pressures_of
from airtact.setup.setup import Setup
from airtact.setup.solving import (
    control_drive,
    memory_of_a_solve,
    named,
    solve_foci,
    synthesise,
    unknowns_of,
)
from airtact.setup.tables import SceneFile
from airtact.timing import Clock

Row = dict[str, Value]
# Function that a sweep evaluates at each point
Function = Callable[[Row], Mapping[str, Value]]

# Largest number of points of a sweep
MAX_POINTS = 1_000_000

# Ending of the names of files that contain the result for one point
SUFFIX = ".point.json"


def sweep(
    function: Function | Setup | str | Path,
    points: Sequence[Mapping[str, Value]],
    executor: Executor | int | None = None,
    store: str | Path | None = None,
    *,
    progress: Callable[[int, int, int], None] | None = None,
) -> list[Row]:
    """Evaluate a scene or a function at many points, in parallel.

    Parameters
    ----------
    function : function that takes a point and returns a mapping from names to
        numbers, text, True, False or None. Processes import this function, so
        define it in a module, or use a ``functools.partial`` of such a function.
        In a script, call ``sweep`` under ``if __name__ == "__main__":``.
        Instead of a function, you can pass a scene file, or a setup read from
        one: ``sweep`` then computes the drive for each point, with the values
        that the point sets for keys of the file (see ``read_scene``).
    points : list of 1 to 1,000,000 mappings from names to values, which are numbers, text, True,
        False or None. For a scene, the names are paths of keys, such as ``"foci[0].offset"``.
    executor : executor that computes the points, such as ``ThreadPoolExecutor()`` or
        the ``get_executor()`` of a Dask client; or the number of processes, each with a
        single thread. By default, one process per processor, or as many as fit into
        memory.
    store : folder with one file per result. The file name depends on the point, the function with
        its arguments and module, and the version of airtact. Stored points are not computed again,
        so an interrupted sweep can be resumed. Use another folder after changing other modules
        that the function uses.
    progress : function called after each point with the numbers of completed points, of all points
        and of failed points.

    Returns
    -------
    A row (a dict) for each point, in the same order, with its values followed by the results. For a
    scene, the results are ``"NAME_Pa"``, the pressure at the focus NAME; ``"weakest_Pa"``;
    ``"gain"``, the ratio of the pressure at the weakest focus to that of a drive computed without
    the bodies (None in open air); ``"unknowns"`` and ``"estimated_error"`` of the solve; and
    ``"warnings"``. If a point raises an exception, ``"error"`` and ``"sentence"`` contain its code
    and message; otherwise they are empty.

    Raises
    ------
    InvalidInput
        If the points have the wrong type or number, or use the name "error" or "sentence"; if the
        setup was not read from a file; if the function cannot be passed to a process or identified
        in the store, the folder is not writable, or a process ended unexpectedly. Exceptions in
        the function do not end the sweep.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> def inverse(point):
    ...     return {"inverse": 1.0 / point["x"]}
    >>> with ThreadPoolExecutor() as threads:
    ...     rows = sweep(inverse, [{"x": 4.0}, {"x": 0.0}], threads)
    >>> rows[0]["inverse"], rows[1]["sentence"]
    (0.25, 'ZeroDivisionError: float division by zero')
    """
    if isinstance(function, Setup | str | Path):
        function = scene_points(function)
    if not callable(function):
        raise InvalidInput(
            f"the function of a sweep must be callable, but it is {function!r}.",
            code="wrong_kind",
        )
    rows = _checked_points(points)
    # This also checks the paths of keys, so do it before creating the folder.
    memory = function.memory(rows) if isinstance(function, ScenePoints) else 0.0
    folder = None
    names = [str(index) for index in range(len(rows))]
    results: dict[str, Row] = {}
    if store is not None:
        folder = writable_folder(Path(of_kind(store, str | Path, "the store", "a path")))
        names = names_of(function, rows)
        for name in names:
            try:
                content = json.loads((folder / (name + SUFFIX)).read_bytes())
                if content["name"] == name and {"error", "sentence"} <= content["row"].keys():
                    results[name] = content["row"]
            except (OSError, ValueError, LookupError, TypeError, AttributeError):
                continue  # recompute missing or damaged results

    waiting = {name: row for name, row in zip(names, rows, strict=True) if name not in results}
    total = len(set(names))
    failed = sum(bool(row["error"]) for row in results.values())
    if progress is not None:
        progress(len(results), total, failed)
    for name, row in _computed(function, waiting, executor, memory):
        # Do not store transient errors, so that the next run retries their points.
        transient = ("file_failed", "file_missing", "file_unreadable", "too_little_memory")
        if folder is not None and row["error"] not in transient:
            with whole_file(folder / (name + SUFFIX)) as partial_file:
                partial_file.write_text(json.dumps({"name": name, "row": row}), encoding="utf-8")
        results[name] = row
        failed += bool(row["error"])
        if progress is not None:
            progress(len(results), total, failed)
    return [{**row, **results[name]} for name, row in zip(names, rows, strict=True)]


def _checked_points(points: Sequence[Mapping[str, Value]]) -> list[Row]:
    if not isinstance(points, Iterable) or isinstance(points, str | Mapping):
        raise InvalidInput(
            f"the points of a sweep are a {type(points).__name__}, but they must be a list such as "
            '[{"gap": 0.012}, {"gap": 0.014}].',
            code="wrong_kind",
        )
    rows = [_checked_row(point, f"point {index}") for index, point in enumerate(points)]
    taken = sorted({"error", "sentence"}.intersection(*[set().union(*rows)]))
    if taken:
        raise InvalidInput(
            f"the names {', '.join(taken)} are reserved for the results; rename these values.",
            code="given_twice",
        )
    if not 1 <= len(rows) <= MAX_POINTS:
        raise InvalidInput(
            f"there are {len(rows):,} points; use 1 to {MAX_POINTS:,}.", code="out_of_range"
        )
    return rows


def _checked_row(values: Mapping[str, Any], label: str) -> Row:
    if not isinstance(values, Mapping):
        raise InvalidInput(
            f"{label} is a {type(values).__name__}, but it must map names to values, such as "
            '{"gap": 0.012}.',
            code="wrong_kind",
        )
    row: Row = {}
    for name, value in values.items():
        plain = value.item() if isinstance(value, np.generic) else value
        if not isinstance(name, str) or not (plain is None or isinstance(plain, str | float | int)):
            raise InvalidInput(
                f"{label} maps {name!r} to a {type(value).__name__}. Names must be text; values "
                "must be single numbers, text, True, False or None.",
                code="wrong_kind",
            )
        row[name] = plain
    return row


def _attempt(function: Function, point: Row) -> Row:
    # Turn an exception into a row with its code and message, so that the sweep continues.
    try:
        result = _checked_row(function(dict(point)), "the result")
        taken = sorted({*point, "error", "sentence"} & result.keys())
        if taken:
            raise InvalidInput(
                f"the result uses the names {', '.join(taken)}, which are reserved or already used "
                "by the point: rename them.",
                code="given_twice",
            )
    except (InvalidInput, NotConverged) as fault:
        return {"error": fault.code, "sentence": str(fault)}
    except (Exception, SystemExit) as fault:
        codes = {MemoryError: "too_little_memory", OSError: "file_failed"}
        code = next((codes[kind] for kind in codes if isinstance(fault, kind)), "function_failed")
        return {"error": code, "sentence": one_sentence(f"{type(fault).__name__}: {fault}")}
    return {**result, "error": "", "sentence": ""}


def _computed(
    function: Function, waiting: Mapping[str, Row], executor: Executor | int | None, memory: float
) -> Iterator[tuple[str, Row]]:
    # Yield names and results in the order of completion; cancel the remaining points when closed.
    if not waiting:
        return
    if executor is None or isinstance(executor, int):
        # The error raised by a pool does not name the object that cannot be pickled.
        try:
            pickle.dumps(function)
        except Exception as fault:
            raise InvalidInput(
                f"the function cannot be passed to a process ({fault}): define it in a module, or "
                "use an executor with threads.",
                code="wrong_kind",
            ) from None
        running = processes(process_count(len(waiting), executor, memory))
    else:
        running = nullcontext(of_kind(executor, Executor, "the executor", "ThreadPoolExecutor(4)"))
    with running as pool:
        futures = {pool.submit(_attempt, function, point): name for name, point in waiting.items()}
        try:
            for future in as_completed(futures):
                yield futures.pop(future), future.result()
        except BrokenExecutor:
            raise InvalidInput(
                f"a process ended unexpectedly with {len(futures)} of {len(waiting)} points left. "
                "Likely causes: too little memory, or a script that calls sweep outside "
                'if __name__ == "__main__". Stored points are kept.',
                code="link_closed",
            ) from None
        finally:
            for future in futures:
                future.cancel()


def process_count(points: int, limit: int | None = None, memory: float = 0.0) -> int:
    """Return the number of processes to use if each requires ``memory`` [bytes].

    By default, ``limit`` is the number of processors. The result is the smallest of ``limit``, the
    number of points and the number of processes that fit into 80 % of the available memory. The
    function raises ``InvalidInput`` if a single process requires more than the available memory.
    """
    free = available_memory()
    if memory > free:
        raise InvalidInput(
            f"one point requires about {memory / 1e9:.2g} GB, but only {free / 1e9:.2g} GB are "
            "available: close other programs, or allow a larger error (accuracy in [solver]).",
            code="too_little_memory",
        )
    fitting = 0.8 * free / memory if memory else np.inf
    return int(max(1, min(limit or processor_count(), points, fitting)))


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Start a pool of single-threaded processes, which end together with this program."""
    # Before a process has the module search path of this one, it would import from the current
    # folder, where a file random.py could hide Python's module.
    variable = "PYTHONSAFEPATH"
    before = os.environ.get(variable, "")
    os.environ[variable] = "1"
    try:
        with ProcessPoolExecutor(
            count,
            # A forked child inherits locks that other threads hold, so it may hang.
            get_context("spawn"),
            _begin_process,
            ({variable: before},),
        ) as pool:
            yield pool
    finally:
        os.environ[variable] = before


def _begin_process(environment: dict[str, str]) -> None:
    os.environ.update(environment)
    # Let Ctrl-C end the process at once, without a traceback.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # for libraries that are loaded later
    threadpool_limits(1)  # for libraries that are already loaded

    def end_with_parent() -> None:
        parent = parent_process()
        assert parent is not None
        parent.join()
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def names_of(function: Function, points: Iterable[Row]) -> list[str]:
    """Return a name for each point: a hash of its values and of the function, in hexadecimal.

    A function is identified by its name and the content of its module. A
    ``functools.partial`` is also identified by its arguments, and a dataclass object by
    its fields, except those with ``compare=False``.
    """
    parts: list[Any] = []
    core: Any = function
    if isinstance(function, partial):
        core = function.func
        parts = [list(function.args), dict(function.keywords)]
    # An edited module may return different results, so its content is part of the name.
    module = sys.modules.get(getattr(core, "__module__", None) or "")
    file = getattr(module, "__file__", None)
    parts.append(hashlib.blake2b(Path(file).read_bytes() if file else b"").hexdigest())
    if isinstance(core, FunctionType):
        core = f"{core.__module__}.{core.__qualname__}"
        if "<" in core:
            raise InvalidInput(
                f"the name {core} does not identify a function: define it in a module, and pass "
                "further data with functools.partial.",
                code="does_not_match",
            )
    # The hash of the function includes airtact's version and code; see ``store``.
    function_name = name_of(core, *parts)

    return [
        hashlib.blake2b(
            json.dumps([function_name, sorted(point.items())]).encode(), digest_size=20
        ).hexdigest()
        for point in points
    ]


@dataclass(frozen=True)
class ScenePoints:
    """Function for sweeps over a scene file; it maps values of keys to pressures at the foci.

    Attributes
    ----------
    scene : path of the scene file.
    content : hashes of the scene file and of the files named in it, by which stored results are
        identified.
    """

    scene: Path = field(compare=False)
    content: tuple[str, ...] = ()

    def __call__(self, point: Mapping[str, Value]) -> dict[str, Value]:
        """Return the pressures, the gain over the control, unknowns, error and warnings."""
        setup = read_scene(self.scene, point)
        transfer, report = solve_foci(setup, Clock())
        method = partial(drives_at_foci, setup)
        drives, stalled = synthesise(method, transfer, setup.target)
        control = control_drive(setup, method)
        compared = pressures_of(transfer, [drives] if control is None else [drives, control])
        weights = setup.target.weights
        # Foci of weight 0 request no pressure, so they never count as the weakest.
        requested = np.flatnonzero(weights > 0.0)
        peak = np.abs(drives).max()
        pressures = peak * compared["equal peak"][0]
        weakest = requested[np.argmin(pressures[requested] / weights[requested])]

        gain = None
        if control is not None:
            # As in ``render``, compare at full scale if the drive is, otherwise at equal energy.
            held_equal = "equal peak" if peak >= 0.99 else "equal energy"
            ratios = compared[held_equal][:, requested] / weights[requested]
            gain = float(ratios[0].min() / ratios[1].min())
        # Foci may have the same name, but columns may not.
        words = [name.replace(" ", "_") for name in setup.foci]
        columns = [
            f"{word}_{index + 1}" if words.count(word) > 1 else word
            for index, word in enumerate(words)
        ]
        return {
            **{
                f"{column}_Pa": float(pressure)
                for column, pressure in zip(columns, pressures, strict=True)
            },
            "weakest_Pa": float(pressures[weakest]),
            "gain": gain,
            "unknowns": report.nodes,
            "estimated_error": float(report.estimated_error),
            "warnings": "; ".join([*stalled, *named(report.warnings, setup.bodies)]),
        }

    def memory(self, points: Sequence[Mapping[str, Value]]) -> float:
        """Estimate the memory [bytes] of a solve from the first, middle and last point.

        An invalid key path raises an error. If every point is invalid, the method raises the
        error of the first one.
        """
        needed = 1.2e8  # of a process that has imported airtact
        faults = []
        for index in sorted({0, len(points) // 2, len(points) - 1}):
            try:
                setup = read_scene(self.scene, points[index])
                if isinstance(setup.solver, BoundaryElement):
                    unknowns = unknowns_of(setup.solver, setup.scene, setup.target.points)
                    needed = max(needed, memory_of_a_solve(unknowns, setup.accuracy))
            except (InvalidInput, NotConverged) as fault:
                if fault.code in ("unknown_key", "key_misplaced", "given_twice"):
                    raise
                faults.append(fault)
        if len(faults) == len(points):
            raise faults[0]
        return needed


def scene_points(scene: Setup | str | Path) -> ScenePoints:
    """Return the function that evaluates a scene file, or the file of a setup, in a sweep.

    ``InvalidInput`` is raised if a file cannot be read, or the setup has no scene file.
    """
    if isinstance(scene, Setup):
        if scene.path is None:
            raise InvalidInput(
                "a setup that was not read from a scene file has no keys to vary: pass a function.",
                code="wrong_kind",
            )
        scene = scene.path
    scene = file_or_example(scene)
    files = [scene]
    # Any text in the scene file could be the name of a file.
    for word in dict.fromkeys(_words(msgspec.to_builtins(_scene_file(scene)))):
        file = scene.parent / word
        if "\0" not in word and len(word) <= 255 and file.is_file():
            files.append(file)
    # Results are stored by the content of files, so a moved or renamed file keeps its results.
    content = tuple(hashlib.blake2b(bytes_of(file), digest_size=20).hexdigest() for file in files)
    return ScenePoints(scene, content)


def frames_of(scene: Path, recording: Path, folder: Path) -> list[Row]:
    """Write the hand of each frame of a recording to a file; return a sweep point for each frame.

    Each point sets the scene's hand to the file of one frame, and removes the gap and the pose of
    the hand. The radii are those of the scene's hand.
    """
    from airtact.hands.joints import joints_of
    from airtact.hands.tracking.recordings import load_recording

    hands = {
        f"obstacles[{index}]": table
        for index, table in enumerate(_scene_file(scene).obstacles)
        if table.hand is not None
    }
    if len(hands) != 1:
        raise InvalidInput(
            f'{scene.name} contains {len(hands)} obstacles with hand = "POSE.json", but a '
            "recording requires exactly one.",
            code="unknown_key",
        )
    ((key, table),) = hands.items()
    left_out: Row = {
        f"{key}.{name}": None for name in ("gap", "pose") if getattr(table, name) is not None
    }
    setup = read_scene(scene)
    writable_folder(folder)
    points: list[Row] = []
    for frame in load_recording(recording, leave_out=True).frames:
        if frame.landmarks is None:
            continue
        content = {
            "positions_m": joints_of(setup.tracker.apply(frame.landmarks)).tolist(),
            "radii_m": setup.hands[0].radii.tolist(),
            "side": frame.side,
        }
        pose = json.dumps(content).encode()
        # Results are stored by the name of this file, so the name must depend on its content.
        digest = hashlib.blake2b(pose, digest_size=4).hexdigest()
        file = folder / f"{frame.side}_{frame.sequence}_{digest}.json"
        with whole_file(file) as partial_file:
            partial_file.write_bytes(pose)
        points.append({f"{key}.hand": str(file.resolve())} | left_out)
    return points


def _scene_file(scene: Path) -> SceneFile:
    with about(scene.name):
        return parse_scene(text_of(scene, LARGEST_SCENE_FILE))


def _words(data: Any) -> Iterator[str]:
    if isinstance(data, str):
        yield data
    elif isinstance(data, dict):
        yield from _words(list(data.values()))
    elif isinstance(data, list | tuple):
        for value in data:
            yield from _words(value)
