import numpy as np
import pytest

from airtact.conventions import InvalidInput
from airtact.scene.sources import Monopoles


def test_one_sound_is_kept_as_a_column():
    monopoles = Monopoles(np.eye(3), np.array([1, 2, 3]))
    assert monopoles.strengths.dtype == np.complex128
    assert monopoles.strengths.tolist() == [[1], [2], [3]]


def test_several_sounds_from_the_same_points():
    assert Monopoles(np.zeros((2, 3)), np.ones((2, 5))).strengths.shape == (2, 5)


def test_arrays_are_copied_and_locked():
    strengths = np.ones((3, 1), dtype=complex)
    monopoles = Monopoles(np.eye(3), strengths)
    strengths[:] = 0
    assert monopoles.strengths.sum() == 3
    assert not monopoles.positions.flags.writeable
    assert not monopoles.strengths.flags.writeable


@pytest.mark.parametrize(
    ("positions", "strengths", "sentence"),
    [
        (np.zeros((0, 3)), np.zeros(0), "positions are empty"),
        (np.zeros((2, 2)), np.zeros(2), r"positions have shape \(2, 2\)"),
        (np.zeros((2, 3)), np.zeros(3), r"strengths have shape \(3, 1\), but there are 2 positions"),
        (np.zeros((2, 3)), np.zeros((2, 2, 2)), r"strengths have shape \(2, 2, 2\)"),
        (np.zeros((2, 3)), np.zeros((2, 0)), "hold 0 sounds"),
        (np.full((2, 3), np.nan), np.zeros(2), "positions hold 6 NaN"),
        (np.zeros((2, 3)), np.array([1, np.inf * 1j]), "strengths hold 1 NaN or infinite"),
    ],
)
@pytest.mark.usefixtures("as_outside_the_tests")
def test_faults_are_refused(positions, strengths, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        Monopoles(positions, strengths)
