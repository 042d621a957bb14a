"""The report of the boundary element solver and the input it rejects; tests/physics check numbers."""

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.acoustics.solvers.bem import block_matrix
from airtact.acoustics.solvers.bem.layer_potentials import NearRule, locate
from airtact.acoustics.solvers.bem.quadrature import place_nodes
from faults import raises_code
from worlds import AIR, hard, one_each

BALL = at.sphere(0.004, 0.002)
SCENE = hard(BALL)
SOURCE = one_each(np.array([[0.0, 0.0, 0.02]]))


def test_report_describes_the_solve():
    solver = at.BoundaryElement(accuracy=0.02)
    report = solver.radiate(SCENE, SOURCE).report
    assert 0 < report.residual < 0.002
    assert 1 < report.iterations < 20
    assert report.nodes_per_square_wavelength > 0.9 * solver.nodes_per_square_wavelength
    assert 0 < report.estimated_error < 0.02
    assert set(report.seconds) == {"panels", "matrix", "gmres", "estimate"}
    assert report.settings == {
        "accuracy": 0.02,
        "precision": "float32",
        "gmres_tolerance": pytest.approx(0.002),
    }
    assert report.citations
    assert report.warnings == ()


def test_an_inaccurate_result_warns():
    on_skin = one_each(np.array([[0.0, 0.0, 0.004]]))
    report = at.BoundaryElement(accuracy=0.003).radiate(SCENE, on_skin).report
    assert report.estimated_error > 0.0045
    assert len(report.warnings) == 1


def test_without_an_estimate_the_field_at_the_array_is_the_same_and_the_surface_unknown():
    array = np.array([[0.0, 0.05, 0.1]])
    full = at.BoundaryElement(accuracy=0.02).radiate(SCENE, SOURCE)
    lean = at.BoundaryElement(accuracy=0.02, estimate=False).radiate(SCENE, SOURCE)
    assert lean.at(array) == pytest.approx(full.at(array), rel=0.02)
    assert np.isnan(lean.report.estimated_error)
    assert np.isnan(lean.error_at(array)).all()
    assert lean.valid(np.array([[0.0, 0.0, 0.003], [0.0, 0.0, 0.005]])).tolist() == [False, True]
    on_skin = np.array([[0.0, 0.004, 0.0]])
    for ask in (
        lambda: lean.on_surface,
        lambda: lean.at(on_skin),
        lambda: lean.velocity(on_skin),
        lambda: lean.direct_at(array),
    ):
        with raises_code("not_supported"):
            ask()


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("settings", "code"),
    [
        *(({"accuracy": share}, "out_of_range") for share in (0.0, -0.01, 0.5, float("nan"))),
        ({"precision": "half"}, "unknown_name"),
    ],
)
def test_settings_that_cannot_be_are_rejected(settings, code):
    with raises_code(code):
        at.BoundaryElement(**settings)


BESIDE = at.sound_hard(at.sphere(0.003, 0.002, centre=(0.02, 0, 0)))
WATER = at.filled(BALL, at.Medium(1481, 999.7))


@pytest.mark.parametrize(
    ("scene", "source", "code", "words"),
    [
        (hard(), SOURCE, "empty", ""),
        (at.Scene(AIR, [BESIDE, WATER]), SOURCE, "not_supported", "obstacle 1"),
        (SCENE, one_each(np.array([[0.0, 0.0, 0.003]])), "inside_body", "source 0"),
    ],
    ids=["open air", "filled body", "source inside"],
)
def test_scenes_that_it_does_not_solve_are_rejected(scene, source, code, words):
    with raises_code(code, words):
        at.BoundaryElement().radiate(scene, source)


@pytest.mark.parametrize("count", [1, 200], ids=["iterations", "elimination"])
def test_a_matrix_larger_than_memory_is_rejected_before_it_is_made(count, monkeypatch):
    monkeypatch.setattr(block_matrix, "available_memory", lambda: 1e5)
    monkeypatch.setattr(block_matrix, "ALWAYS_FREE", 0)
    with raises_code("too_little_memory"):
        at.BoundaryElement().radiate(SCENE, at.Monopoles(SOURCE.positions, np.ones((1, count))))


def test_points_that_are_not_finite_or_on_a_source_are_rejected():
    field = at.BoundaryElement(accuracy=0.1).radiate(SCENE, SOURCE)
    for ask in (field.at, field.valid):
        with raises_code("not_finite"):
            ask(np.array([[0.0, np.nan, 0.0]]))
    with raises_code("misplaced"):
        field.at(np.array([[0.0, 0.0, 0.05], [0.0, 0.0, 0.02]]))


@pytest.mark.parametrize("strength", [1e-30, 1e-22, 1e20, 1e30])
@pytest.mark.parametrize("estimate", [True, False])
def test_sources_of_any_strength_are_solved_as_those_of_one(estimate, strength):
    solver = at.BoundaryElement(accuracy=0.05, estimate=estimate)
    points = np.array([[0.05, 0.0, 0.0], [0.0, 0.0, -0.05]])
    unit = solver.radiate(SCENE, SOURCE)
    strong = solver.radiate(SCENE, at.Monopoles(SOURCE.positions, np.array([strength])))
    assert np.allclose(strong.at(points) / strength, unit.at(points), rtol=1e-4, atol=0)
    errors = [field.report.estimated_error for field in (strong, unit)]
    assert errors[0] == pytest.approx(errors[1], rel=1e-2, nan_ok=True)


@pytest.mark.parametrize("radius", [0.002, 0.003, 0.004])
@pytest.mark.usefixtures("variant")
def test_near_integrals_are_finite_whatever_the_processor(radius):
    """A node's own panel has points a subnormal distance from it.

    Some machines have no reciprocal root of that.
    """
    source = one_each(np.array([[radius + 2e-3, 0.0, 0.0]]))
    scene = hard(at.sphere(radius, radius / 1.5))
    points = np.array([[0.0, 0.1, 0.02]])
    exact = at.SphereSeries().radiate(scene, source).at(points)
    values = at.BoundaryElement(accuracy=0.1).radiate(scene, source).at(points)
    assert abs(values - exact) < 0.1 * abs(exact)


def test_all_vertices_of_a_coarse_mesh_count_as_outside() -> None:
    # At this accuracy, a panel of the finger passes 3 µm outside one of its vertices, further than
    # the deviation measured at its probes.
    finger = at.pinch().surfaces[0]
    scene = hard(at.Surface(finger.vertices, finger.triangles))
    panels, _ = at.BoundaryElement(accuracy=0.01)._discretised(scene, np.empty((0, 3)))
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    located = locate(scene, nodes, finger.vertices, NearRule(1.6, (4, 4)))
    assert located.outside.all()
    assert np.linalg.norm(located.points - finger.vertices, axis=1).max() < 1e-4
    # Points 0.3 mm below the vertices are inside.
    mesh = trimesh.Trimesh(finger.vertices, finger.triangles, process=False)
    below = finger.vertices - 3e-4 * mesh.vertex_normals
    assert not locate(scene, nodes, below, NearRule(1.6, (4, 4))).outside.any()
