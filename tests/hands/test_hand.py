"""A hand from joints: its skin, pads, touches, opening, sequences, and the input that it rejects."""

import math

import numpy as np
import pytest

import airtact as at
from airtact.geometry.checks import check_surface
from airtact.geometry.mesh.triangles import enclosed_volume
from airtact.hands.joints import CHAINS, TRACKED, side_evidence
from airtact.hands.kinematics import gap_of
from airtact.hands.shape import MAX_KEYFRAMES
from faults import raises_code
from references.hand_poses import example, random_pose

PINCH, RADII = example("pinch")
RELAXED, _ = example("relaxed")
MIRROR = np.array([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def opened() -> at.Hand:
    return at.hand_from_joints(PINCH, RADII).open_to(0.012)


@pytest.fixture(scope="module")
def touching() -> at.Hand:
    return at.hand_from_joints(PINCH, RADII)


# --- the skin -------------------------------------------------------------------------------------------------------


def test_the_surface_is_closed_curved_and_exact(opened):
    surface = opened.surface
    assert isinstance(surface, at.Surface)
    check_surface(surface)
    nodes = np.concatenate([surface.vertices, surface.midpoints.reshape(-1, 3)])
    assert np.abs(surface.depth(nodes)).max() < 30e-6
    assert surface.repairs == ()


def test_the_surface_is_fine_at_the_pads_and_coarse_at_the_wrist(opened):
    surface = opened.surface
    longest = surface.edge_lengths.max(axis=1)
    middles = surface.corners.mean(axis=1)
    pads, wrist = opened.pads[:2], opened.joints[:1]
    beside = np.linalg.norm(middles[:, None] - pads, axis=2).min(axis=1) < 6e-3
    far = np.linalg.norm(middles[:, None] - wrist, axis=2).min(axis=1) < 25e-3
    assert np.median(longest[beside]) < 3.5e-3
    assert np.median(longest[far]) > 6e-3


def test_panels_hold_the_volume_whatever_their_edge(opened):
    volumes = [enclosed_volume(opened.shape.panels(edge)) for edge in (3e-3, 6e-3, 9e-3)]
    assert volumes == pytest.approx([volumes[0]] * 3, rel=2e-3)
    assert 2.5e-4 < volumes[0] < 5e-4  # a hand displaces 250 to 500 ml


def test_a_hand_moves_with_its_skin(opened):
    pose = at.Pose.turn(np.array([1.0, 2.0, -0.5]), 0.7, np.array([0.1, -0.02, 0.05]))
    moved = opened.surface.moved(pose)
    assert np.abs(moved.depth(moved.vertices)).max() < 1e-8
    assert moved.volume == pytest.approx(opened.surface.volume)
    elsewhere = at.hand_from_joints(pose.apply(opened.joints), RADII)
    assert np.abs(elsewhere.shape.depth(moved.vertices)).max() < 1e-8


def test_trackers_with_21_joints_give_nearly_the_same_hand(opened):
    fewer = at.hand_from_joints(PINCH[TRACKED], RADII[TRACKED]).open_to(0.012)
    assert np.linalg.norm(fewer.pads - opened.pads, axis=1).max() < 2e-3
    assert fewer.shape.volume == pytest.approx(opened.shape.volume, rel=0.2)


def test_radii_grow_with_the_length_of_the_hand():
    small, large = (at.hand_from_joints(RELAXED, length=length).radii for length in (0.15, 0.2))
    assert large == pytest.approx(small * 0.2 / 0.15)
    radii = at.hand_from_joints(RELAXED).radii
    assert at.hand_from_joints(1.1 * RELAXED).radii == pytest.approx(1.1 * radii)


# --- left and right -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(20))
def test_sides_are_distinguished_in_any_pose(seed):
    joints = random_pose(seed, RELAXED)
    assert side_evidence(joints) < 0.2
    assert side_evidence(MIRROR * joints) > -0.2


def test_a_left_hand_given_as_right_is_rejected():
    with raises_code("wrong_side"):
        at.hand_from_joints(PINCH, side="right")
    assert at.hand_from_joints(MIRROR * PINCH, side="right").side == "right"


# --- pads and gaps --------------------------------------------------------------------------------------------------


def test_pads_are_on_the_skin_and_look_at_each_other(opened):
    assert np.abs(opened.shape.depth(opened.pads)).max() < 1e-9
    thumb, index = opened.places["thumb.pad"], opened.places["index.pad"]
    assert thumb[1] @ index[1] < -0.7
    between = index[0] - thumb[0]
    assert thumb[1] @ between > 0 > index[1] @ between
    for point, normal in opened.places.values():
        assert opened.shape.depth((point + 2e-3 * normal)[None])[0] == pytest.approx(
            -2e-3, abs=1e-4
        )


@pytest.mark.parametrize("gap", [0.5e-3, 3e-3, 0.012, 0.03])
def test_a_hand_opens_to_the_gap_asked(gap, touching):
    hand = touching.open_to(gap)
    assert gap_of(hand.joints, hand.radii, (0, 1)) == pytest.approx(gap, abs=1e-8)
    bones = [
        np.linalg.norm(np.diff(joints[list(CHAINS[1])], axis=0), axis=1)
        for joints in (PINCH, hand.joints)
    ]
    assert bones[0] == pytest.approx(bones[1])
    assert hand.touches == ()


def test_touching_skins_are_one_and_the_surface_has_a_note(touching):
    touch = touching.touches[0]
    parts = (touch.first, touch.second)
    assert parts == ("last phalanx of the thumb", "last phalanx of the index finger")
    assert touch.gap == pytest.approx(gap_of(PINCH, RADII, (0, 1)), abs=1e-5)
    assert touching.shape.depth(touch.place[None])[0] > 1e-3
    assert "14 mm" in touching.surface.repairs[0]


@pytest.mark.parametrize(("gap", "joined"), [(0.25e-3, True), (0.35e-3, False)])
def test_skins_nearer_than_0_3_mm_are_one_and_others_are_not(gap, joined, touching):
    assert bool(touching.open_to(gap).touches) == joined


def test_a_pad_inside_the_body_is_rejected_with_the_gap_that_frees_it(touching):
    with raises_code("inside_body", "5.3 mm"):
        touching.place("index.pad")
    point, _ = touching.open_to(0.5e-3, "index", "thumb").place("index.pad")
    assert point.shape == (3,)
    assert touching.place("ring.pad")[0] == pytest.approx(touching.pads[3])


@pytest.mark.parametrize(
    ("ask", "code", "words"),
    [
        (lambda hand: hand.open_to(12), "out_of_range", "12 m 0.15 m"),
        (lambda hand: hand.open_to(1e-3, "thumb", "pinky"), "misplaced", "1 mm"),
        (lambda hand: hand.open_to(1e-2, "thumb", "nose"), "unknown_name", "nose"),
        (lambda hand: hand.open_to(1e-2, "thumb", "thumb"), "unknown_name", "thumb"),
        (lambda hand: hand.place("index.tip"), "unknown_name", "'index.tip'"),
    ],
)
def test_impossible_gaps_and_unknown_places_are_rejected(opened, ask, code, words):
    with raises_code(code, words):
        ask(opened)


# --- frame after frame ----------------------------------------------------------------------------------------------


def test_the_next_frame_keeps_the_triangles_and_is_exact(opened):
    before = opened.shape.skin(6e-3)
    shaken = at.Pose.turn(np.array([0.0, 1.0, 0.3]), 0.05, np.array([5e-3, 0.0, 0.0]))
    after = opened.posed(shaken.apply(opened.open_to(0.016).joints))
    skin = after.shape.skin(6e-3)
    assert np.array_equal(skin.triangles, before.triangles)
    assert skin.angles.min() >= 20
    assert np.abs(after.shape.depth(skin.vertices)).max() < 30e-6


def test_a_frame_in_which_fingers_meet_is_meshed_anew(opened):
    opened.shape.skin(6e-3)
    closed = opened.posed(PINCH)
    assert closed.touches
    assert len(closed.shape.skin(6e-3).triangles) != len(opened.shape.skin(6e-3).triangles)


def sequence(gaps: np.ndarray) -> list[at.Hand]:
    start = at.hand_from_joints(PINCH, RADII)
    hands = [start.open_to(gaps[0])]
    for gap in gaps[1:]:
        hands.append(hands[-1].posed(start.open_to(gap).joints))
    return hands


def test_what_was_asked_of_a_frame_changes_no_later_one():
    gaps = np.linspace(0.012, 0.020, 5)
    asked, other, silent = sequence(gaps), sequence(gaps), sequence(gaps)
    for hand in asked:
        hand.shape.skin(6e-3)
    late = other[-1].shape.skin(6e-3)
    other[0].shape.skin(9e-3)
    for edge in (6e-3, 9e-3):
        expected = silent[-1].shape.skin(edge)
        for hand in (asked[-1], other[-1]):
            assert np.array_equal(hand.shape.skin(edge).vertices, expected.vertices)
            assert np.array_equal(hand.shape.skin(edge).triangles, expected.triangles)
    assert other[-1].shape.skin(6e-3) is late
    assert np.array_equal(
        expected.triangles, silent[0].shape.skin(9e-3).triangles
    )  # it does follow


def test_a_long_sequence_keeps_few_frames_and_little_history():
    opening = np.linspace(0.012, 0.045, 12)
    hands = sequence(np.concatenate([opening, opening[::-1]] * 3))
    assert max(hand.shape.keyframes for hand in hands) <= MAX_KEYFRAMES + 1
    assert all(hand.shape.follows is not None for hand in hands[1:12])
    assert np.abs(hands[-1].shape.depth(hands[-1].shape.skin(7e-3).vertices)).max() < 30e-6


# --- bad input --------------------------------------------------------------------------------

THUMB_AND_INDEX_SWAPPED = [0, 9, 8, 7, 6, 5, 4, 3, 2, 1, *range(10, 25)]


@pytest.mark.parametrize(
    ("code", "joints", "options"),
    [
        ("joint_count", PINCH[:24], {}),
        ("not_in_metres", 1e3 * PINCH, {}),
        ("not_finite", np.where(np.arange(25)[:, None] == 7, np.nan, PINCH), {}),
        ("bone_length", PINCH[THUMB_AND_INDEX_SWAPPED], {}),
        ("bone_length", PINCH + np.where(np.arange(25)[:, None] == 19, 0.06, 0.0), {}),
        ("not_in_metres", 0.1 * PINCH, {}),
        ("out_of_range", PINCH, {"radii": 1e3 * RADII}),
        ("not_finite", PINCH, {"radii": np.where(np.arange(25) == 3, math.nan, RADII)}),
        ("wrong_shape", PINCH, {"radii": RADII[:24]}),
        ("out_of_range", PINCH, {"length": 190}),
        ("unknown_name", PINCH, {"side": "top"}),
    ],
)
def test_joints_radii_and_sides_of_no_hand_are_rejected(
    code, joints, options, as_outside_the_tests
):
    with raises_code(code):
        at.hand_from_joints(joints, **options)


# --- files ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("wrong_kind", "{"),
        ("wrong_kind", "[" * 100_000),
        ("wrong_kind", '{"positions_m": [], "colour": 1}'),
        ("wrong_kind", '{"side": "left", "side": "right", "positions_m": [[0, 0, 0]]}'),
        ("file_unreadable", '{"positions_m":\f[[0, 0, 0]]}'),
        ("wrong_kind", '{"positions_m": [[0, 0, 1' + "0" * 400 + "]]}"),
        ("wrong_kind", '{"positions_m": [[0, 0, "a"]]}'),
        ("wrong_kind", '{"positions_m": [' + "9" * 5000 + "]}"),
        ("hand_implausible", '{"positions_m": [[0, 0, 0]], "joints": ["wrist"]}'),
        ("hand_implausible", '{"positions_m": []}'),
        ("sizes_differ", '{"positions_m": [[0, 0, 0]], "radii_m": [0.01, 0.01]}'),
        ("file_missing", None),
    ],
)
def test_files_that_hold_no_pose_are_rejected(tmp_path, code, text):
    if text is not None:
        (tmp_path / "pose.json").write_text(text)
    with raises_code(code, "pose.json"):
        at.load_hand(tmp_path / "pose.json")


def test_a_hand_is_put_in_front_of_an_array():
    board = at.autd3_board().moved(at.Pose.turn((1, 2, 3), 1.1, (0.1, 0.2, 0.3)))
    hand = at.load_hand(at.example("relaxed.json"))
    for place in ("palm", "index.pad"):
        over = hand.over(board, 0.15, place)
        point, normal = over.place(place)
        front = board.normals[0]
        np.testing.assert_allclose(point, board.positions.mean(axis=0) + 0.15 * front, atol=1e-9)
        np.testing.assert_allclose(normal, -front, atol=1e-9)
        np.testing.assert_allclose(over.focus(place, 1e-3), point - 1e-3 * front, atol=1e-9)
    lengths = [np.linalg.norm(np.diff(one.joints, axis=0), axis=1) for one in (hand, over)]
    np.testing.assert_allclose(*lengths)
    with raises_code("misplaced"):
        hand.over(at.surrounding_box(), 0.1)
    with raises_code("out_of_range"):
        hand.focus("palm", offset=0.5)
