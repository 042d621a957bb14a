"""Options that several commands share."""

import pkgutil
import sys
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import click
from click.core import ParameterSource

import airtact as at
from airtact.cli.console import JSON, QUIET, say, wanted

Command = TypeVar("Command", bound=Callable[..., None])
Setting = TypeVar("Setting")


FILE = click.Path(path_type=Path)


class InputFile(click.ParamType):
    """Click parameter type for the path of a file to read or the name of an example."""

    name = "file"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return an existing file; otherwise print a note and return the example of that name."""
        from airtact.setup.examples import file_or_example

        file = file_or_example(value)
        named = True
        if ctx is not None and param is not None and param.name is not None:
            named = ctx.get_parameter_source(param.name) != ParameterSource.DEFAULT
        if file != Path(value) and named and not wanted(QUIET):
            say(f"There is no file {value} here: using the example {file}")
        return file


INPUT = InputFile()


class Names(click.Choice):
    """Click parameter type for names in a registry, which is imported only when needed.

    Parameters
    ----------
    registry : location of the names, such as ``"airtact.transducers.boards:BOARDS"``.
    more : additional names.
    """

    case_sensitive = True

    def __init__(self, registry: str, *more: str) -> None:
        self._registry = registry
        self._more = more

    @cached_property
    def choices(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Names in the registry."""
        return (*pkgutil.resolve_name(self._registry), *self._more)


def _keep(context: click.Context, option: click.Parameter, value: bool) -> None:
    context.meta[JSON if option.name == "json" else QUIET] = value


quiet = click.option(
    "--quiet",
    is_flag=True,
    is_eager=True,  # parsed before the arguments, whose conversion may print a note
    expose_value=False,
    callback=_keep,
    help="Print errors and warnings only.",
)

as_json = click.option(
    "--json",
    is_flag=True,
    expose_value=False,
    callback=_keep,
    help="Print the result as JSON, and everything else on standard error.",
)


def _folder_for(context: click.Context, option: click.Parameter, folder: Path | None) -> Path:
    named = context.params.get("scene") or context.info_name
    return folder or Path("out") / Path(named or "").stem


# Folder for results; by default, named after the scene or the command
results = click.option(
    "--out",
    "folder",
    type=FILE,
    callback=_folder_for,
    help="Folder for the results; by default out/NAME.",
)


def scene_here(context: click.Context, argument: click.Parameter, scene: Path) -> Path:
    """Return the scene, or raise ``InvalidInput`` if none is named and the default is missing."""
    if (
        context.get_parameter_source("scene") is click.core.ParameterSource.DEFAULT
        and not scene.exists()
    ):
        raise at.InvalidInput(
            f"no scene was named, and there is no {scene} in this folder: name a scene, or create "
            "one with airtact init.",
            code="file_missing",
        )
    return scene


# Scene file; by default, the one that ``airtact init`` writes
scene = click.argument("scene", type=INPUT, default="scene.toml", callback=scene_here)


def setup_for(folder: Path, scene: Path) -> "at.Setup":
    """Read a scene, and create the folder for its results."""
    from airtact.files.atomic import writable_folder

    setup = at.read_scene(scene)
    writable_folder(folder)
    return setup


open_result = click.option("--open", "opened", is_flag=True, help="Open the report in the browser.")

pictures = click.option(
    "--no-pictures",
    "pictures",
    is_flag=True,
    flag_value=False,
    default=True,
    help="Write numbers only, without a report or pictures.",
)

store = click.option("--store", type=FILE, help="Folder for solved fields, which later runs reuse.")


def surface_settings(command: Command) -> Command:
    """Add the options of ``load_surface`` to a command."""
    # Their default is None, so that the defaults of load_surface apply.
    for name, keyword, words in (
        (
            "--sharp",
            "sharp_degrees",
            "Edges with a larger angle stay sharp, in degrees; 75 by default.",
        ),
        (
            "--largest-hole",
            "largest_hole",
            "Widest hole that is filled, in metres; 2e-3 by default.",
        ),
        (
            "--smallest",
            "smallest",
            "Width below which bores are filled and walls are removed, in metres.",
        ),
        ("--scale", "scale", "Metres per unit of the surface file: 1e-3 for millimetres."),
    ):
        command = click.option(name, keyword, type=float, help=words)(command)
    return click.option(
        "--union",
        is_flag=True,
        default=None,
        help="Replace overlapping parts with their common outer surface.",
    )(command)


def given(**settings: Setting | None) -> dict[str, Setting]:
    """Return the options that are not None."""
    return {name: value for name, value in settings.items() if value is not None}


def microphone_face(command: Command) -> Command:
    """Add the options for the face of a microphone to a command."""
    command = click.option(
        "--axis",
        type=float,
        nargs=3,
        metavar="X Y Z",
        help="Direction of the microphone's face; by default 0 0 -1 (down).",
    )(command)
    return click.option(
        "--diameter",
        type=float,
        help="Diameter of the microphone in metres; by default 6.35e-3 (a quarter inch).",
    )(command)


def board_address(command: Command) -> Command:
    """Add the options for the address of boards to a command."""
    command = click.option("--port", help="Serial port of a SonicSurface or Nano16.")(command)
    return click.option(
        "--address", help="Network interface, AMS net id, host:port or emulator for AUTD3."
    )(command)


def page_address(command: Command) -> Command:
    """Add the options for the port and address of a page."""
    port = click.option(
        "--page-port",
        type=int,
        default=8940,
        show_default=True,
        help="Port of the page; 0 chooses a free one.",
    )
    host = click.option(
        "--host",
        default="127.0.0.1",
        show_default=True,
        help="Address at which the page is served.",
    )
    return port(host(command))


def level_of(cap: float | None, full_scale: bool) -> float | None:
    """Return the cap set by ``--cap`` or ``--full-scale``, or None for the default."""
    if full_scale and cap is not None:
        raise at.InvalidInput(
            f"--full-scale and --cap {cap:g} cannot be combined: omit one.",
            code="options_clash",
        )
    return 1.0 if full_scale else cap


def agreed(question: str) -> None:
    """Ask for confirmation before anything is emitted; raise an error if the user declines."""
    # A script or a pipe must not start an emission by accident.
    if not sys.stdin.isatty():
        raise at.InvalidInput(
            "nothing was sent, because confirmation requires a terminal: use --yes to emit without "
            "confirmation.",
            code="link_failed",
        )
    if not click.confirm(question, default=False):
        raise at.InvalidInput("nothing was sent, because you answered no.", code="link_failed")
