"""Any surface is solved at the cost of its physics: meshes against closed forms and references."""

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.geometry.mesh.triangles import enclosed_volume, smallest_angles
from references import axisymmetric, ellipsoid, relative_columns
from references.assorted_meshes import assorted
from worlds import WAVELENGTH, ball, directions, far_points, hard, one_each

AXES = np.array([15, 10, 7]) * 1e-3


def surface_of(mesh: trimesh.Trimesh, **options: float) -> at.Surface:
    return at.Surface(np.array(mesh.vertices), np.array(mesh.faces), **options)


def icosphere(level: int, radius: float) -> at.Scene:
    return hard(surface_of(trimesh.creation.icosphere(level, radius=radius)))


@pytest.mark.parametrize(
    ("level", "noise", "gaps"),
    [
        (4, 0.0, [0.002]),
        pytest.param(4, 0.0, [0.02], marks=pytest.mark.slow),
        pytest.param(6, 2e-5, [0.002, 0.02], marks=pytest.mark.slow),
    ],
)
def test_scanned_ellipsoids_against_fundamental_solutions(level, noise, gaps):
    """5,120 triangles at level 4; 81,920 at level 6, rough along its normals."""
    mesh = trimesh.creation.icosphere(level)
    vertices = np.array(mesh.vertices) * AXES
    normals = vertices / AXES**2
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rough = noise * np.random.default_rng(1).standard_normal((len(vertices), 1)) * normals
    scene = hard(at.Surface(vertices + rough, np.array(mesh.faces)))
    skin, outward, _ = ellipsoid.surface_points(AXES, 8)
    for gap in gaps:
        positions = skin + gap * outward
        exact, own_error = ellipsoid.pressure_at(
            AXES, 2 * np.pi / WAVELENGTH, positions, far_points()
        )
        assert own_error < 1e-3
        field = at.BoundaryElement().radiate(scene, one_each(positions))
        assert relative_columns(field.at(far_points()), exact).max() < 0.02
        assert field.report.nodes < 2600


@pytest.mark.parametrize(
    ("accuracy", "polar"), [(0.03, 10.3e-3), pytest.param(0.01, 8.9e-3, marks=pytest.mark.slow)]
)
def test_the_pressure_on_the_tips_of_a_meshed_spheroid_against_rings(accuracy, polar):
    """Half axes of 3.8 mm and ``polar``, as triangles; the rings stand inside the exact spheroid."""
    meridian = axisymmetric.spheroid(3.8e-3, polar)
    triangles = axisymmetric.surface(meridian, 0.5e-3)
    source = 0.06 * directions(1, 1)
    scene = hard(at.Surface(triangles.vertices, triangles.triangles))
    field = at.BoundaryElement(accuracy=accuracy).radiate(scene, one_each(source))
    exact = axisymmetric.fitted([meridian], 2 * np.pi / WAVELENGTH, source, 3.0)
    assert exact.residual < 1e-3
    surface = field.on_surface
    true = exact.pressure(surface.points)
    area = surface.areas[:, None]
    off = np.sqrt((area * np.abs(surface.pressure - true) ** 2).sum())
    assert off < 2 * accuracy * np.sqrt((area * np.abs(true) ** 2).sum())


@pytest.mark.parametrize(
    ("size", "sources"),
    [
        ((15, 15, 15), [[0, 0, 9.5], [9.5, 9, 2], [20, 10, 3], [0, 0, 30]]),
        ((20, 20, 0.6), [[0, 0, 2], [10.5, 4, 1], [10, 0, 10], [0, 0, 30]]),
    ],
    ids=["sharp cube", "thin plate"],
)
def test_boxes_against_finer_panels(size, sources):
    box = 1e-3 * np.array(size)
    scene = hard(surface_of(trimesh.creation.box(box)))
    beacons = one_each(1e-3 * np.array(sources))
    coarse, fine = (at.BoundaryElement(a).radiate(scene, beacons) for a in (0.02, 0.004))
    assert relative_columns(coarse.at(far_points()), fine.at(far_points())).max() < 0.03
    volume = enclosed_volume(coarse.surface.nodes.quadratic_triangles)
    assert volume == pytest.approx(np.prod(box), rel=0.005)


def test_a_bead_of_half_a_millimetre_scatters_as_the_series_says():
    """The scattered sound alone, which is small beside the sound that passes."""
    radius = 0.00026
    sources = one_each(directions(4, 3) * (radius + 1e-3))
    exact = at.SphereSeries().radiate(ball(radius), sources).scattered_at(far_points(30))
    solver = at.BoundaryElement(precision="float64")
    values = solver.radiate(icosphere(3, radius), sources).scattered_at(far_points(30))
    assert relative_columns(values, exact).max() < 0.03


def test_panels_far_off_the_triangles_are_reported():
    """An icosahedron is taken for a ball, whose panels lie two millimetres off its triangles."""
    mesh = trimesh.creation.icosahedron()
    mesh.apply_scale(0.012)
    source = one_each(np.array([[0, 0, 0.03]]))
    for options, curved in (({}, True), ({"sharp_degrees": 0}, False)):
        scene = hard(surface_of(mesh, **options))
        report = at.BoundaryElement(accuracy=0.1).radiate(scene, source).report
        off = report.farthest_off_triangles
        assert off > 2e-3 if curved else off < 1e-9
        assert bool(report.warnings) == curved


@pytest.mark.slow
def test_fifty_assorted_meshes_get_panels_that_hold_their_volume():
    count = 0
    for name, mesh in assorted():
        surface = at.Surface(*mesh)
        panels = surface.panelled(0.638 * WAVELENGTH).quadratic_triangles
        assert enclosed_volume(panels) == pytest.approx(surface.volume, rel=0.03), name
        narrow = 15 if name == "stick" else 20  # four strips of 1 mm, with edges of 4 mm
        assert np.median(smallest_angles(panels)) > narrow, name
        count += 1
    assert count == 50
