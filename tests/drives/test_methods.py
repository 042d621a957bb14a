"""Laws of every method, on random matrices and in closed form."""

import numpy as np
import pytest

import airtact as at
from closed_form_transfers import (
    WAVELENGTH,
    any_points,
    at_random,
    in_open_air,
    open_air,
    random_matrix,
    scattered,
    worst,
)
from faults import raises_code

AT_FULL_SCALE = (at.weighted_gerchberg_saxton, at.drives.gs_pat, at.max_min)


# --- laws of all methods --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", at.drives.METHODS)
def test_one_focus_with_every_method(name):
    transfer, target = at_random(1, 1)
    drive = at.drives.METHODS[name](transfer, target)
    row = transfer.matrix[0]
    # for one focus a method may only choose amplitudes; the phases are those of the conjugate
    np.testing.assert_allclose(
        np.angle(drive.amplitudes * row * np.vdot(drive.amplitudes, row.conj())), 0.0, atol=1e-5
    )
    pressure = worst(transfer, drive)
    assert np.abs(drive.amplitudes).max() == pytest.approx(1.0)
    if name in ("time_reversal", "inverse_filter", "robust"):
        energy = np.linalg.norm(drive.amplitudes)
        assert pressure == pytest.approx(energy * np.linalg.norm(row), rel=1e-6)
    else:
        assert pressure == pytest.approx(np.abs(row).sum(), rel=1e-6)


@pytest.mark.parametrize("name", at.drives.METHODS)
def test_the_worst_focus_gets_what_it_asked_where_that_is_possible(name):
    transfer, target = at_random(2, 4, np.array([100.0, 200.0, 150.0, 300.0]))
    drive = at.drives.METHODS[name](transfer, target)
    assert at.drives.achieved_fraction(transfer, target, drive).min() == pytest.approx(
        1.0, rel=1e-9
    )
    greedy = at.Target(any_points(4), 1e6)
    drive = at.drives.METHODS[name](transfer, greedy)
    assert np.abs(drive.amplitudes).max() == pytest.approx(1.0)
    assert at.drives.achieved_fraction(transfer, greedy, drive).min() < 0.1


@pytest.mark.parametrize("name", at.drives.METHODS)
def test_a_focus_that_asks_for_nothing_does_not_hold_the_others_back(name):
    transfer = random_matrix(5, 3)
    target = at.Target(any_points(3), np.array([300.0, 0.0, 200.0]))
    assert np.nanmin(
        at.drives.achieved_fraction(transfer, target, at.drives.METHODS[name](transfer, target))
    ) == pytest.approx(1.0)


UNBALANCED = ("time_reversal", "phase_conjugate")


@pytest.mark.parametrize("name", at.drives.METHODS)
def test_methods_that_balance_keep_the_shares_and_the_others_follow_them(name):
    transfer, shares = random_matrix(6, 3), np.array([1.0, 0.5, 0.25])
    got, alike = (
        np.abs(
            transfer.pressure(
                at.drives.METHODS[name](transfer, at.Target(any_points(3), shares=one))
            )
        )
        for one in (shares, np.ones(3))
    )
    if name in UNBALANCED:  # in order, but off the shares
        assert got[0] > got[1] > got[2]
        assert np.abs(got / got[0] / shares - 1).max() > 0.1
    else:
        np.testing.assert_allclose(got / got[0], shares, rtol=0.03)
    assert got[2] / got[0] < 0.7 * alike[2] / alike[0]


@pytest.mark.parametrize("name", at.drives.METHODS)
def test_wrong_sizes_raise(name):
    with raises_code("sizes_differ"):
        at.drives.METHODS[name](random_matrix(7, 2), at.Target(any_points(3)))


# --- one by one -----------------------------------------------------------------------------------------------------


def test_the_inverse_filter_is_the_drive_of_least_energy_with_the_pressures_and_phases_asked():
    transfer = random_matrix(9, 3)
    asked = np.array([100.0, 50.0j, -70.0])
    drive = at.drives.inverse_filter(transfer, at.Target(any_points(3), asked), weight=0.0)
    np.testing.assert_allclose(
        drive.amplitudes, np.linalg.pinv(transfer.matrix) @ asked, rtol=1e-9, atol=1e-12
    )


