"""The multipole reference against the series of one sphere and the laws of physics."""

from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.evaluation import self_check
from airtact.geometry.primitives import Capsule
from references.two_spheres import pressure_at

AIR = at.Medium(sound_speed=343.1, density=1.293)
K = AIR.wavenumber(40e3)


def ball(centre, radius):
    return Capsule(radius, 0.0, at.Pose(np.eye(3), np.asarray(centre, dtype=float)))


def pair(first, second, gap, direction=(0.6, 0.0, 0.8)):
    return [
        ball((0.0, 0.0, 0.0), first),
        ball((first + second + gap) * np.array(direction), second),
    ]


def around(number, radius, seed=0):
    vectors = np.random.default_rng(seed).normal(size=(number, 3))
    return radius * vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("off", [0.0, 5e-4, 0.03])
def test_a_lonely_sphere_is_the_series(off):
    """The other sphere is 0.5 mm wide and 5 m away: its echo is 4e-6 of what it hears."""
    spheres = [ball((0.001, 0.0, -0.002), 0.009), ball((3.0, 0.0, 4.0), 0.0005)]
    near, far = np.array([0.001, 0.0, -0.002]) + around(5, 0.009 + off), around(12, 0.08, seed=1)
    pressure, error = pressure_at(spheres, K, near, far)
    scene = at.Scene(AIR, [at.sound_hard(spheres[0].mesh(0.006))])
    exact = at.SphereSeries().radiate(scene, at.Monopoles(near, np.eye(5))).at(far)
    assert error < 1e-5
    np.testing.assert_allclose(pressure, exact, atol=2e-5 * np.abs(exact).max())


def test_a_lonely_sphere_of_an_impedance_is_the_series():
    spheres, ratio = [ball((0.0, 0.0, 0.0), 0.009), ball((3.0, 0.0, 4.0), 0.0005)], 1.5 + 0.5j
    near, far = around(5, 0.0095), around(12, 0.08, seed=1)
    pressure, error = pressure_at(spheres, K, near, far, admittances=(1 / ratio, 2.0))
    exact = at.SphereSeries().radiate(
        at.Scene(AIR, [at.impedance(spheres[0].mesh(0.006), ratio)]), at.Monopoles(near, np.eye(5))
    )
    assert error < 1e-5
    np.testing.assert_allclose(pressure, exact.at(far), atol=2e-5 * np.abs(pressure).max())


@pytest.mark.parametrize(
    ("first", "second", "gap"),
    [pytest.param(0.009, 0.006, 0.002, marks=pytest.mark.slow), (0.008, 0.008, 0.012)],
)
def test_own_error_is_small_where_solvers_are_judged(first, second, gap):
    spheres = pair(first, second, gap)
    near, far = around(6, first + 5e-4, seed=2), around(10, 0.1, seed=3)
    near = near[spheres[1].depth(near) < 0.0]
    pressure, error = pressure_at(spheres, K, near, far)
    finer, finer_error = pressure_at(spheres, K, near, far, wanted=1e-7)
    assert error < 1e-4
    assert finer_error < 1e-6
    assert np.linalg.norm(pressure - finer) < error * np.linalg.norm(finer)


def test_the_stored_pressures_of_the_self_check_are_those_of_the_multipoles():
    stored = np.load(Path(self_check.__file__).with_name("two_spheres.npz"))
    spheres = [ball((0.0, 0.0, 0.0), 8e-3), ball((16e-3, 0.0, 0.0), 5e-3)]
    exact, _ = pressure_at(spheres, K, stored["away"], stored["between"])
    assert stored["error"] < 1e-3
    assert np.linalg.norm(stored["pressure"] - exact) < stored["error"] * np.linalg.norm(exact)
