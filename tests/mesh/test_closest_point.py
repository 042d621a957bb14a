"""Closest points held to what defines them: no point of a convex set lies beyond the plane through the nearest one."""

import numpy as np
import pytest

from airtact.mesh.closest_point import (
    closest_on_segments,
    closest_on_triangles,
    segment_distances,
    signed_distance,
    size_groups,
)
from airtact.surfaces.files import load_surface
from mesh.meshes import box_mesh, torus_mesh


def beyond(points: np.ndarray, nearest: np.ndarray, corners: np.ndarray) -> float:
    """How far any corner reaches past the plane through the nearest point: at most 0 for the true one."""
    gap = points - nearest
    length = np.maximum(np.linalg.norm(gap, axis=1), 1e-300)
    return float((np.einsum("ni,nki->nk", gap, corners - nearest[:, None]) / length[:, None]).max())


def test_the_nearest_point_of_a_triangle(rng):
    corners = rng.normal(size=(5000, 3, 3))
    points = rng.normal(scale=2.0, size=(5000, 3))
    weights = closest_on_triangles(points, corners)
    assert weights.min() >= 0.0
    assert np.allclose(weights.sum(axis=1), 1.0, rtol=0, atol=1e-14)
    nearest = np.einsum("nk,nki->ni", weights, corners)
    assert beyond(points, nearest, corners) < 1e-12
    assert {int((w == 0).sum()) for w in weights} == {0, 1, 2}  # faces, edges and corners are all met


def test_the_nearest_point_of_a_sliver(rng):
    corners = rng.normal(size=(2000, 3, 3))
    corners[:, 2] = corners[:, :2].mean(axis=1) + 1e-5 * rng.normal(size=(2000, 3))
    points = rng.normal(scale=2.0, size=(2000, 3))
    nearest = np.einsum("nk,nki->ni", closest_on_triangles(points, corners), corners)
    assert beyond(points, nearest, corners) < 1e-10


def test_the_nearest_point_of_a_segment(rng):
    ends = rng.normal(size=(1000, 2, 3))
    points = rng.normal(scale=2.0, size=(1000, 3))
    share = closest_on_segments(points, ends[:, 0], ends[:, 1])
    nearest = ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0])
    assert beyond(points, nearest, ends) < 1e-14


def test_a_segment_without_length_is_a_point():
    point = np.array([[1.0, 2.0, 3.0]])
    assert closest_on_segments(point, np.zeros((1, 3)), np.zeros((1, 3))).tolist() == [0.0]


def test_the_distance_of_two_segments(rng):
    first, second = rng.normal(size=(2, 5000, 2, 3))
    distance, here, there = segment_distances(first, second)
    assert np.allclose(np.linalg.norm(here - there, axis=1), distance, rtol=0, atol=1e-14)
    assert beyond(there, here, first) < 1e-11
    assert beyond(here, there, second) < 1e-11


@pytest.mark.parametrize(
    ("first", "second", "distance"),
    [
        ([[0, 0, 0], [1, 0, 0]], [[0, 2, 0], [1, 2, 0]], 2.0),  # parallel, side by side
        ([[0, 0, 0], [1, 0, 0]], [[4, 3, 0], [5, 3, 0]], np.hypot(3, 3)),  # parallel, past the end
        ([[0, 0, 0], [1, 0, 0]], [[3, 0, 0], [2, 0, 0]], 1.0),  # on one line
        ([[0, 0, 0], [2, 0, 0]], [[1, 0, 0], [3, 0, 0]], 0.0),  # on one line, over each other
        ([[0, 0, 0], [2, 2, 0]], [[0, 2, 0], [2, 0, 0]], 0.0),  # crossing
        ([[0, 0, 0], [2, 2, 0]], [[0, 2, 5], [2, 0, 5]], 5.0),  # skew
        ([[0, 0, 0], [0, 0, 0]], [[3, 4, -1], [3, 4, 1]], 5.0),  # a point and a segment
        ([[3, 4, -1], [3, 4, 1]], [[0, 0, 0], [0, 0, 0]], 5.0),
        ([[1, 1, 1], [1, 1, 1]], [[1, 1, 3], [1, 1, 3]], 2.0),  # two points
    ],
)
def test_segments_in_special_places(first, second, distance):
    given, _, _ = segment_distances(np.array([first], dtype=float), np.array([second], dtype=float))
    assert given[0] == pytest.approx(distance, abs=1e-15)


