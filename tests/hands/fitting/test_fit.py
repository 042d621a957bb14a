"""Hands fitted to clouds: a true hand of another shape family, our own body, and input that is rejected."""

from functools import cache

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

import airtact as at
from airtact.geometry.mesh.triangles import edge_twins
from airtact.hands import FittedHand, HandAnatomy
from airtact.hands.fitting.fit import with_offset
from airtact.hands.fitting.priors import SIZE_RADII, SPANS
from airtact.hands.joints import TRACKED
from faults import raises_code
from geometry.mesh.meshes import flat_mesh
from references.hand_poses import example, random_pose
from references.rigged_hand import Rigged, off_each_other, posed, rough, seen, turned_to_camera

CAMERA = np.zeros(3)
LEARNED = 8
REST, RADII = example("relaxed")


@pytest.fixture(scope="module")
def true_hand() -> Rigged:
    return turned_to_camera(posed("pinch"), 1)


@pytest.fixture(scope="module")
def cloud(true_hand: Rigged) -> np.ndarray:
    return seen(true_hand, 1)


@pytest.fixture(scope="module")
def landmarks(true_hand: Rigged) -> np.ndarray:
    return rough(true_hand.joints, 1)


@pytest.fixture(scope="module")
def fitted(cloud: np.ndarray, landmarks: np.ndarray) -> FittedHand:
    return at.fit_hand(cloud, landmarks, "right", CAMERA)


def mean_error(fitted: FittedHand, true: Rigged) -> float:
    return np.abs(fitted.hand.shape.depth(true.vertices)).mean()


# --- accuracy ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pose", "view", "palm"),
    [
        ("pinch", 1, True),
        ("rest", 2, True),
        ("point", 1, False),
        *(
            pytest.param(pose, view, view % 2 == 0, marks=pytest.mark.slow)
            for pose in ("rest", "pinch", "grip", "point", "curl")
            for view in range(4)
        ),
    ],
)
def test_both_skins_are_near_each_other_and_the_uncertainty_is_honest(pose, view, palm) -> None:
    true = turned_to_camera(posed(pose), view, palm=palm)
    fitted = at.fit_hand(seen(true, view), rough(true.joints, view), "right", CAMERA)
    from_true, from_fitted, _, _ = off_each_other(fitted.hand, true)

    assert 0.5 * (from_true.mean() + from_fitted.mean()) < 2.5e-3
    assert edge_twins(fitted.surface.triangles).min() >= 0  # closed
    joints = np.linalg.norm(fitted.hand.joints - true.joints, axis=1)
    joint_error = np.sqrt(np.mean(fitted.joint_errors**2))
    assert 0.3 < np.sqrt(np.mean(joints**2)) / joint_error < 3.0
    assert fitted.uncertainty.own_position == pytest.approx(joint_error / np.sqrt(3.0))


def test_later_frames_are_as_good_and_keep_the_sizes() -> None:
    before = None
    errors = []
    for frame in range(LEARNED + 3):
        true = turned_to_camera(posed("pinch", 0.1 * frame), 3, tilt=20.0 + frame)
        before = at.fit_hand(seen(true, frame), rough(true.joints, frame), "right", CAMERA, before)
        errors.append(mean_error(before, true))
        if frame == LEARNED - 1:
            learned = before.anatomy

    assert learned.settled
    assert before.anatomy is learned
    np.testing.assert_array_equal(before.hand.radii, np.exp(learned.mean[SIZE_RADII]))
    assert before.hand.follows is not None  # its mesh follows the one of the frame before
    assert max(errors[LEARNED:]) < 2.5e-3


# The last three end in wrong minima from one start alone.
@pytest.mark.parametrize(
    "seed", [0, 93, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3, 60, 131))]
)
def test_a_clean_cloud_of_our_own_body_gives_its_own_joints(seed: int) -> None:
    joints = random_pose(seed, REST)
    ends = joints[np.array(SPANS)]
    sizes = np.log(np.r_[np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1), RADII])
    sure = HandAnatomy(sizes, 1e-6 * np.eye(62), LEARNED)
    cloud = at.Hand(joints, RADII, "left").shape.skin(4e-3).vertices

    fitted = at.fit_hand(cloud, rough(joints, seed), "left", anatomy=sure)

    assert np.linalg.norm(fitted.hand.joints - joints, axis=1).max() < 0.11e-3
    assert fitted.misfit < 0.05e-3


