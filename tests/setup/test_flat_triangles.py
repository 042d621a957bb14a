"""Flat triangles of panels enclose what the panels do, and are closed where panels of one size meet."""

import numpy as np
import pytest

import airtact as at
from airtact.geometry.mesh.quadratic_triangles import cut
from airtact.geometry.mesh.topology import cone_volumes, edge_twins
from airtact.setup.panel_files import flat_triangles
from geometry.mesh.meshes import box_mesh, torus_mesh

BODIES = {
    "ball": at.sphere(0.01, 3e-3),
    "rod": at.capsule((0, 0, 0), (0, 0, 0.02), 5e-3, 2e-3),
    "box": at.Surface(*box_mesh()),
    "ring": at.Surface(*torus_mesh(0.02, 0.006, around=48, across=24)),
}
EXACT = {  # volumes in closed form
    "ball": 4 / 3 * np.pi * 0.01**3,
    "rod": np.pi * 5e-3**2 * 0.02 + 4 / 3 * np.pi * 5e-3**3,
    "box": 0.02 * 0.03 * 0.04,
    "ring": 2 * np.pi**2 * 0.02 * 0.006**2,
}


@pytest.mark.parametrize("name", BODIES)
def test_triangles_of_panels_of_one_size_are_closed_and_right(name):
    panels = BODIES[name].panelled(4e-3).quadratic_triangles
    vertices, triangles = flat_triangles(panels)
    assert len(triangles) == 4 * len(panels)
    assert np.all(edge_twins(triangles) >= 0)
    assert len(vertices) == len(triangles) // 2 + (0 if name == "ring" else 2)  # Euler
    assert cone_volumes(vertices[triangles]).sum() == pytest.approx(EXACT[name], rel=0.04)


@pytest.mark.parametrize("parts", [2, 3])
def test_a_panel_in_pieces_beside_a_whole_one_leaves_no_crack(parts):
    panels = BODIES["ball"].panelled(4e-3).quadratic_triangles
    counts = np.ones(len(panels), dtype=int)
    counts[:5] = parts
    mixed, _ = cut(panels, counts)
    vertices, triangles = flat_triangles(mixed)
    assert len(triangles) > 4 * len(mixed)
    assert np.all(edge_twins(triangles) >= 0)
    assert cone_volumes(vertices[triangles]).sum() == pytest.approx(EXACT["ball"], rel=0.04)


def test_nodes_that_part_by_a_little_are_joined():
    panels = BODIES["ball"].panelled(4e-3).quadratic_triangles
    apart = panels + np.random.default_rng(2).uniform(-5e-5, 5e-5, panels.shape)
    vertices, triangles = flat_triangles(apart)
    assert np.all(edge_twins(triangles) >= 0)
    exact, _ = flat_triangles(panels)
    assert len(vertices) == len(exact)


def test_bodies_that_stand_apart_are_not_joined():
    near = np.concatenate(
        [at.sphere(0.01, 3e-3, (x, 0, 0)).panelled(4e-3).quadratic_triangles for x in (0.0, 0.0203)]
    )
    _, triangles = flat_triangles(near)
    assert len(triangles) == 4 * len(near)
    assert np.all(edge_twins(triangles) >= 0)
