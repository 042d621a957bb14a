"""Limits of edges: by the radius of tight bends and the width of narrow strips."""

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.geometry.mesh.edge_limits import bend_sizes, strip_sizes
from airtact.geometry.mesh.quadratic_triangles import enclosed_volume
from geometry.mesh.meshes import box_mesh, torus_mesh

NO_RIDGES = np.zeros((0, 2), dtype=np.int64)


@pytest.mark.parametrize("radius", [0.5e-3, 1e-3, 1.8e-3])
def test_a_tight_tube_asks_for_its_radius(radius):
    vertices, triangles = torus_mesh(0.02, radius, around=120, across=24)
    sizes = bend_sizes(vertices, triangles, NO_RIDGES, 8e-3)
    assert 0.9 * radius < sizes.min()
    assert sizes.max() < 1.6 * radius


def test_a_wide_bend_a_kink_and_a_thin_wall_ask_for_nothing():
    ball = trimesh.creation.icosphere(4, radius=0.02)
    assert bend_sizes(np.array(ball.vertices), np.array(ball.faces), NO_RIDGES, 5e-3).min() == 5e-3
    roof = trimesh.creation.cone(
        radius=0.02, height=0.02, sections=8
    )  # its side turns by 60 degrees at the kinks
    vertices, triangles = trimesh.remesh.subdivide_loop(
        np.array(roof.vertices), np.array(roof.faces), 0
    )
    assert bend_sizes(vertices, triangles, NO_RIDGES, 1e-4).min() == 1e-4
    plate = (
        trimesh.creation.box((0.02, 0.02, 0.0005)).subdivide().subdivide().subdivide().subdivide()
    )
    ends = np.sort(plate.face_adjacency_edges[plate.face_adjacency_angles > 1], axis=1)
    sizes = bend_sizes(np.array(plate.vertices), np.array(plate.faces), ends.astype(np.int64), 5e-3)
    assert sizes.min() == 5e-3


def test_a_strip_asks_for_twice_its_width_along_its_rims_only():
    vertices, triangles = box_mesh(high=(0.02, 0.02, 0.0006))
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    ridges = mesh.face_adjacency_edges[mesh.face_adjacency_angles > 1].astype(np.int64)
    inner = np.concatenate([vertices, [[0.01, 0.01, 0.0006], [0.01, 0.0, 0.0006]]])
    ridges = np.concatenate([ridges, [[8, 9]]])  # a ridge that runs to the middle of a face
    sizes = strip_sizes(inner, ridges, 5e-3)
    assert sizes[9] == pytest.approx(1.2e-3)
    assert sizes[8] == 5e-3
    assert strip_sizes(vertices, NO_RIDGES, 5e-3).min() == 5e-3


@pytest.mark.parametrize("edge", [3e-3, 8e-3])
def test_a_thin_ring_keeps_its_shape_however_large_the_panels_asked(edge):
    vertices, triangles = torus_mesh(0.02, 0.001, around=120, across=24)
    panels = at.Surface(vertices, triangles).panelled(edge)
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
