import numpy as np
import pytest

from airtact.acoustics.target import Target
from faults import raises_code

POINTS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.01]])


def test_pressures_are_one_for_all_or_one_each_or_as_strong_as_possible():
    target = Target(POINTS, 1500)
    assert target.pressures.tolist() == [1500.0, 1500.0]
    assert target.pressures.dtype == np.float64
    assert not target.points.flags.writeable
    assert not target.pressures.flags.writeable
    assert Target(POINTS, np.array([0, 200])).pressures.tolist() == [0.0, 200.0]
    assert Target(POINTS).pressures is None


@pytest.mark.parametrize(
    ("points", "code"),
    [
        (np.zeros((0, 3)), "empty"),
        (np.array([[0.0, np.nan, 0.0]]), "not_finite"),
        ((POINTS[1], np.array([0.0, -0.6, 0.8])), "misplaced"),
        (np.array([[0.0, 0.0, 1.0], [0.0, 5.5, 0.0]]), "not_in_metres"),
    ],
)
@pytest.mark.usefixtures("as_outside_the_tests")
def test_faults_of_points_are_rejected(points, code):
    with raises_code(code):
        Target(points)


def test_a_share_asks_for_proportions_only():
    target = Target(POINTS, shares=np.array([1.0, 0.25]))
    assert target.pressures is None
    assert target.shares.tolist() == target.weights.tolist() == [1.0, 0.25]
    assert Target(POINTS).weights.tolist() == [1.0, 1.0]
    assert Target(POINTS, 20).weights.tolist() == [20.0, 20.0]


def test_complex_numbers_fix_the_phases_and_real_ones_leave_them():
    fixed = Target(POINTS, np.array([100.0, -200j]))
    np.testing.assert_allclose(fixed.pressures, [100.0, 200.0], rtol=1e-15)
    np.testing.assert_allclose(fixed.phases, [0.0, -np.pi / 2], rtol=1e-15)
    np.testing.assert_allclose(fixed.wanted, [100.0, -200j], atol=1e-12)
    free = Target(POINTS, np.array([100.0, 200.0]))
    assert free.phases is None
    np.testing.assert_array_equal(free.wanted, [100.0, 200.0])
    np.testing.assert_allclose(Target(POINTS, shares=1j).wanted, [1j, 1j], atol=1e-15)


def test_suppression_points_follow_the_foci_as_beacons_where_asked():
    target = Target(POINTS, suppression_points=np.array([[0.01, 0.0, 0.0]]))
    assert np.array_equal(target.beacons().positions, POINTS)
    assert np.array_equal(target.beacons().strengths, np.eye(2))
    both = target.beacons(suppression=True)
    assert np.array_equal(both.positions, [*POINTS, [0.01, 0.0, 0.0]])
    assert np.array_equal(both.strengths, np.eye(3))
    assert Target(POINTS).suppression_points.shape == (0, 3)


@pytest.mark.parametrize(
    ("asked", "code"),
    [
        ({"pressures": -3.0}, "out_of_range"),
        ({"pressures": np.array([10.0, -2.0])}, "out_of_range"),
        ({"pressures": 0.0}, "empty"),
        ({"pressures": np.nan}, "not_finite"),
        ({"pressures": np.array([1.0, np.inf])}, "not_finite"),
        ({"pressures": np.ones(3)}, "wrong_shape"),
        ({"pressures": np.zeros(0)}, "wrong_shape"),
        ({"shares": -0.5}, "out_of_range"),
        ({"shares": 0.0}, "empty"),
        ({"shares": 0j}, "empty"),
        ({"shares": np.ones(3)}, "wrong_shape"),
        ({"shares": 1.0, "pressures": 2.0}, "options_clash"),
        ({"pressures": complex(np.nan, 0)}, "not_finite"),
        ({"pressures": np.array([1j, np.inf])}, "not_finite"),
        ({"suppression_points": np.zeros((2, 2))}, "wrong_shape"),
        ({"suppression_points": np.array([[0.0, 0.0, np.nan]])}, "not_finite"),
        ({"suppression_points": np.array([[0.0, 0.0, 3.0]])}, "not_in_metres"),
        (
            {"suppression_points": np.array([[0.0, 0.1, 0.0], [0.0, 2e-7, 0.01]])},
            "misplaced",
        ),
    ],
)
@pytest.mark.usefixtures("as_outside_the_tests")
def test_faults_of_what_is_wanted_are_rejected(asked, code):
    with raises_code(code):
        Target(POINTS, **asked)
