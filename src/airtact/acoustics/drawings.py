"""Writing and pictures as points for a ``Target``: text in single strokes, SVG paths, grey-scale images."""

import io
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Real

from airtact.acoustics.svg_limits import check_drawing, check_path
from airtact.acoustics.target_points import Points, check_count, frame_of, spaced_apart
from airtact.checks import check_finite, file_fault, positive, real_numbers
from airtact.errors import (
    LARGEST_DRAWING,
    LARGEST_NUMBER,
    MOST_PIXELS,
    SMALLEST_NUMBER,
    InvalidInput,
    Vector,
)
from airtact.files.apart import out_of_memory, read_apart
from airtact.files.bounded import Arrays, bytes_of

PICTURE_FORMATS = ("PNG", "JPEG", "TIFF", "PPM")
"""What is opened, in the names of Pillow, whose PPM is PGM too; others start programs, such as Ghostscript."""

TIFF_BEGINS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF, in both orders and of both sizes."""

LARGEST_PLAIN = 200_000
"""Longest SVG that is read by this process [bytes]; a longer one is read by one of its own."""

FONT = "futural"
"""The Hershey font of single strokes without serifs: what is felt is the stroke, not the outline of a letter."""

DARKEST_SHARE = 0.05
"""Points of a picture darker than this fraction of its brightest are left out."""

SHARP_CORNER_COSINE = 0.5
"""Cosine of the bend of a stroke below which its corner becomes a point: 60 degrees."""

LEAST_KEPT = 0.2
"""Least share of the points of strokes that are kept where strokes cross or follow each other."""

Strokes = list[Float64[np.ndarray, "_ 2"]]
"""Lines from corner to corner in a plane, x to the right and y up."""


def text(
    words: str,
    height: float,
    spacing: float,
    centre: Vector = (0.0, 0.0, 0.0),
    normal: Vector = (0.0, 0.0, 1.0),
    up: Vector | None = None,
) -> Points:
    """Points (F, 3) [m] of writing, in single strokes: the centre lines of letters (A. V. Hershey's fonts, 1967).

    Parameters
    ----------
    words : what is written, in ASCII.
    height : of a capital letter [m].
    spacing : largest distance of neighbours along a stroke [m].
    centre : (3,) middle of the writing [m].
    normal : (3,) direction from which it is read.
    up : (3,) direction of the letters' tops; None for y, or z where the normal is nearly y.

    Raises
    ------
    InvalidInput
        If there is nothing to write, a letter is not in the font, or as ``polyline``.

    Examples
    --------
    >>> letters = text("AIR", height=0.02, spacing=3e-3)
    >>> np.ptp(letters, axis=0).round(4).tolist()
    [0.041, 0.02, 0.0]
    """
    from HersheyFonts import HersheyFonts  # read only where something is written

    check_count(len(words), spacing)
    font = HersheyFonts()
    font.load_default_font(FONT)
    font.normalize_rendering(1.0)  # or y would run down
    unknown = [letter for letter in words if not 32 <= ord(letter) < 127]
    if unknown:
        raise InvalidInput(
            f"{unknown[0]!r} of {words!r} is not one of the 95 letters of the font; write it in ASCII.",
            code="unknown_name",
        )
    strokes = [np.array(stroke, dtype=np.float64) for stroke in font.strokes_for_text(words)]
    capital = np.concatenate(
        [np.array(stroke, dtype=np.float64) for stroke in font.strokes_for_text("H")]
    )
    scale = positive(height, "the height of a letter", "m") / float(np.ptp(capital[:, 1]))
    return _laid_out(
        [stroke * scale for stroke in strokes], repr(words), spacing, centre, normal, up
    )


def svg_path(
    source: str | Path,
    width: float,
    spacing: float,
    centre: Vector = (0.0, 0.0, 0.0),
    normal: Vector = (0.0, 0.0, 1.0),
    up: Vector | None = None,
) -> Points:
    """Points (F, 3) [m] of the lines of an SVG drawing: its paths, polygons, circles and so on, with transforms.

    Parameters
    ----------
    source : an .svg file, or the text of one path, such as "M 0 0 L 10 0 C 10 5 5 10 0 10 Z".
    width : of the whole drawing [m], or its height where it has no width.
    spacing : largest distance of neighbours along a line [m].
    centre : (3,) middle of the drawing [m].
    normal : (3,) direction from which it is seen.
    up : (3,) direction of its top; None for y, or z where the normal is nearly y.

    Raises
    ------
    InvalidInput
        If the file cannot be read or is not SVG, it holds no lines, or as ``polyline``.
    """
    width, spacing = (
        positive(width, "the width of the drawing", "m"),
        positive(spacing, "the spacing", "m"),
    )
    name = source.name if isinstance(source, Path) else repr(source)
    strokes = _svg_strokes(source, name)
    corners = np.concatenate(strokes) if strokes else np.empty((0, 2))
    extent = np.ptp(corners, axis=0) if len(corners) else np.zeros(2)
    size = extent[0] if extent[0] > 0.0 else extent[1]
    if size < SMALLEST_NUMBER:
        raise InvalidInput(
            f"{name} holds {len(strokes)} lines, none of which is longer than 0.", code="empty"
        )
    scaled = [stroke * [width / size, -width / size] for stroke in strokes]  # in SVG y runs down
    return _laid_out(scaled, name, spacing, centre, normal, up)


def _svg_strokes(source: str | Path, name: str) -> Strokes:
    """Turn the lines of a drawing into corners close to each other, in its own units."""
    if isinstance(source, Path) or source.endswith(".svg"):
        path = Path(source)
        raw = bytes_of(path, LARGEST_DRAWING)
        check_drawing(raw, name)
        found = (
            stroke_arrays(path) if len(raw) <= LARGEST_PLAIN else read_apart(stroke_arrays, path)
        )
        strokes = np.split(found["corners"], np.cumsum(found["counts"]))[:-1]
    else:
        check_path(source, name)
        strokes = _parsed(source, name)
    for stroke in strokes:
        farthest = np.abs(stroke).max(initial=0.0)
        if not farthest <= LARGEST_NUMBER:
            sentence = f"{name} has a line at {farthest:.3g}, but lines lie within {LARGEST_NUMBER:g} units."
            raise InvalidInput(sentence, code="out_of_range")
    return [stroke for stroke in strokes if len(stroke) > 1]


def stroke_arrays(path: Path) -> Arrays:
    """Read the "corners" (N, 2) of all strokes of an SVG file, and the "counts" (S,) of corners of each."""
    strokes = _parsed(bytes_of(path, LARGEST_DRAWING), path.name)
    corners = np.concatenate([np.empty((0, 2)), *strokes])
    return {
        "corners": corners,
        "counts": np.array([len(stroke) for stroke in strokes], dtype=np.int64),
    }


def _parsed(drawing: bytes | str, name: str) -> Strokes:
    """Read the strokes of an SVG file or of one path."""
    import svgelements  # read only where something is drawn

    try:
        with np.errstate(all="ignore"):  # numbers that are too large are named above
            if isinstance(drawing, bytes):
                elements = svgelements.SVG.parse(io.BytesIO(drawing)).elements()
                paths = [
                    svgelements.Path(one) for one in elements if isinstance(one, svgelements.Shape)
                ]
            else:
                paths = [svgelements.Path(drawing)]
            return [
                _stroke(svgelements.Path(part)) for path in paths for part in path.as_subpaths()
            ]
    except MemoryError:
        raise out_of_memory(name) from None
    except Exception as error:  # the reader has its own way to fail on each damage
        raise InvalidInput(f"{name} is not SVG: {error}.", code="file_unreadable") from None


def _stroke(line: Any) -> Float64[np.ndarray, "corners 2"]:
    """Corners of one subpath: the ends of its straight parts, and 64 points of each curve."""
    import svgelements

    ends = []
    for part in line:
        if isinstance(part, svgelements.Move | svgelements.Line | svgelements.Close):
            ends += [] if part.end is None else [[[part.end.x, part.end.y]]]
        else:
            ends.append(part.npoint(np.linspace(0.0, 1.0, 65)[1:]))
    return np.concatenate(ends).astype(np.float64).reshape(-1, 2) if ends else np.empty((0, 2))


def picture(
    image: str | Path | Real[np.ndarray, "rows columns"],
    width: float,
    spacing: float,
    centre: Vector = (0.0, 0.0, 0.0),
    normal: Vector = (0.0, 0.0, 1.0),
    up: Vector | None = None,
) -> tuple[Points, Float64[np.ndarray, "points"]]:
    """Points on a plane, and the share of each: the brightness of a grey-scale picture around it.

    Parameters
    ----------
    image : a picture file, or (R, C) brightness, the first row on top.
    width : of the picture [m].
    spacing : of the points, on a square grid [m].
    centre : (3,) its middle [m].
    normal : (3,) direction from which it is seen.
    up : (3,) direction of its top; None for y, or z where the normal is nearly y.

    Returns
    -------
    (F, 3) points [m], and (F,) shares for ``Target(points, shares=shares)``, 1 at the brightest; those below 0.05 are
    left out.

    Raises
    ------
    InvalidInput
        If the file cannot be read, the picture is black or no grey-scale, or there would be more than 4096 points.

    Examples
    --------
    >>> points, shares = picture(np.array([[0.0, 100.0], [50.0, 0.0]]), width=0.02, spacing=0.01)
    >>> (1e3 * points).round(1).tolist(), shares.tolist()
    ([[5.0, 5.0, 0.0], [-5.0, -5.0, 0.0]], [1.0, 0.5])
    """
    bright = _brightness(image)
    width, spacing = (
        positive(width, "the width of the picture", "m"),
        positive(spacing, "the spacing", "m"),
    )
    rows, columns = bright.shape
    right, upwards, _ = frame_of(normal, up)
    across, down = max(1, round(width / spacing)), max(1, round(width * rows / columns / spacing))
    check_count(across * down, spacing)
    shares = _averaged(_averaged(bright, down).T, across).T
    shares = shares / shares.max()
    x = ((np.arange(across) + 0.5) / across - 0.5) * width
    y = (0.5 - (np.arange(down) + 0.5) / down) * width * rows / columns
    grid = (
        np.asarray(centre, dtype=np.float64) + y[:, None, None] * upwards + x[None, :, None] * right
    )
    kept = shares >= DARKEST_SHARE
    return grid[kept], shares[kept]


def _brightness(
    image: str | Path | Real[np.ndarray, "rows columns"],
) -> Float64[np.ndarray, "rows columns"]:
    """Read the brightness of a picture; raise where it is black or not a picture."""
    bright = (
        _read(Path(image))
        if isinstance(image, str | Path)
        else real_numbers(image, "the brightness")
    )
    check_finite(bright, "the brightness")
    if bright.ndim != 2 or bright.size == 0 or bright.min() < 0.0 or bright.max() == 0.0:
        least = f", its smallest value {bright.min():g}" if bright.size else ""
        raise InvalidInput(
            f"a picture is rows and columns of brightness from 0 up, not all 0, not of shape {bright.shape}{least}.",
            code="wrong_kind",
        )
    return bright


def _read(path: Path) -> Float64[np.ndarray, "rows columns"]:
    """Read a picture; a TIFF, of many makes and compressions, by a process of its own."""
    if path.exists() and not path.is_file():
        raise InvalidInput(
            f"{path.name} is 1 folder, device or pipe, not a picture.", code="file_unreadable"
        )
    try:
        with path.open("rb") as file:
            apart = file.read(4) in TIFF_BEGINS
    except OSError as error:
        raise file_fault(path, error) from None
    return (read_apart(picture_arrays, path) if apart else picture_arrays(path))["brightness"]


def picture_arrays(path: Path) -> Arrays:
    """Read the "brightness" (R, C) of a picture file."""
    from PIL import Image  # comes with matplotlib

    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore"
            )  # of damage that the reader passes over; pixels are counted here
            with Image.open(path, formats=PICTURE_FORMATS) as image:
                _check_pixels(path.name, image.width * image.height)
                return {"brightness": np.asarray(image.convert("L"), dtype=np.float64)}
    except Image.UnidentifiedImageError:
        sentence = f"cannot read the file {path}: it is none of the 4 kinds of picture, PNG, JPEG, TIFF, PGM."
        raise InvalidInput(sentence, code="file_unreadable") from None
    except Image.DecompressionBombError as error:
        raise InvalidInput(f"{path.name} has too many pixels: {error}.", code="too_many") from None
    except OSError as error:
        raise file_fault(path, error) from None
    except InvalidInput:
        raise
    except MemoryError:
        raise out_of_memory(path.name) from None
    except Exception as error:  # the reader has its own way to fail on each damage
        raise InvalidInput(
            f"{path.name} cannot be read as a picture: {error}.", code="file_unreadable"
        ) from None


def _check_pixels(name: str, pixels: int) -> None:
    if pixels > MOST_PIXELS:
        sentence = f"{name} has {pixels:,} pixels, more than {MOST_PIXELS:,}; make it smaller."
        raise InvalidInput(sentence, code="too_many")


def _averaged(
    rows: Float64[np.ndarray, "rows columns"], count: int
) -> Float64[np.ndarray, "cells columns"]:
    """Mean over ``count`` equal parts of the rows; a row that is cut counts in part."""
    total = np.concatenate([np.zeros((1, rows.shape[1])), np.cumsum(rows, axis=0)])
    cuts = np.linspace(0.0, len(rows), count + 1)
    index = np.minimum(cuts.astype(np.int64), len(rows) - 1)
    sums = total[index] + (cuts - index)[:, None] * rows[index]
    return np.diff(sums, axis=0) * count / len(rows)


def _laid_out(
    strokes: Strokes, name: str, spacing: float, centre: Vector, normal: Vector, up: Vector | None
) -> Points:
    """Place strokes in a plane around a point, and points along them."""
    if not strokes:
        raise InvalidInput(f"{name} has 0 strokes: there is nothing to feel.", code="empty")
    right, upwards, _ = frame_of(normal, up)
    corners = np.concatenate(strokes)
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    spacing = positive(spacing, "the spacing", "m")
    steps = [np.linalg.norm(np.diff(stroke, axis=0), axis=1).sum() for stroke in strokes]
    check_count(np.maximum(np.array(steps) / spacing, 1.0).sum() * LEAST_KEPT, spacing)
    found = [
        _along(np.asarray(stroke - middle) @ np.stack([right, upwards]), spacing)
        for stroke in strokes
    ]
    points = spaced_apart(np.concatenate(found), 0.6 * spacing)
    check_count(len(points), spacing)
    return np.asarray(centre, dtype=np.float64) + points


def _along(corners: Float64[np.ndarray, "corners 3"], spacing: float) -> Points:
    """Place points evenly along a stroke, at its ends and sharp corners too, however close its corners are."""
    steps = np.diff(corners, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    if not lengths.max(initial=0.0) > 0.0:
        return corners[:1]
    corners = corners[np.append(True, lengths > 0.0)]
    steps, lengths = steps[lengths > 0.0], lengths[lengths > 0.0]
    cosine = np.einsum("ij,ij->i", steps[1:], steps[:-1]) / (lengths[1:] * lengths[:-1])
    cuts = [0, *(1 + np.flatnonzero(cosine < SHARP_CORNER_COSINE)).tolist(), len(lengths)]
    found = []
    for first, last in pairwise(cuts):
        way = np.concatenate([[0.0], np.cumsum(lengths[first:last])])
        count = max(1, int(np.ceil(way[-1] / spacing - 1e-9)))
        marks = way[-1] * np.linspace(0.0, 1.0, count + 1)
        part = corners[first : last + 1]
        found.append(np.stack([np.interp(marks, way, part[:, axis]) for axis in range(3)], axis=1))
    return np.concatenate(found)
