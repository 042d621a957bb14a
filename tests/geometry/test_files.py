"""Surfaces through every kind of file, whole and damaged."""

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.geometry.checks import check_surface
from airtact.geometry.mesh.triangles import cone_volumes
from faults import raises_code
from geometry.mesh.meshes import box_mesh, torus_mesh


def written(path, mesh: trimesh.Trimesh | trimesh.Scene):
    mesh.export(path)
    return path


def box(*corners) -> trimesh.Trimesh:
    return trimesh.Trimesh(*box_mesh(*corners), process=False)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj", ".glb", ".STL"])
def test_every_kind_of_file_gives_the_surface_back(tmp_path, suffix):
    vertices, triangles = torus_mesh(0.02, 0.005)
    path = written(tmp_path / f"ring{suffix}", trimesh.Trimesh(vertices, triangles, process=False))
    surface = at.load_surface(path)
    assert surface.vertices.shape == vertices.shape
    assert np.allclose(
        np.sort(surface.corners.mean(axis=1), axis=0),
        np.sort(vertices[triangles].mean(axis=1), axis=0),
        rtol=0,
        atol=1e-8,
    )
    assert cone_volumes(surface.corners).sum() == pytest.approx(
        trimesh.Trimesh(vertices, triangles).volume, rel=1e-5
    )
    assert surface.repairs == ()


def test_vertices_doubled_for_normals_and_textures_are_merged(tmp_path):
    mesh = box()
    faceted = trimesh.Trimesh(
        mesh.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False
    )
    faceted.visual = trimesh.visual.TextureVisuals(uv=np.random.default_rng(0).random((36, 2)))
    faceted.vertex_normals = np.repeat(mesh.face_normals, 3, axis=0)
    for suffix in (".glb", ".ply"):
        assert len(at.load_surface(written(tmp_path / f"faceted{suffix}", faceted)).vertices) == 8


def test_nodes_of_a_scene_are_placed_and_joined(tmp_path):
    nodes = trimesh.Scene()
    nodes.add_geometry(box((0, 0, 0), (0.01, 0.01, 0.01)), node_name="one")
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    turn[:3, 3] = [0.05, 0.0, 0.0]
    nodes.add_geometry(box((0, 0, 0), (0.02, 0.01, 0.03)), node_name="two", transform=turn)
    surface = at.load_surface(written(tmp_path / "two.glb", nodes))
    assert len(surface.triangles) == 24
    assert surface.volume == pytest.approx(1e-6 + 6e-6, rel=1e-6)
    assert np.allclose(surface.vertices.min(axis=0), [0, 0, 0], atol=1e-8)
    assert np.allclose(surface.vertices.max(axis=0), [0.05, 0.02, 0.03], atol=1e-8)


def without_face(mesh: trimesh.Trimesh, index: int) -> trimesh.Trimesh:
    mesh.update_faces(np.arange(len(mesh.faces)) != index)
    return mesh


def test_what_cannot_be_repaired_names_the_file(tmp_path):
    crowded = trimesh.util.concatenate([box(), box((0.02, 0.0, 0.0), (0.03, 0.03, 0.04))])
    with raises_code("mesh_not_oriented", "two.obj: ", "4 edges"):
        at.load_surface(written(tmp_path / "two.obj", crowded))
    with raises_code("mesh_faulty", "lidless.ply: ", "1 hole", "30 mm"):
        at.load_surface(written(tmp_path / "lidless.ply", without_face(box(), 3)))


def test_holes_are_filled_as_wide_as_asked_for(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=8.0)
    path = written(tmp_path / "ball.stl", without_face(ball, 77))
    assert "0.55 mm" in at.load_surface(path, scale=1e-3).repairs[0]
    with raises_code("mesh_faulty", "ball.stl: ", "0.4 mm"):
        at.load_surface(path, scale=1e-3, largest_hole=0.4e-3)


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan])
def test_the_scale_is_above_zero(tmp_path, scale):
    with raises_code("out_of_range", f"scale is {scale:g}"):
        at.load_surface(tmp_path / "box.stl", scale)


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("absent.stl", "file_missing"),
        ("folder.stl", "file_unreadable"),
        ("hand.step", "unknown_format"),
    ],
)
def test_files_of_no_surface_are_named(tmp_path, name, code):
    (tmp_path / "folder.stl").mkdir()
    (tmp_path / "hand.step").write_text("ISO-10303-21;")
    with raises_code(code, name):
        at.load_surface(tmp_path / name)


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("cm", 1e-2), ("inch", 0.0254)])
def test_a_file_in_another_unit_names_the_scales_that_fit(tmp_path, unit, metres):
    ball = trimesh.creation.icosphere(2, radius=8e-3 / metres)
    ball.export(tmp_path / "ball.stl")
    with raises_code("not_in_metres", f"{metres:g} for"):
        at.load_surface(tmp_path / "ball.stl")
    surface = at.load_surface(tmp_path / "ball.stl", scale=metres)
    assert np.ptp(surface.vertices, axis=0) == pytest.approx(16e-3, rel=0.05)