@cache
def curled() -> tuple[Rigged, np.ndarray, np.ndarray]:
    """A hand, its landmarks, and the joints fitted to it."""
    true = turned_to_camera(posed("curl"), 4)
    landmarks = rough(true.joints, 4)
    return true, landmarks, np.array(at.fit_hand(true.vertices, landmarks, "right").hand.joints)


@settings(max_examples=2, phases=[Phase.generate])  # shrinking would take minutes
@given(turn=st.tuples(*3 * [st.floats(-3.0, 3.0)]), shift=st.tuples(*3 * [st.floats(-1.0, 1.0)]))
def test_moving_the_cloud_moves_the_hand(turn: tuple, shift: tuple) -> None:
    true, landmarks, at_rest = curled()
    rotation = Rotation.from_rotvec(turn)
    moved = at.fit_hand(
        rotation.apply(true.vertices) + shift, rotation.apply(landmarks) + shift, "right"
    )

    # the cells stand elsewhere: other means are fitted
    off = rotation.apply(at_rest) + shift - moved.hand.joints
    assert np.sqrt(np.mean(off**2)) < 1e-3


def test_outliers_are_distinguished_from_skin(true_hand: Rigged, fitted: FittedHand) -> None:
    off = np.abs(flat_mesh(true_hand.vertices, true_hand.triangles).depth(fitted.points))

    assert np.mean(fitted.outliers[off > 12e-3]) > 0.8
    assert np.mean(fitted.outliers[off < 2e-3]) < 0.1


def test_21_landmarks_do_as_well(true_hand, cloud, landmarks) -> None:
    fitted = at.fit_hand(cloud, landmarks[TRACKED], camera=CAMERA)

    assert fitted.hand.side == "right"
    assert mean_error(fitted, true_hand) < 2.5e-3


def test_a_hand_seen_from_all_sides_needs_no_camera(true_hand, landmarks) -> None:
    fitted = at.fit_hand(true_hand.vertices, landmarks, "right")

    assert mean_error(fitted, true_hand) < 1.5e-3


def test_a_forearm_is_left_out(cloud, true_hand, landmarks) -> None:
    back = true_hand.joints[0] - true_hand.joints[11]
    back = back / np.linalg.norm(back)
    random = np.random.default_rng(0)
    arm = true_hand.joints[0] + np.outer(random.uniform(0.03, 0.25, 9000), back)
    beside = np.cross(back, [0.0, 0.0, 1.0])
    arm = arm + np.outer(random.uniform(-0.025, 0.025, 9000), beside) - [0.0, 0.0, 0.015]

    fitted = at.fit_hand(np.vstack([cloud, arm]), landmarks, "right", CAMERA)

    assert mean_error(fitted, true_hand) < 2.5e-3


# --- the skin ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hand() -> at.Hand:
    return at.hand_from_joints(REST, RADII)


def points_off(hand: at.Hand, distance: float) -> np.ndarray:
    places = hand.shape.skin(2.5e-3).vertices
    normals = hand.shape.hulls.look(places).gradient
    return (places + distance * normals)[normals[:, 1] > 0.3]


def test_seen_skin_is_nearer_to_the_true_one_and_has_the_places() -> None:
    true_hand = turned_to_camera(posed("pinch", build="stout"), 2)
    fitted = at.fit_hand(seen(true_hand, 2), rough(true_hand.joints, 2), "right", CAMERA)
    true = flat_mesh(true_hand.vertices, true_hand.triangles)
    medians = []
    for places in (fitted.hand.shape.skin(3.5e-3).vertices, fitted.surface.vertices):
        faces = fitted.hand.shape.hulls.look(places).gradient @ [0.0, 0.0, -1.0] > 0.3
        medians.append(np.median(np.abs(true.depth(places[faces]))))
    point, normal = fitted.place("index.pad")

    assert medians[1] < min(0.8 * medians[0], 0.5e-3)
    assert len(fitted.surface.crossings) == 0
    assert abs(fitted.surface.depth(point[None])[0]) < 1e-6
    assert np.linalg.norm(point - fitted.hand.place("index.pad")[0]) < 1.8e-3
    assert np.linalg.norm(normal) == pytest.approx(1.0)


