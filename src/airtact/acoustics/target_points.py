"""Points for a ``Target``: lines, circles, spheres, surfaces of bodies, text and SVG drawings.

The spacing is the largest distance between neighbours along a line. Foci less than half a
wavelength apart merge, so a spacing of a quarter to half a wavelength (2 to 4 mm at 40 kHz)
produces an unbroken line.
"""

import io
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float64, Real

from airtact.errors import (
    LARGEST_NUMBER,
    MOST_POINTS,
    SMALLEST_NUMBER,
    InvalidInput,
    Vector,
    between,
    direction_of,
    in_mm,
    of_kind,
    point_of,
    points_of,
    positive,
)
from airtact.files.bounded import bytes_of
from airtact.geometry.mesh.triangles import points_at
from airtact.geometry.panels import panels_of
from airtact.geometry.surface import Surface

Points = Float64[np.ndarray, "points 3"]

# Largest distance from a surface at which points are projected onto it [m].
MAX_OFFSET = 0.02


def segment(start: Vector, end: Vector, spacing: float) -> Points:
    """Return evenly spaced points on a straight line, including both ends.

    Parameters
    ----------
    start, end : (3,) ends of the line in the frame of the target [m].
    spacing : largest distance between neighbours [m], above 0. At 40 kHz, foci 2 to 4 mm apart
        merge into an unbroken line.

    Returns
    -------
    (F, 3) points from ``start`` to ``end`` [m], for example as the foci of a ``Target``.

    Raises
    ------
    InvalidInput
        If both ends coincide, if a number is not finite, if the spacing is not above zero, or if
        there are more than 4096 points.

    Examples
    --------
    >>> segment((0, 0, 0), (0.01, 0, 0), spacing=4e-3)[:, 0].round(4).tolist()
    [0.0, 0.0033, 0.0067, 0.01]
    """
    return polyline(np.stack([point_of(start, "the start"), point_of(end, "the end")]), spacing)


def polyline(
    corners: Real[np.ndarray, "corners 3"], spacing: float, closed: bool = False
) -> Points:
    """Return points on the lines between successive corners, evenly spaced on each line.

    Parameters
    ----------
    corners : (C, 3) corners in the frame of the target [m].
    spacing : largest distance between neighbours on a line [m].
    closed : whether a line also connects the last corner to the first.

    Returns
    -------
    (F, 3) points in the order of the corners [m], for example as the foci of a ``Target``. Each
    corner is one of them; a closed polyline does not repeat the first corner at its end.

    Raises
    ------
    InvalidInput
        If there are fewer than two corners (three if closed), if successive corners coincide, if a
        number is not finite, if the spacing is not above zero, or if there are more than 4096
        points.
    """
    corners = points_of(corners, "corners of a polyline")
    minimum = 3 if closed else 2
    if len(corners) < minimum:
        raise InvalidInput(
            f"a {'closed ' if closed else ''}polyline has {len(corners)} corners, but needs "
            f"{minimum}.",
            code="too_few",
        )
    spacing = positive(spacing, "the spacing", "m")
    ends = np.roll(corners, -1, axis=0)
    if not closed:
        ends = ends[:-1]
    steps = ends - corners[: len(ends)]
    lengths = np.linalg.norm(steps, axis=1)
    if lengths.min() == 0.0:
        raise InvalidInput(
            f"the ends of segment {int(lengths.argmin())} of a polyline coincide. Remove one of "
            "these two points.",
            code="all_zero",
        )
    # Rounding must not add a point if the length is a multiple of the spacing.
    counts = np.maximum(np.ceil(lengths / spacing - 1e-9), 1.0)
    check_count(counts.sum() + 1.0, spacing)
    parts = [
        start + np.linspace(0.0, 1.0, int(count), endpoint=False)[:, None] * step
        for start, step, count in zip(corners, steps, counts, strict=False)
    ]
    if not closed:
        parts.append(corners[-1:])
    return np.concatenate(parts)


