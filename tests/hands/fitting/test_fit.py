"""Hands fitted to clouds: a true hand of another shape family, our own body, and input that is rejected."""

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from airtact.geometry.mesh.topology import edge_twins
from airtact.hands.fitting.fit import FittedHand, fit_hand
from airtact.hands.fitting.priors import (
    SIZE_LENGTHS,
    SIZE_RADII,
    SPANS,
    HandAnatomy,
    population_prior,
)
from airtact.hands.hand import Hand
from airtact.hands.joints import FINGERS
from faults import raises_code
from geometry.mesh.meshes import flat_mesh
from references.hand_poses import example, random_pose
from references.rigged_hand import Rigged, off_each_other, posed, rough, seen, turned_to_camera

CAMERA = np.zeros(3)
LEARNED = 8


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
    return fit_hand(cloud, landmarks, "right", CAMERA)


def known(joints: np.ndarray, radii: np.ndarray) -> HandAnatomy:
    """Sizes of a hand that are known for sure."""
    ends = joints[np.array(SPANS)]
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    return HandAnatomy(np.log(np.r_[lengths, radii]), 1e-6 * np.eye(62), LEARNED)


# --- how good -------------------------------------------------------------------------------------------------------


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
def test_both_skins_are_near_each_other_and_the_uncertainty_is_honest(
    pose: str, view: int, palm: bool
) -> None:
    true = turned_to_camera(posed(pose), view, palm=palm)
    fitted = fit_hand(seen(true, view), rough(true.joints, view), "right", CAMERA)
    from_true, from_fitted, part, other = off_each_other(fitted.hand, true)
    surface = fitted.surface

    assert 0.5 * (from_true.mean() + from_fitted.mean()) < 2.5e-3
    assert edge_twins(surface.triangles).min() >= 0  # closed
    for index, name in enumerate((*FINGERS, "palm")):
        off = np.r_[from_true[part == index], from_fitted[other == index]]
        assert 0.2 < np.sqrt(np.mean(off**2)) / fitted.part_errors[name] < 2.0
    joints = np.linalg.norm(fitted.hand.joints - true.joints, axis=1)
    assert 0.3 < np.sqrt(np.mean(joints**2) / np.mean(fitted.joint_errors**2)) < 3.0
    assert fitted.uncertainty.own_position == pytest.approx(
        np.sqrt(np.mean(fitted.joint_errors**2) / 3.0)
    )


def test_later_frames_are_as_good_and_keep_the_sizes() -> None:
    before, off = None, []
    for frame in range(LEARNED + 3):
        true = turned_to_camera(posed("pinch", 0.1 * frame), 3, tilt=20.0 + frame)
        before = fit_hand(seen(true, frame), rough(true.joints, frame), "right", CAMERA, before)
        off.append(np.abs(before.hand.shape.depth(true.vertices)).mean())
        if frame == LEARNED - 1:
            learned = before.anatomy

    assert before is not None
    assert learned.settled
    assert before.anatomy is learned
    np.testing.assert_array_equal(before.hand.radii, np.exp(learned.mean[SIZE_RADII]))
    assert before.hand.follows is not None  # its mesh follows the one of the frame before
    assert max(off[LEARNED:]) < 2.5e-3


@pytest.mark.parametrize(
    "seed", [*range(8), 60, 93, 131]
)  # the last end in wrong minima from one start alone
def test_a_clean_cloud_of_our_own_body_gives_its_own_joints(seed: int) -> None:
    rest, radii = example("relaxed")
    joints = random_pose(seed, rest)
    hand = Hand(joints, radii, "left")
    cloud = hand.shape.skin(4e-3).vertices

    found = fit_hand(cloud, rough(joints, seed), "left", anatomy=known(joints, radii))

    assert np.linalg.norm(found.hand.joints - joints, axis=1).max() < 0.11e-3
    assert found.misfit < 0.05e-3


@settings(max_examples=3, phases=[Phase.generate])  # shrinking would take minutes
@given(turn=st.tuples(*3 * [st.floats(-3.0, 3.0)]), shift=st.tuples(*3 * [st.floats(-1.0, 1.0)]))
def test_moving_the_cloud_moves_the_hand(turn: tuple, shift: tuple) -> None:
    true = turned_to_camera(posed("curl"), 4)
    landmarks, rotation = rough(true.joints, 4), Rotation.from_rotvec(turn)
    at_rest = fit_hand(true.vertices, landmarks, "right")
    moved = fit_hand(
        rotation.apply(true.vertices) + shift, rotation.apply(landmarks) + shift, "right"
    )

    # the cells stand elsewhere: other means are fitted
    off = rotation.apply(np.array(at_rest.hand.joints)) + shift - moved.hand.joints
    assert np.sqrt(np.mean(off**2)) < 1e-3


