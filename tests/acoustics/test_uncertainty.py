"""What is in doubt: numbers that make no sense raise, with what was probably meant."""

import dataclasses

import numpy as np
import pytest

import airtact as at
from faults import raises_code

DEVIATIONS = [
    field.name for field in dataclasses.fields(at.Uncertainty) if field.name != "velocity"
]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in DEVIATIONS for value in (-0.2, np.nan)),
        # degrees that were meant in radians, and other units
        *((name, 0.035) for name in ("rotation", "own_rotation", "phase")),
        ("position", 2.0),
        ("age", 20.0),
        ("humidity", 5.0),
        ("dead", 10.0),
        ("temperature", 300.0),
        ("velocity", (500.0, 0.0, 0.0)),
    ],
)
def test_numbers_that_make_no_sense_raise(name, value) -> None:
    with raises_code("out_of_range"):
        at.Uncertainty(**{name: value})


def test_the_velocity_is_a_vector_of_a_hand() -> None:
    assert at.Uncertainty(age=0.01, velocity=np.array([0.5, 0.0, 0.0])).velocity == (0.5, 0.0, 0.0)
