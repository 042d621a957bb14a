"""Limits of edges: by the radius of tight bends and the width of narrow strips."""

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.geometry.mesh.remeshing import tip_sizes
from airtact.geometry.mesh.triangles import enclosed_volume
from geometry.mesh.meshes import torus_mesh


def test_a_thin_ring_keeps_its_shape_however_large_the_panels_asked():
    vertices, triangles = torus_mesh(0.02, 0.001, around=120, across=24)
    panels = at.Surface(vertices, triangles).panelled(8e-3)
    assert enclosed_volume(panels.quadratic_triangles) == pytest.approx(
        2 * np.pi**2 * 0.02 * 0.001**2, rel=1e-2
    )
    assert panels.deviation.max() < 5e-5


def test_a_needle_keeps_its_shape():
    rod = trimesh.creation.cylinder(radius=0.0005, height=0.04, sections=16)
    panels = at.Surface(np.array(rod.vertices), np.array(rod.faces)).panelled(5.5e-3)
    assert enclosed_volume(panels.quadratic_triangles) == pytest.approx(
        np.pi * 0.0005**2 * 0.04, rel=1e-2
    )
    assert panels.deviation.max() < 5e-5


def test_tips_limit_edges_by_their_radius_and_straight_sides_do_not():
    capsule = trimesh.creation.capsule(height=0.03, radius=0.004, count=[32, 32])
    vertices = np.array(capsule.vertices)
    height = vertices[:, 2]
    sizes = tip_sizes(
        vertices, np.array(capsule.faces), np.zeros((0, 2), dtype=np.int64), largest=9e-3, turn=0.7
    )
    low, high = height.min(), height.max()
    round_part = (height < low + 3e-3) | (height > high - 3e-3)
    assert sizes[round_part] == pytest.approx(0.7 * 0.004, rel=0.1)
    side = (height > low + 8e-3) & (height < high - 8e-3)
    assert (sizes[side] == 9e-3).all()
