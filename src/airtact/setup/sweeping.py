"""Sweeps: a function, or the drive of a scene file, at many points on any executor."""

import functools
import hashlib
import json
import os
import pickle
import signal
import sys
import threading
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager, nullcontext
from dataclasses import is_dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from airtact.acoustics.solvers.memory import available_memory, processor_count
from airtact.acoustics.store import name_of
from airtact.errors import InvalidInput, NotConverged, of_kind, one_sentence
from airtact.files.atomic import whole_file, writable_folder
from airtact.setup.scene_points import ScenePoints, scene_points
from airtact.setup.setup import Setup

Value = str | float | int | bool | None
Row = dict[str, Value]
# What a sweep computes at each point
Function = Callable[[Row], Mapping[str, Value]]

# Largest number of points of a sweep
MAX_POINTS = 1_000_000

# End of the name of a file with the result of a point
SUFFIX = ".point.json"


def sweep(
    function: Function | Setup | str | Path,
    points: Sequence[Mapping[str, Value]],
    executor: Executor | None = None,
    store: str | Path | None = None,
    *,
    progress: Callable[[int, int, int], None] | None = None,
) -> list[Row]:
    """Compute a function at many points, and return a row for each, in their order.

    Parameters
    ----------
    function : a scene file or its setup, to make the drive with other values of the file's keys,
        see ``scene_points``. Or a function that takes a point and returns names with a value each:
        numbers, text, True, False or None. A process must be able to import it: it stands in a
        module, or is a ``functools.partial`` of one that does. A script that calls ``sweep`` does
        so under ``if __name__ == "__main__":``.
    points : names with a value each; for a scene the paths of keys, such as ``"foci[0].offset"``.
    executor : computes the points, such as ``ThreadPoolExecutor()`` or the ``get_executor()`` of
        Dask's client. By default processes, one a processor, each with one thread.
    store : folder in which the result of each point is a file, named by the point, the function,
        its arguments, its file and airtact's. What is there is not computed again, so that a sweep
        that was killed goes on. Take another folder where another module that the function uses has
        changed.
    progress : is called with the numbers of points done, of all points and of points that failed.

    Returns
    -------
    For each point its values, then the results; ``"error"`` and ``"sentence"`` are empty, or the
    code and the sentence
    of what was raised there.

    Raises
    ------
    InvalidInput
        The points are of the wrong kind, the function cannot be passed to a process or its results
        cannot be kept, the folder takes no files, or a process ended by itself. Where a function
        raises, the sweep goes on.

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
            f"the function of a sweep is {function!r}, which cannot be called.", code="wrong_kind"
        )
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise InvalidInput(
            f"the executor is a {type(executor).__name__}, but it must be one such as "
            "ThreadPoolExecutor(4), or None for processes.",
            code="wrong_kind",
        )
    rows = _checked_points(points)
    if store is None:
        folder = None
        names = [str(index) for index in range(len(rows))]
        results: dict[str, Row] = {}
    else:
        folder = writable_folder(Path(of_kind(store, str | Path, "the store", "a path")))
        names = names_of(function, rows)
        results = _kept(folder, names)

    waiting = {name: row for name, row in zip(names, rows, strict=True) if name not in results}
    total = len(set(names))
    failed = sum(bool(row["error"]) for row in results.values())
    if progress is not None:
        progress(len(results), total, failed)
    for name, row in _computed(function, waiting, executor):
        # Faults of the moment are not kept, so that the next run tries these points again.
        passing = ("file_failed", "file_missing", "file_unreadable", "too_little_memory")
        if folder is not None and row["error"] not in passing:
            with whole_file(folder / (name + SUFFIX)) as partial:
                partial.write_text(json.dumps({"name": name, "row": row}), encoding="utf-8")
        results[name] = row
        failed += bool(row["error"])
        if progress is not None:
            progress(len(results), total, failed)
    return [{**row, **results[name]} for name, row in zip(names, rows, strict=True)]


def _checked_points(points: Sequence[Mapping[str, Value]]) -> list[Row]:
    if not isinstance(points, Iterable) or isinstance(points, str | Mapping):
        raise InvalidInput(
            f"the points of a sweep are a {type(points).__name__}, but they must be a list of "
            "names with a value each, "
            'such as [{"gap": 0.012}, {"gap": 0.014}].',
            code="wrong_kind",
        )
    rows = [_checked_row(point, f"point {index}") for index, point in enumerate(points)]
    taken = sorted({"error", "sentence"}.intersection(*[set().union(*rows)]))
    if taken:
        raise InvalidInput(
            f"the names {', '.join(taken)} of the points are columns of the result; rename them.",
            code="given_twice",
        )
    if not 1 <= len(rows) <= MAX_POINTS:
        raise InvalidInput(
            f"there are {len(rows):,} points; give 1 to {MAX_POINTS:,}.", code="out_of_range"
        )
    return rows


def _checked_row(values: Mapping[str, Any], label: str) -> Row:
    if not isinstance(values, Mapping):
        raise InvalidInput(
            f"{label} is a {type(values).__name__}, but it must be names with a value each, such "
            "as "
            '{"gap": 0.012}.',
            code="wrong_kind",
        )
    row: Row = {}
    for name, value in values.items():
        plain = value.item() if isinstance(value, np.generic) else value
        if not isinstance(name, str) or not (plain is None or isinstance(plain, str | float | int)):
            raise InvalidInput(
                f"{label} has {name!r} = a {type(value).__name__}, but names are text and values "
                "single numbers, text, true, false or None.",
                code="wrong_kind",
            )
        row[name] = plain
    return row


def _attempt(function: Function, point: Row) -> Row:
    # A fault becomes a row with its code and sentence, so that the sweep goes on.
    try:
        result = _checked_row(function(dict(point)), "the result")
        taken = sorted({*point, "error", "sentence"} & result.keys())
        if taken:
            raise InvalidInput(
                f"the columns {', '.join(taken)} of the result are taken.", code="given_twice"
            )
    except (InvalidInput, NotConverged) as fault:
        return {"error": fault.code, "sentence": str(fault)}
    except MemoryError:
        sentence = "the memory is full: run fewer processes."
        return {"error": "too_little_memory", "sentence": sentence}
    except OSError as fault:
        sentence = f"{fault.filename or 'a file'}: {fault.strerror or fault}"
        return {"error": "file_failed", "sentence": one_sentence(sentence)}
    except (Exception, SystemExit) as fault:
        sentence = f"{type(fault).__name__}: {fault}"
        return {"error": "function_failed", "sentence": one_sentence(sentence)}
    return {**result, "error": "", "sentence": ""}


def _computed(
    function: Function, waiting: Mapping[str, Row], executor: Executor | None
) -> Iterator[tuple[str, Row]]:
    """Yield names and results as they are done, and leave nothing running when it is left."""
    if not waiting:
        return
    if executor is None:
        # A pool raises what cannot be pickled from within, without saying which object it is.
        try:
            pickle.dumps(function)
        except Exception as fault:
            raise InvalidInput(
                f"the function cannot be passed to a process ({fault}): define it in a module, or "
                "give an executor of threads.",
                code="wrong_kind",
            ) from None
        points = list(waiting.values())
        memory = function.memory(points) if isinstance(function, ScenePoints) else None
        running = processes(process_count(len(points), memory=memory))
    else:
        running = nullcontext(executor)
    with running as pool:
        futures = {pool.submit(_attempt, function, point): name for name, point in waiting.items()}
        try:
            for future in as_completed(futures):
                yield futures.pop(future), future.result()
        except BrokenExecutor:
            raise InvalidInput(
                f"a process ended by itself with {len(futures)} of {len(waiting)} points left, as "
                "where memory runs "
                'out, or where a script calls sweep outside of if __name__ == "__main__": what is '
                "in the store stays.",
                code="link_closed",
            ) from None
        finally:
            for future in futures:
                future.cancel()


def process_count(points: int, limit: int | None = None, memory: float | None = None) -> int:
    """Return the number of processes for some points, each of which takes some memory [bytes].

    That is one a processor, or as many as ``wanted``, no more than points, and no more than fit
    into 80 % of the memory that is available. Raise "too_little_memory" where not even one fits.
    """
    count = min(processor_count() if limit is None else limit, points)
    if memory is None:
        return max(1, count)
    free = available_memory()
    if memory > free:
        raise InvalidInput(
            f"one point takes about {memory / 1e9:.2g} GB, and {free / 1e9:.2g} GB are available: "
            "end other programs, or ask for less accuracy.",
            code="too_little_memory",
        )
    return int(max(1, min(count, 0.8 * free / memory)))


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Start processes, which end with the block, by an error, or with this program."""
    # A forked child inherits threads' locks in whatever state they are, and may hang.
    context = get_context("spawn")
    # The processes end when this end of the pipe closes, which a killed program does too.
    watched, held = context.Pipe(duplex=False)
    arguments: Any = (watched,)  # a connection only in name on Windows
    pool = ProcessPoolExecutor(
        count, mp_context=context, initializer=_begin_process, initargs=arguments
    )
    try:
        yield pool
        pool.shutdown()
    finally:
        held.close()
        pool.shutdown(cancel_futures=True)
        watched.close()


