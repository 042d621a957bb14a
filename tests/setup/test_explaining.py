"""What takes pressure from a focus: each cause is the true counterfactual, and they add up."""

import csv
from dataclasses import replace

import numpy as np
import pytest

import airtact as at
from paths import SCENES

POINTS = np.array([[0.0, 0.0, 0.15], [0.04, 0.0, 0.15]])
BOARD = at.flat_boards(1, 1)
AIR = at.Scene(at.air(celsius=20.0))


def explained(setup: at.Setup, kept: float | None = None) -> tuple:
    result = at.render(setup)
    found = at.setup.why(result, kept)
    return result, found, {cause.name: cause.pressures for cause in found.causes}


@pytest.fixture(scope="module")
def beside_a_ball():
    return explained(at.read_scene(SCENES / "ball.toml"))


def test_the_changes_add_up_to_the_verified_pressure(beside_a_ball, tmp_path) -> None:
    result, found, by_name = beside_a_ball
    first = found.causes[0].pressures
    assert np.isnan(found.changes[0]).all()
    np.testing.assert_allclose(first + found.changes[1:].sum(axis=0), found.causes[-1].pressures)
    np.testing.assert_allclose(by_name["rounding to levels"], result.pressures, rtol=0.02)
    # Open air from the distances alone, all elements in phase
    setup = result.setup
    away = np.linalg.norm(setup.array.positions - setup.target.points[0], axis=1)
    directivity = np.abs(at.open_air_matrix(setup.scene, setup.array, setup.target).matrix[0])
    assert by_name["distance and direction"][0] == pytest.approx(directivity.sum())
    assert directivity.sum() <= (setup.array.element.sensitivity / away).sum()
    assert f"shadow and reflection by the {setup.bodies[0]}" in by_name
    found.save(tmp_path / "why.csv")
    rows = list(csv.DictReader((tmp_path / "why.csv").read_text().splitlines()))
    assert len(rows) == len(found.causes) * len(found.foci)
    changes = [row["change_Pa"] for row in rows if row["focus"] == found.foci[0]]
    assert changes[0] == ""  # the first row has nothing to change from
    total = first[0] + sum(map(float, changes[1:]))
    assert total == pytest.approx(found.causes[-1].pressures[0], rel=1e-4)


def test_each_setting_is_a_cause_of_its_own() -> None:
    target = at.Target(POINTS, pressures=np.array([500.0, 500.0]))
    dead = np.ones(len(BOARD), complex)
    dead[:60] = 0.0
    array = at.PhasedArray(BOARD.positions, BOARD.normals, BOARD.element, gains=dead)
    setup = at.Setup(
        AIR,
        array,
        target,
        modulation=at.transducers.AmplitudeModulation(depth=1.0),
        method="weighted_gerchberg_saxton",
        levels=at.transducers.Levels(np.array([0.0, 1.0]), phases=8),
    )
    _, found, by_name = explained(setup, kept=0.7)
    assert [cause.name for cause in found.causes] == [
        "strongest place in open air",
        "distance and direction",
        "gains and dead elements",
        "sharing with 1 other focus",
        "the method weighted gerchberg saxton",
        *(name for name in by_name if name in ("the requested pressures",)),
        "rounding to levels",
        *(name for name in by_name if name in ("steepening in real air",)),
        "modulation, root mean square over time",
        "error and age of the tracked pose",
    ]
    alone = by_name["distance and direction"]
    np.testing.assert_allclose(by_name["gains and dead elements"], 189 / 249 * alone, rtol=0.1)
    last = found.causes[-3].pressures
    # A cosine of the force has half of its maximum on average.
    np.testing.assert_allclose(found.causes[-2].pressures, np.sqrt(0.5) * last)
    np.testing.assert_allclose(found.causes[-1].pressures, 0.7 * np.sqrt(0.5) * last)


@pytest.mark.parametrize("share", [0.25, 0.0])
def test_a_requested_share_is_not_a_loss_by_sharing(share) -> None:
    target = at.Target(POINTS, shares=np.array([1.0, share]))
    result, found, by_name = explained(at.Setup(AIR, BOARD, target))
    ratios = by_name["the requested ratios of the foci"]
    np.testing.assert_allclose(ratios, by_name["distance and direction"][0] * target.weights)
    assert by_name["sharing with 1 other focus"][0] > 0.9 * ratios[0]
    assert "sharing" not in found.advice
    # A silent focus is neither the weakest, nor in doubt, nor steepened.
    assert result.setup.target.weakest(result.pressures) == int(share > 0.0)
    assert share > 0.0 or found.weakest == 0
    assert not result.warnings
    assert not [words for words in result.remarks if "shocks" in words]
    changes = [found.change_in_words(cause, 1) for cause in range(len(found.causes))]
    assert max(map(len, changes)) <= len("-100 %")


def test_the_advice_names_the_largest_removable_loss() -> None:
    setup = at.Setup(AIR, BOARD, at.Target(POINTS - [0.0, 0.0, 0.08]))
    assert "sharing" in explained(setup)[1].advice
    far = at.Target((0.0, 0.0, 0.6))
    alone = explained(replace(setup, target=far, foci=(), riding=()))[1]
    assert "due to distance" in alone.advice
    # A limit for safety is no fault, however much it takes.
    board = replace(setup, target=at.Target(POINTS[:1]), foci=(), riding=(), board="autd3")
    found = explained(board)[1]
    limited = [cause for cause in found.causes if "head" in cause.name]
    assert [cause.remedy for cause in limited] == [""]
    assert "head" not in found.advice


def test_a_focus_that_runs_through_the_points_shares_with_no_other() -> None:
    turns = at.drives.Motion("stm", "points", frequency=50.0)
    result, _, by_name = explained(at.Setup(AIR, BOARD, at.Target(POINTS), modulation=turns))
    assert not [name for name in by_name if "sharing" in name]
    np.testing.assert_allclose(by_name["rounding to levels"], result.pressures, rtol=0.01)