def circle(
    centre: Vector, radius: float, spacing: float, normal: Vector = (0.0, 0.0, 1.0)
) -> Points:
    """Return evenly spaced points on a circle, for example as the foci of a ``Target``.

    Parameters
    ----------
    centre : (3,) centre of the circle [m], in the frame of the target.
    radius : radius of the circle [m], above 0.
    spacing : largest distance between neighbours along the circle [m], above 0. There are at least
        3 points.
    normal : (3,) vector of any length perpendicular to the circle's plane.

    Returns
    -------
    (F, 3) points [m], anticlockwise as seen from the side to which the normal points. For the
    default normal, the first point is at +x from the centre; for other normals, it can be anywhere
    on the circle.

    Raises
    ------
    InvalidInput
        If a number is not finite, if a length is not above zero, if the normal is zero, or if there
        are more than 4096 points.

    Examples
    --------
    >>> circle((0, 0, 0), radius=0.01, spacing=0.02).shape
    (4, 3)
    """
    radius = positive(radius, "the radius", "m")
    spacing = positive(spacing, "the spacing", "m")
    count = max(3.0, np.ceil(2.0 * np.pi * radius / spacing - 1e-9))
    check_count(count, spacing)
    right, up, _ = frame_of(normal)
    angle = 2.0 * np.pi * np.arange(int(count)) / count
    return point_of(centre, "the centre") + radius * (
        np.outer(np.cos(angle), right) + np.outer(np.sin(angle), up)
    )


def sphere_shell(centre: Vector, radius: float, spacing: float) -> Points:
    """Return points spread evenly over the surface of a sphere, on a golden spiral.

    Parameters
    ----------
    centre : (3,) centre of the sphere in the frame of the target [m].
    radius : radius of the sphere [m], above 0.
    spacing : approximate distance between neighbours [m], above 0; at least 4 points are returned.

    Returns
    -------
    (F, 3) points in the order of decreasing z [m], for example as the foci or suppression points of
    a ``Target``.

    Raises
    ------
    InvalidInput
        If a number is not finite, if a length is not above zero, or if there are more than 4096
        points.

    Examples
    --------
    >>> len(sphere_shell((0, 0, 0), radius=0.01, spacing=5e-3))
    59
    """
    radius = positive(radius, "the radius", "m")
    spacing = positive(spacing, "the spacing", "m")
    # In a hexagonal lattice each point covers an area of √3/2 times the square of the spacing.
    count = max(4.0, np.ceil(4.0 * np.pi * radius**2 / (np.sqrt(0.75) * spacing**2)))
    check_count(count, spacing)
    return point_of(centre, "the centre") + radius * even_directions(int(count))


def even_directions(count: int) -> Float64[np.ndarray, "directions 3"]:
    """Return unit vectors (N, 3) spread evenly over the sphere on a golden spiral."""
    index = np.arange(count) + 0.5
    height = 1.0 - 2.0 * index / count
    # The golden angle prevents points from lining up along meridians.
    azimuth = np.pi * (1.0 + np.sqrt(5.0)) * index
    across = np.sqrt(1.0 - height**2)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), height], axis=1)


def surface_points(
    surface: Surface, spacing: float, facing: Vector | None = None, within: float = 90.0
) -> Points:
    """Return points spread over a body's surface, or over one side of it.

    Use the points as suppression points of a target.

    Parameters
    ----------
    surface : the body.
    spacing : approximate distance between neighbours [m].
    facing : (3,) direction that the covered side faces, a vector of any length above zero; or None
        for the whole surface.
    within : largest angle between ``facing`` and the outward normal at the returned points
        [degrees]; ignored if ``facing`` is None.

    Returns
    -------
    (Q, 3) points on the surface in the frame of the body, in no particular order [m].

    Raises
    ------
    InvalidInput
        If the spacing is not above zero or would cover the whole surface with more than 4096
        points, if ``facing`` is zero, or if no part of the surface faces this direction.
    """
    of_kind(surface, Surface, "the surface", "one Surface, such as pinch().surfaces[0]")
    spacing = positive(spacing, "the spacing", "m")
    check_count(surface.area / (np.sqrt(0.75) * spacing**2), spacing)
    # Panels much smaller than the spacing cover the surface densely; their centres are thinned
    # below.
    edge = spacing / 3.0
    panels = panels_of([surface.shape], edge, np.empty((0, 3)), smallest=edge).quadratic_triangles
    centres, normals = points_at(panels, np.full((len(panels), 2), 1.0 / 3.0))
    if facing is not None:
        towards = point_of(facing, "the direction")
        length = positive(float(np.linalg.norm(towards)), "the length of the direction", "m")
        cosine = normals @ towards / (length * np.linalg.norm(normals, axis=1))
        centres = centres[cosine >= np.cos(np.radians(within)) - 1e-12]
    if not len(centres):
        raise InvalidInput(
            f"no part of the surface faces a direction within {within:g} degrees of "
            f"{np.asarray(facing).tolist()}. Use another direction or a larger angle.",
            code="empty",
        )
    # After thinning, the mean distance exceeds the smallest distance.
    return spaced_apart(surface.shape.project(centres), 0.85 * spacing)


