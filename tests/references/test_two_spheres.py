"""The multipole reference against the series of one sphere and the laws of physics."""

from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.evaluation import self_check
from airtact.geometry.primitives import Capsule
from references.two_spheres import fitted, pressure_at

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


def test_talking_and_listening_change_places():
    spheres = pair(0.01, 0.007, 0.003)
    one, other = around(5, 0.03, seed=4), around(6, 0.031, seed=5)
    there = fitted(spheres, K, one, 36).pressure(other)
    back = fitted(spheres[::-1], K, other, 36).pressure(one)
    np.testing.assert_allclose(there, back.T, atol=1e-6 * np.abs(there).max())


@pytest.mark.slow
def test_power_drawn_from_the_source_arrives_far_away():
    """Sound-hard spheres keep no power: k ∮|p|² r² dΩ = 4π (k + Im p_scattered(x0))."""
    spheres = pair(0.006, 0.006, 0.003)
    source = np.array([[0.004, 0.012, 0.006]])
    cosine, weight = np.polynomial.legendre.leggauss(36)
    azimuth = 2.0 * np.pi * np.arange(72) / 72.0
    sine = np.sqrt(1.0 - cosine**2)
    sphere = np.stack(
        [
            np.outer(sine, np.cos(azimuth)),
            np.outer(sine, np.sin(azimuth)),
            np.outer(cosine, np.ones(72)),
        ],
        axis=2,
    ).reshape(-1, 3)
    steps = 2e-5 * np.vstack([np.eye(3), -np.eye(3)])
    listeners = np.vstack([source + steps, source + 2.0 * steps, 1000.0 * sphere])
    pressure, error = pressure_at(spheres, K, source, listeners)
    near, next_near = pressure[:6, 0].imag.mean(), pressure[6:12, 0].imag.mean()
    drawn = 4.0 * np.pi * (4.0 * near - next_near) / 3.0
    heard = (
        K.real
        * np.sum(np.repeat(weight, 72) * np.abs(1000.0 * pressure[12:, 0]) ** 2)
        * 2.0
        * np.pi
        / 72.0
    )
    assert error < 1e-4
    assert heard == pytest.approx(drawn, rel=1e-4)


def test_turning_everything_changes_nothing():
    turn = at.Pose.turn((1.0, -0.4, 0.2), 1.1, translation=(0.02, -0.03, 0.01))
    spheres = pair(0.01, 0.007, 0.004)
    near, far = around(4, 0.0105, seed=6), around(7, 0.09, seed=7)
    here = pressure_at(spheres, K, near, far)[0]
    there = pressure_at(
        [sphere.moved(turn) for sphere in spheres], K, turn.apply(near), turn.apply(far)
    )[0]
    np.testing.assert_allclose(there, here, atol=1e-6 * np.abs(here).max())


def test_the_stored_pressures_of_the_self_check_are_those_of_the_multipoles():
    stored = np.load(Path(self_check.__file__).with_name("two_spheres.npz"))
    spheres = [ball((0.0, 0.0, 0.0), 8e-3), ball((16e-3, 0.0, 0.0), 5e-3)]
    exact, _ = pressure_at(spheres, K, stored["away"], stored["between"])
    assert stored["error"] < 1e-3
    assert np.linalg.norm(stored["pressure"] - exact) < stored["error"] * np.linalg.norm(exact)
