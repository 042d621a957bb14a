import numpy as np
import pytest

from airtact.acoustics.sources import Monopoles, check_off_sources
from faults import raises_code


def test_strengths_are_copied_locked_columns():
    strengths = np.array([1, 2, 3])
    monopoles = Monopoles(np.eye(3), strengths)
    strengths[:] = 0
    assert monopoles.strengths.dtype == np.complex128
    assert monopoles.strengths.tolist() == [[1], [2], [3]]
    assert not monopoles.positions.flags.writeable
    assert not monopoles.strengths.flags.writeable
    assert Monopoles(np.zeros((2, 3)), np.ones((2, 5))).strengths.shape == (2, 5)


@pytest.mark.parametrize(
    ("positions", "strengths", "code"),
    [
        (np.zeros((0, 3)), np.zeros(0), "empty"),
        (np.zeros((2, 2)), np.zeros(2), "wrong_shape"),
        (np.zeros((2, 3)), np.zeros(3), "wrong_shape"),
        (np.zeros((2, 3)), np.zeros((2, 2, 2)), "wrong_shape"),
        (np.zeros((2, 3)), np.zeros((2, 0)), "empty"),
        (np.full((2, 3), np.nan), np.zeros(2), "not_finite"),
        (np.zeros((2, 3)), np.array([1, np.inf * 1j]), "not_finite"),
        (np.zeros((1, 3)), ["abc"], "not_a_number"),
    ],
)
@pytest.mark.usefixtures("as_outside_the_tests")
def test_faults_are_rejected(positions, strengths, code):
    with raises_code(code):
        Monopoles(positions, strengths)


@pytest.mark.parametrize("step", [0.0, 5e-10])
def test_a_point_on_a_source_is_rejected(step):
    sources = Monopoles(np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.1]]), np.ones(2))
    points = np.array([[0.0, 0.0, 0.0], [0.2, step, 0.1]])
    with raises_code("misplaced"):
        check_off_sources(points, sources)
