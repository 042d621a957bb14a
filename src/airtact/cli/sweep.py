"""``airtact sweep``: the pressure at the foci of a scene while keys of its file vary."""

import csv
import io
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from math import isfinite, prod
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

import airtact as at
from airtact.cli.console import QUIET, open_page, plain_table, show, wanted
from airtact.cli.options import INPUT, as_json, open_result, pictures, quiet, results, scene

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from airtact.setup.sweeping import Row

# Takes the points done, all points, and the points that failed
Count = Callable[[int, int, int], None]


@click.command(
    short_help="Make the drive of a scene at many points of its keys.",
    epilog='Example: airtact sweep pinch --vary "pinch.gap=0.008:0.016:5" --out out/gaps',
)
@scene
@results
@click.option(
    "--vary",
    "varied",
    multiple=True,
    metavar="PATH=LOW:HIGH:COUNT",
    help="A key and its values, such as foci[0].offset=0.0005:0.003:6; several make a grid.",
)
@click.option(
    "--recording", type=INPUT, help="Recording whose frames take the place of the scene's hand."
)
@click.option(
    "--processes",
    "wanted_processes",
    type=click.IntRange(min=1),
    help="How many; by default as processors and memory allow.",
)
@click.option("--dask", metavar="ADDRESS", help="Dask scheduler, such as tcp://10.0.0.1:8786.")
@pictures
@open_result
@as_json
@quiet
def sweep(
    scene: Path,
    folder: Path,
    varied: tuple[str, ...],
    recording: Path | None,
    wanted_processes: int | None,
    dask: str | None,
    pictures: bool,
    opened: bool,
) -> None:
    """Make the drive of SCENE at every point and write sweep.csv and sweep.html.

    PATH is a key of the scene file: foci[0].offset, medium.celsius,
    obstacles[0].pose.translation[2], or short for the only body of a kind: hand.gap, pinch.gap,
    sphere.radius. The result of each point is kept in the folder: the same command goes on where it
    was stopped. A point that fails is a row with its sentence.
    """
    table = folder / "sweep.csv"
    page = folder / "sweep.html"
    store = folder / "points"
    with counting() as count:
        from airtact.files.atomic import writable_folder
        from airtact.reports.sweep_page import Swept, write_sweep_page
        from airtact.setup.scene_points import scene_points
        from airtact.setup.sweeping import process_count, processes

        points = _points(varied, recording)
        function = scene_points(scene, recording)
        memory = function.memory(points)
        writable_folder(folder)
        # Of an older run with other points; results of points are kept.
        for file in (table, page):
            file.unlink(missing_ok=True)
        if dask is None:
            executor = processes(process_count(len(points), wanted_processes, memory))
        else:
            executor = _dask_executor(dask)
        try:
            with executor as pool:
                rows = at.sweep(function, points, pool, store, progress=count)
        except KeyboardInterrupt:
            count = len(list(store.glob("*.point.json")))
            raise KeyboardInterrupt(
                f"{count} points in {store} kept; the same command goes on from there"
            ) from None
        names = list(points[0])
        write_csv(table, rows, names)
        swept = Swept(scene.stem.replace("_", " "), scene.read_text("utf-8"), tuple(names), rows)
        if pictures:
            write_sweep_page(page, swept)
    tables = []
    failed = swept.failed
    if len(failed) < len(rows):
        import numpy as np

        summary = plain_table("points", "failed", "weakest focus, median", "least", "most")
        weakest = swept.numbers("weakest_Pa")
        figures = np.nanmedian(weakest), np.nanmin(weakest), np.nanmax(weakest)
        summary.add_row(
            f"{len(rows):,}", f"{len(failed):,}", *(f"{figure:,.0f} Pa" for figure in figures)
        )
        tables.append(summary)
    warnings = []
    if failed:
        warnings.append(
            f"{len(failed)} of {len(rows)} points failed; the first: {failed[0]['sentence']}"
        )
    files = [table, page] if pictures else [table]
    show(
        *tables,
        warnings=warnings,
        lines=[f"Report: {page}" if pictures else f"Table: {table}"],
        record={
            "points": len(rows),
            "failed": len(failed),
            "varied": names,
            "files": {file.name: str(file) for file in files},
        },
    )
    if opened:
        open_page(page)


def _points(varied: Sequence[str], recording: Path | None) -> "list[Row]":
    from airtact.setup.scene_points import FRAME_COLUMNS, frames_of
    from airtact.setup.sweeping import MAX_POINTS

    points = grid_of(varied)
    if recording is not None:
        for column in set(FRAME_COLUMNS) & points[0].keys():
            raise at.InvalidInput(
                f"{column} is given by the recording, so it cannot be varied; leave it out.",
                code="given_twice",
            )
        # The grid at each frame, frame by frame.
        points = [frame | point for frame in frames_of(recording) for point in points]
    if not points or not points[0] or len(points) > MAX_POINTS:
        count = len(points) if varied or recording else 0
        raise at.InvalidInput(
            f"there are {count:,} points to vary; give 1 to {MAX_POINTS:,}, such as "
            '--vary "foci[0].offset=0.0005:0.003:6".',
            code="out_of_range",
        )
    return points


