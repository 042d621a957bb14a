"""Writing, SVG and pictures as points: upright, to scale, and rejected with what is wrong."""

import contextlib
import os

import numpy as np
import pytest
from airtact.files.apart import read_apart
from PIL import Image
from scipy.spatial import KDTree

from airtact.acoustics import drawings
from airtact.acoustics.drawings import picture, svg_path, text
from airtact.errors import InvalidInput
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
    foot = word[word[:, 2] < -0.0099]
    assert foot[:, 1].max() == word[:, 1].max()
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


def test_a_picture_asks_for_its_brightness_where_it_is_bright():
    bright = np.zeros((20, 30))
    bright[:10, :15] = 200.0  # the upper left quarter
    bright[10:, 15:] = 100.0
    points, shares = picture(
        bright, width=0.03, spacing=5e-3, normal=(0.0, 0.0, 1.0), centre=(0.1, 0.0, 0.0)
    )
    assert len(points) == 12
    left = points[:, 0] < 0.1
    np.testing.assert_allclose(shares[left], 1.0)
    np.testing.assert_allclose(shares[~left], 0.5)
    assert np.all(points[left, 1] > 0)
    assert np.all(points[~left, 1] < 0)


def test_a_picture_keeps_its_mean_whatever_the_spacing():
    bright = np.random.default_rng(5).uniform(100, 255, (37, 53))
    points, shares = picture(bright, width=0.053, spacing=7e-3)
    assert len(points) == 8 * 5
    np.testing.assert_allclose(
        shares.mean() / shares.max(), bright.mean() / (bright.mean() / shares.mean()), rtol=1e-12
    )
    fine, _ = picture(bright, width=0.053, spacing=1e-3)
    assert len(fine) == 37 * 53


def test_a_picture_file_is_read_as_grey(tmp_path):
    colours = np.zeros((8, 16, 3), dtype=np.uint8)
    colours[:, 8:] = [255, 255, 255]
    Image.fromarray(colours).save(tmp_path / "half.png")
    points, shares = picture(tmp_path / "half.png", width=0.016, spacing=4e-3)
    assert np.all(points[:, 0] > 0)
    np.testing.assert_array_equal(shares, 1.0)


@pytest.mark.parametrize(
    ("make", "code", "sentence"),
    [
        (lambda: text("", 0.02, 2e-3), "empty", "'' has 0 strokes"),
        (
            lambda: text("Grüße", 0.02, 2e-3),
            "unknown_name",
            "'ü' of 'Grüße' is not one of the 95 letters",
        ),
        (lambda: text("A", -0.02, 2e-3), "out_of_range", "the height of a letter is -0.02 m"),
        (lambda: text("A", 20.0, 2e-3), "too_many", "are the other lengths in millimetres"),
        (lambda: svg_path("M 0 0 L 1 zebra", 0.02, 2e-3), "file_unreadable", "'M 0 0 L 1 zebra'"),
        (
            lambda: svg_path("M 3 3 Z", 0.02, 2e-3),
            "empty",
            "holds ... lines, none of which is longer than 0",
        ),
        (
            lambda: svg_path("missing.svg", 0.02, 2e-3),
            "file_missing",
            "the file missing.svg does not exist",
        ),
        (
            lambda: picture("missing.png", 0.02, 2e-3),
            "file_missing",
            "the file missing.png does not exist",
        ),
        (
            lambda: picture(np.zeros((4, 4)), 0.02, 2e-3),
            "wrong_kind",
            "not all 0, not of shape (4, 4), its smallest value 0",
        ),
        (lambda: picture(np.ones(4), 0.02, 2e-3), "wrong_kind", "not of shape (4,)"),
        (lambda: picture(-np.ones((2, 2)), 0.02, 2e-3), "wrong_kind", "its smallest value -1"),
        (
            lambda: picture(np.ones((9, 9)), 0.2, 1e-3),
            "too_many",
            "a spacing of 1 mm gives 40000 points, more than 4096",
        ),
    ],
)
@pytest.mark.usefixtures("as_outside_the_tests")
def test_faults_are_rejected(make, code, sentence):
    with raises_code(code, *sentence.split(" ... ")):
        make()


