"""Slices and surfaces show the field of the series for a sphere, to what a picture needs."""

import numpy as np
import pytest

import airtact as at
from airtact.evaluation.slices import slices_around, surface_pressure, window_pressure
from airtact.evaluation.windows import plane_through

AIR = at.Medium(sound_speed=343.1, density=1.293)
RADIUS = 8e-3
SOURCES = at.Monopoles(
    np.array([[0.05, -0.03, 0.06], [-0.02, 0.05, 0.05]]), np.array([[1.0, 0.3], [0.5j, 1.0]])
)
FOCI = np.array([[0.0, 0.0, 8.5e-3], [8.5e-3, 0.0, 0.0]])


def points_of(slices):
    index = np.stack(
        np.meshgrid(*map(np.arange, slices.depth.shape), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    return slices.corner + (index[:, ::-1] * slices.steps) @ slices.axes


@pytest.fixture(scope="module")
def scene():
    return at.Scene(AIR, [at.sound_hard(at.sphere(RADIUS, 2e-3))], 40e3)


@pytest.fixture(scope="module")
def solved(scene):
    return at.BoundaryElement(0.01).radiate(scene, SOURCES)


@pytest.fixture(scope="module")
def slices(scene, solved):
    window = plane_through(FOCI, scene.obstacles[0].surface.vertices, scene.wavelength)
    return slices_around(solved, [0, 1], FOCI, window)


def test_slices_show_the_field_to_a_few_percent(scene, slices):
    points = points_of(slices)
    away = np.linalg.norm(points, axis=1) - RADIUS
    exact = np.abs(at.SphereSeries().radiate(scene, SOURCES).at(points[away > 0]))
    drawn = slices.pressures.reshape(-1, 2)[away > 0]
    error = np.abs(drawn - exact) / exact.max(axis=0)
    near = away[away > 0] < 0.25 * scene.wavelength
    assert error.max() < 0.07
    assert np.sqrt(np.mean(error[near] ** 2)) < 0.02
    assert error[away[away > 0] > 0.4 * scene.wavelength].max() < 0.025


def test_the_box_stands_along_the_frame_round_the_foci_and_has_them_in_a_plane(slices, scene):
    np.testing.assert_array_equal(np.abs(slices.axes).sum(axis=0), 1.0)
    assert slices.any_axis
    last = slices.corner + (np.array(slices.depth.shape[::-1]) - 1) * slices.steps @ slices.axes
    lowest, highest = np.minimum(slices.corner, last), np.maximum(slices.corner, last)
    assert (lowest < FOCI.min(axis=0) - scene.wavelength).all()
    assert (highest > FOCI.max(axis=0) + scene.wavelength).all()
    heights = FOCI @ slices.axes[2] - slices.corner @ slices.axes[2]
    np.testing.assert_allclose(
        heights / slices.steps[2], round(heights[0] / slices.steps[2]), atol=1e-9
    )


def test_the_picture_of_a_plane_shows_the_field_to_one_percent(scene, solved):
    window = plane_through(FOCI, scene.obstacles[0].surface.vertices, scene.wavelength)
    depth = scene.depth(window.points)
    drawn = window_pressure(solved.for_pictures, window, depth)
    away = depth < 0.0
    assert np.isnan(drawn[~away]).all()
    exact = at.SphereSeries().radiate(scene, SOURCES).at(window.points[away])
    error = np.abs(drawn[away] - exact) / np.abs(exact).max(axis=0)
    assert np.sqrt(np.mean(error**2)) < 0.01
    assert error.max() < 0.07


def test_foci_far_apart_get_a_stack_of_planes():
    foci = np.array([[0.0, 0.0, 0.1], [0.16, 0.12, 0.1], [0.0, 0.12, 0.13]])
    field = at.FreeField().radiate(
        at.Scene(AIR, [], 40e3), at.Monopoles(np.array([[0.05, 0.05, -0.1]]), np.ones(1))
    )
    slices = slices_around(field, [0], foci, plane_through(foci, np.empty((0, 3)), 8.6e-3))
    assert not slices.any_axis
    exact = np.abs(field.at(points_of(slices))[:, 0])
    np.testing.assert_allclose(slices.pressures.ravel(), exact, rtol=0.05)


def test_surfaces_carry_the_pressure_on_them(scene, solved):
    computed = surface_pressure(solved, [1])
    assert computed is not None
    exact = np.abs(at.SphereSeries().radiate(scene, SOURCES).at(computed.vertices * (1 + 1e-9)))[
        :, 1
    ]
    assert np.abs(computed.pressures[:, 0] - exact).max() < 0.04 * exact.max()
    corners = computed.vertices[computed.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert edges.max() <= 0.3 * scene.wavelength * (1 + 1e-9)
