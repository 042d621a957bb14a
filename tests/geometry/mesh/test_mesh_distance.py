"""Closest points by their definition: no point of a convex set is beyond their plane."""

import numpy as np
import pytest

from airtact.geometry.mesh.mesh_distance import (
    closest_on_segments,
    closest_on_triangles,
    closest_weights,
    segment_distances,
)


def beyond(points: np.ndarray, nearest: np.ndarray, corners: np.ndarray) -> float:
    """Distance of any corner past the plane through the nearest point: at most 0."""
    gap = points - nearest
    length = np.maximum(np.linalg.norm(gap, axis=1), 1e-300)
    return float((np.einsum("ni,nki->nk", gap, corners - nearest[:, None]) / length[:, None]).max())


def test_the_nearest_point_of_a_triangle(rng):
    corners = rng.normal(size=(5000, 3, 3))
    points = rng.normal(scale=2.0, size=(5000, 3))
    weights = closest_weights(points, corners)
    assert weights.min() >= 0.0
    assert np.allclose(weights.sum(axis=1), 1.0, rtol=0, atol=1e-14)
    assert beyond(points, np.einsum("nk,nki->ni", weights, corners), corners) < 1e-12
    assert {int((w == 0).sum()) for w in weights} == {
        0,
        1,
        2,
    }  # faces, edges and corners are all met


def test_the_nearest_point_of_a_sliver(rng):
    corners = rng.normal(size=(2000, 3, 3))
    corners[:, 2] = corners[:, :2].mean(axis=1) + 1e-5 * rng.normal(size=(2000, 3))
    points = rng.normal(scale=2.0, size=(2000, 3))
    assert beyond(points, closest_on_triangles(points, corners), corners) < 1e-10


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
