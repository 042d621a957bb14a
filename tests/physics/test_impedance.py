"""Locally reacting surfaces by boundary elements, against series, multipoles, finite elements and laws."""

import numpy as np
import pytest

import airtact as at
from references import relative_columns
from worlds import AIR, directions, one_each, sphere_rule

RATIOS = [0.5, 2.0, 2 + 2j, 20.0]
K = AIR.wavenumber(40e3).real
RADII = {"off": 8e-3, "monopole": np.pi / K, "dipole": 4.493409 / K, "higher": 6.98793 / K}
"""The interior of a sphere resonates where j_n(ka) = 0: n = 0, 1, 3."""

SKIN = 1.6e6 / 415
"""Impedance of soft tissue over that of air (F. A. Duck, Physical Properties of Tissue, 1990, chapter 4)."""


def relative(values: np.ndarray, exact: np.ndarray) -> float:
    return float(relative_columns(values, exact).max())


def sphere_scene(ratio: complex, radius: float = 8e-3) -> at.Scene:
    return at.Scene(AIR, [at.impedance(at.sphere(radius, radius), ratio)])


def power_into(field: at.acoustics.RadiatedField) -> float:
    """Power that enters the bodies [W], from pressure and velocity on their surfaces."""
    surface = field.on_surface
    inwards = -np.einsum("nds,nd->ns", field.velocity(surface.points), surface.normals)
    return float(0.5 * np.real(np.conj(surface.pressure) * inwards)[:, 0] @ surface.areas)


CASES = [
    pytest.param(
        radius, ratio, marks=() if name == "higher" or ratio == 2 + 2j else pytest.mark.slow
    )
    for name, radius in RADII.items()
    for ratio in RATIOS
]


@pytest.mark.parametrize(("radius", "ratio"), CASES)
def test_a_sphere_is_its_series_on_and_off_its_resonances(radius, ratio):
    scene = sphere_scene(ratio, radius)
    sources = one_each(
        np.concatenate([directions(3, 1) * (radius + 0.5e-3), directions(3, 2) * (radius + 0.03)])
    )
    found, exact = (
        one.radiate(scene, sources) for one in (at.BoundaryElement(), at.SphereSeries())
    )
    away, near = directions(40, 3) * (radius + 0.05), directions(40, 4) * (radius + 2e-3)
    assert relative(found.at(away), exact.at(away)) < 0.01
    assert relative(found.at(near)[:, 3:], exact.at(near)[:, 3:]) < 0.01
    assert relative(found.scattered_at(away), exact.scattered_at(away)) < 0.02
    assert found.report.estimated_error < 0.02


def test_finer_panels_and_double_precision_converge_on_the_surface_too():
    scene, sources = sphere_scene(2 + 2j), one_each(directions(2, 1) * 0.02)
    exact = at.SphereSeries().radiate(scene, sources)
    lit = directions(400, 5) * 8e-3
    lit = lit[(lit @ sources.positions.T > 0).all(axis=1)]
    errors = []
    for solver in (at.BoundaryElement(0.01), at.BoundaryElement(3e-3, "float64")):
        found = solver.radiate(scene, sources)
        errors.append(
            (
                relative(found.at(lit), exact.at(lit)),
                relative(found.at(10 * lit), exact.at(10 * lit)),
            )
        )
    assert errors[0][0] < 0.02
    assert errors[1][0] < 6e-3
    assert errors[1][1] < 3e-3


@pytest.mark.parametrize("ratio", [0.5, 5j])
def test_the_power_that_enters_is_what_the_field_around_has_lost(ratio):
    """The power that leaves a sphere round body and source, and what enters the body, are the source's own."""
    source = np.array([[0.0, 0.004, 0.02]])
    field = at.BoundaryElement(0.006).radiate(sphere_scene(ratio), one_each(source))
    own = field.scattered_at(source)[0, 0] + 1j * K  # p − 1/r at the source
    emitted = 2 * np.pi * np.imag(own) / (AIR.density * 2 * np.pi * 40e3)
    ways, area = sphere_rule(24)
    intensity = 0.5 * np.abs(field.at(10.0 * ways)[:, 0]) ** 2 / (AIR.density * AIR.sound_speed)
    left = 100.0 * area @ intensity
    absorbed = power_into(field)
    assert left + absorbed == pytest.approx(emitted, rel=5e-3)
    assert (absorbed > 0.02 * emitted) == (complex(ratio).real > 0)


