"""What all commands print alike: progress, warnings, tables, and the result as JSON."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import click
from rich.box import SIMPLE
from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

import airtact as at
from airtact.timing import Progress as Step

# Where click keeps that the result is wanted as JSON, or that only faults and warnings are
JSON, QUIET = "airtact.json", "airtact.quiet"


def wanted(key: str) -> bool:
    """Return whether the running command was given ``--json`` (`JSON`) or ``--quiet`` (`QUIET`)."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(key))


@contextmanager
def progress() -> Iterator[Step]:
    """Show steps as they begin: live with the time each takes in a terminal, else one line each.

    None if quiet.
    """
    console = Console(stderr=True)
    if wanted(QUIET):
        yield lambda step: None
        return
    # A log or a pipe gets lines, since a live display would fill it with control characters.
    if not console.is_terminal:
        begun = time.perf_counter()
        yield lambda step: click.echo(f"{time.perf_counter() - begun:7.1f} s  {step}", err=True)
        return
    columns = (
        SpinnerColumn(finished_text="[green]✓"),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=console) as steps:

        def finish() -> None:
            for task in steps.tasks:
                steps.update(task.id, completed=1)

        def begin(step: str) -> None:
            finish()
            steps.add_task(step, total=1)

        yield begin
        finish()


@contextmanager
def status_line() -> Iterator[Callable[[object], None]]:
    """Show what is reported on one line that is rewritten, in a terminal.

    Else a line each; nothing if quiet.
    """
    console = Console(stderr=True)
    if wanted(QUIET):
        yield lambda status: None
        return
    if not console.is_terminal:
        last = ""

        def line(status: object) -> None:
            nonlocal last
            state = str(status).partition(",")[0]
            # Numbers change twice a second; a log gets a line when the state changes.
            if state != last:
                click.echo(str(status), err=True)
            last = state

        yield line
        return
    with Live(console=console, refresh_per_second=4) as shown:
        yield lambda status: shown.update(Text(str(status), no_wrap=True, overflow="ellipsis"))


def show(
    *tables: Table,
    first: Sequence[str] = (),
    warnings: Sequence[str] = (),
    lines: Sequence[str] = (),
    record: Mapping | None = None,
) -> None:
    """Print what comes first, tables, warnings, and lines that say which files were written.

    With ``--quiet`` only the warnings are printed. With ``--json`` the record, with the warnings
    and the version, is all that stands on the standard output, and the rest goes to the standard
    error.
    """
    from airtact.errors import one_sentence  # only now, so that --help comes at once

    # Standard output is for the result alone, so that it can be piped.
    console = Console(stderr=wanted(JSON) or wanted(QUIET))
    for index, line in enumerate(() if wanted(QUIET) else first):
        console.print(
            escape(line), soft_wrap=True, highlight=False, style=None if index else "bold"
        )
    for table in () if wanted(QUIET) else tables:
        console.print(table)
    for sentence in map(one_sentence, warnings):
        console.print(
            f"[yellow]Warning:[/yellow] {escape(sentence)}", soft_wrap=True, highlight=False
        )
    for line in () if wanted(QUIET) else lines:
        console.print(escape(line), soft_wrap=True, highlight=False)
    if record is not None and wanted(JSON):
        import msgspec

        about = {"airtact": at.__version__, "command": click.get_current_context().info_name}
        click.echo(msgspec.json.encode({**about, **record, "warnings": warnings}))


def open_page(page: Path) -> None:
    """Show a page in the browser, or write where it is if there is none."""
    import webbrowser

    if not webbrowser.open(page.resolve().as_uri()):
        show(warnings=[f"no browser was found here; open {page} in one."])


def plain_table(*columns: str) -> Table:
    """Begin a table, with a head if columns are named; all but the first are numbers."""
    table = Table(box=SIMPLE, show_header=any(columns))
    for index, column in enumerate(columns or ("", "")):
        table.add_column(column, justify="right" if index and any(columns) else "left")
    return table


def facts_table(facts: Sequence[tuple[str, str]]) -> Table:
    """Tabulate facts by their names."""
    table = plain_table()
    for fact in facts:
        table.add_row(*fact)
    return table


def repairs_table(surface: "at.Surface", name: str = "") -> Table:
    """Tabulate what was repaired in a surface."""
    table = plain_table()
    for index, note in enumerate(surface.repairs or ("nothing",)):
        table.add_row(
            escape(f"repaired in {name}" if name else "repaired") if index == 0 else "",
            escape(note),
        )
    return table


def sharp_edges_in_words(surface: "at.Surface") -> str:
    """Count the edges that stay sharp when a surface is curved, and add up their lengths."""
    from airtact.reports.body_figure import sharp_edges

    sharp = sharp_edges(surface)
    length = 1e3 * surface.edge_lengths[sharp].sum() / 2
    count = int(sharp.sum()) // 2
    if count == 0:
        return f"none turns by over {surface.sharp_degrees:g}°"
    turn = f"turn by over {surface.sharp_degrees:g}° or end a flat cap"
    return f"{count:,}, {length:.4g} mm together, that {turn}"
