"""Foci that move: where their paths lie, which frames they make, and what is rejected."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code

AIR = at.Medium(343.1, 1.293)
BOARD = at.autd3_board()
MIDDLE = BOARD.positions.mean(axis=0)
OPEN = at.Scene(AIR, [])
ALONE = at.Target(np.array([[0.09, 0.07, 0.15]]))


def matrix_of(target: at.Target) -> at.TransferMatrix:
    return at.transfer_matrix(at.FreeField().radiate(OPEN, target.beacons()), BOARD)


def test_a_circle_lies_across_the_view_of_the_array() -> None:
    (path,) = at.drives.Motion("lm", size=4e-3, frames=12).paths(OPEN, ALONE, MIDDLE)
    away = path - ALONE.points[0]
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 4e-3, rtol=1e-12)
    towards = (MIDDLE - ALONE.points[0]) / np.linalg.norm(MIDDLE - ALONE.points[0])
    np.testing.assert_allclose(away @ towards, 0.0, atol=1e-15)
    steps = np.linalg.norm(np.roll(path, -1, axis=0) - path, axis=1)
    np.testing.assert_allclose(steps, 8e-3 * np.sin(np.pi / 12), rtol=1e-12)


def test_a_line_runs_to_and_fro_over_its_length() -> None:
    (path,) = at.drives.Motion("lm", "line", size=6e-3, frames=8).paths(OPEN, ALONE, MIDDLE)
    away = path - ALONE.points[0]
    along = away @ (away[2] / np.linalg.norm(away[2]))
    np.testing.assert_allclose(
        along, [0.0, 1.5e-3, 3e-3, 1.5e-3, 0.0, -1.5e-3, -3e-3, -1.5e-3], atol=1e-15
    )


def test_a_path_along_the_skin_keeps_its_distance() -> None:
    """On a ball the circle of 3 mm in the tangent plane lies 0.5 mm off the ball all round."""
    ball = at.sphere(8e-3, edge=2e-3)
    (path,) = at.drives.Motion("lm").paths(
        at.Scene(AIR, [at.sound_hard(ball)]), at.Target(np.array([[0.0, 0.0, -8.5e-3]])), MIDDLE
    )
    np.testing.assert_allclose(np.linalg.norm(path, axis=1), 8.5e-3, rtol=1e-9)
    # projected to the centre, from the tangent plane at 8.5 mm; the normal is a numerical gradient
    np.testing.assert_allclose(
        np.hypot(path[:, 0], path[:, 1]), 8.5e-3 * np.sin(np.arctan(3 / 8.5)), rtol=1e-5
    )


def test_frames_follow_the_foci() -> None:
    target = at.Target(
        np.array([[0.06, 0.07, 0.15], [0.12, 0.07, 0.15]]), shares=np.array([1.0, 0.5])
    )
    paths = at.drives.Motion("lm", frames=8).paths(OPEN, target, MIDDLE)
    points = at.drives.moving_target(target, paths)
    transfer = matrix_of(points)
    sequence = at.drives.moving_foci(transfer, points, 2, turns=50.0)
    assert (len(sequence), sequence.rate) == (8, 400.0)
    got = np.abs(sequence.pressure(transfer)).reshape(8, 8, 2)
    for frame in range(8):
        here = got[frame, frame]
        assert here[1] / here[0] == pytest.approx(0.5, rel=1e-2)
        assert got[frame, :, 0].max() <= 1.02 * here[0]
    # Steps of 2.3 mm are a quarter of a wavelength: the global phase of each frame follows the one
    # before.
    alike = np.sum(sequence.drives[1:] * sequence.drives[:-1].conj(), axis=1)
    assert np.abs(np.angle(alike)).max() < 1e-9


def test_a_shape_is_drawn_at_the_speed_of_skin_waves() -> None:
    motion = at.drives.Motion("stm", "circle", size=0.02, frames=64)
    paths = motion.paths(OPEN, ALONE, MIDDLE)
    assert 2 * np.pi * 0.02 * motion.turns(paths) == pytest.approx(7.0, rel=1e-3)
    assert at.drives.Motion("lm").turns(paths) == 50.0
    assert at.drives.Motion("stm", frequency=33.0).turns(paths) == 33.0


def test_two_points_take_turns_in_frames_of_whole_periods() -> None:
    target = at.Target(np.array([[0.06, 0.07, 0.15], [0.12, 0.07, 0.15]]))
    assert at.drives.Motion("stm").through_points(2)
    assert not at.drives.Motion("stm").through_points(1)
    assert not at.drives.Motion("stm", "circle").through_points(2)
    sequence = at.drives.moving_foci(matrix_of(target), target, 1, turns=300.0)
    assert len(sequence) == 4
    assert (40e3 / sequence.rate) == pytest.approx(round(40e3 / sequence.rate), abs=1e-9)
    assert sequence.rate / 4 == pytest.approx(300.0, rel=0.02)
    np.testing.assert_array_equal(sequence.drives[0], sequence.drives[1])


def test_suppression_points_stay_suppressed() -> None:
    """With a method that suppresses, every frame has the point in its target."""
    target = at.Target(ALONE.points, suppression_points=np.array([[0.1, 0.07, 0.15]]))
    points = at.drives.moving_target(
        target, at.drives.Motion("lm", frames=4).paths(OPEN, target, MIDDLE)
    )
    transfer = at.transfer_matrix(
        at.FreeField().radiate(OPEN, points.beacons(suppression=True)), BOARD
    )
    seen = []

    def method(rows, alone):
        from airtact.drives.linear_methods import phase_conjugate

        seen.append((rows.matrix.shape, len(alone.suppression_points)))
        return phase_conjugate(rows, alone)

    at.drives.moving_foci(transfer, points, 1, 50.0, method)
    assert seen == [((2, 249), 1)] * 4


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: at.drives.Motion("am"), "unknown_name"),
        (lambda: at.drives.Motion("lm", "square"), "unknown_name"),
        (lambda: at.drives.Motion("lm", "points"), "unknown_name"),
        (lambda: at.drives.Motion("stm", "points", size=0.01), "options_clash"),
        (lambda: at.drives.Motion("lm", size=-1.0), "out_of_range"),
        (lambda: at.drives.Motion("lm", frequency=0.0), "out_of_range"),
        (lambda: at.drives.Motion("stm", "circle", size=3.0), "out_of_range"),
        (lambda: at.transducers.AmplitudeModulation(20000.0), "out_of_range"),
        (lambda: at.drives.Motion("lm", frames=3), "out_of_range"),
        (lambda: at.drives.Motion("lm", along="skin").paths(OPEN, ALONE, MIDDLE), "misplaced"),
        (lambda: at.drives.moving_foci(matrix_of(ALONE), ALONE, 2, 50.0), "sizes_differ"),
        (lambda: at.drives.moving_foci(matrix_of(ALONE), ALONE, 1, 20000.0), "out_of_range"),
    ],
)
def test_motions_that_cannot_be_are_rejected(make, code: str) -> None:
    with raises_code(code):
        make()
