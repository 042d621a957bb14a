"""The certified bound against closed forms, and the methods against it."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import airtact as at
from closed_form_transfers import (
    any_points,
    at_random,
    in_open_air,
    open_air,
    random_matrix,
    scattered,
    worst,
)
from faults import raises_code


def full_matrix_certificate(bound, transfer: at.TransferMatrix, target: at.Target) -> float:
    """Smallest eigenvalue of diag(y) − Σ μ h hᴴ, element by element, over the largest y: at least 0 where it holds."""
    rows = transfer.matrix / target.weights[:, None]
    inside = np.diag(bound.elements) - rows.conj().T @ (bound.multipliers[:, None] * rows)
    return float(np.linalg.eigvalsh(inside)[0] / bound.elements.max())


def test_for_one_focus_the_bound_is_the_sum_of_magnitudes():
    transfer, target = at_random(1, 1)
    bound = at.upper_bound(transfer, target)
    assert bound.worst == pytest.approx(np.abs(transfer.matrix).sum(), rel=1e-9)
    assert bound.reached(
        transfer, target, at.drives.phase_conjugate(transfer, target)
    ) == pytest.approx(1.0, rel=1e-9)


def test_foci_with_elements_of_their_own_have_bounds_of_their_own():
    """Focus 0 is reached by 3 elements and focus 1 by 5: the bound is the smaller sum over what is asked."""
    matrix = np.zeros((2, 8), dtype=complex)
    matrix[0, :3], matrix[1, 3:] = 2j, -1.0
    bound = at.upper_bound(
        at.TransferMatrix(matrix, 0.0),
        at.Target(any_points(2), np.array([3.0, 2.0])),
        tolerance=1e-6,
    )
    assert bound.worst == pytest.approx(min(6.0 / 3.0, 5.0 / 2.0), rel=1e-4)


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
@settings(max_examples=25, deadline=None)
def test_the_certificate_holds_element_by_element_and_no_drive_passes_it(
    seed: int, foci: int
) -> None:
    transfer = random_matrix(seed, foci, elements=20)
    target = at.Target(any_points(foci), np.linspace(1.0, 2.0, foci))
    bound = at.upper_bound(transfer, target)
    assert bound.eigenvalue(transfer, target) <= 1.0
    assert full_matrix_certificate(bound, transfer, target) >= -1e-9
    assert bound.multipliers.sum() == pytest.approx(1.0)
    assert bound.worst**2 == pytest.approx(bound.elements.sum())
    random = np.random.default_rng(seed)
    for _ in range(20):
        drive = at.Drive(
            random.uniform(0.0, 1.0, 20) * np.exp(2j * np.pi * random.uniform(size=20))
        )
        assert bound.reached(transfer, target, drive) <= 1.0
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", at.drives.Stalled
        )  # 20 elements for 6 foci may take more iterations than it has
        assert bound.reached(transfer, target, at.max_min(transfer, target)) <= 1.0


@pytest.mark.parametrize("foci", [2, 7, 16, 40])
def test_the_bound_is_within_its_tolerance_of_converged(foci):
    transfer, target = in_open_air(scattered(foci, foci))
    bound, tight = (
        at.upper_bound(transfer, target),
        at.upper_bound(transfer, target, tolerance=1e-6),
    )
    assert bound.relaxed <= tight.worst * (
        1 + 1e-12
    )  # the relaxation's own optimum is no more than any bound
    assert tight.worst <= bound.worst <= 1.001 * bound.relaxed
    with raises_code("out_of_range"):
        at.upper_bound(transfer, target, tolerance=0.0)


@pytest.mark.parametrize("seed", range(6))
def test_the_strongest_worst_focus_is_near_the_bound_and_beats_the_rest(seed):
    transfer, target = in_open_air(scattered(seed, 3 + 2 * seed))
    bound = at.upper_bound(transfer, target)
    reached = bound.reached(transfer, target, at.quantise(at.max_min(transfer, target)).drive())
    assert reached > 0.9
    for method in (
        at.time_reversal,
        at.drives.phase_conjugate,
        at.drives.inverse_filter,
        at.drives.gs_pat,
        at.weighted_gerchberg_saxton,
    ):
        assert bound.reached(transfer, target, method(transfer, target)) < reached + 5e-3


def test_two_foci_against_every_phase_between_them():
    """For two foci all good drives are phases of Hᴴ s; a fine grid of s finds the best one."""
    transfer, target = in_open_air(scattered(20, 2))
    turn, tilt = np.meshgrid(np.linspace(0, 2 * np.pi, 91), np.linspace(0.4, 0.6, 41))
    sources = np.stack([tilt.ravel(), (1 - tilt).ravel() * np.exp(1j * turn.ravel())])
    sent = transfer.matrix.conj().T @ sources
    best = np.abs(transfer.matrix @ (sent / np.abs(sent))).min(axis=0).max()
    assert worst(transfer, at.max_min(transfer, target)) > 0.999 * best
    assert best <= at.upper_bound(transfer, target).worst


# --- bad input ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "method",
    [at.upper_bound, at.max_min, at.drives.inverse_filter, at.drives.gs_pat],
)
def test_foci_that_cannot_be_separated_raise(method):
    points = np.array([[0.0, 0, 0], [0.01, 0, 0], [0.0101, 0.0005, 0], [0, 0, 0.02]])
    with raises_code("foci_unreachable") as raised:
        method(open_air(points), at.Target(points))
    np.testing.assert_allclose(raised.value.position, points[1])
    matrix = random_matrix(2, 3).matrix.copy()
    matrix[2] = 3j * matrix[0]
    with raises_code("foci_unreachable"):
        method(at.TransferMatrix(matrix, 0.0), at.Target(any_points(3)))
    with raises_code("too_many"):
        method(random_matrix(3, 5, elements=4), at.Target(any_points(5)))


def test_a_transfer_matrix_knows_how_near_is_too_near():
    points = np.array([[0.0, 0, 0], [0.0008, 0, 0]])
    for speed, taken in ((343.1, False), (300.0, True)):
        scene, target = at.Scene(at.Medium(speed, 1.293), []), at.Target(points)
        transfer = at.transfer_matrix(
            at.FreeField().radiate(scene, target.beacons()), at.surrounding_box()
        )
        assert transfer.wavelength == pytest.approx(speed / 40e3)
        if taken:
            at.upper_bound(transfer, target)
            continue
        with raises_code("foci_unreachable"):
            at.upper_bound(transfer, target)


def test_a_shadowed_focus_raises_with_its_pressure_and_that_of_the_others():
    matrix = random_matrix(4, 4).matrix.copy()
    matrix[2] *= 0.01
    with raises_code("foci_unreachable"):
        at.max_min(at.TransferMatrix(matrix, 0.0), at.Target(any_points(4)))
    modest = at.Target(any_points(4), shares=np.array([1.0, 1.0, 0.01, 1.0]))
    at.max_min(at.TransferMatrix(matrix, 0.0), modest)


# --- stalling -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("method", "foci"), [(at.max_min, 60), (at.drives.gradient, 14)])
def test_a_method_that_stalls_warns_and_returns_its_best(method, foci):
    transfer, target = in_open_air(scattered(6, foci))
    with pytest.warns(at.drives.Stalled) as warned:
        drive = method(transfer, target, iterations=1)
    warning = warned[0].message
    assert isinstance(warning, at.drives.Stalled)
    assert f"{warning.reached:.1%} of the certified bound" in str(warning)
    assert ("use gradient" in str(warning)) == (method is at.max_min)
    # against the bound that was computed to 1 %
    assert warning.reached == pytest.approx(
        at.upper_bound(transfer, target).reached(transfer, target, drive), rel=0.011
    )
    assert warning.reached > 0.5


@pytest.mark.parametrize(
    "method",
    [
        at.weighted_gerchberg_saxton,
        at.drives.gs_pat,
        at.max_min,
        at.drives.gradient,
    ],
)
def test_no_iteration_raises(method):
    with raises_code("too_few"):
        method(random_matrix(5, 2), at.Target(any_points(2)), iterations=0)


def test_the_gradient_improves_where_iterations_do_not_converge():
    """A drawing of 60 points 4 mm apart: more than alternating projections can level."""
    across, up = np.meshgrid(np.arange(10), np.arange(6))
    points = 4e-3 * np.column_stack([across.ravel() - 4.5, up.ravel() - 2.5, np.zeros(60)])
    transfer, target = in_open_air(points)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", at.drives.Stalled)
        projected = worst(transfer, at.max_min(transfer, target))
    assert worst(transfer, at.drives.gradient(transfer, target)) > 1.01 * projected
