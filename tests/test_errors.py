"""Errors keep their code and position, and all codes are documented."""

import ast
import pickle
import re

import numpy as np
import pytest

from airtact.errors import LONGEST_SENTENCE, InvalidInput, about, one_sentence
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
    documented = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
    assert documented == sorted(set(documented))
    assert used - set(documented) == set()
    # A few codes are chosen from a list before they are passed on.
    assert set(documented) - used - words == set()