def test_a_broken_svg_file_is_rejected(tmp_path):
    (tmp_path / "broken.svg").write_text("<svg><path")
    with raises_code("file_unreadable", "broken.svg is not SVG"):
        svg_path(tmp_path / "broken.svg", 0.02, 2e-3)
    Image.new("L", (4, 4)).save(tmp_path / "black.png")
    with raises_code("wrong_kind", "not all 0"):
        picture(tmp_path / "black.png", 0.02, 2e-3)
    (tmp_path / "no.png").write_text("no picture")
    with raises_code("file_unreadable", "cannot read the file", "no.png"):
        picture(tmp_path / "no.png", 0.02, 2e-3)


def test_only_png_jpeg_tiff_and_pgm_are_opened(tmp_path):
    grey = Image.fromarray(np.arange(1, 17, dtype=np.uint8).reshape(4, 4))
    for ending in ("png", "jpg", "tiff", "pgm"):
        grey.save(tmp_path / f"a.{ending}")
        assert len(picture(tmp_path / f"a.{ending}", width=0.02, spacing=5e-3)[0]) > 10
    for ending in ("eps", "gif", "bmp", "pdf"):
        grey.save(tmp_path / f"a.{ending}")
        (tmp_path / "posing.png").write_bytes((tmp_path / f"a.{ending}").read_bytes())
        for name in (f"a.{ending}", "posing.png"):
            with raises_code("file_unreadable", name, "PNG, JPEG, TIFF, PGM"):
                picture(tmp_path / name, width=0.02, spacing=5e-3)


@pytest.mark.parametrize("side", [4097, 10_000, 13_000, 60_000])
def test_pixels_are_counted_before_a_picture_is_decoded(tmp_path, side):
    path = tmp_path / "large.pgm"
    path.write_bytes(b"P5 %d %d 255\n" % (side, side))
    with raises_code("too_many"):
        picture(path, width=0.02, spacing=5e-3)


def test_a_damaged_picture_or_a_pipe_is_rejected(tmp_path):
    Image.fromarray(np.full((64, 64), 9, dtype=np.uint8)).save(tmp_path / "whole.png")
    data = (tmp_path / "whole.png").read_bytes()
    path = tmp_path / "damaged.png"
    for place in range(8, len(data), 3):
        for flipped in (
            data[:place],
            data[:place] + bytes([data[place] ^ 255]) + data[place + 1 :],
        ):
            path.write_bytes(flipped)
            with contextlib.suppress(InvalidInput):
                picture(path, width=0.02, spacing=5e-3)
    os.mkfifo(tmp_path / "pipe.png")
    with raises_code("file_unreadable", "pipe"):
        picture(tmp_path / "pipe.png", width=0.02, spacing=5e-3)


def test_a_long_drawing_and_a_tiff_are_read_by_a_process_of_their_own(tmp_path, monkeypatch):
    called = []

    def noted(reader, path):
        called.append(path.name)
        return read_apart(reader, path)

    monkeypatch.setattr(drawings, "read_apart", noted)
    angles = np.linspace(0, 2 * np.pi, 8000)
    corners = " L ".join(f"{np.cos(one):.14f} {np.sin(one):.14f}" for one in angles)
    long = tmp_path / "round.svg"
    long.write_text(f'<svg xmlns="http://www.w3.org/2000/svg"><path d="M {corners} Z"/></svg>')
    points = svg_path(long, width=0.02, spacing=2e-3)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.01, rtol=1e-3)
    brightness = np.array([[0, 100], [50, 200]], dtype=np.uint8)
    Image.fromarray(brightness).save(tmp_path / "grey.tif")
    Image.fromarray(brightness).save(tmp_path / "grey.png")
    shares = [picture(tmp_path / name, 0.02, 0.01)[1] for name in ("grey.tif", "grey.png")]
    np.testing.assert_allclose(shares, [[0.5, 0.25, 1.0]] * 2)
    assert called == ["round.svg", "grey.tif"]