def test_a_wide_body_is_taken_where_its_scale_is_given(tmp_path):
    trimesh.creation.box((0.6, 0.6, 0.1)).export(tmp_path / "box.stl")
    assert at.load_surface(tmp_path / "box.stl", scale=1.0).volume == pytest.approx(0.036)


@pytest.mark.slow
def test_overlapping_balls_are_united_on_request(tmp_path):
    # Two balls of 8 mm whose centres are 6 mm apart, one of them open, and a box on a box.
    first = trimesh.creation.icosphere(subdivisions=3, radius=8.0)
    second = without_face(first.copy().apply_translation([6.0, 0.0, 0.0]), 33)
    path = written(tmp_path / "balls.stl", trimesh.util.concatenate([first, second]))
    with raises_code("mesh_faulty"):
        at.load_surface(path, scale=1e-3)
    surface = at.load_surface(path, scale=1e-3, union=True)
    closed = first.copy().apply_translation([6.0, 0.0, 0.0])
    assert surface.volume == pytest.approx(1e-9 * first.union(closed).volume, rel=3e-3)
    assert len(surface.repairs) >= 1
    # Away from the seam and the hole, the surface lies within a tenth of a cell of 0.086 mm of the
    # triangles, which lie up to 0.03 mm inside the balls.
    centres = np.array([[0, 0, 0], [6e-3, 0, 0]])
    radii = np.linalg.norm(surface.vertices[:, None] - centres, axis=2).min(axis=1)
    off_seam = np.abs(surface.vertices[:, 0] - 3e-3) > 0.2e-3
    assert np.quantile(np.abs(radii - 8e-3)[off_seam], 0.99) < 0.04e-3
    assert np.abs(radii - 8e-3)[off_seam].max() < 0.2e-3


def test_a_box_on_a_box_is_united_on_request(tmp_path):
    stacked = trimesh.util.concatenate([box((0, 0, 0), (9, 9, 9)), box((3, 3, 9), (6, 6, 12))])
    path = written(tmp_path / "stacked.stl", stacked)
    with raises_code("mesh_faulty"):
        at.load_surface(path, scale=1e-3)
    united = at.load_surface(path, scale=1e-3, union=True)
    assert united.volume == pytest.approx((729 + 27) * 1e-9, rel=3e-3)


def test_bores_are_filled_and_fins_removed_on_request(tmp_path):
    # A block with a bore of 1 mm and a fin of 0.4 mm, which alone would be rejected as too thin.
    block = box((0, 0, 0), (10, 8, 6))
    bore = trimesh.creation.cylinder(0.5, segment=[[3, 4, -1], [3, 4, 7]])
    fin = box((6, 0, 5), (6.4, 8, 9))
    path = written(tmp_path / "block.stl", trimesh.util.concatenate([block.difference(bore), fin]))
    surface = at.load_surface(path, scale=1e-3, smallest=1.5e-3)
    mesh = trimesh.Trimesh(surface.vertices, surface.triangles)
    assert mesh.is_watertight
    assert mesh.euler_number == 2
    # The true body is the block without bore and fin. Its edges are rounded.
    assert surface.volume == pytest.approx(480e-9, rel=0.05)
    true_body = at.Surface(1e-3 * block.vertices, np.array(block.faces))
    assert np.abs(true_body.depth(surface.vertices)).max() < 0.4e-3
    check_surface(surface)
    assert "cm³ became 0.4" in surface.repairs[0]


def test_details_that_are_too_large_or_too_small_for_the_body_are_rejected(tmp_path):
    path = written(tmp_path / "box.stl", box((0, 0, 0), (10, 8, 2)))
    with raises_code("out_of_range"):
        at.load_surface(path, scale=1e-3, smallest=3e-3)
    with raises_code("out_of_range"):
        at.load_surface(path, scale=1e-3, smallest=0.1e-3)
