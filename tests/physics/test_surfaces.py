"""Any surface is solved for what its physics costs: meshes against closed forms and fundamental solutions."""

import numpy as np
import pytest
import trimesh

import airtact as at
from benchmarks import accuracy, surfaces
from references import ellipsoid

AXES = np.array([15, 10, 7]) * 1e-3


def bead(radius: float) -> at.Scene:
    mesh = trimesh.creation.icosphere(3, radius=radius)
    return surfaces.scene_of(np.array(mesh.vertices), np.array(mesh.faces))


@pytest.mark.parametrize("gap", [0.002, 0.02])
@pytest.mark.parametrize(("level", "noise"), [(4, 0.0), (6, 2e-5)])
def test_scanned_ellipsoids_against_fundamental_solutions(gap, level, noise):
    error, _, _, unknowns = surfaces.scanned_error(AXES, gap, level, noise)
    assert error < 0.02
    assert unknowns < 2600


def test_the_reference_of_ellipsoids_is_that_of_spheres():
    skin, normals, radius = ellipsoid.surface_points(np.full(3, 0.01), 8)
    assert radius == pytest.approx(0.01)
    sources, points = skin + 0.002 * normals, accuracy.far_points(30)
    found, own = ellipsoid.pressure_at(np.full(3, 0.01), surfaces.WAVENUMBER, sources, points)
    true = at.SphereSeries().radiate(accuracy.ball(0.01), accuracy.one_each(sources)).at(points)
    assert accuracy.relative(found, true).max() < 1e-3
    assert own < 1e-3


def test_a_scanned_sphere_converges_at_third_order():
    mesh = trimesh.creation.icosphere(5, radius=0.01)
    scene = surfaces.scene_of(np.array(mesh.vertices), np.array(mesh.faces))
    sources, points = accuracy.one_each(accuracy.directions(4, 0) * 0.03), accuracy.far_points(30)
    true = at.SphereSeries().radiate(accuracy.ball(0.01), sources).at(points)
    edges, errors = [], []
    for asked in (0.1, 0.03, 0.01, 0.003):
        solver = at.BoundaryElement(accuracy=asked)
        field = solver.radiate(scene, sources)
        edges.append(field.report.nodes_per_square_wavelength**-0.5)
        errors.append(accuracy.relative(field.at(points), true).max())
    assert np.polyfit(np.log(edges), np.log(errors), 1)[0] > 2.5
    assert errors[-1] < 1e-3


def test_a_sharp_cube_and_a_thin_plate_against_finer_panels():
    beside = np.array([[0, 0, 9.5], [9.5, 9, 2], [20, 10, 3], [0, 0, 30]]) * 1e-3
    error, volume, _ = surfaces.against_smaller_panels((0.015, 0.015, 0.015), beside)
    assert error < 0.03
    assert volume < 0.005
    before = np.array([[0, 0, 2], [10.5, 4, 1], [10, 0, 10], [0, 0, 30]]) * 1e-3
    error, volume, _ = surfaces.against_smaller_panels((0.02, 0.02, 0.0006), before)
    assert error < 0.03
    assert volume < 0.005


def test_a_bead_of_half_a_millimetre_scatters_as_the_series_says():
    """The little sound that it scatters, not the sum with all the sound that passes it."""
    radius = 0.00026
    sources = accuracy.one_each(accuracy.directions(4, 3) * (radius + 1e-3))
    points = accuracy.far_points(30)
    exact = at.SphereSeries().radiate(
        at.Scene(accuracy.PAPER_AIR, [at.sound_hard(at.sphere(radius, radius / 2))]), sources
    )
    free = at.FreeField().radiate(at.Scene(accuracy.PAPER_AIR, []), sources).at(points)
    found = at.BoundaryElement(precision="float64").radiate(bead(radius), sources).at(points)
    assert accuracy.relative(found - free, exact.at(points) - free).max() < 0.03


def test_a_mesh_that_moves_needs_no_new_panels_and_sounds_alike():
    vertices, triangles = (
        np.array(trimesh.creation.icosphere(3).vertices) * AXES,
        trimesh.creation.icosphere(3).faces,
    )
    surface = at.Surface(vertices, np.array(triangles))
    pose = at.Pose.turn((1, 2, 3), 0.8, translation=(0.3, -0.2, 0.1))
    positions, points = accuracy.directions(3, 1) * 0.02, accuracy.far_points(30)
    solver = at.BoundaryElement(precision="float64")
    here = solver.radiate(
        at.Scene(accuracy.PAPER_AIR, [at.sound_hard(surface)]), accuracy.one_each(positions)
    ).at(points)
    there = solver.radiate(
        at.Scene(accuracy.PAPER_AIR, [at.sound_hard(surface.moved(pose))]),
        accuracy.one_each(pose.apply(positions)),
    ).at(pose.apply(points))
    assert accuracy.relative(there, here).max() < 1e-9


def test_panels_far_off_the_triangles_are_told():
    """An icosahedron is taken for a ball; that its panels lie two millimetres off its triangles must be said."""
    mesh = trimesh.creation.icosahedron()
    mesh.apply_scale(0.012)
    scene = surfaces.scene_of(np.array(mesh.vertices), np.array(mesh.faces))
    field = at.BoundaryElement(accuracy=0.1).radiate(
        scene, accuracy.one_each(np.array([[0, 0, 0.03]]))
    )
    assert field.report.farthest_off_triangles > 2e-3
    assert any("off the triangles" in warning for warning in field.report.warnings)
    flat = at.Surface(np.array(mesh.vertices), np.array(mesh.faces), sharp_degrees=0)
    field = at.BoundaryElement(accuracy=0.1).radiate(
        at.Scene(accuracy.PAPER_AIR, [at.sound_hard(flat)]),
        accuracy.one_each(np.array([[0, 0, 0.03]])),
    )
    assert field.report.farthest_off_triangles < 1e-9
    assert not any("off the triangles" in warning for warning in field.report.warnings)


@pytest.mark.slow
def test_fifty_assorted_meshes_get_panels_that_hold_their_volume():
    from airtact.geometry.mesh.quadratic_triangles import enclosed_volume, smallest_angles
    from references.assorted_meshes import assorted

    count = 0
    for name, mesh in assorted():
        surface = at.Surface(*mesh)
        panels = surface.panelled(surfaces.EDGE).quadratic_triangles
        assert enclosed_volume(panels) == pytest.approx(surface.volume, rel=0.03), name
        narrow = 15 if name == "stick" else 20  # four strips of 1 mm, with edges of 4 mm
        assert np.median(smallest_angles(panels)) > narrow, name
        count += 1
    assert count == 50


@pytest.mark.slow
def test_damaged_meshes_are_mended_and_sound_right_or_refused():
    (line,) = surfaces.damaged_figures(60)
    assert " 0 wrong" in line, line
