"""Scenes that go beyond a limit are rejected at once, in one short sentence."""

import os

import pytest

from airtact.cli import main
from airtact.setup.building import read_scene
from airtact.setup.parsing import parse_scene
from faults import raises_code
from paths import EXAMPLES

PINCH = (EXAMPLES / "pinch.toml").read_text(encoding="utf-8")
LETTERS = (EXAMPLES / "air_letters.toml").read_text(encoding="utf-8")
PALM = (
    (EXAMPLES / "open_hand.toml")
    .read_text(encoding="utf-8")
    .replace("hands/", f"{EXAMPLES.as_posix()}/hands/")
)
BODY = """
[medium]
celsius = 20.0
[array]
layout = "surrounding_box"
[[obstacles]]
BODY
[[foci]]
point = [0.0, 0.0, 0.05]
"""
HAND = PALM[PALM.index("[[obstacles]]") : PALM.index("# Each point")]


def body(words: str) -> str:
    return BODY.replace("BODY", words)


HURTFUL = {
    "nested lists": (PINCH + "x = " + "[" * 2000 + "]" * 2000, "file_too_large"),
    "nested tables": (PINCH + "x = " + "{a=" * 2000 + "1" + "}" * 2000, "file_too_large"),
    "dotted": (PINCH + "[a" + ".a" * 3000 + "]", "file_too_large"),
    "dotted tables in lists": (
        PINCH + "x = " + ("{" + "a." * 30 + "a = ") * 30 + "1" + "}" * 30,
        "file_too_large",
    ),
    "digits": (PINCH.replace("40e3", "4" * 4301), "file_unreadable"),
    "hexadecimal digits": (PINCH.replace("40e3", "0x" + "f" * 9000), "out_of_range"),
    "whole number of 90 digits": (PINCH.replace("40e3", "4" * 90), "out_of_range"),
    "a long key": (PINCH + "k" * 100_000 + " = 1", "unknown_key"),
    "a long name": (PINCH.replace("boundary_element", "b" * 100_000), "unknown_name"),
    "a name of two lines": (PINCH.replace("boundary_element", "a\\nb"), "unknown_name"),
    "many letters": (LETTERS.replace('"AIR"', '"' + "A" * 100_000 + '"'), "too_many"),
    "fine letters": (LETTERS.replace("spacing = 0.005", "spacing = 5e-9"), "too_many"),
    "fine letters, infinitely": (
        LETTERS.replace("spacing = 0.005", "spacing = 1e-50"),
        "too_many",
    ),
    "far sphere": (body("sphere = { radius = 0.01, centre = [1e300, 0, 0] }"), "out_of_range"),
    "infinitely far sphere": (
        body("sphere = { radius = 0.01, centre = [inf, 0, 0] }"),
        "not_finite",
    ),
    "far capsule": (
        body("capsule = { start = [0, 0, 0], end = [1e300, 0, 0], radius = 0.01 }"),
        "out_of_range",
    ),
    "far pose": (
        body("sphere = { radius = 0.01 }\npose = { translation = [-1e300, 0, 0] }"),
        "out_of_range",
    ),
    "far axis": (
        body("sphere = { radius = 0.01 }\npose = { axis = [1e300, 0, 1], degrees = 9 }"),
        "out_of_range",
    ),
    "far focus": (PINCH.replace('at = "thumb.pad"', "point = [1e300, 0, 0]"), "out_of_range"),
    "tiny radius": (body("sphere = { radius = 1e-300 }"), "out_of_range"),
    "thin capsule": (
        body("capsule = { start = [0, 0, 0], end = [0, 0, 0.01], radius = 8e-9 }"),
        "too_many",
    ),
    "large sphere": (body("sphere = { radius = 0.8 }"), "out_of_range"),
    "doubled hand": (PALM.replace(HAND, HAND + HAND), "bodies_overlap"),
    "shifted hand": (
        PALM.replace(HAND, HAND + HAND + "pose = { translation = [1e-3, 0, 0] }\n"),
        "bodies_overlap",
    ),
    "many bodies": (
        body("pinch = {}\n[[obstacles]]\n" * 256 + "pinch = {}"),
        "out_of_range",
    ),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name == "shifted hand" else ())
        for name in HURTFUL
    ],
)
def test_a_scene_that_hurts_is_rejected_in_one_line_by_the_command(name, tmp_path, capsys):
    text, code = HURTFUL[name]
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    assert main(["check", str(path), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.rstrip().endswith(f"[{code}]"), said
    assert len(said) <= 501


def test_points_are_counted_before_they_are_made_unless_more_are_asked_for(tmp_path):
    many = LETTERS + "".join(
        f"\n[[foci]]\npoint = [0.0, {1e-5 * index:.5f}, 0.03]" for index in range(4096)
    )
    path = tmp_path / "many.toml"
    path.write_text(many, encoding="utf-8")
    with raises_code("too_many", "4,097", "4,096"):
        read_scene(path)
    path.write_text("most_points = 10\n" + LETTERS, encoding="utf-8")
    with raises_code("too_many"):
        read_scene(path)
    path.write_text("most_points = 9000\n" + many, encoding="utf-8")
    assert len(read_scene(path).foci) > 4096


def test_half_of_a_pair_is_no_text():
    with raises_code("file_unreadable"):
        parse_scene('a = "\ud800"')


def test_a_file_that_is_too_large_or_a_pipe_is_not_read(tmp_path):
    large, pipe = tmp_path / "large.toml", tmp_path / "pipe.toml"
    large.write_text("#" * 4_000_001, encoding="utf-8")
    with raises_code("file_too_large", "4,000,001", "4,000,000"):
        read_scene(large)
    with raises_code("file_too_large", "4,000,001"):
        parse_scene("#" * 4_000_001)
    os.mkfifo(pipe)
    with raises_code("file_unreadable"):
        read_scene(pipe)
