"""The default is as good as any method, exact where that is possible, and its peak the least there is."""

import numpy as np
import pytest
from jaxtyping import Complex128
from scipy.optimize import linprog

import airtact as at
from airtact.drives.methods import METHODS, method_for
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


def least_peak_by_linear_programming(
    transfer: at.TransferMatrix, expected: Complex128[np.ndarray, "foci"], sides: int = 64
) -> float:
    """Bound the least peak of H d = w from below: amplitudes in a polygon around the disc, by scipy."""
    matrix = np.asarray(transfer.matrix)
    foci, elements = matrix.shape
    turns = np.exp(-2j * np.pi * np.arange(sides) / sides)
    # Unknowns: real and imaginary parts of d, and the peak; Re(d e^{-iα}) is at most the peak for
    # every side.
    limits = np.zeros((sides * elements, 2 * elements + 1))
    for side, turn in enumerate(turns):
        rows = np.arange(elements) + side * elements
        limits[rows, np.arange(elements)] = turn.real
        limits[rows, elements + np.arange(elements)] = -turn.imag
        limits[rows, -1] = -1.0
    equal = np.zeros((2 * foci, 2 * elements + 1))
    real, imaginary = np.real(matrix), np.imag(matrix)
    equal[:, : 2 * elements] = np.block([[real, -imaginary], [imaginary, real]])
    computed = linprog(
        np.r_[np.zeros(2 * elements), 1.0],
        A_ub=limits,
        b_ub=np.zeros(len(limits)),
        A_eq=equal,
        b_eq=np.r_[np.real(expected), np.imag(expected)],
        bounds=[(None, None)] * (2 * elements + 1),
    )
    assert computed.success
    return float(computed.x[-1])


@pytest.mark.parametrize(("seed", "foci"), [(1, 2), (2, 3), (3, 6), (4, 10)])
def test_no_other_method_gives_the_weakest_focus_more(seed, foci) -> None:
    transfer, target = in_open_air(scattered(seed, foci))
    others = {
        name: worst(transfer, method(transfer, target))
        for name, method in METHODS.items()
        if name != "best"
    }
    computed = worst(transfer, at.best(transfer, target))
    # gradient starts where max_min ends and may gain a little in much more time
    assert computed >= 0.99 * max(others.values())
    assert computed > 1.3 * others["time_reversal"]
    rounded = at.quantise(at.best(transfer, target)).drive()
    assert at.upper_bound(transfer, target).reached(transfer, target, rounded) > 0.9


