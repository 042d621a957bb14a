import math

import numpy as np
import pytest

from airtact.conventions import InvalidInput
from airtact.scene.guards import fixed, place, points_of, positive, refuse_not_finite


@pytest.mark.parametrize("value", [0.0, -2.5, math.nan, math.inf, -math.inf])
def test_positive_refuses_with_the_name_the_number_and_the_unit(value):
    with pytest.raises(InvalidInput, match=f"the gap is {value:g} m,"):
        positive(value, "the gap", "m")


def test_positive_gives_the_number_back():
    assert positive(np.float64(0.25), "the gap", "m") == 0.25


def test_fixed_copies_and_locks():
    given = np.arange(3)
    kept = fixed(given)
    given[0] = 7
    assert kept.tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        kept[0] = 1.0


@pytest.mark.parametrize("shape", [(3,), (4, 2), (2, 3, 1)])
def test_points_need_three_columns(shape):
    with pytest.raises(InvalidInput, match=r"foci have shape \(" + str(shape[0])):
        points_of(np.ones(shape), "foci")


def test_points_are_not_empty():
    with pytest.raises(InvalidInput, match=r"foci are empty \(0 points\)"):
        points_of(np.zeros((0, 3)), "foci")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_not_finite_values_are_counted_and_placed(value):
    points = np.zeros((5, 3))
    points[3, 1] = points[4, 2] = value
    with pytest.raises(InvalidInput, match=r"foci hold 2 NaN or infinite values, the first at index \[3, 1\]"):
        points_of(points, "foci")


def test_not_finite_complex_values_are_seen():
    with pytest.raises(InvalidInput, match=r"strengths hold 1 NaN or infinite values, the first at index \[1\]"):
        refuse_not_finite(np.array([1.0, 1j * np.inf]), "strengths")


def test_places_are_said_in_millimetres():
    assert place(np.array([0.0123, -0.5, 0.0])) == "(12.30, -500.00, 0.00) mm"
