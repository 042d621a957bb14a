"""Each kind of damage by itself: repaired with a note, or rejected with number and position."""

import numpy as np
import pytest
import trimesh

from airtact.checks import in_mm
from airtact.geometry.checks import check_surface
from airtact.geometry.mesh.repair import repaired
from airtact.geometry.surface import Surface
from faults import raises_code
from geometry.mesh.meshes import box_mesh, torus_mesh
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

# --- what needs nothing ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mesh", [ball(), fine_box(), torus_mesh(0.02, 0.005), box_mesh()])
def test_a_mesh_that_needs_nothing_comes_back_as_it_is(mesh):
    result = repaired(*mesh)
    assert np.array_equal(result.vertices, mesh[0])
    assert np.array_equal(result.triangles, mesh[1])
    assert result.notes == ()


def test_thin_triangles_of_a_drawn_part_are_no_damage():
    # Sides of a rod of 100 mm with 400 sections: 250 times as long as wide.
    mesh = trimesh.creation.cylinder(4.0, 100.0, sections=400)
    result = accepted(1e-3 * np.asarray(mesh.vertices), np.array(mesh.faces))
    assert result.notes == ()
    assert len(result.triangles) == len(mesh.faces)


def test_vertices_repeated_for_every_triangle_are_no_damage():
    v, t = ball()
    result = accepted(v[t].reshape(-1, 3), np.arange(t.size).reshape(-1, 3))
    assert result.notes == ()
    assert len(result.vertices) == len(v)
    assert np.array_equal(result.vertices[result.triangles], v[t])


# --- vertices -------------------------------------------------------------------------------------------------------


def test_vertices_that_nothing_names_are_dropped_even_if_they_are_nan():
    v, t = ball()
    result = accepted(np.vstack([[[np.nan] * 3, [1.0, 2.0, 3.0]], v]), t + 2)
    assert result.notes == (
        "2 vertices that no triangle names were dropped, the first is vertex 0.",
    )
    assert np.array_equal(result.vertices, v)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_nan_in_a_vertex_that_is_named_is_rejected(value):
    v, t = ball()
    v = v.copy()
    v[[70, 90], 1] = value
    with raises_code("not_finite", "2 vertices", "vertex 70 beside ("):
        repaired(v, t)


@pytest.mark.parametrize("index", [-1, 162, 9999])
def test_an_index_out_of_range_is_rejected(index):
    v, t = ball(2)
    t[17, 1] = index
    with raises_code("out_of_range", "1 triangle", f"triangle 17 names {index},", "from 0 to 161"):
        repaired(v, t)


def test_no_triangles_are_rejected():
    with raises_code("empty"):
        repaired(ball()[0], np.zeros((0, 3), dtype=np.int64))


def test_vertices_a_hair_apart_are_merged_without_moving_the_first():
    v, t = fine_box()
    own = np.flatnonzero(t.ravel() == 40)[1:]
    t.ravel()[own] = len(v) + np.arange(len(own))
    result = accepted(np.vstack([v, v[40] + 1e-9 * np.arange(1, 1 + len(own))[:, None]]), t)
    assert np.array_equal(result.vertices, v)
    assert len(result.notes) == 1
    assert (
        f"{len(own)} vertices were merged with another within 0.014 micrometres" in result.notes[0]
    )


def test_the_two_sides_of_a_thin_plate_are_not_merged():
    v, t = box_mesh((0, 0, 0), (0.02, 0.02, 0.5e-3))
    assert accepted(v, t).notes == ()


def test_a_file_in_millimetres_is_asked_about_before_its_holes():
    v, t = ball()
    with raises_code("too_many", "16 m"):
        repaired(1e3 * v, t[5:])


# --- triangles ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "how", [lambda t: t, lambda t: t[:, ::-1], lambda t: np.roll(t, 1, axis=1)]
)
def test_triangles_that_repeat_others_are_dropped(how):
    v, t = ball()
    result = accepted(v, np.vstack([t, how(t)]))
    assert np.array_equal(result.triangles, t)
    assert result.notes[0].startswith(
        f"{len(t)} triangles that repeat others were dropped, the first near ("
    )


def test_triangles_that_name_a_vertex_twice_are_dropped():
    v, t = ball()
    result = accepted(v, np.vstack([t, [[5, 5, 9], [7, 7, 7]]]))
    assert np.array_equal(result.triangles, t)
    assert result.notes[0].startswith("2 triangles with two corners in one vertex were removed")


@pytest.mark.parametrize("share", [1e-9, 1e-6, 1e-4, 5e-4])
def test_needles_are_collapsed(share):
    v, t = ball()
    a, b, _ = t[100]
    over = np.flatnonzero((t == a).any(axis=1) & (t == b).any(axis=1))
    one, two = t[over].copy(), t[over].copy()
    one[one == a], two[two == b] = len(v), len(v)
    result = accepted(
        np.vstack([v, v[a] + share * (v[b] - v[a])]),
        np.vstack([np.delete(t, over, axis=0), one, two]),
    )
    assert len(result.vertices) == len(v)
    assert len(result.triangles) == len(t)
    assert apart((result.vertices, result.triangles), (v, t)) < 1e-6
    assert len(result.notes) >= 1


