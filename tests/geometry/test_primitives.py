"""Sphere and capsule against their closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import airtact as at
from airtact.geometry.mesh.intersections import self_crossings
from airtact.geometry.mesh.triangles import enclosed_volume
from airtact.geometry.primitives import Capsule, capsule, nearest_on_segments, sphere
from faults import raises_code

number = st.floats(-0.5, 0.5, allow_subnormal=False)
vector = st.tuples(number, number, number)
pose = st.builds(
    at.Pose.turn, vector.filter(lambda v: np.linalg.norm(v) > 1e-3), st.floats(-6.28, 6.28), vector
)
slenderness = st.one_of(st.just(0.0), st.floats(1e-5, 4.0))
rod = st.builds(lambda r, s, p: Capsule(r, s * r, p), st.floats(0.5e-3, 30e-3), slenderness, pose)


def angles(surface: at.Surface) -> np.ndarray:
    edges = np.roll(surface.corners, -1, axis=1) - surface.corners
    edges = edges / np.linalg.norm(edges, axis=2, keepdims=True)
    return np.degrees(np.arccos(-np.einsum("tki,tki->tk", edges, np.roll(edges, 1, axis=1))))


@given(rod, st.floats(0.3, 3.0))
def test_every_mesh_is_closed_round_well_shaped_and_on_the_shape(shape, relative_edge):
    edge = relative_edge * shape.radius
    surface = shape.mesh(edge)
    at.Surface(surface.vertices, surface.triangles, surface.midpoints, shape)  # which checks it
    assert surface.primitive.radius == shape.radius
    assert (
        len(surface.vertices) - 1.5 * len(surface.triangles) + len(surface.triangles) == 2
    )  # Euler: one sphere
    assert angles(surface).min() >= 30.0
    assert surface.edge_lengths.max() <= edge * (1 + 1e-12)
    assert np.abs(shape.depth(surface.vertices)).max() < 1e-15
    assert np.abs(shape.depth(surface.midpoints.reshape(-1, 3))).max() < 1e-15


@given(rod, pose, st.floats(0.3, 3.0))
def test_meshes_move_with_their_pose(shape, motion, relative_edge):
    edge = relative_edge * shape.radius
    meshed_there = shape.moved(motion).mesh(edge)
    moved_there = shape.mesh(edge).moved(motion)
    assert np.array_equal(meshed_there.triangles, moved_there.triangles)
    assert np.abs(meshed_there.vertices - moved_there.vertices).max() < 1e-12
    assert np.abs(meshed_there.midpoints - moved_there.midpoints).max() < 1e-12


@pytest.mark.parametrize("around", range(6, 17))
@pytest.mark.parametrize("length", [0.0, 3e-3, 20e-3])
def test_panels_are_closed_with_any_number_around(length, around):
    shape = Capsule(8e-3, length, at.Pose.turn((1, 2, 3), 0.7))
    panels = shape.panels(16e-3, 2 * np.pi / around)
    corners, triangles = np.unique(
        np.round(panels[:, :3].reshape(-1, 3), 9), axis=0, return_inverse=True
    )
    triangles = triangles.reshape(-1, 3)
    edges = np.sort(
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1
    )
    each, sides = np.unique(edges, axis=0, return_counts=True)
    assert (sides == 2).all()
    assert len(corners) - len(each) + len(triangles) == 2
    assert enclosed_volume(panels) == pytest.approx(shape.volume, rel=1e-3)
    height = (corners - shape.axis.mean(axis=0)) @ shape.pose.rotation[:, 2]
    assert length or np.count_nonzero(np.abs(height) < 1e-6) == around


@pytest.mark.parametrize("length", [0.0, 1e-5, 2e-3, 5e-3, 44e-3])
def test_no_mesh_crosses_itself(length):
    surface = Capsule(8e-3, length, at.Pose.turn((1, 2, 3), 0.7)).mesh(3e-3)
    assert len(self_crossings(surface.corners, surface.triangles)) == 0


@pytest.mark.parametrize("length", [0.0, 3e-3, 40e-3])
def test_area_and_volume_come_from_the_closed_forms_at_fourth_order(length):
    radius = 8e-3
    area = 4 * math.pi * radius**2 + 2 * math.pi * radius * length
    volume = 4 / 3 * math.pi * radius**3 + math.pi * radius**2 * length
    shape = Capsule(radius, length, at.Pose.identity())
    assert shape.area == pytest.approx(area, rel=1e-14)
    assert shape.volume == pytest.approx(volume, rel=1e-14)
    meshes = [shape.mesh(edge) for edge in (6e-3, 3e-3, 1.5e-3, 0.75e-3)]
    meshes = [at.Surface(mesh.vertices, mesh.triangles, mesh.midpoints) for mesh in meshes]
    edges = np.log([m.edge_lengths.max() for m in meshes])
    for truth, found in ((area, [m.area for m in meshes]), (volume, [m.volume for m in meshes])):
        errors = np.abs(np.array(found) / truth - 1)
        assert errors[-1] < 1e-5
        assert np.polyfit(edges, np.log(errors), 1)[0] > 3.8


@pytest.mark.parametrize(
    "direction", [(0, 0, 1), (0, 0, -1), (1e-9, 0, -1), (1, 0, 0), (0, 1, 1e-9), (0, -1, -1e-9)]
)
def test_a_capsule_may_point_anywhere(direction):
    end = 0.03 * np.array(direction, dtype=float)
    assert np.allclose(
        capsule((0, 0, 0), end, 0.005, 0.01).primitive.axis, [np.zeros(3), end], rtol=0, atol=1e-17
    )


def test_projecting_goes_straight_to_the_surface(rng):
    shape = Capsule(0.008, 0.04, at.Pose.turn((1, 1, 0), 0.5, (0.1, 0.0, 0.0)))
    points = shape.pose.translation + rng.normal(scale=0.02, size=(200, 3))
    skin = shape.project(points)
    assert np.abs(shape.depth(skin)).max() < 1e-16
    assert np.allclose(
        np.linalg.norm(skin - points, axis=1), np.abs(shape.depth(points)), rtol=0, atol=1e-16
    )


@pytest.mark.parametrize(
    ("make", "code", "said"),
    [
        (lambda: sphere(0.24e-3, 0.1e-3), "not_in_metres", "0.48 mm"),
        (lambda: sphere(8.0, 2.0), "not_in_metres", "16 m"),
        (lambda: capsule((0, 0, 0), (0, 0, 44), radius=8, edge=0.0025), "not_in_metres", "60 m"),
        (lambda: capsule((0, 0, 0), (0.0, 0.0, 1.99), 0.01, 0.02), "not_in_metres", "2.01 m"),
        (lambda: sphere(0.0, 0.1e-3), "out_of_range", "0 m"),
        (lambda: sphere(-0.01, 0.1e-3), "out_of_range", "-0.01 m"),
        (lambda: sphere(math.nan, 0.1e-3), "out_of_range", "nan m"),
        (lambda: sphere(0.01, 0.0), "out_of_range", "0 m"),
        (lambda: sphere(0.01, -1e-3), "out_of_range", "-0.001 m"),
        (lambda: sphere(0.01, math.inf), "out_of_range", "inf m"),
        (
            lambda: sphere(0.01, 1e-6),
            "out_of_range",
            "400",
        ),
        (
            lambda: sphere(0.01, 0.003, centre=(0.0, math.nan, 0.0)),
            "not_finite",
            "1 NaN",
        ),
        (
            lambda: capsule((0.0, 0.0, math.inf), (0, 0, 0), 0.01, 0.01),
            "not_finite",
            "1 NaN",
        ),
        (lambda: Capsule(0.01, -0.02, at.Pose.identity()), "out_of_range", "-0.02 m"),
        (lambda: Capsule(0.01, math.nan, at.Pose.identity()), "out_of_range", "nan m"),
    ],
)
def test_faults_are_rejected(make, code, said):
    with raises_code(code, said):
        make()


@pytest.mark.usefixtures("as_outside_the_tests")
def test_a_point_has_three_numbers():
    with raises_code("wrong_shape", "(2,)"):
        capsule((0, 0, 0), (1, 2), 0.01, 0.01)


@pytest.mark.parametrize(
    ("first", "second", "distance"),
    [
        ([[0, 0, 0], [1, 0, 0]], [[0, 2, 0], [1, 2, 0]], 2.0),  # parallel, side by side
        ([[0, 0, 0], [1, 0, 0]], [[4, 3, 0], [5, 3, 0]], np.hypot(3, 3)),  # parallel, past the end
        ([[0, 0, 0], [1, 0, 0]], [[3, 0, 0], [2, 0, 0]], 1.0),  # on one line
        ([[0, 0, 0], [2, 2, 0]], [[0, 2, 0], [2, 0, 0]], 0.0),  # crossing
        ([[0, 0, 0], [2, 2, 0]], [[0, 2, 5], [2, 0, 5]], 5.0),  # skew
        ([[0, 0, 0], [0, 0, 0]], [[3, 4, -1], [3, 4, 1]], 5.0),  # a point and a segment
        ([[3, 4, -1], [3, 4, 1]], [[0, 0, 0], [0, 0, 0]], 5.0),
        ([[1, 1, 1], [1, 1, 1]], [[1, 1, 3], [1, 1, 3]], 2.0),  # two points
    ],
)
def test_nearest_points_of_two_segments(first, second, distance):
    ends = nearest_on_segments(np.array(first, dtype=float), np.array(second, dtype=float))
    assert math.dist(*ends) == pytest.approx(distance, abs=1e-15)


def test_a_large_sphere_has_small_panels():
    panels = at.sphere(0.3, 0.05).shape.panels(0.015)
    assert len(panels) >= 1.35 * 4 * math.pi * 0.3**2 / (math.sqrt(3) / 4 * 0.015**2)