def test_outliers_are_distinguished_from_skin(true_hand: Rigged, fitted: FittedHand) -> None:
    off = np.abs(flat_mesh(true_hand.vertices, true_hand.triangles).depth(fitted.points))

    assert np.mean(fitted.outliers[off > 12e-3]) > 0.8
    assert np.mean(fitted.outliers[off < 2e-3]) < 0.1


def test_landmarks_of_21_joints_do_as_well(
    true_hand: Rigged, cloud: np.ndarray, landmarks: np.ndarray
) -> None:
    tracked = np.delete(landmarks, [5, 10, 15, 20], axis=0)

    found = fit_hand(cloud, tracked, camera=CAMERA)

    assert found.hand.side == "right"
    assert np.abs(found.hand.shape.depth(true_hand.vertices)).mean() < 2.5e-3


def test_a_hand_seen_from_all_sides_needs_no_camera(
    true_hand: Rigged, landmarks: np.ndarray
) -> None:
    found = fit_hand(true_hand.vertices, landmarks, "right")

    assert np.abs(found.hand.shape.depth(true_hand.vertices)).mean() < 1.5e-3


def test_a_forearm_is_left_out(cloud: np.ndarray, true_hand: Rigged, landmarks: np.ndarray) -> None:
    back = true_hand.joints[0] - true_hand.joints[11]
    back = back / np.linalg.norm(back)
    random = np.random.default_rng(0)
    beside = np.cross(back, [0.0, 0.0, 1.0])
    arm = true_hand.joints[0] + np.outer(random.uniform(0.03, 0.25, 9000), back)
    arm = arm + np.outer(random.uniform(-0.025, 0.025, 9000), beside) - [0.0, 0.0, 0.015]

    found = fit_hand(np.vstack([cloud, arm]), landmarks, "right", CAMERA)

    assert np.abs(found.hand.shape.depth(true_hand.vertices)).mean() < 2.5e-3


def test_sizes_have_the_names_of_bones(fitted: FittedHand) -> None:
    lengths = fitted.anatomy.lengths

    assert len(lengths) == 24
    assert (
        0.03 < lengths["index-finger-phalanx-proximal to index-finger-phalanx-intermediate"] < 0.06
    )
    np.testing.assert_allclose(fitted.anatomy.radii, fitted.hand.radii)
    assert fitted.anatomy.frames == 1


def test_radii_of_the_population_grow_more_slowly_than_bones(landmarks: np.ndarray) -> None:
    small, large = population_prior(landmarks), population_prior(1.2 * landmarks)

    np.testing.assert_allclose(np.exp(large.mean - small.mean)[SIZE_LENGTHS], 1.2)
    assert np.all(large.radii / small.radii < 1.15)


# --- bad input ------------------------------------------------------------------------------------------------------


def test_joints_that_are_missing_are_rejected(cloud: np.ndarray, landmarks: np.ndarray) -> None:
    with raises_code("joint_count", "20 joints"):
        fit_hand(cloud, landmarks[:20], "right")


def test_joints_that_are_nan_are_rejected(cloud: np.ndarray, landmarks: np.ndarray) -> None:
    broken = landmarks.copy()
    broken[7] = np.nan

    with raises_code("not_finite", "joint 7, index-finger-phalanx-intermediate"):
        fit_hand(cloud, broken, "right")


def test_joints_in_millimetres_are_rejected(cloud: np.ndarray, landmarks: np.ndarray) -> None:
    with raises_code("not_in_metres", " m:"):
        fit_hand(cloud, 1e3 * landmarks, "right")


def test_bones_of_impossible_length_are_rejected(cloud: np.ndarray, landmarks: np.ndarray) -> None:
    broken = landmarks.copy()
    broken[9] += [0.0, 0.12, 0.0]

    with raises_code("bone_length", "index-finger-phalanx-distal", "index-finger-tip"):
        fit_hand(cloud, broken, "right")


def test_swapped_joints_are_rejected(
    true_hand: Rigged, cloud: np.ndarray, landmarks: np.ndarray
) -> None:
    fingers = landmarks.copy()
    fingers[[5, 6, 7, 8, 9, 20, 21, 22, 23, 24]] = landmarks[[20, 21, 22, 23, 24, 5, 6, 7, 8, 9]]
    tips = landmarks.copy()
    tips[[9, 24]] = landmarks[[24, 9]]

    with raises_code("hand_implausible", "ring finger", "16.5 mm"):
        fit_hand(cloud, fingers, "right", CAMERA)
    with raises_code("bone_length", "are joints swapped"):
        fit_hand(cloud, tips, "right", CAMERA)


