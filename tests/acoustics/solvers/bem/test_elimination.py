"""Hundreds of excitations, solved by elimination: the closed form, and agreement with iterations."""

import numpy as np
import pytest

import airtact as at
from references import relative
from worlds import AIR, directions, hard, one_each

BALL = at.sphere(6e-3, 2e-3)


def test_many_excitations_give_the_closed_form() -> None:
    scene = hard(BALL)
    sources = one_each(0.03 * directions(200, 0))
    points = 0.05 * directions(50, 0)
    field = at.BoundaryElement(accuracy=0.005).radiate(scene, sources)
    assert field.report.iterations == 0
    assert field.report.residual < 1e-5
    exact = at.SphereSeries().radiate(scene, sources).scattered_at(points)
    assert relative(field.scattered_at(points), exact) < 0.005


@pytest.mark.parametrize(
    "planes", [[], [at.plane((0, 0, -0.01), (0, 0, 1))]], ids=["open air", "over a table"]
)
def test_elimination_and_iterations_agree(planes) -> None:
    scene = at.Scene(AIR, [at.sound_hard(BALL)], planes=planes)
    above = directions(200, 0)
    above[:, 2] = np.abs(above[:, 2])
    positions = 0.03 * above
    points = 0.05 * above[:50]
    solver = at.BoundaryElement(accuracy=0.01, estimate=False)
    many = solver.radiate(scene, one_each(positions))
    few = solver.radiate(scene, at.Monopoles(positions, np.eye(200)[:, :3]))
    assert many.report.iterations == 0
    assert few.report.iterations > 0
    assert relative(few.scattered_at(points), many.scattered_at(points)[:, :3]) < 0.005
