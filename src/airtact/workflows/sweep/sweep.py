"""From a scene file and values of its keys to a table of what the foci get, and a page. Prints nothing."""

import logging
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.errors import InvalidInput, NotConverged, extra
from airtact.files.atomic import writable_folder
from airtact.reports.sweep_page import Swept, write_sweep_page
from airtact.setup.building import read_scene
from airtact.setup.solving import memory_of_a_solve, unknowns_of
from airtact.setup.sweeping.processes import PROCESS, process_count, processes
from airtact.setup.sweeping.rows import Row
from airtact.setup.sweeping.scene_point import FRAME, SIDE, TIME, ScenePoint, frames_of, scene_point
from airtact.setup.sweeping.sweep import MOST, Count
from airtact.setup.sweeping.sweep import sweep as swept_rows
from airtact.setup.sweeping.table import check_parquet, write_csv, write_parquet
from airtact.workflows.sweep.grid import grid_of

FILES = ("sweep.csv", "sweep.html", "sweep.parquet")
"""What a sweep writes; the last only where it is asked for."""

OF_A_PATH = (
    "unknown_key",
    "unknown_key",
    "out_of_range",
    "key_misplaced",
    "unknown_key",
    "given_twice",
)
"""Faults of what is varied, which no other point mends."""

STORE = "points"
"""Folder of the results of single points, beside the table."""


def sweep(
    scene: Path,
    varied: Sequence[str],
    folder: Path,
    count: Count | None = None,
    recording: Path | None = None,
    *,
    number: int | None = None,
    dask: str | None = None,
    parquet: bool = False,
    pictures: bool = True,
) -> Swept:
    """Make the drive at each point of a grid, and write a table of what the foci get, in the order of the points.

    Parameters
    ----------
    scene : a scene file.
    varied : "PATH=LOW:HIGH:COUNT" each; the last one varies fastest.
    folder : of `FILES` and of the results of the points, from which a sweep that was killed goes
        on.
    count : is called with the points done, all points and those that failed.
    recording : whose frames take the place of the hand, each at every point of the grid; or None.
    number : of processes; by default as many as there are processors and memory allows.
    dask : address of a Dask scheduler, or "local" for a cluster of ``number`` processes on this
        computer.
    parquet, pictures : whether the table is written as Parquet too, and whether the page is.

    Raises
    ------
    InvalidInput
        The scene, a path, the recording or the folder is at fault; nothing was solved then.
    """
    if parquet:
        check_parquet()
    grid = grid_of(varied)
    for own in {FRAME, SIDE, TIME} & grid[0].keys() if recording else ():
        raise InvalidInput(
            f"{own} is given by the recording, and varied 1 time more; leave it out.",
            code="given_twice",
        )
    points = [] if recording is None else frames_of(recording)
    points = [frame | point for frame in points for point in grid] if recording else grid
    if len(points) > MOST or not points or not points[0]:
        raise InvalidInput(
            f"there are {len(points) if varied or recording else 0:,} points to vary; give 1 to {MOST:,}, such as "
            '--vary "foci[0].offset=0.0005:0.003:6".',
            code="out_of_range",
        )
    function = scene_point(scene, recording)
    memory = _memory(function, points)
    writable_folder(folder)
    for name in FILES:
        (folder / name).unlink(missing_ok=True)
    with executor_of(dask, process_count(len(points), number, memory)) as executor:
        rows = swept_rows(function, points, executor, folder / STORE, progress=count)
    names = list(points[0])
    write_csv(folder / FILES[0], rows, names)
    if parquet:
        write_parquet(folder / FILES[2], rows)
    found = Swept(scene.stem.replace("_", " "), scene.read_text("utf-8"), tuple(names), rows)
    if pictures:
        write_sweep_page(folder / FILES[1], found)
    return found


def _memory(function: ScenePoint, points: Sequence[Row]) -> float:
    """Estimate the memory of a process from the first, the middle and the last point that can be built [bytes].

    The scene as it is and the paths of the keys are checked before.
    """
    read_scene(function.scene)
    needed, faults = PROCESS, []
    trials = [points[index] for index in sorted({0, len(points) // 2, len(points) - 1})]
    for point in trials:
        try:
            setup = function.setup(point)
            if isinstance(setup.solver, BoundaryElement):
                unknowns = unknowns_of(setup.solver, setup.scene, setup.target.points)
                needed = max(needed, memory_of_a_solve(unknowns, setup.accuracy))
        except (InvalidInput, NotConverged) as fault:
            if fault.code in OF_A_PATH:
                raise
            faults.append(fault)
    if len(faults) == len(points):
        raise faults[0]
    return needed


@contextmanager
def executor_of(dask: str | None, count: int) -> Iterator[Executor]:
    """Begin processes, a local cluster of Dask, or a client of the scheduler at an address."""
    if dask is None:
        with processes(count) as executor:
            yield executor
        return
    with extra("dask", "a sweep on a cluster needs Dask"):
        from distributed import Client, LocalCluster
    if dask == "local":
        settings: dict[str, Any] = {
            "threads_per_worker": 1,
            "dashboard_address": None,
            "silence_logs": logging.CRITICAL,
        }
        with LocalCluster(n_workers=count, **settings) as cluster, Client(cluster) as client:
            yield client.get_executor()
        return
    try:
        client = Client(dask, timeout=10)
    except (OSError, ValueError) as fault:
        raise InvalidInput(
            f"no Dask scheduler answers at {dask} within 10 s ({fault}): give the address that it prints, such as "
            "tcp://10.0.0.1:8786.",
            code="child_failed",
        ) from None
    with client:
        yield client.get_executor()
