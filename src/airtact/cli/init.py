"""``airtact init``: write a first scene that users can render and modify."""

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

import airtact as at
from airtact.cli.console import show
from airtact.cli.options import FILE, INPUT, Names, quiet

if TYPE_CHECKING:
    import numpy as np

# Named points of the hand that face the board
PLACES = ("index.pad", "middle.pad", "palm")


@click.command(
    short_help="Write a first scene: a board and a hand above it.",
    epilog="Example: airtact init first",
)
@click.argument("place", metavar="[FOLDER or FILE.toml]", type=FILE, default=".")
@click.option(
    "--board",
    type=Names("airtact.transducers.boards:BOARDS"),
    default="autd3",
    help="Kind of board; by default autd3.",
)
@click.option(
    "--hand",
    type=INPUT,
    help="Pose file of a hand (.json); by default airtact's relaxed left hand.",
)
@click.option("--right", is_flag=True, help="Use airtact's hand as a right hand.")
@quiet
def init(place: Path, board: str, hand: Path | None, right: bool) -> None:
    """Write a commented scene.toml with one board and a hand above it.

    The file is written to the current folder, to FOLDER, or to FILE.toml. Existing files are never
    overwritten.
    """
    import numpy as np

    from airtact.files.atomic import whole_file, writable_folder

    scene = place if place.suffix == ".toml" else place / "scene.toml"
    folder = scene.parent
    copied = {}
    if hand is None:
        pose = at.example("relaxed.json")
        content = json.loads(pose.read_text("utf-8"))
        if right:
            content["positions_m"] = [[-x, y, z] for x, y, z in content["positions_m"]]
        copied = {
            folder / "hand.json": json.dumps(content, indent=1) + "\n",
            folder / "hand-LICENSE.txt": pose.with_name("LICENSE-poses").read_text("utf-8"),
        }
        positions, radii = (np.array(content[key]) for key in ("positions_m", "radii_m"))
        over = at.hand_from_joints(positions, radii)
        name = "hand.json"
    else:
        if right:
            raise click.UsageError(
                "--right only applies to airtact's own hand and cannot be used with --hand."
            )
        over = at.load_hand(hand)
        try:
            name = Path(os.path.relpath(hand, folder)).as_posix()
        except ValueError:  # Windows has no relative paths between drives
            name = hand.resolve().as_posix()
    for file in (scene, *copied):
        if file.exists():
            raise at.InvalidInput(
                f"{file} already exists and was not overwritten: choose another folder or file.",
                code="would_overwrite",
            )
    text = _scene_text(scene.name, at.transducers.board_named(board), over, name)
    writable_folder(folder)
    for file, written in {**copied, scene: text}.items():
        with whole_file(file) as partial:
            partial.write_text(written, "utf-8")
    named = "" if scene == Path("scene.toml") else f" {scene}"
    show(
        lines=[
            f"Scene: {scene}",
            *(f"{'Licence' if file.suffix == '.txt' else 'Hand'}: {file}" for file in copied),
            f"Next: airtact render{named} --open",
        ]
    )


def _scene_text(name: str, board: "at.transducers.Board", hand: "at.Hand", file: str) -> str:
    from importlib import resources
    from string import Template

    import numpy as np

    from airtact.emission.codecs import codec_of
    from airtact.setup.building import DEFAULT_OFFSET
    from airtact.transducers.levels import DEFAULT_FREQUENCY

    # A small board can only focus close to itself.
    large = len(board) >= 100
    height = 0.15 if large else 0.06
    axis, degrees, translation = _over_board(hand, board, height)
    # A focus requires air in front of the skin.
    places = list(hand.places) if large else PLACES
    points, normals = _places_of(hand, places)
    inside = hand.shape.depth(points + DEFAULT_OFFSET * normals) > 0.0
    felt = [place for place, is_inside in zip(places, inside, strict=True) if not is_inside]
    template = resources.files("airtact.setup").joinpath("first_scene.toml").read_text("utf-8")
    return Template(template).substitute(
        title=board.title,
        file=name,
        board=board.name,
        middle=_listed(-(board.positions.min(axis=0) + board.positions.max(axis=0)) / 2.0),
        height=f"{1e3 * height:.0f}",
        hand=file,
        axis=_listed(axis),
        degrees=f"{degrees:.1f}",
        translation=_listed(translation),
        foci="\n\n".join(f'[[foci]]\nat = "{place}"' for place in felt),
        amplitudes=board.amplitudes,
        phases=board.phases,
        # The board must accept at least two frames per period of the modulation.
        frequency=min(DEFAULT_FREQUENCY, float(np.floor(codec_of(board).fastest_frames() / 2.0))),
    )


def _over_board(
    hand: "at.Hand", board: "at.transducers.Board", height: float
) -> "tuple[np.ndarray, float, np.ndarray]":
    """Return the axis, degrees and translation [m] that place the hand palm down above a board.

    The lowest of ``PLACES`` is at ``height`` [m]. The hand points along the longer side
    of the board. The point midway between palm and fingertips is above the centre of
    the board.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    points, normals = _places_of(hand, PLACES)
    facing = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
    face_down = at.Pose.between(facing, np.array([0.0, 0.0, -1.0]))
    x, y, _ = face_down.rotation @ (points[:2].mean(axis=0) - points[2])
    width, depth, _ = np.ptp(board.positions, axis=0)
    along = np.arctan2(y, x) if width >= depth else np.arctan2(-x, y)
    turned = at.Pose.turn((0.0, 0.0, 1.0), -along).rotation @ face_down.rotation
    turn = Rotation.from_matrix(turned).as_rotvec()
    # Round these numbers, because users read and change them.
    degrees = float(round(np.degrees(np.linalg.norm(turn))))
    axis = (turn / np.linalg.norm(turn)).round(3) if degrees else np.array([1.0, 0.0, 0.0])
    placed = at.Pose.turn(axis, np.radians(degrees)).apply(points)
    x, y, _ = 0.5 * (placed[:2].mean(axis=0) + placed[2])
    return axis, degrees, np.array([-x, -y, height - placed[:, 2].min()]).round(3)


def _places_of(hand: "at.Hand", places: "list[str] | tuple[str, ...]") -> "list[np.ndarray]":
    import numpy as np

    return [np.array([hand.places[place][part] for place in places]) for part in (0, 1)]


def _listed(numbers: "np.ndarray") -> str:
    return ", ".join(str(round(float(number), 6) + 0.0) for number in numbers)
