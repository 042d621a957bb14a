"""The command line: parse, call, print. Exit codes: 0 done, 2 bad input or not converged, 130 broken off by Ctrl-C."""

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from airtact.conventions import InvalidInput, NotConverged

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from airtact.meshing import Meshed
    from airtact.report.run_page import Run
    from airtact.scene.geometry import Surface
    from airtact.scene.scene import Scene
    from airtact.scene_file.building import Setup


Command = TypeVar("Command", bound=Callable[..., None])


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


def _surface_settings(command: Command) -> Command:
    """Give a command the options of ``load_surface``; those that are not given stay None."""
    for name, says in (
        ("--sharp", "Edges that turn by more degrees than this stay sharp; 75 by default."),
        ("--largest-hole", "Widest hole that is filled, in metres; 2e-3 by default."),
        ("--scale", "Metres per unit of a surface file: 1e-3 for millimetres."),
    ):
        command = click.option(name, type=float, help=says)(command)
    return command


def _given(scale: float | None, largest_hole: float | None, sharp: float | None) -> dict[str, float]:
    settings = {"scale": scale, "largest_hole": largest_hole, "sharp_degrees": sharp}
    return {name: value for name, value in settings.items() if value is not None}


@commands.command(
    short_help="Say what is in a scene or a surface, or what is wrong with it.",
    epilog="Example: airtact check examples/pinch.toml",
)
@click.argument("scene", metavar="SCENE_OR_SURFACE", type=click.Path(path_type=Path))
@click.option(
    "--out", "folder", type=click.Path(path_type=Path), help="Folder for a picture of the bodies or the fault."
)
@_surface_settings
def check(scene: Path, folder: Path | None, **settings: float | None) -> None:
    """Read a scene file or a surface file (STL, PLY, OBJ, GLB) and say what is in it, or what is wrong with it.

    With --out a picture of the bodies is written, or of the place of the fault where it is refused.
    """
    from rich.console import Console

    from airtact.checking import check_scene, check_surface_file
    from airtact.scene.files import SUFFIXES

    given = _given(**settings)
    console = Console()
    with _progress(Console(stderr=True)) as tell:
        if scene.suffix.lower() in SUFFIXES:
            facts = _surface_summary(scene.name, check_surface_file(scene, folder, tell, **given))
        elif given:
            key, value = next(iter(given.items()))
            raise InvalidInput(
                f"{key} = {value:g} stands in a scene file, beside its surface, not on the command line."
            )
        else:
            facts = _summary(check_scene(scene, folder, tell))
        tell("counting unknowns")
        tables = list(facts)
    for table in tables:
        console.print(table)


@commands.command(
    short_help="Cover a surface with curved panels and say how good they are.",
    epilog="Example: airtact mesh examples/hands/generic-hand-right.glb --out out.vtkhdf",
)
@click.argument("surface", type=click.Path(path_type=Path))
@click.option("--edge", type=float, help="Edge of the panels in metres; by default what 1 % takes at 40 kHz.")
@click.option("--out", "file", required=True, type=click.Path(path_type=Path), help="File for the panels.")
@_surface_settings
def mesh(surface: Path, edge: float | None, file: Path, **settings: float | None) -> None:
    """Cover SURFACE (STL, PLY, OBJ, GLB) with curved panels, as the solvers do, and say how good they are.

    The panels are written to a .vtkhdf file for ParaView, or as flat triangles in metres to .stl, .ply or .glb; a
    picture of them, .png, stands beside it.
    """
    from rich.console import Console

    with _progress(Console(stderr=True)) as tell:
        from airtact.meshing import mesh as run_mesh

        meshed = run_mesh(surface, file, edge, tell, **_given(**settings))
    console = Console()
    for table in _quality(meshed):
        console.print(table)
    if meshed.warning:
        console.print(f"[yellow]Warning:[/yellow] {meshed.warning}", soft_wrap=True, highlight=False)
    console.print(f"The panels: {meshed.file}, their picture: {meshed.picture}", soft_wrap=True, highlight=False)


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
    notes = [(name, one.surface) for name, one in zip(setup.bodies, setup.scene.obstacles, strict=True)]
    yield from (_mended(surface, name) for name, surface in notes if surface.mended)
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


