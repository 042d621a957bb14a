"""Holes: filled where the surface around them shows what is missing, rejected where it does not."""

from itertools import pairwise

import numpy as np
import pytest
import trimesh

from airtact.errors import in_mm
from airtact.geometry.mesh.holes import find_holes
from airtact.geometry.mesh.repair import repaired
from faults import raises_code
from geometry.mesh.meshes import box_mesh
from geometry.mesh.repaired_meshes import (
    accepted,
    apart,
    ball,
    fine_box,
    joined,
    near,
    tube,
    volume,
)

BALL = ball()
FINE_BALL = ball(5)
BOX = fine_box(0.5)


def without(triangles: np.ndarray, gone) -> np.ndarray:
    return np.delete(triangles, gone, axis=0)


def off(result, mesh) -> float:
    """Largest distance of a repaired mesh from the undamaged one [m]."""
    return apart((result.vertices, result.triangles), mesh)


def filled_volume(result) -> float:
    return volume(result.vertices, result.triangles)


# --- filled ---------------------------------------------------------------------------------------


def test_a_missing_triangle_comes_back():
    v, t = BALL
    result = accepted(v, without(t, [123]))
    assert np.array_equal(np.sort(np.sort(result.triangles), axis=0), np.sort(np.sort(t), axis=0))
    assert result.notes[0].startswith("1 hole")
    assert in_mm(v[t[123]].mean(axis=0)) in result.notes[0]


@pytest.mark.parametrize("number", [2, 5, 9, 13])
def test_a_hole_of_a_ball_leaves_no_more_than_its_cap(number):
    radius = 0.008
    v, t = BALL
    gone = near(v, t, v[7])[:number]
    rim = np.unique(t[gone])
    width = np.linalg.norm(v[rim][:, None] - v[rim][None], axis=2).max()
    result = accepted(v, without(t, gone))
    # Jung: the rim fits in a circle of radius width / sqrt(3).
    cap = radius - np.sqrt(radius**2 - width**2 / 3.0)
    assert off(result, BALL) <= cap + 1e-6
    assert filled_volume(result) == pytest.approx(volume(*BALL), abs=np.pi * width**2 * cap / 6.0)


def test_a_sharp_edge_is_drawn_on_through_a_hole():
    v, t = BOX
    gone = near(v, t, [5e-3, 6e-3, 0.1e-3])[:8]
    normals = np.cross(v[t[gone, 1]] - v[t[gone, 0]], v[t[gone, 2]] - v[t[gone, 0]])
    assert len({tuple(np.round(normal)) for normal in 1e7 * normals}) >= 2
    assert off(accepted(v, without(t, gone)), BOX) < 1e-9


def test_a_corner_is_cut_by_less_than_the_hole():
    v, t = BOX
    at_corner = np.linalg.norm(v[t] - [5e-3, 6e-3, 7e-3], axis=2) < 1e-9
    result = accepted(v, t[~at_corner.any(axis=1)])
    assert off(result, BOX) < 0.6e-3
    assert filled_volume(result) == pytest.approx(volume(*BOX), rel=1e-4)


def test_a_rim_along_a_straight_line_is_filled_without_slivers():
    v, t = fine_box()
    on_edge = (np.abs(v[:, 1] - 6e-3) < 1e-9) & (np.abs(v[:, 2] - 7e-3) < 1e-9)
    first = int(np.flatnonzero(on_edge[t].sum(axis=1) == 2)[0])
    start = np.flatnonzero(on_edge[t[first]] & np.roll(on_edge[t[first]], -1))[0]
    a, b, c = np.roll(t[first], -int(start))
    over = next(k for k in range(len(t)) if k != first and {a, b} <= set(t[k]))
    d = (set(t[over]) - {a, b}).pop()
    chain = [a, len(v), len(v) + 1, len(v) + 2, b]
    slices = [[here, after, c] for here, after in pairwise(chain)]
    slices += [[after, here, d] for here, after in pairwise(chain)]
    v = np.vstack([v, *(v[a] + share * (v[b] - v[a]) for share in (0.2, 0.5, 0.8))])
    torn = np.vstack([without(t, [first, over]), np.delete(slices, [1, 2, 5, 6], axis=0)])
    assert filled_volume(accepted(v, torn)) == pytest.approx(10e-3 * 12e-3 * 14e-3, rel=1e-9)


def test_holes_that_meet_in_vertices_are_filled_each_by_itself(rng):
    v, t = FINE_BALL
    for _ in range(5):
        region = near(v, t, v[rng.integers(len(v))])[:40]
        result = accepted(v, without(t, rng.permutation(region)[:16]))
        assert len(result.triangles) == len(t)
        assert filled_volume(result) == pytest.approx(volume(v, t), rel=1e-4)


def test_an_island_in_a_hole_that_hangs_on_a_vertex_is_joined_again():
    v, t = FINE_BALL
    around = np.flatnonzero((t == 300).any(axis=1))
    island = around[0]
    ring = np.flatnonzero(np.isin(t, t[island]).any(axis=1))
    neighbours = [k for k in around[1:] if len(set(t[k]) & set(t[island])) == 2]
    result = accepted(v, without(t, np.r_[np.setdiff1d(ring, around), neighbours]))
    assert filled_volume(result) == pytest.approx(volume(v, t), rel=1e-4)
    assert off(result, FINE_BALL) < 30e-6


