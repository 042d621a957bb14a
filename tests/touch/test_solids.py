"""Depths in solids against closed forms, and in meshes against the exact mesh."""

import numpy as np
import pytest

import airtact as at
from airtact.touch import Box, Button, Cylinder, HalfSpace
from airtact.touch.solids import solid_of

SOLIDS = [
    Box((0.03, 0.02, 0.01), (0.01, 0.0, 0.02)),
    Cylinder((0.01, 0.0, 0.0), (0.02, 0.02, 0.02), radius=0.008),
    HalfSpace((0.0, 0.01, 0.0), (0.0, 1.0, 2.0)),
    Button((0.01, 0.0, 0.01), radius=0.01, travel=0.004, normal=(1.0, 1.0, 0.0)),
]


@pytest.mark.parametrize("solid", SOLIDS, ids=lambda solid: type(solid).__name__)
def test_the_depth_is_a_distance(solid, rng) -> None:
    points = rng.uniform(-0.05, 0.05, (4000, 3))
    steps = 1e-6 * np.eye(3)
    gradient = [(solid.depth(points + step) - solid.depth(points - step)) / 2e-6 for step in steps]
    slope = np.linalg.norm(gradient, axis=0)
    # 1 except on the few points next to a ridge inside
    assert np.quantile(slope, 0.01) == pytest.approx(1.0, abs=1e-3)
    assert slope.max() < 1.0 + 1e-6


@pytest.mark.parametrize("solid", SOLIDS, ids=lambda solid: type(solid).__name__)
def test_the_mesh_for_pictures_lies_on_the_surface(solid) -> None:
    vertices, triangles = solid.mesh()
    if isinstance(solid, Button):  # only its upper part is drawn
        vertices = vertices[solid.depth(vertices) < 1e-6]
    assert np.abs(solid.depth(vertices)).max() < 1e-6
    assert triangles.max() < len(solid.mesh()[0])


@pytest.mark.parametrize("solid", SOLIDS, ids=lambda solid: type(solid).__name__)
def test_the_ball_holds_the_solid(solid, rng) -> None:
    centre, radius = solid.ball()
    points = rng.uniform(-0.05, 0.05, (4000, 3))
    inside = points[solid.depth(points) > 0.0]
    assert np.linalg.norm(inside - centre, axis=1).max() <= radius


def test_depths_at_known_points() -> None:
    box = Box((0.04, 0.02, 0.02))
    corner_off = np.array([[0.02 + 0.003, 0.01 + 0.004, 0.0]])
    assert box.depth(corner_off) == pytest.approx(-0.005)
    rod = Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.1), radius=0.01)
    rim_off = np.array([[0.013, 0.0, 0.104], [0.004, 0.0, 0.05], [0.0, 0.0, 0.001]])
    np.testing.assert_allclose(rod.depth(rim_off), [-0.005, 0.006, 0.001], atol=1e-12)


def test_the_solid_of_a_mesh_states_its_error(box, rng) -> None:
    sides = np.array([0.04, 0.02, 0.03])
    mesh = box(-sides / 2, sides / 2)
    grid = solid_of(mesh)
    points = rng.uniform(-0.5, 0.5, (2000, 3)) * (sides + 2e-3)
    error = np.abs(grid.depth(points) - Box(tuple(sides)).depth(points))
    assert grid.error < 0.1e-3
    assert np.sqrt(np.mean(error**2)) < 2.0 * grid.error
    assert error.max() < 1.1e-3  # less than the step, along the ridges of the distance
    away = points + [0.05, 0.0, 0.0]
    far = grid.depth(away) - Box(tuple(sides)).depth(away)
    assert far.min() > -1e-3  # beyond the grid it may seem nearer, but not inside
    assert grid.depth(away)[away[:, 0] > 0.5 * sides[0]].max() < 0.0


def test_a_moved_object_keeps_its_shape(rng) -> None:
    pose = at.Pose.turn((1.0, 2.0, 0.5), 0.7, translation=(0.1, 0.0, -0.05))
    points = rng.uniform(-0.05, 0.05, (200, 3))
    for shape in (*SOLIDS, at.capsule((0, 0, 0), (0, 0, 0.02), radius=0.01, edge=0.004)):
        thing = at.VirtualObject(shape)
        np.testing.assert_allclose(
            thing.moved(pose).depth(pose.apply(points)), thing.depth(points), atol=1e-12
        )


@pytest.mark.parametrize(
    ("code", "make"),
    [
        ("out_of_range", lambda: Box((0.02, 0.0, 0.02))),
        ("not_in_metres", lambda: Box((20.0, 20.0, 20.0))),
        ("not_in_metres", lambda: Box((0.02, 0.02, 0.02), (0.0, 0.0, 150.0))),
        ("not_finite", lambda: Cylinder((0, 0, np.nan), (0, 0, 1), radius=0.01)),
        ("out_of_range", lambda: Cylinder((0, 0, 0), (0, 0, 0), radius=0.01)),
        ("all_zero", lambda: HalfSpace((0, 0, 0), (0, 0, 0))),
        ("out_of_range", lambda: Button((0, 0, 0), radius=0.01, travel=-1e-3)),
        ("wrong_kind", lambda: at.VirtualObject(0.012)),
        ("unknown_name", lambda: at.VirtualObject(SOLIDS[0], style="dots")),
        ("options_clash", lambda: at.VirtualObject(SOLIDS[0], style="texture")),
        ("out_of_range", lambda: at.VirtualObject(SOLIDS[0], stiffness=0.0)),
        ("not_in_metres", lambda: at.VirtualObject(SOLIDS[0], at.Pose.shift((0, 0, 150)))),
        ("not_finite", lambda: at.VirtualObject(SOLIDS[0], at.Pose.shift((0, 0, np.inf)))),
        ("out_of_range", lambda: at.touch.Grating(4.0)),
        ("out_of_range", lambda: at.touch.HeightMap(np.full((3, 3), 255.0), 0.02)),
    ],
)
def test_impossible_objects_are_rejected(code, make, as_outside_the_tests) -> None:
    with pytest.raises(at.InvalidInput) as caught:
        make()
    assert caught.value.code == code
