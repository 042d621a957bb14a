"""The command line: parse, call, print.

Exit codes: 0 done, 2 bad input or not converged, 3 a link to boards failed, 130 broken off by Ctrl-C.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import click

from airtact.cli.bench import bench
from airtact.cli.boards import boards, emit, export
from airtact.cli.console import progress, warn
from airtact.cli.hands import hand
from airtact.cli.papers import reproduce
from airtact.cli.tracking import listen
from airtact.conventions import InvalidInput, NotConverged
from airtact.hardware.link import LinkFailed

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
    except LinkFailed as error:
        return _fail(str(error), 3)
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


for _command in (bench, boards, emit, export, reproduce, hand, listen):
    commands.add_command(_command)


def _surface_settings(command: Command) -> Command:
    """Give a command the options of ``load_surface``; those that are not given stay None."""
    for name, says in (
        ("--sharp", "Edges that turn by more degrees than this stay sharp; 75 by default."),
        ("--largest-hole", "Widest hole that is filled, in metres; 2e-3 by default."),
        ("--scale", "Metres per unit of a surface file: 1e-3 for millimetres."),
    ):
        command = click.option(name, type=float, help=says)(command)
    return command


_store = click.option(
    "--store", type=click.Path(path_type=Path), help="Folder where solved fields are kept, and looked for next time."
)


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

    from airtact.cli.tables import scene_tables, surface_tables
    from airtact.surfaces.files import SUFFIXES
    from airtact.workflows.check import check_scene, check_surface_file

    given = _given(**settings)
    console = Console()
    with progress() as report_step:
        if scene.suffix.lower() in SUFFIXES:
            facts = surface_tables(scene.name, check_surface_file(scene, folder, report_step, **given))
        elif given:
            key, value = next(iter(given.items()))
            raise InvalidInput(
                f"{key} = {value:g} stands in a scene file, beside its surface, not on the command line."
            )
        else:
            facts = scene_tables(check_scene(scene, folder, report_step))
        report_step("counting unknowns")
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

    with progress() as report_step:
        from airtact.cli.tables import quality_tables
        from airtact.workflows.mesh import mesh as run_mesh

        meshed = run_mesh(surface, file, edge, report_step, **_given(**settings))
    console = Console()
    for table in quality_tables(meshed):
        console.print(table)
    warn(console, [meshed.warning] if meshed.warning else [])
    console.print(f"The panels: {meshed.file}, their picture: {meshed.picture}", soft_wrap=True, highlight=False)


@commands.command(
    short_help="Compute the drive and the field for a scene.",
    epilog="Example: airtact render examples/pinch.toml --out out/pinch",
)
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--out", "folder", required=True, type=click.Path(path_type=Path), help="Folder for the results.")
@_store
def render(scene: Path, folder: Path, store: Path | None) -> None:
    """Compute the drive and the field for SCENE and write drive.csv, drive.h5, field.vtkhdf and report.html."""
    from rich.console import Console

    with progress() as report_step:
        report_step("starting")
        from airtact.cli.tables import run_table
        from airtact.workflows.render import render as run_render

        run = run_render(scene, folder, report_step, store)
    console = Console()
    console.print(run_table(run))
    warn(console, run.notes)
    console.print(f"The page of this run: {folder / 'report.html'}", soft_wrap=True, highlight=False)


@commands.command(
    short_help="Make the drive of a scene by all methods and compare them.",
    epilog="Example: airtact compare examples/pinch.toml --out out/methods",
)
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--out", "folder", required=True, type=click.Path(path_type=Path), help="Folder for the results.")
@_store
def compare(scene: Path, folder: Path, store: Path | None) -> None:
    """Make the drive of SCENE by every method, judge all, and write methods.csv, methods.html and drives/*.h5.

    All drives come from one transfer matrix and are judged by one finer solution.
    """
    from rich.console import Console

    with progress() as report_step:
        report_step("starting")
        from airtact.cli.tables import methods_table
        from airtact.workflows.compare import compare_methods

        contest = compare_methods(scene, folder, report_step, store)
    console = Console()
    console.print(methods_table(contest))
    warn(console, contest.notes)
    console.print(f"The page of this comparison: {folder / 'methods.html'}", soft_wrap=True, highlight=False)


@commands.command(
    name="compare-scan",
    short_help="Hold a measured scan against the prediction for a scene.",
    epilog="Example: airtact compare-scan examples/pinch_scan.csv examples/pinch.toml --out out/scan",
)
@click.argument("scan", type=click.Path(path_type=Path))
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--out", "folder", required=True, type=click.Path(path_type=Path), help="Folder for the results.")
@click.option("--diameter", type=float, help="Of the microphone's face in metres; 6.35e-3, a quarter inch, by default.")
@click.option("--axis", type=float, nargs=3, metavar="X Y Z", help="The way its face looks; 0 0 -1 by default, down.")
@click.option("--housing", type=float, help="How far it reaches straight behind its face in metres; 0.05 by default.")
def compare_scan(
    scan: Path, scene: Path, folder: Path, **microphone: float | tuple[float, float, float] | None
) -> None:
    """Predict what a microphone reads in SCENE and hold SCAN, a measured one, against it.

    SCAN is a .csv file with the columns x, y, z (metres, in the obstacles' frame), pressure (any unit) and, if it was
    measured, phase (radians). Writes overlay.csv and overlay.png.
    """
    from rich.console import Console

    with progress() as report_step:
        report_step("starting")
        from airtact.cli.tables import scan_table
        from airtact.evaluation.microphone import Microphone
        from airtact.workflows.compare_scan import compare_scan as run_compare_scan

        given = {name: value for name, value in microphone.items() if value is not None}
        compared = run_compare_scan(scan, scene, folder, Microphone(**given), report_step)  # pyright: ignore[reportArgumentType]
    console = Console()
    console.print(scan_table(compared))
    warn(console, [*compared.notes, *compared.overlay.warnings, *compared.report.warnings])
    console.print(f"The overlay: {folder / 'overlay.png'}", soft_wrap=True, highlight=False)
