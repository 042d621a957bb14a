"""Progress: whatever may take seconds reports its steps to a callback, and the result is the same."""

import numpy as np
import pytest

import airtact as at

BALL = at.sphere(radius=5e-3, edge=2e-3)
SCENE = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(BALL)])
TARGET = at.Target(np.array([[0.0, 0.0, 8e-3]]))
BOARD = at.autd3_board().facing((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.1)
SOLVER = at.BoundaryElement(accuracy=0.1)
# First words of the steps of a solve
SOLVE = ["covering", "filling", "solving"]


def first_words(steps: list[str]) -> list[str]:
    return [step.split()[0] for step in steps]


def test_a_solver_reports_its_steps() -> None:
    steps: list[str] = []
    reporting = SOLVER.reporting(steps.append)
    field = reporting.radiate(SCENE, TARGET.beacons())
    assert first_words(steps) == [*SOLVE, "estimating"]
    assert f"{field.report.nodes} unknowns" in steps[1]
    assert reporting == SOLVER == at.BoundaryElement(accuracy=0.1, progress=print)
    assert "progress" not in repr(reporting)
    plain = SOLVER.radiate(SCENE, TARGET.beacons())
    np.testing.assert_array_equal(field.at(BOARD.positions), plain.at(BOARD.positions))


def test_a_factorisation_reports_each_body() -> None:
    steps: list[str] = []
    SOLVER.reporting(steps.append).factorised(SCENE)
    assert first_words(steps) == ["covering", "factorising"]


def test_a_store_reports_what_it_solves(tmp_path) -> None:
    steps: list[str] = []
    store = at.Stored(SOLVER, tmp_path)
    store.reporting(steps.append).radiate(SCENE, TARGET.beacons())
    assert first_words(steps)[:3] == SOLVE
    seen = len(steps)
    store.reporting(steps.append).radiate(SCENE, TARGET.beacons())
    assert len(steps) == seen


@pytest.mark.parametrize(
    ("do", "after"),
    [
        (lambda drive, **words: at.evaluate(SCENE, BOARD, drive, TARGET, **words), []),
        (lambda drive, **words: at.compare(SCENE, BOARD, {"one": drive}, TARGET, **words), []),
        (
            lambda drive, **words: at.field_map(SCENE, BOARD, drive, TARGET.points, **words),
            ["evaluating"],
        ),
        (
            lambda drive, **words: at.evaluation.verify(SCENE, BOARD, drive, TARGET, **words),
            [*SOLVE, "estimating", "evaluating", "searching"],
        ),
    ],
)
def test_evaluations_report_their_steps(do, after) -> None:
    steps: list[str] = []
    drive = at.Drive(np.ones(249, dtype=complex))
    do(drive, solver=SOLVER, progress=steps.append)
    assert first_words(steps) == [*SOLVE, "estimating", *after]


def test_a_file_a_fit_and_an_expansion_report_their_steps() -> None:
    steps: list[str] = []
    at.load_surface(at.example("generic-hand-right.glb"), progress=steps.append)
    landmarks = at.hands.load_landmarks(at.example("seen_hand.json"))
    fitted = at.fit_hand(
        at.hands.load_cloud(at.example("seen_hand.ply")), *landmarks, progress=steps.append
    )
    field = SOLVER.radiate(SCENE, TARGET.beacons())
    at.multipole_expansion(field, progress=steps.append)
    assert len(steps) == 8  # four of the file, two of each of the others
    assert f"{len(fitted.points)} points" in steps[5]


def test_closed_forms_have_no_steps() -> None:
    assert at.FreeField().reporting(print) == at.FreeField()
    assert SOLVER.reporting(None) is SOLVER