def onto_surface(points: Points, surface: Surface, offset: float = 0.5e-3) -> Points:
    """Project points onto a surface, and shift them outward along its normal.

    Use the function to place foci, such as those of a drawing, just above the skin of a hand.

    Parameters
    ----------
    points : (P, 3) points in the frame of the surface [m], inside or outside the body. Each is
        moved to the nearest point of the surface.
    surface : surface of the body, such as ``hand.surface``.
    offset : distance of the shifted points from the surface [m], 0 to 0.02.

    Returns
    -------
    (P, 3) shifted points in the same order [m].

    Raises
    ------
    InvalidInput
        If the offset is outside its range, or if a shifted point is closer to the surface than half
        of the offset, as in a crevice.

    Examples
    --------
    >>> from airtact.geometry.primitives import sphere
    >>> ball = sphere(0.01, edge=2e-3)
    >>> onto_surface(np.array([[0.0, 0.0, 0.03]]), ball, offset=1e-3).round(6).tolist()
    [[0.0, 0.0, 0.011]]
    """
    of_kind(surface, Surface, "the surface", "one Surface, such as pinch().surfaces[0]")
    offset = between(offset, 0.0, MAX_OFFSET, "the offset", "m", "use metres.")
    points = points_of(points, "points", least=0)
    projected = surface.shape.project(points).copy()
    # Bodies such as hands can project only nearby points. Other points start from the nearest
    # triangle.
    off = np.flatnonzero(np.abs(surface.depth(projected)) > 1e-6)
    if len(off):
        import trimesh

        mesh = trimesh.Trimesh(surface.vertices, surface.triangles, process=False)
        nearest = trimesh.proximity.closest_point_naive(mesh, points[off])[0]
        projected[off] = surface.shape.project(nearest)
    shifted = projected + offset * outward(surface.depth, projected)
    # In a crevice, the shifted point is closer to the opposite side.
    short = np.flatnonzero(-surface.depth(shifted) < 0.5 * offset)
    if len(short):
        where = projected[short[0]]
        raise InvalidInput(
            f"point {int(short[0])}, shifted {1e3 * offset:.3g} mm off the surface at "
            f"{in_mm(where)}, lies in a crevice or in front of another part of the surface. Move "
            "the drawing.",
            where,
            code="misplaced",
        )
    return shifted


def spaced_apart(points: Points, spacing: float) -> Float64[np.ndarray, "kept 3"]:
    """Return the points in order, omitting each point within ``spacing`` [m] of a kept point."""
    from scipy.spatial import KDTree  # importing it takes 0.2 s

    remaining = []
    dropped = np.zeros(len(points), dtype=bool)
    tree = KDTree(points)
    for index, point in enumerate(points):
        if not dropped[index]:
            remaining.append(index)
            dropped[tree.query_ball_point(point, spacing * (1.0 - 1e-9))] = True
    return points[remaining]


