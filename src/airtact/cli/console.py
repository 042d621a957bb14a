"""Output that the commands share: progress, warnings, tables, and results as JSON."""

import json
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import click
from rich.box import SIMPLE
from rich.console import Console, ConsoleOptions, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

import airtact as at
from airtact.timing import Progress as Step

# Keys of click's context for --json and --quiet
JSON, QUIET = "airtact.json", "airtact.quiet"


def printable(text: str) -> str:
    r"""Remove control characters, and marks that change the direction of text in a terminal.

    Examples
    --------
    >>> printable("thumb\x1b[31m\u202e")
    'thumb[31m'
    """
    return "".join(character for character in text if character.isprintable() or character == "\n")


class Terminal(Console):
    """A console that removes control characters, which text from files may contain."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterator[Segment]:
        """Render like the base class, but remove control characters."""
        for segment in super().render(renderable, options):
            # Segments with ``control`` were added by rich itself, for example to move the cursor.
            yield segment if segment.control else segment._replace(text=printable(segment.text))


def say(text: str) -> None:
    """Print a line to standard error, without control characters."""
    click.echo(printable(text), err=True)


def wanted(key: str) -> bool:
    """Return whether the running command was called with the option ``JSON`` or ``QUIET``."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(key))


@contextmanager
def progress(first: str | None = None) -> Iterator[Step]:
    """Show a first step; yield a function that shows each further step as it begins.

    A terminal shows a live display with the time of each step; a pipe receives one line per step.
    With ``--quiet``, nothing is shown.
    """
    console = Terminal(stderr=True)
    if wanted(QUIET):
        yield lambda step: None
        return
    # In a log file, a live display would leave control characters.
    if not console.is_terminal:
        begun = time.perf_counter()

        def line(step: str) -> None:
            say(f"{time.perf_counter() - begun:7.1f} s  {step}")

        if first is not None:
            line(first)
        yield line
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
            steps.add_task(escape(step), total=1)

        if first is not None:
            begin(first)
        yield begin
        finish()


@contextmanager
def status_line() -> Iterator[Callable[[object], None]]:
    """Yield a function that shows the current status; with ``--quiet``, nothing is shown.

    A terminal shows one line, which is rewritten; a pipe receives one line per change of state.
    """
    console = Terminal(stderr=True)
    if wanted(QUIET):
        yield lambda status: None
        return
    if not console.is_terminal:
        last = ""

        def line(status: object) -> None:
            nonlocal last
            # The numbers change twice a second, which is too often for a log.
            state = re.sub(r"[\d.]+", "", re.sub(r"(, \d+ drives/s.*)", "", str(status)))
            if state != last:
                say(str(status))
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
    """Print a headline, tables, warnings, and lines such as the names of written files.

    With ``--quiet``, only the warnings are printed. With ``--json``, the record, the warnings and
    the version are printed to standard output, and everything else to standard error.
    """
    from airtact.errors import one_sentence  # importing NumPy here does not delay --help

    # The standard output only contains the result, so that it can be piped.
    console = Terminal(stderr=wanted(JSON) or wanted(QUIET))
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
        result = msgspec.json.encode({**about, **record, "warnings": warnings}).decode()
        # Write these characters as JSON escapes.
        click.echo(re.sub(r"[^\x20-\x7e]", lambda found: json.dumps(found[0])[1:-1], result))


def open_page(page: Path) -> None:
    """Show a page in the browser; if no browser is found, print the path of the page."""
    import webbrowser

    if not webbrowser.open(page.resolve().as_uri()):
        show(warnings=[f"no browser was found: open {page} manually."])


def plain_table(*columns: str) -> Table:
    """Return an empty table, with a header if columns are named.

    All columns except the first contain numbers.
    """
    table = Table(box=SIMPLE, show_header=any(columns))
    for index, column in enumerate(columns or ("", "")):
        table.add_column(column, justify="right" if index and any(columns) else "left")
    return table


def facts_table(facts: Sequence[tuple[str, str]]) -> Table:
    """Return a two-column table of names and values."""
    table = plain_table()
    for fact in facts:
        table.add_row(*fact)
    return table


def repairs_table(surface: "at.Surface", name: str = "") -> Table:
    """Return a table of the repairs of a surface."""
    table = plain_table()
    for index, note in enumerate(surface.repairs or ("nothing",)):
        table.add_row(
            escape(f"repaired in {name}" if name else "repaired") if index == 0 else "",
            escape(note),
        )
    return table


def sharp_edges_in_words(surface: "at.Surface") -> str:
    """Describe the edges that stay sharp when a surface is curved: number and total length."""
    from airtact.reports.body_figure import sharp_edges

    sharp = sharp_edges(surface)
    if not sharp.any():
        return f"none with an angle above {surface.sharp_degrees:g}°"
    length = 1e3 * surface.edge_lengths[sharp].sum() / 2
    return (
        f"{int(sharp.sum()) // 2:,} with a total length of {length:.4g} mm "
        f"(angle above {surface.sharp_degrees:g}° or rim of a flat cap)"
    )
