import numpy as np
import pytest

from airtact.geometry.mesh.topology import (
    check_closed,
    check_not_degenerate,
    check_orientation,
    cone_volumes,
    edge_twins,
    shells,
)
from faults import raises_code
from geometry.mesh.meshes import box_mesh, torus_mesh


def ends(triangles: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Vertices at the start and end of flat edge indices."""
    return np.stack(
        [triangles.ravel()[edges], np.roll(triangles, -1, axis=1).ravel()[edges]], axis=-1
    )


def test_twins_are_the_same_edge_run_the_other_way():
    _, triangles = torus_mesh(0.02, 0.005)
    twins = edge_twins(triangles)
    here = ends(triangles, np.arange(twins.size))
    assert np.array_equal(ends(triangles, twins.ravel()), here[:, ::-1])
    assert np.array_equal(twins.ravel()[twins.ravel()], np.arange(twins.size))


def test_an_edge_without_a_neighbour_has_no_twin():
    assert edge_twins(np.array([[0, 1, 2], [1, 0, 3]])).tolist() == [[3, -1, -1], [0, -1, -1]]


def test_an_edge_run_twice_the_same_way_is_marked():
    twins = edge_twins(np.array([[0, 1, 2], [0, 1, 3], [1, 0, 4]]))
    assert twins[0, 0] == twins[1, 0] == -2


def test_every_vertex_order_of_a_triangle_counts_the_same():
    vertices, triangles = box_mesh()
    turned = np.stack([np.roll(t, i) for i, t in enumerate(triangles)])
    check_closed(vertices, turned)
    check_orientation(vertices, turned)
    assert cone_volumes(vertices[turned]) == pytest.approx(cone_volumes(vertices[triangles]))


def test_shells_are_counted():
    _, box = box_mesh()
    _, torus = torus_mesh(0.02, 0.005)
    labels = shells(np.concatenate([box, torus + 8, box + 400]))
    parts = np.split(labels, [len(box), len(box) + len(torus)])
    assert [len(set(part)) for part in parts] == [1, 1, 1]
    assert len(set(labels)) == 3


def test_volumes_do_not_depend_on_the_place():
    vertices, triangles = box_mesh((0, 0, 0), (0.01, 0.02, 0.03))
    far = vertices + [1.0, -1.0, 1.0]
    assert cone_volumes(far[triangles]).sum() == pytest.approx(6e-6, rel=1e-12)


def test_a_thin_triangle_is_degenerate_at_a_millionth_of_its_edge():
    triangle = np.array([[0, 1, 2]])
    points = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.005, 1.1e-8, 0.0]])
    check_not_degenerate(points, triangle)
    with raises_code("mesh_faulty"):
        check_not_degenerate(points * [1, 0.9, 1], triangle)


def test_a_cavity_is_inside_out():
    outer, triangles = box_mesh((0, 0, 0), (0.03, 0.03, 0.03))
    inner, _ = box_mesh((0.01, 0.01, 0.01), (0.02, 0.02, 0.02))
    with raises_code("mesh_faulty", "-1 cm³"):
        check_orientation(
            np.concatenate([outer, inner]), np.concatenate([triangles, triangles[:, ::-1] + 8])
        )
