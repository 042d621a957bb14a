"""What all commands print alike: progress, warnings, plain tables."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import click
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table


def warn(console: Console, sentences: Sequence[str]) -> None:
    """Print warnings, a line each."""
    for sentence in sentences:
        console.print(f"[yellow]Warning:[/yellow] {escape(sentence)}", soft_wrap=True, highlight=False)


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """Show steps as they begin: live with the time each takes in a terminal, else one line each."""
    console = Console(stderr=True)
    if not console.is_terminal:
        begun = time.perf_counter()
        yield lambda step: click.echo(f"{time.perf_counter() - begun:7.1f} s  {step}", err=True)
        return
    columns = SpinnerColumn(finished_text="[green]✓"), TimeElapsedColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console) as steps:

        def finish() -> None:
            for task in steps.tasks:
                steps.update(task.id, completed=1)

        def report_step(step: str) -> None:
            finish()
            steps.add_task(step, total=1)

        yield report_step
        finish()


def plain_table(*columns: str) -> Table:
    """Begin a table; it has a head where a column has a name, and all but its first column are numbers then."""
    table = Table(box=SIMPLE, show_header=any(columns))
    for index, column in enumerate(columns):
        table.add_column(column, justify="right" if index and any(columns) else "left")
    return table
