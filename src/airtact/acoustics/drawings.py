"""Text and SVG drawings as points for a ``Target``."""

import io
import re
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.target_points import Points, check_count, frame_of, spaced_apart
from airtact.errors import LARGEST_NUMBER, SMALLEST_NUMBER, InvalidInput, Vector, positive
from airtact.files.bounded import bytes_of

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
    """Return points (F, 3) [m] along a text in Hershey's single-stroke font of 1967.

    Parameters
    ----------
    words : the text, in ASCII characters.
    height : height of a capital letter [m].
    spacing : largest distance between neighbours along a stroke [m].
    centre : (3,) middle of the text [m].
    normal : (3,) direction toward the reader.
    up : (3,) upward direction of the letters; by default y, or z if the normal is
        nearly parallel to y.

    Raises
    ------
    InvalidInput
        If the text is empty or a letter is not in the font. Also under the conditions listed in
        ``polyline``.

    Examples
    --------
    >>> letters = text("AIR", height=0.02, spacing=3e-3)
    >>> np.ptp(letters, axis=0).round(4).tolist()
    [0.041, 0.02, 0.0]
    """
    from HersheyFonts import HersheyFonts

    check_count(len(words), spacing)
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
    """Return points (F, 3) along the lines of an SVG drawing [m].

    The drawing may contain paths, polygons, circles and transforms.

    Parameters
    ----------
    source : an .svg file, or the text of one path, such as "M 0 0 L 10 0 C 10 5 5 10 0 10 Z".
    width : width to which the drawing is scaled [m]; for a single vertical line, its height.
    spacing : largest distance between neighbours along a line [m].
    centre : (3,) middle of the drawing [m].
    normal : (3,) direction toward the viewer.
    up : (3,) upward direction of the drawing; by default y, or z if the normal is
        nearly parallel to y.

    Raises
    ------
    InvalidInput
        If the file cannot be read, is not an SVG file, contains no lines or contains too many
        curves. Also under the conditions listed in ``polyline``.
    """
    width = positive(width, "the width of the drawing", "m")
    spacing = positive(spacing, "the spacing", "m")
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
                f"{name} contains copies of elements, or an element with over 100 attributes; "
                "flatten the drawing.",
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
