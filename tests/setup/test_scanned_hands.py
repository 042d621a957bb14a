"""Named points on scanned hands in scene files."""

import json

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.hands.joints import NAMES
from faults import raises_code
from paths import EXAMPLES, GENERIC_HAND

AIR = "[medium]\nsound_speed = 343.1\ndensity = 1.293\n"
BOARDS = '[array]\nlayout = "flat_boards"\nrows = 2\ncolumns = 2\n[array.pose]\naxis = [0.0, 1.0, 0.0]\ndegrees = 90.0\n'
BOARDS += "translation = [-0.18564, -0.03, 0.0]\n"
SCAN = f'[[obstacles]]\nsurface = "{GENERIC_HAND}"\n'
BARE = '[[obstacles]]\nsurface = "scan.stl"\n'
INDEX = '[[foci]]\nat = "index.pad"\n'


@pytest.fixture
def bare(tmp_path):
    trimesh.load_scene(GENERIC_HAND, process=False).to_mesh().export(tmp_path / "scan.stl")
    hand = at.hands.load_rigged_hand(GENERIC_HAND)
    pose = {"joints": list(NAMES), "positions_m": hand.joints.tolist(), "side": hand.side}
    (tmp_path / "pose.json").write_text(json.dumps(pose), encoding="utf-8")
    return tmp_path


def index_pad() -> tuple[np.ndarray, np.ndarray]:
    return at.hands.places_on(
        at.load_surface(GENERIC_HAND), at.hands.load_rigged_hand(GENERIC_HAND)
    )["index.pad"]


def test_a_rig_names_the_pads_of_a_scan(read) -> None:
    setup = read(AIR, BOARDS, SCAN, INDEX, '[[foci]]\nat = "palm"\noffset = 1e-3\n')
    assert setup.foci == ("index.pad", "palm")
    point, normal = index_pad()
    np.testing.assert_allclose(setup.target.points[0], point + 0.5e-3 * normal, atol=1e-9)
    assert setup.scene.depth(setup.target.points) == pytest.approx([-0.5e-3, -1e-3], abs=2e-6)


def test_joints_beside_a_scan_name_its_pads_as_its_rig_would(read, bare) -> None:
    setup = read(AIR, BOARDS, BARE, 'joints = "pose.json"\n', INDEX)
    point, normal = index_pad()
    np.testing.assert_allclose(setup.target.points[0], point + 0.5e-3 * normal, atol=1e-5)


def test_a_scan_in_other_units_has_its_places_in_metres(read, tmp_path) -> None:
    scene = trimesh.load_scene(GENERIC_HAND, process=False)
    scene.apply_scale(1e3)
    scene.export(tmp_path / "hand.glb")
    setup = read(AIR, BOARDS, '[[obstacles]]\nsurface = "hand.glb"\nscale = 1e-3\n', INDEX)
    point, normal = index_pad()
    np.testing.assert_allclose(setup.target.points[0], point + 0.5e-3 * normal, atol=1e-5)


def test_a_scan_without_joints_is_named_with_what_to_give(read, bare) -> None:
    with raises_code("unknown_name", 'foci[0]: at = "index.pad"', 'joints = "FILE.json"'):
        read(AIR, BOARDS, BARE, INDEX)


def test_a_body_without_names_needs_none_where_others_have_them(read, bare) -> None:
    trimesh.creation.icosphere(radius=0.01).apply_translation([0.0, 0.15, 0.0]).export(
        bare / "ball.stl"
    )
    setup = read(AIR, BOARDS, '[[obstacles]]\nsurface = "ball.stl"\n', SCAN, INDEX)
    assert setup.foci == ("index.pad",)


@pytest.mark.parametrize(
    "focus", [INDEX, "[[foci]]\npoint = [-0.05, 0.0, 0.0]\n"], ids=["named", "point"]
)
def test_joints_that_are_not_of_the_scan_are_rejected(read, bare, focus) -> None:
    pinch = json.dumps(str(EXAMPLES / "hands/pinch.json"))
    with raises_code("misplaced", "obstacles[0]: thumb.pad", "mm from the surface", "one frame"):
        read(AIR, BOARDS, BARE, f"joints = {pinch}\n", focus)
    with raises_code("file_missing", "none.json"):
        read(AIR, BOARDS, BARE, 'joints = "none.json"\n', focus)


def test_a_rig_of_unclear_side_asks_for_it(read, bare) -> None:
    """Flattened in the plane of the palm, its fingers bend neither way."""
    scene = trimesh.load_scene(GENERIC_HAND, process=False)
    joints = at.hands.load_rigged_hand(GENERIC_HAND).joints
    back = np.cross(joints[11] - joints[0], joints[6] - joints[21])
    back /= np.linalg.norm(back)
    for name, joint in zip(NAMES, joints, strict=True):
        scene.graph.update(
            name,
            frame_from="world",
            matrix=trimesh.transformations.translation_matrix(
                joint - (joint - joints[0]) @ back * back
            ),
        )
    scene.export(bare / "flat.glb")
    with raises_code("side_unclear", "flat.glb", "side"):
        read(AIR, BOARDS, '[[obstacles]]\nsurface = "flat.glb"\n', INDEX)
