"""Distances and nearest points, against SciPy."""

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from airtact.geometry.distances import (
    distances,
    few_within,
    nearest,
    nearest_pair,
    nearest_within,
)


@pytest.mark.parametrize("count", [1, 40, 3000])  # the last uses a tree
def test_distances_and_nearest_points_are_those_of_scipy(count: int) -> None:
    random = np.random.default_rng(count)
    points, others = random.normal(size=(50, 3)), random.normal(size=(count, 3))
    expected = cdist(points, others)
    np.testing.assert_allclose(distances(points, others), expected, rtol=1e-12)
    distance, index = nearest(points, others)
    np.testing.assert_allclose(distance, expected.min(axis=1), rtol=1e-12)
    np.testing.assert_array_equal(index, expected.argmin(axis=1))


@pytest.mark.parametrize("count", [0, 5, 30_000])  # the last is more than one part
def test_points_beyond_the_reach_are_not_nearest(count: int) -> None:
    random = np.random.default_rng(2)
    points, others = random.uniform(size=(count, 3)), random.uniform(size=(400, 3))
    distance, index = nearest_within(points, others, 0.05)
    expected, nearest_index = KDTree(others).query(points) if count else (np.empty(0), index)
    near = expected < 0.05
    np.testing.assert_allclose(distance[near], expected[near], rtol=1e-12)
    np.testing.assert_array_equal(index[near], nearest_index[near])
    assert np.isinf(distance[~near]).all()
    assert (index[~near] == 0).all()


def test_the_nearest_few_are_listed_from_the_nearest_on() -> None:
    random = np.random.default_rng(4)
    points, others = random.uniform(size=(60, 3)), random.uniform(size=(500, 3))
    reach = random.uniform(0.1, 0.4, size=len(others))
    distance, index = few_within(points, others, reach, 5)
    for point, apart, chosen in zip(cdist(points, others), distance, index, strict=True):
        expected = np.argsort(np.where(point < reach, point, np.inf))[:5]
        found = int((point < reach).sum().clip(max=5))
        np.testing.assert_array_equal(chosen[:found], expected[:found])
        np.testing.assert_allclose(apart[:found], point[expected[:found]], rtol=1e-12)
        assert np.isinf(apart[found:]).all()


@pytest.mark.parametrize("far", [0.0, 1e3])
def test_the_closest_pair_is_found_wherever_it_is(far: float) -> None:
    points = np.random.default_rng(3).uniform(size=(500, 3))
    points[::2] += far  # so that successive points are far apart
    distance = cdist(points, points) + 1e9 * np.eye(len(points))
    first, second, apart = nearest_pair(points)
    assert first < second
    assert apart == pytest.approx(distance.min(), rel=1e-9)
    assert distance[first, second] == distance.min()
    points[77] = points[400]
    assert nearest_pair(points) == (77, 400, 0.0)


def test_two_points_in_one_place_are_the_closest_pair() -> None:
    assert nearest_pair(np.zeros((2, 3))) == (0, 1, 0.0)
