"""From the tables of foci and suppression zones to a target."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Num

from airtact.acoustics.drawings import svg_path, text
from airtact.acoustics.target import Target
from airtact.acoustics.target_points import (
    Points,
    circle,
    onto_surface,
    polyline,
    segment,
    sphere_shell,
    surface_points,
)
from airtact.errors import MOST_POINTS, InvalidInput, about
from airtact.geometry.surface import Surface
from airtact.setup import tables
from airtact.setup.bodies import NamedPoints, built
from airtact.setup.limits import check_total
from airtact.setup.parsing import nearest

SHAPES = {
    tables.SegmentTable: segment,
    tables.PolylineTable: polyline,
    tables.CircleTable: circle,
    tables.SphereShellTable: sphere_shell,
    tables.WritingTable: text,
}
"""Shapes whose keys are the arguments of the function that makes them."""

DEFAULT_OFFSET = 0.5e-3
"""Distance of a focus from the surface of its body [m]."""


def target_of(
    foci: Sequence[tables.FocusTable],
    suppression: Sequence[tables.SuppressionTable],
    named: NamedPoints,
    bodies: Mapping[str, Surface],
    folder: Path,
    most_points: int = MOST_POINTS,
) -> tuple[Target, tuple[str, ...]]:
    """Build the target of a scene file, and a name for each of its foci.

    Foci can name the points in ``named`` and the bodies by their names; drawings are
    in the folder. Raise "too_many" where there are more than ``most_points`` foci and
    suppression points.
    """
    check_total(len(foci) + len(suppression), most_points)
    points = [np.empty((0, 3))]
    counts = []
    names = []
    for index, table in enumerate(foci):
        with about(f"foci[{index}]"):
            found = _foci(table, named, bodies, folder)
            names += _names(table, index, len(found))
            points.append(found)
            counts.append(len(found))
        check_total(sum(map(len, points)), most_points)
    zones = [np.empty((0, 3))]
    for index, zone in enumerate(suppression):
        with about(f"suppression[{index}]"):
            if isinstance(zone.points, tables.SurfacePointsTable):
                body = _body(zone.points.body, bodies, "body")
                zones.append(built(partial(surface_points, body), zone.points, leave_out=("body",)))
            else:
                zones.append(_drawn(zone.points, folder))
        check_total(sum(map(len, points + zones)), most_points)
    with about("foci"):
        wanted = _wanted(foci, counts)
        return Target(
            np.concatenate(points), suppression_points=np.concatenate(zones), **wanted
        ), tuple(names)


def riding_of(
    foci: Sequence[tables.FocusTable], count: int
) -> tuple[tuple[str, float] | None, ...]:
    """Return for each of ``count`` foci the named point that it is before and its distance off the surface [m]."""
    if any(not isinstance(table.points, tables.NamedPointTable) for table in foci):
        return (None,) * count
    offsets = [DEFAULT_OFFSET if table.offset is None else table.offset for table in foci]
    names = [table.points.at for table in foci if isinstance(table.points, tables.NamedPointTable)]
    return tuple(zip(names, offsets, strict=True))


def _wanted(
    foci: Sequence[tables.FocusTable], counts: Sequence[int]
) -> dict[str, Num[np.ndarray, "foci"]]:
    """Return the pressures or shares of all foci, or nothing where all are alike."""
    pressures, shares, degrees = (
        _each(foci, key, counts) for key in ("pressure", "share", "phase_degrees")
    )
    if pressures is not None and shares is not None:
        sentence = f"{len(foci)} of {len(foci)} have a pressure and a share; give one of the two."
        raise InvalidInput(sentence, code="options_clash")
    phased = 1.0 if degrees is None else np.exp(1j * np.radians(degrees))
    if pressures is not None:
        return {"pressures": pressures * phased}
    if shares is not None:
        return {"shares": shares * phased}
    if degrees is not None:
        return {"shares": np.asarray(phased)}
    return {}


def _each(
    foci: Sequence[tables.FocusTable], key: str, counts: Sequence[int]
) -> Float64[np.ndarray, "foci"] | None:
    """Spread a key over the points of each table; None where no table has it."""
    given = [value for table in foci if (value := getattr(table, key)) is not None]
    if not given:
        return None
    if len(given) != len(foci):
        otherwise = " for as strong as possible" if key == "pressure" else ""
        sentence = (
            f"{len(given)} of {len(foci)} have a {key}; give it to all, or to none{otherwise}."
        )
        raise InvalidInput(sentence, code="key_missing")
    return np.repeat(np.array(given, dtype=np.float64), counts)


def _names(table: tables.FocusTable, index: int, count: int) -> list[str]:
    match table.points:
        case tables.NamedPointTable(at=at):
            return [table.name or at]
        case tables.PointTable():
            return [table.name or f"focus {index + 1}"]
    kind = table.name or table.points.__struct_config__.tag
    return [f"{kind} {number + 1}" for number in range(count)]


def _foci(
    table: tables.FocusTable, named: NamedPoints, bodies: Mapping[str, Surface], folder: Path
) -> Points:
    """Points of one table."""
    offset = DEFAULT_OFFSET if table.offset is None else table.offset
    if isinstance(table.points, tables.NamedPointTable):
        if table.onto is not None:
            raise InvalidInput("onto goes only with a point or a shape.", code="key_misplaced")
        return _named(table.points.at, named, offset)[None]
    if table.offset is not None and table.onto is None:
        raise InvalidInput("offset goes only with at or onto.", code="key_misplaced")
    points = _drawn(table.points, folder)
    if table.onto is not None:
        points = onto_surface(points, _body(table.onto, bodies, "onto"), offset)
    return points


def _drawn(table: tables.PointTable | tables.Shape | tables.SvgTable, folder: Path) -> Points:
    """Points that foci and suppression zones alike may be."""
    match table:
        case tables.PointTable(point=point):
            return np.array([point], dtype=np.float64)
        case tables.SvgTable(source=source):
            drawing = (
                folder / source.file if isinstance(source, tables.DrawingFileTable) else source.path
            )
            return built(partial(svg_path, drawing), table, leave_out=("source",))
    return built(SHAPES[type(table)], table)


def _body(name: str, bodies: Mapping[str, Surface], key: str) -> Surface:
    if name not in bodies:
        known = nearest(name, bodies) if bodies else "there is no body here."
        raise InvalidInput(f'{key} = "{name}" is not a body; {known}', code="unknown_name")
    return bodies[name]


def _named(name: str, named: NamedPoints, offset: float) -> Float64[np.ndarray, "3"]:
    if name not in named:
        known = (
            nearest(name, named)
            if named
            else "no body here has named points, so give point = [x, y, z]."
        )
        raise InvalidInput(
            f'at = "{name}" is not a named point of a body; {known}', code="unknown_name"
        )
    if not (math.isfinite(offset) and offset >= 0):
        raise InvalidInput(
            f"offset = {offset} m must be 0 (on the surface) or more.", code="out_of_range"
        )
    point, normal, room = named[name]
    if offset >= room:
        raise InvalidInput(
            f"offset = {offset:g} m does not lie in the gap of {1e3 * room:g} mm before {name}: is it in "
            "millimetres? Give metres.",
            code="out_of_range",
        )
    return point + offset * normal
