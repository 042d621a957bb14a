"""Figures as pixels, and as PNG files."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave

from airtact.files.atomic import whole_file

PIXELS = 1.35
"""Pixels drawn per pixel of the page, for screens that have more."""


def pixels_of(figure: Figure) -> UInt8[np.ndarray, "rows columns 4"]:
    """Draw a figure and cut off its empty margins, which are wide around a view in space."""
    figure.set_dpi(96 * PIXELS)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())
    inked = np.any(pixels[:, :, :3] < 255, axis=2)
    spans = []
    for axis in (1, 0):
        used = np.flatnonzero(inked.any(axis=axis))
        spans.append(slice(max(used[0] - 8, 0), used[-1] + 9))
    return np.ascontiguousarray(pixels[spans[0], spans[1]])


def write_picture(path: Path, figure: Figure) -> None:
    """Draw a figure into a PNG file, which appears only once it is complete."""
    with whole_file(path) as partial:
        imsave(partial, pixels_of(figure), format="png")
