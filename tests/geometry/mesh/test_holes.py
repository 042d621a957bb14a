"""Holes: filled where the surface round them shows what is missing, rejected where it does not."""

import numpy as np
import pytest
import trimesh

from airtact.checks import in_mm
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


def without(triangles: np.ndarray, gone) -> np.ndarray:
    return np.delete(triangles, gone, axis=0)


# --- filled ---------------------------------------------------------------------------------------------------------


def test_a_missing_triangle_comes_back():
    v, t = ball()
    result = accepted(v, without(t, [123]))
    assert np.array_equal(np.sort(np.sort(result.triangles), axis=0), np.sort(np.sort(t), axis=0))
    widest = np.linalg.norm(np.ptp(v[t[123]], axis=0))
    assert result.notes[0].startswith("1 hole of up to ")
    assert result.notes[0].endswith(f"was filled, the first near {in_mm(v[t[123]].mean(axis=0))}.")
    assert 0.3e-3 < widest < 2e-3


@pytest.mark.parametrize("number", [2, 5, 9, 13])
def test_a_hole_of_a_ball_leaves_no_more_than_its_cap(number):
    radius = 0.008
    v, t = ball(radius=radius)
    gone = near(v, t, v[7])[:number]
    rim = np.unique(t[gone])
    width = np.linalg.norm(v[rim][:, None] - v[rim][None], axis=2).max()
    result = accepted(v, without(t, gone))
    cap = radius - np.sqrt(
        radius**2 - width**2 / 3.0
    )  # Jung: the rim fits in a circle of radius width / sqrt(3)
    assert apart((result.vertices, result.triangles), (v, t)) <= cap + 1e-6
    assert volume(result.vertices, result.triangles) == pytest.approx(
        volume(v, t), abs=np.pi * width**2 * cap / 6.0
    )


def test_a_sharp_edge_is_drawn_on_through_a_hole():
    v, t = fine_box(0.5)
    gone = near(v, t, [5e-3, 6e-3, 0.1e-3])[:8]
    assert (
        len(
            {
                tuple(np.round(n))
                for n in np.cross(v[t[gone, 1]] - v[t[gone, 0]], v[t[gone, 2]] - v[t[gone, 0]])
                * 1e7
            }
        )
        >= 2
    )
    result = accepted(v, without(t, gone))
    assert apart((result.vertices, result.triangles), (v, t)) < 1e-9


def test_a_corner_is_cut_by_less_than_the_hole():
    v, t = fine_box(0.5)
    corner = np.array([5e-3, 6e-3, 7e-3])
    gone = np.flatnonzero((np.linalg.norm(v[t] - corner, axis=2) < 1e-9).any(axis=1))
    result = accepted(v, without(t, gone))
    assert apart((result.vertices, result.triangles), (v, t)) < 0.6e-3
    assert volume(result.vertices, result.triangles) == pytest.approx(volume(v, t), rel=1e-4)


def test_a_rim_along_a_straight_line_is_filled_without_slivers():
    v, t = fine_box()
    upper = (np.abs(v[:, 1] - 6e-3) < 1e-9) & (
        np.abs(v[:, 2] - 7e-3) < 1e-9
    )  # one sharp edge of the box
    first = int(np.flatnonzero(upper[t].sum(axis=1) == 2)[0])
    a, b, c = np.roll(
        t[first], -int(np.flatnonzero(upper[t[first]] & np.roll(upper[t[first]], -1))[0])
    )
    over = next(k for k in range(len(t)) if k != first and {a, b} <= set(t[k]))
    d = (set(t[over]) - {a, b}).pop()
    chain = [a, len(v), len(v) + 1, len(v) + 2, b]
    slices = [[chain[i], chain[i + 1], c] for i in range(4)] + [
        [chain[i + 1], chain[i], d] for i in range(4)
    ]
    v = np.vstack([v, *(v[a] + share * (v[b] - v[a]) for share in (0.2, 0.5, 0.8))])
    torn = np.vstack([without(t, [first, over]), np.delete(slices, [1, 2, 5, 6], axis=0)])
    result = accepted(v, torn)
    assert volume(result.vertices, result.triangles) == pytest.approx(
        10e-3 * 12e-3 * 14e-3, rel=1e-9
    )


def test_holes_that_meet_in_vertices_are_filled_each_by_itself(rng):
    v, t = ball(5)
    for _ in range(5):
        region = near(v, t, v[rng.integers(len(v))])[:40]
        gone = rng.permutation(region)[:16]
        result = accepted(v, without(t, gone))
        assert len(result.triangles) == len(t)
        assert volume(result.vertices, result.triangles) == pytest.approx(volume(v, t), rel=1e-4)


def test_an_island_in_a_hole_that_hangs_on_a_vertex_is_joined_again():
    v, t = ball(5)
    round_it = np.flatnonzero((t == 300).any(axis=1))
    island = round_it[0]
    ring = np.flatnonzero(np.isin(t, t[island]).any(axis=1))
    gone = np.setdiff1d(ring, [island, *np.flatnonzero((t == 300).any(axis=1))])
    gone = np.r_[
        gone, [k for k in round_it if k != island and len(set(t[k]) & set(t[island])) == 2]
    ]
    result = accepted(v, without(t, gone))
    assert volume(result.vertices, result.triangles) == pytest.approx(volume(v, t), rel=1e-4)
    assert apart((result.vertices, result.triangles), (v, t)) < 30e-6


