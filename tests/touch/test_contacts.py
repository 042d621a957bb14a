"""Contacts of skin with virtual objects, against closed forms."""

import numpy as np
import pytest

import airtact as at
from airtact.hands.joints import NAMES
from airtact.touch import Box, Button, Grating, HalfSpace, skin_of
from airtact.touch.finding import find
from faults import raises_code
from paths import HANDS
from worlds import directions


def ball(radius: float, centre=(0.0, 0.0, 0.0), **kwargs) -> at.VirtualObject:
    return at.VirtualObject(at.sphere(radius, radius / 4), at.Pose.shift(tuple(centre)), **kwargs)


@pytest.fixture(scope="module")
def hand() -> at.Hand:
    return at.load_hand(HANDS / "relaxed.json")


@pytest.mark.parametrize("seed", range(4))
def test_two_spheres(seed) -> None:
    skin_radius = 8e-3
    radius = 12e-3
    distance = 17e-3
    (way,) = directions(1, seed)
    contacts = at.contact(at.sphere(skin_radius, 2e-3), ball(radius, distance * way, name="ball"))

    assert contacts.objects == ("ball",)
    np.testing.assert_allclose(contacts.depths, skin_radius + radius - distance, atol=1e-7)
    np.testing.assert_allclose(contacts.points, [skin_radius * way], atol=1e-5)
    np.testing.assert_allclose(contacts.normals, [way], atol=2e-3)
    # the skin inside is a cap
    height = skin_radius - (distance**2 + skin_radius**2 - radius**2) / (2 * distance)
    assert contacts.areas[0] == pytest.approx(2 * np.pi * skin_radius * height, rel=0.15)
    # its edge is the circle of points on both spheres
    ((curve,),) = contacts.outlines
    np.testing.assert_array_equal(curve[0], curve[-1])
    np.testing.assert_allclose(np.linalg.norm(curve, axis=1), skin_radius, atol=1e-7)
    off = np.linalg.norm(curve - distance * way, axis=1) - radius
    assert np.abs(off).max() < 0.1e-3
    rim = np.sqrt(skin_radius**2 - (skin_radius - height) ** 2)
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    assert length == pytest.approx(2 * np.pi * rim, rel=0.02)


def test_two_fingers_at_a_ball_touch_where_the_paper_says() -> None:
    fingers = at.pinch(gap=0.012)
    contacts = at.contact(fingers.surfaces, ball(12e-3, name="ball"))
    np.testing.assert_allclose(contacts.points, fingers.pads, atol=1e-6)
    np.testing.assert_allclose(contacts.depths, 6e-3, atol=1e-9)
    np.testing.assert_allclose(contacts.target().points, fingers.foci(0.5e-3), atol=2e-6)


def test_the_smallest_ball_is_found_between_the_points_of_the_skin() -> None:
    finger = at.capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.03), radius=8e-3, edge=6e-3)
    skin = skin_of(finger)
    # The middle of the triangle that is farthest from its corners
    corners = skin.points[skin.triangles]
    middles = corners.mean(axis=1)
    widest = int(np.linalg.norm(corners - middles[:, None], axis=2).min(axis=1).argmax())
    place = finger.shape.project(middles[[widest]])[0]
    bead = ball(2e-3, place)
    assert len(find(skin, [bead]).depths) == 0
    contacts = at.contact(finger, bead)
    np.testing.assert_allclose(contacts.points, [place], atol=1e-5)
    np.testing.assert_allclose(contacts.depths, 2e-3, atol=1e-5)
    with raises_code("out_of_range"):
        ball(1.9e-3)


def test_a_hand_on_a_half_space_touches_with_the_outermost_joints(hand) -> None:
    # The skin around a joint is a ball, so the outermost ball is deepest. Blending adds skin only
    # between the balls.
    _, normal = hand.places["middle.pad"]
    reach = hand.joints @ normal + hand.radii
    level = reach.max() - 2e-3
    plane = HalfSpace(tuple(level * normal), tuple(-normal))
    contacts = at.contact(hand, at.VirtualObject(plane, name="table"))
    deepest = int(contacts.depths.argmax())
    joint = int(reach.argmax())
    assert contacts.depths[deepest] == pytest.approx(2e-3, abs=1e-5)
    expected = hand.joints[joint] + hand.radii[joint] * normal
    np.testing.assert_allclose(contacts.points[deepest], expected, atol=0.1e-3)
    assert contacts.places[deepest] in NAMES[joint]
    assert set(contacts.objects) == {"table"}