@pytest.mark.parametrize("sharp", [False, True])
@pytest.mark.parametrize("height", [0.0, 1e-9, 1e-7, 3e-7])
def test_caps_are_repaired_by_flipping(height, sharp):
    v, t = box_mesh((0, 0, 0), (0.004, 0.005, 0.006)) if sharp else ball()
    a, b, c = t[3]
    middle, up = (v[a] + v[b]) / 2.0, v[c] - v[a]
    along = (v[b] - v[a]) / np.linalg.norm(v[b] - v[a])
    up = up - (up @ along) * along
    n = len(v)
    v = np.vstack([v, middle + height * up / np.linalg.norm(up)])
    flat = np.vstack([np.delete(t, 3, axis=0), [[a, b, n], [b, c, n], [c, a, n]]])
    result = accepted(v, flat)
    said = f"1 flat cap was removed by flipping its longest edge, the first near {in_mm(v[[a, b, n]].mean(axis=0))}."
    assert result.notes == (said,)
    assert len(result.triangles) == len(flat)
    assert apart((result.vertices, result.triangles), (v[:n], t)) < 5e-7


def test_many_slivers_are_repaired_at_once(rng):
    v, t = ball(5, 0.01)
    picked = rng.permutation(len(t))[:800]
    a, b, c = t[picked].T
    n = len(v) + np.arange(800)
    height = 10.0 ** rng.uniform(-9, -4, (800, 1))
    new = (1 - height) * (0.6 * v[a] + 0.4 * v[b]) + height * v[c]
    added = np.concatenate(
        [np.stack(corners, axis=1) for corners in ((a, b, n), (b, c, n), (c, a, n))]
    )
    result = accepted(np.vstack([v, new]), np.vstack([np.delete(t, picked, axis=0), added]))
    assert apart((result.vertices, result.triangles), (v, t)) < 5e-6
    assert volume(result.vertices, result.triangles) == pytest.approx(volume(v, t), rel=1e-6)


# --- cracks ---------------------------------------------------------------------------------------------------------


def test_a_vertex_on_an_edge_of_the_other_side_is_joined():
    v, t = box_mesh()
    a, b, c = t[4]
    for share in (0.3, 0.5, 0.9):
        v = np.vstack([v, v[a] + share * (v[b] - v[a])])
    fan = np.array([[a, 8, c], [8, 9, c], [9, 10, c], [10, b, c]])
    result = accepted(v, np.vstack([np.delete(t, 4, axis=0), fan]))
    assert result.notes[0].startswith(
        "3 vertices lay on edges of neighbours, which were split there to close the crack"
    )
    assert volume(result.vertices, result.triangles) == pytest.approx(
        volume(*box_mesh()), rel=1e-12
    )


def test_a_crack_with_other_vertices_on_each_side_is_closed():
    v, t = box_mesh()
    a, b, c = t[4]
    over = next(k for k in range(12) if k != 4 and {a, b} <= set(t[k]))
    d = (set(t[over]) - {a, b}).pop()
    v = np.vstack([v, v[a] + 0.3 * (v[b] - v[a]), v[a] + 0.6 * (v[b] - v[a])])
    sides = [[a, 8, c], [8, b, c], [b, 9, d], [9, a, d]]
    result = accepted(v, np.vstack([np.delete(t, [4, over], axis=0), sides]))
    assert len(result.triangles) == 10 + 6
    assert volume(result.vertices, result.triangles) == pytest.approx(
        volume(*box_mesh()), rel=1e-12
    )


def test_a_patch_torn_off_by_a_few_micrometres_is_joined():
    v, t = ball()
    torn = near(v, t, v[50])[:10]
    moved = np.unique(t[torn])
    new = np.zeros(len(v), dtype=np.int64)
    new[moved] = len(v) + np.arange(len(moved))
    t = t.copy()
    t[torn] = new[t[torn]]
    result = accepted(np.vstack([v, v[moved] + [2e-6, 1e-6, 1e-6]]), t)
    assert "were joined across cracks of up to 2.4 micrometres" in result.notes[1]
    assert volume(result.vertices, result.triangles) == pytest.approx(
        volume(v, ball()[1]), rel=1e-4
    )


# --- which way triangles run ----------------------------------------------------------------------------------------


def test_flipped_patches_are_turned():
    v, t = torus_mesh(0.02, 0.005)
    flipped = t.copy()
    flipped[30:90] = flipped[30:90, ::-1]
    result = accepted(v, flipped)
    assert np.array_equal(np.sort(result.triangles), np.sort(t))
    assert volume(result.vertices, result.triangles) == pytest.approx(volume(v, t))
    assert result.notes[0].startswith(
        "60 triangles ran against their neighbours and were turned, the first near ("
    )


