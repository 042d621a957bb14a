"""The multipole reference against the series of one sphere and the laws of physics."""

from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.evaluation import self_check
from airtact.geometry.primitives import Capsule
from references.two_spheres import pressure_at
from worlds import AIR, directions

K = AIR.wavenumber(40e3)


def ball(centre, radius):
    return Capsule(radius, 0.0, at.Pose(np.eye(3), np.asarray(centre, dtype=float)))


@pytest.mark.parametrize("ratio", [None, 1.5 + 0.5j], ids=["hard", "impedance"])
def test_a_lonely_sphere_is_the_series(ratio):
    """The other sphere is 0.5 mm wide and 5 m away: its echo is 4e-6 of what it hears."""
    offs = np.repeat([0.0, 5e-4, 0.03], 5)
    spheres = [ball((0.001, 0.0, -0.002), 0.009), ball((3.0, 0.0, 4.0), 0.0005)]
    near = np.array([0.001, 0.0, -0.002]) + (0.009 + offs[:, None]) * directions(15, 0)
    far = 0.08 * directions(12, 1)
    admittances = (1 / ratio, 2.0) if ratio else (0.0, 0.0)
    pressure, error = pressure_at(spheres, K, near, far, admittances=admittances)
    skin = spheres[0].mesh(0.006)
    scene = at.Scene(AIR, [at.impedance(skin, ratio) if ratio else at.sound_hard(skin)])
    exact = at.SphereSeries().radiate(scene, at.Monopoles(near, np.eye(15))).at(far)
    assert error < 1e-5
    for off in np.unique(offs):
        difference = np.abs(pressure - exact)[:, offs == off]
        assert difference.max() < 2e-5 * np.abs(exact[:, offs == off]).max()


@pytest.mark.parametrize(
    ("first", "second", "gap"),
    [pytest.param(0.009, 0.006, 0.002, marks=pytest.mark.slow), (0.008, 0.008, 0.012)],
)
def test_own_error_is_small_where_solvers_are_judged(first, second, gap):
    centre = (first + second + gap) * np.array([0.6, 0.0, 0.8])
    spheres = [ball(np.zeros(3), first), ball(centre, second)]
    near, far = (first + 5e-4) * directions(6, 2), 0.1 * directions(10, 3)
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
