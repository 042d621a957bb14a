"""Values that take the place of those in a scene file, by the paths of their keys."""

import msgspec
import pytest

import airtact as at
from airtact.setup.parsing import with_changes

PINCH = msgspec.toml.decode(at.example("pinch").read_bytes())
HAND = msgspec.toml.decode(at.example("pinch_pose").read_bytes())


def test_values_take_the_place_of_those_there_and_are_added() -> None:
    changes = {
        "foci[1].offset": 1e-3,
        "pinch.gap": 0.01,
        "medium.density": 1.2,
        "uncertainty.position": 1e-3,
    }
    found = with_changes(PINCH, changes)
    assert found["foci"] == [{"at": "thumb.pad"}, {"at": "finger.pad", "offset": 1e-3}]
    assert found["obstacles"] == [{"pinch": {"gap": 0.01}}]
    assert found["medium"] == {"sound_speed": 343.1, "density": 1.2}
    assert found["uncertainty"] == {"position": 1e-3}
    assert "offset" not in PINCH["foci"][1]
    assert {key for key in found if found[key] != PINCH.get(key)} == {
        "foci",
        "obstacles",
        "medium",
        "uncertainty",
    }


def test_a_kind_of_body_is_short_for_its_obstacle() -> None:
    found = with_changes(
        HAND,
        {"hand.gap": 0.01, "hand.pose.translation[1]": 0.002, "array.pose.translation[2]": 0.1},
    )
    assert found["obstacles"] == [
        {"hand": "hands/pinch.json", "gap": 0.01, "pose": {"translation": [0.0, 0.002, 0.0]}}
    ]
    assert found["array"]["pose"]["translation"] == [-0.035, 0.016, 0.1]
    assert with_changes(PINCH, {"pinch.pose.translation[0]": 1.0})["obstacles"][0]["pose"] == {
        "translation": [1.0, 0.0, 0.0]
    }
    assert with_changes(HAND, {"hand.gap": None})["obstacles"] == [{"hand": "hands/pinch.json"}]


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (
            "foci[2].offset",
            r"foci\[2\].offset: 2 is not in the scene file; there are 2",
        ),
        (
            "hand.gap",
            ".hand. is neither a key of the file .*foci",
        ),
        ("foci.offset", "is not in the scene file"),
        ("medium[0]", "is not in the scene file"),
        ("frequency.high", "its value is 40000"),
        ("foci[0]offset..x", "is not the path of a key"),
        ("foci[0]offset", "is not the path of a key"),
        ("", "is not the path of a key"),
    ],
)
def test_a_path_that_leads_nowhere_names_what_is_there(path, words) -> None:
    with pytest.raises(at.InvalidInput, match=words) as fault:
        with_changes(PINCH, {path: 1.0})
    assert fault.value.code == "unknown_key"


def test_a_scene_is_read_with_other_values() -> None:
    setup = at.read_scene(at.example("pinch"), {"pinch.gap": 0.01, "foci[0].offset": 2e-3})
    assert setup.target.points[:, 0] == pytest.approx([-3e-3, 4.5e-3])
    with pytest.raises(at.InvalidInput, match="did you mean foci") as fault:
        at.read_scene(at.example("pinch"), {"foci[0].ofset": 2e-3})
    assert fault.value.code == "unknown_key"


def test_two_paths_of_one_key_are_rejected() -> None:
    with pytest.raises(at.InvalidInput) as fault:
        with_changes(PINCH, {"pinch.gap": 0.01, "obstacles[0].pinch.gap": 0.02})
    assert fault.value.code == "given_twice"
