"""Triangle crossings against linear programming, which finds common points independently."""

import numpy as np
import pytest
from scipy.optimize import linprog

import airtact as at
from airtact.geometry.mesh.intersections import self_crossings
from geometry.mesh.meshes import box_mesh, torus_mesh
from geometry.mesh.repaired_meshes import joined


def common_point(
    first: np.ndarray, second: np.ndarray, keep_off: int | None = None
) -> float | None:
    """Least weight of corner ``keep_off`` of the first triangle in a common point, or None."""
    cost = np.zeros(6)
    if keep_off is not None:
        cost[keep_off] = 1.0
    equal = np.zeros((5, 6))
    equal[:3] = np.concatenate([first, -second]).T
    equal[3, :3] = equal[4, 3:] = 1.0
    found = linprog(cost, A_eq=equal, b_eq=[0, 0, 0, 1, 1], bounds=(0, None), method="highs")
    return float(found.fun) if found.status == 0 else None


def test_strangers_cross_where_linear_programming_finds_a_common_point(rng):
    corners = rng.uniform(size=(28, 3, 3))
    triangles = np.arange(84).reshape(28, 3)
    truth = {
        (i, j)
        for i in range(28)
        for j in range(i + 1, 28)
        if common_point(corners[i], corners[j]) is not None
    }
    assert 30 < len(truth) < 300
    assert {tuple(pair) for pair in self_crossings(corners, triangles)} == truth


def test_triangles_with_a_common_corner_cross_where_a_common_point_lies_off_it(rng):
    count = 36
    vertices = np.concatenate([np.zeros((1, 3)), rng.uniform(-1, 1, (2 * count, 3))])
    triangles = np.column_stack(
        [np.zeros(count, dtype=int), 1 + np.arange(2 * count).reshape(count, 2)]
    )
    turned = np.stack([np.roll(t, i) for i, t in enumerate(triangles)])
    truth = set()
    for i in range(count):
        for j in range(i + 1, count):
            weight = common_point(vertices[triangles[i]], vertices[triangles[j]], keep_off=0)
            if weight is not None and weight < 1 - 1e-9:
                truth.add((i, j))
    assert 20 < len(truth) < 500
    assert {tuple(pair) for pair in self_crossings(vertices[turned], turned)} == truth


@pytest.mark.parametrize(("height", "crosses"), [(0.0, True), (1e-3, False), (-1e-3, False)])
def test_neighbours_over_an_edge_cross_only_when_folded_flat(height, crosses):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.9, 0.7, height]])
    triangles = np.array([[0, 1, 2], [1, 0, 3]])
    assert len(self_crossings(vertices[triangles], triangles)) == crosses


@pytest.mark.parametrize(
    "second",
    [
        [[0.2, 0.2, 0], [0.2, 0.2, 1], [0.3, 0.3, 1]],  # a corner on its face
        [[1, 0, 0], [2, 0, 1], [2, 0, 2]],  # corner to corner
        [[0.5, 0.0, 0], [0.5, -1, 1], [0.5, -1, -1]],  # a corner on its edge
    ],
)
def test_strangers_that_only_touch_count(second):
    first = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=float)
    second = np.array(second, dtype=float)
    triangles = np.arange(6).reshape(2, 3)
    assert self_crossings(np.stack([first, second]), triangles).tolist() == [[0, 1]]
    second[:, 2] += 1e-6 if second[:, 2].min() == 0 else 3.0
    assert self_crossings(np.stack([first, second]), triangles).tolist() == []


def test_a_torus_crosses_itself_only_when_its_tube_is_thicker_than_its_ring():
    thin, triangles = torus_mesh(0.02, 0.015)
    assert len(self_crossings(thin[triangles], triangles)) == 0
    thick, triangles = torus_mesh(0.015, 0.02)
    pairs = self_crossings(thick[triangles], triangles)
    assert len(pairs) > 0
    # Crossings of a spindle torus lie round its axis, within the spindle.
    assert np.hypot(*thick[triangles][pairs].mean(axis=(1, 2))[:, :2].T).max() < 0.006


def test_crossings_do_not_depend_on_place_and_order(rng):
    vertices, triangles = torus_mesh(0.015, 0.02)
    shuffle = rng.permutation(len(triangles))
    before = {frozenset(pair) for pair in self_crossings(vertices[triangles], triangles).tolist()}
    after = self_crossings((vertices + [1.0, -0.5, 0.7])[triangles[shuffle]], triangles[shuffle])
    assert {frozenset(shuffle[pair].tolist()) for pair in after} == before


def test_a_finger_pushed_through_the_palm_is_seen(hand_file):
    hand = at.load_surface(hand_file)
    tip = int(hand.vertices[:, 1].argmin())  # the end of the longest finger
    moved = hand.vertices.copy()
    near = np.linalg.norm(moved - moved[tip], axis=1) < 0.012
    moved[near] += hand.vertices.mean(axis=0) - moved[tip]
    assert len(self_crossings(moved[hand.triangles], hand.triangles)) > 0


def test_large_and_small_triangles_are_paired():
    small = at.sphere(
        0.001, 0.0003, centre=(0.01, 0.0, 0.0)
    )  # straddles one face of a box 40 times as large
    vertices, triangles = joined(
        (small.vertices, small.triangles), box_mesh((-0.03, -0.03, -0.03), (0.01, 0.03, 0.03))
    )
    pairs = self_crossings(vertices[triangles], triangles)
    straddling = (small.corners[:, :, 0].min(axis=1) <= 0.01) & (
        small.corners[:, :, 0].max(axis=1) >= 0.01
    )
    assert set(pairs[:, 0].tolist()) == set(np.flatnonzero(straddling).tolist())
