"""Named positions on scanned hands, by the joints of their rig."""

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.hands.hand import PLACES, hand_from_joints, places_on
from faults import raises_code
from paths import GENERIC_HAND, HANDS
from references.rigged_hand import rest


@pytest.fixture(scope="module")
def hand():
    return at.hands.load_rigged_hand(GENERIC_HAND)


@pytest.fixture(scope="module")
def skin():
    return at.load_surface(GENERIC_HAND)


def test_the_joints_are_those_that_the_mesh_is_bound_to(hand) -> None:
    """The nodes of the rig against the inverse of its bind matrices."""
    np.testing.assert_allclose(hand.joints, rest().joints, atol=1e-6)
    assert hand.side == "right"


def test_places_lie_on_the_skin_and_face_outwards(hand, skin) -> None:
    places = places_on(skin, hand)
    assert tuple(places) == PLACES == tuple(hand.places)
    points = np.array([point for point, _ in places.values()])
    normals = np.array([normal for _, normal in places.values()])
    np.testing.assert_allclose(skin.depth(points), 0.0, atol=1e-8)
    np.testing.assert_allclose(skin.depth(points + 0.5e-3 * normals), -0.5e-3, atol=2e-6)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


def test_a_rig_in_millimetres_is_scaled_as_its_mesh(tmp_path, hand, skin) -> None:
    scene = trimesh.load_scene(GENERIC_HAND, process=False)
    scene.apply_scale(1e3)
    scene.export(tmp_path / "hand.glb")
    scaled = at.hands.load_rigged_hand(tmp_path / "hand.glb", scale=1e-3)
    np.testing.assert_allclose(scaled.joints, hand.joints, atol=1e-7)
    same = places_on(at.load_surface(tmp_path / "hand.glb", scale=1e-3), scaled)
    for name, (point, _) in places_on(skin, hand).items():
        np.testing.assert_allclose(same[name][0], point, atol=1e-6)
    with raises_code("not_in_metres", "hand.glb"):
        at.hands.load_rigged_hand(tmp_path / "hand.glb")


def test_a_rig_that_lacks_joints_is_named_with_them(tmp_path) -> None:
    trimesh.creation.icosphere(radius=0.03).export(tmp_path / "ball.glb")
    with raises_code("joint_missing", "ball.glb"):
        at.hands.load_rigged_hand(tmp_path / "ball.glb")
    scene = trimesh.load_scene(GENERIC_HAND, process=False)
    scene.graph.transforms.remove_node("index-finger-tip")
    scene.export(tmp_path / "hand.glb")
    with raises_code("joint_missing", "(index-finger-tip)"):
        at.hands.load_rigged_hand(tmp_path / "hand.glb")
    with raises_code("file_missing", "none.glb"):
        at.hands.load_rigged_hand(tmp_path / "none.glb")


@pytest.mark.parametrize(
    ("shift", "fault"),
    [
        ((0.0, 0.0, 0.03), "mm from the surface"),
        # towards the back, where the pads lie in fingers of 13 mm
        ((-8e-3, 0.0, 0.0), "turned from the surface"),
    ],
)
def test_joints_of_another_frame_are_rejected(shift, fault, hand, skin) -> None:
    with raises_code("misplaced", fault):
        places_on(skin.moved(at.Pose(np.eye(3), np.array(shift))), hand)


def test_a_hand_of_joints_finds_its_own_pads() -> None:
    """On the skin that was made from the joints, the places are those of the hand."""
    hand = at.load_hand(HANDS / "relaxed.json")
    for name, (point, normal) in places_on(hand.surface, hand).items():
        np.testing.assert_allclose(point, hand.places[name][0], atol=1e-6)
        np.testing.assert_allclose(normal, hand.places[name][1], atol=1e-3)


def test_a_side_that_contradicts_the_rig_is_rejected(hand) -> None:
    assert hand_from_joints(hand.joints * [1.0, 1.0, -1.0]).side == "left"
    with raises_code("wrong_side", "left"):
        at.hands.load_rigged_hand(GENERIC_HAND, side="left")
