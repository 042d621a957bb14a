"""All methods on one scene are made, verified and shown, and the series for a sphere agrees with them."""

import csv

import h5py
import numpy as np
import pytest

from airtact.acoustics.solvers.spherical.sphere_series import SphereSeries
from airtact.cli import main
from airtact.drives.methods import METHODS
from airtact.drives.transfer import Drive
from airtact.errors import InvalidInput
from airtact.evaluation.field import drive_sources
from airtact.setup.building import read_scene
from airtact.workflows.compare import FILES, WAYS, compare
from paths import SCENES

BALL = SCENES / "ball.toml"
CONTROL = "without the object"


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """One comparison on the small scene: its folder and what it returned."""
    folder = tmp_path_factory.mktemp("methods")
    return folder, compare(BALL, folder)


def test_every_method_and_the_control_are_there(compared):
    folder, contest = compared
    names = [one.name for one in contest.contenders]
    assert sorted(names) == sorted([*(name.replace("_", " ") for name in WAYS), CONTROL])
    assert sorted(entry.name for entry in folder.iterdir()) == sorted([*FILES, "drives"])
    written = sorted(entry.stem for entry in (folder / "drives").iterdir())
    assert written == sorted(name.replace(" ", "_") for name in names)


def test_the_default_is_marked(compared):
    folder, contest = compared
    labels = [contest.label(one) for one in contest.contenders]
    assert [label for label in labels if label.endswith(" (default)")] == ["max min (default)"]
    assert "max min (default)" in (folder / FILES[1]).read_text(encoding="utf-8")


def test_the_series_agrees_with_the_verification(compared):
    contest, setup = compared[1], read_scene(BALL)
    sources = drive_sources(setup.array, [one.emitted for one in contest.contenders])
    true = np.abs(SphereSeries().radiate(setup.scene, sources).at(setup.target.points)).T
    for one, pressures in zip(contest.contenders, true, strict=True):
        np.testing.assert_allclose(one.pressures, pressures, rtol=0.02)


def test_no_method_passes_the_bound(compared):
    contest = compared[1]
    for one in contest.contenders:
        assert contest.of_the_bound(one) <= 1.05  # the scene asks for 5 %
        foci = len(contest.foci)
        exact = np.abs(contest.transfer.pressure(one.emitted))[:foci] / contest.target.weights
        assert exact.min() <= contest.bound * (1.0 + 1e-12)


def test_the_best_method_gives_no_less_than_the_control(compared):
    contest = compared[1]
    control = next(one for one in contest.contenders if one.name == CONTROL)
    assert contest.of_the_bound(contest.best) >= contest.of_the_bound(control)


def test_the_table_has_the_pressures(compared):
    folder, contest = compared
    with (folder / "methods.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(contest.contenders) * len(contest.foci)
    for row in rows:
        one = next(one for one in contest.contenders if one.name == row["method"])
        index = contest.foci.index(row["focus"])
        assert float(row["pressure_Pa"]) == pytest.approx(one.pressures[index], rel=1e-5)
        assert float(row["weight"]) == contest.target.weights[index]


def test_a_drive_file_holds_the_drive(compared):
    folder, contest = compared
    one = contest.best
    with h5py.File(folder / "drives" / f"{one.name.replace(' ', '_')}.h5") as file:
        amplitudes = file["amplitude"][:] * np.exp(1j * file["phase"][:])
    np.testing.assert_allclose(Drive(amplitudes).amplitudes, one.drive.amplitudes, atol=1e-12)


def test_the_page_needs_nothing_else_and_names_every_method(compared):
    folder, contest = compared
    page = (folder / "methods.html").read_text(encoding="utf-8")
    assert page.count("data:image/webp;base64,") == 1 + len(contest.contenders)
    assert "://" not in page
    for one in contest.contenders:
        assert one.name in page


def test_a_method_that_raises_is_reported_and_the_others_stand(tmp_path, capsys, monkeypatch):
    def reject(transfer, target):
        raise InvalidInput("2 foci are 0.1 mm apart; part them.", code="foci_too_close")

    monkeypatch.setitem(METHODS, "inverse_filter", reject)
    assert main(["compare", str(BALL), "--out", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert "inverse filter made no drive: 2 foci are 0.1 mm apart; part them." in said.out
    assert "time reversal" in said.out
    assert "2 foci are 0.1 mm apart" in (tmp_path / "methods.html").read_text(encoding="utf-8")


def test_when_all_raise_nothing_is_written_but_the_folder(tmp_path, capsys, monkeypatch):
    def reject(transfer, target):
        raise InvalidInput("2 foci are 0.1 mm apart; part them.", code="foci_too_close")

    for name in METHODS:
        monkeypatch.setitem(METHODS, name, reject)
    assert main(["compare", str(BALL), "--out", str(tmp_path)]) == 2
    errors = capsys.readouterr().err
    assert f"0 of {len(WAYS)} methods" in errors
    assert errors.endswith(" [no_drive]\n")
    assert list((tmp_path / "drives").iterdir()) == []
