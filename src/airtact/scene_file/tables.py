"""The tables of a scene file and how its text becomes them.

All lengths are metres and all frames are the obstacles' frame unless a key says otherwise. The attributes of each class
are the keys of one table.
"""

import difflib
import re
import typing
from collections.abc import Iterable
from typing import Any, Literal

import msgspec

from airtact.conventions import InvalidInput

Triple = tuple[float, float, float]


class Table(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A table of the file: a key that it does not know is an error."""


class MediumTable(Table, frozen=True):
    """Air by its weather (``humidity`` is 0 to 1), or any fluid by its speed, density and absorption [Np/m]."""

    celsius: float | None = None
    humidity: float | None = None
    sound_speed: float | None = None
    density: float | None = None
    absorption: float | None = None


class PoseTable(Table, frozen=True):
    """A turn by ``degrees`` about ``axis``, or a ``rotation`` matrix, then a ``translation``."""

    axis: Triple | None = None
    degrees: float | None = None
    rotation: tuple[Triple, Triple, Triple] | None = None
    translation: Triple = (0.0, 0.0, 0.0)


class ArrayTable(Table, frozen=True):
    """Who speaks; ``pose`` is where the whole array stands in the obstacles' frame.

    ``board`` is the kind of board that a box or boards are made of; ``calibration`` is a .csv file beside the scene
    file that says what each element really gives.
    """

    layout: str
    board: str | None = None
    calibration: str | None = None
    rows: int | None = None
    columns: int | None = None
    poses: list[PoseTable] | None = None
    piston_radius: float | None = None
    sensitivity: float | None = None
    pose: PoseTable | None = None


class PinchTable(Table, frozen=True):
    """The paper's thumb and forefinger, ``gap`` apart."""

    gap: float = 0.012


class CapsuleTable(Table, frozen=True):
    """A round-ended rod; ``edge`` is the longest edge of its picture, not of the solver's panels."""

    start: Triple
    end: Triple
    radius: float
    edge: float = 2.5e-3


class SphereTable(Table, frozen=True):
    """A ball; ``edge`` as for a capsule."""

    radius: float
    centre: Triple = (0.0, 0.0, 0.0)
    edge: float = 2.5e-3


class ObstacleTable(Table, frozen=True):
    """A ``pinch``, ``capsule``, ``sphere``, ``surface`` or ``hand`` (files beside the scene file), and its skin.

    A hand is a pose; with ``gap`` [m] thumb and index finger are opened until their last phalanges are so far apart.

    For a surface ``scale`` is metres per unit of the mesh file; its holes up to ``largest_hole`` [m] are filled; its
    edges that turn by more than ``sharp_degrees`` stay sharp.
    """

    pinch: PinchTable | None = None
    capsule: CapsuleTable | None = None
    sphere: SphereTable | None = None
    surface: str | None = None
    hand: str | None = None
    gap: float | None = None
    scale: float | None = None
    largest_hole: float | None = None
    sharp_degrees: float | None = None
    boundary: Literal["sound_hard", "impedance", "filled"] = "sound_hard"
    ratio: float | tuple[float, float] | None = None
    medium: MediumTable | None = None


class SegmentTable(Table, frozen=True):
    """Points of a straight line, at most ``spacing`` apart [m]."""

    start: Triple
    end: Triple
    spacing: float


class PolylineTable(Table, frozen=True):
    """Points of lines from corner to corner, and back to the first where it is ``closed``."""

    corners: list[Triple]
    spacing: float
    closed: bool = False


class CircleTable(Table, frozen=True):
    """Points of a circle in the plane at right angles to ``normal``."""

    centre: Triple
    radius: float
    spacing: float
    normal: Triple = (0.0, 0.0, 1.0)


class SphereShellTable(Table, frozen=True):
    """Points spread over a sphere, about ``spacing`` apart."""

    centre: Triple
    radius: float
    spacing: float


class TextTable(Table, frozen=True):
    """Writing in single strokes, read from where ``normal`` points to; ``height`` is that of a capital letter."""

    words: str
    height: float
    spacing: float
    centre: Triple = (0.0, 0.0, 0.0)
    normal: Triple = (0.0, 0.0, 1.0)
    up: Triple | None = None


class SvgTable(Table, frozen=True):
    """The lines of an SVG ``file`` beside the scene file, or of the text of one ``path``, ``width`` wide."""

    width: float
    spacing: float
    file: str | None = None
    path: str | None = None
    centre: Triple = (0.0, 0.0, 0.0)
    normal: Triple = (0.0, 0.0, 1.0)
    up: Triple | None = None


class PictureTable(Table, frozen=True):
    """A grey-scale picture beside the scene file on a grid of points; bright ones ask for more."""

    file: str
    width: float
    spacing: float
    centre: Triple = (0.0, 0.0, 0.0)
    normal: Triple = (0.0, 0.0, 1.0)
    up: Triple | None = None


class SkinTable(Table, frozen=True):
    """Points on the skin of a ``body``, or on the side of it that looks to ``facing`` within so many degrees."""

    body: str
    spacing: float
    facing: Triple | None = None
    within: float = 90.0


class FocusTable(Table, frozen=True):
    """What to feel: ``at`` a named place of a body, ``offset`` off its skin, at a ``point``, or a shape.

    A point or shape ``onto`` a body is brought to its skin, and ``offset`` off it.

    ``pressure`` [Pa] is asked of every point of it, or a ``share`` in proportion to the others; ``phase_degrees`` fixes
    the phase.
    """

    at: str | None = None
    offset: float | None = None
    onto: str | None = None
    point: Triple | None = None
    segment: SegmentTable | None = None
    polyline: PolylineTable | None = None
    circle: CircleTable | None = None
    sphere_shell: SphereShellTable | None = None
    text: TextTable | None = None
    svg: SvgTable | None = None
    picture: PictureTable | None = None
    pressure: float | None = None
    share: float | None = None
    phase_degrees: float | None = None
    name: str | None = None


class SuppressionTable(Table, frozen=True):
    """What to keep quiet: a point, a shape, or ``skin`` of a body."""

    point: Triple | None = None
    segment: SegmentTable | None = None
    polyline: PolylineTable | None = None
    circle: CircleTable | None = None
    sphere_shell: SphereShellTable | None = None
    text: TextTable | None = None
    svg: SvgTable | None = None
    skin: SkinTable | None = None


class SolverTable(Table, frozen=True):
    """How sound travels is computed, by default as the bodies need; ``accuracy`` is the relative error asked for."""

    name: str | None = None
    accuracy: float = 0.01


class DriveTable(Table, frozen=True):
    """How the drive is made from the transfer matrix, and in how many levels it is sent."""

    method: str = "time_reversal"
    levels: int = 256


class SceneFile(Table, frozen=True):
    """The whole file; ``merge_bodies`` makes one of sound-hard bodies that overlap or are nearer than 0.3 mm."""

    medium: MediumTable
    array: ArrayTable
    foci: list[FocusTable]
    suppression: list[SuppressionTable] = []
    obstacles: list[ObstacleTable] = []
    frequency: float = 40e3
    merge_bodies: bool = False
    solver: SolverTable = SolverTable()
    drive: DriveTable = DriveTable()


def parse_scene(text: str) -> SceneFile:
    r"""Turn the text of a scene file into its tables.

    Raises
    ------
    InvalidInput
        Not TOML, an unknown key (named with its path and the nearest right key), a missing key or a wrong type.

    Examples
    --------
    >>> parse_scene("[medium]\ncelsuis = 20.0")
    Traceback (most recent call last):
    ...
    airtact.conventions.InvalidInput: medium.celsuis is not a key of a scene file; did you mean medium.celsius?
    """
    try:
        data = msgspec.toml.decode(text.encode())
    except msgspec.DecodeError as error:
        raise InvalidInput(f"this is not TOML: {str(error)[:1].lower()}{str(error)[1:]}.") from None
    _check_unknown_keys(data, SceneFile, "")
    try:
        return msgspec.convert(data, SceneFile)
    except msgspec.ValidationError as error:
        raise InvalidInput(_sentence(str(error))) from None


def nearest(word: str, known: Iterable[str], prefix: str = "") -> str:
    """Say which known word was probably meant, or all that there are.

    >>> nearest("finite_elemant", ["boundary_element", "finite_element"])
    'did you mean finite_element?'
    """
    known = sorted(known)
    close = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {prefix}{close[0]}?" if close else f"there is {', '.join(prefix + name for name in known)}."


def _check_unknown_keys(data: Any, table: type[Table], path: str) -> None:
    if not isinstance(data, dict):
        return
    kinds = typing.get_type_hints(table)
    for key, value in data.items():
        if key not in kinds:
            raise InvalidInput(f"{path}{key} is not a key of a scene file; {nearest(key, kinds, path)}")
        inner = _table_in(kinds[key])
        if inner and isinstance(value, list):
            for index, item in enumerate(value):
                _check_unknown_keys(item, inner, f"{path}{key}[{index}].")
        elif inner:
            _check_unknown_keys(value, inner, f"{path}{key}.")


def _table_in(kind: Any) -> type[Table] | None:
    """Find the table that a type holds: alone, in a list or as one of several choices."""
    if isinstance(kind, type) and issubclass(kind, Table):
        return kind
    return next((found for part in typing.get_args(kind) if (found := _table_in(part))), None)


_PLAIN_WORDS = {
    "array": "a list",
    "bool": "true or false",
    "float": "a number",
    "int": "a whole number",
    "object": "a table",
    "str": "a string",
}


def _sentence(message: str) -> str:
    """Say in TOML's words what msgspec says in Python's."""
    what, _, where = message.partition(" - at ")
    where = where.strip("`").removeprefix("$").removeprefix(".")
    if missing := re.fullmatch(r"Object missing required field `(.+)`", what):
        return f"the key {where}{'.' if where else ''}{missing[1]} is missing."
    what = re.sub(r"`([a-z| ]+)`", _plain_types, what)
    return f"{where}: {what[:1].lower()}{what[1:]}."


def _plain_types(match: re.Match[str]) -> str:
    return " or ".join(_PLAIN_WORDS.get(word, word) for word in match[1].split(" | ") if word != "null")