def test_holes_of_an_inside_out_body_are_filled_and_the_body_is_turned():
    v, t = BALL
    result = accepted(v, without(t, near(v, t, v[9])[:6])[:, ::-1])
    assert result.notes[-2].startswith("1 hole")
    assert result.notes[-1].startswith("1 closed piece")
    assert filled_volume(result) == pytest.approx(volume(v, t), rel=1e-4)


def test_wider_holes_are_filled_when_asked_for():
    v, t = BALL
    torn = without(t, near(v, t, v[9])[:80])
    with raises_code("mesh_faulty", "1 hole", "2 mm"):
        repaired(v, torn)
    result = accepted(v, torn, largest_hole=6e-3)
    assert filled_volume(result) == pytest.approx(volume(v, t), rel=5e-3)


# --- rejected -------------------------------------------------------------------------------------


def without_lid(sections: int, height: float) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.cylinder(10.0, 2e3 * height, sections=sections)
    v = 1e-3 * np.asarray(mesh.vertices)
    t = np.array(mesh.faces)
    return v, t[~(v[t][:, :, 2] > 0.99 * height).all(axis=1)]


def without_fingertip() -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.capsule(20.0, 0.9, count=[24, 24])
    v = 1e-3 * np.asarray(mesh.vertices)
    t = np.array(mesh.faces)
    return v, t[~(v[t][:, :, 2].min(axis=1) > v[:, 2].max() - 0.8e-3)]


def with_two_holes() -> tuple[np.ndarray, np.ndarray]:
    v, t = fine_box()
    gone = np.r_[near(v, t, [-5e-3, 0, 0])[:40], near(v, t, [5e-3, 0, 0])[:80]]
    return v, without(t, gone)


def with_a_large_share_missing() -> tuple[np.ndarray, np.ndarray]:
    v, t = ball(radius=1.2e-3)
    return v, without(t, near(v, t, v[9])[:700])


def without_ring_between_halves() -> tuple[np.ndarray, np.ndarray]:
    """Two cones tip to tip, flared so much that the surface around each cut looks ahead."""
    angle = 2 * np.pi * np.arange(24) / 24
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(24)], axis=1)
    rings = [1e-3 * (r * rim + [0, 0, 0.3 + 0.4 * (r - 0.6)]) for r in (0.6, 3.0, 6.0)]
    v = np.vstack([*rings, [[0, 0, 4e-3]]])
    t = []
    for i in range(24):
        j = (i + 1) % 24
        for k in (0, 24):
            t += [[k + j, k + i, k + 24 + i], [k + j, k + 24 + i, k + 24 + j]]
        t.append([48 + j, 48 + i, 72])
    return joined((v, np.array(t)), (v * [1, 1, -1], np.array(t)[:, ::-1]))


ONE_TRIANGLE = np.array([[0, 1, 2]])


@pytest.mark.parametrize(
    ("mesh", "largest", "values"),
    [
        ((BALL[0], without(BALL[1], [3])), 0.0, ["1 hole", "0 mm"]),
        (with_two_holes(), 2e-3, ["2 holes", "2 mm", "(5.00, "]),  # the largest is placed
        (without_lid(48, 0.01), 2e-3, ["1 hole", "2 mm", "20 mm", "10.00) mm"]),
        (without_lid(48, 0.01), 0.03, ["1 hole"]),  # the surface leans out of its plane
        (without_lid(1300, 0.005), 0.1, ["1 hole", "400"]),  # too many edges
        (tube(0.75e-3, 0.02), 2e-3, ["2 holes", "1.5 mm"]),
        (without_fingertip(), 2e-3, ["1 hole"]),
        (with_a_large_share_missing(), 2e-3, ["1 hole", "0.5 %"]),
        (without_ring_between_halves(), 2e-3, ["1 pair", "0.6 mm"]),
        ((1e-3 * np.eye(3), ONE_TRIANGLE), 2e-3, ["1 hole"]),
        ((2e-2 * np.eye(3), ONE_TRIANGLE), 2e-3, ["1 hole"]),
        (joined(BALL, (0.012 + 1e-3 * np.eye(3), ONE_TRIANGLE)), 2e-3, ["1 hole"]),
    ],
)
def test_holes_whose_missing_part_is_unknown_are_rejected(mesh, largest, values):
    with raises_code("mesh_faulty", *values) as caught:
        repaired(*mesh, largest_hole=largest)
    assert in_mm(caught.value.position) in str(caught.value)


@pytest.mark.parametrize("width", [-1e-3, 2.0, np.nan])
def test_a_width_in_another_unit_is_rejected(width):
    with raises_code("out_of_range", f"{width:g} m"):
        repaired(*ball(2), largest_hole=width)


def test_holes_are_walked_round_against_the_triangles_beside_them():
    v, t = box_mesh()
    (hole,) = find_holes(v, without(t, [5]))
    turned = [np.roll(t[5], shift).tolist() for shift in range(3)]
    assert hole.rim.tolist() in turned
    diagonal = np.linalg.norm(v[t[5]][:, None] - v[t[5]][None], axis=2).max()
    assert hole.width == pytest.approx(diagonal)
