"""Curved panels: their sizes are those asked for; surface, volume and edges are kept."""

from itertools import pairwise

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.geometry.mesh.triangles import (
    cut,
    enclosed_volume,
    longest_edges,
    middles_of,
    panel_areas,
    points_at,
    smallest_angles,
)
from airtact.geometry.panels import panels_of
from faults import raises_code
from geometry.mesh.meshes import box_mesh
from paths import GENERIC_HAND
from references import axisymmetric

NOWHERE = np.empty((0, 3))


def surface_of(mesh: trimesh.Trimesh, **settings) -> at.Surface:
    return at.Surface(np.array(mesh.vertices), np.array(mesh.faces), **settings)


def wanted(area: float, edge: float) -> float:
    return area / (np.sqrt(3) / 4 * edge**2)


def test_cutting_keeps_the_quadratic_surface():
    panels = at.sphere(0.01, 0.006).panelled(0.006).quadratic_triangles
    pieces, parents = cut(panels, np.arange(len(panels)) % 3 + 1)
    assert len(pieces) == ((np.arange(len(panels)) % 3 + 1) ** 2).sum()
    assert enclosed_volume(pieces) == pytest.approx(enclosed_volume(panels), rel=1e-12)
    assert panel_areas(pieces).sum() == pytest.approx(panel_areas(panels).sum(), rel=1e-4)
    assert np.array_equal(np.bincount(parents), (np.arange(len(panels)) % 3 + 1) ** 2)


@pytest.mark.parametrize("edge", [2e-3, 3e-3, 5e-3])
@pytest.mark.parametrize(
    "shape", [at.sphere(0.007, 0.004), at.capsule((0, 0, 0), (0, 0, 0.03), 0.006, 0.004)]
)
def test_panels_of_primitives_have_the_size_asked_and_the_exact_volume(shape, edge):
    panels = shape.panelled(edge).quadratic_triangles
    assert 0.9 * wanted(shape.area, edge) <= len(panels) <= 2.5 * wanted(shape.area, edge)
    assert enclosed_volume(panels) == pytest.approx(shape.volume, rel=1e-4)


@pytest.mark.parametrize("edge", [2e-3, 5e-3, 1.0])
def test_a_box_keeps_its_faces_edges_and_volume(edge):
    box = at.Surface(*box_mesh(high=(0.01, 0.02, 0.03)))
    panels = box.panelled(edge)
    assert enclosed_volume(panels.quadratic_triangles) == pytest.approx(6e-6, rel=1e-9)
    assert panel_areas(panels.quadratic_triangles).sum() == pytest.approx(2.2e-3, rel=1e-9)
    assert panels.deviation.max() < 1e-12
    assert longest_edges(panels.quadratic_triangles).max() < 2.2 * edge
    assert len(panels.quadratic_triangles) < 3 * wanted(2.2e-3, edge) + 60


def test_a_plate_gets_no_slivers_on_its_narrow_sides():
    plate = at.Surface(*box_mesh(high=(0.02, 0.02, 0.0006)))
    panels = plate.panelled(1.5e-3).quadratic_triangles
    assert enclosed_volume(panels) == pytest.approx(2.4e-7, rel=1e-9)
    assert smallest_angles(panels).min() > 8


@pytest.mark.parametrize("level", [2, 3, 4])
def test_a_round_mesh_becomes_round(level):
    """Panels of flat triangles with corners on a sphere lie on the sphere."""
    surface = surface_of(trimesh.creation.icosphere(level, radius=0.01))
    panels = surface.panelled(4e-3).quadratic_triangles
    off = np.abs(np.linalg.norm(panels, axis=2) - 0.01).max()
    flat = 0.01 - np.linalg.norm(surface.corners.mean(axis=1), axis=1).min()
    assert off < max(0.15 * flat, 2e-5)
    assert enclosed_volume(panels) == pytest.approx(4e-6 / 3 * np.pi, rel=2e-3)
    assert len(panels) < 3 * wanted(surface.area, 4e-3)
    assert smallest_angles(panels).min() > 20