def test_fingers_of_a_hand_are_named(hand) -> None:
    things = []
    for name in ("thumb", "index", "palm"):
        point, normal = hand.places["palm" if name == "palm" else f"{name}.pad"]
        things.append(ball(0.01, point + 8.5e-3 * normal, name=f"ball at {name}"))
    contacts = at.contact(hand, things)
    assert [f"ball at {place}" for place in contacts.places] == list(contacts.objects)
    assert set(contacts.places) == {"thumb", "index", "palm"}
    on_skin = hand.surface.depth(contacts.points)
    assert np.abs(on_skin).max() < 1e-6
    assert (contacts.depths > 1e-3).all()
    assert not contacts.foci().note


def test_two_hands_have_sides(hand) -> None:
    mirrored = at.hand_from_joints(
        hand.joints * [-1.0, 1.0, 1.0], side="left" if hand.side == "right" else "right"
    )
    skin = skin_of([hand, mirrored.moved(at.Pose.shift((0.5, 0.0, 0.0)))])
    assert {"left.index", "right.palm"} <= set(skin.places)


def test_moving_skin_gives_nearly_the_same_contacts_as_the_exact_surface() -> None:
    fingers = at.pinch(gap=0.012)
    skin = skin_of(fingers.surfaces)
    for shift in ((0.0, 0.0, 0.0), (0.3e-3, 0.7e-3, -1.1e-3), (0.0, 2e-3, 1e-3)):
        thing = ball(12e-3, shift, name="ball")
        found = find(skin, [thing])
        exact = at.contact(fingers.surfaces, thing)
        np.testing.assert_allclose(found.points, exact.points, atol=0.15e-3)
        np.testing.assert_allclose(found.depths, exact.depths, atol=0.02e-3)
        np.testing.assert_allclose(found.normals, exact.normals, atol=0.03)


def test_a_coarse_skin_of_a_hand_serves_the_pads(hand) -> None:
    coarse = skin_of(hand, longest_edge=10e-3)
    assert len(coarse.points) < 2000 < len(skin_of(hand).points)
    for finger in ("thumb", "index", "middle"):
        point, normal = hand.places[f"{finger}.pad"]
        thing = ball(15e-3, point + 13e-3 * normal, name="ball")
        found = find(coarse, [thing])
        exact = at.contact(hand, thing)
        assert [coarse.places[place] for place in found.places] == [finger]
        np.testing.assert_allclose(found.points, exact.points, atol=0.3e-3)
        np.testing.assert_allclose(found.depths, exact.depths, atol=0.05e-3)


def test_a_mesh_gives_the_contacts_of_its_closed_form(box) -> None:
    sides = np.array([0.03, 0.03, 0.02])
    pose = at.Pose.turn((0, 1, 0), 0.2, translation=(0.0, 0.0, -0.016))
    finger = at.capsule((0, 0, 0.02), (0, 0, 0), radius=8e-3, edge=2e-3)
    of_mesh = at.contact(finger, at.VirtualObject(box(-sides / 2, sides / 2), pose))
    of_form = at.contact(finger, at.VirtualObject(Box(tuple(sides)), pose))
    np.testing.assert_allclose(of_mesh.depths, of_form.depths, atol=1e-5)
    np.testing.assert_allclose(of_mesh.points, of_form.points, atol=0.1e-3)


def test_a_long_patch_gets_several_foci_apart(hand) -> None:
    wavelength = 8.6e-3
    finger = at.capsule((0.0, 0, 0), (0.03, 0, 0), radius=8e-3, edge=2e-3)
    table = at.VirtualObject(HalfSpace((0, 0, -7e-3), (0, 0, 1)), name="table")
    foci = at.contact(finger, table).foci()
    distances = np.linalg.norm(foci.points[:, None] - foci.points, axis=2)
    assert 3 <= len(foci.points) <= 8
    assert distances[~np.eye(len(distances), dtype=bool)].min() >= 0.79 * wavelength
    assert len(set(foci.names)) == len(foci.names)
    assert len(at.contact(finger, table).target(most=2).points) == 2


