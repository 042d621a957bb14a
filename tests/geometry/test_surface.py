"""Surfaces against closed forms; every check of a surface."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import airtact as at
from airtact.geometry.primitives import Capsule
from airtact.geometry.surface import rigid_motion
from faults import raises_code
from geometry.mesh.meshes import box_mesh

number = st.floats(-1.0, 1.0, allow_subnormal=False)
vector = st.tuples(number, number, number)
axis = vector.filter(lambda v: np.linalg.norm(v) > 1e-3)
pose = st.builds(at.Pose.turn, axis, st.floats(-6.28, 6.28), vector)


# ---- surfaces: closed forms


def test_a_box_has_its_area_and_volume(box):
    surface = box((-0.01, 0.0, 0.0), (0.01, 0.03, 0.04))
    assert surface.area == pytest.approx(2 * (0.02 * 0.03 + 0.03 * 0.04 + 0.04 * 0.02), rel=1e-14)
    assert surface.volume == pytest.approx(0.02 * 0.03 * 0.04, rel=1e-14)
    diagonals = [math.hypot(0.02, 0.03), math.hypot(0.03, 0.04), math.hypot(0.04, 0.02)]
    assert sorted(set(np.round(surface.edge_lengths.ravel(), 12))) == pytest.approx(
        sorted([0.02, 0.03, 0.04, *diagonals])
    )


def test_the_depth_in_a_box_is_the_closed_form(box, rng):
    half = np.array([0.01, 0.015, 0.02])
    points = rng.uniform(-0.03, 0.03, (2000, 3))
    outside = np.linalg.norm(np.maximum(np.abs(points) - half, 0), axis=1)
    inside = np.maximum((half - np.abs(points)).min(axis=1), 0)
    assert np.allclose(box(-half, half).depth(points), inside - outside, rtol=0, atol=1e-15)


def test_flat_and_exact_depths_differ_by_the_sagitta_only_and_curved_ones_hardly(rng):
    exact = at.sphere(0.01, 0.001)
    flat = at.Surface(exact.vertices, exact.triangles, sharp_degrees=0)
    points = rng.normal(scale=0.008, size=(500, 3))
    sagitta = exact.edge_lengths.max() ** 2 / (6 * 0.01)
    gap = exact.depth(points) - flat.depth(points)
    assert gap.min() > -1e-15
    assert 0.5 * sagitta < gap.max() < sagitta
    curved = at.Surface(exact.vertices, exact.triangles)
    off_centre = points[exact.depth(points) < 0.007]
    assert np.abs(exact.depth(off_centre) - curved.depth(off_centre)).max() < 0.03 * sagitta


@given(pose)
def test_moving_a_surface_moves_all_of_it(motion):
    body = Capsule(0.01, 0.02, at.Pose.identity()).mesh(0.02)
    moved = body.moved(motion)
    assert np.array_equal(moved.vertices, motion.apply(body.vertices))
    assert np.array_equal(moved.midpoints, motion.apply(body.midpoints))
    assert np.array_equal(moved.triangles, body.triangles)
    points = np.array([[0.003, -0.002, 0.015], [0.02, 0.01, -0.02]])
    assert np.allclose(moved.depth(motion.apply(points)), body.depth(points), rtol=0, atol=1e-15)
    assert moved.area == pytest.approx(body.area, rel=1e-12)
    assert moved.volume == pytest.approx(body.volume, rel=1e-9)


def test_the_motion_between_two_places_of_a_body_is_known_and_is_that_of_its_vertices():
    body = Capsule(0.01, 0.02, at.Pose.identity()).mesh(0.02)
    here = body.moved(at.Pose.turn((1, 2, 0), 0.7, (0.1, 0.0, 0.0)))
    there = here.moved(at.Pose.turn((0, 1, 1), 1.1, (0.0, -0.2, 0.1)))
    made_there = at.Surface(there.vertices, there.triangles, there.midpoints, there.primitive)
    for now in (there, made_there):
        motion, off = rigid_motion(here, now)
        assert off < 1e-12
        assert np.allclose(motion.apply(here.vertices), there.vertices, rtol=0, atol=1e-12)


def test_a_surface_is_a_locked_copy(box):
    vertices, triangles = box_mesh()
    surface = at.Surface(vertices, triangles)
    vertices[:] = 0
    assert surface.volume > 0
    assert not any(
        a.flags.writeable for a in (surface.vertices, surface.triangles, surface.corners)
    )


# ---- surfaces: guards


def two_boxes(shift, reverse: bool = False) -> tuple[np.ndarray, np.ndarray]:
    one, triangles = box_mesh((0, 0, 0), (0.03, 0.03, 0.03))
    two, _ = box_mesh((0, 0, 0), (0.01, 0.01, 0.01))
    second = triangles[:, ::-1] if reverse else triangles
    return np.concatenate([one, two + shift]), np.concatenate([triangles, second + 8])


def with_shared_edge() -> tuple[np.ndarray, np.ndarray]:
    one, triangles = box_mesh((0, 0, 0), (0.01, 0.01, 0.01))
    other = np.arange(8, 16)
    other[[0, 4]] = [3, 7]  # the edge x = y = 10 mm stands in both
    vertices = np.concatenate([one, one + [0.01, 0.01, 0.0]])
    return vertices, np.concatenate([triangles, other[triangles]])


def with_flat_triangle() -> tuple[np.ndarray, np.ndarray]:
    vertices, triangles = box_mesh((0, 0, 0), (0.02, 0.02, 0.02))
    a, b, c = triangles[0]
    on_edge = vertices[[a, b]].mean(axis=0, keepdims=True)
    split = np.array([[a, b, 8], [b, c, 8], [c, a, 8]])
    return np.concatenate([vertices, on_edge]), np.concatenate([triangles[1:], split])


def changed(place, vertex: float | None = None, index: int | None = None):
    vertices, triangles = box_mesh()
    if vertex is not None:
        vertices[place] = vertex
    if index is not None:
        triangles[place] = index
    return vertices, triangles


BOX = box_mesh()
TURNED = BOX[1].copy()
TURNED[5] = TURNED[5, ::-1]


@pytest.mark.parametrize(
    ("mesh", "code", "values"),
    [
        ((BOX[0], BOX[1][2:]), "mesh_open", ["4 edges", " 0.00) mm"]),  # without its bottom
        ((BOX[0], BOX[1][1:]), "mesh_open", ["3 edges"]),
        ((BOX[0], TURNED), "mesh_not_oriented", ["3 edges"]),
        (with_shared_edge(), "mesh_not_oriented", ["1 edge"]),
        ((BOX[0], BOX[1][:, ::-1]), "mesh_faulty", ["12 triangles"]),
        (two_boxes([0.05, 0.0, 0.0], reverse=True), "mesh_faulty", ["1 of 2", "12 triangles"]),
        (with_flat_triangle(), "mesh_faulty", ["1 triangle ", "triangle 11"]),
        (
            (BOX[0], np.concatenate([BOX[1], [[0, 1, 1], [1, 0, 0]]])),
            "mesh_faulty",
            ["2 triangles", "triangle 12"],
        ),
        (changed((4, 1), index=8), "out_of_range", ["triangle 4 names 8,", "from 0 to 7"]),
        (changed((4, 1), index=-1), "out_of_range", ["triangle 4 names -1,"]),
        (changed((6, 2), vertex=np.nan), "not_finite", ["1 NaN", "[6, 2]"]),
        (changed((6, 2), vertex=np.inf), "not_finite", ["[6, 2]"]),
        ((BOX[0] * 1e3, BOX[1]), "not_in_metres", ["40 m", "2 m"]),
        ((BOX[0] * 50.01, BOX[1]), "not_in_metres", ["2 m"]),
        ((BOX[0] * 0.01, BOX[1]), "not_in_metres", ["0.4 mm", "0.5 mm"]),
    ],
)
def test_faulty_meshes_are_rejected_with_their_number_and_place(mesh, code, values):
    with raises_code(code, *values):
        at.Surface(*mesh)


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("arrays", "code", "value"),
    [
        ((np.zeros((0, 3)), np.zeros((0, 3), dtype=int)), "empty", ""),
        ((np.zeros((4, 3)), np.zeros((0, 3), dtype=int)), "wrong_shape", "(0, 3)"),
        ((np.zeros((4, 2)), np.zeros((1, 3), dtype=int)), "wrong_shape", "(4, 2)"),
        ((np.zeros((4, 3)), np.zeros((1, 4), dtype=int)), "wrong_shape", "(1, 4)"),
        ((np.zeros((4, 3)), np.zeros((1, 3))), "not_a_number", "float64"),
        ((*BOX, np.zeros((12, 3))), "wrong_shape", "(12, 3, 3)"),
    ],
)
def test_wrong_shapes_are_rejected(arrays, code, value):
    with raises_code(code, value):
        at.Surface(*arrays)


@pytest.mark.parametrize(
    ("place", "change", "code", "values"),
    [
        ((7, 1, 2), np.nan, "not_finite", ["1 NaN", "[7, 1, 2]"]),
        ((7, 1), np.array([0.0, 0.0, 0.001]), "mesh_faulty", ["1 edge", " 1 mm"]),  # not shared
    ],
)
def test_faulty_midpoints_are_rejected(place, change, code, values):
    body = at.sphere(0.01, 0.02)
    midpoints = body.midpoints.copy()
    midpoints[place] += change
    with raises_code(code, *values):
        at.Surface(body.vertices, body.triangles, midpoints)


def test_midpoints_far_off_their_edges_are_rejected():
    vertices, triangles = box_mesh((0, 0, 0), (0.02, 0.03, 0.04))
    corners = vertices[triangles]
    middles = (corners + np.roll(corners, -1, axis=1)) / 2
    on_edge = np.isclose(middles, [0.01, 0.0, 0.0]).all(axis=2)  # of 20 mm, in both triangles
    middles[on_edge] -= [0.0, 0.0, 0.011]
    with raises_code("mesh_faulty", " 11 mm", "0.55") as caught:
        at.Surface(vertices, triangles, middles)
    assert caught.value.position == pytest.approx([0.01, 0.0, -0.011])