def test_a_left_hand_for_a_right_one_is_rejected(cloud: np.ndarray, landmarks: np.ndarray) -> None:
    with raises_code("wrong_side", "left hand", "(+"):
        fit_hand(cloud, landmarks, "left", CAMERA)


def test_a_flat_hand_needs_its_side(cloud: np.ndarray) -> None:
    with raises_code("side_unclear", "1.5"):
        fit_hand(cloud, turned_to_camera(posed("rest"), 1).joints)


def test_an_empty_or_tiny_cloud_is_rejected(cloud: np.ndarray, landmarks: np.ndarray) -> None:
    with raises_code("too_few", " 0 points"):
        fit_hand(np.zeros((0, 3)), landmarks, "right")
    with raises_code("too_few", "150 points"):
        fit_hand(cloud[:150], landmarks, "right")


def test_a_cloud_with_nan_is_rejected(cloud: np.ndarray, landmarks: np.ndarray) -> None:
    broken = cloud.copy()
    broken[5, 1] = np.nan

    with raises_code("not_finite", "1 NaN", "[5, 1]"):
        fit_hand(broken, landmarks, "right")


def test_a_cloud_in_millimetres_is_rejected(cloud: np.ndarray, landmarks: np.ndarray) -> None:
    with raises_code("not_in_metres", " m from"):
        fit_hand(1e3 * cloud, landmarks, "right", CAMERA)


def test_a_cloud_far_off_is_rejected(cloud: np.ndarray, landmarks: np.ndarray) -> None:
    with raises_code("misplaced", f"0 of {len(cloud)} points", "45 mm"):
        fit_hand(cloud + [0.4, 0.0, 0.0], landmarks, "right", CAMERA)


def test_two_hands_in_a_cloud_are_rejected(cloud: np.ndarray, landmarks: np.ndarray) -> None:
    second = cloud * [-1.0, 1.0, 1.0] + [0.25, 0.0, 0.0]

    with raises_code("given_twice", "45 mm"):
        fit_hand(np.vstack([cloud, second]), landmarks, "right", CAMERA)


def test_a_second_hand_behind_the_first_is_rejected(
    cloud: np.ndarray, landmarks: np.ndarray
) -> None:
    with raises_code("pose_not_found", "% to 6 mm"):
        fit_hand(np.vstack([cloud, cloud + [0.0, 0.0, 0.05]]), landmarks, "right", CAMERA)


def test_a_camera_among_the_points_is_rejected(cloud: np.ndarray, landmarks: np.ndarray) -> None:
    with raises_code("misplaced", "30 mm"):
        fit_hand(cloud, landmarks, "right", np.median(cloud, axis=0))


def test_a_camera_that_stands_elsewhere_is_rejected(
    cloud: np.ndarray, landmarks: np.ndarray
) -> None:
    with raises_code("pose_not_found", "% to 6 mm", "does the camera stand elsewhere"):
        fit_hand(cloud, landmarks, "right", np.array([0.0, 0.0, 1.0]))


def test_coordinates_that_are_no_positions_are_rejected(
    cloud: np.ndarray, landmarks: np.ndarray
) -> None:
    broken = cloud.copy()
    broken[5, 1] = 1e200

    with raises_code("out_of_range", "point 5", "1e+200 m"):
        fit_hand(broken, landmarks, "right", CAMERA)


def test_a_cloud_that_is_mostly_outliers_is_rejected(
    cloud: np.ndarray, landmarks: np.ndarray
) -> None:
    random = np.random.default_rng(0)
    fog = landmarks[random.integers(0, 25, 20_000)] + random.normal(scale=22e-3, size=(20_000, 3))

    with raises_code("pose_not_found", "% to 6 mm"):
        fit_hand(np.vstack([cloud[::20], fog]), landmarks, "right")


def test_landmarks_of_another_hand_are_rejected(cloud: np.ndarray, landmarks: np.ndarray) -> None:
    moved = landmarks.copy()
    moved[[8, 9]] += [0.0, 0.0, 0.045]  # 45 mm off, and no bone shows it

    with raises_code("misplaced", "index-finger-tip", "30 mm"):
        fit_hand(cloud, moved, "right", CAMERA)


def test_a_camera_that_is_no_position_is_rejected(
    cloud: np.ndarray, landmarks: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "jaxtyping.config.jaxtyping_disable", True
    )  # so that the guard itself answers
    with raises_code("wrong_shape", "(2,)"):
        fit_hand(cloud, landmarks, "right", np.zeros(2))
    with raises_code("not_finite", "3 NaN"):
        fit_hand(cloud, landmarks, "right", np.full(3, np.nan))