def two_kinds() -> tuple[at.Scene, tuple[complex, complex]]:
    balls = [at.sphere(9e-3, 9e-3), at.sphere(6e-3, 6e-3, centre=(0.017 * 0.6, 0.0, 0.017 * 0.8))]
    ratio = 1.5 + 0.5j
    return at.Scene(AIR, [at.sound_hard(balls[0]), at.impedance(balls[1], ratio)]), (
        0.0,
        1 / ratio,
    )


@pytest.fixture(scope="module")
def between() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sources about two balls of two kinds, points away, and the pressure there by multipoles."""
    from references import two_spheres

    scene, admittances = two_kinds()
    balls = [one.surface.primitive for one in scene.obstacles]
    sources = np.array([[0.006, 0.0, 0.008 + 1e-4], [-0.0095, 0, 0], [0.02, 0.01, 0.03]])
    away = directions(30, 3) * 0.1
    exact, own = two_spheres.pressure_at(
        balls, scene.wavenumber, sources, away, admittances=admittances
    )
    assert own < 1e-4
    return sources, away, exact


def test_bodies_of_two_kinds_stand_in_one_scene_and_are_factorised(between):
    sources, away, exact = between
    scene, _ = two_kinds()
    field = at.BoundaryElement().radiate(scene, one_each(sources))
    assert relative(field.at(away), exact) < 0.01
    assert relative(at.multipole_expansion(field).at(away), field.at(away)) < 2e-3
    ready = at.BoundaryElement(0.05).factorised(scene, sources)
    assert relative(ready.radiate(scene, one_each(sources)).at(away), exact) < 0.05


def test_an_absorbing_ball_over_a_plane_is_the_series_of_two():
    from references import before_a_plane

    ball = at.sphere(8e-3, 8e-3, centre=(0, 0, 10e-3))
    scene = at.Scene(AIR, [at.impedance(ball, 2 + 1j)], planes=[at.plane((0, 0, 0), (0, 0, 1))])
    sources = np.array([[0.03, 0.02, 0.06], [0.0, 9e-3, 10e-3], [0.04, 0.0, 0.0]])
    points = np.array([[0.05, 0.01, 0.03], [-0.06, 0.02, 0.09], [0.012, 0, 0], [0.05, 0.03, 0]])
    exact, own = before_a_plane.sphere_pressure(scene, sources, points)
    assert own < 1e-4
    assert relative(at.BoundaryElement().radiate(scene, one_each(sources)).at(points), exact) < 0.01


def test_a_hand_s_skin_is_as_good_as_rigid():
    """The share of the pressure that soft tissue lets in is of the order of 1/ratio."""
    finger = at.capsule((-0.012, 0, 0), (0.012, 0, 0), 8e-3, 4e-3)
    sources = one_each(np.array([[0, 0, 8.5e-3], [0.05, 0.02, 0.1]]))
    points = directions(40, 3) * 0.2
    solver = at.BoundaryElement(0.003)
    rigid, skin = (
        solver.radiate(at.Scene(AIR, [body]), sources).at(points)
        for body in (at.sound_hard(finger), at.impedance(finger, SKIN))
    )
    assert 0 < relative(skin, rigid) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.5, 2 + 2j])
def test_a_plate_beside_a_source_is_what_finite_elements_find(box, ratio):
    plate = box((-0.01, -0.01, -0.001), (0.01, 0.01, 0.001))
    scene = at.Scene(AIR, [at.impedance(plate, ratio)])
    sources, away = one_each(np.array([[0.002, 0.001, 0.006]])), directions(60, 3) * 0.1
    found = at.BoundaryElement(0.003).radiate(scene, sources).at(away)
    other = at.FiniteElement(order=4).radiate(scene, sources).at(away)
    assert relative(found, other) < 0.02
