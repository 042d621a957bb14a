"""The examples that come with airtact: each is found by its name, and all are in the package."""

import pytest

import airtact as at
from faults import raises_code
from paths import EXAMPLES


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_a_scene_is_found_by_its_name_and_read(path) -> None:
    assert (
        at.example(path.stem).read_bytes() == path.read_bytes()
    )  # of the package, which may be an installed wheel
    assert len(at.read_scene(at.example(path.stem)).foci) >= 1


@pytest.mark.parametrize(
    "name", ["pinch.json", "relaxed.json", "pinching.jsonl", "seen_hand.ply", "pinch_scan.csv"]
)
def test_other_files_are_found_by_their_names(name) -> None:
    assert at.example(name).name == name
    assert at.example(name).stat().st_size > 1000


def test_an_unknown_name_lists_the_examples() -> None:
    with raises_code("unknown_name", "'nose'", "open_hand", "relaxed.json"):
        at.example("nose")
