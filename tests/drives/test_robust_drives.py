"""Drives over samples: laws on random matrices, and what they keep of the pressure of hands that were not in them."""

from functools import cache

import numpy as np
import pytest

import airtact as at
from closed_form_transfers import any_points, at_random, random_matrix
from faults import raises_code

TARGET = at.Target(any_points(2))
GOALS = ("lowest tenth", "mean", "worst")
LIMITS = ("energy", "phases")


def random_ensemble(
    seed: int, foci: int = 2, samples: int = 24, spread: float = 0.7
) -> at.drives.TransferEnsemble:
    """Matrices around a nominal one, with phases that differ by a normal error of ``spread`` [rad]."""
    nominal = random_matrix(seed, foci).matrix
    errors = np.random.default_rng(seed).normal(size=(samples, *nominal.shape))
    # Errors of neighbouring elements go together, as those of a hand that is off do.
    smooth = np.cumsum(errors, axis=2) / np.sqrt(nominal.shape[1] / 2)
    return at.drives.TransferEnsemble(
        matrix=nominal, estimated_error=0.0, geometry=nominal * np.exp(1j * spread * smooth)
    )


@cache
def pinched(seed: int) -> at.drives.TransferEnsemble:
    """Two foci in open air before two boards, the hand off by 2 mm and 3 degrees."""
    points = np.array([[-6e-3, 0.0, 0.0], [6e-3, 0.0, 0.0]])
    beacons = at.FreeField().radiate(
        at.Scene(at.air(), [], frequency=40e3), at.Target(points).beacons()
    )
    array = at.flat_boards(1, 2).facing((0, 0, 0), (0, 0, 1), 0.15)
    return at.ensemble(
        beacons, array, at.Uncertainty(position=2e-3, rotation=3.0), samples=64, seed=seed
    )


def at_equal_energy(
    samples: at.drives.TransferEnsemble, target: at.Target, drive: at.Drive, goal="lowest tenth"
) -> float:
    return at.drives.goal_value(samples, target, drive, goal) / float(
        np.linalg.norm(drive.amplitudes)
    )


@pytest.mark.parametrize("goal", GOALS)
def test_no_goal_falls_below_that_of_the_nominal_drive(goal) -> None:
    for seed in range(3):
        samples = random_ensemble(seed)
        reached = at_equal_energy(samples, TARGET, at.robust(samples, TARGET, goal), goal)
        assert reached >= 0.999 * at_equal_energy(
            samples, TARGET, at.time_reversal(samples, TARGET), goal
        )


def test_hands_that_were_not_sampled_keep_more() -> None:
    target = at.Target(pinched(0).foci)
    others = pinched(1)
    robust, usual = (method(pinched(0), target) for method in (at.robust, at.time_reversal))
    assert at_equal_energy(others, target, robust) > 1.15 * at_equal_energy(others, target, usual)


@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize("foci", [1, 2, 3])
def test_nothing_in_doubt_gives_the_method_that_it_generalises(limit, foci) -> None:
    transfer, target = at_random(7, foci)
    alike = at.drives.TransferEnsemble(
        matrix=transfer.matrix, estimated_error=0.0, geometry=np.stack([transfer.matrix] * 8)
    )
    computed = at.robust(alike, target, limit=limit)
    usual = at.robust(transfer, target, limit=limit)
    if foci == 1:
        usual = (at.time_reversal if limit == "energy" else at.drives.phase_conjugate)(
            transfer, target
        )
    elif limit == "phases":
        usual = at.max_min(transfer, target)
    one, other = (
        np.abs(transfer.pressure(drive)) / np.linalg.norm(drive.amplitudes)
        for drive in (computed, usual)
    )
    np.testing.assert_allclose(one, other, rtol=1e-6 if limit == "energy" or foci == 1 else 0.01)


@pytest.mark.parametrize("goal", GOALS)
def test_limits_hold(goal) -> None:
    samples = random_ensemble(5)
    phases = at.robust(samples, TARGET, goal, limit="phases")
    np.testing.assert_allclose(np.abs(phases.amplitudes), 1.0, rtol=1e-9)
    at_energy = at.robust(samples, TARGET, goal)
    reached = [at.drives.goal_value(samples, TARGET, one, goal) for one in (phases, at_energy)]
    assert reached[0] > reached[1]
    np.testing.assert_array_equal(
        at.drives.robust_phase_only(samples, TARGET, goal).amplitudes, phases.amplitudes
    )


def test_asked_pressures_are_reached_nine_of_ten_times() -> None:
    samples = random_ensemble(8)
    full = at.drives.goal_value(samples, TARGET, at.robust(samples, TARGET))
    asked = at.Target(TARGET.points, pressures=0.5 * full)
    drive = at.robust(samples, asked)
    assert at.drives.goal_value(samples, asked, drive) == pytest.approx(1.0, rel=1e-6)


def test_other_foci_raise() -> None:
    samples = random_ensemble(9)
    with raises_code("sizes_differ"):
        at.robust(samples, at.Target(any_points(3)))