def test_panels_of_a_rough_scan_lie_in_its_middle_and_are_as_few():
    """20 micrometres of noise on 20,000 triangles neither moves the surface nor adds panels."""
    mesh = trimesh.creation.icosphere(5, radius=0.01)
    noise = 2e-5 * np.random.default_rng(1).standard_normal((len(mesh.vertices), 1))
    rough = at.Surface(np.array(mesh.vertices) * (1 + noise / 0.01), np.array(mesh.faces))
    smooth = surface_of(mesh)
    edge = 5e-3
    panels = rough.panelled(edge).quadratic_triangles
    assert len(panels) < 1.5 * len(smooth.panelled(edge).quadratic_triangles)
    assert enclosed_volume(panels) == pytest.approx(4e-6 / 3 * np.pi, rel=2e-3)


def test_sharp_edges_stay_sharp_and_round_rims_round():
    """The caps of a cylinder of 24 sides stay flat, its rim and side become round."""
    cylinder = surface_of(trimesh.creation.cylinder(radius=0.008, height=0.02, sections=24))
    panels = cylinder.panelled(3e-3).quadratic_triangles
    assert np.abs(panels[:, :, 2]).max() == pytest.approx(0.01, rel=1e-6)
    assert np.linalg.norm(panels[:, :, :2], axis=2).max() == pytest.approx(0.008, rel=3e-3)
    assert enclosed_volume(panels) == pytest.approx(np.pi * 0.008**2 * 0.02, rel=3e-3)
    flat = np.abs(panels[:, :, 2]).min(axis=1) > 0.00999
    assert panel_areas(panels[flat]).sum() == pytest.approx(2 * np.pi * 0.008**2, rel=5e-3)
    faceted = surface_of(
        trimesh.creation.cylinder(radius=0.008, height=0.02, sections=24), sharp_degrees=0
    )
    assert faceted.volume == pytest.approx(
        24 / 2 * np.sin(2 * np.pi / 24) * 0.008**2 * 0.02, rel=1e-9
    )


def test_the_cut_of_a_wrist_stays_flat():
    """A closed half sphere with a wavy rim, closed by triangles from rim to rim."""
    angle = 2 * np.pi * np.arange(24) / 24
    rim = np.stack([0.02 * np.cos(angle), 0.02 * np.sin(angle), 0.0006 * np.cos(7 * angle)], axis=1)
    vertices = np.concatenate([rim, rim * [1, 1, 0] + [0, 0, 0.02], [[0, 0, 0.02]]])
    side = [[i, (i + 1) % 24, 24 + i] for i in range(24)] + [
        [(i + 1) % 24, 24 + (i + 1) % 24, 24 + i] for i in range(24)
    ]
    lid = [[24 + i, 24 + (i + 1) % 24, 48] for i in range(24)]
    body = at.Surface(vertices, np.array(side + lid + [[0, i + 1, i] for i in range(1, 23)]))
    assert body.panelled(4e-3).quadratic_triangles[:, :, 2].min() > -0.0013


def test_panels_move_with_the_surface_to_the_last_bit():
    mesh = surface_of(trimesh.creation.icosphere(3, radius=0.01))
    pose = at.Pose.turn((1, 2, 3), 0.7, translation=(0.01, 0.02, 0.03))
    there = mesh.moved(pose).panelled(4e-3).quadratic_triangles
    assert np.abs(there - pose.apply(mesh.panelled(4e-3).quadratic_triangles)).max() < 1e-15