def test_the_weakest_contacts_are_merged_then_dropped() -> None:
    things = [ball(3e-3, (7e-3 * i, 0.0, 10e-3 + 0.1e-3 * i), name=str(i)) for i in range(11)]
    finger = at.capsule((0.0, 0, 0), (0.07, 0, 0), radius=8e-3, edge=2e-3)
    contacts = at.contact(finger, things)
    assert len(contacts) >= 10
    foci = contacts.foci(most=8)
    assert len(foci.points) == 8
    assert foci.dropped == len(contacts) - 8
    assert str(foci.dropped) in foci.note
    assert set(foci.contacts) == set(np.argsort(-contacts.depths)[:8])


def test_the_strength_rises_with_depth_up_to_a_cap() -> None:
    finger = at.sphere(8e-3, 2e-3)
    strengths = []
    for depth in (0.1e-3, 1e-3, 2e-3, 4e-3):
        thing = ball(12e-3, (0, 0, 20e-3 - depth), stiffness=400.0)
        strengths.append(float(at.contact(finger, thing).foci().strengths[0]))
    np.testing.assert_allclose(strengths, [0.24, 0.6, 1.0, 1.0], atol=1e-3)
    button = Button((0, 0, 0), radius=0.01, travel=5e-3)
    pressed = [
        at.contact(finger, at.VirtualObject(button, at.Pose.shift((0, 0, d - 8e-3))))
        for d in (2.5e-3, 5e-3)
    ]
    np.testing.assert_allclose([c.foci().strengths[0] for c in pressed], [0.6, 1.0], atol=1e-3)


def test_a_texture_is_fixed_to_the_object() -> None:
    finger = at.sphere(8e-3, 2e-3)
    ridges = Grating(4e-3)
    strengths = []
    for shift in (0.0, 1e-3, 2e-3):
        block = Box((0.04, 0.04, 0.01))
        pose = at.Pose.shift((shift, 0.0, -11e-3))
        thing = at.VirtualObject(block, pose, style="texture", texture=ridges)
        strengths.append(float(at.contact(finger, thing).foci().strengths[0]))
    np.testing.assert_allclose(strengths, [1.0, 0.5, 0.0], atol=0.02)


def test_an_outline_is_a_path_along_the_edge_of_the_contact() -> None:
    finger = at.sphere(8e-3, 2e-3)
    table = at.VirtualObject(HalfSpace((0, 0, -5e-3), (0, 0, 1)), style="outline")
    contacts = at.contact(finger, table)
    points = contacts.target().points
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 8.5e-3, atol=0.05e-3)
    np.testing.assert_allclose(points[:, 2], -5e-3 * 8.5 / 8.0, atol=0.2e-3)
    steps = np.linalg.norm(np.diff(points, axis=0, append=points[:1]), axis=1)
    assert 1.5e-3 < steps.min() < steps.max() < 2.9e-3
    mixed = at.contact(finger, [table, ball(5e-3, (0, 0, 12e-3))])
    with pytest.raises(at.InvalidInput) as caught:
        mixed.target()
    assert caught.value.code == "options_clash"


def test_no_contact_is_a_result_but_no_target() -> None:
    contacts = at.contact(at.sphere(8e-3, 2e-3), ball(12e-3, (0, 0, 0.05)))
    assert len(contacts) == 0
    assert contacts.points.shape == contacts.normals.shape == (0, 3)
    assert contacts.foci().points.shape == (0, 3)
    with pytest.raises(at.InvalidInput) as caught:
        contacts.target()
    assert caught.value.code == "empty"


@pytest.mark.parametrize(
    ("code", "objects", "offset"),
    [
        ("too_many", [ball(0.01)] * 65, 0.5e-3),
        ("given_twice", [ball(0.01, name="a"), ball(0.01, name="a")], 0.5e-3),
        ("out_of_range", ball(0.01), 0.5),
        ("wrong_kind", at.sphere(0.01, 0.003), 0.5e-3),
    ],
)
def test_impossible_questions_are_rejected(code, objects, offset, as_outside_the_tests) -> None:
    with pytest.raises(at.InvalidInput) as caught:
        at.contact(at.sphere(8e-3, 2e-3), objects, offset)
    assert caught.value.code == code
