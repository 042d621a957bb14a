"""The closest point on curved panels against dense samples, and the sign of the depth."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

import airtact as at
from airtact.geometry.mesh.triangles import cut, panel_tree, points_at, shape_functions
from airtact.geometry.mesh_shape import MeshShape, QuadraticMesh
from geometry.mesh.meshes import flat_mesh


def bumpy() -> at.Surface:
    """A closed surface, convex and concave, of panels curved by their normals."""
    mesh = trimesh.creation.icosphere(2)
    way = np.array(mesh.vertices)
    radius = 0.01 * (1 + 0.25 * np.sin(3 * way[:, 0]) * np.cos(4 * way[:, 1]) + 0.1 * way[:, 2])
    return at.Surface(radius[:, None] * way, np.array(mesh.faces))


def curved_mesh(surface: at.Surface) -> QuadraticMesh:
    assert isinstance(surface.shape, MeshShape)
    return surface.shape.mesh


@pytest.mark.usefixtures("variant")
def test_the_closest_panel_is_that_of_a_search_through_all(rng):
    quadratic_triangles = curved_mesh(bumpy()).quadratic_triangles
    points = rng.normal(scale=0.01, size=(60, 3))
    panel, foot, distance = panel_tree(quadratic_triangles).closest(points)
    u, v = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    places = np.stack([u, v], axis=2)[u + v <= 1 + 1e-12]
    skin = np.einsum("qn,tnd->tqd", shape_functions(places), quadratic_triangles).reshape(-1, 3)
    searched, _ = KDTree(skin).query(points)
    spacing = 0.004 / 40
    assert (distance <= searched + 1e-12).all()
    assert (searched - distance < spacing**2 / (2 * np.maximum(distance, spacing)) + 1e-12).all()
    place, _ = points_at(quadratic_triangles[panel], foot)
    assert np.linalg.norm(place - points, axis=1) == pytest.approx(distance, abs=1e-15)


@pytest.mark.parametrize("count", [1, 3, 4, 5, 17])
def test_a_tree_of_few_panels_is_searched_too(rng, count):
    quadratic_triangles = curved_mesh(bumpy()).quadratic_triangles[:count]
    points = rng.normal(scale=0.01, size=(20, 3))
    alone = np.stack(
        [panel_tree(quadratic_triangles[i : i + 1]).closest(points)[2] for i in range(count)]
    )
    panel, _, distance = panel_tree(quadratic_triangles).closest(points)
    assert np.array_equal(distance, alone.min(axis=0))
    assert np.array_equal(panel, alone.argmin(axis=0))


@pytest.mark.usefixtures("variant")
@pytest.mark.parametrize("within", [None, 0.01])
def test_panels_that_bulge_beyond_their_corners_are_not_left_out(rng, within):
    panels = 0.03 * rng.normal(size=(30, 1, 3)) + 0.01 * rng.normal(size=(30, 6, 3))
    inner = shape_functions(rng.dirichlet([1, 1, 1], size=5)[:, 1:]) @ panels
    points = np.concatenate([0.03 * rng.normal(size=(50, 3)), inner.reshape(-1, 3)])
    limits = None if within is None else np.full(len(points), within)
    alone = np.stack([panel_tree(panel[None]).closest(points, limits)[2] for panel in panels])
    assert np.array_equal(panel_tree(panels).closest(points, limits)[2], alone.min(axis=0))


@pytest.mark.usefixtures("variant")
def test_a_point_has_the_same_closest_panel_alone_and_among_others(rng):
    tree = panel_tree(curved_mesh(bumpy()).quadratic_triangles)
    points = rng.normal(scale=0.01, size=(300, 3))
    together = tree.closest(points)
    alone = [tree.closest(point[None]) for point in points]
    for values, single in zip(together, zip(*alone, strict=True), strict=True):
        assert np.array_equal(values, np.concatenate(single))


@pytest.mark.parametrize("step", [1e-9, 1e-6, 1e-4])
def test_points_off_the_surface_along_its_normal_are_that_deep(rng, step):
    mesh = curved_mesh(bumpy())
    pieces, _ = cut(mesh.quadratic_triangles, np.full(len(mesh.quadratic_triangles), 2))
    place, normal = points_at(pieces, rng.dirichlet([1, 1, 1], size=len(pieces))[:, 1:])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    for side in (1, -1):  # where the surface bends it may be nearer elsewhere
        depth = side * mesh.depth(place - side * step * normal)
        assert depth.max() < step + 1e-12
        assert depth.min() > 0.5 * step
        assert np.median(depth) == pytest.approx(step, abs=1e-12)


def test_sharp_edges_are_found_and_projected_on():
    cylinder = trimesh.creation.cylinder(radius=0.008, height=0.02, sections=24)
    mesh = curved_mesh(at.Surface(np.array(cylinder.vertices), np.array(cylinder.faces)))
    assert mesh.ridges.shape == (48, 3, 3)
    angle = np.linspace(0, 6, 50)
    points = np.stack([0.0083 * np.cos(angle), 0.0083 * np.sin(angle), np.full(50, 0.0099)], axis=1)
    found = mesh.project_on_sharp_edges(points)
    assert np.abs(np.linalg.norm(found[:, :2], axis=1) - 0.008).max() < 1e-6
    assert found[:, 2] == pytest.approx(0.01)
    assert (
        np.abs(np.arctan2(found[:, 1], found[:, 0]) - np.arctan2(points[:, 1], points[:, 0])).max()
        < 1e-3
    )


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
        nearest = trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1)))
        distance[row] = np.linalg.norm(point - nearest, axis=1)
    return distance.min(axis=1)


def test_depth_in_a_hand_has_the_sign_of_the_solid_angle_and_the_size_of_an_exhaustive_search(
    hand_file, rng
):
    hand = at.load_surface(hand_file)
    points = rng.uniform(
        hand.vertices.min(axis=0) - 0.01, hand.vertices.max(axis=0) + 0.01, (400, 3)
    )
    depth = flat_mesh(hand.vertices, hand.triangles).depth(points)
    inside = winding(points, hand.corners)
    assert np.allclose(inside, np.round(inside), atol=1e-9)
    assert np.array_equal(depth > 0, inside > 0.5)
    assert 20 < (depth > 0).sum() < 380
    assert np.allclose(
        np.abs(depth[:100]), nearest_of_all(points[:100], hand.corners), rtol=0, atol=1e-15
    )


def test_points_just_off_edges_and_corners_of_a_concave_body_have_the_right_side(rng):
    # An L: the notch has a concave edge, where plain face normals of either side mislead.
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]) * 0.01
    vertices = np.concatenate([np.column_stack([outline, np.full(6, z)]) for z in (0.0, 0.01)])
    lid = [[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]]
    sides = [t for i in range(6) for j in [(i + 1) % 6] for t in ([i, j, j + 6], [i, j + 6, i + 6])]
    triangles = np.array([t[::-1] for t in lid] + [[i + 6 for i in t] for t in lid] + sides)
    corners = vertices[triangles]
    edges = (
        corners.mean(axis=1)[:, None] * 0.0
        + (corners + np.roll(corners, -1, axis=1)).reshape(len(corners), 3, 3) / 2
    )
    start = np.concatenate([vertices, edges.reshape(-1, 3)])
    points = np.repeat(start, 40, axis=0) + 1e-4 * rng.normal(size=(40 * len(start), 3))
    depth = flat_mesh(vertices, triangles).depth(points)
    x, y, z = points.T
    inside = (
        (np.minimum(x, y) > 0)
        & (np.maximum(x, y) < 0.02)
        & ((x < 0.01) | (y < 0.01))
        & (z > 0)
        & (z < 0.01)
    )
    assert np.array_equal(depth > 0, inside)
