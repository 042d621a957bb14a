"""Simulated echoes: as much noise as was asked for, and what is rejected."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code
from sensing.sensed_scenes import BOX, CODES, TRUE, capsules, relative, solved


def echoes(**spoilt) -> at.Echoes:
    return at.simulate_echoes(solved(), capsules(), BOX.seen_from(TRUE), CODES, **spoilt)


def test_noise_is_as_strong_as_was_asked_for() -> None:
    pure = echoes()
    noisy = echoes(noise=20.0, seed=5)
    assert relative(noisy.pressures, pure.pressures) == pytest.approx(0.1, rel=0.03)
    assert noisy.noise == pytest.approx(0.1 * np.sqrt(np.mean(np.abs(pure.pressures) ** 2)))
    assert np.array_equal(noisy.pressures, echoes(noise=20.0, seed=5).pressures)
    assert not np.array_equal(noisy.pressures, echoes(noise=20.0, seed=6).pressures)


def test_some_may_receive() -> None:
    some = echoes(receivers=np.array([7, 3]))
    assert some.receiving.tolist() == [7, 3]
    assert np.allclose(some.pressures, echoes().pressures[[7, 3]], rtol=1e-5)


def test_reciprocity_holds_and_a_gain_counts_in_both_directions() -> None:
    gains = np.ones(996, dtype=complex)
    gains[4] = 0.5j
    single = np.zeros((996, 2))
    single[4, 0] = single[9, 1] = 1
    found = at.simulate_echoes(
        solved(), capsules(), BOX.calibrated(gains).seen_from(TRUE), single
    ).pressures
    plain = at.simulate_echoes(solved(), capsules(), BOX.seen_from(TRUE), single).pressures
    assert found[9, 0] == pytest.approx(found[4, 1], rel=1e-5)
    assert found[9, 0] == pytest.approx(0.5j * plain[9, 0], rel=1e-5)
    assert found[4, 0] == pytest.approx(-0.25 * plain[4, 0], rel=1e-5)


def test_what_cannot_be_simulated_is_rejected() -> None:
    with raises_code("sizes_differ"):
        at.simulate_echoes(
            solved(), capsules(), at.autd3_board(at.Pose(np.eye(3), np.array([0, 0, -0.1]))), CODES
        )
    with raises_code("does_not_match"):
        at.simulate_echoes(solved(), capsules(0.014), BOX, CODES)
    with raises_code("bodies_overlap"):
        near = at.Pose(np.eye(3), np.array([0.054, 0, 0]))
        at.simulate_echoes(solved(), capsules(), BOX.seen_from(near), CODES)
    for wrong in ({"noise": 1e4}, {"seed": -1}):
        with raises_code("out_of_range"):
            echoes(**wrong)