def grid_of(varied: Sequence[str]) -> "list[Row]":
    """Return the points of a grid from "PATH=LOW:HIGH:COUNT" each, the last one varying fastest.

    Values are integers where both ends are written as such and all between are.

    Examples
    --------
    >>> grid_of(["a=0:1:2", "b=0.5:1:2"])
    [{'a': 0, 'b': 0.5}, {'a': 0, 'b': 1.0}, {'a': 1, 'b': 0.5}, {'a': 1, 'b': 1.0}]
    """
    from airtact.setup.sweeping import MAX_POINTS

    axes: dict[str, Sequence[float | int]] = {}
    for words in varied:
        match = re.fullmatch(r"([^=]+)=([^:]+):([^:]+):([^:]+)", words)
        values = _values(*match.groups()[1:]) if match else None
        if match is None or values is None:
            raise at.InvalidInput(
                f'--vary "{words}" is not PATH=LOW:HIGH:COUNT with two numbers and a count from 1 '
                f"to {MAX_POINTS:,}, "
                'such as "foci[0].offset=0.0005:0.003:6".',
                code="out_of_range",
            )
        path = match[1].strip()
        # linspace would drop the upper end without a word.
        if len(values) == 1 and float(match[3]) != values[0]:
            raise at.InvalidInput(
                f'--vary "{words}" has 1 point but two ends: give a count of 2 or more, or one '
                "value as both ends.",
                code="out_of_range",
            )
        if path in axes:
            raise at.InvalidInput(f"{path} is varied twice; give it once.", code="given_twice")
        axes[path] = values
    total = prod(map(len, axes.values()))
    if total > MAX_POINTS:
        raise at.InvalidInput(
            f"the grid has {total:,} points, more than {MAX_POINTS:,}.", code="out_of_range"
        )
    return [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]


def _values(low: str, high: str, count: str) -> Sequence[float | int] | None:
    """Return the values of an axis, or None where its words are no numbers."""
    import numpy as np

    from airtact.setup.sweeping import MAX_POINTS

    try:
        first = float(low)
        last = float(high)
        number = int(count)
    except ValueError:
        return None
    if not (1 <= number <= MAX_POINTS and isfinite(first) and isfinite(last)):
        return None
    # Keys that are counts take integers only, so 0:4:5 gives 0 to 4 and not 0.0 to 4.0.
    values = np.linspace(first, last, number).tolist()
    integers = all(re.fullmatch(r"[+-]?\d+", end.strip()) for end in (low, high))
    if integers and all(value.is_integer() for value in values):
        return [int(value) for value in values]
    return values


@contextmanager
def _dask_executor(address: str) -> "Iterator[Executor]":
    from airtact.errors import InvalidInput, extra

    with extra("dask", "a sweep on a cluster needs Dask"):
        from distributed import Client
    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError) as fault:
        raise InvalidInput(
            f"no Dask scheduler answers at {address} within 10 s ({fault}): give the address that "
            "it prints, such as tcp://10.0.0.1:8786.",
            code="child_failed",
        ) from None
    with client:
        yield client.get_executor()


def write_csv(file: Path, rows: "Sequence[Row]", varied: Sequence[str]) -> None:
    """Write rows as CSV: varied values with 12 digits, results with 6.

    A value that a row lacks is empty.
    """
    from airtact.files.atomic import whole_file

    # Rows of failed points lack the results, so columns are those of all rows; faults come last.
    names = dict.fromkeys(name for row in rows for name in row)
    columns = [name for name in names if name not in ("error", "sentence")]
    columns += ["error", "sentence"]
    stream = io.StringIO(newline="")
    writer = csv.writer(stream)
    writer.writerow(columns)
    for row in rows:
        words = []
        for name in columns:
            value = row.get(name)
            # 12 digits give a varied value back; of a result 6 are more than its accuracy.
            if isinstance(value, float):
                value = f"{value:.{12 if name in varied else 6}g}"
            words.append("" if value is None else str(value))
        writer.writerow(words)
    with whole_file(file) as partial:
        partial.write_bytes(stream.getvalue().encode())


@contextmanager
def counting() -> Iterator[Count]:
    """Show the points done and the time left: a bar in a terminal, else a line from time to time.

    None if quiet.
    """
    console = Console(stderr=True)
    if wanted(QUIET):
        yield lambda done, total, failed: None
        return
    if not console.is_terminal:
        yield _count_in_lines()
        return
    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=console) as shown:
        tasks = []

        def count(done: int, total: int, failed: int) -> None:
            if not tasks:
                # Points kept from an earlier run do not count for the time left.
                tasks.append(shown.add_task("", total=total, completed=done))
            words = f"left, [red]{failed} failed[/red]" if failed else "left"
            shown.update(tasks[0], completed=done, description=words)

        yield count


def _count_in_lines() -> Count:
    # The first count is that of an earlier run's points, which took no time in this one.
    begun = time.perf_counter()
    earlier = -1
    last = 0.0

    def count(done: int, total: int, failed: int) -> None:
        nonlocal earlier, last
        passed = time.perf_counter() - begun
        if earlier < 0:
            earlier = done
        if done not in (total, earlier) and passed - last <= 10.0:
            return
        last = passed
        words = f"{passed:7.1f} s  {done:,} of {total:,} points"
        if failed:
            words += f", {failed} failed"
        if earlier < done < total:
            words += f", {passed / (done - earlier) * (total - done):.0f} s left"
        click.echo(words, err=True)

    return count
