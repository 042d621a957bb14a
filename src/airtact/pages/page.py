"""Pieces of one self-contained HTML page: pictures embedded, no script, nothing fetched."""

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape

from matplotlib.figure import Figure
from matplotlib.image import imsave

from airtact.figures.picture_file import PIXELS, drawn

STYLE = """
:root { color-scheme: light; --ink: #1d2430; --soft: #5b6675; --line: #dde2e9; --accent: #5a2a83; }
body { font: 16px/1.55 system-ui, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; color: var(--ink);
  max-width: 68rem; margin: 2.5rem auto 4rem; padding: 0 1.5rem; background: #fff; }
h1 { font-size: 1.7rem; margin: 0 0 .3rem; }
h2 { font-size: 1.2rem; margin: 2.8rem 0 .6rem; padding-top: 1rem; border-top: 1px solid var(--line); }
p { max-width: 50rem; }
.lead { color: var(--soft); margin-top: 0; }
.tiles { display: flex; flex-wrap: wrap; gap: .8rem; margin: 1.4rem 0; }
.tile { border: 1px solid var(--line); border-radius: .5rem; padding: .7rem 1rem; min-width: 9rem; flex: 1; }
.tile b { display: block; font-size: 1.45rem; color: var(--accent); font-variant-numeric: tabular-nums; }
.tile span { color: var(--soft); font-size: .85rem; }
figure { margin: 1rem 0; overflow-x: auto; }
img { max-width: 100%; height: auto; display: block; }
figcaption, caption { color: var(--soft); font-size: .9rem; text-align: left; max-width: 50rem; }
caption { padding: 0 0 .4rem; }
.scroll { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .92rem; }
th, td { padding: .3rem .9rem .3rem 0; text-align: right; border-bottom: 1px solid var(--line); vertical-align: top; }
th:first-child, td:first-child { text-align: left; }
thead th { color: var(--soft); font-weight: 600; }
.text th, .text td { text-align: left; }
.warning { border-left: 4px solid #d9822b; background: #fff7ec; padding: .6rem 1rem; }
pre { background: #f6f7f9; padding: 1rem; overflow-x: auto; font-size: .85rem; }
"""


def picture(figure: Figure, caption: str, alternative: str) -> str:
    """Embed a figure as PNG.

    Parameters
    ----------
    figure : what to show.
    caption : what stands below it.
    alternative : what it shows, for those who cannot see it.
    """
    buffer = io.BytesIO()
    pixels = drawn(figure)
    imsave(buffer, pixels, format="png")
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    width = round(pixels.shape[1] / PIXELS)
    image = f'<img alt="{escape(alternative)}" width="{width}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>"


def table(header: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "", text: bool = False) -> str:
    """Lay out rows of words; all but the first column to the right, or to the left if ``text``.

    >>> table(["focus", "Pa"], [["thumb", "12"]])[-63:]
    '<tbody><tr><td>thumb</td><td>12</td></tr></tbody></table></div>'
    """
    head = "".join(f"<th>{escape(word)}</th>" for word in header)
    body = "".join("<tr>" + "".join(f"<td>{escape(word)}</td>" for word in row) + "</tr>" for row in rows)
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    kind = ' class="text"' if text else ""
    return f'<div class="scroll"><table{kind}>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def tiles(facts: Iterable[tuple[str, str]]) -> str:
    """Show a few numbers large, each (number, what it is)."""
    shown = "".join(
        f'<div class="tile"><b>{escape(number)}</b><span>{escape(what)}</span></div>' for number, what in facts
    )
    return f'<div class="tiles">{shown}</div>'


def paragraph(words: str, kind: str = "") -> str:
    """One paragraph; ``kind`` may be "lead" or "warning"."""
    return f'<p class="{kind}">{escape(words)}</p>' if kind else f"<p>{escape(words)}</p>"


def folded(title: str, text: str) -> str:
    """Show a text as it is, behind a title to click."""
    return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>"


def document(title: str, pieces: Iterable[str]) -> str:
    """Put pieces of HTML together as one page.

    Parameters
    ----------
    title : of the page.
    pieces : HTML made by the functions of this module.
    """
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n<body>\n"
        + "\n".join(pieces)
        + "\n</body></html>\n"
    )


def section(title: str) -> str:
    """Head a section."""
    return f"<h2>{escape(title)}</h2>"
