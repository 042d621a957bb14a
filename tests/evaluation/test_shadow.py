"""A focus in the shadow of a body: the error that is printed is that of the focus."""

import numpy as np
import pytest

import airtact as at

BEHIND = np.array([[0.0, 0.0, 0.0405]])  # half a millimetre off the skin


@pytest.fixture(scope="module")
def behind_a_ball():
    board = at.autd3_board()
    board = board.moved(at.Pose(np.eye(3), -board.positions.mean(axis=0) - [0, 0, 0.2]))
    scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(0.04, 0.002))], 40e3)
    target = at.Target(BEHIND)
    series = at.SphereSeries().radiate(scene, target.beacons())
    return scene, board, target, at.transfer_matrix(series, board)


@pytest.mark.parametrize("accuracy", [0.1, 0.03])
def test_the_error_of_an_evaluation_is_that_of_its_foci(behind_a_ball, accuracy):
    scene, board, target, transfer = behind_a_ball
    drive = at.best(transfer, target)
    exact = transfer.pressure(drive)
    solver = at.BoundaryElement(accuracy=accuracy)
    evaluation = at.evaluate(scene, board, drive, target, solver=solver)
    error = float(np.abs(evaluation.pressures - exact)[0] / np.abs(exact)[0])
    assert error > accuracy  # more than was asked: the shadow gets little pressure
    assert 0.5 < evaluation.report.estimated_error / error < 3.0
    assert any("shadow" in warning for warning in evaluation.report.warnings)


def test_a_transfer_matrix_that_is_far_off_warns(behind_a_ball):
    scene, board, target, transfer = behind_a_ball
    beacons = at.BoundaryElement(accuracy=0.2).radiate(scene, target.beacons())
    with pytest.warns(UserWarning, match="error of the transfer matrix"):
        rough = at.transfer_matrix(beacons, board)
    assert rough.estimated_error > 0.2
    assert transfer.estimated_error < 0.01
