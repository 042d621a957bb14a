"""The command line: parse, call, print. Exit codes: 0 done, 2 bad input or not converged, 130 broken off by Ctrl-C."""

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from airtact.conventions import InvalidInput, NotConverged

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from airtact.report.run_page import Run
    from airtact.scene_file.building import Setup


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments : what stands after the command's name; that of this process if not given.
    """
    try:
        commands.main(args=arguments, prog_name="airtact", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (InvalidInput, NotConverged) as error:
        return _fail(str(error), 2)
    except OSError as error:
        return _fail(f"{error.filename or 'a file'}: {error.strerror or error}", 2)
    except (KeyboardInterrupt, click.Abort):
        return _fail("broken off; what was finished is whole", 130)
    return 0


def _fail(sentence: str, code: int) -> int:
    click.echo(f"airtact: {sentence}", err=True)
    return code


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Example: airtact render examples/pinch.toml --out out/pinch",
)
@click.version_option(package_name="airtact", message="%(prog)s %(version)s")
def commands() -> None:
    """Compute what a phased array must emit so that a hand feels points while it scatters the sound."""


@commands.command(
    short_help="Say what is in a scene, or what is wrong with it.",
    epilog="Example: airtact check examples/pinch.toml",
)
@click.argument("scene", type=click.Path(path_type=Path))
def check(scene: Path) -> None:
    """Read SCENE, say what is in it and what solving it will take, or what is wrong with it."""
    from rich.console import Console

    from airtact.scene_file.building import read_setup

    setup = read_setup(scene)
    console = Console()
    for table in _summary(setup):
        console.print(table)


@commands.command(
    short_help="Compute the drive and the field for a scene.",
    epilog="Example: airtact render examples/pinch.toml --out out/pinch",
)
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--out", "folder", required=True, type=click.Path(path_type=Path), help="Folder for the results.")
def render(scene: Path, folder: Path) -> None:
    """Compute the drive and the field for SCENE and write drive.csv, drive.h5, field.vtkhdf and report.html."""
    from rich.console import Console

    with _progress(Console(stderr=True)) as tell:
        tell("starting")
        from airtact.render import render as run_render

        run = run_render(scene, folder, tell)
    console = Console()
    console.print(_results(run))
    console.print(f"The page of this run: {folder / 'report.html'}", soft_wrap=True, highlight=False)


@contextmanager
def _progress(console: "Console") -> Iterator[Callable[[str], None]]:
    """Show steps as they begin: live with the time each takes in a terminal, else one line each."""
    if not console.is_terminal:
        begun = time.perf_counter()
        yield lambda step: click.echo(f"{time.perf_counter() - begun:7.1f} s  {step}", err=True)
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = SpinnerColumn(finished_text="[green]✓"), TimeElapsedColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console) as progress:

        def finish() -> None:
            for task in progress.tasks:
                progress.update(task.id, completed=1)

        def tell(step: str) -> None:
            finish()
            progress.add_task(step, total=1)

        yield tell
        finish()


def _summary(setup: "Setup") -> Iterator["Table"]:
    """Tables of the bodies, the foci, and what solving takes."""
    from rich.markup import escape

    wavelength = setup.scene.wavelength
    bodies = _table("bodies", "boundary", "triangles", "area")
    for name, obstacle in zip(setup.bodies, setup.scene.obstacles, strict=True):
        surface = obstacle.surface
        size = f"{1e4 * surface.area:.1f} cm² = {surface.area / wavelength**2:.0f} λ²"
        bodies.add_row(escape(name), obstacle.boundary.replace("_", "-"), f"{len(surface.triangles):,}", size)
    yield bodies
    foci = _table("foci", "x", "y", "z", "off the skin", "pressure")
    asked = setup.target.pressures
    off_skin = -setup.scene.depth(setup.target.points)
    for index, (name, point) in enumerate(zip(setup.foci, setup.target.points, strict=True)):
        wanted = "strongest" if asked is None else f"{asked[index]:g} Pa"
        place = [f"{1e3 * number:.2f} mm" for number in point]
        foci.add_row(escape(name), *place, f"{1e3 * off_skin[index]:.3g} mm", wanted)
    yield foci
    unknowns = setup.solver.unknowns(setup.scene, setup.target.beacons())
    elements = setup.array
    clearance = -setup.scene.depth(elements.positions).max()
    facts = _table("", "")
    sensitivity = f"{elements.element.sensitivity:g} Pa·m, uncalibrated"
    facts.add_row("transducers", f"{len(elements)}, {sensitivity}, {1e3 * clearance:.0f} mm off the bodies or more")
    facts.add_row("wavelength", f"{1e3 * wavelength:.2f} mm at {setup.scene.frequency / 1e3:g} kHz")
    facts.add_row("drive", f"{setup.method.replace('_', ' ')}, accuracy {setup.solver.accuracy:g}")
    facts.add_row("unknowns", f"{unknowns:,}, matrix {_memory(unknowns)}")
    yield facts


def _results(run: "Run") -> "Table":
    """Tabulate what each focus gets, with the hand considered and ignored."""
    from rich.markup import escape

    ratios = {name: run.comparison.ratios(name)[1] for name in run.comparison.pressures}
    table = _table("focus", "pressure", *ratios)
    table.title = "Pressure at the foci, and what ignoring the hand would leave of it"
    for index, name in enumerate(run.foci):
        shares = [f"{ratio[index]:.2f} ×" for ratio in ratios.values()]
        table.add_row(escape(name), f"{run.reached[index]:,.0f} Pa", *shares)
    return table


def _table(*columns: str) -> "Table":
    from rich.box import SIMPLE
    from rich.table import Table

    table = Table(box=SIMPLE, show_header=any(columns))
    for index, column in enumerate(columns):
        table.add_column(column, justify="right" if index and any(columns) else "left")
    return table


def _memory(unknowns: float) -> str:
    """Say how large a complex matrix of single precision is."""
    size = 8 * unknowns**2
    return f"{size / 1e9:.1f} GB" if size > 1e9 else f"{math.ceil(size / 1e6)} MB"


if __name__ == "__main__":
    sys.exit(main())
