"""Rigid motions as a group, and what is none."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import airtact as at
from faults import raises_code

number = st.floats(-1.0, 1.0, allow_subnormal=False)
vector = st.tuples(number, number, number)
axis = vector.filter(lambda v: np.linalg.norm(v) > 1e-3)
pose = st.builds(at.Pose.turn, axis, st.floats(-2 * math.pi, 2 * math.pi), vector)


@given(pose, pose, vector)
def test_composing_poses_is_applying_one_after_the_other(first, second, point):
    points = np.array([point])
    assert np.allclose(
        (first @ second).apply(points), first.apply(second.apply(points)), rtol=0, atol=1e-14
    )


@given(pose, vector)
def test_the_inverse_undoes_on_both_sides(motion, point):
    points = np.array([point])
    assert np.allclose((motion.inverse() @ motion).apply(points), points, rtol=0, atol=1e-14)
    assert np.allclose(motion.apply(motion.inverse().apply(points)), points, rtol=0, atol=1e-14)


@given(pose, vector, vector)
def test_poses_keep_distances_and_handedness(motion, one, two):
    points = np.array([one, two])
    assert math.dist(*motion.apply(points)) == pytest.approx(math.dist(*points), abs=1e-14)
    turned = motion.rotate(np.cross(*points))
    assert np.allclose(turned, np.cross(*motion.rotate(points)), rtol=0, atol=1e-14)


@given(axis, st.floats(-2 * math.pi, 2 * math.pi))
def test_a_turn_keeps_its_axis_and_has_its_angle(direction, angle):
    motion = at.Pose.turn(direction, angle)
    assert np.allclose(motion.rotate(np.array(direction)), direction, rtol=0, atol=1e-14)
    assert np.trace(motion.rotation) == pytest.approx(1 + 2 * math.cos(angle), abs=1e-14)


def test_a_quarter_turn_is_right_handed_and_shifts_afterwards():
    quarter = at.Pose.turn((0, 0, 2), math.pi / 2, translation=(1, 0, 0))
    assert np.allclose(quarter.apply(np.array([[1.0, 0.0, 5.0]])), [[1.0, 1.0, 5.0]])
    assert np.allclose(quarter.rotate(np.array([[1.0, 0.0, 5.0]])), [[0.0, 1.0, 5.0]])


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("rotation", "translation", "code", "said"),
    [
        (np.eye(2), np.zeros(3), "wrong_shape", "(2, 2) and (3,)"),
        (np.eye(3), np.zeros(2), "wrong_shape", "(3, 3) and (2,)"),
        (1.01 * np.eye(3), np.zeros(3), "wrong_kind", "0.02"),
        (np.diag([1.0, 1.0, -1.0]), np.zeros(3), "wrong_kind", "-1"),
        (np.full((3, 3), np.nan), np.zeros(3), "not_finite", "9 NaN"),
        (
            np.eye(3),
            np.array([0.0, np.inf, 0.0]),
            "not_finite",
            "[1]",
        ),
    ],
)
def test_what_is_no_rigid_motion_is_rejected(rotation, translation, code, said):
    with raises_code(code, said):
        at.Pose(rotation, translation)


@pytest.mark.parametrize(
    ("axis", "angle", "code"),
    [
        ((0, 0, 0), 1.0, "all_zero"),
        ((0.0, math.nan, 0.0), 1.0, "all_zero"),
        ((0, 0, 1), math.nan, "not_finite"),
        ((0, 0, 1), 90, "out_of_range"),  # degrees
    ],
)
def test_a_turn_needs_an_axis_and_an_angle_in_radians(axis, angle, code):
    with raises_code(code):
        at.Pose.turn(axis, angle)