def _begin_process(watched: Connection) -> None:
    """Take one thread for linear algebra, leave Ctrl-C to the parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # of libraries that are loaded later
    threadpool_limits(1)  # of those that are loaded already

    def end_with_parent() -> None:
        try:
            watched.recv()
        except (EOFError, OSError):
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def names_of(function: Function, points: Iterable[Row]) -> list[str]:
    """Name points by their values and the function, with 40 hexadecimal digits each.

    A function counts by the file of its module, its name and its default arguments; a
    ``functools.partial`` also by its arguments; an object of a dataclass by its fields, except
    those that take no part in comparisons.
    """
    # The digest of the function includes airtact's version and code, see the store.
    function_name = name_of(*_parts(function))

    def name(point: Row) -> str:
        text = json.dumps([function_name, sorted(point.items())], ensure_ascii=True)
        return hashlib.blake2b(text.encode(), digest_size=20).hexdigest()

    return [name(point) for point in points]


def _parts(function: Any) -> list[Any]:
    if isinstance(function, functools.partial):
        return [*_parts(function.func), list(function.args), dict(function.keywords)]
    if isinstance(function, types.FunctionType):
        if function.__closure__ or "<" in function.__qualname__:
            raise InvalidInput(
                f"the name {function.__qualname__} does not identify a function: define it in a "
                "module, and pass what it needs by functools.partial.",
                code="does_not_match",
            )
        return [
            *_module_of(function),
            function.__qualname__,
            list(function.__defaults__ or ()),
            dict(function.__kwdefaults__ or {}),
        ]
    if not is_dataclass(function) or isinstance(function, type):
        raise InvalidInput(
            f"a {type(function).__name__} cannot be compared with another one, so its results "
            "cannot be kept: give a function of a module, or an object of a dataclass.",
            code="does_not_match",
        )
    return [*_module_of(type(function)), function]


def _module_of(definition: type | types.FunctionType) -> list[str]:
    # An edited module may compute something else, so its content belongs to the name.
    file = getattr(sys.modules.get(definition.__module__), "__file__", None)
    content = Path(file).read_bytes() if file else b""
    return [definition.__module__, hashlib.blake2b(content).hexdigest()]


def _kept(folder: Path, names: Iterable[str]) -> dict[str, Row]:
    results = {}
    for name in names:
        try:
            content = json.loads((folder / (name + SUFFIX)).read_bytes())
        except (OSError, ValueError):
            continue
        if not isinstance(content, dict) or content.get("name") != name:
            continue
        row = content.get("row")
        if isinstance(row, dict) and {"error", "sentence"} <= row.keys():
            results[name] = row
    return results
