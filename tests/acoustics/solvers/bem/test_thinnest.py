"""The thickness of shapes is what is measured on their panels."""

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.solvers.bem.quadrature import place_nodes, thickness
from airtact.geometry.panels import panels_of
from airtact.hands.body import Hulls
from airtact.hands.shape import HandShape
from references.hand_poses import example

LARGEST = 20e-3


@pytest.mark.parametrize(
    ("surface", "diameter"),
    [(at.sphere(3e-3, 1e-3), 6e-3), (at.capsule((0, 0, 0), (0, 0.01, 0.02), 4e-3, 2e-3), 8e-3)],
    ids=["sphere", "capsule"],
)
def test_round_bodies_have_the_thickness_of_their_shape(surface, diameter):
    panels = panels_of([surface.shape], 2e-3, np.empty((0, 3)), 1e-3)
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    assert surface.shape.thinnest == diameter
    assert np.allclose(thickness(nodes, LARGEST), diameter, rtol=0.05)
    assert (thickness(nodes, diameter, np.full(len(nodes.points), diameter)) == diameter).all()


def test_a_thin_body_beside_a_thick_one_is_still_measured():
    shapes = [at.sphere(3e-3, 1e-3).shape, at.sphere(1e-3, 5e-4, (9e-3, 0, 0)).shape]
    panels = panels_of(shapes, 1e-3, np.empty((0, 3)), 5e-4)
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    known = thickness(nodes, 5e-3, np.array([shape.thinnest for shape in shapes])[nodes.body])
    assert (known[nodes.body == 0] == 5e-3).all()
    assert np.allclose(known[nodes.body == 1], 2e-3, rtol=0.05)


def test_a_hull_is_nowhere_thinner_than_its_smallest_ball():
    balls = np.array(
        [
            [0.0, 0.0, 0.0, 6e-3],
            [0.0, 5e-3, 20e-3, 5e-3],
            [16e-3, 0.0, 0.0, 7e-3],
            [18e-3, 0.0, 20e-3, 6e-3],
        ]
    )
    apart = np.array([[0.0, 1.0], [1.0, 0.0]])
    hulls = Hulls(balls, np.array([[0, 1, -1], [2, 3, -1]]), np.zeros((2, 2)), apart)
    shape = HandShape(hulls, at.Pose.identity())
    panels = shape.panels(3e-3)
    nodes = place_nodes(panels, np.zeros(len(panels), dtype=np.int64), np.zeros(len(panels)))
    assert shape.least_thickness == 10e-3
    assert thickness(nodes, 12e-3).min() == pytest.approx(10e-3, rel=0.06)


def test_a_hand_has_creases_and_a_bound_away_from_them_only():
    joints, radii = example("relaxed")
    shape = at.hand_from_joints(joints, radii).surface.shape
    panels, most = shape.panels(6e-3), 5.7e-3
    nodes = place_nodes(panels, np.zeros(len(panels), dtype=np.int64), np.zeros(len(panels)))
    least, found = shape.thickness_at(nodes.points, nodes.normals, most), thickness(nodes, most)
    assert shape.least_thickness == 0.0
    assert (found < 0.8 * most).any()
    assert (least[found < 0.99 * most] == 0.0).all()
    assert 0.85 < (least == most).mean() < 1.0
    assert np.array_equal(thickness(nodes, most, least), found)
