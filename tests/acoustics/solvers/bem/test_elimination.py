"""Hundreds of excitations, which elimination solves: the closed form's field, and what iterations give."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code

AIR = at.Medium(343.1, 1.293)
BALL = at.sphere(6e-3, 2e-3)


def around(count: int, radius: float = 0.03) -> np.ndarray:
    directions = np.random.default_rng(0).normal(size=(count, 3))
    return radius * directions / np.linalg.norm(directions, axis=1)[:, None]


def above(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points[:, :2], np.abs(points[:, 2])])


def relative(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def test_many_excitations_give_the_closed_form() -> None:
    scene = at.Scene(AIR, [at.sound_hard(BALL)], frequency=40e3)
    sources, points = at.Monopoles(around(200), np.eye(200)), around(50, 0.05)
    field = at.BoundaryElement(accuracy=0.005).radiate(scene, sources)
    assert field.report.iterations == 0
    assert field.report.residual < 1e-5
    exact = at.SphereSeries().radiate(scene, sources).scattered_at(points)
    assert relative(field.scattered_at(points), exact) < 0.005


@pytest.mark.parametrize(
    "planes", [[], [at.plane((0, 0, -0.01), (0, 0, 1))]], ids=["open air", "over a table"]
)
def test_elimination_and_iterations_agree(planes) -> None:
    scene = at.Scene(AIR, [at.sound_hard(BALL)], frequency=40e3, planes=planes)
    positions = above(around(200))
    solver = at.BoundaryElement(accuracy=0.01, estimate=False)
    many = solver.radiate(scene, at.Monopoles(positions, np.eye(200)))
    few = solver.radiate(scene, at.Monopoles(positions, np.eye(200)[:, :3]))
    assert many.report.iterations == 0
    assert few.report.iterations > 0
    points = above(around(50, 0.05))
    assert relative(few.scattered_at(points), many.scattered_at(points)[:, :3]) < 0.005


def test_too_little_memory_for_the_factors_is_said_before(monkeypatch) -> None:
    monkeypatch.setattr(
        "airtact.acoustics.solvers.bem.block_matrix.available_memory", lambda: 2**20
    )
    monkeypatch.setattr("airtact.acoustics.solvers.bem.block_matrix.ALWAYS_FREE", 0)
    scene = at.Scene(AIR, [at.sound_hard(BALL)], frequency=40e3)
    with raises_code("too_little_memory", "GiB"):
        at.BoundaryElement().radiate(scene, at.Monopoles(around(200), np.eye(200)))
