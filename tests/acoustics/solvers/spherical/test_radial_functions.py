"""Radial quotients against scipy's functions and identities, Legendre sums against plain summation."""

from itertools import islice

import numpy as np
import pytest
from numpy.polynomial.legendre import legval
from scipy.special import eval_legendre, j0, spherical_jn, spherical_yn

from airtact.acoustics.solvers.spherical.radial_functions import (
    image_sums,
    legendre_polynomials,
    outgoing_derivatives,
    outgoing_ratios,
    regular_derivatives,
    regular_quotients,
    regular_ratios,
)

ARGUMENTS = [0.1 + 0j, 1.0 + 0j, 4.3 + 0j, 7.326 + 0j, 22.0 + 0j, 60.0 + 0j, 7.0 + 0.3j]


def hankel(order, argument, derivative=False):
    regular = spherical_jn(order, argument, derivative)
    return regular + 1j * spherical_yn(order, argument, derivative)


@pytest.mark.parametrize("argument", ARGUMENTS)
@pytest.mark.parametrize(
    ("function", "ratios", "derivatives", "scale"),
    [
        (hankel, outgoing_ratios, outgoing_derivatives, 1.7),
        (spherical_jn, regular_ratios, regular_derivatives, 0.6),
    ],
    ids=["outgoing", "regular"],
)
def test_radial_functions_agree_with_scipy(function, ratios, derivatives, scale, argument):
    orders = np.arange(20)
    found = np.array(list(islice(ratios(np.array([scale * argument + 0j]), argument), 20)))[:, 0]
    exact = function(orders, argument)
    np.testing.assert_allclose(found, function(orders, scale * argument) / exact, rtol=1e-10)
    slopes = np.array(list(islice(derivatives(argument), 20)))
    np.testing.assert_allclose(slopes, function(orders, argument, True) / exact, rtol=1e-10)


def test_zeros_of_the_bessel_function_do_no_harm():
    """At z = π j_0 vanishes to rounding; products through the zero still give j_1(0.5 z)/j_1(z)."""
    ratios = list(islice(regular_ratios(np.array([0.5 * np.pi + 0j]), np.pi + 0j), 5))
    wanted = spherical_jn(np.arange(5), 0.5 * np.pi) / spherical_jn(np.arange(5), np.pi)
    np.testing.assert_allclose(np.array(ratios)[1:, 0], wanted[1:], rtol=1e-10)


def test_regular_quotients_at_the_origin_are_zero():
    np.testing.assert_array_equal(regular_quotients(np.zeros(2, dtype=complex), 1, 3), 0.0)
    values = list(islice(regular_ratios(np.zeros(1, dtype=complex), 2.0 + 0j), 3))
    np.testing.assert_allclose(
        np.array(values)[:, 0], [1.0 / spherical_jn(0, 2.0), 0.0, 0.0], atol=1e-15
    )


def test_legendre_polynomials_at_usual_and_at_tiny_angles():
    angles = np.array([0.0, 0.3, 1.5, np.pi])
    values = np.array(list(islice(legendre_polynomials(2.0 * np.sin(angles / 2.0) ** 2), 200)))
    np.testing.assert_allclose(
        values, eval_legendre(np.arange(200)[:, None], np.cos(angles)), atol=1e-12
    )
    tiny = 1e-5
    high = next(
        islice(legendre_polynomials(np.array([2.0 * np.sin(tiny / 2.0) ** 2])), 10_000, None)
    )
    # Hilb: P_n(cos γ) = √(γ/sin γ) J_0((n + 1/2) γ) + O(γ²) for small angles (Szegő, theorem
    # 8.21.6).
    np.testing.assert_allclose(high, j0(10_000.5 * tiny), atol=1e-9)


@pytest.mark.parametrize("ratio", [0.0, 1e-3, 0.3, 0.9])
@pytest.mark.parametrize("angle", [0.0, 0.2, 1.6, 3.0, np.pi])
def test_image_sums_are_the_sums(ratio, angle):
    orders = np.arange(400)
    powers = np.where(orders == 0, 1.0, ratio**orders)
    point, line = image_sums(np.array([ratio]), np.array([2.0 * np.sin(angle / 2.0) ** 2]))
    assert point[0] == pytest.approx(legval(np.cos(angle), powers), rel=1e-12)
    assert line[0] == pytest.approx(legval(np.cos(angle), powers / (orders + 1)), rel=1e-12)