def frame_of(
    normal: Vector, up: Vector | None = None
) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Return three unit vectors of a plane seen from its front: right, up, and normal to the plane.

    ``up`` is projected onto the plane. By default, ``up`` is y, or z if the normal is nearly
    parallel to y.
    """
    towards = direction_of(normal, "the normal of a plane")
    # Any direction except the normal is valid.
    if up is None:
        up = (0.0, 1.0, 0.0) if abs(towards[1]) < 0.9 else (0.0, 0.0, 1.0)
    direction = point_of(up, "the direction up")
    upwards = direction - (direction @ towards) * towards
    if np.linalg.norm(upwards) <= 1e-6 * np.linalg.norm(direction):
        raise InvalidInput(
            f"up is {direction.tolist()}, which is parallel to the normal {towards.tolist()}; use "
            "another direction.",
            code="all_zero",
        )
    upwards /= np.linalg.norm(upwards)
    return np.cross(upwards, towards), upwards, towards


def check_count(count: float, spacing: float) -> None:
    """Raise an error if a spacing [m] results in more than ``MOST_POINTS`` points."""
    if count > MOST_POINTS:
        raise InvalidInput(
            f"a spacing of {1e3 * spacing:.3g} mm results in {count:.0f} points, but at "
            f"most {MOST_POINTS} are allowed: are the other lengths in millimetres? Use metres, "
            "and at 40 kHz a spacing of 2e-3 to 4e-3.",
            code="too_many",
        )


def outward(
    depth: Callable[[Float64[np.ndarray, "positions 3"]], Float64[np.ndarray, "positions"]],
    points: Real[np.ndarray, "points 3"],
) -> Float64[np.ndarray, "points 3"]:
    """Return unit directions (P, 3) in which a depth such as ``Surface.depth`` falls fastest."""
    step = 1e-4  # [m]
    shifts = step * np.concatenate([np.eye(3), -np.eye(3)])
    # The gradient is by central differences; the direction is z if the depth is constant.
    around = depth((points[:, None] + shifts).reshape(-1, 3)).reshape(-1, 6)
    gradients = around[:, 3:] - around[:, :3]
    length = np.linalg.norm(gradients, axis=1, keepdims=True)
    level = length == 0
    return np.where(level, [0.0, 0.0, 1.0], gradients / np.where(level, 1, length))


# Largest size of an SVG drawing [bytes]; the reading time grows with the square of the size.
MAX_DRAWING_BYTES = 500_000

# Largest number of straight and curved parts of a drawing, counted at each use.
MAX_CURVES = 5_000

# Polygonal lines in a plane, with x to the right and y up.
Strokes = list[Float64[np.ndarray, "_ 2"]]


def text(
    words: str,
    height: float,
    spacing: float,
    centre: Vector = (0.0, 0.0, 0.0),
    normal: Vector = (0.0, 0.0, 1.0),
    up: Vector | None = None,
) -> Points:
    """Return points along the strokes of a text in Hershey's single-stroke font of 1967.

    The text is one line in the plane through ``centre`` that is perpendicular to ``normal``.

    Parameters
    ----------
    words : the text, in printable ASCII characters.
    height : height of a capital letter [m], above 0.
    spacing : largest distance between neighbours along a stroke [m], above 0.
    centre : (3,) position of the middle of the text's bounding box in the frame of the target [m];
        by default, the origin.
    normal : (3,) direction toward the reader, a vector of any length above zero; by default z.
    up : (3,) upward direction of the letters, projected onto their plane; by default y, or z if the
        normal is within 26 degrees of ±y.

    Returns
    -------
    (F, 3) points in the order of the strokes [m], for example as the foci of a ``Target``. Points
    closer than 0.6 times the spacing to an earlier point are omitted.

    Raises
    ------
    InvalidInput
        If the text has no visible letters, if a letter is not in the font, if a length is not above
        zero, if ``normal`` is zero or parallel to ``up``, or if there are more than 4096 points.

    Examples
    --------
    >>> letters = text("AIR", height=0.02, spacing=3e-3)
    >>> np.ptp(letters, axis=0).round(4).tolist()
    [0.041, 0.02, 0.0]
    """
    from HersheyFonts import HersheyFonts

    check_count(len(of_kind(words, str, "the words", 'a text such as "AIR"')), spacing)
    for letter in words:
        if not 32 <= ord(letter) < 127:
            raise InvalidInput(
                f"{letter!r} of {words!r} is not in the font; use ASCII characters only.",
                code="unknown_name",
            )
    font = HersheyFonts()
    # A sans serif font in single strokes instead of outlines.
    font.load_default_font("futural")
    font.normalize_rendering(1.0)  # otherwise y would point down
    strokes = [np.array(stroke, dtype=np.float64) for stroke in font.strokes_for_text(words)]
    # The height of capitals depends on the font.
    capital = np.concatenate([np.array(stroke) for stroke in font.strokes_for_text("H")])
    scale = positive(height, "the height of a letter", "m") / float(np.ptp(capital[:, 1]))
    strokes = [stroke * scale for stroke in strokes]
    return _laid_out(strokes, repr(words), spacing, centre, normal, up)


def svg_path(
    source: str | Path,
    width: float,
    spacing: float,
    centre: Vector = (0.0, 0.0, 0.0),
    normal: Vector = (0.0, 0.0, 1.0),
    up: Vector | None = None,
) -> Points:
    """Return points along the lines of an SVG drawing.

    The drawing may contain paths, polygons, circles and transforms. It lies in the plane through
    ``centre`` that is perpendicular to ``normal``.

    Parameters
    ----------
    source : an .svg file, or the text of one path, such as "M 0 0 L 10 0 C 10 5 5 10 0 10 Z".
    width : width to which the drawing is scaled, with its proportions unchanged [m]; for a single
        vertical line, its height.
    spacing : largest distance between neighbours along a line [m].
    centre : (3,) position of the middle of the drawing's bounding box [m].
    normal : (3,) direction from the drawing toward its viewer, a vector of any length above zero.
    up : (3,) direction in space that points up in the drawing; it is projected onto the plane of
        the drawing. By default y, or z if the normal is within 26 degrees of ±y.

    Returns
    -------
    (F, 3) points in the order of the lines in the drawing [m]. Points closer than 0.6 times the
    spacing to an earlier point are omitted, for example where lines cross.

    Raises
    ------
    InvalidInput
        If the file cannot be read, exceeds 500 kB, is not an SVG file, contains no lines or
        contains more than 5000 curves. The error is also raised if a length is not above zero, if
        ``normal`` is zero or parallel to ``up``, or if there are more than 4096 points.
    """
    width = positive(width, "the width of the drawing", "m")
    spacing = positive(spacing, "the spacing", "m")
    of_kind(source, str | Path, "the drawing", "the name of an SVG file or the path in it")
    if isinstance(source, Path) or source.endswith(".svg"):
        name = Path(source).name
        drawing = _checked_drawing(bytes_of(Path(source), MAX_DRAWING_BYTES), name)
    else:
        name = repr(source)
        drawing = source
        _check_curves(_numbers_in(source) + _letters_in(source), name)
    strokes = _strokes_of(drawing, name)
    corners = np.concatenate([np.empty((0, 2)), *strokes])
    # `not ... <=` also rejects NaN.
    farthest = np.abs(corners).max(initial=0.0)
    if not farthest <= LARGEST_NUMBER:
        raise InvalidInput(
            f"{name} has a coordinate of {farthest:.3g} units, but at most {LARGEST_NUMBER:g} are "
            "allowed. Scale the drawing down.",
            code="out_of_range",
        )
    extent = np.ptp(corners, axis=0) if len(corners) else np.zeros(2)
    # An upright line has no width.
    size = extent[0] if extent[0] > 0.0 else extent[1]
    if size < SMALLEST_NUMBER:
        raise InvalidInput(f"all lines in {name} have length 0. Draw longer lines.", code="empty")
    upright = [stroke * [width / size, -width / size] for stroke in strokes]  # y points down in SVG
    return _laid_out(upright, name, spacing, centre, normal, up)


def _strokes_of(drawing: bytes | str, name: str) -> Strokes:
    import svgelements

    try:
        with np.errstate(all="ignore"):  # the caller reports numbers that are too large
            if isinstance(drawing, bytes):
                elements = svgelements.SVG.parse(io.BytesIO(drawing)).elements()
                shapes = [item for item in elements if isinstance(item, svgelements.Shape)]
            else:
                shapes = [drawing]
            parts = [part for shape in shapes for part in svgelements.Path(shape).as_subpaths()]
            strokes = [_corners(svgelements.Path(part)) for part in parts]
    except Exception as error:  # the reader raises different errors for each kind of damage
        raise InvalidInput(f"{name} is not SVG: {error}.", code="file_unreadable") from None
    return [stroke for stroke in strokes if len(stroke) > 1]


def _corners(line: Any) -> Float64[np.ndarray, "corners 2"]:
    import svgelements

    corners = [np.empty((0, 2))]
    for part in line:
        if not isinstance(part, svgelements.Move | svgelements.Line | svgelements.Close):
            corners.append(part.npoint(np.linspace(0.0, 1.0, 65)[1:]))
        elif part.end is not None:
            corners.append(np.array([[part.end.x, part.end.y]]))
    return np.concatenate(corners).astype(np.float64).reshape(-1, 2)


def _checked_drawing(drawing: bytes, name: str) -> bytes:
    """Check the size of an SVG file before it is parsed, and remove its style sheets.

    Style sheets do not move any line, but the parser can take minutes to process them.
    """
    try:
        root = ElementTree.fromstring(drawing)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InvalidInput(f"{name} is not SVG: {error}.", code="file_unreadable") from None
    total = 0
    for element in root.iter():
        kind = element.tag.rpartition("}")[2]
        # The parser copies an element for every use, up to thousands of times, and copies
        # attributes into all children.
        if kind == "use" or len(element.attrib) > 100:
            raise InvalidInput(
                f"{name} contains <use> elements (copies), or an element with over 100 attributes. "
                "Convert the drawing to plain paths.",
                code="too_many",
            )
        if kind == "style":
            element.text = ""
        # An empty element takes the parser as long as a curve of six numbers.
        total += 6 + sum(_numbers_in(value) for value in element.attrib.values())
        total += _letters_in(element.attrib.get("d", ""))
    _check_curves(total, name)
    return ElementTree.tostring(root)


def _numbers_in(value: str) -> int:
    return len(re.findall(r"(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", value))


def _letters_in(path: str) -> int:
    return sum(map(str.isalpha, path))


def _check_curves(numbers: int, name: str) -> None:
    """Raise an error if a drawing has too many curves.

    Every six numbers, or every element, count as one curve.
    """
    if numbers // 6 > MAX_CURVES:
        raise InvalidInput(
            f"{name} has about {numbers // 6:,} curves, but at most {MAX_CURVES:,} are allowed; "
            "simplify the drawing.",
            code="too_many",
        )


def _laid_out(
    strokes: Strokes, name: str, spacing: float, centre: Vector, normal: Vector, up: Vector | None
) -> Points:
    if not strokes:
        raise InvalidInput(f"{name} has no strokes. Use visible letters or lines.", code="empty")
    right, upwards, _ = frame_of(normal, up)
    corners = np.concatenate(strokes)
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    spacing = positive(spacing, "the spacing", "m")
    lengths = [np.linalg.norm(np.diff(stroke, axis=0), axis=1).sum() for stroke in strokes]
    # If strokes cross or follow each other, up to four in five points are dropped below.
    check_count(0.2 * np.maximum(np.array(lengths) / spacing, 1.0).sum(), spacing)
    axes = np.stack([right, upwards])
    points = [_along((stroke - middle) @ axes, spacing) for stroke in strokes]
    points = spaced_apart(np.concatenate(points), 0.6 * spacing)
    check_count(len(points), spacing)
    return np.asarray(centre, dtype=np.float64) + points


def _along(corners: Float64[np.ndarray, "corners 3"], spacing: float) -> Points:
    steps = np.diff(corners, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    moving = lengths > 0.0
    if not moving.any():
        return corners[:1]
    corners = corners[np.append(True, moving)]
    steps = steps[moving]
    lengths = lengths[moving]
    # Points spaced evenly along the entire stroke would round off its corners.
    cosine = np.einsum("ij,ij->i", steps[1:], steps[:-1]) / (lengths[1:] * lengths[:-1])
    sharp = 1 + np.flatnonzero(cosine < 0.5)  # the stroke bends by more than 60 degrees
    points = []
    for first, last in pairwise([0, *sharp.tolist(), len(lengths)]):
        travelled = np.concatenate([[0.0], np.cumsum(lengths[first:last])])
        count = max(1, int(np.ceil(travelled[-1] / spacing - 1e-9)))
        marks = travelled[-1] * np.linspace(0.0, 1.0, count + 1)
        part = corners[first : last + 1]
        points.append(
            np.stack([np.interp(marks, travelled, part[:, axis]) for axis in range(3)], axis=1)
        )
    return np.concatenate(points)
