"""The closest point on curved panels, against brute force over dense samples, and the sign of the depth."""

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.mesh.panel_tree import panel_tree
from airtact.mesh.quadratic_triangles import cut, points_at, shape_functions
from airtact.surfaces.curved_mesh import CurvedMesh
from airtact.surfaces.mesh_shape import CurvedShape
from mesh.meshes import box_mesh


def bumpy() -> at.Surface:
    """A closed surface, convex and concave, of panels curved by their normals."""
    mesh = trimesh.creation.icosphere(2)
    way = np.array(mesh.vertices)
    radius = 0.01 * (1 + 0.25 * np.sin(3 * way[:, 0]) * np.cos(4 * way[:, 1]) + 0.1 * way[:, 2])
    return at.Surface(radius[:, None] * way, np.array(mesh.faces))


def curved_mesh(surface: at.Surface) -> CurvedMesh:
    assert isinstance(surface.shape, CurvedShape)
    return surface.shape.mesh


@pytest.mark.usefixtures("variant")
def test_the_closest_panel_is_that_of_a_search_through_all(rng):
    quadratic_triangles = curved_mesh(bumpy()).quadratic_triangles
    points = rng.normal(scale=0.01, size=(200, 3))
    panel, foot, distance = panel_tree(quadratic_triangles).closest(points)
    u, v = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    places = np.stack([u, v], axis=2)[u + v <= 1 + 1e-12]
    skin = np.einsum("qn,tnd->tqd", shape_functions(places), quadratic_triangles).reshape(-1, 3)
    for point, found in zip(points, distance, strict=True):
        searched = np.linalg.norm(skin - point, axis=1).min()
        spacing = 0.004 / 40
        assert found <= searched + 1e-12
        assert searched - found < spacing**2 / (2 * max(found, spacing)) + 1e-12
    place, _ = points_at(quadratic_triangles[panel], foot)
    assert np.linalg.norm(place - points, axis=1) == pytest.approx(distance, abs=1e-15)


@pytest.mark.parametrize("count", [1, 3, 4, 5, 17])
def test_a_tree_of_few_panels_is_searched_too(rng, count):
    quadratic_triangles = curved_mesh(bumpy()).quadratic_triangles[:count]
    points = rng.normal(scale=0.01, size=(20, 3))
    alone = np.stack([panel_tree(quadratic_triangles[i : i + 1]).closest(points)[2] for i in range(count)])
    panel, _, distance = panel_tree(quadratic_triangles).closest(points)
    assert np.array_equal(distance, alone.min(axis=0))
    assert np.array_equal(panel, alone.argmin(axis=0))


@pytest.mark.parametrize("step", [1e-9, 1e-6, 1e-4])
def test_points_off_the_skin_along_its_normal_are_that_deep(rng, step):
    mesh = curved_mesh(bumpy())
    pieces, _ = cut(mesh.quadratic_triangles, np.full(len(mesh.quadratic_triangles), 2))
    references = rng.dirichlet([1, 1, 1], size=len(pieces))[:, 1:]
    place, normal = points_at(pieces, references)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    for side in (1, -1):  # where the skin bends it may be nearer elsewhere
        depth = side * mesh.depth(place - side * step * normal)
        assert depth.max() < step + 1e-12
        assert depth.min() > 0.5 * step
        assert np.median(depth) == pytest.approx(step, abs=1e-12)


def test_off_edges_and_corners_the_sign_is_right(rng):
    """Seen from a corner or edge of a box the closest panels disagree, and their weighted normal decides."""
    box = at.Surface(*box_mesh(high=(0.01, 0.02, 0.03)))
    points = rng.uniform(-0.01, 0.04, size=(4000, 3))
    outside = np.maximum(np.maximum(-points, points - [0.01, 0.02, 0.03]), 0)
    inside = np.minimum(points, [0.01, 0.02, 0.03] - points).min(axis=1)
    true = np.where(inside > 0, inside, -np.linalg.norm(outside, axis=1))
    assert np.abs(box.depth(points) - true).max() < 1e-15


def test_depth_and_closest_points_move_with_the_body(rng):
    body = bumpy()
    pose = at.Pose.turn((3, 2, 1), 1.1, translation=(0.1, -0.2, 0.3))
    points = rng.normal(scale=0.01, size=(50, 3))
    there = body.moved(pose)
    assert there.depth(pose.apply(points)) == pytest.approx(body.depth(points), abs=1e-15)
    assert there.shape.project(pose.apply(points)) == pytest.approx(pose.apply(body.shape.project(points)), abs=1e-15)
    assert there.area == body.area
    assert there.volume == body.volume


def test_creases_are_found_and_projected_on():
    cylinder = trimesh.creation.cylinder(radius=0.008, height=0.02, sections=24)
    mesh = curved_mesh(at.Surface(np.array(cylinder.vertices), np.array(cylinder.faces)))
    assert mesh.creases.shape == (48, 3, 3)
    angle = np.linspace(0, 6, 50)
    points = np.stack([0.0083 * np.cos(angle), 0.0083 * np.sin(angle), np.full(50, 0.0099)], axis=1)
    found = mesh.project_on_sharp_edges(points)
    assert np.abs(np.linalg.norm(found[:, :2], axis=1) - 0.008).max() < 1e-6
    assert found[:, 2] == pytest.approx(0.01)
    assert np.abs(np.arctan2(found[:, 1], found[:, 0]) - np.arctan2(points[:, 1], points[:, 0])).max() < 1e-3
