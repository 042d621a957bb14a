"""A function at many points, in processes or on a cluster; a killed sweep is taken up again."""

import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, as_completed
from contextlib import nullcontext
from pathlib import Path

from airtact.checks import of_kind
from airtact.errors import InvalidInput
from airtact.files.atomic import writable_folder
from airtact.setup.sweeping.kept import keep, load, names_of
from airtact.setup.sweeping.processes import process_count, processes
from airtact.setup.sweeping.rows import (
    ERROR,
    PASSING,
    SENTENCE,
    Function,
    Row,
    Value,
    attempt,
    checked,
)

Count = Callable[[int, int, int], None]
"""What a sweep calls with the points done, all points, and the points that failed."""

MOST = 1_000_000
"""Largest number of points."""


def sweep(
    function: Function,
    points: Sequence[Mapping[str, Value]],
    executor: Executor | None = None,
    store: str | Path | None = None,
    *,
    progress: Count | None = None,
) -> list[Row]:
    """Compute a function at many points, and return a row for each, in their order.

    Parameters
    ----------
    function : takes a point and returns names with a value each: numbers, text, True, False or
        None. A process must be able to import it: it stands in a module, or is a
        ``functools.partial`` of one that does. A script that calls ``sweep`` does so under ``if
        __name__ == "__main__":``.
    points : names with a value each.
    executor : computes the points, such as ``ThreadPoolExecutor()`` or the ``get_executor()`` of
        Dask's client. By default processes, one a processor, each with one thread.
    store : folder in which the result of each point is a file, named by the point, the function,
        its arguments, its file and airtact's. What is there is not computed again, so that a sweep
        that was killed goes on. Take another folder where another module that the function uses has
        changed.
    progress : is called with the numbers of points done, of all points and of points that failed.

    Returns
    -------
    For each point its values, then the results; ``"error"`` and ``"sentence"`` are empty, or the code and the sentence
    of what was raised there.

    Raises
    ------
    InvalidInput
        The points are of the wrong kind, the function cannot be passed to a process or its results cannot be kept, the
        folder takes no files, or a process ended by itself. Where a function raises, the sweep goes on.

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
    if not callable(function):
        raise InvalidInput(
            f"the function of a sweep is {function!r}, which cannot be called.", code="wrong_kind"
        )
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise InvalidInput(
            f"the executor is a {type(executor).__name__}, but it must be one such as ThreadPoolExecutor(4), or None "
            "for processes.",
            code="wrong_kind",
        )
    rows = _checked(points)
    folder = (
        None
        if store is None
        else writable_folder(Path(of_kind(store, str | Path, "the store", "a path")))
    )
    names = (
        [str(index) for index in range(len(rows))] if folder is None else names_of(function, rows)
    )
    found = {} if folder is None else load(folder, names)
    _complete(found, function, dict(zip(names, rows, strict=True)), executor, folder, progress)
    return [{**row, **found[name]} for name, row in zip(names, rows, strict=True)]


def _complete(
    found: dict[str, Row],
    function: Function,
    points: Mapping[str, Row],
    executor: Executor | None,
    folder: Path | None,
    progress: Count | None,
) -> None:
    """Compute the points whose results are not found, and keep and count each result as it comes."""
    waiting = {name: point for name, point in points.items() if name not in found}
    failed = sum(bool(row[ERROR]) for row in found.values())
    count = progress or (lambda done, total, failed: None)
    count(len(found), len(points), failed)
    for name, row in _computed(function, waiting, executor):
        if folder is not None and row[ERROR] not in PASSING:
            keep(folder, name, row)
        found[name] = row
        failed += bool(row[ERROR])
        count(len(found), len(points), failed)


def _checked(points: Sequence[Mapping[str, Value]]) -> list[Row]:
    if not isinstance(points, Iterable) or isinstance(points, str | Mapping):
        raise InvalidInput(
            f"the points of a sweep are a {type(points).__name__}, but they must be a list of names with a value each, "
            'such as [{"gap": 0.012}, {"gap": 0.014}].',
            code="wrong_kind",
        )
    rows = [checked(point, f"point {index}") for index, point in enumerate(points)]
    taken = sorted({ERROR, SENTENCE}.intersection(*[set().union(*rows)]))
    if taken:
        raise InvalidInput(
            f"the points have {len(taken)} names that columns of the rows have: {', '.join(taken)}; rename them.",
            code="given_twice",
        )
    if not 1 <= len(rows) <= MOST:
        raise InvalidInput(
            f"there are {len(rows):,} points; give 1 to {MOST:,}.", code="out_of_range"
        )
    return rows


def _computed(
    function: Function, waiting: Mapping[str, Row], executor: Executor | None
) -> Iterator[tuple[str, Row]]:
    """Yield names and results as they are done, and leave nothing running when it is left."""
    if not waiting:
        return
    if executor is None:
        _check_passable(function)
        running = processes(process_count(len(waiting)))
    else:
        running = nullcontext(executor)
    with running as pool:
        futures = {pool.submit(attempt, function, point): name for name, point in waiting.items()}
        try:
            for future in as_completed(futures):
                yield futures.pop(future), future.result()
        except BrokenExecutor:
            raise InvalidInput(
                f"a process ended by itself with {len(futures)} of {len(waiting)} points left, as where memory runs "
                'out, or where a script calls sweep outside of if __name__ == "__main__": what is in the store stays.',
                code="link_closed",
            ) from None
        finally:
            for future in futures:
                future.cancel()


def _check_passable(function: Function) -> None:
    try:
        pickle.dumps(function)
    except Exception as fault:
        raise InvalidInput(
            f"the function cannot be passed to a process ({fault}): define it in a module, or give an executor of "
            "1 or more threads.",
            code="wrong_kind",
        ) from None