def test_tikhonovs_weight_limits_a_nearly_singular_drive():
    transfer, target = in_open_air(
        np.array([[0.0, 0, 0], [0.001, 0, 0]]), shares=np.array([1.0, -1.0 + 0j])
    )
    wild, calm = (
        at.drives.inverse_filter(transfer, target, weight=weight) for weight in (0.0, 1e-2)
    )
    ratio = [
        np.linalg.norm(transfer.pressure(drive)) / np.linalg.norm(drive.amplitudes)
        for drive in (wild, calm)
    ]
    assert ratio[0] <= ratio[1] * (1 + 1e-9)
    with raises_code("out_of_range"):
        at.drives.inverse_filter(transfer, target, weight=-0.1)


def test_the_l_curve_weighs_little_where_nothing_is_singular_and_more_where_it_is():
    transfer, target = in_open_air(scattered(1, 5, least=2 * WAVELENGTH))
    np.testing.assert_allclose(
        np.abs(transfer.pressure(at.drives.inverse_filter(transfer, target))),
        np.abs(transfer.pressure(at.drives.inverse_filter(transfer, target, weight=0.0))),
        rtol=0.02,
    )


@pytest.mark.parametrize("method", AT_FULL_SCALE)
def test_gerchberg_saxton_and_its_variants_give_full_scale(method):
    drive = method(random_matrix(12, 5), at.Target(any_points(5)))
    np.testing.assert_allclose(np.abs(drive.amplitudes), 1.0, rtol=1e-9)


def test_weights_level_the_foci():
    transfer, target = in_open_air(scattered(2, 8))
    weighted = np.abs(
        transfer.pressure(at.weighted_gerchberg_saxton(transfer, target, iterations=200))
    )
    assert weighted.max() / weighted.min() < 1.01


# --- suppression points ------------------------------------------------------------------------------------------


HEEDING = [name for name, method in at.drives.METHODS.items() if method.heeds_suppression_points]


def test_each_method_has_a_name_and_a_description():
    assert HEEDING == ["best", "inverse_filter", "gradient"]
    assert len(at.drives.METHODS) == len(
        {method.description for method in at.drives.METHODS.values()}
    )
    assert all(
        method.name == name and method.description for name, method in at.drives.METHODS.items()
    )


@pytest.mark.parametrize("name", at.drives.METHODS)
def test_phases_asked_for_are_heeded_where_the_registry_has_it_so(name):
    transfer, phases = random_matrix(16, 2), np.exp(1j * np.array([0.0, 2.5]))
    plain, asked = (
        at.drives.METHODS[name](transfer, at.Target(any_points(2), shares=shares)).amplitudes
        for shares in (np.ones(2), phases)
    )
    if at.drives.METHODS[name].heeds_phases:
        pressure = transfer.matrix @ asked
        assert np.angle(pressure[1] / pressure[0]) == pytest.approx(2.5, abs=0.3)
    else:
        np.testing.assert_allclose(asked, plain, atol=1e-12)


@pytest.mark.parametrize("name", HEEDING)
def test_suppression_points_are_silenced(name):
    points, suppressed = scattered(6, 3), 0.004 + scattered(7, 12)
    target = at.Target(points, suppression_points=suppressed)
    transfer = open_air(np.concatenate([points, suppressed]))
    drive, reference = at.drives.METHODS[name](transfer, target), at.max_min(transfer, target)
    after, before = (np.abs(transfer.pressure(one)) for one in (drive, reference))
    fraction = (
        np.linalg.norm(after[3:])
        / after[:3].min()
        / (np.linalg.norm(before[3:]) / before[:3].min())
    )
    assert fraction < 10 ** (-10 / 20)
    if name in ("best", "gradient"):
        assert after[:3].min() > 0.898 * before[:3].min()
    with raises_code("data_missing"):
        at.drives.METHODS[name](open_air(points), target)


@pytest.mark.parametrize("name", sorted(set(at.drives.METHODS) - set(HEEDING)))
def test_other_methods_ignore_suppression_points(name):
    points = scattered(8, 3)
    whole = np.concatenate([points, 0.004 + scattered(9, 4)])
    given = at.drives.METHODS[name](
        open_air(whole), at.Target(points, suppression_points=whole[3:])
    )
    np.testing.assert_allclose(
        given.amplitudes,
        at.drives.METHODS[name](open_air(points), at.Target(points)).amplitudes,
        atol=1e-6,
    )


def test_a_loss_of_more_than_all_raises():
    with raises_code("out_of_range"):
        at.drives.gradient(random_matrix(15, 2), at.Target(any_points(2)), loss=1.5)
