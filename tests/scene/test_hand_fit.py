"""The pieces of the fit: distances to the body, rules and the outline, all with exact derivatives."""

import numpy as np
import pytest

from airtact.scene.clouds import thinned
from airtact.scene.hand import hand_from_joints
from airtact.scene.hand_feet import feet_on, gaps_to
from airtact.scene.hand_hulls import Hulls
from airtact.scene.hand_limits import UNKNOWNS, bend_rules, bending_axes, landmark_rules, length_rules
from airtact.scene.hand_outline import FAR, LOOSE, SPARE, outline
from scene.hand_poses import example
from scene.rigged_hand import posed, seen, turned_to_camera

STEP = 1e-7


@pytest.fixture(scope="module")
def hulls() -> Hulls:
    joints, radii = example("relaxed")
    return hand_from_joints(joints, radii).shape.hulls


@pytest.fixture(scope="module")
def points(hulls: Hulls) -> np.ndarray:
    random = np.random.default_rng(0)
    middles = hulls.balls[random.integers(0, 26, 800)]
    ways = random.normal(size=(800, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    return middles[:, :3] + random.uniform(0.3, 1.5, (800, 1)) * middles[:, 3:] * ways


def by_differences(function, start: np.ndarray, step: float = STEP) -> np.ndarray:
    columns = []
    for index in range(start.size):
        moved = np.zeros(start.size)
        moved[index] = step
        moved = moved.reshape(start.shape)
        columns.append((function(start + moved) - function(start - moved)) / (2 * step))
    return np.stack(columns, axis=1)


def test_distances_are_those_of_the_body(hulls: Hulls, points: np.ndarray) -> None:
    each = hulls.each(points)
    for index, part in enumerate(hulls.parts):
        feet = feet_on(points, hulls.balls, np.tile(part, (len(points), 1)))
        np.testing.assert_allclose(feet.distance, each[:, index], atol=1e-12)
    off = np.abs(gaps_to(points, hulls).distance - hulls.look(points).distance)
    assert np.mean(off < 1e-12) > 0.97  # where three creases meet, only those with the nearest hull are seen
    assert off.max() < 1e-3


@pytest.mark.parametrize("camera", [None, np.array([0.1, -0.2, 0.5])])
def test_slopes_of_distances_are_exact_but_in_creases(hulls: Hulls, points: np.ndarray, camera: np.ndarray) -> None:
    bare = Hulls(hulls.balls, hulls.parts, 0.0 * hulls.blend, hulls.apart)

    def distances(balls: np.ndarray) -> np.ndarray:
        return gaps_to(points, Hulls(balls, hulls.parts, bare.blend, hulls.apart), camera).distance

    slopes = gaps_to(points, bare, camera).slopes
    off = np.abs(by_differences(distances, hulls.balls) - slopes).max(axis=1)
    assert np.percentile(off, 97 if camera is None else 55) < 1e-5  # the foot on a ball's front is held fixed
    assert slopes.shape == (len(points), 104)


def test_points_are_held_against_skin_that_faces_the_camera(hulls: Hulls) -> None:
    finger = Hulls(hulls.balls[[6, 7]], np.array([[0, 1, -1]]).repeat(4, axis=0), np.zeros((4, 4)), np.zeros((4, 4)))
    ball = 0.5 * (finger.balls[0] + finger.balls[1])
    axis = finger.balls[1, :3] - finger.balls[0, :3]
    sight = np.cross(axis, [0.0, 0.0, 1.0])
    sight /= np.linalg.norm(sight)
    camera = ball[:3] + 0.5 * sight
    behind = (ball[:3] - 0.9 * ball[3] * sight)[None]

    assert abs(gaps_to(behind, finger).distance[0]) < 0.15 * ball[3]  # nearest is the back
    assert gaps_to(behind, finger, camera).distance[0] == pytest.approx(-1.9 * ball[3], rel=0.02)


def test_slopes_of_rules_are_exact() -> None:
    joints, _ = example("relaxed")
    random = np.random.default_rng(1)
    for _ in range(3):
        place = joints + random.normal(scale=8e-3, size=(25, 3))
        axes, sizes = bending_axes(place, "left"), random.normal(scale=0.1, size=62) - 3.5
        firm = random.uniform(50.0, 200.0, 25)
        rules = {
            "bends": lambda x, axes=axes: bend_rules(x, axes),
            "lengths": lambda x, sizes=sizes: length_rules(x, sizes),
            "landmarks": lambda x, firm=firm: landmark_rules(x - joints, firm),
        }
        for rule in rules.values():
            found = rule(place)
            slopes = by_differences(lambda x, rule=rule: rule(x).residuals, place)
            assert found.slopes.shape == (len(found.residuals), UNKNOWNS)
            np.testing.assert_allclose(found.slopes[:, :75], slopes, atol=1e-6 * np.abs(slopes).max())
        by_size = by_differences(lambda s, place=place: length_rules(place, s).residuals, sizes)
        np.testing.assert_allclose(length_rules(place, sizes).slopes[:, 75:], by_size, atol=1e-4)


def test_a_hand_at_rest_breaks_no_rule() -> None:
    joints, _ = example("relaxed")

    rules = bend_rules(joints, bending_axes(joints, "left"))

    assert np.abs(rules.residuals[:28]).max() == 0.0  # bends backwards and too far


def test_a_finger_bent_backwards_breaks_one() -> None:
    joints, _ = example("relaxed")
    mirrored = bending_axes(joints, "right")

    assert np.abs(bend_rules(joints, mirrored).residuals).max() > 3.0


def test_what_stands_out_of_the_outline_is_found_with_its_slope() -> None:
    true = turned_to_camera(posed("rest"), 1)
    found = outline(seen(true, 1, strays=0.0), np.zeros(3))
    radii = example("relaxed")[1]
    balls = np.vstack([np.column_stack([true.joints, radii]), [*true.joints[1:3].mean(axis=0), 0.01]])
    inside = balls * [1.0, 1.0, 1.0, 0.5]
    aside = balls + [0.007, 0.0, 0.0, 0.0]

    def weighed(balls: np.ndarray) -> float:
        return found.beyond(balls)[2]

    assert weighed(inside) < 0.2 * weighed(aside)
    residuals, slopes, cost = found.beyond(aside)
    assert len(residuals) > 5
    assert 0.0 < cost < 8 * 60 * (FAR / LOOSE) ** 2
    assert SPARE > 0.0
    whole = by_differences(lambda x: np.array([weighed(x)]), aside)[0]
    np.testing.assert_allclose(2.0 * residuals @ slopes, whole, rtol=0.02, atol=0.02 * np.abs(whole).max())


def test_thinning_keeps_given_points_and_drops_lonely_ones() -> None:
    random = np.random.default_rng(0)
    plate = np.column_stack([random.uniform(0.0, 0.1, (5000, 2)), np.zeros(5000)])
    lonely = np.array([[0.05, 0.05, 0.2]])

    kept = thinned(np.vstack([plate, lonely]))

    assert 200 < len(kept) < 400
    assert kept[:, 2].max() == 0.0
    assert all((plate == point).all(axis=1).any() for point in kept[:20])
