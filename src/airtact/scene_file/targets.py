"""From the tables of foci and suppression zones to a target."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float64, Num

from airtact.conventions import InvalidInput, about
from airtact.scene.drawings import picture, svg_path, text
from airtact.scene.target import Target
from airtact.scene.target_points import Points, circle, onto_surface, polyline, segment, sphere_shell, surface_points
from airtact.scene_file.keys import goes_with, one_of
from airtact.scene_file.tables import FocusTable, SuppressionTable, SvgTable, Table, nearest
from airtact.surfaces.surface import Surface

Places = dict[str, tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"], float]]
"""Named points of bodies, the outward normals there, and how far off the next body is [m]."""

SHAPES = {
    "segment": segment,
    "polyline": polyline,
    "circle": circle,
    "sphere_shell": sphere_shell,
    "text": text,
}
"""Shapes whose keys are the arguments of the function that makes them."""

DRAWN = ("point", *SHAPES, "svg")
"""What foci and suppression zones alike may be."""


def target_of(
    tables: Sequence[FocusTable],
    suppression: Sequence[SuppressionTable],
    places: Places,
    bodies: Mapping[str, Surface],
    folder: Path,
) -> tuple[Target, tuple[str, ...]]:
    """Build the target of a scene file, and a name for each of its foci.

    Parameters
    ----------
    tables : what shall be felt.
    suppression : where the sound is suppressed.
    places : points of bodies that foci can name.
    bodies : surfaces of the bodies by name.
    folder : where drawings and pictures are found.

    Raises
    ------
    InvalidInput
        Beginning with the table at fault.
    """
    points, parts, names = [np.empty((0, 3))], [np.empty(0)], []
    for index, table in enumerate(tables):
        with about(f"foci[{index}]"):
            found, part = _foci(table, places, folder)
            if table.onto is not None:
                offset = 0.5e-3 if table.offset is None else table.offset
                found = onto_surface(found, _body(table.onto, bodies, "onto"), offset)
            names += _names(table, index, len(found))
            points.append(found)
            parts.append(part)
    zones = [np.empty((0, 3))]
    for index, table in enumerate(suppression):
        with about(f"suppression[{index}]"):
            zones.append(_zone(table, bodies, folder))
    with about("foci"):
        wanted = _wanted(tables, parts[1:])
        return Target(np.concatenate(points), suppression_points=np.concatenate(zones), **wanted), tuple(names)


def _wanted(
    tables: Sequence[FocusTable], parts: Sequence[Float64[np.ndarray, "_"]]
) -> dict[str, Num[np.ndarray, "foci"]]:
    """Say what all foci are asked: pressures, shares, or nothing where all are alike."""
    pressures, shares, degrees = (_each(tables, key, parts) for key in ("pressure", "share", "phase_degrees"))
    if pressures is not None and shares is not None:
        raise InvalidInput(f"{len(tables)} of {len(tables)} have a pressure and a share; give one of the two.")
    size = np.concatenate([np.empty(0), *parts])
    turned = size if degrees is None else size * np.exp(1j * np.radians(degrees))
    if pressures is not None:
        return {"pressures": pressures * turned}
    if shares is not None or degrees is not None or np.any(size != 1.0):
        return {"shares": turned if shares is None else shares * turned}
    return {}


def _each(
    tables: Sequence[FocusTable], key: str, parts: Sequence[Float64[np.ndarray, "_"]]
) -> Float64[np.ndarray, "foci"] | None:
    """Spread a key over the points of each table; None where no table has it."""
    given = [value for table in tables if (value := getattr(table, key)) is not None]
    if not given:
        return None
    if len(given) != len(tables):
        otherwise = " for as strong as possible" if key == "pressure" else ""
        raise InvalidInput(f"{len(given)} of {len(tables)} have a {key}; give it to all, or to none{otherwise}.")
    return np.repeat(np.array(given, dtype=np.float64), [len(part) for part in parts])


def _names(table: FocusTable, index: int, count: int) -> list[str]:
    kind = one_of(table, ("at", *DRAWN, "picture"))
    if kind in ("at", "point"):
        return [table.name or table.at or f"focus {index + 1}"]
    return [f"{table.name or kind} {number + 1}" for number in range(count)]


def _foci(table: FocusTable, places: Places, folder: Path) -> tuple[Points, Float64[np.ndarray, "points"]]:
    """Points of one table, and the part of what it asks that each of them gets."""
    kind = one_of(table, ("at", *DRAWN, "picture"))
    goes_with(table, "offset", "at or onto", fits=kind == "at" or table.onto is not None)
    goes_with(table, "onto", "a point or a shape", fits=kind != "at")
    if kind == "at":
        found = _named(table, places)[None]
    elif table.picture is not None:
        return picture(folder / table.picture.file, **_arguments(table.picture, leave_out=("file",)))
    else:
        found = _drawn(table, kind, folder)
    return found, np.ones(len(found))


def _drawn(table: FocusTable | SuppressionTable, kind: str, folder: Path) -> Points:
    """Points of a shape that foci and suppression zones alike may be."""
    shape = getattr(table, kind)
    if kind == "point":
        return np.array([shape], dtype=np.float64)
    if isinstance(shape, SvgTable):
        source = folder / shape.file if shape.file is not None else shape.path
        if source is None or (shape.file is not None and shape.path is not None):
            raise InvalidInput("svg: give file, or path with the text of one path, not both.")
        return svg_path(source, **_arguments(shape, leave_out=("file", "path")))
    return SHAPES[kind](**_arguments(shape))


def _arguments(table: Table, leave_out: tuple[str, ...] = ()) -> dict[str, Any]:
    """Bring the keys of a shape to the arguments of the function that makes it."""
    given = {key: value for key, value in msgspec.structs.asdict(table).items() if value is not None}
    given = {key: np.array(value) if key == "corners" else value for key, value in given.items()}
    return {key: value for key, value in given.items() if key not in leave_out}


def _zone(table: SuppressionTable, bodies: Mapping[str, Surface], folder: Path) -> Points:
    """Points of one suppression zone."""
    kind = one_of(table, (*DRAWN, "skin"))
    if table.skin is None:
        return _drawn(table, kind, folder)
    return surface_points(_body(table.skin.body, bodies, "body"), **_arguments(table.skin, leave_out=("body",)))


def _body(name: str, bodies: Mapping[str, Surface], key: str) -> Surface:
    if name not in bodies:
        known = nearest(name, bodies) if bodies else "there is no body here."
        raise InvalidInput(f'{key} = "{name}" is not a body; {known}')
    return bodies[name]


def _named(table: FocusTable, places: Places) -> Float64[np.ndarray, "3"]:
    if table.at not in places:
        known = (
            nearest(str(table.at), places) if places else "no body here has named places, so give point = [x, y, z]."
        )
        raise InvalidInput(f'at = "{table.at}" is not a place of a body; {known}')
    offset = 0.5e-3 if table.offset is None else table.offset
    if not (math.isfinite(offset) and offset >= 0):
        raise InvalidInput(f"offset = {offset} m must be 0 (on the skin) or more.")
    point, normal, room = places[table.at]
    if offset >= room:
        raise InvalidInput(
            f"offset = {offset:g} m does not lie in the gap of {1e3 * room:g} mm before {table.at}: is it in "
            "millimetres? Give metres."
        )
    return point + offset * normal
