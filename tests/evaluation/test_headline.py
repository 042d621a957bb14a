"""The first sentence of a run says what its comparison holds."""

import numpy as np
import pytest

import airtact as at
from airtact.evaluation.comparison import compare
from airtact.evaluation.headline import beyond_linear, body_word, headline, pascals, shortfalls

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


def test_the_gain_is_that_of_the_weakest_foci() -> None:
    result = compared(at.Target(POINTS), weaker=0.7)
    first, second = result.pressures["equal peak"].min(axis=1)
    assert headline(result, AT_FULL_SCALE) == (
        f"Hand-aware: {first / 1e3:.2f} kPa at the weakest focus. Without the hand: {second / 1e3:.2f} kPa. Same "
        f"hardware: {first / second - 1.0:+.0%}."
    ).replace("%", " %")


def test_where_the_hand_does_not_matter_the_sentence_says_so() -> None:
    said = headline(compared(at.Target(POINTS)), AT_FULL_SCALE, "object")
    assert said.endswith(
        "The object does not matter here: the solution distinguishes no less than 1.0%."
    )


def test_below_full_scale_the_energies_are_equal() -> None:
    result = compared(at.Target(POINTS, 500.0), weaker=0.7)
    first, second = result.pressures["equal energy"].min(axis=1)
    said = headline(result, emitted(500.0 / result.pressures["equal peak"][0].min()))
    assert said.startswith("Hand-aware: 500 Pa at the weakest focus.")
    assert said.endswith(f"Same energy: {first / second - 1.0:+.0%}.".replace("%", " %"))


def test_unequal_requests_are_counted_as_shares() -> None:
    result = compared(at.Target(POINTS, np.array([400.0, 200.0])))
    assert headline(result, emitted(0.1)).startswith("Hand-aware: ")
    assert " % of what was asked at the weakest focus." in headline(result, emitted(0.1))


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
        "Asked and not reached: a 21.5 kPa of 200 kPa: the transducers are at full scale.",
    )
    assert shortfalls(target, ["a", "b"], np.array([200e3, 500.0]), emitted(0.5)) == ()
    assert shortfalls(at.Target(POINTS), ["a", "b"], np.array([1.0, 1.0]), AT_FULL_SCALE) == ()


def test_sound_too_strong_for_the_linear_model_is_warned_of() -> None:
    assert beyond_linear(np.array([100.0, 4.9e3])) == ()
    (words,) = beyond_linear(np.array([100.0, 12.3e3]))
    assert "5.00 kPa" in words
    assert "12.3 kPa" in words


def test_pressures_have_three_digits() -> None:
    assert [pascals(one) for one in (12045.0, 8931.0, 853.2, 41.6e3, 200e3, 9.4)] == [
        "12.0 kPa",
        "8.93 kPa",
        "853 Pa",
        "41.6 kPa",
        "200 kPa",
        "9.4 Pa",
    ]
