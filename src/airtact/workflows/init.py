"""From nothing to a first scene: a board, a hand over it, and what it feels. Prints nothing."""

import os
import shutil
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np
from jaxtyping import Float64

from airtact.checks import counted
from airtact.emission.codecs import codec_of
from airtact.errors import InvalidInput
from airtact.files.atomic import whole_file, writable_folder
from airtact.geometry.pose import Pose
from airtact.hands.files import load_hand
from airtact.hands.hand import Hand
from airtact.setup.examples import example
from airtact.setup.targets import DEFAULT_OFFSET
from airtact.transducers.boards import Board, board_named
from airtact.transducers.modulation import DEFAULT_FREQUENCY

SCENE, HAND, LICENCE = "scene.toml", "hand.json", "hand-LICENSE.txt"
"""What is written into a folder; the last two only where no hand is given."""

PLACES = ("index.pad", "middle.pad", "palm")
"""What faces the board."""

SMALL = 100
"""Elements below which a board is small, so that the hand is nearer and only ``PLACES`` are felt; else all places."""


def init(place: Path, board: str = "autd3", hand: Path | None = None) -> tuple[Path, ...]:
    """Write a commented scene for one board and a hand; nothing that is there is overwritten.

    Parameters
    ----------
    place : a folder, or a scene file ending in .toml.
    board : name of the kind of board.
    hand : a pose as JSON; None for the relaxed hand that comes with airtact, which is written
        beside the scene.

    Returns
    -------
    The files written, the scene first.

    Raises
    ------
    InvalidInput
        "would_overwrite": one of the files is there; or the hand or the folder is at fault, or there is no such board.
    """
    scene = place if place.suffix == ".toml" else place / SCENE
    folder = scene.parent
    pose = example("relaxed.json")
    texts = {} if hand else {folder / HAND: pose, folder / LICENCE: pose.with_name("LICENSE-poses")}
    files = (scene, *texts)
    there = [file for file in files if file.exists()]
    if there:
        raise InvalidInput(
            f"{there[0]} is there already, and init overwrites none of the {counted(len(files), 'file', 'files')} "
            "that it writes; name another folder or file.",
            code="would_overwrite",
        )
    text = _text(
        scene.name,
        board_named(board),
        load_hand(hand or pose),
        _beside(hand, folder) if hand else HAND,
    )
    writable_folder(folder)
    for file, source in texts.items():
        shutil.copyfile(source, file)
    with whole_file(scene) as partial:
        partial.write_text(text, "utf-8")
    return files


def _beside(file: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:  # another drive of Windows
        return file.resolve().as_posix()


def _text(name: str, board: Board, hand: Hand, file: str) -> str:
    """Fill the template: the board around the origin, the hand above it with its palm down."""
    middle = -(board.positions.min(axis=0) + board.positions.max(axis=0)) / 2.0
    height = 0.15 if len(board) >= SMALL else 0.06
    axis, degrees, translation = _over_board(hand, height)
    template = resources.files("airtact.setup").joinpath("first_scene.toml").read_text("utf-8")
    return Template(template).substitute(
        title=board.title,
        file=name,
        board=board.name,
        middle=_listed(middle),
        height=f"{1e3 * height:.0f}",
        hand=file,
        axis=_listed(axis),
        degrees=f"{degrees:.1f}",
        translation=_listed(translation),
        foci="\n\n".join(f'[[foci]]\nat = "{place}"' for place in _felt(hand, board)),
        amplitudes=board.amplitudes,
        phases=board.phases,
        frequency=min(DEFAULT_FREQUENCY, float(np.floor(codec_of(board).fastest_frames() / 2.0))),
    )


def _felt(hand: Hand, board: Board) -> Sequence[str]:
    """Choose the places that are felt: those with air before them."""
    places = list(hand.places) if len(board) >= SMALL else PLACES
    points, normals = (np.array([hand.places[place][part] for place in places]) for part in (0, 1))
    inside = hand.shape.depth(points + DEFAULT_OFFSET * normals) > 0.0
    return [place for place, is_inside in zip(places, inside, strict=True) if not is_inside]


def _over_board(
    hand: Hand, height: float
) -> tuple[Float64[np.ndarray, "3"], float, Float64[np.ndarray, "3"]]:
    """Find the axis, the degrees and the translation [m] that turn ``PLACES`` down, the lowest at a height [m]."""
    points, normals = (np.array([hand.places[place][part] for place in PLACES]) for part in (0, 1))
    facing, down = (
        normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0)),
        np.array([0.0, 0.0, -1.0]),
    )
    across = np.cross(facing, down)
    axis = (
        across / np.linalg.norm(across)
        if np.linalg.norm(across) > 1e-6
        else np.array([1.0, 0.0, 0.0])
    )
    degrees = float(np.degrees(np.arccos(np.clip(facing @ down, -1.0, 1.0))))
    axis, degrees = axis.round(3), float(round(degrees))
    turned = Pose.turn(axis, np.radians(degrees)).apply(points)
    translation = np.array([0.0, 0.0, height]) - [*turned[:, :2].mean(axis=0), turned[:, 2].min()]
    return axis, degrees, translation.round(3)


def _listed(numbers: Float64[np.ndarray, "3"]) -> str:
    return ", ".join(str(round(float(number), 6) + 0.0) for number in numbers)
