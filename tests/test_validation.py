import math
import re

import numpy as np
import pytest

from airtact.conventions import InvalidInput
from airtact.scene.medium import Medium
from airtact.validation import check_finite, check_frequency, fixed, in_mm, number, of_kind, points_of, positive


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
    with pytest.raises(InvalidInput, match=r"strengths hold 1 NaN or infinite value, the first at index \[1\]"):
        check_finite(np.array([1.0, 1j * np.inf]), "strengths")


def test_places_are_said_in_millimetres():
    assert in_mm(np.array([0.0123, -0.5, 0.0])) == "(12.30, -500.00, 0.00) mm"


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("40e3", "'40e3'"),
        (None, "a NoneType"),
        (4e4 + 1j, r"\(40000\+1j\)"),
        (np.array([4e4]), r"an array of shape \(1,\)"),
        ([4e4, 5e4], "a list of length 2"),
        (True, "True"),
    ],
)
def test_what_is_no_number_is_refused(value, said):
    with pytest.raises(InvalidInput, match=f"^frequency is {said}, but it must be one real number, in Hz.$"):
        number(value, "frequency", "Hz")


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize("value", [40000, 40e3, np.int64(40000), np.float32(4e4), np.array(4e4)])
def test_every_kind_of_number_is_one(value):
    assert number(value, "frequency", "Hz") == 40e3


@pytest.mark.parametrize("value", [40.0, 999.0, 1.1e6, 0.04])
def test_a_frequency_in_another_unit_is_asked_about(value):
    with pytest.raises(InvalidInput, match=r"frequency is .* Hz, .* 1000 and 1e\+06 Hz: is it in kHz\?"):
        check_frequency(value)


@pytest.mark.parametrize("value", [1e3, 40000, 1e6])
def test_the_range_of_frequencies_has_its_ends(value):
    assert check_frequency(value) == value


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        ([[0.0, 0.0], [0.0, 0.0, 1.0]], "points are a list of length 2 whose rows differ in length"),
        ([[0j, 0.0, 1.0]], r"points are a list of length 1 of type complex128 and shape \(1, 3\)"),
        ([["a", "b", "c"]], r"points are a list of length 1 of type <U1 and shape \(1, 3\)"),
        (None, r"points are a NoneType of type object and shape \(\)"),
        (0.0, r"points have shape \(\)"),
    ],
)
def test_points_are_real_numbers(points, sentence):
    with pytest.raises(InvalidInput, match=f"^{sentence}"):
        points_of(points, "points")


def test_no_points_pass_where_none_are_needed():
    assert points_of(np.zeros((0, 3)), "points", least=0).shape == (0, 3)


@pytest.mark.parametrize(
    ("value", "kind", "sentence"),
    [
        (3.0, Medium, "the medium is 3.0, but it must be a Medium: give air()."),
        (Medium, Medium, "the medium is the class Medium, but it must be a Medium: give air()."),
        (np.zeros(3), Medium, "the medium is an array of shape (3,), but it must be a Medium: give air()."),
        ([1, 2], dict, "the medium is a list of length 2, but it must be a dict: give air()."),
    ],
)
def test_another_kind_is_refused_with_what_to_give(value, kind, sentence):
    with pytest.raises(InvalidInput, match=f"^{re.escape(sentence)}$"):
        of_kind(value, kind, "the medium", "air()")


def test_one_value_is_said_in_the_singular():
    with pytest.raises(InvalidInput, match="points hold 1 NaN or infinite value, the first"):
        check_finite(np.array([np.nan, 0.0]), "points")
