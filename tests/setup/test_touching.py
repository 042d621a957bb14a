"""Virtual objects of scene files, and the foci where bodies touch them."""

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.setup.sentences import reach_cautions, touches
from faults import raises_code
from paths import HANDS

ARRAY = '[array]\nlayout = "surrounding_box"\n'
# A finger along z whose lowest point is the origin
FINGER = """[[obstacles]]
capsule = { start = [0.0, 0.0, 0.008], end = [0.0, 0.0, 0.05], radius = 0.008 }
"""
BALL = "[[objects]]\nsphere = { radius = 0.01, centre = [0.0, 0.0, -0.008] }\n"


def test_the_ball_of_the_paper_has_its_contact_points() -> None:
    ball = at.read_scene("touch_ball")
    pinch = at.read_scene("pinch")
    np.testing.assert_allclose(ball.target.points, pinch.target.points, atol=1e-5)
    assert ball.foci == ("thumb at ball", "finger at ball")
    assert [thing.name for thing in ball.objects] == ["ball"]


@pytest.mark.parametrize(
    "keys",
    [
        "sphere = { radius = 0.01, centre = [0.0, 0.0, -0.008] }",
        "capsule = { start = [-0.01, 0.0, -0.008], end = [0.01, 0.0, -0.008], radius = 0.01 }",
        "box = { sides = [0.03, 0.03, 0.02], centre = [0.0, 0.0, -0.008] }",
        "cylinder = { start = [0.0, 0.0, -0.02], end = [0.0, 0.0, 0.002], radius = 0.01 }",
        "half_space = { point = [0.1, 0.0, 0.002], normal = [0.0, 0.0, 3.0] }",
        "button = { centre = [0.0, 0.0, 0.002], radius = 0.01, travel = 0.004 }",
        'surface = "block.stl"\nscale = 1e-3',
        "box = { sides = [0.02, 0.03, 0.03] }\n"
        "pose = { axis = [0, 1, 0], degrees = 90, translation = [0, 0, -0.008] }",
    ],
)
def test_every_kind_of_object_is_touched(keys, read, tmp_path) -> None:
    block = trimesh.creation.box(extents=(30.0, 30.0, 20.0))
    block.apply_translation((0.0, 0.0, -8.0))
    block.export(tmp_path / "block.stl")
    setup = read(ARRAY, FINGER, f'[[objects]]\n{keys}\nname = "thing"\n')
    assert setup.foci == ("capsule at thing",)
    np.testing.assert_allclose(setup.contacts.depths, 2e-3, atol=2e-5)
    np.testing.assert_allclose(setup.target.points, [[0.0, 0.0, -0.5e-3]], atol=5e-5)


def test_fingers_of_a_posed_hand_touch(read, tmp_path) -> None:
    hand = at.load_hand(HANDS / "relaxed.json")
    (tmp_path / "relaxed.json").write_bytes((HANDS / "relaxed.json").read_bytes())
    point, normal = hand.places["index.pad"]
    x, y, z = point + 7e-3 * normal + [0.0, 0.0, 0.01]
    setup = read(
        ARRAY.replace("surrounding_box", "flat_boards"),
        "pose = { translation = [0.0, 0.0, -0.3] }\n",
        '[[obstacles]]\nhand = "relaxed.json"\npose = { translation = [0.0, 0.0, 0.01] }\n',
        f"[[objects]]\nsphere = {{ radius = 0.01, centre = [{x}, {y}, {z}] }}\n",
    )
    assert setup.foci == ("index at object 1",)
    np.testing.assert_allclose(setup.contacts.depths, 3e-3, atol=0.2e-3)


def test_an_outline_is_drawn_by_a_moving_focus(read) -> None:
    setup = read(ARRAY, FINGER, BALL, 'style = "outline"\n')
    assert setup.motion.through_points(len(setup.foci))
    assert len(setup.foci) >= 3
    np.testing.assert_allclose(-setup.scene.depth(setup.target.points), 0.5e-3, atol=0.1e-3)


def test_a_grating_sets_the_strength(read) -> None:
    keys = 'style = "texture"\nstiffness = 1000.0\n'
    at_ridge = read(ARRAY, FINGER, BALL, keys, "grating = { pitch = 0.004 }\n")
    beside = read(
        ARRAY,
        FINGER,
        BALL,
        keys,
        "grating = { pitch = 0.004 }\n",
        "pose = { translation = [0.001, 0, 0] }\n",
    )
    assert at_ridge.contacts.foci().strengths[0] == pytest.approx(1.0, abs=1e-3)
    assert beside.contacts.foci().strengths[0] < 0.95


def test_the_result_names_the_touch_and_its_strength(read) -> None:
    (words,) = touches(at.read_scene("touch_ball"))
    assert "thumb 6.0 mm" in words
    assert "finger 6.0 mm" in words
    shallow = read(ARRAY, FINGER, BALL.replace("-0.008", "-0.009"))
    assert "60%" in touches(shallow)[1]


def test_many_contacts_are_merged_or_dropped_with_a_warning(read) -> None:
    finger = FINGER.replace("0.05]", "0.09]")
    heights = 0.008 + 0.008 * np.arange(10)
    balls = [
        f"[[objects]]\nsphere = {{ radius = 0.004, centre = [0.011, 0.0, {height}] }}\n"
        for height in heights
    ]
    setup = read(ARRAY, finger, *balls)
    assert len(setup.contacts) == 10
    assert len(setup.foci) == 8
    assert any("2 dropped" in caution for caution in reach_cautions(setup))


def test_given_foci_are_kept_and_the_objects_only_drawn(read) -> None:
    setup = read(ARRAY, FINGER, "[[foci]]\npoint = [0.0, 0.0, -0.001]\n", BALL)
    assert setup.contacts is None
    assert setup.target.points.tolist() == [[0.0, 0.0, -0.001]]
    assert len(setup.objects) == 1


@pytest.mark.parametrize(
    ("code", "parts", "facts"),
    [
        ("key_missing", [FINGER], "foci"),
        ("empty", [FINGER, BALL.replace("-0.008", "-0.018")], "8 mm"),
        ("empty", [BALL], ""),
        ("too_many", [FINGER, BALL * 65], "65 64"),
        ("given_twice", [FINGER, (BALL + 'name = "b"\n') * 2], "'b'"),
        ("not_finite", [FINGER, BALL.replace("-0.008", "nan")], "objects[0].sphere.centre"),
        ("not_in_metres", [FINGER, BALL.replace("-0.008", "-80.0")], "objects[0]"),
        ("out_of_range", [FINGER, BALL.replace("0.01,", "-0.01,")], "objects[0].sphere.radius"),
        ("options_clash", [FINGER, BALL, 'surface = "block.stl"\n'], "objects[0]"),
        ("key_missing", [FINGER, BALL, 'style = "texture"\n'], "objects[0]"),
        ("key_misplaced", [FINGER, BALL, "grating = { pitch = 0.004 }\n"], "objects[0]"),
        ("unknown_name", [FINGER, BALL, 'style = "outlines"\n'], "objects[0].style"),
        ("unknown_key", [FINGER, BALL, "stifness = 400.0\n"], "objects[0].stiffness"),
        ("mesh_faulty", [FINGER, '[[objects]]\nsurface = "open.stl"\n'], "objects[0] open.stl"),
    ],
)
def test_impossible_objects_are_rejected(code, parts, facts, read, tmp_path) -> None:
    block = trimesh.creation.box(extents=(0.03, 0.03, 0.02))
    block.update_faces(np.arange(10))
    block.export(tmp_path / "open.stl")
    with raises_code(code, facts):
        read(ARRAY, *parts)
