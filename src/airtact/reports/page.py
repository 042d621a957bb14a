"""Self-contained HTML pages from templates, with embedded pictures and scripts."""

import base64
import io
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave
from PIL import (
    Image,
    WebPImagePlugin,  # noqa: F401 (otherwise, saving a picture first imports all 44 formats)
)

from airtact.errors import as_sentence
from airtact.files.atomic import whole_file

# Folder of the templates
FOLDER = Path(__file__).parent / "templates"

TEMPLATES = Environment(
    loader=FileSystemLoader(FOLDER),
    autoescape=True,
    # A missing value raises an error instead of being replaced by empty text.
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)

# Pixels of a picture per pixel of the page, for high-resolution screens
PIXELS = 1.35


TEMPLATES.filters["sentence"] = as_sentence


def write_page(path: Path, template: str, **values: object) -> None:
    """Fill a template with values, and write the page to a file, replacing an existing one.

    All text in the values is escaped.
    """
    with whole_file(path) as partial:
        partial.write_text(TEMPLATES.get_template(template).render(values), "utf-8")


def picture(figure: Figure, caption: str, alternative: str, wide: bool = False) -> Markup:
    """Return HTML that contains a figure as WebP and its caption.

    A ``wide`` figure scrolls on narrow screens instead of shrinking.
    """
    buffer = io.BytesIO()
    pixels = pixels_of(figure)
    # A quality of 90 % keeps letters sharp. Method 2 takes half the time for 2 % more bytes.
    image = Image.fromarray(np.ascontiguousarray(pixels[:, :, :3]))
    image.save(buffer, "webp", quality=90, method=2)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    height, width = (round(length / PIXELS) for length in pixels.shape[:2])
    pieces: object = TEMPLATES.get_template("pieces.html.j2").module
    return pieces.picture(data, width, height, caption, alternative, wide)  # pyright: ignore


def pixels_of(figure: Figure) -> UInt8[np.ndarray, "rows columns 4"]:
    """Render a figure to pixels, and crop the wide margins of 3-D axes."""
    figure.set_dpi(96 * PIXELS)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())
    # The background is white.
    inked = np.any(pixels[:, :, :3] < 255, axis=2)
    rows = np.flatnonzero(inked.any(axis=1))
    columns = np.flatnonzero(inked.any(axis=0))
    top = max(rows[0] - 8, 0)
    left = max(columns[0] - 8, 0)
    return np.ascontiguousarray(pixels[top : rows[-1] + 9, left : columns[-1] + 9])


def write_picture(path: Path, figure: Figure) -> None:
    """Write a figure to a PNG file; an existing file is replaced."""
    with whole_file(path) as partial:
        imsave(partial, pixels_of(figure), format="png")
