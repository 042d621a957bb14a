"""Writing as points for a ``Target``."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.target_points import Points, check_count, frame_of, spaced_apart
from airtact.errors import InvalidInput, Vector, positive


def text(
    words: str,
    height: float,
    spacing: float,
    centre: Vector = (0.0, 0.0, 0.0),
    normal: Vector = (0.0, 0.0, 1.0),
    up: Vector | None = None,
) -> Points:
    """Points (F, 3) [m] of text in Hershey's single-stroke letters (1967).

    Parameters
    ----------
    words : text in ASCII.
    height : height of a capital letter [m].
    spacing : largest distance between neighbours along a stroke [m].
    centre : (3,) middle of the text [m].
    normal : (3,) direction to the reader.
    up : (3,) direction of the letters' tops; None for y, or z if the normal is nearly y.

    Raises
    ------
    InvalidInput
        If the text is empty, a letter is not in the font, or ``polyline`` would raise it.

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
                f"{letter!r} of {words!r} is not in the font; write it in ASCII.",
                code="unknown_name",
            )
    font = HersheyFonts()
    # sans serif, in single strokes rather than outlines
    font.load_default_font("futural")
    font.normalize_rendering(1.0)  # otherwise y would run down
    strokes = [np.array(stroke, dtype=np.float64) for stroke in font.strokes_for_text(words)]
    # The height of capitals differs from font to font.
    capital = np.concatenate([np.array(stroke) for stroke in font.strokes_for_text("H")])
    scale = positive(height, "the height of a letter", "m") / float(np.ptp(capital[:, 1]))
    if not strokes:
        raise InvalidInput(f"{words!r} has no strokes.", code="empty")
    right, upwards, _ = frame_of(normal, up)
    corners = np.concatenate(strokes)
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    spacing = positive(spacing, "the spacing", "m")
    lengths = [scale * np.linalg.norm(np.diff(stroke, axis=0), axis=1).sum() for stroke in strokes]
    # If strokes cross or follow each other, up to four in five points are left out below.
    check_count(0.2 * np.maximum(np.array(lengths) / spacing, 1.0).sum(), spacing)
    axes = scale * np.stack([right, upwards])
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
    # Points spaced evenly over the whole stroke would round off its corners.
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