def winding(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Solid angle of the mesh over 4π (van Oosterom and Strackee 1983): 1 inside, 0 outside."""
    a, b, c = np.moveaxis(corners[None] - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    top = np.einsum("pti,pti->pt", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("pti,pti->pt", *pair) for pair in ((a, b), (b, c), (c, a)))
    return np.arctan2(top, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=1) / (2 * np.pi)


def nearest_of_all(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    distance = np.empty((len(points), len(corners)))
    for row, point in enumerate(points):
        repeated = np.broadcast_to(point, (len(corners), 3))
        nearest = np.einsum("nk,nki->ni", closest_on_triangles(repeated, corners), corners)
        distance[row] = np.linalg.norm(point - nearest, axis=1)
    return distance.min(axis=1)


def test_depth_in_a_hand_has_the_sign_of_the_solid_angle_and_the_size_of_an_exhaustive_search(hand_file, rng):
    hand = load_surface(hand_file)
    points = rng.uniform(hand.vertices.min(axis=0) - 0.01, hand.vertices.max(axis=0) + 0.01, (400, 3))
    depth = signed_distance(hand.vertices, hand.triangles).depth(points)
    inside = winding(points, hand.corners)
    assert np.allclose(inside, np.round(inside), atol=1e-9)
    assert np.array_equal(depth > 0, inside > 0.5)
    assert 20 < (depth > 0).sum() < 380
    assert np.allclose(np.abs(depth[:100]), nearest_of_all(points[:100], hand.corners), rtol=0, atol=1e-15)


def test_points_just_off_edges_and_corners_of_a_concave_body_have_the_right_side(rng):
    # An L: the notch has a concave edge, where plain face normals of either side mislead.
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]) * 0.01
    vertices = np.concatenate([np.column_stack([outline, np.full(6, z)]) for z in (0.0, 0.01)])
    lid = [[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]]
    sides = [t for i in range(6) for j in [(i + 1) % 6] for t in ([i, j, j + 6], [i, j + 6, i + 6])]
    triangles = np.array([t[::-1] for t in lid] + [[i + 6 for i in t] for t in lid] + sides)
    corners = vertices[triangles]
    edges = (
        corners.mean(axis=1)[:, None] * 0.0 + (corners + np.roll(corners, -1, axis=1)).reshape(len(corners), 3, 3) / 2
    )
    start = np.concatenate([vertices, edges.reshape(-1, 3)])
    points = np.repeat(start, 40, axis=0) + 1e-4 * rng.normal(size=(40 * len(start), 3))
    depth = signed_distance(vertices, triangles).depth(points)
    x, y, z = points.T
    inside = (np.minimum(x, y) > 0) & (np.maximum(x, y) < 0.02) & ((x < 0.01) | (y < 0.01)) & (z > 0) & (z < 0.01)
    assert np.array_equal(depth > 0, inside)


def test_many_points_are_the_same_as_few():
    vertices, triangles = torus_mesh(0.02, 0.005)
    prepared = signed_distance(vertices, triangles)
    points = np.random.default_rng(3).uniform(-0.03, 0.03, (5000, 3))  # more than one pass
    assert np.array_equal(prepared.depth(points)[4900:], prepared.depth(points[4900:]))


def test_no_points_have_no_depth():
    assert signed_distance(*box_mesh()).depth(np.zeros((0, 3))).shape == (0,)


def test_size_groups_hold_every_triangle_once(hand_file):
    corners = load_surface(hand_file).corners
    groups = size_groups(corners)
    assert np.array_equal(np.sort(np.concatenate([members for members, _, _ in groups])), np.arange(len(corners)))
    assert len(groups) > 1
    for members, _, reach in groups:
        span = np.linalg.norm(corners[members] - corners[members].mean(axis=1, keepdims=True), axis=2).max(axis=1)
        assert span.max() == pytest.approx(reach)
        assert span.max() < 2 * span.min()
