"""Simulated echoes: as much noise and direct sound as was asked for, dead receivers, and what is rejected."""

import numpy as np
import pytest

import airtact as at
from airtact.sensing.simulation import direct_sound
from faults import raises_code
from sensing.sensed_scenes import AIR, BOX, CODES, TRUE, capsules, relative, solved


def echoes(**spoilt) -> at.Echoes:
    return at.simulate_echoes(solved(), capsules(), BOX.seen_from(TRUE), CODES, **spoilt)


def test_noise_is_as_strong_as_was_asked_for() -> None:
    pure = echoes()
    noisy = echoes(noise=20.0, seed=5)
    assert relative(noisy.pressures, pure.pressures) == pytest.approx(0.1, rel=0.03)
    assert noisy.noise == pytest.approx(0.1 * np.sqrt(np.mean(np.abs(pure.pressures) ** 2)))
    assert np.array_equal(noisy.pressures, echoes(noise=20.0, seed=5).pressures)
    assert not np.array_equal(noisy.pressures, echoes(noise=20.0, seed=6).pressures)


def test_direct_sound_is_left_as_much_as_was_asked_for() -> None:
    rest = echoes(subtraction=40.0).pressures - echoes().pressures
    distance = np.linalg.norm(BOX.positions[:, None] - BOX.positions, axis=2)
    np.fill_diagonal(distance, np.inf)
    expected = 0.01 * BOX.element.sensitivity * np.sqrt(np.sum(distance**-2.0, axis=1))
    assert np.sqrt(np.mean(np.abs(rest) ** 2)) == pytest.approx(
        np.sqrt(np.mean(expected**2)), rel=0.03
    )


def test_no_direct_sound_arrives_from_behind() -> None:
    back = at.autd3_board().moved(at.Pose.turn((1, 0, 0), np.pi, (0, 0, -0.1)))
    pair = at.transducers.join([at.autd3_board(), back])
    alone = direct_sound(at.autd3_board(), AIR.wavenumber(40e3), np.ones((249, 1), dtype=complex))
    both = direct_sound(pair, AIR.wavenumber(40e3), np.ones((498, 1), dtype=complex))
    assert np.allclose(both[:249], alone, rtol=1e-12)


def test_dead_receivers_get_nothing_and_some_may_receive() -> None:
    some = echoes(receivers=np.array([7, 3]), dead=np.array([3]))
    assert some.receiving.tolist() == [7, 3]
    assert np.array_equal(some.pressures[0], echoes().pressures[7])
    assert not some.pressures[1].any()


def test_reciprocity_holds_and_a_gain_counts_in_both_directions() -> None:
    gains = np.ones(996, dtype=complex)
    gains[4] = 0.5j
    single = np.zeros((996, 2))
    single[4, 0] = single[9, 1] = 1
    found = at.simulate_echoes(
        solved(), capsules(), BOX.calibrated(gains).seen_from(TRUE), single
    ).pressures
    plain = at.simulate_echoes(solved(), capsules(), BOX.seen_from(TRUE), single).pressures
    assert found[9, 0] == pytest.approx(found[4, 1]) == pytest.approx(0.5j * plain[9, 0])
    assert found[4, 0] == pytest.approx(-0.25 * plain[4, 0])


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
    for wrong in ({"noise": 1e4}, {"seed": -1}, {"dead": np.array([996])}):
        with raises_code("out_of_range"):
            echoes(**wrong)


def test_an_element_that_rings_does_not_receive() -> None:
    parts = np.repeat(np.arange(4), 249)
    codes = at.sensing.random_codes(996, 8, seed=2, parts=parts)
    assert np.array_equal((codes[:, 1] != 0), parts == 1)
    given = at.simulate_echoes(solved(), capsules(), BOX.seen_from(TRUE), codes, ring_down=1e-3)
    assert np.array_equal(given.valid, codes == 0)
    assert not given.pressures[~given.valid].any()
    # 0.3 ms are 103 mm there and back: farther elements have rung down when the first echo comes
    later = at.simulate_echoes(solved(), capsules(), BOX.seen_from(TRUE), codes, ring_down=3e-4)
    corners = np.concatenate([one.surface.corners.reshape(-1, 3) for one in capsules().obstacles])
    away = np.linalg.norm(BOX.seen_from(TRUE).positions[:, None] - corners, axis=2)
    for transmission in (0, 3):
        emits = codes[:, transmission] != 0
        for element in np.flatnonzero(emits)[::40]:
            first = (away[element] + away[emits].min(axis=0)).min()
            assert later.valid[element, transmission] == (first >= 3e-4 * AIR.sound_speed)
    assert codes.size > later.valid.sum() > given.valid.sum()
    with raises_code("link_failed"):
        echoes(ring_down=1e-3)
    with raises_code("out_of_range"):
        echoes(ring_down=-1.0)
    with raises_code("sizes_differ"):
        at.sensing.random_codes(996, 8, parts=parts[:3])