def test_pressures_are_exactly_what_is_asked_where_full_scale_is_enough() -> None:
    points, asked = scattered(5, 4), np.array([4000.0, 1000.0, 2500.0, 500.0])
    transfer, target = in_open_air(points, asked)
    drive = at.best(transfer, target)
    np.testing.assert_allclose(np.abs(transfer.pressure(drive)), asked, rtol=1e-9)
    phases = np.exp(1j * np.angle(transfer.pressure(drive)))
    least = np.linalg.pinv(transfer.matrix) @ (asked * phases)
    np.testing.assert_allclose(drive.amplitudes, least, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_peak_is_the_least_by_linear_programming(seed) -> None:
    transfer = random_matrix(seed, 3, elements=20)
    expected = np.array([200.0, 80.0j, -150.0])
    drive = at.drives.least_peak(transfer, at.Target(any_points(3), expected), iterations=300)
    np.testing.assert_allclose(transfer.pressure(drive), expected, rtol=1e-9)
    peak, bound = (
        np.abs(drive.amplitudes).max(),
        least_peak_by_linear_programming(transfer, expected),
    )
    # a polygon of 64 sides reaches 0.12 % beyond the disc
    assert bound <= peak <= 1.01 * bound


def test_phases_asked_are_exact_and_stronger_than_by_least_squares() -> None:
    points = scattered(7, 3)
    transfer, shares = open_air(points), np.exp(1j * np.array([0.0, 2.0, 4.0]))
    target = at.Target(points, shares=shares)
    pressure = transfer.pressure(at.best(transfer, target))
    np.testing.assert_allclose(pressure / pressure[0], shares, rtol=1e-9)
    inverse = transfer.pressure(at.drives.inverse_filter(transfer, target))
    assert np.abs(pressure).min() > 1.3 * np.abs(inverse).min()


def test_what_is_asked_chooses_the_method() -> None:
    one, two, suppressed = any_points(1), any_points(2), 0.1 + any_points(4)
    phases = np.array([1.0, 1j])
    chosen = {
        "phase_conjugate": at.Target(one, 100.0),
        "max_min": at.Target(two),
        "least_peak": at.Target(two, shares=phases),
        "gradient": at.Target(two, suppression_points=suppressed),
        "inverse_filter": at.Target(two, shares=phases, suppression_points=suppressed),
    }
    assert {name: method_for(target) for name, target in chosen.items()} == {
        name: name for name in chosen
    }
    assert method_for(at.Target(two, np.array([100.0, 0.0]))) == "phase_conjugate"


@pytest.mark.usefixtures("as_outside_the_tests")
def test_arguments_in_the_wrong_order_are_rejected() -> None:
    with raises_code("wrong_kind"):
        at.best(
            at.Target(np.array([[0.0, 0.0, 0.1]])),
            at.TransferMatrix(np.ones((1, 4), dtype=complex), 0.0),
        )  # pyright: ignore


def test_what_is_asked_may_be_too_much_for_few_elements() -> None:
    transfer, target = at_random(8, 2, np.array([1e5, 1e5j]), elements=3)
    drive = at.best(transfer, target)
    assert isinstance(drive, at.Drive)
    pressure = transfer.pressure(drive)
    assert pressure[1] / pressure[0] == pytest.approx(1j, rel=1e-9)
    assert np.abs(drive.amplitudes).max() == pytest.approx(1.0)


# --- foci that fade -------------------------------------------------------------------------------


FADING = np.array([[0.0, 0, 0], [0.015, 0, 0], [0, 0.02, 0]])


@pytest.mark.parametrize("faded", [1.0, 0.5, 0.1, 0.05, 0.01, 1e-3, 0.0])
def test_shares_from_0_to_1_are_met(faded):
    shares = np.array([1.0, faded, faded])
    transfer, target = in_open_air(FADING, shares=shares)
    pressures = np.abs(transfer.pressure(at.best(transfer, target)))
    np.testing.assert_allclose(pressures / pressures.max(), shares, atol=0.02)
    # fading foci cost the strong one nothing
    alike = at.Target(FADING)
    assert pressures[0] >= worst(transfer, at.best(transfer, alike)) * 0.99


@pytest.mark.parametrize("name", at.drives.METHODS)
@pytest.mark.parametrize("asked", [{"shares": 1.0}, {"pressures": 2000.0}])
def test_a_fading_focus_is_no_shadowed_one(name, asked):
    (kind, strongest) = next(iter(asked.items()))
    transfer, target = in_open_air(FADING, **{kind: strongest * np.array([1.0, 0.04, 1e-3])})
    pressures = np.abs(transfer.pressure(at.drives.METHODS[name](transfer, target)))
    assert pressures.argmax() == 0


def test_pressures_of_zero_are_silent_foci():
    transfer, target = in_open_air(FADING, np.array([2000.0, 0.0, 80.0]))
    pressures = np.abs(transfer.pressure(at.best(transfer, target)))
    np.testing.assert_allclose(pressures, [2000.0, 0.0, 80.0], atol=1e-6)


def test_exact_shares_stay_within_full_scale() -> None:
    rng = np.random.default_rng(30)  # rounding exceeded full scale here
    matrix = rng.normal(size=(2, 4)) + 1j * rng.normal(size=(2, 4))
    transfer = at.TransferMatrix(matrix, 0.0)
    target = at.Target(0.1 * np.eye(3)[:2], shares=np.array([1.0, 0.5]))
    drive = at.best(transfer, target)
    strong, weak = np.abs(transfer.pressure(drive))
    assert drive.peak < 1.0 + 1e-12
    assert weak == pytest.approx(0.5 * strong)
