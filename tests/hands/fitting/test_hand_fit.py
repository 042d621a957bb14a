"""The parts of the fit: distances from the body, rules and the silhouette, all with exact derivatives."""

from itertools import pairwise

import numpy as np
import pytest

import airtact as at
from airtact.hands.body import Hulls
from airtact.hands.fitting.gauss_newton import skin_residuals
from airtact.hands.fitting.priors import (
    JOINTS,
    SIZES,
    bend_rules,
    bending_axes,
    length_rules,
    usual_last_bones,
)
from airtact.hands.fitting.silhouette import silhouette_of
from airtact.hands.joints import BONES, CHAINS
from airtact.hands.kinematics import evenly_bent
from references.hand_poses import example
from references.rigged_hand import posed, seen, turned_to_camera

STEP = 1e-7


@pytest.fixture(scope="module")
def hulls() -> Hulls:
    joints, radii = example("relaxed")
    return at.hand_from_joints(joints, radii).shape.hulls


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
        alone = Hulls.unblended(hulls.balls, part[None])
        np.testing.assert_allclose(
            skin_residuals(points, alone).distance, each[:, index], atol=1e-12
        )
    off = np.abs(skin_residuals(points, hulls).distance - hulls.look(points).distance)
    assert (
        np.mean(off < 1e-12) > 0.97
    )  # where three blends meet, only those with the nearest hull are evaluated
    assert off.max() < 1e-3


@pytest.mark.parametrize("camera", [None, np.array([0.1, -0.2, 0.5])])
def test_derivatives_of_distances_are_exact_without_blending(
    hulls: Hulls, points: np.ndarray, camera: np.ndarray
) -> None:
    bare = Hulls(hulls.balls, hulls.parts, 0.0 * hulls.blend, hulls.apart)

    def distances(balls: np.ndarray) -> np.ndarray:
        return skin_residuals(
            points, Hulls(balls, hulls.parts, bare.blend, hulls.apart), camera
        ).distance

    by_balls = skin_residuals(points, bare, camera).by_balls
    off = np.abs(by_differences(distances, hulls.balls) - by_balls).max(axis=1)
    assert (
        np.percentile(off, 97 if camera is None else 55) < 1e-5
    )  # the nearest position on a ball's front is held fixed
    assert by_balls.shape == (len(points), 104)


def test_points_are_held_against_skin_that_faces_the_camera(hulls: Hulls) -> None:
    finger = Hulls.unblended(hulls.balls[[6, 7]], np.array([[0, 1, -1]]).repeat(4, axis=0))
    ball = 0.5 * (finger.balls[0] + finger.balls[1])
    sight = np.cross(finger.balls[1, :3] - finger.balls[0, :3], [0.0, 0.0, 1.0])
    sight /= np.linalg.norm(sight)
    camera = ball[:3] + 0.5 * sight
    behind = (ball[:3] - 0.9 * ball[3] * sight)[None]

    assert abs(skin_residuals(behind, finger).distance[0]) < 0.15 * ball[3]  # nearest is the back
    assert skin_residuals(behind, finger, camera).distance[0] == pytest.approx(
        -1.9 * ball[3], rel=0.02
    )


def test_derivatives_of_rules_are_exact() -> None:
    joints, _ = example("relaxed")
    random = np.random.default_rng(1)
    for _ in range(3):
        place = joints + random.normal(scale=8e-3, size=(25, 3))
        axes, sizes = bending_axes(place, "left"), random.normal(scale=0.1, size=62) - 3.5
        usual = usual_last_bones(place, axes)
        rules = {
            "bends": lambda x, axes=axes, usual=usual: bend_rules(x, axes, usual),
            "lengths": lambda x, sizes=sizes: length_rules(x, sizes),
        }
        for rule in rules.values():
            found = rule(place)
            gradients = by_differences(lambda x, rule=rule: rule(x).residuals, place)
            assert found.gradients.shape == (len(found.residuals), 137)
            np.testing.assert_allclose(
                found.gradients[:, JOINTS], gradients, atol=1e-6 * np.abs(gradients).max()
            )
        by_size = by_differences(lambda s, place=place: length_rules(place, s).residuals, sizes)
        np.testing.assert_allclose(
            length_rules(place, sizes).gradients[:, SIZES], by_size, atol=1e-4
        )


def test_rough_landmarks_are_untangled_by_how_far_knuckles_and_tips_are_apart() -> None:
    joints, _ = example("relaxed")
    lengths = np.linalg.norm(np.diff(joints[np.array(BONES)], axis=1)[:, 0], axis=1)
    tangled = joints.copy()
    for chain in CHAINS:
        tangled[list(chain[-3:-1])] = tangled[
            list(chain[-2:-4:-1])
        ]  # two joints of each finger swapped

    found = evenly_bent(tangled, lengths, "left")

    knuckles = [chain[-4] for chain in CHAINS[1:]]
    tips = [chain[-1] for chain in CHAINS[1:]]
    np.testing.assert_array_equal(found[knuckles], joints[knuckles])
    assert np.linalg.norm(found[tips] - joints[tips], axis=1).max() < 1.5e-3
    assert np.linalg.norm(found - joints, axis=1)[6:].mean() < 4e-3
    bones = np.linalg.norm(np.diff(found[np.array(BONES)], axis=1)[:, 0], axis=1)
    outer = [BONES.index(pair) for chain in CHAINS for pair in pairwise(chain[-3:])]
    np.testing.assert_allclose(bones[outer], lengths[outer], rtol=1e-9)


def test_what_reaches_out_of_the_silhouette_is_found_with_its_derivatives() -> None:
    true = turned_to_camera(posed("rest"), 1)
    found = silhouette_of(seen(true, 1, outliers=0.0), np.zeros(3))
    radii = example("relaxed")[1]
    balls = np.vstack(
        [np.column_stack([true.joints, radii]), [*true.joints[1:3].mean(axis=0), 0.01]]
    )
    inside = balls * [1.0, 1.0, 1.0, 0.5]
    aside = balls + [0.007, 0.0, 0.0, 0.0]

    def weighed(balls: np.ndarray) -> float:
        return found.beyond(balls)[2]

    assert weighed(inside) < 0.2 * weighed(aside)
    residuals, by_balls, cost = found.beyond(aside)
    assert len(residuals) > 5
    assert 0.0 < cost < 8 * 60 * 12**2
    whole = by_differences(lambda x: np.array([weighed(x)]), aside)[0]
    np.testing.assert_allclose(
        2.0 * residuals @ by_balls, whole, rtol=0.02, atol=0.02 * np.abs(whole).max()
    )