def test_panels_are_finer_beside_points_and_facing_bodies_only():
    left, right = (at.sphere(0.008, 0.004, centre=(side * 0.0084, 0.0, 0.0)) for side in (-1, 1))
    point = np.array([[-0.0084, 0.0, 0.0085]])
    panels = panels_of([left.shape, right.shape], 5e-3, point, 1e-3)
    centres = panels.quadratic_triangles.mean(axis=1)
    edges = longest_edges(panels.quadratic_triangles)
    assert edges[np.linalg.norm(centres - point, axis=1) < 1.5e-3].max() < 2.5e-3
    assert edges[np.linalg.norm(centres, axis=1) < 2e-3].max() < 3.5e-3
    assert edges[np.abs(centres[:, 0]) > 0.013].min() > 3e-3
    assert np.array_equal(np.unique(panels.body), [0, 1])


@pytest.mark.parametrize("edge", [0.0, -1.0, np.nan])
def test_an_edge_is_above_zero(edge):
    with raises_code("out_of_range", f"{edge:g} m"):
        at.sphere(0.008, 0.004).panelled(edge)


@pytest.mark.parametrize("edge", [8e-3, 3e-3])
def test_panels_leave_no_holes_at_the_tips_of_an_elongated_mesh(edge):
    """The tips of this spheroid have a radius of 1.4 mm, less than the edges asked."""
    axes = 1e-3 * np.array([3.8, 3.8, 10.3])
    mesh = trimesh.creation.icosphere(5)
    body = at.Surface(np.array(mesh.vertices) * axes, np.array(mesh.faces))
    panels = body.panelled(edge).quadratic_triangles
    assert panel_areas(panels).sum() == pytest.approx(body.area, rel=2e-3)
    centres, normals = middles_of(panels)
    true = centres / axes**2
    cosine = np.einsum("pd,pd->p", normals, true) / np.linalg.norm(true, axis=1)
    assert cosine.min() > np.cos(np.radians(10))


def test_a_coarser_edge_takes_no_more_panels():
    """A capped finger: a cylinder with a round tip, cut off and closed by a flat cap."""
    radius = 9e-3
    side = axisymmetric.line((radius, 0), (radius, 0.0385))
    tip = axisymmetric.arc((0, 0.0385), (radius, radius), 0, 90)
    cap = axisymmetric.line((0, 0), (radius, 0))
    finger = axisymmetric.surface(axisymmetric.Meridian([cap, side, tip], radius), 2e-3)
    body = at.Surface(finger.vertices, finger.triangles)
    edges = (12e-3, 8e-3, 5e-3)
    counts = [len(body.panelled(edge).quadratic_triangles) for edge in edges]
    assert counts == sorted(counts)


def test_a_bead_smaller_than_the_panels_asked_keeps_its_shape():
    bead = surface_of(trimesh.creation.icosphere(3, radius=0.00026))
    panels = bead.panelled(5.5e-3)
    assert enclosed_volume(panels.quadratic_triangles) == pytest.approx(
        4 / 3 * np.pi * 0.00026**3, rel=1e-2
    )
    pair = trimesh.util.concatenate(
        [
            trimesh.creation.icosphere(3, radius=0.01),
            trimesh.creation.icosphere(3, radius=0.0005).apply_translation([0.013, 0, 0]),
        ]
    )
    panels = surface_of(pair).panelled(5.5e-3)
    small = panels.quadratic_triangles[panels.quadratic_triangles[:, 0, 0] > 0.012]
    assert enclosed_volume(small) == pytest.approx(4 / 3 * np.pi * 0.0005**3, rel=3e-2)


def test_triangles_and_panels_apart_are_measured():
    """Flat triangles with corners on a sphere lie a sagitta under it."""
    mesh = surface_of(trimesh.creation.icosphere(2, radius=0.01))
    panels = mesh.panelled(3e-3)
    sagitta = 0.01 - np.linalg.norm(mesh.corners.mean(axis=1), axis=1).min()
    assert panels.farthest[0] == pytest.approx(sagitta, rel=0.1)
    assert 0.2 * sagitta < panels.mean_distance[0] < 0.8 * sagitta
    assert at.sphere(0.01, 0.004).panelled(3e-3).farthest[0] == 0


