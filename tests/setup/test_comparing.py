"""All methods on one scene are made, verified and shown, and the series for a sphere agrees with them."""

import csv

import h5py
import numpy as np
import pytest

import airtact as at
from airtact.drives.methods import FOR_SAMPLES, METHODS
from faults import raises_code
from paths import SCENES

BALL = SCENES / "ball.toml"
CONTROL = "object ignored"


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("methods")
    result = at.compare(at.read_scene(BALL))
    result.save(folder)
    at.write_report(result, folder)
    return folder, result


def test_every_method_and_the_control_are_there_and_the_default_is_marked(compared):
    folder, contest = compared
    names = [one.name for one in contest.contenders]
    methods = [name for name in METHODS if name != "best" and name not in FOR_SAMPLES]
    assert sorted(names) == sorted([*(name.replace("_", " ") for name in methods), CONTROL])
    files = ["drives", "methods.csv", "methods.html"]
    assert sorted(entry.name for entry in folder.iterdir()) == files
    written = sorted(entry.stem for entry in (folder / "drives").iterdir())
    assert written == sorted(name.replace(" ", "_") for name in names)
    labels = [contest.label(one) for one in contest.contenders]
    assert [label for label in labels if label.endswith(" (default)")] == ["max min (default)"]
    page = (folder / "methods.html").read_text(encoding="utf-8")
    assert "max min (default)" in page
    assert [name for name in names if name not in page] == []
    assert "://" not in page
    shown = 2 + len(contest.contenders) - len(contest.equally_good)
    assert page.count("data:image/webp;base64,") == shown


def test_the_series_agrees_with_the_verification(compared):
    contest, setup = compared[1], compared[1].setup
    sources = at.evaluation.drive_sources(setup.array, [one.emitted for one in contest.contenders])
    true = np.abs(at.SphereSeries().radiate(setup.scene, sources).at(setup.target.points)).T
    for one, pressures in zip(contest.contenders, true, strict=True):
        np.testing.assert_allclose(one.pressures, pressures, rtol=0.02)


def test_no_method_passes_the_bound_and_the_best_is_no_weaker_than_the_control(compared):
    contest = compared[1]
    for one in contest.contenders:
        assert contest.of_the_bound(one) <= 1.05  # the scene asks for 5 %
        foci = len(contest.setup.foci)
        exact = np.abs(contest.transfer.pressure(one.emitted))[:foci] / contest.setup.target.weights
        assert exact.min() <= contest.bound * (1.0 + 1e-12)
    control = next(one for one in contest.contenders if one.name == CONTROL)
    least = (1.0 - contest.tolerance) * contest.of_the_bound(control)
    assert contest.of_the_bound(contest.best) >= least


def test_methods_within_the_error_are_equal_and_the_default_is_first_of_them(compared):
    contest = compared[1]
    shares = [contest.of_the_bound(one) for one in contest.contenders]
    equal = [share >= (1.0 - contest.tolerance) * max(shares) for share in shares]
    assert sum(equal) == len(contest.equally_good) > 1
    assert contest.ranked[: sum(equal)][0].name == contest.default == "max min"
    assert set(contest.ranked[: sum(equal)]) == set(contest.equally_good)


def test_the_files_hold_pressures_and_drives(compared):
    folder, contest = compared
    with (folder / "methods.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(contest.contenders) * len(contest.setup.foci)
    for row in rows:
        one = next(one for one in contest.contenders if one.name == row["method"])
        index = contest.setup.foci.index(row["focus"])
        assert float(row["pressure_Pa"]) == pytest.approx(one.pressures[index], rel=1e-5)
        assert float(row["weight"]) == contest.setup.target.weights[index]
    one = contest.best
    with h5py.File(folder / "drives" / f"{one.name.replace(' ', '_')}.h5") as file:
        amplitudes = file["amplitude"][:] * np.exp(1j * file["phase"][:])
    np.testing.assert_allclose(at.Drive(amplitudes).amplitudes, one.drive.amplitudes, atol=1e-12)


def reject(transfer, target):
    raise at.InvalidInput("the foci are 0.1 mm apart; part them.", code="too_close")


def test_a_method_that_raises_is_reported_and_the_others_stand(monkeypatch):
    monkeypatch.setitem(METHODS, "inverse_filter", reject)
    result = at.compare(at.read_scene(BALL))
    assert "0.1 mm" in next(words for words in result.warnings if "inverse filter" in words)
    assert "time reversal" in [one.name for one in result.contenders]


def test_when_all_raise_there_is_no_result(monkeypatch):
    for name in METHODS:
        monkeypatch.setitem(METHODS, name, reject)
    with raises_code("empty", "0.1 mm"):
        at.compare(at.read_scene(BALL))


def test_a_drive_of_another_program_is_judged_and_corrected(compared):
    setup = compared[1].setup
    best = compared[1].best.drive
    blurred = np.random.default_rng(2).normal(0.0, 1.0, len(setup.array))
    theirs = at.Drive(np.exp(1j * (best.phases + blurred)))
    opposite = at.Drive(np.conj(best.amplitudes))
    silent = at.Drive(best.amplitudes * (np.arange(len(best)) % 2))
    drives = {"theirs": theirs, "opposite": opposite, "good": best, "silent": silent}
    contest = at.compare(setup, drives=drives)
    by_name = {one.name: one for one in contest.contenders}
    assert list(by_name)[1:] == [
        *("theirs", "theirs, corrected", "opposite", "opposite, corrected", "good"),
        *("silent", "silent, corrected", CONTROL),
    ]
    share = {name: contest.of_the_bound(one) for name, one in by_name.items()}
    assert share["theirs"] < 0.7
    assert 0.93 < share["theirs, corrected"] < 0.97
    # Half of the elements are silent: no phases correct that.
    assert share["silent"] < 0.6
    assert share["silent, corrected"] > 0.93
    # The corrected drive is nearer to the given one than the best drive is, but for a common phase.
    corrected = by_name["theirs, corrected"].drive
    near = [
        abs(np.mean(other.amplitudes * theirs.amplitudes.conj())) for other in (corrected, best)
    ]
    assert near[0] > near[1] + 0.1
    assert [text for text in contest.warnings if "opposite" in text]
    with raises_code("sizes_differ"):
        at.compare(setup, drives={"theirs": at.Drive(np.ones(3, complex))})
    with raises_code("all_zero"):
        at.compare(setup, drives={"theirs": at.Drive(np.zeros(len(setup.array), complex))})
