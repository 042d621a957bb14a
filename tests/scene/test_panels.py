"""Curved panels: cutting keeps the surface, sizes follow what is asked, primitives hold their volume."""

import numpy as np
import pytest

import airtact as at
from airtact.scene.panels import cut, enclosed_volume, longest_edges, panelled, scene_panels, surface_panels

NOWHERE = np.empty((0, 3))


def area_sum(panels: np.ndarray) -> float:
    corners = panels[:, :3]
    return 0.5 * float(
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    )


def test_cutting_keeps_the_quadratic_surface():
    panels = surface_panels(at.sphere(0.01, 0.006))
    pieces, parents = cut(panels, np.arange(len(panels)) % 3 + 1)
    assert len(pieces) == ((np.arange(len(panels)) % 3 + 1) ** 2).sum()
    assert enclosed_volume(pieces) == pytest.approx(enclosed_volume(panels), rel=1e-12)
    assert np.array_equal(np.bincount(parents), (np.arange(len(panels)) % 3 + 1) ** 2)


def test_flat_panels_enclose_the_volume_of_a_box():
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float) * [0.01, 0.02, 0.03]
    faces = [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
    ]
    faces += [[1, 5, 7], [1, 7, 3]]
    box = at.Surface(corners, np.array(faces))
    assert enclosed_volume(surface_panels(box)) == pytest.approx(6e-6, rel=1e-12)
    fine = panelled(box, 2e-3)
    assert enclosed_volume(fine) == pytest.approx(6e-6, rel=1e-12)
    assert area_sum(fine) == pytest.approx(2.2e-3, rel=1e-12)
    assert longest_edges(fine).max() <= 1.5 * 2e-3
    assert len(panelled(box, 1.0)) == 12


@pytest.mark.parametrize("edge", [2e-3, 3e-3, 5e-3])
@pytest.mark.parametrize("shape", [at.sphere(0.007, 0.004), at.capsule((0, 0, 0), (0, 0, 0.03), 0.006, 0.004)])
def test_panels_of_primitives_have_the_size_asked_and_the_exact_volume(shape, edge):
    panels = panelled(shape, edge)
    wanted = shape.primitive.area / (np.sqrt(3) / 4 * edge**2)
    assert 0.9 * wanted <= len(panels) <= 2.5 * wanted
    assert enclosed_volume(panels) == pytest.approx(shape.primitive.volume, rel=1e-4)


def test_panels_are_finer_beside_points_and_facing_bodies_only():
    left, right = (at.sphere(0.008, 0.004, centre=(side * 0.0084, 0.0, 0.0)) for side in (-1, 1))
    point = np.array([[-0.0084, 0.0, 0.0085]])
    panels = scene_panels([left, right], 5e-3, point, 1e-3)
    centres = panels.six_nodes.mean(axis=1)
    edges = longest_edges(panels.six_nodes)
    assert edges[np.linalg.norm(centres - point, axis=1) < 1.5e-3].max() < 2.5e-3
    assert edges[np.linalg.norm(centres, axis=1) < 2e-3].max() < 3.5e-3
    assert edges[np.abs(centres[:, 0]) > 0.013].min() > 3e-3
    assert np.array_equal(np.unique(panels.body), [0, 1])


def test_deviation_is_the_distance_from_the_exact_shape():
    coarse, fine = (scene_panels([at.sphere(0.008, 0.004)], edge, NOWHERE, edge) for edge in (6e-3, 2e-3))
    assert 1e-6 < coarse.deviation.max() < 5e-5
    assert fine.deviation.max() < 0.1 * coarse.deviation.max()
    flat = at.Surface(at.sphere(0.008, 0.004).vertices, at.sphere(0.008, 0.004).triangles)
    assert not scene_panels([flat], 2e-3, NOWHERE, 1e-3).deviation.any()
