"""Boards and calibration in scene files."""

import numpy as np
import pytest

import airtact as at
from airtact.transducers.boards import BOARDS
from faults import raises_code

SCENE = """
[medium]
sound_speed = 343.1
density = 1.293

[array]
{array}

[[obstacles]]
sphere = {{ radius = 5e-3 }}

[[foci]]
point = [0.0, 0.0, -5.5e-3]
"""

ONE_BOARD = 'layout = "boards"\nposes = [{ translation = [0.0, 0.0, -0.1] }]\n'


def array_of(folder, text: str):
    (folder / "scene.toml").write_text(SCENE.format(array=text))
    return at.read_scene(folder / "scene.toml").array


def test_a_box_of_real_boards(tmp_path) -> None:
    array = array_of(tmp_path, 'layout = "surrounding_box"\nboard = "autd3"')
    np.testing.assert_array_equal(array.positions, at.surrounding_box(board="autd3").positions)
    assert abs(array.positions[0, 0]) == pytest.approx(75.7e-3, abs=1e-12)


@pytest.mark.parametrize("name", BOARDS)
def test_boards_of_any_kind(tmp_path, name: str) -> None:
    array = array_of(tmp_path, ONE_BOARD + f'board = "{name}"')
    expected = at.transducers.board_array(name, [at.Pose(np.eye(3), np.array([0.0, 0.0, -0.1]))])
    np.testing.assert_array_equal(array.positions, expected.positions)
    assert array.element.directional
    assert array.element.radius == BOARDS[name].radius


def test_calibration_is_read_from_beside_the_scene(tmp_path) -> None:
    (tmp_path / "gains.csv").write_text("element,gain,phase\n5,0,0\n248,0.5,0.1\n")
    array = array_of(tmp_path, ONE_BOARD + 'calibration = "gains.csv"')
    assert array.gains[5] == 0.0
    assert array.gains[248] == pytest.approx(0.5 * np.exp(0.1j))
    assert np.count_nonzero(array.gains == 1.0) == 247


@pytest.mark.parametrize(
    ("text", "code", "sentence"),
    [
        (
            ONE_BOARD + 'board = "autd4"',
            "unknown_name",
            "scene.toml: array: 'autd4'",
        ),
        (
            'layout = "surrounding_box"\nboard = "nano16"',
            "unknown_name",
            "nano16",
        ),
        (
            'layout = "flat_boards"\nboard = "autd3"',
            "key_misplaced",
            'board goes only with layout = "surrounding_box" or layout = "boards".',
        ),
        (
            ONE_BOARD + 'calibration = "none.csv"',
            "file_missing",
            "scene.toml: array: calibration: the file ",
        ),
        (
            ONE_BOARD + 'calibration = "bad.csv"',
            "unknown_name",
            "line 2 of bad.csv: there is no element 249",
        ),
    ],
)
def test_bad_boards_are_rejected(tmp_path, text: str, code: str, sentence: str) -> None:
    (tmp_path / "bad.csv").write_text("element,gain,phase\n249,1,0\n")
    with raises_code(code, sentence):
        array_of(tmp_path, text)
