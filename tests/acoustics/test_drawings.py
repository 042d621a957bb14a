"""Writing and SVG as points: upright, to scale, and rejected before a reader expands too much."""

import os

import numpy as np
import pytest
from scipy.spatial import KDTree

from airtact.acoustics.target_points import MAX_CURVES, MAX_DRAWING_BYTES, svg_path, text
from faults import raises_code


def test_a_letter_is_upright_to_scale_and_in_the_middle():
    letter = text("A", height=0.02, spacing=1e-3, centre=(0.01, 0.0, 0.05))
    assert letter[:, 1].max() == pytest.approx(0.01)
    assert letter[:, 1].min() == pytest.approx(-0.01)
    np.testing.assert_allclose(letter[:, 2], 0.05)
    # The apex of an A is one point over its middle, its legs are far apart.
    top, bottom = letter[letter[:, 1] > 0.008], letter[letter[:, 1] < -0.0095]
    assert np.ptp(top[:, 0]) < 3e-3
    assert top[:, 0].mean() == pytest.approx(0.01, abs=1e-4)
    assert np.ptp(bottom[:, 0]) > 0.012


def test_letters_follow_each_other_to_the_right_of_who_reads_them():
    # Read from +x with z up, the right is +y; the L has its long stroke on its left.
    word = text("IL", height=0.02, spacing=1e-3, normal=(1.0, 0.0, 0.0), up=(0.0, 0.0, 1.0))
    np.testing.assert_allclose(word[:, 0], 0.0, atol=1e-15)
    assert word[word[:, 2] < -0.0099][:, 1].max() == word[:, 1].max()
    assert word[:, 1].min() == pytest.approx(-word[:, 1].max())
    assert np.sum(word[:, 2] > 0.0099) == 2


def test_strokes_that_meet_leave_no_double_points():
    letters = text("AIRE", height=0.03, spacing=3e-3)
    nearest = KDTree(letters).query(letters, k=2)[0][:, 1]
    assert nearest.min() > 0.6 * 3e-3 * (1 - 1e-6)
    assert nearest.max() <= 3e-3 * 1.0001


CIRCLE = "M 10 0 A 10 10 0 0 1 -10 0 A 10 10 0 0 1 10 0 Z"


def test_a_path_of_arcs_is_a_circle_to_scale():
    points = svg_path(CIRCLE, width=0.03, spacing=2e-3, centre=(0.0, 0.0, 0.02))
    np.testing.assert_allclose(np.linalg.norm(points - [0, 0, 0.02], axis=1), 0.015, rtol=2e-3)
    assert len(points) == pytest.approx(np.pi * 0.03 / 2e-3, abs=2)


def test_in_svg_y_runs_down():
    flag = svg_path("M 0 0 L 0 20 M 0 0 L 10 0", width=0.01, spacing=1e-3)
    assert np.ptp(flag[:, 1]) == pytest.approx(0.02)
    assert flag[flag[:, 0] > 0.0][:, 1].min() == pytest.approx(
        0.01
    )  # the flag is at the top of its mast


def test_a_corner_of_a_path_is_not_cut():
    square = svg_path("M 0 0 H 10 V 10 H 0 Z", width=0.02, spacing=5e-3)
    corners = 0.01 * np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]])
    assert KDTree(square).query(corners)[0].max() < 1e-12
    assert len(square) == 16
    # many corners in one place are no more points than the spacing asks for
    zigzag = "M0 0" + " ".join(f"L{0.5 + 0.5 * (-1) ** n} {1e-4 * n}" for n in range(1000))
    assert len(svg_path(zigzag, width=0.05, spacing=3e-3)) < 200


