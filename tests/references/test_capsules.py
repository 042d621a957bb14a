"""The fundamental solutions against the multipoles of two spheres, the series of one, and reciprocity."""

import numpy as np
import pytest

import airtact as at
from airtact.geometry.primitives import Capsule
from references import fundamental_solutions as capsules
from references import two_spheres

AIR = at.Medium(sound_speed=343.1, density=1.293)
K = AIR.wavenumber(40e3)


def around(number, radius, seed=0):
    vectors = np.random.default_rng(seed).normal(size=(number, 3))
    return radius * vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def fingers(first, second, degrees, gap, length):
    """Two capsules whose tips face each other along x, their axes running down and outward."""
    bodies = []
    for side, radius in ((-1.0, first), (1.0, second)):
        tilt = side * np.radians(degrees)
        tip = np.array([side * (gap / 2.0 + radius), 0.0, 0.0])
        pose = at.Pose.turn((0.0, 1.0, 0.0), -tilt)
        bodies.append(
            Capsule(
                radius, length, at.Pose(pose.rotation, tip - pose.rotation[:, 2] * length / 2.0)
            )
        )
    return bodies


@pytest.mark.parametrize(("radius", "off"), [(0.008, 0.0), (0.008, 5e-4), (0.0005, 5e-4)])
def test_one_sphere_is_the_series(radius, off):
    ball = Capsule(radius, 0.0, at.Pose(np.eye(3), np.array([0.001, 0.0, -0.002])))
    near, far = ball.pose.translation + around(6, radius + off, seed=1), around(8, 0.08, seed=2)
    pressure, error = capsules.pressure_at([ball], K, near, far)
    scene = at.Scene(AIR, [at.sound_hard(ball.mesh(0.6 * radius))])
    exact = at.SphereSeries().radiate(scene, at.Monopoles(near, np.eye(6))).at(far)
    true = np.max(np.linalg.norm(pressure - exact, axis=0) / np.linalg.norm(exact, axis=0))
    assert true < error < 3e-3


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
    skin = around(5, first + 5e-4, seed=3)
    near = np.vstack([skin[balls[1].depth(skin) < 0.0], [[first + gap / 2.0, 0.0, 0.0]]])
    far = around(10, 0.09, seed=4)
    pressure, error = capsules.pressure_at(balls, K, near, far)
    exact, exact_error = two_spheres.pressure_at(balls, K, near, far)
    true = np.max(np.linalg.norm(pressure - exact, axis=0) / np.linalg.norm(exact, axis=0))
    assert exact_error < 1e-4
    assert error < 3e-3
    assert true < 2.0 * error


@pytest.mark.slow
def test_own_error_of_two_fingers_bounds_the_distance_to_a_finer_fit():
    bodies = fingers(0.006, 0.007, 30.0, 0.004, 0.012)
    near, far = (
        np.array([[-0.0015, 0.0, 0.0], [0.0015, 0.0, 0.0], [0.0, 0.003, -0.005]]),
        around(10, 0.09, seed=5),
    )
    pressure, error = capsules.pressure_at(bodies, K, near, far)
    finer = capsules.fitted(bodies, K, far, 4.0).pressure(near).T
    true = np.max(np.linalg.norm(pressure - finer, axis=0) / np.linalg.norm(finer, axis=0))
    assert error < 3e-3
    assert true < 2.0 * error
