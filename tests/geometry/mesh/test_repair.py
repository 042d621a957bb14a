"""Each kind of damage by itself: repaired with a note, or rejected with number and position."""

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.geometry.checks import check_surface
from airtact.geometry.mesh.repair import repaired
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

BALL = ball(3)
BOX = box_mesh()


def mesh_of(result) -> tuple[np.ndarray, np.ndarray]:
    return result.vertices, result.triangles


# --- sound meshes ---------------------------------------------------------------------------------


def rod_of_long_triangles() -> tuple[np.ndarray, np.ndarray]:
    # Sides of a rod of 100 mm with 400 sections: 250 times as long as wide.
    mesh = trimesh.creation.cylinder(4.0, 100.0, sections=400)
    return 1e-3 * np.asarray(mesh.vertices), np.array(mesh.faces)


@pytest.mark.parametrize(
    "mesh",
    [
        BALL,
        fine_box(),
        torus_mesh(0.02, 0.005),
        BOX,
        box_mesh((0, 0, 0), (0.02, 0.02, 0.5e-3)),  # the sides of a thin plate are not merged
        rod_of_long_triangles(),
        joined(BALL, box_mesh((0.02, 0.0, 0.0), (0.0206, 0.0006, 0.0006))),  # a small piece
    ],
)
def test_a_sound_mesh_comes_back_as_it_is(mesh):
    result = accepted(*mesh)
    assert np.array_equal(result.vertices, mesh[0])
    assert np.array_equal(result.triangles, mesh[1])
    assert result.notes == ()


def test_vertices_repeated_for_every_triangle_are_no_damage():
    v, t = BALL
    result = accepted(v[t].reshape(-1, 3), np.arange(t.size).reshape(-1, 3))
    assert result.notes == ()
    assert len(result.vertices) == len(v)
    assert np.array_equal(result.vertices[result.triangles], v[t])


# --- vertices -------------------------------------------------------------------------------------


def test_unused_vertices_are_dropped_even_if_they_are_nan():
    v, t = BALL
    result = accepted(np.vstack([[[np.nan] * 3, [1.0, 2.0, 3.0]], v]), t + 2)
    assert len(result.notes) == 1
    assert np.array_equal(result.vertices, v)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_nan_in_a_used_vertex_is_rejected(value):
    v, t = BALL
    v = v.copy()
    v[[70, 90], 1] = value
    with raises_code("not_finite", "2 vertices", "vertex 70") as caught:
        repaired(v, t)
    assert np.linalg.norm(caught.value.position - BALL[0][70]) < 1e-3


@pytest.mark.parametrize("index", [-1, 162, 9999])
def test_an_index_out_of_range_is_rejected(index):
    v, t = ball(2)
    t[17, 1] = index
    with raises_code("out_of_range", "triangle 17", f" {index},", "161"):
        repaired(v, t)


def test_vertices_a_hair_apart_are_merged_without_moving_the_first():
    v, t = fine_box()
    own = np.flatnonzero(t.ravel() == 40)[1:]
    t.ravel()[own] = len(v) + np.arange(len(own))
    result = accepted(np.vstack([v, v[40] + 1e-9 * np.arange(1, 1 + len(own))[:, None]]), t)
    assert np.array_equal(result.vertices, v)
    assert len(result.notes) == 1
    assert result.notes[0].startswith(f"{len(own)} vertices")


# --- triangles ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("added", "number"),
    [
        (BALL[1], 1280),
        (BALL[1][:, ::-1], 1280),
        (np.roll(BALL[1], 1, axis=1), 1280),
        (np.array([[5, 5, 9], [7, 7, 7]]), 2),
    ],
)
def test_repeated_and_collapsed_triangles_are_dropped(added, number):
    v, t = BALL
    result = accepted(v, np.vstack([t, added]))
    assert np.array_equal(result.triangles, t)
    assert result.notes[0].split()[0] == str(number)


@pytest.mark.parametrize("mesh", [BALL, box_mesh((0, 0, 0), (0.004, 0.005, 0.006))])
@pytest.mark.parametrize("height", [0.0, 1e-9, 1e-7, 3e-7])
def test_caps_are_merged(height, mesh):
    v, t = mesh
    n = len(v)
    a, b, c = t[3]
    along = (v[b] - v[a]) / np.linalg.norm(v[b] - v[a])
    up = v[c] - v[a]
    up = up - (up @ along) * along
    apex = (v[a] + v[b]) / 2.0 + height * up / np.linalg.norm(up)
    flat = np.vstack([np.delete(t, 3, axis=0), [[a, b, n], [b, c, n], [c, a, n]]])
    result = accepted(np.vstack([v, apex]), flat)
    assert [note.split()[0] for note in result.notes] == ["1"]
    assert apart(mesh_of(result), mesh) < 5e-7


# --- cracks ---------------------------------------------------------------------------------------


def test_vertices_on_an_edge_of_the_other_side_are_joined():
    v, t = BOX
    a, b, c = t[4]
    v = np.vstack([v, *(v[a] + share * (v[b] - v[a]) for share in (0.3, 0.5, 0.9))])
    fan = np.array([[a, 8, c], [8, 9, c], [9, 10, c], [10, b, c]])
    result = accepted(v, np.vstack([np.delete(t, 4, axis=0), fan]))
    assert volume(*mesh_of(result)) == pytest.approx(volume(*BOX), rel=1e-12)


