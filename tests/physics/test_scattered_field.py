"""The scattered field alone: the total less the open-air pressure, and finite at the sources themselves."""

from dataclasses import replace

import numpy as np
import pytest

import airtact as at
from faults import raises_code

AIR = at.Medium(343.1, 1.293, absorption=0.1)
RADIUS = 6e-3
BALL = at.sphere(radius=RADIUS, edge=2.5e-3)
SCENE = at.Scene(AIR, [at.sound_hard(BALL)])
HEIGHTS = (3e-4, 2e-3, 0.05)
SOURCES = at.Monopoles(
    np.array([[0, 0, RADIUS + HEIGHTS[0]], [RADIUS + HEIGHTS[1], 0, 0], [0, 0.056, 0]]), np.eye(3)
)
TOUCHING = at.Monopoles(np.array([[0, 0, RADIUS], [0, 0.056, 0]]), np.eye(2))
POINTS = np.array(
    [
        [0.03, 0.01, 0.02],
        [0, 0, -RADIUS - 1e-4],
        [1e-3, 0, RADIUS + 1e-3],
        [0, 0.0561, 0],
        [0, 0, 0.14],
    ]
)

SOLVERS = {
    "series": at.SphereSeries(),
    "boundary element": at.BoundaryElement(accuracy=0.01),
    "boundary element, transposed only": at.BoundaryElement(accuracy=0.01, estimate=False),
    "factorised bodies": at.BoundaryElement(accuracy=0.01),
    "multipole expansion": at.SphereSeries(),
}
AWAY = ["boundary element, transposed only", "factorised bodies"]


def solved(name: str, sources: at.Monopoles = SOURCES) -> at.acoustics.RadiatedField:
    solver = SOLVERS[name]
    if name == "factorised bodies":
        assert isinstance(solver, at.BoundaryElement)
        return solver.factorised(SCENE, sources.positions).radiate(SCENE, sources)
    field = solver.radiate(SCENE, sources)
    return at.multipole_expansion(field) if name == "multipole expansion" else field


def image_series(height: float) -> complex:
    """Scattered pressure of a monopole at its own position, from the plain series of DLMF functions, height > 0."""
    from scipy.special import spherical_jn, spherical_yn

    k, order = SCENE.wavenumber, np.arange(90)
    ka, kr = k * RADIUS, k * (RADIUS + height)
    slope = spherical_jn(order, ka, True) / (
        spherical_jn(order, ka, True) + 1j * spherical_yn(order, ka, True)
    )
    outgoing = spherical_jn(order, kr) + 1j * spherical_yn(order, kr)
    return complex(-1j * k * np.sum((2 * order + 1) * slope * outgoing**2))


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("sources", [SOURCES, TOUCHING], ids=["off the surface", "touching it"])
def test_the_total_is_the_scattered_and_the_incident_pressure(name, sources):
    field = solved(name, sources)
    points = POINTS[[0, 3, 4]] if name in AWAY else POINTS
    incident = at.FreeField().radiate(replace(SCENE, obstacles=[]), sources).at(points)
    np.testing.assert_allclose(
        field.scattered_at(points) + incident, field.at(points), rtol=3e-5, atol=1e-5
    )  # phases in float32


@pytest.mark.parametrize("name", SOLVERS)
def test_at_the_sources_themselves_it_is_the_closed_form(name):
    field = solved(name)
    series = solved("series").scattered_at(SOURCES.positions)
    own = image_series(HEIGHTS[1]), image_series(HEIGHTS[2])
    np.testing.assert_allclose(np.diag(series)[1:], own, rtol=1e-7)
    some = [2] if name in AWAY else [0, 1, 2]  # the others are near the surface
    found = field.scattered_at(SOURCES.positions[some])
    assert np.isfinite(found).all()
    size = np.abs(np.diag(series))
    limit = 1e-3 if name == "multipole expansion" else 0.02 if "series" not in name else 1e-12
    assert (np.abs(found - series[some]) / np.sqrt(np.outer(size[some], size))).max() < limit


@pytest.mark.parametrize("name", ["series", "boundary element"])
def test_beside_a_source_it_goes_over_to_its_value_there(name):
    field = solved(name)
    beside = field.scattered_at(SOURCES.positions + [0, 2e-9, 0])
    np.testing.assert_allclose(beside, field.scattered_at(SOURCES.positions), rtol=1e-4)
    # at a source that touches a body and inside it, it is unknown
    points = np.array([[0, 0, RADIUS], [0, 0, 0.5 * RADIUS], [0, 0.056, 0]])
    unknown = np.isnan(solved(name, TOUCHING).scattered_at(points)).any(axis=1)
    assert unknown.tolist() == [True, True, False]


def test_many_points_in_cells_are_as_single_ones():
    field = solved("boundary element", at.Monopoles(SOURCES.positions[2:], np.ones(1)))
    along = np.linspace(-15e-3, 15e-3, 60)
    picture = np.stack(np.meshgrid(along, along, [9e-3], indexing="ij"), axis=-1).reshape(-1, 3)
    together, alone = field.scattered_at(picture)[::61], field.scattered_at(picture[::61])
    assert np.linalg.norm(together - alone) < 0.02 * np.linalg.norm(alone)


def test_without_the_direct_solution_points_near_the_surface_are_rejected():
    with raises_code("not_supported"):
        solved("boundary element, transposed only").scattered_at(SOURCES.positions[:1])


def test_a_filled_sphere_has_one_inside_too():
    scene = at.Scene(AIR, [at.filled(BALL, at.Medium(500.0, 3.0))])
    field = at.SphereSeries().radiate(scene, SOURCES)
    points = np.array([[0, 0, 0], [1e-3, 2e-3, -3e-3]])
    incident = at.FreeField().radiate(replace(scene, obstacles=[]), SOURCES).at(points)
    np.testing.assert_allclose(field.scattered_at(points) + incident, field.at(points), rtol=1e-9)


def test_open_air_scatters_nothing():
    field = at.FreeField().radiate(at.Scene(AIR, []), SOURCES)
    assert np.array_equal(field.scattered_at(SOURCES.positions), np.zeros((3, 3)))
    with raises_code("not_finite"):
        field.scattered_at(np.array([[np.nan, 0, 0]]))
