"""``airtact sweep``: vary keys of a scene file and tabulate the pressure at the foci."""

import csv
import re
import time
from collections.abc import Sequence
from itertools import product
from math import isfinite, prod
from pathlib import Path
from typing import TYPE_CHECKING

import click

import airtact as at
from airtact.cli.console import open_page, plain_table, show, status_line
from airtact.cli.options import INPUT, as_json, open_result, pictures, quiet, results, scene

if TYPE_CHECKING:
    from airtact.setup.sweeping import Row


@click.command(
    short_help="Compute the drives of a scene for many values of its keys.",
    epilog='Example: airtact sweep pinch --vary "pinch.gap=0.008:0.016:5" --out out/gaps',
)
@scene
@results
@click.option(
    "--vary",
    "varied",
    multiple=True,
    metavar="PATH=LOW:HIGH:COUNT",
    help="A key and its values, such as foci[0].offset=0.0005:0.003:6; repeat it for a grid.",
)
@click.option(
    "--recording", type=INPUT, help="Recording whose frames replace the hand in the scene."
)
@click.option(
    "--processes",
    "processes",
    type=click.IntRange(min=1),
    help="Number of processes; by default as many as the processors and the memory allow.",
)
@pictures
@open_result
@as_json
@quiet
def sweep(
    scene: Path,
    folder: Path,
    varied: tuple[str, ...],
    recording: Path | None,
    processes: int | None,
    pictures: bool,
    opened: bool,
) -> None:
    """Compute the drive of SCENE for many values of its keys; write sweep.csv and sweep.html.

    PATH is a key of the scene file, such as foci[0].offset, medium.celsius or
    obstacles[0].pose.translation[2]. If there is only one body of a kind, hand.gap, pinch.gap or
    sphere.radius is sufficient. LOW and HIGH are the first and the last of COUNT evenly spaced
    values, in the unit of the key. With several --vary, all combinations of their values are
    computed; with --recording, all of them for each frame. The table has a row for each
    combination, with the pressures at the foci. Results are stored in the folder, so the same
    command resumes an interrupted sweep. If a combination fails, its row contains the error.
    """
    table = folder / "sweep.csv"
    page = folder / "sweep.html"
    store = folder / "points"
    with status_line() as report:
        from airtact.reports.sweep_page import Swept, write_sweep_page
        from airtact.setup.sweeping import frames_of

        if not varied and recording is None:
            raise at.InvalidInput(
                'nothing is varied: use an option such as --vary "foci[0].offset=0.0005:0.003:6".',
                code="data_missing",
            )
        points = grid_of(varied)
        if recording is not None:
            # One grid per frame
            hands = frames_of(scene, recording, folder / "hands")
            points = [hand | point for hand in hands for point in points]
        begun = time.perf_counter()
        stored: int | None = None

        def count(done: int, total: int, failed: int) -> None:
            nonlocal stored
            # The first count is that of stored points, which take no time.
            stored = done if stored is None else stored
            computed = done - stored
            left = (time.perf_counter() - begun) / computed * (total - done) if computed else 0.0
            report(f"{done / total:.0%} of {total:,} points, {failed} failed, {left:.0f} s left")

        try:
            rows = at.sweep(scene, points, processes, store, progress=count)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"{len(list(store.glob('*.point.json')))} points are stored in {store}; run the "
                "same command to continue"
            ) from None
        names = [name for name, value in points[0].items() if value is not None]
        write_csv(table, rows)
        swept = Swept(scene.stem.replace("_", " "), scene.read_text("utf-8"), tuple(names), rows)
        if pictures:
            write_sweep_page(page, swept)
        else:
            page.unlink(missing_ok=True)  # left from an older run with other points
    tables = []
    warnings = []
    failed = swept.failed
    if len(failed) < len(rows):
        import numpy as np

        tables = [plain_table("points", "failed", "weakest focus, median", "smallest", "largest")]
        weakest = swept.numbers("weakest_Pa")
        figures = np.nanmedian(weakest), np.nanmin(weakest), np.nanmax(weakest)
        tables[0].add_row(
            f"{len(rows):,}", f"{len(failed):,}", *(f"{figure:,.0f} Pa" for figure in figures)
        )
    if failed:
        warnings.append(
            f"{len(failed)} of {len(rows)} points failed; the first error is: "
            f"{failed[0]['sentence']}"
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


def grid_of(varied: Sequence[str]) -> "list[Row]":
    """Return the points of a grid from texts "PATH=LOW:HIGH:COUNT"; the last key varies fastest.

    Values are integers if both ends are written as integers and all values are whole.

    Examples
    --------
    >>> grid_of(["a=0:1:2", "b=0.5:1:2"])
    [{'a': 0, 'b': 0.5}, {'a': 0, 'b': 1.0}, {'a': 1, 'b': 0.5}, {'a': 1, 'b': 1.0}]
    """
    import numpy as np

    from airtact.setup.sweeping import MAX_POINTS

    axes: dict[str, Sequence[float | int]] = {}
    for words in varied:
        path, _, ends = words.partition("=")
        try:
            low, high, number = ends.split(":")
            count = int(number)
            first = float(low)
            last = float(high)
            # A count of 1 would silently ignore the upper limit.
            if not (isfinite(first + last) and 1 + (first != last) <= count <= MAX_POINTS):
                raise ValueError
        except ValueError:
            raise at.InvalidInput(
                f'--vary "{words}" does not have the form PATH=LOW:HIGH:COUNT, such as '
                '"foci[0].offset=0.0005:0.003:6". LOW and HIGH must be numbers. COUNT must be '
                f"from 2 to {MAX_POINTS:,}, or 1 if LOW and HIGH are equal.",
                code="out_of_range",
            ) from None
        values: list[float] = np.linspace(first, last, count).tolist()
        # Keys that are counts only accept integers.
        integers = all(re.fullmatch(r"[+-]?\d+", end.strip()) for end in (low, high))
        if integers and all(value.is_integer() for value in values):
            values = [int(value) for value in values]
        path = path.strip()
        if path in axes:
            raise at.InvalidInput(f"{path} is varied twice; vary it once.", code="given_twice")
        axes[path] = values
    total = prod(map(len, axes.values()))
    if total > MAX_POINTS:
        raise at.InvalidInput(
            f"the grid has {total:,} points, but at most {MAX_POINTS:,} are allowed: vary fewer "
            "values.",
            code="out_of_range",
        )
    return [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]


def write_csv(file: Path, rows: "Sequence[Row]") -> None:
    """Write rows as CSV, with 12 digits per number and empty cells for missing values."""
    from airtact.files.atomic import whole_file

    # Rows of failed points contain no results, so use the columns of all rows. Errors come last.
    names = dict.fromkeys(name for row in rows for name in row)
    faults = ("error", "sentence")
    with whole_file(file) as partial, partial.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [*(name for name in names if name not in faults), *faults])
        writer.writeheader()
        for row in rows:
            writer.writerow(
                {
                    name: f"{value:.12g}" if isinstance(value, float) else value
                    for name, value in row.items()
                }
            )