def test_a_file_has_its_shapes_and_transforms(tmp_path):
    file = tmp_path / "drawing.svg"
    file.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100"><g transform="scale(2)">'
        '<rect x="0" y="0" width="20" height="10" fill="none"/></g><circle cx="60" cy="10" r="20"/></svg>'
    )
    points = svg_path(file, width=0.08, spacing=2e-3)
    assert np.ptp(points[:, 0]) == pytest.approx(
        0.08, rel=1e-3
    )  # the rectangle to 40, the circle to 80
    assert np.ptp(points[:, 1]) == pytest.approx(0.04, rel=1e-3)
    assert np.linalg.norm(points - [0.02, 0.0, 0.0], axis=1).min() == pytest.approx(0.02, rel=1e-2)


HEAD = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">'
LINE = '<path d="M0 0L1 1"/>'


def svg(inside: str) -> str:
    return f"{HEAD}{inside}</svg>"


ENTITIES = "".join(f'<!ENTITY a{n} "{("&a" + str(n - 1 or "") + ";") * 10}">' for n in range(1, 9))
HURTFUL = {
    "used often": (svg(f'<g id="a">{LINE}</g>' + '<use href="#a"/>' * 6000), "too_many"),
    "nested": (svg("<g>" * 6000 + LINE + "</g>" * 6000), "too_many"),
    "many curves": (svg(f'<path d="M0 0{"C1 2 3 4 5 6" * (MAX_CURVES + 9)}"/>'), "too_many"),
    "many ends": (svg(f'<path d="M0 0{"Z" * 400_000}"/>'), "too_many"),
    "many attributes": (
        svg("<g " + " ".join(f'a{n}=""' for n in range(30_000)) + f">{LINE * 900}</g>"),
        "too_many",
    ),
    "infinite": (svg('<path d="M0 0L1e400 1"/>'), "out_of_range"),
    "far": (svg('<path d="M0 0C1e308 1 -1e308 2 0 0"/>'), "out_of_range"),
    "far by its place": (svg(f'<g transform="scale(1e308)">{LINE}</g>'), "out_of_range"),
    "entities": (
        f'<!DOCTYPE svg [<!ENTITY a "1 2 ">{ENTITIES}]>' + svg('<path d="M&a8;"/>'),
        "file_unreadable",
    ),
    "large": (svg(" " * MAX_DRAWING_BYTES), "file_too_large"),
    "no SVG": ("<svg", "file_unreadable"),
}


@pytest.mark.parametrize("name", HURTFUL)
def test_a_drawing_that_hurts_is_rejected(name, tmp_path):
    words, code = HURTFUL[name]
    (tmp_path / "drawing.svg").write_text(words)
    with raises_code(code):
        svg_path(tmp_path / "drawing.svg", width=0.05, spacing=3e-3)


def test_a_pipe_is_no_drawing(tmp_path):
    os.mkfifo(tmp_path / "pipe.svg")
    with raises_code("file_unreadable"):
        svg_path(tmp_path / "pipe.svg", width=0.05, spacing=3e-3)


def test_style_sheets_are_ignored(tmp_path):
    (tmp_path / "drawing.svg").write_text(svg("<style>" + "/*" * 200_000 + "</style>" + LINE))
    assert len(svg_path(tmp_path / "drawing.svg", width=0.05, spacing=3e-3)) == 25


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: text("", 0.02, 2e-3), "empty"),
        (lambda: text("Grüße", 0.02, 2e-3), "unknown_name"),
        (lambda: text("A", -0.02, 2e-3), "out_of_range"),
        (lambda: text("A", 20.0, 2e-3), "too_many"),
        (lambda: svg_path("M 0 0 L 1 zebra", 0.02, 2e-3), "file_unreadable"),
        (lambda: svg_path("M 3 3 Z", 0.02, 2e-3), "empty"),
        (lambda: svg_path("missing.svg", 0.02, 2e-3), "file_missing"),
        (lambda: svg_path("M0 0" + "L1 1" * 20_000, 0.05, 3e-3), "too_many"),
        (lambda: svg_path("M0 0C" + "1 " * 60_000, 0.05, 3e-3), "too_many"),
    ],
)
def test_faults_are_rejected(make, code):
    with raises_code(code):
        make()
