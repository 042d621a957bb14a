"""The boundary element solver against closed forms and independent methods; ``make bench`` measures them all."""

import numpy as np
import pytest

import airtact as at
from benchmarks import accuracy
from references import two_spheres


@pytest.mark.parametrize(
    ("radius", "frequency"),
    [(0.5e-3, 40e3), (3e-3, 40e3)]
    + [(0.01, ka * 343.1 / (2 * np.pi * 0.01)) for ka in accuracy.INTERIOR_EIGENVALUES[:3]],
)
@pytest.mark.parametrize(
    ("gap", "allowed"), [(0.0, 0.02), (1e-4, 0.02), (5e-4, 0.01), (20e-3, 0.01)]
)
def test_sphere_at_default_accuracy(radius, frequency, gap, allowed):
    assert accuracy.sphere_error(radius, gap, frequency) < allowed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gap", "allowed"), [(0.0, 0.02), (1e-4, 0.02), (5e-4, 0.01), (2e-3, 0.01), (20e-3, 0.01)]
)
@pytest.mark.parametrize("radius", [16e-3, 30e-3])
def test_large_sphere_at_default_accuracy(radius, gap, allowed):
    assert accuracy.sphere_error(radius, gap) < allowed


def test_a_sphere_of_five_wavelengths_converges_with_a_matrix_of_mostly_low_rank_blocks():
    """At 0.3 % it has 5,616 unknowns. The error falls with what is asked, beyond what rounding to bfloat16 leaves."""
    scene, sources = (
        accuracy.ball(0.02),
        at.Monopoles(np.array([[0, 0, 0.0205], [0, 0.05, 0.01]]), np.eye(2)),
    )
    points = accuracy.directions(60, 3) * 0.15
    exact, found = at.SphereSeries().radiate(scene, sources).at(points), []
    for asked in (0.03, 0.01, 0.003):
        field = at.BoundaryElement(asked).radiate(scene, sources)
        found.append(accuracy.relative(field.at(points), exact).max())
        assert found[-1] < asked
        assert any("cross approximation" in line for line in field.report.citations)
    order = np.log(found[0] / found[-1]) / np.log(0.03 / 0.003)
    assert order > 0.9


@pytest.mark.parametrize("height", [0.0, 1e-4, 2e-4, 5e-4])
def test_pressure_on_and_near_the_surface(height):
    assert accuracy.surface_error(0.008, height) < 0.02


def test_pressure_at_the_nodes_of_the_surface():
    scene, sources = accuracy.ball(0.008), accuracy.one_each(accuracy.directions(8, 0) * 0.1)
    surface = at.BoundaryElement().radiate(scene, sources).on_surface
    points = 0.008 * surface.points / np.linalg.norm(surface.points, axis=1)[:, None]
    exact = at.SphereSeries().radiate(scene, sources).at(points)
    assert accuracy.relative(surface.pressure, exact).max() < 0.02
    assert surface.areas.sum() == pytest.approx(4 * np.pi * 0.008**2, rel=2e-3)


@pytest.mark.parametrize(("radii", "gap"), [((6e-3, 9e-3), 2e-3), ((8e-3, 8e-3), 12e-3)])
def test_two_spheres_against_multipoles(radii, gap):
    shapes = [
        at.sphere(radius, radius, centre=(side * (gap / 2 + radius), 0.0, 0.0))
        for side, radius in zip((-1, 1), radii, strict=True)
    ]
    scene = at.Scene(accuracy.PAPER_AIR, [at.sound_hard(shape) for shape in shapes])
    sources = np.array(
        [[gap / 2 - 5e-4, 0, 0], [0, 0, 4e-3], [-gap / 2 - radii[0], radii[0] + 5e-4, 0]]
    )
    points = accuracy.far_points(20)
    true, own = two_spheres.pressure_at(
        [s.primitive for s in shapes], scene.wavenumber, sources, points
    )
    found = at.BoundaryElement().radiate(scene, accuracy.one_each(sources)).at(points)
    assert own < 1e-3
    assert accuracy.relative(found, true).max() < 0.02


def test_two_short_fingers_against_fundamental_solutions():
    scene = accuracy.two_fingers(6e-3, 20, 8e-3, length=8e-3)
    sources, points = accuracy.finger_sources(scene, 0.5e-3), accuracy.outer_points(scene, 12)
    true = accuracy.reference(scene, sources, points)
    found = at.BoundaryElement().radiate(scene, accuracy.one_each(sources)).at(points)
    assert accuracy.relative(found, true).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    ("radius", "tilt", "gap"), [(6e-3, 0, 2e-3), (8e-3, 20, 12e-3), (12e-3, 45, 40e-3)]
)
def test_two_fingers_against_fundamental_solutions(radius, tilt, gap):
    error, own = accuracy.finger_error(radius, tilt, gap)
    assert own < 0.007
    assert error < 0.02


