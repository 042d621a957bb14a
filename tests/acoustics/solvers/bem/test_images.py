"""Bodies before a rigid plane, against two bodies that mirror each other, which share no code with the images."""

import numpy as np
import pytest

import airtact as at
from references import before_a_plane, relative_columns
from worlds import AIR, one_each

TABLE = at.plane((0, 0, 0), (0, 0, 1))
RADIUS = 8e-3
SOURCES = np.array([[0.03, 0.02, 0.06], [0.0, RADIUS + 1e-3, RADIUS], [0.04, 0.0, 0.0]])
"""One away, one beside a ball that nearly rests on the plane, one on the plane."""

POINTS = np.array(
    [[0.05, 0.01, 0.03], [-0.06, 0.02, 0.09], [0.012, 0, 0], [0.05, 0.03, 0], [0.004, 0.001, 0]]
)
"""Two away, three on the plane, the last one under the ball."""


def over(height: float) -> at.Scene:
    ball = at.sphere(RADIUS, RADIUS, centre=(0, 0, height + RADIUS))
    return at.Scene(AIR, [at.sound_hard(ball)], planes=[TABLE])


@pytest.mark.parametrize(
    "height",
    [
        *(pytest.param(height, marks=pytest.mark.slow) for height in (2e-4, 5e-4, 1e-3, 2e-3)),
        5e-3,
        40e-3,
    ],
)
def test_a_sphere_over_a_plane_is_the_series_of_two(height):
    scene = over(height)
    field = at.BoundaryElement(accuracy=0.01).radiate(scene, one_each(SOURCES))
    exact, own = before_a_plane.sphere_pressure(scene, SOURCES, POINTS)
    assert own < 1e-4
    assert relative_columns(field.at(POINTS), exact).max() < 0.01
    assert (
        relative_columns(
            field.scattered_at(POINTS[:2]), exact[:2] - field._incident(POINTS[:2])
        ).max()
        < 0.03
    )
    assert field.report.estimated_error < 0.01
    assert field.report.settings["rigid_planes"] == 1


def test_double_precision_too_and_with_absorption():
    medium = at.Medium(343.1, 1.293, absorption=2.0)
    tilted = at.plane((0.01, -0.02, 0.005), (1, 2, 2))
    away = 0.012 * tilted.normal
    scene = at.Scene(
        medium, [at.sound_hard(at.sphere(5e-3, 2e-3, tuple(tilted.point + away)))], planes=[tilted]
    )
    sources = one_each(tilted.point + 0.03 * np.eye(3))
    points = tilted.point + np.array([[0.05, 0.01, 0.02], [0.01, 0.04, 0.03]])
    exact, own = before_a_plane.sphere_pressure(scene, sources.positions, points)
    assert own < 1e-4
    assert (
        relative_columns(
            at.BoundaryElement(1e-3, "float64").radiate(scene, sources).at(points), exact
        ).max()
        < 1e-3
    )


def test_a_mesh_over_a_plane_is_what_it_and_its_image_are_as_two_bodies(box):
    body = box((-0.006, -0.004, 0.002), (0.007, 0.005, 0.009))
    mirrored = at.Surface(body.vertices * [1, 1, -1], body.triangles[:, ::-1])
    both = np.concatenate([SOURCES, SOURCES * [1, 1, -1]])
    twice = at.Scene(AIR, [at.sound_hard(body), at.sound_hard(mirrored)])
    once = at.Scene(AIR, [at.sound_hard(body)], planes=[TABLE])
    solver = at.BoundaryElement(accuracy=0.003)
    found = solver.radiate(once, one_each(SOURCES))
    whole = solver.radiate(twice, at.Monopoles(both, np.tile(np.eye(3), (2, 1))))
    assert relative_columns(found.at(POINTS), whole.at(POINTS)).max() < 0.003
    assert found.report.nodes == pytest.approx(whole.report.nodes / 2, rel=0.1)
    top = np.array([[0.001, 0.001, 0.0093], [-0.002, 0.0, 0.0097]])
    assert relative_columns(found.velocity(top)[:, 2], whole.velocity(top)[:, 2]).max() < 0.02


def test_the_field_knows_where_it_is_and_is_reciprocal():
    scene = over(1e-3)
    behind = np.array([[0.02, 0.0, -1e-4], [0.0, 0.0, -0.01]])
    pair = np.array([[0.04, 0.0, 0.0], [0.02, -0.03, 0.05]])
    field = at.BoundaryElement(accuracy=0.01).radiate(scene, one_each(pair))
    assert field.valid(np.concatenate([POINTS, behind])).tolist() == [True] * 5 + [False] * 2
    assert np.isnan(field.at(behind)).all()
    assert np.isnan(field.velocity(behind)).all()
    assert np.isnan(
        field.scattered_at(pair)[0, 0]
    )  # the image of a source on the plane stands on it
    there, back = (
        at.BoundaryElement(accuracy=0.01)
        .radiate(scene, at.Monopoles(one[None], np.ones(1)))
        .at(other[None])[0, 0]
        for one, other in (pair, pair[::-1])
    )
    assert abs(there - back) < 3e-3 * abs(there)
    assert len(field.on_surface.points) == field.report.nodes
    assert field.on_surface.points[:, 2].min() > 0.0
    slope = field.velocity(np.array([[0.03, 0.01, 0.0]]))[0]
    assert np.abs(slope[2]).max() < 1e-6 * np.abs(slope[0]).max()  # nothing moves through the plane
