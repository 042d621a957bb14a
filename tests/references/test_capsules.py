"""The fundamental solutions against the multipoles of two spheres, the series of one, and reciprocity."""

import numpy as np
import pytest

import airtact as at
from airtact.geometry.primitives import Capsule
from references import fundamental_solutions as capsules
from references import relative_columns, two_spheres
from worlds import AIR, directions, two_fingers

K = AIR.wavenumber(40e3)


@pytest.mark.parametrize(("radius", "off"), [(0.008, 0.0), (0.008, 5e-4), (0.0005, 5e-4)])
def test_one_sphere_is_the_series(radius, off):
    ball = Capsule(radius, 0.0, at.Pose(np.eye(3), np.array([0.001, 0.0, -0.002])))
    near = ball.pose.translation + (radius + off) * directions(6, 1)
    far = 0.08 * directions(8, 2)
    pressure, error = capsules.pressure_at([ball], K, near, far)
    scene = at.Scene(AIR, [at.sound_hard(ball.mesh(0.6 * radius))])
    exact = at.SphereSeries().radiate(scene, at.Monopoles(near, np.eye(6))).at(far)
    assert relative_columns(pressure, exact).max() < error < 3e-3


@pytest.mark.parametrize(
    ("first", "second", "gap"),
    [
        (0.008, 0.008, 0.012),
        (0.0005, 0.006, 0.002),
        pytest.param(0.006, 0.012, 0.002, marks=pytest.mark.slow),
        pytest.param(0.006, 0.006, 0.0005, marks=pytest.mark.slow),
    ],
)
def test_two_spheres_are_the_multipoles(first, second, gap):
    balls = [
        Capsule(r, 0.0, at.Pose(np.eye(3), np.array([x, 0, 0])))
        for r, x in ((first, 0.0), (second, first + second + gap))
    ]
    skin = (first + 5e-4) * directions(5, 3)
    near = np.vstack([skin[balls[1].depth(skin) < 0.0], [[first + gap / 2.0, 0.0, 0.0]]])
    far = 0.09 * directions(10, 4)
    pressure, error = capsules.pressure_at(balls, K, near, far)
    exact, exact_error = two_spheres.pressure_at(balls, K, near, far)
    assert exact_error < 1e-4
    assert error < 3e-3
    assert relative_columns(pressure, exact).max() < 2.0 * error


@pytest.mark.slow
def test_own_error_of_two_fingers_bounds_the_distance_to_a_finer_fit():
    scene = two_fingers(0.006, 30.0, 0.004, 0.012)
    bodies = [obstacle.surface.primitive for obstacle in scene.obstacles]
    near = np.array([[-0.0015, 0.0, 0.0], [0.0015, 0.0, 0.0], [0.0, 0.003, -0.005]])
    far = 0.09 * directions(10, 5)
    pressure, error = capsules.pressure_at(bodies, K, near, far)
    finer = capsules.fitted(bodies, K, far, 4.0).pressure(near).T
    assert error < 3e-3
    assert relative_columns(pressure, finer).max() < 2.0 * error