def test_panels_of_a_smooth_mesh_lie_as_near_as_asked():
    ring = 8e-3
    tube = 2e-3
    shape = axisymmetric.surface(axisymmetric.torus(ring, tube), 1e-3).shape

    def off(away: float) -> float:
        panels = panels_of([shape], 4e-3, NOWHERE, 2e-3, away=away).quadratic_triangles
        points = np.concatenate(
            [
                points_at(panels, np.full((len(panels), 2), place))[0]
                for place in ((1 / 3, 1 / 3), (0.6, 0.2), (0.2, 0.2))
            ]
        )
        from_tube = np.hypot(np.hypot(points[:, 0], points[:, 1]) - ring, points[:, 2]) - tube
        return float(np.sqrt(np.mean(from_tube**2)))

    assert off(1.5e-7) < 1.5e-7
    assert off(np.inf) > 3e-7


def test_where_a_wall_ends_in_a_knife_s_edge_panels_stay_as_large_as_asked() -> None:
    """The cut wrist of a hand, and skin between its fingers, are of no thickness somewhere."""
    hand = at.load_surface(GENERIC_HAND)
    coarse, fine = (hand.panelled(edge).quadratic_triangles for edge in (16e-3, 8e-3))
    # Kinks between coarse triangles are not resolved as bends.
    assert len(coarse) < len(fine) < 1.9 * wanted(hand.area, 8e-3)
    assert enclosed_volume(fine) == pytest.approx(hand.volume, rel=0.005)
    assert smallest_angles(fine).min() > 15


def test_a_single_edge_between_smooth_parts_is_not_sharp() -> None:
    """The skin between the fingers of a coarse hand has such edges; the cut at the wrist is sharp."""
    ridges = at.load_surface(GENERIC_HAND).shape.mesh.ridges
    assert len(ridges) == 20
    assert ridges[:, :, 1].min() > 0.06


def test_panels_of_a_bent_wall_are_about_two_thicknesses_long_and_flat_ones_longer() -> None:
    wall = 1e-3
    bowl = axisymmetric.surface(axisymmetric.shell(10e-3, wall, 90.0), 1e-3)
    assert longest_edges(bowl.panelled(3e-3).quadratic_triangles).max() < 2.2 * wall
    plate = at.Surface(*box_mesh(high=(0.02, 0.02, wall))).panelled(3e-3).quadratic_triangles
    assert 2.5 * wall < longest_edges(plate).max() < 4.01 * wall


def test_a_ball_with_a_bore_takes_no_more_panels_at_a_coarser_accuracy() -> None:
    """The bore decides the panels; coarsening the mesh first would distort it."""
    angle = np.linspace(np.arcsin(3 / 8), np.pi - np.arcsin(3 / 8), 21)
    arc = 8e-3 * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    ball = trimesh.creation.revolve(np.concatenate([arc, arc[:1]]), sections=40)
    scene = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(surface_of(ball))], frequency=40e3)
    source = at.Monopoles(np.array([[0.0, 0.0, 0.2]]), np.ones(1))
    counts = [
        at.BoundaryElement(accuracy=accuracy).unknowns(scene, source)
        for accuracy in (0.005, 0.01, 0.03, 0.1)
    ]
    assert all(coarse <= 1.02 * fine for fine, coarse in pairwise(counts))
    assert counts[2] < 1200  # 1,776 where the mouth of the bore counted as a thin wall


def test_a_box_with_rounded_corners_keeps_panels_as_large_as_asked() -> None:
    """The limit by roundness must not follow small round corners."""
    box = trimesh.creation.box((20.0, 20.0, 20.0)).subdivide().subdivide().subdivide()
    core = np.clip(box.vertices, -9.0, 9.0)
    away = box.vertices - core
    box.vertices = core + away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    panels = surface_of(box.apply_scale(1e-3)).panelled(5e-3)
    assert len(panels.quadratic_triangles) < 20 * wanted(2.4e-3, 5e-3)
