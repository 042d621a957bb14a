"""Surfaces against closed forms; every check of a surface."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airtact.geometry.pose import Pose
from airtact.geometry.primitives import Capsule, sphere
from airtact.geometry.surface import Surface, rigid_motion
from faults import raises_code
from geometry.mesh.meshes import box_mesh, torus_mesh

number = st.floats(-1.0, 1.0, allow_subnormal=False)
vector = st.tuples(number, number, number)
axis = vector.filter(lambda v: np.linalg.norm(v) > 1e-3)
pose = st.builds(Pose.turn, axis, st.floats(-6.28, 6.28), vector)


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
    depth = box(-half, half).depth(points)
    assert np.allclose(depth, inside - outside, rtol=0, atol=1e-15)


def test_the_depth_is_exact_beside_edges_and_corners(box):
    points = np.array(
        [
            [0.02, 0.02, 0.02],
            [0.0, 0.0, 0.02],
            [0.01, 0.01, 0.01],
            [0.0, 0.01, 0.01],
            [0.02, 0.02, 0.0],
        ]
    )
    depth = box((-0.01,) * 3, (0.01,) * 3).depth(points)
    assert depth == pytest.approx(
        [-math.sqrt(3) * 0.01, -0.01, 0.0, 0.0, -math.sqrt(2) * 0.01], abs=1e-17
    )


def test_flat_and_exact_depths_differ_by_the_sagitta_only_and_curved_ones_hardly(rng):
    exact = sphere(0.01, 0.001)
    flat = Surface(exact.vertices, exact.triangles, sharp_degrees=0)
    points = rng.normal(scale=0.008, size=(500, 3))
    sagitta = exact.edge_lengths.max() ** 2 / (6 * 0.01)
    gap = exact.depth(points) - flat.depth(points)
    assert gap.min() > -1e-15
    assert 0.5 * sagitta < gap.max() < sagitta
    curved = Surface(exact.vertices, exact.triangles)
    off_centre = points[exact.depth(points) < 0.007]
    assert np.abs(exact.depth(off_centre) - curved.depth(off_centre)).max() < 0.03 * sagitta


def test_curved_volume_is_that_of_the_quadratic_panels():
    # A box whose flat faces carry midpoints at the true middles is the same box.
    vertices, triangles = box_mesh()
    corners = vertices[triangles]
    curved = Surface(vertices, triangles, (corners + np.roll(corners, -1, axis=1)) / 2)
    flat = Surface(vertices, triangles)
    assert curved.volume == pytest.approx(flat.volume, rel=1e-13)
    assert curved.area == pytest.approx(flat.area, rel=1e-13)


@given(pose)
def test_moving_a_surface_moves_all_of_it(motion):
    body = Capsule(0.01, 0.02, Pose.identity()).mesh(0.02)
    moved = body.moved(motion)
    assert np.array_equal(moved.vertices, motion.apply(body.vertices))
    assert np.array_equal(moved.midpoints, motion.apply(body.midpoints))
    assert np.array_equal(moved.triangles, body.triangles)
    points = np.array([[0.003, -0.002, 0.015], [0.02, 0.01, -0.02]])
    assert np.allclose(moved.depth(motion.apply(points)), body.depth(points), rtol=0, atol=1e-15)
    assert moved.area == pytest.approx(body.area, rel=1e-12)
    assert moved.volume == pytest.approx(body.volume, rel=1e-9)


def test_the_motion_between_two_places_of_a_body_is_known_and_is_that_of_its_vertices():
    body = Capsule(0.01, 0.02, Pose.identity()).mesh(0.02)
    here = body.moved(Pose.turn((1, 2, 0), 0.7, (0.1, 0.0, 0.0)))
    there = here.moved(Pose.turn((0, 1, 1), 1.1, (0.0, -0.2, 0.1)))
    made_there = Surface(there.vertices, there.triangles, there.midpoints, there.primitive)
    for now in (there, made_there):
        motion, off = rigid_motion(here, now)
        assert off < 1e-12
        assert np.allclose(motion.apply(here.vertices), there.vertices, rtol=0, atol=1e-12)


def test_moving_a_flat_surface_keeps_what_was_found_about_it():
    crossing = Surface(*torus_mesh(0.01, 0.015))
    there = Pose.turn((1, 1, 0), 0.4, (0.3, 0.0, 0.0))
    fresh = Surface(there.apply(crossing.vertices), crossing.triangles)
    assert np.array_equal(crossing.moved(there).crossings, fresh.crossings)
    assert len(crossing.crossings) > 0
    assert np.array_equal(crossing.moved(there).crossings, crossing.crossings)


def test_a_surface_is_a_locked_copy(box):
    vertices, triangles = box_mesh()
    surface = Surface(vertices, triangles)
    vertices[:] = 0
    assert surface.volume > 0
    assert not any(
        a.flags.writeable for a in (surface.vertices, surface.triangles, surface.corners)
    )


@pytest.mark.parametrize("dtype", [np.int32, np.uint8, np.int64])
def test_any_integers_are_vertex_indices(dtype):
    vertices, triangles = box_mesh()
    assert Surface(vertices, triangles.astype(dtype)).triangles.dtype == np.int64


# ---- surfaces: guards


def test_an_open_surface_is_rejected_with_its_edges_and_their_place():
    vertices, triangles = box_mesh((0, 0, 0), (0.02, 0.03, 0.04))
    with raises_code("mesh_open", "4 edges", " 0.00) mm"):
        Surface(vertices, triangles[2:])  # without its bottom, all of whose edges lie at z = 0
    with raises_code("mesh_open", "3 edges"):
        Surface(vertices, triangles[1:])


def test_a_triangle_turned_round_is_rejected():
    vertices, triangles = box_mesh()
    triangles[5] = triangles[5, ::-1]
    with raises_code("mesh_not_oriented", "3 edges"):
        Surface(vertices, triangles)


def test_two_bodies_that_share_an_edge_are_rejected():
    one, triangles = box_mesh((0, 0, 0), (0.01, 0.01, 0.01))
    vertices = np.concatenate([one, one + [0.01, 0.01, 0.0]])
    other = np.arange(8, 16)
    other[[0, 4]] = [3, 7]  # the edge x = y = 10 mm stands in both
    with raises_code("mesh_not_oriented", "1 edge"):
        Surface(vertices, np.concatenate([triangles, other[triangles]]))


def test_an_inside_out_surface_is_rejected_with_its_volume():
    vertices, triangles = box_mesh((0, 0, 0), (0.01, 0.02, 0.03))
    with raises_code("mesh_faulty", "-6 cm³", "12 triangles"):
        Surface(vertices, triangles[:, ::-1])


def test_one_inside_out_piece_of_two_is_found():
    one, triangles = box_mesh((0, 0, 0), (0.03, 0.03, 0.03))
    two, _ = box_mesh((0.05, 0, 0), (0.06, 0.01, 0.01))
    with raises_code("mesh_faulty", "1 of 2 closed pieces", "-1 cm³"):
        Surface(np.concatenate([one, two]), np.concatenate([triangles, triangles[:, ::-1] + 8]))


def test_degenerate_triangles_are_rejected_with_their_number_and_place():
    vertices, triangles = box_mesh((0, 0, 0), (0.02, 0.02, 0.02))
    middle = len(vertices)
    a, b, c = triangles[0]
    split = np.array([[a, b, middle], [b, c, middle], [c, a, middle]])
    flat = np.concatenate(
        [vertices, vertices[[a, b]].mean(axis=0, keepdims=True)]
    )  # on the edge ab
    with raises_code("mesh_faulty", "1 triangle ", "triangle 11"):
        Surface(flat, np.concatenate([triangles[1:], split]))


def test_a_vertex_named_twice_is_degenerate():
    vertices, triangles = box_mesh()
    with raises_code("mesh_faulty", "2 triangles", "triangle 12 near ("):
        Surface(vertices, np.concatenate([triangles, [[0, 1, 1], [1, 0, 0]]]))


@pytest.mark.parametrize("index", [8, -1])
def test_indices_out_of_range_are_rejected(index):
    vertices, triangles = box_mesh()
    triangles[4, 1] = index
    with raises_code("out_of_range", f"triangle 4 names {index},", "from 0 to 7"):
        Surface(vertices, triangles)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_vertices_that_are_not_finite_are_rejected(value):
    vertices, triangles = box_mesh()
    vertices[6, 2] = value
    with raises_code("not_finite", "surface vertices hold 1 NaN", "[6, 2]"):
        Surface(vertices, triangles)


@pytest.mark.parametrize(
    ("scale", "code", "numbers"),
    [
        (1e3, "too_many", ("40 m", "2 m", "millimetres?")),
        (50.01, "too_many", ("2 m",)),
        (0.01, "out_of_range", ("0.4 mm", "0.5 mm", "millimetres")),
    ],
)
def test_bodies_too_large_or_too_small_are_rejected(scale, code, numbers):
    vertices, triangles = box_mesh((0, 0, 0), (0.02, 0.03, 0.04))
    with raises_code(code, *numbers):
        Surface(vertices * scale, triangles)


@pytest.mark.parametrize("scale", [50.0, 0.0125])
def test_the_largest_and_the_smallest_body_are_accepted(scale):
    vertices, triangles = box_mesh((0, 0, 0), (0.02, 0.03, 0.04))
    assert np.ptp(Surface(vertices * scale, triangles).vertices, axis=0).max() == pytest.approx(
        0.04 * scale
    )


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("vertices", "triangles", "code", "said"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3), dtype=int), "empty", "surface vertices"),
        (
            np.zeros((4, 3)),
            np.zeros((0, 3), dtype=int),
            "wrong_shape",
            "triangles have shape (0, 3)",
        ),
        (
            np.zeros((4, 2)),
            np.zeros((1, 3), dtype=int),
            "wrong_shape",
            "vertices have shape (4, 2)",
        ),
        (
            np.zeros((4, 3)),
            np.zeros((1, 4), dtype=int),
            "wrong_shape",
            "triangles have shape (1, 4)",
        ),
        (np.zeros((4, 3)), np.zeros((1, 3)), "not_a_number", "float64"),
    ],
)
def test_wrong_shapes_are_rejected(vertices, triangles, code, said):
    with raises_code(code, said):
        Surface(vertices, triangles)


@pytest.mark.usefixtures("as_outside_the_tests")
def test_midpoints_of_the_wrong_shape_are_rejected():
    with raises_code("wrong_shape", "(12, 3)", "12 triangles", "(12, 3, 3)"):
        Surface(*box_mesh(), np.zeros((12, 3)))


def test_midpoints_that_are_not_finite_are_rejected():
    body = sphere(0.01, 0.02)
    midpoints = body.midpoints.copy()
    midpoints[7, 1, 2] = np.nan
    with raises_code("not_finite", "midpoints hold 1 NaN", "[7, 1, 2]"):
        Surface(body.vertices, body.triangles, midpoints)


def test_midpoints_that_neighbours_do_not_share_are_rejected():
    body = sphere(0.01, 0.02)
    midpoints = body.midpoints.copy()
    midpoints[7, 1] += [0.0, 0.0, 0.001]
    with raises_code("mesh_faulty", "1 edge", " 1 mm apart"):
        Surface(body.vertices, body.triangles, midpoints)


def test_midpoints_far_off_their_edges_are_rejected():
    vertices, triangles = box_mesh((0, 0, 0), (0.02, 0.03, 0.04))
    corners = vertices[triangles]
    middles = (corners + np.roll(corners, -1, axis=1)) / 2
    middles[np.isclose(middles, [0.01, 0.0, 0.0]).all(axis=2)] -= [
        0.0,
        0.0,
        0.011,
    ]  # of an edge of 20 mm, in both
    with raises_code("mesh_faulty", " 11 mm", "0.55") as caught:
        Surface(vertices, triangles, middles)
    assert caught.value.position == pytest.approx([0.01, 0.0, -0.011])


def test_a_primitive_that_is_another_shape_is_rejected():
    ball = sphere(0.01, 0.004)
    with raises_code("not_supported", " 10 mm off") as caught:
        Surface(2.0 * ball.vertices, ball.triangles, primitive=ball.primitive)
    assert np.linalg.norm(caught.value.position) == pytest.approx(0.02)
    assert (
        Surface(ball.vertices, ball.triangles, primitive=ball.primitive).primitive is ball.primitive
    )
