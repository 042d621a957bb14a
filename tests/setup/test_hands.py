"""Hands in a scene file and from the command line."""

import json
from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.cli import main
from airtact.geometry.mesh.triangles import edge_twins
from faults import raises_code
from paths import EXAMPLES

PINCH = EXAMPLES / "hands/pinch.json"


def scene_file(tmp_path: Path, old: str = "", new: str = "") -> Path:
    text = (EXAMPLES / "pinch_pose.toml").read_text().replace("hands/pinch.json", str(PINCH))
    assert old in text
    path = tmp_path / "scene.toml"
    path.write_text(text.replace(old, new))
    return path


def test_the_example_has_its_foci_half_a_millimetre_before_the_pads():
    setup = at.read_scene(EXAMPLES / "pinch_pose.toml")
    assert setup.bodies == ("hand",)
    assert setup.foci == ("thumb.pad", "index.pad")
    assert setup.scene.depth(setup.target.points) == pytest.approx([-0.5e-3, -0.5e-3], abs=1e-8)


def test_pads_inside_the_body_are_rejected(tmp_path):
    with raises_code("inside_body"):
        at.read_scene(scene_file(tmp_path, "gap = 0.012\n"))


def test_the_command_writes_a_closed_skin_and_a_picture(tmp_path, capsys):
    import trimesh

    assert main(["hand", str(PINCH), "--edge", "0.006", "--out", str(tmp_path / "hand.ply")]) == 0
    mesh = trimesh.load_mesh(tmp_path / "hand.ply")
    assert edge_twins(np.asarray(mesh.faces)).min() >= 0
    assert 2.5e-4 < mesh.volume < 5e-4
    assert (tmp_path / "hand.png").stat().st_size > 20_000
    written = capsys.readouterr().out
    assert (
        "the last phalanx of the thumb and the last phalanx of the index finger are merged"
        in written
    )
    assert "5.3 mm inside the body" in written


def test_fingers_that_are_swapped_are_rejected(tmp_path):
    pose_of = json.loads(PINCH.read_text())
    chains = [list(range(5 + 5 * finger, 10 + 5 * finger)) for finger in range(4)]
    for order, sentence in (
        ((3, 1, 2, 0), "knuckle of the ring finger is 20.7 mm nearer to the index finger's"),
        ((3, 2, 1, 0), " mm from the little finger's knuckle"),
    ):
        rows = [*range(5), *(joint for finger in order for joint in chains[finger])]
        swapped = tmp_path / "swapped.json"
        swapped.write_text(
            json.dumps({"positions_m": [pose_of["positions_m"][row] for row in rows]})
        )
        with raises_code("hand_implausible", sentence):
            at.load_hand(swapped)


def two_hands(tmp_path: Path, foci: str) -> Path:
    """The relaxed left hand, and a right one that is its mirror image beside it."""
    left = at.load_hand(EXAMPLES / "hands/relaxed.json")
    pose = json.loads((EXAMPLES / "hands/relaxed.json").read_text())
    pose["side"] = "right"
    pose["positions_m"] = (left.joints * [-1.0, 1.0, 1.0]).tolist()
    (tmp_path / "right.json").write_text(json.dumps(pose))
    path = tmp_path / "scene.toml"
    path.write_text(
        '[array]\nlayout = "flat_boards"\npose = { translation = [0, 0, -0.6] }\n'
        f'[[obstacles]]\nhand = "{EXAMPLES / "hands/relaxed.json"}"\n'
        "pose = { translation = [-0.2, 0, 0] }\n"
        '[[obstacles]]\nhand = "right.json"\npose = { translation = [0.2, 0, 0] }\n' + foci
    )
    return path


def test_places_of_two_hands_are_named_by_side(tmp_path):
    foci = '[[foci]]\nat = "left.palm"\n[[foci]]\nat = "right.palm"\n'
    setup = at.read_scene(two_hands(tmp_path, foci))
    assert [hand.side for hand in setup.hands] == ["left", "right"]
    expected = [hand.focus("palm") for hand in setup.hands]
    np.testing.assert_allclose(setup.target.points, expected, atol=1e-9)
    assert setup.foci == ("left.palm", "right.palm")
    assert setup.bodies == ("left hand", "right hand")
    with raises_code("given_twice", 'at = "right.palm"'):
        at.read_scene(two_hands(tmp_path, '[[foci]]\nat = "palm"\n'))
    # Two hands of one side have no name that tells them apart.
    path = two_hands(tmp_path, '[[foci]]\nat = "left.palm"\n')
    path.write_text(path.read_text().replace("right.json", str(EXAMPLES / "hands/relaxed.json")))
    with raises_code("given_twice", "both are left hands", "point = "):
        at.read_scene(path)