def test_skin_moves_as_far_as_points_are_off_and_stays_where_there_are_none(hand: at.Hand) -> None:
    points = points_off(hand, 0.8e-3)

    skin = with_offset(hand.shape.hulls, points, [3.5e-3])

    look = hand.shape.hulls.look(skin.vertices)
    facing = (look.gradient[:, 1] > 0.8) & (look.facing > 8e-3) & (np.abs(look.bend) > 5e-3)
    assert np.median(look.distance[facing]) == pytest.approx(0.8e-3, rel=0.1)
    away = KDTree(points).query(skin.vertices)[0] > 12.5e-3
    assert away.any()
    assert np.abs(look.distance[away]).max() < 1e-6


# --- bad input --------------------------------------------------------------------------------


def at_index(points: np.ndarray, index: object, value: object) -> np.ndarray:
    changed = points.copy()
    changed[index] = value
    return changed


def swapped(points: np.ndarray, first: list[int], second: list[int]) -> np.ndarray:
    return at_index(points, first + second, points[second + first])


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("joint_count", lambda cloud, marks: (cloud, marks[:20])),
        ("not_finite", lambda cloud, marks: (cloud, at_index(marks, 7, np.nan))),
        ("not_in_metres", lambda cloud, marks: (cloud, 1e3 * marks)),
        ("bone_length", lambda cloud, marks: (cloud, at_index(marks, (9, 1), marks[9, 1] + 0.12))),
        ("bone_length", lambda cloud, marks: (cloud, swapped(marks, [9], [24]))),
        (
            "hand_implausible",
            lambda cloud, marks: (cloud, swapped(marks, [5, 6, 7, 8, 9], [20, 21, 22, 23, 24])),
        ),
        ("wrong_side", lambda cloud, marks: (cloud, marks, "left")),
        (
            "side_unclear",
            lambda cloud, marks: (cloud, turned_to_camera(posed("rest"), 1).joints, None),
        ),
        ("too_few", lambda cloud, marks: (np.zeros((0, 3)), marks)),
        ("too_few", lambda cloud, marks: (cloud[:150], marks)),
        ("not_finite", lambda cloud, marks: (at_index(cloud, (5, 1), np.nan), marks)),
        ("out_of_range", lambda cloud, marks: (at_index(cloud, (5, 1), 1e200), marks)),
        ("not_in_metres", lambda cloud, marks: (1e3 * cloud, marks)),
        ("misplaced", lambda cloud, marks: (cloud + [0.4, 0.0, 0.0], marks)),
        (  # a second hand beside the first
            "given_twice",
            lambda cloud, marks: (np.vstack([cloud, cloud * [-1, 1, 1] + [0.25, 0, 0]]), marks),
        ),
        (  # and one behind it
            "pose_not_found",
            lambda cloud, marks: (np.vstack([cloud, cloud + [0.0, 0.0, 0.05]]), marks),
        ),
        ("misplaced", lambda cloud, marks: (cloud, marks, "right", np.median(cloud, axis=0))),
        ("pose_not_found", lambda cloud, marks: (cloud, marks, "right", np.array([0.0, 0.0, 1.0]))),
        (  # 45 mm off, and no bone shows it
            "misplaced",
            lambda cloud, marks: (cloud, at_index(marks, [8, 9], marks[[8, 9]] + [0, 0, 0.045])),
        ),
        ("wrong_shape", lambda cloud, marks: (cloud, marks, "right", np.zeros(2))),
        ("not_finite", lambda cloud, marks: (cloud, marks, "right", np.full(3, np.nan))),
    ],
)
def test_bad_input_is_rejected(code, change, cloud, landmarks, as_outside_the_tests) -> None:
    changed = change(cloud, landmarks)
    defaults = (cloud, landmarks, "right", CAMERA)
    with raises_code(code):
        at.fit_hand(*changed, *defaults[len(changed) :])


def test_a_cloud_that_is_mostly_outliers_is_rejected(cloud, landmarks) -> None:
    random = np.random.default_rng(0)
    fog = landmarks[random.integers(0, 25, 20_000)] + random.normal(scale=22e-3, size=(20_000, 3))

    with raises_code("pose_not_found"):
        at.fit_hand(np.vstack([cloud[::20], fog]), landmarks, "right")
