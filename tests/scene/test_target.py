import numpy as np
import pytest

from airtact.conventions import InvalidInput
from airtact.scene.target import Target

POINTS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.01]])


def test_one_number_is_asked_of_every_focus():
    assert Target(POINTS, 1500.0).pressures.tolist() == [1500.0, 1500.0]
    assert Target(POINTS, 1500).pressures.dtype == np.float64


def test_pressures_may_differ_and_one_may_be_quiet():
    assert Target(POINTS, np.array([0, 200])).pressures.tolist() == [0.0, 200.0]


def test_without_pressures_as_strong_as_possible():
    assert Target(POINTS).pressures is None


def test_beacons_are_one_pascal_metre_each_in_every_focus():
    beacons = Target(POINTS, 1500.0).beacons()
    assert np.array_equal(beacons.positions, POINTS)
    assert np.array_equal(beacons.strengths, np.eye(2))


def test_arrays_are_locked():
    target = Target(POINTS, 3.0)
    assert not target.points.flags.writeable
    assert not target.pressures.flags.writeable


@pytest.mark.parametrize(
    ("points", "pressures", "sentence"),
    [
        (np.zeros((0, 3)), None, r"target points are empty \(0 points\)"),
        (
            np.array([[0.0, np.nan, 0.0]]),
            None,
            r"target points hold 1 NaN or infinite value, the first at index \[0, 1\]",
        ),
        (POINTS, -3.0, "a target pressure is -3 Pa"),
        (POINTS, np.array([10.0, -2.0]), "a target pressure is -2 Pa"),
        (POINTS, 0.0, "every target pressure is 0 Pa"),
        (POINTS, np.nan, "target pressures hold 1 NaN"),
        (POINTS, np.array([1.0, np.inf]), r"target pressures hold 1 NaN or infinite value, the first at index \[1\]"),
        (POINTS, np.ones(3), r"target pressures have shape \(3,\), but the target has 2 foci"),
        (POINTS, np.zeros(0), r"target pressures have shape \(0,\), but the target has 2 foci"),
    ],
)
@pytest.mark.usefixtures("as_outside_the_tests")
def test_faults_are_refused(points, pressures, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        Target(points, pressures)


def test_foci_in_millimetres_are_asked_about():
    with pytest.raises(
        InvalidInput, match=r"focus 1 at \(0.00, 5500.00, 0.00\) mm is 5.5 m from .* 2 m: is this in mill"
    ):
        Target(np.array([[0.0, 0.0, 1.0], [0.0, 5.5, 0.0]]))


def test_printing_a_target_is_short():
    assert repr(Target(POINTS, 3.0)) == "Target(points=[[0.0, 0.0, 0.0], [0.0, 0.0, 0.01]], pressures=[3.0, 3.0])"