def _surface_summary(name: str, scene: "Scene") -> Iterator["Table"]:
    """Tables of what is in a surface, what was mended, and what solving it takes."""
    from airtact.checking import unknowns_by_accuracy
    from airtact.scene.topology import shells

    surface = scene.obstacles[0].surface
    pieces = int(shells(surface.triangles).max()) + 1
    facts = _table("", "")
    facts.add_row("accepted", f"{name}: {len(surface.triangles):,} triangles, {_pieces(pieces)}")
    facts.add_row("extent", f"{_sides(surface)} mm along x, y, z")
    facts.add_row("area", f"{1e4 * surface.area:.4g} cm² = {surface.area / scene.wavelength**2:.3g} λ² at 40 kHz")
    facts.add_row("volume", f"{1e6 * surface.volume:.4g} cm³")
    facts.add_row("sharp edges", _sharp(surface))
    for accuracy, unknowns in unknowns_by_accuracy(scene).items():
        facts.add_row(f"accuracy {accuracy:g}", f"{unknowns:,} unknowns, matrix {_memory(unknowns)}")
    yield facts
    yield _mended(surface)


def _quality(meshed: "Meshed") -> Iterator["Table"]:
    """Tables of panels beside the triangles that they were made from."""
    sizes = _table("", "given", "panels")
    sizes.add_row("triangles, panels", f"{len(meshed.surface.triangles):,}", f"{len(meshed.panels.six_nodes):,}")
    sizes.add_row("area", f"{1e4 * meshed.given_area:.4g} cm²", f"{1e4 * meshed.area:.4g} cm²")
    sizes.add_row("volume", f"{1e6 * meshed.given_volume:.4g} cm³", f"{1e6 * meshed.volume:.4g} cm³")
    yield sizes
    worst, first = meshed.angles
    facts = _table("", "")
    facts.add_row("smallest angle", f"{worst:.1f}°, 1 of 100 panels below {first:.1f}°")
    facts.add_row("edge", f"{1e3 * meshed.edge:.3g} mm asked, the longest has {1e3 * meshed.longest_edge:.3g} mm")
    panels = meshed.panels
    farthest, mean = _gap(panels.farthest.max()), _gap(panels.mean_distance.max())
    facts.add_row("off the triangles given", f"{farthest} at most, {mean} in the mean")
    facts.add_row("off the curved skin", f"{_gap(panels.deviation.max())} at most")
    facts.add_row("sharp edges", _sharp(meshed.surface))
    if meshed.open_edges:
        facts.add_row("open edges", f"{meshed.open_edges} in {meshed.file.name}: its triangles are not quite closed")
    yield facts
    yield _mended(meshed.surface)


def _mended(surface: "Surface", name: str = "") -> "Table":
    from rich.markup import escape

    table = _table("", "")
    for index, note in enumerate(surface.mended or ("nothing",)):
        table.add_row(escape(f"mended in {name}" if name else "mended") if index == 0 else "", escape(note))
    return table


def _gap(distance: float) -> str:
    return f"{1e3 * distance:.2g} mm" if distance >= 1e-7 else "under 0.1 µm"


def _pieces(count: int) -> str:
    return f"{count} closed {'piece' if count == 1 else 'pieces'}"


def _sides(surface: "Surface") -> str:
    spans = surface.vertices.max(axis=0) - surface.vertices.min(axis=0)
    return " x ".join(f"{1e3 * span:.4g}" for span in spans)


def _sharp(surface: "Surface") -> str:
    from airtact.report.body_figure import sharp_edges

    sharp = sharp_edges(surface)
    length = 1e3 * surface.edge_lengths[sharp].sum() / 2
    count = int(sharp.sum()) // 2
    if count == 0:
        return f"none turns by over {surface.sharp_degrees:g}°"
    return f"{count:,}, {length:.4g} mm together, that turn by over {surface.sharp_degrees:g}° or end a flat cap"


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