def test_holes_of_an_inside_out_body_are_filled_and_the_body_is_turned():
    v, t = ball()
    result = accepted(v, without(t, near(v, t, v[9])[:6])[:, ::-1])
    assert [note[:30] for note in result.notes[-2:]] == [
        "1 hole of up to 1.4 mm was fil",
        "1 closed piece was inside out ",
    ]
    assert volume(result.vertices, result.triangles) == pytest.approx(volume(v, t), rel=1e-4)


def test_wider_holes_are_filled_when_asked_for():
    v, t = ball()
    gone = near(v, t, v[9])[:80]
    with raises_code("mesh_faulty", "1 hole", "2 mm"):
        repaired(v, without(t, gone))
    result = accepted(v, without(t, gone), largest_hole=6e-3)
    assert volume(result.vertices, result.triangles) == pytest.approx(volume(v, t), rel=5e-3)


# --- rejected --------------------------------------------------------------------------------------------------------


def test_no_hole_is_filled_where_none_may_be():
    v, t = ball()
    with raises_code("mesh_faulty", "1 hole"):
        repaired(v, without(t, [3]), largest_hole=0.0)


@pytest.mark.parametrize("width", [-1e-3, 2.0, np.nan])
def test_a_width_in_another_unit_is_rejected(width):
    with raises_code("out_of_range", f"{width:g} m"):
        repaired(*ball(2), largest_hole=width)


def test_large_holes_are_counted_and_the_largest_is_placed():
    v, t = fine_box()
    low, high = near(v, t, [-5e-3, 0, 0])[:40], near(v, t, [5e-3, 0, 0])[:80]
    with raises_code("mesh_faulty", "2 holes", "2 mm", "near (5.00, "):
        repaired(v, without(t, np.r_[low, high]))


def test_the_lid_of_a_can_is_not_invented():
    mesh = trimesh.creation.cylinder(10.0, 20.0, sections=48)
    v, t = 1e-3 * np.asarray(mesh.vertices), np.array(mesh.faces)
    lid = (v[t][:, :, 2] > 9.9e-3).all(axis=1)
    with raises_code("mesh_faulty", "1 hole", "2 mm", "20 mm across", "10.00) mm"):
        repaired(v, t[~lid])
    with raises_code("mesh_faulty", "1 hole"):
        repaired(v, t[~lid], largest_hole=0.03)


def test_a_thin_tube_is_not_closed():
    with raises_code("mesh_faulty", "2 holes", "1.5 mm across"):
        repaired(*tube(0.75e-3, 0.02))


def test_a_lost_fingertip_is_not_cut_off_flat():
    mesh = trimesh.creation.capsule(20.0, 0.9, count=[24, 24])
    v, t = 1e-3 * np.asarray(mesh.vertices), np.array(mesh.faces)
    tip = v[t][:, :, 2].min(axis=1) > v[:, 2].max() - 0.8e-3
    with raises_code("mesh_faulty", "1 hole"):
        repaired(v, t[~tip])


def test_a_hole_that_may_have_taken_an_audible_share_is_rejected():
    v, t = ball(radius=1.2e-3)
    gone = near(v, t, v[9])[:700]
    with raises_code("mesh_faulty", "0.5 %"):
        repaired(v, without(t, gone))


def test_a_ring_missing_between_two_halves_is_rejected():
    # Two cones tip to tip, flared so much that the surface round each cut looks ahead.
    angle = 2 * np.pi * np.arange(24) / 24
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(24)], axis=1)
    radii = np.array([0.6, 3.0, 6.0])
    rings = [1e-3 * (r * rim + [0, 0, 0.3 + 0.4 * (r - 0.6)]) for r in radii]
    v = np.vstack([*rings, [[0, 0, 4e-3]]])
    t = []
    for i in range(24):
        j = (i + 1) % 24
        for k in (0, 24):
            t += [[k + j, k + i, k + 24 + i], [k + j, k + 24 + i, k + 24 + j]]
        t.append([48 + j, 48 + i, 72])
    both = joined((v, np.array(t)), (v * [1, 1, -1], np.array(t)[:, ::-1]))
    with raises_code("mesh_faulty", "1 pair", "0.6 mm apart"):
        repaired(*both)


@pytest.mark.parametrize(("size", "code"), [(1e-3, "mesh_faulty"), (2e-2, "mesh_faulty")])
def test_a_single_triangle_is_rejected(size, code):
    with raises_code(code, "1 hole"):
        repaired(size * np.eye(3), np.array([[0, 1, 2]]))


def test_loose_triangles_beside_a_body_are_rejected():
    v, t = ball()
    with raises_code("mesh_faulty", "1 hole"):
        repaired(*joined((v, t), (0.012 + 1e-3 * np.eye(3), np.array([[0, 1, 2]]))))


def test_a_rim_of_too_many_edges_is_rejected():
    mesh = trimesh.creation.cylinder(20.0, 10.0, sections=1300)
    v, t = 1e-3 * np.asarray(mesh.vertices), np.array(mesh.faces)
    lid = (v[t][:, :, 2] > 4.9e-3).all(axis=1)
    with raises_code("mesh_faulty", "1 hole", "400 edges"):
        repaired(v, t[~lid], largest_hole=0.1)


def test_holes_are_walked_round_against_the_triangles_beside_them():
    v, t = box_mesh()
    (hole,) = find_holes(v, without(t, [5]))
    turned = [np.roll(t[5], shift).tolist() for shift in range(3)]
    assert hole.rim.tolist() in turned
    assert hole.width == pytest.approx(
        np.linalg.norm(v[t[5]][:, None] - v[t[5]][None], axis=2).max()
    )
