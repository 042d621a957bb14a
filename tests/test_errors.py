"""Errors keep their code and position, all codes are documented, and checks raise them."""

import ast
import math
import pickle
import re
from pathlib import Path

import numpy as np
import pytest

from airtact.acoustics.medium import Medium
from airtact.errors import (
    LONGEST_SENTENCE,
    InvalidInput,
    about,
    check_frequency,
    file_fault,
    fixed,
    number,
    of_kind,
    one_sentence,
    points_of,
    positive,
)
from faults import raises_code
from paths import ROOT


@pytest.mark.parametrize("position", [None, np.array([0.01, 0.02, 0.03])])
def test_position_and_code_are_kept_by_prefixes_and_pickling(position):
    with pytest.raises(InvalidInput) as caught, about("scene.toml"), about("obstacles[1]"):
        raise InvalidInput("1 edge is open.", position, code="mesh_open")
    for error in (caught.value, pickle.loads(pickle.dumps(caught.value))):
        assert str(error) == "scene.toml: obstacles[1]: 1 edge is open."
        np.testing.assert_array_equal(error.position, position)
        assert error.code == "mesh_open"


@pytest.mark.parametrize("text", ["x" * 100_000, "a\nb\x1b[2J\ud800", "\x00" * 100_000])
def test_a_message_is_one_short_line_whatever_it_names(text):
    sentence = one_sentence(f"the word {text} is wrong; leave it out.")
    assert sentence.isprintable()
    assert len(sentence) <= LONGEST_SENTENCE
    assert sentence.startswith("the word")
    assert sentence.endswith("leave it out.")


def test_every_code_is_documented_and_every_documented_code_is_used():
    used = set()
    words = set()
    for path in (ROOT / "src/airtact").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.keyword) and node.arg == "code":
                values = [part.value for part in ast.walk(node.value) if hasattr(part, "value")]
                used |= {value for value in values if isinstance(value, str)}
            elif isinstance(node, ast.Constant):
                words.add(node.value)
    table = (ROOT / "docs/errors.md").read_text(encoding="utf-8")
    documented = re.findall(r"^\|`(\w+)`\|", table, re.MULTILINE)
    assert documented == sorted(set(documented))
    assert used - set(documented) == set()
    # A few codes are chosen from a list before they are passed on.
    assert set(documented) - used - words == set()


@pytest.mark.parametrize("value", [0.0, -2.5, math.nan, math.inf, -math.inf])
def test_positive_names_the_value_the_number_and_the_unit(value):
    with raises_code("out_of_range"):
        positive(value, "the gap", "m")


def test_fixed_copies_and_locks():
    given = np.arange(3)
    copy = fixed(given)
    given[0] = 7
    assert copy.tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        copy[0] = 1.0


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("value", "written"),
    [
        ("40e3", "'40e3'"),
        (None, "a NoneType"),
        (4e4 + 1j, "(40000+1j)"),
        (np.array([4e4]), "an array of shape (1,)"),
        ([4e4, 5e4], "a list of length 2"),
        (True, "True"),
    ],
)
def test_what_is_not_a_number_is_rejected(value, written):
    with raises_code("not_a_number"):
        number(value, "frequency", "Hz")


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize("value", [40000, 40e3, np.int64(40000), np.float32(4e4), np.array(4e4)])
def test_every_kind_of_number_is_one(value):
    assert number(value, "frequency", "Hz") == 40e3


@pytest.mark.parametrize("value", [40.0, 999.0, 1.1e6, 0.04])
def test_a_frequency_in_another_unit_is_asked_about(value):
    with raises_code("out_of_range", f"{value:g} Hz"):
        check_frequency(value)


@pytest.mark.parametrize("value", [1e3, 40000, 1e6])
def test_the_range_of_frequencies_has_its_ends(value):
    assert check_frequency(value) == value


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("points", "code", "written"),
    [
        (
            [[0.0, 0.0], [0.0, 0.0, 1.0]],
            "wrong_shape",
            "points are a list of length 2 whose rows differ in length",
        ),
        (
            [[0j, 0.0, 1.0]],
            "not_a_number",
            "points are a list of length 1 of type complex128 and shape (1, 3)",
        ),
        (
            [["a", "b", "c"]],
            "not_a_number",
            "points are a list of length 1 of type <U1 and shape (1, 3)",
        ),
        (None, "not_a_number", "points are a NoneType of type object and shape ()"),
        (0.0, "wrong_shape", "points have shape ()"),
        (np.ones((4, 2)), "wrong_shape", "(4, 2)"),
        (np.ones((2, 3, 1)), "wrong_shape", "(2, 3, 1)"),
        ([[0.0, 0.0, 0.0], [0.0, np.nan, np.inf]], "not_finite", ""),
    ],
)
def test_points_are_finite_real_numbers_in_three_columns(points, code, written):
    with raises_code(code, written):
        points_of(points, "points")


@pytest.mark.parametrize(
    ("value", "kind", "written"),
    [
        (3.0, Medium, "the medium is 3.0, but it must be a Medium: pass air()."),
        (Medium, Medium, "the medium is the class Medium, but it must be a Medium: pass air()."),
        (
            np.zeros(3),
            Medium,
            "the medium is an array of shape (3,), but it must be a Medium: pass air().",
        ),
        ([1, 2], dict, "the medium is a list of length 2, but it must be a dict: pass air()."),
    ],
)
def test_another_kind_is_rejected_with_what_to_give(value, kind, written):
    with raises_code("wrong_kind", written):
        of_kind(value, kind, "the medium", "air()")


def test_a_missing_file_and_an_unreadable_one_have_their_codes_and_their_folder(tmp_path: Path):
    path = tmp_path / "none.csv"
    with pytest.raises(FileNotFoundError) as missing:
        path.read_text()
    with raises_code("file_missing", str(path)):
        raise file_fault(path, missing.value)
    with pytest.raises(IsADirectoryError) as folder:
        tmp_path.read_text()
    with raises_code("file_unreadable", str(tmp_path)):
        raise file_fault(tmp_path, folder.value)
