"""The levels that a board can emit."""

import numpy as np
import pytest

import airtact as at
from airtact.transducers import Levels
from faults import raises_code


@pytest.mark.parametrize(
    ("amplitudes", "phases"), [(2, 2), (2, 256), (3, 16), (64, 32), (255, 7), (256, 256)]
)
def test_any_number_of_levels_rounds_to_the_nearest(amplitudes: int, phases: int) -> None:
    random = np.random.default_rng(1)
    drive = at.Drive(
        random.uniform(0.01, 1.0, 3000) * np.exp(2j * np.pi * random.uniform(size=3000))
    )
    levels = Levels.even(amplitudes, phases)
    frame = at.quantise(drive, levels)
    emitted = frame.drive().amplitudes
    assert frame.amplitude.max() == amplitudes - 1
    assert frame.phase.max() == phases - 1
    if amplitudes > 2:
        assert (
            np.abs(np.abs(emitted) - np.abs(drive.amplitudes)).max()
            <= 0.5 / (amplitudes - 1) + 1e-12
        )
    on = np.abs(emitted) > 0
    turns = np.angle(emitted[on] / drive.amplitudes[on]) / (2 * np.pi)
    assert np.abs(turns).max() <= 0.5 / phases + 1e-12
    assert at.quantise(frame.drive(), levels).same_as(frame)


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: Levels.even(1, 16), "out_of_range"),
        (lambda: Levels.even(257, 16), "out_of_range"),
        (lambda: Levels.even(16, 1), "out_of_range"),
        (lambda: Levels.even(16.5, 16), "out_of_range"),
        (lambda: Levels(np.zeros(1), 16), "out_of_range"),
        (lambda: Levels(np.array([0.0, 0.5, 0.9]), 16), "out_of_range"),
        (lambda: Levels(np.array([0.0, 0.5, 0.5, 1.0]), 16), "out_of_range"),
    ],
)
def test_levels_that_cannot_be_are_rejected(make, code) -> None:
    with raises_code(code):
        make()
