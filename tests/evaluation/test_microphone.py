"""A microphone reads the mean over its face, and nothing where a body is in its way."""

import numpy as np
import pytest
from scipy.special import j1

import airtact as at
from faults import raises_code

AIR = at.Medium(sound_speed=343.1, density=1.293)


def open_air_field(direction: np.ndarray, distance: float) -> at.acoustics.RadiatedField:
    source = at.Monopoles(distance * direction[None], np.array([distance + 0j]))
    return at.FreeField().radiate(at.Scene(AIR, [], frequency=40e3), source)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0, 90.0])
def test_a_far_source_is_read_with_the_pattern_of_a_disc(degrees):
    axis = np.array([0.2, -0.5, 0.9]) / np.linalg.norm([0.2, -0.5, 0.9])
    across = np.cross(axis, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    angle = np.radians(degrees)
    direction = np.cos(angle) * axis + np.sin(angle) * across
    microphone = at.evaluation.Microphone(axis=tuple(axis))
    field = open_air_field(direction, 50.0)
    middle = np.zeros((1, 3))
    reading = microphone.read(field, middle)[0, 0] / field.at(middle)[0, 0]
    x = field.scene.wavenumber.real * microphone.diameter / 2 * np.sin(angle)
    expected = 1.0 if x == 0.0 else 2.0 * j1(x) / x
    assert reading == pytest.approx(expected, abs=2e-3)


def test_what_blocks_it_follows_from_geometry():
    rng = np.random.default_rng(3)
    radius, microphone = 0.01, at.evaluation.Microphone(axis=(0.0, 0.0, -1.0), housing=0.03)
    scene = at.Scene(AIR, [at.sound_hard(at.sphere(radius, edge=1e-3))], frequency=40e3)
    centres = rng.uniform([-0.02, -0.02, -0.045], [0.02, 0.02, 0.015], (400, 3))
    # The nearest point of an upright cylinder of the microphone's radius to the middle of the ball.
    aside = np.linalg.norm(centres[:, :2], axis=1)
    gap_aside = np.maximum(aside - microphone.diameter / 2, 0.0)
    height = np.clip(0.0, centres[:, 2], centres[:, 2] + microphone.housing)
    distance = np.hypot(gap_aside, height)
    clear = (
        np.abs(distance - radius) > 0.7e-3
    )  # probes stand 3 mm apart along the housing and 0.8 mm along the rim
    blocked = microphone.blocked(scene, centres)
    assert 0.1 < blocked.mean() < 0.5
    np.testing.assert_array_equal(blocked[clear], distance[clear] < radius)


def test_blocked_positions_read_nothing():
    scene = at.Scene(AIR, [at.sound_hard(at.sphere(0.01, edge=1e-3))], frequency=40e3)
    field = at.SphereSeries().radiate(
        scene, at.Monopoles(np.array([[0.0, 0.0, 0.05]]), np.array([1.0 + 0j]))
    )
    reading = at.evaluation.Microphone(axis=(0.0, 0.0, 1.0), housing=0.0).read(
        field, np.array([[0.0, 0.0, 0.02], [0.0, 0.009, 0.0]])
    )
    assert np.isfinite(reading[0, 0])
    assert np.isnan(reading[1, 0])


@pytest.mark.parametrize(
    ("given", "code"),
    [
        ({"diameter": 6.35}, "out_of_range"),
        ({"diameter": -0.001}, "out_of_range"),
        ({"axis": (0.0, 0.0, 0.0)}, "wrong_shape"),
        ({"housing": -0.1}, "out_of_range"),
        ({"diameter": float("nan")}, "out_of_range"),
    ],
)
def test_impossible_microphones_raise(given, code):
    with raises_code(code):
        at.evaluation.Microphone(**given)
