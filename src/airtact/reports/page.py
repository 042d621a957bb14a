"""Self-contained HTML pages from the templates, with embedded pictures and scripts."""

import base64
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import UInt8
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave
from PIL import Image

from airtact.files.atomic import whole_file

Value = TypeVar("Value")
"""Value of a template: text, number, table or piece."""


TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent / "templates"),
    autoescape=True,
    # A value that is missing is an error, not empty text.
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


def page_from(template: str, **values: Value) -> str:
    """Fill a template with values; text among them is escaped."""
    return TEMPLATES.get_template(template).render(values)


def _piece(name: str, *values: object) -> Markup:
    return getattr(TEMPLATES.get_template("pieces.html.j2").module, name)(*values)


def document(title: str, pieces: Iterable[str]) -> str:
    """Join pieces made by the functions of this module into one page; any other text is escaped."""
    return page_from("page.html.j2", title=title, pieces=list(pieces))


def picture(figure: Figure, caption: str, alternative: str, wide: bool = False) -> Markup:
    """Embed a figure as WebP; a narrow screen scrolls a wide one instead of shrinking it."""
    buffer = io.BytesIO()
    pixels = pixels_of(figure)
    # A quality of 90 % keeps letters clean.
    Image.fromarray(np.ascontiguousarray(pixels[:, :, :3])).save(buffer, "webp", quality=90)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    height, width = (round(length / PIXELS) for length in pixels.shape[:2])
    return _piece("picture", data, width, height, caption, alternative, wide)


def table(
    header: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "", text: bool = False
) -> Markup:
    """Lay out rows; columns after the first are right-aligned, or left-aligned if ``text``.

    >>> print(table(["focus", "Pa"], [["<thumb>", "12"]]))
    <div class="scroll"><table>
    <thead><tr><th scope="col">focus</th><th scope="col">Pa</th></tr></thead>
    <tbody>
    <tr><th scope="row">&lt;thumb&gt;</th><td>12</td></tr>
    </tbody></table></div>
    """
    return _piece("table", header, list(rows), caption, text)


def key_numbers(facts: Iterable[tuple[str, str]]) -> Markup:
    """Show a few large numbers, each (number, caption)."""
    return _piece("key_numbers", list(facts))


def paragraph(words: str, kind: str = "") -> Markup:
    """One paragraph; ``kind`` may be "lead" or "warning"."""
    return _piece("paragraph", words, kind)


def folded(title: str, text: str) -> Markup:
    """Show a text unchanged, behind a title to click."""
    return _piece("folded", title, text)


def heading(title: str) -> Markup:
    """Head a page."""
    return _piece("heading", title)


def section(title: str) -> Markup:
    """Head a section."""
    return _piece("section", title)


PIXELS = 1.35
"""Pixels of a picture per pixel of the page, for screens with high resolution."""


def pixels_of(figure: Figure) -> UInt8[np.ndarray, "rows columns 4"]:
    """Draw a figure and cut off its empty margins, which are wide around 3-D axes."""
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
    """Draw a figure into a PNG file, which appears only once it is complete."""
    with whole_file(path) as partial:
        imsave(partial, pixels_of(figure), format="png")
