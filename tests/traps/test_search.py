"""Positions of traps and verdicts, in a standing wave between the caps of TinyLev."""

import numpy as np
import pytest

import airtact as at

SCENE = at.Scene(at.Medium(sound_speed=343.1, density=1.2))
ARRAY = at.transducers.known_array("tinylev", at.piston(4.5e-3, sensitivity=3.4))
IN_PHASE = at.Drive(np.ones(72, dtype=np.complex128))


def judged(drive: at.Drive, point: tuple[float, float, float]) -> at.traps.Verdict:
    return at.traps.verdict(SCENE, ARRAY, drive, np.array([point]))[0]


def test_a_trap_is_found_and_holds_the_bead() -> None:
    # From a saddle of the potential, between two traps beside the axis
    places = at.traps.find(SCENE, ARRAY, IN_PHASE, np.array([[1e-3, 1.5e-3, -1e-3]]))
    np.testing.assert_allclose(places, [[0.0, 2.35e-3, 0.0]], atol=2e-5)
    verdict = judged(IN_PHASE, tuple(places[0]))
    assert verdict.is_trap
    assert np.abs(verdict.force).max() < 1e-9
    assert "stable along x, y and z" in str(verdict)
    # Along the axis the force is that of a standing wave: largest an eighth of a wavelength away.
    distances = np.linspace(0.1e-3, 2.1e-3, 50)
    line = places + distances[:, None] * np.eye(3)[0]
    pull = -at.traps.force(SCENE, ARRAY, IN_PHASE, line)[:, 0].min()
    weight = 4 / 3 * np.pi * 0.65e-3**3 * 29.36 * 9.80665
    assert verdict.holds == pytest.approx(pull / weight, rel=0.05)


def test_an_antinode_is_no_trap() -> None:
    verdict = judged(IN_PHASE, (0.0, 0.0, 0.0))
    assert verdict.balanced
    assert not verdict.stable
    assert "no trap" in str(verdict)
    assert "along y the stiffness is -0.06" in str(verdict)
    assert "pushes the bead away in all directions" in str(verdict)


def test_a_point_off_the_equilibrium_is_no_trap() -> None:
    verdict = judged(IN_PHASE, (0.0, 1.85e-3, 0.0))
    assert verdict.stable
    assert not verdict.is_trap
    # The shift is linear, so it is an estimate only.
    assert verdict.shift[1] == pytest.approx(0.5e-3, rel=0.4)


def test_a_weak_drive_does_not_hold_the_bead() -> None:
    verdict = judged(at.Drive(0.2 * IN_PHASE.amplitudes), (0.0, 2.353e-3, 0.0))
    assert verdict.stable
    assert verdict.balanced
    assert not verdict.is_trap
    assert "too weak for the bead" in str(verdict)
    assert verdict.holds == pytest.approx(0.2**2 * judged(IN_PHASE, (0, 2.353e-3, 0)).holds)


def test_a_single_element_has_no_trap() -> None:
    alone = at.PhasedArray(np.zeros((1, 3)), element=at.monopole())
    start = np.array([[0.0, 0.0, 0.05]])
    drive = at.Drive(np.ones(1, dtype=np.complex128))
    assert np.isnan(at.traps.find(SCENE, alone, drive, start)).all()
