"""The first sentence of a run says what its comparison holds."""

from dataclasses import replace

import numpy as np
import pytest

import airtact as at
from airtact.evaluation.comparison import body_word, compare, headline, shortfalls
from airtact.evaluation.metrics import in_real_air, pascals
from airtact.evaluation.steepening import Steepening

SCENE = at.Scene(at.Medium(343.1, 1.293), [])
ARRAY = at.flat_boards(1, 1)
POINTS = np.array([[0.02, 0.0, 0.06], [-0.03, 0.01, 0.08]])


def emitted(peak: float) -> at.Drive:
    return at.Drive(np.full(3, peak, dtype=np.complex128))


AT_FULL_SCALE = emitted(1.0)


def compared(target: at.Target, weaker: float = 1.0):
    """Compare the best drive with itself, but for a share of its elements that are off."""
    drive = at.best(at.open_air_matrix(SCENE, ARRAY, target), target)
    on = np.arange(len(drive)) < weaker * len(drive)
    drives = {"hand-aware": drive, "without the hand": at.Drive(drive.amplitudes * on)}
    return compare(SCENE, ARRAY, drives, target, solver=at.FreeField())


def replace_pressures(result, target, values, report):
    """A comparison with these pressures at the foci, whatever is held equal."""
    field = replace(result.field, report=report)
    pressures = dict.fromkeys(result.pressures, values)
    at_foci = values.T + 0j
    return replace(result, target=target, pressures=pressures, field=field, at_foci=at_foci)


def test_the_gain_is_that_of_the_weakest_foci_and_of_the_mean() -> None:
    result = compared(at.Target(POINTS), weaker=0.7)
    values = result.pressures["equal peak"]
    weakest = values.min(axis=1)
    mean = values.mean(axis=1)
    assert headline(result, AT_FULL_SCALE) == (
        f"Hand-aware: {weakest[0] / 1e3:.2f} kPa at the weakest focus. Without the hand: "
        f"{weakest[1] / 1e3:.2f} kPa. Same hardware: {weakest[0] / weakest[1] - 1.0:+.0%} at the "
        f"weakest focus, {mean[0] / mean[1] - 1.0:+.0%} on average."
    ).replace("%", " %")


def test_a_focus_that_loses_is_named() -> None:
    values = np.array([[1000.0, 1100.0, 1400.0], [800.0, 900.0, 1600.0]])
    target = at.Target(np.concatenate([POINTS, [[0.0, 0.0, 0.1]]]))
    report = at.acoustics.SolveReport("series", estimated_error=0.01)
    result = replace_pressures(compared(at.Target(POINTS)), target, values, report)
    said = headline(result, AT_FULL_SCALE, foci=("a", "b", "palm"))
    assert said.endswith("+25 % at the weakest focus, +6 % on average; palm loses 12 %.")


@pytest.mark.parametrize(("error", "word"), [(0.002, "the same to within"), (0.4, "unknown")])
def test_no_gain_is_told_apart_from_one_that_cannot_be_told(error, word) -> None:
    values = np.array([[1000.0, 1100.0], [995.0, 1100.0]])
    report = at.acoustics.SolveReport("series", estimated_error=error)
    result = replace_pressures(compared(at.Target(POINTS)), at.Target(POINTS), values, report)
    assert word in headline(result, AT_FULL_SCALE, "object")


def test_below_full_scale_the_energies_are_equal() -> None:
    result = compared(at.Target(POINTS, 500.0), weaker=0.7)
    first, second = result.pressures["equal energy"].min(axis=1)
    said = headline(result, emitted(500.0 / result.pressures["equal peak"][0].min()))
    assert said.startswith("Hand-aware: 500 Pa at the weakest focus.")
    gain = f"Same energy: {first / second - 1.0:+.0%} at the weakest focus".replace("%", " %")
    assert gain in said


@pytest.mark.parametrize(
    ("bodies", "word"),
    [
        (["thumb", "finger"], "hand"),
        (["hand"], "hand"),
        (["left-Hand 2"], "hand"),
        (["sphere", "cup"], "object"),
    ],
)
def test_bodies_are_called_what_they_are(bodies, word) -> None:
    assert body_word(bodies) == word


def test_what_was_asked_and_not_reached_is_listed() -> None:
    target = at.Target(POINTS, np.array([200e3, 500.0]))
    assert shortfalls(target, ["a", "b"], np.array([21.53e3, 495.0]), AT_FULL_SCALE) == (
        "Requested but not reached: a 21.5 kPa of 200 kPa: the transducers are at full scale.",
    )
    assert shortfalls(target, ["a", "b"], np.array([200e3, 500.0]), emitted(0.5)) == ()
    assert shortfalls(at.Target(POINTS), ["a", "b"], np.array([1.0, 1.0]), AT_FULL_SCALE) == ()


def test_the_pressure_that_real_air_leaves_is_stated_if_it_differs() -> None:
    none = np.zeros(2)
    weak = Steepening(np.array([0.01, 0.05]), np.array([0.0, 5e-4]), none)
    target = at.Target(POINTS)
    assert in_real_air(np.array([100.0, 500.0]), target, weak) == ()
    # a plane wave at σ = 1 keeps 2 J₁(1) = 0.880
    strong = Steepening(np.array([0.5, 0.1]), np.array([0.125, 0.005]), none)
    (words,) = in_real_air(np.array([10e3, 2e3]), target, strong)
    assert "10.0 kPa" in words
    assert "8.80 kPa" in words
    (words,) = in_real_air(np.array([10e3, 2e3]), target, strong.scaled(3.0))
    assert "shocks" in words
    # A silent focus is not meant to be heard, whatever its steepening.
    silent = at.Target(POINTS, shares=np.array([0.0, 1.0]))
    (words,) = in_real_air(np.array([1e-12, 2e3]), silent, strong)
    assert "focus 1: 2.00 kPa computed" in words


def test_pressures_have_three_digits() -> None:
    assert [pascals(one) for one in (12045.0, 8931.0, 853.2, 41.6e3, 200e3, 9.4)] == [
        "12.0 kPa",
        "8.93 kPa",
        "853 Pa",
        "41.6 kPa",
        "200 kPa",
        "9.4 Pa",
    ]
    rounded = [pascals(one) for one in (999.4, 999.8, 1e3, 9999.0, 99_999.0)]
    assert rounded == ["999 Pa", "1.00 kPa", "1.00 kPa", "10.0 kPa", "100 kPa"]


def test_the_weakest_focus_is_stated_with_its_own_pressure() -> None:
    target = at.Target(POINTS, shares=np.array([1.0, 0.25]))
    result = compared(target, weaker=0.7)
    weakest, _ = result.pressures["equal peak"][:, 1]
    said = headline(result, AT_FULL_SCALE, foci=("a", "b"))
    assert said.startswith(f"Hand-aware: {pascals(weakest)} at b,")
    assert result.pressures["equal peak"][0, 0] > 3.9 * weakest
    # The first focus misses its request by more than the second.
    report = at.acoustics.SolveReport("series")
    values = np.array([[900.0, 300.0], [900.0, 200.0]])
    said = headline(replace_pressures(result, target, values, report), AT_FULL_SCALE)
    assert said.startswith("Hand-aware: 900 Pa at focus 1,")
    assert "Without the hand: 200 Pa at focus 2," in said
