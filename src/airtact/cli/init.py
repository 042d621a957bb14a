"""``airtact init``: a first scene to render and to change."""

from pathlib import Path

import click

from airtact.cli.console import show
from airtact.cli.options import FILE, INPUT, Names, quiet


@click.command(
    short_help="Write a first scene: a board and a hand over it.",
    epilog="Example: airtact init first",
)
@click.argument("place", metavar="[FOLDER or FILE.toml]", type=FILE, default=".")
@click.option(
    "--board",
    type=Names("airtact.transducers.boards:BOARDS"),
    default="autd3",
    help="Kind of board; autd3 by default.",
)
@click.option(
    "--hand", type=INPUT, help="Pose of a hand, .json; the relaxed hand of airtact by default."
)
@quiet
def init(place: Path, board: str, hand: Path | None) -> None:
    """Write scene.toml, with comments, for one board and a hand above it that feels three points.

    It is written into this folder, or into FOLDER or FILE.toml. No file is overwritten.
    """
    from airtact.workflows import init as workflow

    scene, *others = workflow.init(place, board, hand)
    named = "" if scene == Path(workflow.SCENE) else f" {scene}"
    lines = [
        f"Scene: {scene}",
        *(f"Beside it: {file}" for file in others),
        f"Next: airtact render{named} --open",
    ]
    show(lines=lines)
