"""Force and torque on bodies of any size against the partial wave series and laws of physics."""

import numpy as np
import pytest

import airtact as at
from airtact.evaluation.verification import radiation_of
from faults import raises_code
from references.standing_wave import AIR, BOTH, ENERGY, FOAM, PAIR, K, standing_wave_function

OPEN_AIR = at.Scene(AIR)
TINYLEV = at.transducers.known_array("tinylev", at.monopole(3.4))
IN_PHASE = at.Drive(np.ones(72, dtype=np.complex128))


@pytest.mark.parametrize("filling", [None, FOAM])
@pytest.mark.parametrize("size", [0.5e-3 * K, 0.3 * np.pi, 0.3 * 2 * np.pi])
def test_sphere_in_a_plane_standing_wave(size, filling) -> None:
    radius = size / K
    surface = at.sphere(radius, radius / 3, (0.0, 1e-3, 0.0))
    body = at.sound_hard(surface) if filling is None else at.filled(surface, filling)
    force, torque = at.traps.body_force(OPEN_AIR, PAIR, BOTH, body, solver=at.SphereSeries())
    scale = np.pi * radius**2 * ENERGY
    expected = scale * standing_wave_function(size, filling) * np.sin(2 * K * 1e-3)
    # The waves are not quite plane over the largest sphere.
    assert force[1] == pytest.approx(expected, rel=2e-3, abs=2e-3 * scale)
    assert np.abs(force[[0, 2]]).max() < 1e-6 * scale
    assert np.abs(torque).max() < 1e-6 * scale * radius
    if filling is None:
        other, _ = at.traps.body_force(OPEN_AIR, PAIR, BOTH, body)
        np.testing.assert_allclose(other, force, rtol=0, atol=5e-3 * scale)


def test_gorkov_is_the_limit_of_small_beads() -> None:
    point = (1e-3, 1.5e-3, 0.5e-3)
    bead = at.filled(at.sphere(0.25e-3, 0.1e-3, point), FOAM)
    exact, _ = at.traps.body_force(OPEN_AIR, TINYLEV, IN_PHASE, bead)
    pull = at.traps.force(OPEN_AIR, TINYLEV, IN_PHASE, np.array([point]), radius=0.25e-3)[0]
    assert np.linalg.norm(pull - exact) < 0.02 * np.linalg.norm(exact)


def test_a_tilted_capsule_is_pushed_and_turned_as_the_pressure_on_its_surface_does() -> None:
    capsule = at.sound_hard(at.capsule((-2e-3, 1e-3, 0), (2e-3, 2.5e-3, 1e-3), 1.5e-3, 1e-3))
    solver = at.BoundaryElement(accuracy=0.01)
    force, torque = at.traps.body_force(OPEN_AIR, TINYLEV, IN_PHASE, capsule, (0, 0, 0), solver)
    scene = at.Scene(AIR, [capsule])
    sources = at.evaluation.drive_sources(TINYLEV, [IN_PHASE], scene)
    surface = radiation_of(solver.radiate(scene, sources), 0)
    push = -(surface.areas * surface.radiation_pressure)[:, None] * surface.normals
    size = np.linalg.norm(force)
    np.testing.assert_allclose(force, push.sum(axis=0), atol=3e-3 * size)
    turn = np.cross(surface.points, push).sum(axis=0)
    np.testing.assert_allclose(torque, turn, atol=3e-3 * np.linalg.norm(torque))


def test_a_vortex_turns_what_absorbs_by_the_absorbed_power() -> None:
    angle = 2 * np.pi * np.arange(8) / 8
    places = np.stack([0.05 * np.sin(angle), 0.05 * np.cos(angle), -0.05 + 0 * angle], axis=1)
    ring = at.PhasedArray(places, element=at.monopole(3.4))
    drive = at.Drive(np.exp(-1j * angle))
    body = at.impedance(at.sphere(2e-3, 1e-3), 1.5)
    _, torque = at.traps.body_force(OPEN_AIR, ring, drive, body, solver=at.SphereSeries())
    scene = at.Scene(AIR, [body])
    field = at.SphereSeries().radiate(scene, at.evaluation.drive_sources(ring, [drive], scene))
    skin = field.on_surface
    # v = p/Z into the surface; a wave of order m carries angular momentum m/ω for its energy.
    power = np.sum(skin.areas * np.abs(skin.pressure[:, 0]) ** 2) / (2 * 1.5 * 1.2 * 343.1)
    expected = [0.0, 0.0, power / (2 * np.pi * 40e3)]
    np.testing.assert_allclose(torque, expected, atol=1e-3 * expected[2])


def test_a_ball_beside_a_finger_does_not_depend_on_the_panels() -> None:
    finger = at.sound_hard(at.capsule((0.012, 0, 0), (0.032, 0, 0), 6e-3, 2e-3))
    ball = at.sound_hard(at.sphere(2e-3, 1e-3, (1e-3, 1.2e-3, 0.5e-3)))
    beside = at.Scene(AIR, [finger])
    force, _ = at.traps.body_force(beside, TINYLEV, IN_PHASE, ball)
    fine = at.BoundaryElement(accuracy=0.005)
    finer, _ = at.traps.body_force(beside, TINYLEV, IN_PHASE, ball, solver=fine)
    alone, _ = at.traps.body_force(OPEN_AIR, TINYLEV, IN_PHASE, ball)
    size = np.linalg.norm(finer)
    assert np.linalg.norm(force - finer) < 0.01 * size
    assert np.linalg.norm(force - alone) > 0.03 * size


@pytest.mark.slow
def test_finite_elements_and_the_series_agree_on_a_filled_sphere() -> None:
    ball = at.filled(at.sphere(1.5e-3, 0.5e-3, (1e-3, 1.2e-3, 0.4e-3)), FOAM)
    exact, _ = at.traps.body_force(OPEN_AIR, TINYLEV, IN_PHASE, ball)
    finite, _ = at.traps.body_force(OPEN_AIR, TINYLEV, IN_PHASE, ball, solver=at.FiniteElement())
    assert np.linalg.norm(finite - exact) < 0.01 * np.linalg.norm(exact)


def test_impossible_bodies_are_rejected(as_outside_the_tests) -> None:
    finger = at.sound_hard(at.capsule((0.012, 0, 0), (0.032, 0, 0), 6e-3, 2e-3))
    rod = at.sound_hard(at.capsule((3e-3, -5e-3, 0), (3e-3, 5e-3, 0), 1e-3, 1e-3))
    with raises_code("bodies_overlap", "(3.00, 0.00, 0.00)"):
        at.traps.body_force(at.Scene(AIR, [finger]), TINYLEV, IN_PHASE, rod)
    far = at.PhasedArray(np.array([[0.0, 0.0, 0.5]]), element=at.monopole())
    with raises_code("out_of_range", "wavelengths"):
        large = at.sound_hard(at.sphere(0.1, 0.03))
        at.traps.body_force(OPEN_AIR, far, at.Drive(np.ones(1) + 0j), large)
    with raises_code("wrong_kind"):
        at.traps.body_force(OPEN_AIR, TINYLEV, IN_PHASE, at.sphere(1e-3, 1e-3))
    with raises_code("not_in_metres", "the body is 12 m"):
        away = at.sound_hard(at.sphere(1e-3, 1e-3, (0.0, 12.0, 0.0)))
        at.traps.body_force(OPEN_AIR, TINYLEV, IN_PHASE, away)
