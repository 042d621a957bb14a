"""The flags that commands share: JSON, quiet, no pictures, a browser, a method, and folders named after scenes."""

import json
import re

import click
import h5py
import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.cli import NAMES, commands
from airtact.evaluation import self_check
from cli.running import done, output, rejected
from paths import ROOT, SCENES

BALL = SCENES / "ball.toml"
DRIVE = ["drive.csv", "drive.h5"]


def record(capsys, *arguments):
    """Return the only thing that stands on the standard output."""
    printed, _ = done(capsys, *arguments, "--json")
    return json.loads(printed)


def documented_keys(command):
    """Return the keys of a command's result in the table of the page."""
    page = (ROOT / "docs/commands.md").read_text(encoding="utf-8")
    (row,) = re.findall(
        rf"^\|`{command}`[^|]*\|(.*)\|$", page.split("## Results as JSON")[1], re.MULTILINE
    )
    return set(re.findall(r"`(\w+)`", re.sub(r"\([^)]*\)", "", row)))


COMMON = {"airtact", "command", "warnings"}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_render_prints_what_the_foci_get_as_json(capsys, here):
    found = record(capsys, "render", BALL, "--no-pictures")
    assert set(found) == COMMON | documented_keys("render")
    assert (found["airtact"], found["command"]) == (at.__version__, "render")
    assert [focus["asked"] for focus in found["foci"]] == [900.0, 600.0]
    assert all(0.9 < focus["expected"] / focus["pressure"] <= 1.0 for focus in found["foci"])
    np.testing.assert_allclose(
        [focus["position"] for focus in found["foci"]], [[0, 0, -5.5e-3], [8e-3, 0, 0]]
    )
    with h5py.File(here / "out/ball/drive.h5") as file:
        got = np.abs(
            file["transfer_matrix"][:] @ (file["amplitude"][:] * np.exp(1j * file["phase"][:]))
        )
    np.testing.assert_allclose([focus["pressure"] for focus in found["foci"]], got, rtol=0.05)
    assert [name for name, path in found["files"].items() if not (here / path).is_file()] == []


def test_open_shows_the_page_and_no_pictures_leaves_the_numbers(capsys, here, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    assert output(capsys, "render", BALL, "--quiet", "--open")[0] == 0
    # The folder is named after the scene.
    assert opened == [(here / "out/ball/report.html").resolve().as_uri()]
    assert (here / "out/ball/report.html").is_file()
    printed, _ = done(capsys, "render", BALL, "--no-pictures")
    assert "report.html" not in printed
    assert sorted(entry.name for entry in (here / "out/ball").iterdir()) == DRIVE


def test_a_method_on_the_command_line_takes_the_place_of_the_scene_s(capsys, here):
    drives = []
    for method in ("time_reversal", "max_min"):
        found = record(capsys, "render", BALL, "--no-pictures", "--method", method)
        assert found["method"] == method.replace("_", " ")
        drives.append(at.load_drive(here / "out/ball/drive.h5").amplitudes)
    assert not np.allclose(*drives)
    errors = rejected(capsys, "render", BALL, "--method", "maxmin")
    assert "max_min" in errors


def test_compare_prints_the_methods_as_json_best_first(capsys, here):
    found = record(capsys, "compare", BALL, "--no-pictures")
    assert set(found) == COMMON | documented_keys("compare")
    shares = [method["of_the_bound"] for method in found["methods"]]
    # The default method is first among those that are equal within the tolerance of 1 % or more.
    assert max(shares) <= 1.02 * shares[0]
    assert shares[-1] == min(shares)
    assert shares[0] > 0.9
    assert len(found["methods"][0]["pressures"]) == len(found["foci"]) == 2
    assert sorted(entry.name for entry in (here / "out/ball").iterdir()) == [
        "drives",
        "methods.csv",
    ]


def test_check_prints_what_is_in_a_scene_or_a_surface_as_json(capsys, here):
    found = record(capsys, "check", BALL)
    assert set(found) == COMMON | documented_keys("check")
    assert found["bodies"][0]["area"] == pytest.approx(4.0 * np.pi * 5e-3**2, rel=0.01)
    assert [focus["off_the_surface"] for focus in found["foci"]] == pytest.approx(
        [0.5e-3, 3e-3], abs=1e-6
    )
    trimesh.creation.icosphere(subdivisions=3, radius=5.0).export(here / "ball.stl")
    found = record(capsys, "check", here / "ball.stl", "--scale", "1e-3")
    assert set(found) == COMMON | {"surface", "unknowns"}
    assert found["surface"]["triangles"] == 20 * 4**3
    assert found["unknowns"]["0.01"] >= found["unknowns"]["0.03"] > 0


def test_known_fields_are_solved_as_accurately_as_asked(capsys, monkeypatch):
    found = record(capsys, "selfcheck")
    assert set(found) == COMMON | documented_keys("selfcheck")
    assert found["threads"] >= 1
    assert [one["name"].split(",")[0] for one in found["fields"]] == ["one sphere"] * 2 + [
        "two spheres"
    ] * 2
    assert max(one["error"] for one in found["fields"]) < found["asked"] == 0.01
    assert max(one["own"] for one in found["fields"]) < 1e-3


def test_known_fields_that_are_not_met_end_with_1(capsys, monkeypatch):
    monkeypatch.setattr(self_check, "SOLVER", at.BoundaryElement(accuracy=0.3))
    code, printed, _ = output(capsys, "selfcheck", "--json")
    found = json.loads(printed)
    over = [one["name"] for one in found["fields"] if one["error"] > 0.01]
    assert code == 1
    assert over
    assert [sentence.split(":")[0] for sentence in found["warnings"]] == over


def test_boards_are_listed_as_json(capsys):
    found = record(capsys, "boards")
    assert set(found) == COMMON | documented_keys("boards")
    assert {board["name"]: board["elements"] for board in found["boards"]}["autd3"] == 249


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (("render", "no.toml"), "file_missing"),
        (("render",), "file_missing"),
        (("rendr",), "wrong_usage"),
        (("check", BALL, "--scale", "1"), "options_clash"),
        (("check",), "file_missing"),
    ],
)
def test_a_fault_is_json_too(capsys, here, arguments, fault):
    code, printed, errors = output(capsys, *arguments, "--json")
    assert code == 2
    found = json.loads(printed)
    assert set(found) == {"error", "code"}
    assert found["code"] == fault
    assert errors.splitlines()[-1] == f"airtact: {found['error']} [{fault}]"


def test_quiet_prints_nothing_where_nothing_is_wrong(capsys, here):
    assert output(capsys, "render", BALL, "--no-pictures", "--quiet") == (0, "", "")
    assert output(capsys, "check", "pinch", "--quiet") == (0, "", "")
    code, printed, errors = output(capsys, "check", here / "no.toml", "--quiet")
    assert (code, printed, len(errors.splitlines())) == (2, "", 1)


@pytest.mark.parametrize(
    ("line", "nearest"),
    [("rendr", "render"), ("render x.toml --stor y", "--store"), ("init --board autd", "autd3")],
)
def test_a_mistyped_command_option_or_name_suggests_the_nearest(capsys, line, nearest):
    code, printed, errors = output(capsys, *line.split())
    assert (code, printed) == (2, "")
    assert nearest in errors
    assert errors.endswith("--help. [wrong_usage]\n")


def test_every_command_can_be_quiet():
    for name in NAMES:
        command = commands.get_command(click.Context(commands), name)
        assert command is not None
        assert "--quiet" in [flag for option in command.params for flag in option.opts], name
