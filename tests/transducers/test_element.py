"""A piston's points against closed forms: moments of the disc and 2 J₁(x)/x."""

import numpy as np
import pytest
from scipy.special import gamma, j1

import airtact as at
from airtact.transducers import Element
from airtact.transducers.element import MAX_PISTON_SIZE, check_pattern
from faults import raises_code


def _directions() -> tuple[np.ndarray, np.ndarray]:
    """Directions over the half sphere before a face, and the sines of their angles from the axis."""
    theta = np.radians(np.linspace(0.0, 90.0, 91))
    phi = np.radians(np.linspace(0.0, 360.0, 73))
    theta, phi = (angles.ravel() for angles in np.meshgrid(theta, phi))
    directions = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1
    )
    return directions, np.sin(theta)


def _pattern_error(ka: float, radius: float = 5e-3, points: int = 19) -> float:
    directions, sines = _directions()
    x = np.maximum(ka * sines, 1e-9)
    return float(
        np.abs(
            at.piston(radius, points=points).far_pattern(directions, ka / radius) - 2.0 * j1(x) / x
        ).max()
    )


def test_far_pattern_holds_up_to_the_largest_piston_and_not_much_further() -> None:
    for points, largest in MAX_PISTON_SIZE.items():
        assert _pattern_error(largest, points=points) < 1.5e-3
        assert _pattern_error(1.25 * largest, points=points) > 1.5e-3


@pytest.mark.parametrize(
    ("points", "degree"), [*((19, n) for n in range(10)), *((12, n) for n in range(8))]
)
def test_points_of_a_piston_integrate_the_disc_to_their_degree(points: int, degree: int) -> None:
    element = at.piston(0.1, points=points)
    x, y, _ = 10.0 * element.points.T
    for a in range(degree + 1):
        b = degree - a
        exact = (
            0.0
            if (a % 2 or b % 2)
            else gamma((a + 1) / 2) * gamma((b + 1) / 2) / (np.pi * gamma((a + b) / 2 + 2))
        )
        assert element.weights @ (x**a * y**b) == pytest.approx(exact, abs=1e-15)


def test_a_monopole_radiates_alike_everywhere() -> None:
    directions, _ = _directions()
    element = at.monopole(sensitivity=2.0)
    assert np.array_equal(element.far_pattern(directions, 732.0), np.ones(len(directions)))
    assert (element.sensitivity, element.directional, element.reach) == (2.0, False, 0.0)


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: at.piston(-0.001), "out_of_range"),
        (lambda: at.piston(float("nan")), "out_of_range"),
        (lambda: at.monopole(sensitivity=0.0), "out_of_range"),
        (lambda: at.monopole(sensitivity=float("inf")), "out_of_range"),
        (lambda: Element(np.zeros((2, 3)), np.array([0.5, 0.4])), "out_of_range"),
        (lambda: Element(np.zeros((2, 3)), np.ones(3) / 3), "wrong_shape"),
        (lambda: Element(np.zeros((0, 3)), np.zeros(0)), "empty"),
        (lambda: Element(np.zeros((2, 2)), np.ones(2) / 2), "wrong_shape"),
        (lambda: Element(np.full((2, 3), np.nan), np.ones(2) / 2), "not_finite"),
        (lambda: Element(np.zeros((1, 3)), np.array([np.nan])), "out_of_range"),
        (lambda: Element(np.zeros((1, 3)), np.ones(1), radius=-1.0), "out_of_range"),
    ],
)
def test_bad_elements_are_rejected(make, code: str) -> None:
    with raises_code(code):
        make()


def test_a_piston_too_large_for_its_points_is_rejected() -> None:
    check_pattern(at.piston(6.5e-3), 732.5)
    with raises_code("out_of_range"):
        check_pattern(at.piston(10e-3), 733.0 + 0.1j)