def test_a_surface_that_is_inside_out_is_turned():
    v, t = fine_box()
    result = accepted(v, t[:, ::-1])
    assert volume(result.vertices, result.triangles) == pytest.approx(10e-3 * 12e-3 * 14e-3)
    assert result.notes[0].startswith(
        f"1 closed piece was inside out and turned round, the first of {len(t)} triangles"
    )


def test_each_piece_is_turned_by_itself():
    v, t = ball()
    result = accepted(
        np.vstack([v, v + 0.02, v - 0.02]), np.vstack([t, t[:, ::-1] + len(v), t + 2 * len(v)])
    )
    assert result.notes[0].startswith("1 closed piece was inside out")
    assert volume(result.vertices, result.triangles) == pytest.approx(3 * volume(v, t))


def test_a_cavity_is_left_for_the_check_to_reject():
    v, t = ball()
    both = repaired(np.vstack([v, 0.5 * v]), np.vstack([t, t[:, ::-1] + len(v)]))
    with raises_code("mesh_faulty", "piece 1 of 2", "piece 0"):
        check_surface(Surface(both.vertices, both.triangles))


def test_a_moebius_strip_is_rejected():
    angle = 2 * np.pi * np.arange(40) / 40
    across = 3e-3 * np.stack(
        [np.cos(angle / 2) * np.cos(angle), np.cos(angle / 2) * np.sin(angle), np.sin(angle / 2)]
    )
    middle = 10e-3 * np.stack([np.cos(angle), np.sin(angle), np.zeros(40)])
    v = np.concatenate([(middle - across).T, (middle + across).T])
    strip = []
    for i in range(40):
        a, b, c, d = (
            (i, i + 1, i + 41, i + 40) if i < 39 else (39, 40, 0, 79)
        )  # the ends are joined crosswise
        strip += [[a, b, c], [a, c, d]]
    with raises_code("mesh_faulty", "80 triangles"):
        repaired(v, np.array(strip))


# --- what hangs together wrongly ------------------------------------------------------------------------------------


def test_two_bodies_that_share_a_vertex_are_rejected():
    low, high = (
        box_mesh((0, 0, 0), (0.01, 0.01, 0.01)),
        box_mesh((0.01, 0.01, 0.01), (0.02, 0.02, 0.02)),
    )
    with raises_code("mesh_faulty", "1 vertex", "(10.00, 10.00, 10.00) mm"):
        repaired(*joined(low, high))


def test_two_bodies_that_share_an_edge_are_rejected():
    low, high = (
        box_mesh((0, 0, 0), (0.01, 0.01, 0.01)),
        box_mesh((0.01, 0.01, 0), (0.02, 0.02, 0.01)),
    )
    with raises_code("mesh_faulty", "1 edge", "first 4 of them near (10.00, 10"):
        repaired(*joined(low, high))


def test_two_bodies_that_share_a_face_are_rejected():
    low, high = box_mesh((0, 0, 0), (0.01, 0.01, 0.01)), box_mesh((0.01, 0, 0), (0.02, 0.01, 0.01))
    with raises_code("mesh_faulty", "4 edges", "first 3 of them near"):
        repaired(*joined(low, high))


def test_a_wall_inside_a_body_is_rejected():
    v, t = tube(0.005, 0.02)
    lids = [
        np.stack([np.full(24, len(v)), k + np.arange(24), k + (np.arange(24) + 1) % 24], axis=1)
        for k in (0, 240, 696)
    ]
    lids = [lid + [[i, 0, 0]] for i, lid in enumerate(lids)]
    v = np.vstack([v, [[0, 0, 0], v[240] * [0, 0, 1], [0, 0, 0.02]]])
    with raises_code("mesh_faulty", "24 edges", "first 3 of them"):
        repaired(v, np.vstack([t, *lids]))


def test_a_pillow_without_thickness_is_rejected():
    v = 0.01 * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.4, 0.5, 0.0]])
    t = np.array([[0, 1, 2], [0, 2, 3], [1, 0, 4], [2, 1, 4], [3, 2, 4], [0, 3, 4]])
    with raises_code("mesh_faulty", "1 closed piece", "0 cm³"):
        repaired(v, t)


def test_pieces_that_cross_are_left_for_the_check_to_reject():
    v, t = ball()
    with raises_code("mesh_faulty"):
        accepted(np.vstack([v, v + 0.003]), np.vstack([t, t + len(v)]))


def test_small_closed_pieces_are_kept():
    v, t = ball()
    crumb = box_mesh((0.02, 0.0, 0.0), (0.0206, 0.0006, 0.0006))
    assert len(accepted(*joined((v, t), crumb)).triangles) == len(t) + 12