def test_a_patch_torn_off_by_a_few_micrometres_is_joined():
    v, t = BALL
    torn = near(v, t, v[50])[:10]
    moved = np.unique(t[torn])
    new = np.zeros(len(v), dtype=np.int64)
    new[moved] = len(v) + np.arange(len(moved))
    t = t.copy()
    t[torn] = new[t[torn]]
    result = accepted(np.vstack([v, v[moved] + [2e-6, 1e-6, 1e-6]]), t)
    assert " 5 micrometres" in result.notes[1]
    assert volume(*mesh_of(result)) == pytest.approx(volume(*BALL), rel=1e-4)


# --- holes -------------------------------------------------------------------------------------


def test_a_missing_triangle_comes_back():
    v, t = BALL
    result = accepted(v, np.delete(t, 123, axis=0))
    assert np.array_equal(np.sort(np.sort(result.triangles), axis=0), np.sort(np.sort(t), axis=0))
    assert result.notes[0].startswith("1 hole")


@pytest.mark.parametrize(("number", "turned"), [(2, 1), (5, -1), (9, 1), (13, -1)])
def test_a_hole_gets_a_lid_whatever_side_is_out(number, turned):
    mesh = v, t = ball(4)
    result = accepted(v, np.delete(t, near(v, t, v[7])[:number], axis=0)[:, ::turned])
    assert apart(mesh_of(result), mesh) < 3e-5
    assert volume(*mesh_of(result)) == pytest.approx(volume(*mesh), rel=1e-5)


def test_wider_holes_are_filled_when_asked_for():
    v, t = tube(0.005, 0.02)
    with raises_code("mesh_faulty", "2 holes", "10 mm", "2 mm"):
        repaired(v, t)
    result = accepted(v, t, largest_hole=0.02)
    area = 24 / 2 * np.sin(2 * np.pi / 24) * 0.005**2
    assert volume(*mesh_of(result)) == pytest.approx(area * 0.02, rel=1e-9)


@pytest.mark.parametrize("width", [-1e-3, 2.0, np.nan])
def test_a_width_in_another_unit_is_rejected(width):
    with raises_code("out_of_range", f"{width:g} m"):
        repaired(*ball(2), largest_hole=width)


# --- orientation ----------------------------------------------------------------------------------


@pytest.mark.parametrize("turned", [[True], [False, True, False]])
def test_pieces_that_are_inside_out_are_turned(turned):
    v, t = BALL
    vertices = np.vstack([v + 0.02 * index for index in range(len(turned))])
    pieces = [(t[:, ::-1] if turn else t) + index * len(v) for index, turn in enumerate(turned)]
    result = accepted(vertices, np.vstack(pieces))
    assert result.notes[0].startswith("1 closed piece")
    assert volume(*mesh_of(result)) == pytest.approx(len(turned) * volume(v, t))


def test_cavities_and_crossings_are_left_for_the_check_to_reject():
    v, t = BALL
    cavity = repaired(np.vstack([v, 0.5 * v]), np.vstack([t, t[:, ::-1] + len(v)]))
    with raises_code("mesh_faulty", "piece 1 of 2"):
        check_surface(at.Surface(*mesh_of(cavity)))
    with raises_code("mesh_faulty"):
        accepted(np.vstack([v, v + 0.003]), np.vstack([t, t + len(v)]))


# --- rejected -------------------------------------------------------------------------------------


def moebius_strip() -> tuple[np.ndarray, np.ndarray]:
    angle = 2 * np.pi * np.arange(40) / 40
    across = 3e-3 * np.stack(
        [np.cos(angle / 2) * np.cos(angle), np.cos(angle / 2) * np.sin(angle), np.sin(angle / 2)]
    )
    middle = 10e-3 * np.stack([np.cos(angle), np.sin(angle), np.zeros(40)])
    strip = [[39, 40, 0], [39, 0, 79]]  # the ends are joined crosswise
    for i in range(39):
        strip += [[i, i + 1, i + 41], [i, i + 41, i + 40]]
    return np.concatenate([(middle - across).T, (middle + across).T]), np.array(strip)


def beside(low) -> tuple[np.ndarray, np.ndarray]:
    low = np.array(low)
    return joined(box_mesh((0, 0, 0), (0.01,) * 3), box_mesh(low, low + 0.01))


PILLOW = (
    0.01 * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.4, 0.5, 0.0]]),
    np.array([[0, 1, 2], [0, 2, 3], [1, 0, 4], [2, 1, 4], [3, 2, 4], [0, 3, 4]]),
)


@pytest.mark.parametrize(
    ("mesh", "code", "values"),
    [
        ((BALL[0], np.zeros((0, 3), dtype=np.int64)), "empty", []),
        ((1e3 * BALL[0], BALL[1][5:]), "not_in_metres", ["16 m"]),  # before its holes
        (moebius_strip(), "mesh_not_oriented", []),
        (beside((0.01, 0.01, 0.01)), "mesh_faulty", ["1 vertex", "(10.00, 10.00, 10.00) mm"]),
        (beside((0.01, 0.01, 0)), "mesh_not_oriented", ["1 edge", "(10.00, 10"]),
        (beside((0.01, 0, 0)), "mesh_not_oriented", ["4 edges"]),
        (PILLOW, "mesh_faulty", ["1 closed piece", "0 cm³"]),
        (joined(BALL, (0.012 + 1e-3 * np.eye(3), np.array([[0, 1, 2]]))), "mesh_faulty", ["0 cm³"]),
    ],
)
def test_meshes_without_a_known_inside_are_rejected(mesh, code, values):
    with raises_code(code, *values):
        repaired(*mesh)
