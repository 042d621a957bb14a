"""The text of a scene file becomes tables, or a sentence with the position of the fault."""

import pytest

import airtact as at
from airtact.setup.parsing import parse_scene
from airtact.setup.tables import SceneFile
from faults import raises_code

LEAST = """
[medium]
celsius = 20.0
[array]
layout = "surrounding_box"
[[foci]]
point = [0.0, 0.0, 0.0]
"""


def test_the_least_file_has_the_defaults_of_the_design():
    file = parse_scene(LEAST)
    assert isinstance(file, SceneFile)
    assert (file.frequency, file.solver.name, file.solver.accuracy) == (40e3, None, 0.01)
    assert (file.drive.method, file.drive.levels) == ("best", 256)
    assert file.obstacles == []
    assert file.foci[0].offset is None


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("frequenzy = 4e4", "frequenzy is not a key of a scene file; did you mean frequency?"),
        (
            "[medium]\nsound_sped = 340.0",
            "medium.sound_sped is not a key of a scene file; did you mean medium.sound_speed?",
        ),
        (
            "[array]\nlayouts = 1",
            "array.layouts is not a key of a scene file; did you mean array.layout?",
        ),
        (
            "[array.pose]\ndegree = 1",
            "array.pose.degree is not a key of a scene file; did you mean array.pose.degrees?",
        ),
        (
            "[[obstacles]]\npinch = {}\n[[obstacles]]\npinch = { gapp = 0.01 }",
            "obstacles[1].pinch.gapp is not a key of a scene file; did you mean obstacles[1].pinch.gap?",
        ),
        (
            "[[foci]]\npresure = 1.0",
            "foci[0].presure is not a key of a scene file; did you mean foci[0].pressure?",
        ),
        (
            "[drive]\nqqqq = 1",
            "drive.qqqq is not a key of a scene file; use one of drive.levels, drive.method, drive.modulation.",
        ),
    ],
)
def test_a_wrong_key_is_named_with_its_path_and_the_nearest_right_one(text, sentence):
    with raises_code("unknown_key") as fault:
        parse_scene(text)
    assert str(fault.value) == sentence


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (LEAST.replace("20.0", '"warm"'), "medium.celsius: expected a number, got a string."),
        (
            LEAST.replace("[0.0, 0.0, 0.0]", "[0.0, 0.0]"),
            "foci[0].point: expected a list of length 3, got 2.",
        ),
        (
            LEAST.replace('layout = "surrounding_box"', ""),
            "the key array.layout is missing: add it.",
        ),
        (
            LEAST + "[drive]\nlevels = 12.5",
            "drive.levels: expected a whole number or a table, got a number.",
        ),
        (
            LEAST + '[[obstacles]]\nboundary = "impedance"\nratio = "x"\npinch = {}',
            "obstacles[0].ratio: expected a number or a list, got a string.",
        ),
        (
            LEAST + "[[obstacles]]\npinch = {}\nboundary = 3",
            "obstacles[0].boundary: expected a string, got a whole number.",
        ),
        ("medium = 3", "medium: expected a table, got a whole number."),
    ],
)
def test_a_wrong_value_is_named_with_its_path(text, sentence):
    code = "key_missing" if "missing" in sentence else "wrong_kind"
    if "expected a number" in sentence or "expected a whole" in sentence:
        code = "not_a_number"
    if "length" in sentence:
        code = "out_of_range"
    with raises_code(code) as fault:
        parse_scene(text)
    assert str(fault.value) == sentence


def test_what_is_not_toml_is_rejected_with_its_line():
    with raises_code("file_unreadable", "medium = = 3"):
        parse_scene("frequency = 4e4\nmedium = = 3\n")


def test_the_air_of_a_scene_is_of_20_degrees_where_none_is_given(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(LEAST.replace("[medium]\ncelsius = 20.0", ""), encoding="utf-8")
    assert at.read_scene(path).medium == at.air(celsius=20.0)
