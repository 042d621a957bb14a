"""Multipole expansions against the closed form of one sphere and against the fields that they replace."""

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.solvers.spherical import multipole_field
from faults import raises_code

AIR = at.Medium(343.1, 1.293)
DAMP = at.air(20.0, 0.5, 40e3)


def around(centre: np.ndarray, nearest: float, count: int = 60) -> np.ndarray:
    random = np.random.default_rng(7)
    directions = random.normal(size=(count, 3))
    return centre + nearest / random.uniform(0.02, 1.0, (count, 1)) * directions / np.linalg.norm(
        directions, axis=1, keepdims=True
    )


def beside_a_ball(
    radius: float, medium: at.Medium = AIR, law=at.sound_hard
) -> at.acoustics.RadiatedField:
    """Half a millimetre off a ball, on it and far from it: three excitations in closed form."""
    centre = np.array([0.02, -0.01, 0.03])
    scene = at.Scene(
        medium, [law(at.sphere(radius, edge=radius / 4, centre=tuple(centre)))], frequency=40e3
    )
    positions = centre + np.array([[0, 0, radius + 0.5e-3], [radius, 0, 0], [0.2, 0.1, 0.1]])
    return at.SphereSeries().radiate(scene, at.Monopoles(positions, np.eye(3)))


def errors(found: np.ndarray, exact: np.ndarray) -> np.ndarray:
    return np.linalg.norm(found - exact, axis=0) / np.linalg.norm(exact, axis=0)


@pytest.mark.parametrize(
    ("radius", "medium", "law"),
    [
        (1e-3, AIR, at.sound_hard),
        (10e-3, DAMP, at.sound_hard),
        (10e-3, AIR, lambda skin: at.impedance(skin, 1.5 + 0.5j)),
        (30e-3, AIR, at.sound_hard),
    ],
)
def test_the_expansion_equals_the_closed_form_of_a_sphere(radius, medium, law):
    field = beside_a_ball(radius, medium, law)
    expanded = at.multipole_expansion(field)
    points = around(
        field.scene.obstacles[0].surface.corners.mean(axis=(0, 1)),
        radius + 1.1 * field.scene.wavelength,
    )
    off = errors(expanded.at(points), field.at(points))
    assert off.max() < 3e-4
    assert np.all(off < 3 * expanded.report.settings["expansion_error"] + 1e-9)
    assert expanded.report.warnings == field.report.warnings


def test_a_rigid_motion_gives_the_transfer_matrix_of_the_surface_integral():
    fingers = [at.capsule((x, 0, 0), (x, 0, -0.02), 4e-3, edge=2e-3) for x in (-0.007, 0.007)]
    scene = at.Scene(AIR, [at.sound_hard(finger) for finger in fingers], frequency=40e3)
    target = at.Target(np.array([[-0.0025, 0, 0], [0.0025, 0, 0]]))
    field = at.BoundaryElement(accuracy=0.1, estimate=False).radiate(scene, target.beacons())
    expanded, array = at.multipole_expansion(field), at.surrounding_box()
    for turn in (0.0, 0.4):
        seen = array.seen_from(at.Pose.turn((1, 2, 3), turn, (0.005, -0.01, 0.0)))
        found, exact = at.transfer_matrix(expanded, seen), at.transfer_matrix(field, seen)
        assert errors(found.matrix.T, exact.matrix.T).max() < 1e-4
        assert np.isnan(
            found.estimated_error
        )  # a solution without an estimate has none here either


def test_over_a_plane_one_solve_serves_the_motions_along_it():
    """The body is lower over the plane than the ball around it reaches, and touched by a focus."""
    table, finger = (
        at.plane((0, 0, 0), (0, 0, 1)),
        at.capsule((-0.006, 0, 0.006), (0.006, 0, 0.006), 4e-3, edge=2e-3),
    )
    scene = at.Scene(AIR, [at.sound_hard(finger)], frequency=40e3, planes=[table])
    target = at.Target(np.array([[0, 0, 0.0107], [0, -0.004, 0.006]]))
    array = at.autd3_board(at.Pose(np.eye(3), np.array([-0.09, -0.07, 0.0])))
    solver = at.BoundaryElement(accuracy=0.03)
    field = solver.radiate(scene, target.beacons())
    expanded = at.multipole_expansion(field)
    assert expanded.report.settings["expansion_error"] < 1e-3
    motion = at.Pose.turn((0, 0, 1), 0.4, (0.03, -0.02, 0.0))
    assert table.kept_by(motion)
    seen = array.seen_from(motion)
    found, exact = at.transfer_matrix(expanded, seen), at.transfer_matrix(field, seen)
    assert errors(found.matrix.T, exact.matrix.T).max() < 1e-3
    moved = at.Scene(AIR, [at.sound_hard(finger.moved(motion))], frequency=40e3, planes=[table])
    again = solver.radiate(moved, at.Target(motion.apply(target.points)).beacons())
    assert errors(found.matrix.T, at.transfer_matrix(again, array).matrix.T).max() < 0.03
    points = np.array([[0, 0, 0.0], [0.002, 0.001, 0.0], [0.1, 0.05, 0.0], [0.05, 0.02, -0.01]])
    assert expanded.valid(points).tolist() == [True, True, True, False]
    assert np.isnan(expanded.at(points)[3]).all()
    np.testing.assert_allclose(expanded.at(points)[:3], field.at(points)[:3], rtol=2e-3)
    np.testing.assert_array_equal(expanded.scattered_at(points), field.scattered_at(points))


def test_near_the_bodies_the_solution_itself_serves():
    field = beside_a_ball(5e-3)
    expanded = at.multipole_expansion(field)
    centre = field.scene.obstacles[0].surface.corners.mean(axis=(0, 1))
    near = centre + np.array([[0, 6e-3, 0], [0, 0, -13e-3], [1e-3, 0, 0]])
    both = np.concatenate([near, centre + [[0.1, 0, 0]]])
    np.testing.assert_array_equal(expanded.at(both)[:3], field.at(near))
    np.testing.assert_allclose(expanded.at(both)[3], field.at(both[3:])[0], rtol=1e-3)
    assert expanded.valid(both).tolist() == [True, True, False, True]
    np.testing.assert_array_equal(expanded.velocity(near[:2]), field.velocity(near[:2]))
    np.testing.assert_array_equal(expanded.on_surface.pressure, field.on_surface.pressure)
    assert expanded.error_at(both).max() < 1e-3


def test_fields_that_cannot_be_expanded_are_rejected(monkeypatch):
    field = beside_a_ball(2e-3)
    open_air = at.FreeField().radiate(at.Scene(AIR, [], 40e3), field.sources)
    with raises_code("empty"):
        at.multipole_expansion(open_air)
    nodes = field.scene.obstacles[0].surface.corners.mean(axis=(0, 1)) + 0.03 * np.eye(4, 3, -1)
    pressures = np.ones((4, 3), dtype=np.complex128)
    with raises_code("data_missing"):
        at.multipole_expansion(at.SampledField(field.scene, field.sources, nodes, pressures))
    monkeypatch.setattr(multipole_field, "available_memory", lambda: 2.0**18)
    with raises_code("too_little_memory"):
        at.multipole_expansion(field)
