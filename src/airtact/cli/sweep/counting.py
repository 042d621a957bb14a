"""How many points of a sweep are done, and the time left."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

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

from airtact.cli.console import QUIET, wanted

EVERY = 10.0
"""How often progress is printed where there is no terminal [s]."""


@contextmanager
def counting() -> Iterator[Callable[[int, int, int], None]]:
    """Show the points done and the time left: a bar in a terminal, else a line from time to time; none if quiet."""
    console = Console(stderr=True)
    if wanted(QUIET):
        yield lambda done, total, failed: None
        return
    if not console.is_terminal:
        yield _lines()
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
                tasks.append(
                    shown.add_task("", total=total, completed=done)
                )  # what was kept says nothing of the time
            words = "left" + (f", [red]{failed} failed[/red]" if failed else "")
            shown.update(tasks[0], completed=done, description=words)

        yield count


def _lines() -> Callable[[int, int, int], None]:
    begun, kept, last = time.perf_counter(), -1, 0.0

    def count(done: int, total: int, failed: int) -> None:
        nonlocal kept, last
        passed = time.perf_counter() - begun
        kept = done if kept < 0 else kept
        if done in (total, kept) or passed - last > EVERY:
            last = passed
            left = (
                f", {passed / (done - kept) * (total - done):.0f} s left"
                if kept < done < total
                else ""
            )
            words = f", {failed} failed" if failed else ""
            click.echo(f"{passed:7.1f} s  {done:,} of {total:,} points{words}{left}", err=True)

    return count
