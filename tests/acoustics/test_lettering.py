"""Writing as points: upright and to scale."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from airtact.acoustics.lettering import text
from faults import raises_code


def test_a_letter_is_upright_to_scale_and_in_the_middle():
    letter = text("A", height=0.02, spacing=1e-3, centre=(0.01, 0.0, 0.05))
    assert letter[:, 1].max() == pytest.approx(0.01)
    assert letter[:, 1].min() == pytest.approx(-0.01)
    np.testing.assert_allclose(letter[:, 2], 0.05)
    # The apex of an A is one point over its middle, its legs are far apart.
    top, bottom = letter[letter[:, 1] > 0.008], letter[letter[:, 1] < -0.0095]
    assert np.ptp(top[:, 0]) < 3e-3
    assert top[:, 0].mean() == pytest.approx(0.01, abs=1e-4)
    assert np.ptp(bottom[:, 0]) > 0.012


def test_letters_follow_each_other_to_the_right_of_who_reads_them():
    # Read from +x with z up, the right is +y; the L has its long stroke on its left.
    word = text("IL", height=0.02, spacing=1e-3, normal=(1.0, 0.0, 0.0), up=(0.0, 0.0, 1.0))
    np.testing.assert_allclose(word[:, 0], 0.0, atol=1e-15)
    assert word[word[:, 2] < -0.0099][:, 1].max() == word[:, 1].max()
    assert word[:, 1].min() == pytest.approx(-word[:, 1].max())
    assert np.sum(word[:, 2] > 0.0099) == 2


def test_strokes_that_meet_leave_no_double_points():
    letters = text("AIRE", height=0.03, spacing=3e-3)
    nearest = KDTree(letters).query(letters, k=2)[0][:, 1]
    assert nearest.min() > 0.6 * 3e-3 * (1 - 1e-6)
    assert nearest.max() <= 3e-3 * 1.0001


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: text("", 0.02, 2e-3), "empty"),
        (lambda: text("Grüße", 0.02, 2e-3), "unknown_name"),
        (lambda: text("A", -0.02, 2e-3), "out_of_range"),
        (lambda: text("A", 20.0, 2e-3), "too_many"),
    ],
)
def test_faults_are_rejected(make, code):
    with raises_code(code):
        make()
