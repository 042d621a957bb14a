"""What each focus gets, against closed forms and the transfer matrix."""

import re

import numpy as np
import pytest

import airtact as at
from faults import raises_code

AIR = at.Medium(343.1, 1.293)
BALL = at.sound_hard(at.sphere(0.010, edge=4e-3))
REPORT = at.acoustics.SolveReport(
    "by hand", 0.0, 0, 0, np.inf, 0.0, warnings=("A warning to pass on.",)
)
POINTS = np.array([[0.0, 0.0, 0.011], [0.011, 0.0, 0.0], [0.0, -0.03, 0.0]])


def given_pressures(
    *pressures: complex, asked: np.ndarray | float | None = None
) -> at.evaluation.Evaluation:
    points = np.arange(3.0 * len(pressures)).reshape(-1, 3) * 1e-3
    return at.evaluation.Evaluation(
        at.Target(points, asked), np.array(pressures, dtype=np.complex128), REPORT
    )


def test_figures_of_a_known_answer() -> None:
    result = given_pressures(300.0, 400j, -100.0)
    np.testing.assert_allclose(result.magnitudes, [300.0, 400.0, 100.0])
    assert np.isnan(result.shares).all()
    assert (result.worst, result.uniformity) == (100.0, pytest.approx(1.0 - 300.0 / 500.0))
    assert result.mean == pytest.approx(800.0 / 3.0)


def test_figures_are_of_shares_where_pressures_are_asked() -> None:
    result = given_pressures(300.0, 400j, -100.0, asked=np.array([600.0, 400.0, 0.0]))
    np.testing.assert_allclose(result.shares, [0.5, 1.0, np.nan])
    assert (result.worst, result.mean) == (0.5, 0.75)
    assert result.uniformity == pytest.approx(1.0 - 0.5 / 1.5)


def test_foci_that_get_what_their_shares_ask_are_uniform() -> None:
    target = at.Target(np.arange(9.0).reshape(-1, 3) * 1e-3, shares=np.array([1.0, 0.5, 0.0]))
    result = at.evaluation.Evaluation(target, np.array([300.0, 150j, 20.0]), REPORT)
    assert (result.worst, result.mean, result.uniformity) == (300.0, 300.0, 1.0)
    uneven = at.evaluation.Evaluation(target, np.array([300.0, 300j, 20.0]), REPORT)
    assert (uneven.worst, uneven.uniformity) == (300.0, pytest.approx(1.0 - 300.0 / 900.0))
    # What is printed is the pressure at a focus, not its ratio to a share.
    assert "focus 1, the weakest relative to its share, 150.0 Pa, mean 225.0 Pa" in str(result)


def test_an_evaluation_reads_as_a_table() -> None:
    text = str(given_pressures(300.0, 400j, asked=np.array([600.0, 0.0])))
    lines = text.splitlines()
    assert re.fullmatch(r"\s+0\s+0\.00\s+1\.00\s+2\.00\s+300\.0\s+600\.0\s+50\.0%", lines[1])
    assert re.fullmatch(r"\s+1\s+3\.00\s+4\.00\s+5\.00\s+400\.0\s+0\.0\s+-", lines[2])
    assert "weakest focus 50.0% of the request" in text
    assert "by by hand" in text
    assert "A warning to pass on." in text
    assert "do not reflect" in text
    assert "not calibrated" in text
    assert "weakest focus 300.0 Pa" in str(given_pressures(300.0, 400j))
    columns = [
        line.rindex(end) + len(end)
        for line, end in zip(lines[:3], ("share", "50.0%", "-"), strict=True)
    ]
    assert len(set(columns)) == 1


def test_a_drive_by_time_reversal_gets_what_its_matrix_predicts() -> None:
    box = at.surrounding_box()
    array = at.PhasedArray(box.positions[::30], box.normals[::30])
    scene, target = at.Scene(AIR, [BALL]), at.Target(POINTS, np.array([100.0, 120.0, 80.0]))
    transfer = at.transfer_matrix(at.SphereSeries().radiate(scene, target.beacons()), array)
    drive = at.time_reversal(transfer, target)
    result = at.evaluate(scene, array, drive, target, solver=at.SphereSeries())
    np.testing.assert_allclose(result.pressures, transfer.pressure(drive), rtol=1e-6)
    np.testing.assert_allclose(
        result.shares, at.drives.achieved_fraction(transfer, target, drive), rtol=1e-6
    )
    assert result.worst == pytest.approx(1.0, rel=1e-6)
    assert result.report.solver == "SphereSeries"


def test_a_focus_in_a_body_or_behind_a_face_raises() -> None:
    array = at.flat_boards(1, 1, at.piston(4.5e-3))
    drive = at.Drive(np.ones(249, dtype=np.complex128))
    behind = at.Target(np.array([[0.0, 0.0, -0.01]]))
    with raises_code("behind_faces"):
        at.evaluate(at.Scene(AIR, []), array, drive, behind, solver=at.FreeField())
    scene = at.Scene(AIR, [at.sound_hard(at.sphere(0.010, edge=4e-3, centre=(0.0, 0.0, 0.1)))])
    with raises_code("inside_body"):
        at.evaluate(
            scene, array, drive, at.Target(np.array([[0.0, 0.0, 0.103]])), solver=at.SphereSeries()
        )
