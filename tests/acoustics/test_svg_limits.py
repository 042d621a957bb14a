"""Drawings that would hurt are rejected before they are expanded."""

import os

import pytest

from airtact.acoustics.drawings import svg_path
from airtact.errors import LARGEST_DRAWING, MOST_CURVES
from faults import raises_code

HEAD = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">'
LINE = '<path d="M0 0L1 1"/>'


def svg(inside: str) -> str:
    return f"{HEAD}{inside}</svg>"


def doubled(levels: int) -> str:
    """Use a line 2^levels times."""
    parts = [f'<g id="g0">{LINE}</g>']
    parts += [f'<g id="g{n + 1}">' + f'<use href="#g{n}"/>' * 2 + "</g>" for n in range(levels)]
    return svg("<defs>" + "".join(parts) + f'</defs><use href="#g{levels}"/>')


HURTFUL = {
    "used often": (svg(f'<g id="a">{LINE}</g>' + '<use href="#a"/>' * 6000), "too_many"),
    "used twice and twice again": (doubled(40), "too_many"),
    "used by itself": (svg(f'<g id="a">{LINE}<use href="#a"/></g>'), "file_too_large"),
    "nested": (svg("<g>" * 2000 + LINE + "</g>" * 2000), "file_too_large"),
    "many curves": (
        svg(f'<path d="M0 0{"C1 2 3 4 5 6" * (MOST_CURVES + 9)}"/>'),
        "too_many",
    ),
    "infinite": (svg('<path d="M0 0L1e400 1"/>'), "out_of_range"),
    "far": (svg('<path d="M0 0C1e308 1 -1e308 2 0 0"/>'), "out_of_range"),
    "far by its place": (svg(f'<g transform="scale(1e308)">{LINE}</g>'), "out_of_range"),
    "entities": (
        '<!DOCTYPE svg [<!ENTITY a "1 2 ">'
        + "".join(f'<!ENTITY a{n} "{("&a" + str(n - 1 or "") + ";") * 10}">' for n in range(1, 9))
        + ']><svg xmlns="http://www.w3.org/2000/svg"><path d="M&a8;"/></svg>',
        "file_unreadable",
    ),
    "large": (svg(" " * LARGEST_DRAWING), "file_too_large"),
    "no SVG": ("<svg", "file_unreadable"),
}


@pytest.mark.parametrize("name", HURTFUL)
def test_a_drawing_that_hurts_is_rejected(name, tmp_path):
    words, code = HURTFUL[name]
    (tmp_path / "drawing.svg").write_text(words)
    with raises_code(code, "drawing.svg"):
        svg_path(tmp_path / "drawing.svg", width=0.05, spacing=3e-3)


def test_a_pipe_is_no_drawing(tmp_path):
    os.mkfifo(tmp_path / "pipe.svg")
    with raises_code("file_unreadable", "pipe.svg"):
        svg_path(tmp_path / "pipe.svg", width=0.05, spacing=3e-3)


@pytest.mark.parametrize("words", ["M0 0" + "L1 1" * 20_000, "M0 0C" + "1 " * 60_000])
def test_a_path_of_many_curves_is_rejected(words):
    with raises_code("too_many", f"{MOST_CURVES:,}"):
        svg_path(words, width=0.05, spacing=3e-3)


def test_a_path_of_many_corners_in_one_place_is_drawn():
    zigzag = "M0 0" + " ".join(f"L{0.5 + 0.5 * (-1) ** n} {1e-4 * n}" for n in range(1000))
    assert len(svg_path(zigzag, width=0.05, spacing=3e-3)) < 200


def test_parts_that_are_used_again_are_drawn(tmp_path):
    (tmp_path / "drawing.svg").write_text(doubled(5))
    assert len(svg_path(tmp_path / "drawing.svg", width=0.05, spacing=3e-3)) == 25