def test_error_falls_as_the_third_power_of_the_edge():
    edges, errors = accuracy.convergence()
    assert len(set(edges)) == 4
    assert accuracy.order(edges, errors) > 3


def test_absorption_is_solved_for():
    lossy = at.Medium(343.1, 1.293, absorption=20.0)
    scene = at.Scene(lossy, [at.sound_hard(at.sphere(0.006, 0.003))])
    sources = accuracy.one_each(accuracy.directions(8, 0) * 0.0065)
    found = at.BoundaryElement().radiate(scene, sources).at(accuracy.far_points())
    exact = at.SphereSeries().radiate(scene, sources).at(accuracy.far_points())
    assert accuracy.relative(found, exact).max() < 0.01


@pytest.mark.parametrize("index", [5, 12, 14, 31, 42])
def test_the_error_estimate_is_of_the_size_of_the_error(index):
    _, scene, sources = list(accuracy.estimate_scenes())[index]
    estimate, true = accuracy.estimate_and_error(scene, sources)
    assert 0.3 < estimate / true < 10


@pytest.mark.slow
def test_the_error_estimate_over_fifty_scenes():
    pairs = np.array(
        [accuracy.estimate_and_error(*scene[1:]) for scene in accuracy.estimate_scenes()]
    )
    ratio = pairs[:, 0] / pairs[:, 1]
    assert np.mean((ratio >= 0.3) & (ratio <= 10)) >= 0.95
    assert not np.any((pairs[:, 1] > 0.1) & (pairs[:, 0] < 0.1))


def test_twelve_iterations_for_two_fingers():
    scene = accuracy.two_fingers(8e-3, 20, 12e-3)
    report = (
        at.BoundaryElement(accuracy=0.1)
        .radiate(scene, accuracy.one_each(accuracy.finger_sources(scene, 5e-4)))
        .report
    )
    assert report.residual < 1e-2
    assert report.iterations <= 12


@pytest.mark.parametrize("gap", [0.0, 1e-7, 1e-6, 1e-5, 3e-5])
@pytest.mark.parametrize("radius", [2e-3, 5e-3])
def test_sources_micrometres_off_the_surface_are_as_accurate_as_on_it(radius, gap):
    assert accuracy.sphere_error(radius, gap) < 0.02
    assert accuracy.surface_error(radius, gap) < 0.02


@pytest.mark.parametrize("asked", [0.03, 0.01, 0.004])
def test_contact_beacons_on_both_pads_have_symmetric_fields(asked):
    """The pinch is its own mirror image, pads standing where panels meet."""
    fingers = at.pinch()
    scene = at.Scene(accuracy.PAPER_AIR, [at.sound_hard(surface) for surface in fingers.surfaces])
    field = at.BoundaryElement(accuracy=asked).radiate(
        scene, at.Target(fingers.foci(0.0)).beacons()
    )
    points = accuracy.far_points(30)
    found, mirrored = field.at(points), field.at(points * [-1, 1, 1])
    assert np.linalg.norm(found[:, 0] - mirrored[:, 1]) < 0.02 * np.linalg.norm(found[:, 0])


@pytest.mark.parametrize("offset", [-9e-10, -5e-10, 0.0, 1e-12, 1e-9, 1e-7])
@pytest.mark.parametrize("asked", [0.05, 0.01])
def test_contact_where_panels_meet_is_not_a_matter_of_rounding(asked, offset):
    """Sources on poles, vertices and edge midpoints of the mesh that the solver makes itself."""
    ball = at.sphere(0.01, 0.004)
    scene = at.Scene(accuracy.PAPER_AIR, [at.sound_hard(ball)])
    panels = ball.panelled(accuracy.PAPER_AIR.wavelength(40e3) * 0.6).quadratic_triangles
    ways = np.concatenate([[[0, 0, 1.0], [0, 0, -1.0]], panels[::9, 0], panels[::7, 4]])
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    sources = accuracy.one_each(ways * (0.01 + offset))
    found = at.BoundaryElement(accuracy=asked).radiate(scene, sources).at(accuracy.far_points(30))
    exact = at.SphereSeries().radiate(scene, sources).at(accuracy.far_points(30))
    assert accuracy.relative(found, exact).max() < max(0.02, asked)
