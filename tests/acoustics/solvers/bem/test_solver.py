"""The report of the boundary element solver and the input it rejects; tests/physics check its numbers."""

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.solvers.bem import block_matrix
from faults import raises_code

AIR = at.Medium(343.1, 1.293)
SOURCE = at.Monopoles(np.array([[0.0, 0.0, 0.02]]), np.ones(1))


def scene(*obstacles: at.acoustics.Obstacle) -> at.Scene:
    return at.Scene(AIR, list(obstacles) or [at.sound_hard(at.sphere(0.004, 0.002))])


def test_report_describes_the_solve():
    report = at.BoundaryElement(accuracy=0.02).radiate(scene(), SOURCE).report
    assert 0 < report.residual < 0.006
    assert 1 < report.iterations < 20
    assert (
        report.nodes_per_square_wavelength
        > at.BoundaryElement(accuracy=0.02).nodes_per_square_wavelength * 0.9
    )
    assert 0 < report.estimated_error < 0.02
    assert set(report.seconds) == {"panels", "matrix", "gmres", "estimate"}
    assert report.settings == {
        "accuracy": 0.02,
        "precision": "float32",
        "gmres_tolerance": pytest.approx(0.006),
    }
    assert report.citations
    assert report.warnings == ()


def test_an_inaccurate_result_warns_with_both_numbers():
    on_skin = at.Monopoles(np.array([[0.0, 0.0, 0.004]]), np.ones(1))
    report = at.BoundaryElement(accuracy=0.003).radiate(scene(), on_skin).report
    assert report.estimated_error > 0.0045
    assert "and 0.3 % was asked" in report.warnings[0]


def test_without_an_estimate_the_field_at_the_array_is_the_same_and_the_surface_unknown():
    both, array = (
        at.BoundaryElement(accuracy=0.02).radiate(scene(), SOURCE),
        np.array([[0.0, 0.05, 0.1]]),
    )
    one = at.BoundaryElement(accuracy=0.02, estimate=False).radiate(scene(), SOURCE)
    assert one.at(array) == pytest.approx(both.at(array), rel=0.02)
    assert np.isnan(one.report.estimated_error)
    assert np.isnan(one.error_at(array)).all()
    assert one.valid(np.array([[0.0, 0.0, 0.003], [0.0, 0.0, 0.005]])).tolist() == [False, True]
    on_skin = np.array([[0.0, 0.004, 0.0]])
    unknown = (lambda: one.on_surface, lambda: one.at(on_skin), lambda: one.velocity(on_skin))
    for ask in (*unknown, lambda: one.direct_at(array)):
        with raises_code("not_supported"):
            ask()


@pytest.mark.parametrize("accuracy", [0.0, -0.01, 0.5, float("nan")])
def test_accuracy_out_of_range_is_rejected(accuracy):
    with raises_code("out_of_range", f"{accuracy:g}"):
        at.BoundaryElement(accuracy=accuracy)


def test_unknown_precision_is_rejected(monkeypatch):
    monkeypatch.setattr(
        "jaxtyping.config.jaxtyping_disable", True
    )  # so that the guard itself answers
    with raises_code("unknown_name", "half"):
        at.BoundaryElement(precision="half")


def test_open_air_is_rejected():
    with raises_code("empty"):
        at.BoundaryElement().radiate(at.Scene(AIR, []), SOURCE)


def test_filled_bodies_are_rejected():
    obstacle = at.filled(at.sphere(0.004, 0.002), at.Medium(1481, 999.7))
    with raises_code("not_supported", "obstacle 1 is filled"):
        at.BoundaryElement().radiate(
            scene(at.sound_hard(at.sphere(0.003, 0.002, centre=(0.02, 0, 0))), obstacle), SOURCE
        )


def test_a_source_inside_a_body_is_rejected_with_its_depth():
    with raises_code("inside_body", "source 0", "1 mm"):
        at.BoundaryElement().radiate(
            scene(), at.Monopoles(np.array([[0.0, 0.0, 0.003]]), np.ones(1))
        )


def test_a_matrix_larger_than_memory_is_rejected_before_it_is_made(monkeypatch):
    monkeypatch.setattr(block_matrix, "available_memory", lambda: 1e5)
    monkeypatch.setattr(block_matrix, "ALWAYS_FREE", 0)
    with raises_code("too_little_memory", "0.0 GiB"):
        at.BoundaryElement().radiate(scene(), SOURCE)


@pytest.mark.parametrize("bad", [np.array([[0.0, 0.0, np.nan]]), np.array([[0.0, np.inf, 0.0]])])
def test_points_that_are_no_numbers_are_rejected(bad):
    field = at.BoundaryElement(accuracy=0.1).radiate(scene(), SOURCE)
    for ask in (field.at, field.valid):
        with raises_code("not_finite"):
            ask(bad)


def test_a_point_on_a_source_is_rejected():
    field = at.BoundaryElement(accuracy=0.1).radiate(scene(), SOURCE)
    with raises_code("misplaced", "source 0"):
        field.at(np.array([[0.0, 0.0, 0.05], [0.0, 0.0, 0.02]]))


@pytest.mark.parametrize("strength", [1e-30, 1e-22, 1e20, 1e30])
@pytest.mark.parametrize("estimate", [True, False])
def test_sources_of_any_strength_are_solved_as_those_of_one(estimate, strength):
    scene = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(at.sphere(5e-3, 2e-3))])
    solver, place = (
        at.BoundaryElement(accuracy=0.05, estimate=estimate),
        np.array([[0.0, 0.0, 0.02]]),
    )
    points = np.array([[0.05, 0.0, 0.0], [0.0, 0.0, -0.05]])
    one, other = (
        solver.radiate(scene, at.Monopoles(place, np.array([one]))) for one in (1.0, strength)
    )
    assert np.allclose(other.at(points) / strength, one.at(points), rtol=1e-4, atol=0)
    if estimate:
        assert other.report.estimated_error == pytest.approx(one.report.estimated_error, rel=1e-2)


@pytest.mark.parametrize("radius", [0.002, 0.003, 0.004])
@pytest.mark.usefixtures("variant")
def test_near_integrals_are_numbers_whatever_the_processor(radius):
    """A node's own panel has points a subnormal distance from it, whose reciprocal root some machines lack."""
    source = at.Monopoles(np.array([[radius + 2e-3, 0.0, 0.0]]), np.ones(1))
    ball = at.sphere(radius, radius / 1.5)
    field = at.BoundaryElement(accuracy=0.1).radiate(scene(at.sound_hard(ball)), source)
    points = np.array([[0.0, 0.1, 0.02]])
    exact = at.SphereSeries().radiate(scene(at.sound_hard(ball)), source).at(points)
    assert abs(field.at(points) - exact) < 0.1 * abs(exact)
