"""The map of reach: closed form, no drive above it, one drive that reaches each value."""

import csv
from dataclasses import replace

import numpy as np
import pytest

import airtact as at
from airtact.hands.joints import FINGERS
from airtact.setup.reaching import _parts
from faults import raises_code
from worlds import AIR, ball

BOARD = at.autd3_board().facing((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.1)
ABOVE = at.Target((0.0, 0.0, 0.012))


@pytest.fixture(scope="module")
def around_ball() -> at.setup.ReachMap:
    gains = np.ones(len(BOARD), dtype=complex)
    gains[:40] = 0.0
    gains[40:80] = 0.5
    array = at.PhasedArray(BOARD.positions, BOARD.normals, BOARD.element, gains=gains)
    return at.reach(at.Setup(ball(9e-3), array, ABOVE), points=80)


def test_the_bound_is_that_of_the_sphere_series(around_ball) -> None:
    setup = replace(around_ball.setup, solver=at.SphereSeries())
    exact = at.reach(setup, points=80)
    np.testing.assert_array_equal(exact.points, around_ball.points)
    ratio = around_ball.bounds / exact.bounds
    assert np.sqrt(np.mean((ratio - 1.0) ** 2)) < 0.015
    np.testing.assert_allclose(ratio, 1.0, atol=0.05)
    # The lit side gets more than the side in shadow.
    assert exact.points[exact.bounds.argmax(), 2] > 7e-3
    assert exact.bounds.max() > 1.5 * exact.bounds.min()


def test_no_drive_exceeds_the_bound_and_one_reaches_it(around_ball) -> None:
    rng = np.random.default_rng(0)
    shape = (len(BOARD), 1000)
    drives = rng.uniform(0.5, 1.0, shape) * np.exp(2j * np.pi * rng.random(shape))
    pressures = np.abs(around_ball.transfer.matrix @ drives)
    assert (pressures < around_ball.bounds[:, None]).all()
    setup = around_ball.setup
    for point in (int(around_ball.bounds.argmin()), int(around_ball.bounds.argmax())):
        drive = around_ball.drive(point)
        focus = at.Target(around_ball.points[point])
        result = at.evaluate(setup.scene, setup.array, drive, focus, solver=at.SphereSeries())
        np.testing.assert_allclose(result.magnitudes[0], around_ball.bounds[point], rtol=0.03)


def test_points_are_even_and_on_the_skin(around_ball) -> None:
    points = around_ball.points
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 9e-3, rtol=1e-3)
    apart = np.linalg.norm(points[:, None] - points, axis=2) + np.eye(len(points))
    # 80 points on this sphere are at most 3.8 mm apart.
    assert apart.min() > 2e-3
    np.testing.assert_allclose(around_ball.normals, points / 9e-3, atol=0.1)
    for index in (80, -1):
        with raises_code("out_of_range"):
            around_ball.drive(index)
    assert set(around_ball.places) == {"body 0"}
    np.testing.assert_allclose(around_ball.on_skin[around_ball.chosen], around_ball.bounds)
    assert around_ball.on_skin.max() < 1.001 * around_ball.bounds.max()


def test_the_parts_of_a_hand_are_named(around_ball, tmp_path) -> None:
    setup = at.read_scene("live_pinch")
    hand = setup.hands[0]
    points = np.array([point for point, _ in hand.places.values()])
    assert _parts(setup, points, ["hand"] * 6) == (*FINGERS, "palm")
    assert _parts(setup, points + 0.1, ["ball"] * 6) == ("ball",) * 6
    around_ball.save(tmp_path / "reach.csv")
    rows = list(csv.DictReader((tmp_path / "reach.csv").read_text().splitlines()))
    bounds = [float(row["bound_Pa"]) for row in rows]
    np.testing.assert_allclose(bounds, around_ball.bounds, rtol=1e-5)
    ((name, weakest, strongest),) = around_ball.extremes
    assert name == "body 0"
    assert bounds[weakest] == min(bounds)
    assert bounds[strongest] == max(bounds)


def test_wrong_requests_are_rejected() -> None:
    setup = at.Setup(ball(9e-3), BOARD, ABOVE)
    for wrong in ({"points": 0}, {"points": 10**6}, {"accuracy": 0.0}):
        with raises_code("out_of_range"):
            at.reach(setup, **wrong)
    with raises_code("empty"):
        at.reach(at.Setup(at.Scene(AIR), BOARD, ABOVE))
