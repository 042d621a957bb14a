"""What comparisons hold equal: energy and peak of a drive."""

import numpy as np
import pytest

import airtact as at

WEAK = at.Drive(np.array([0.3, 0.4j, 0.0]))
FLAT = at.Drive(np.full(3, 0.99 + 0j))


def test_energy_and_peak_are_those_of_the_amplitudes() -> None:
    assert (WEAK.peak, WEAK.energy) == (pytest.approx(0.4), pytest.approx(0.25))
    assert not WEAK.is_full_scale
    assert FLAT.is_full_scale


@pytest.mark.parametrize("quantity", ["energy", "peak"])
def test_the_factor_makes_energy_or_peak_equal(quantity) -> None:
    scaled = at.Drive(FLAT.amplitudes * FLAT.factor_to_match(WEAK, quantity))
    assert getattr(scaled, quantity) == pytest.approx(getattr(WEAK, quantity))
