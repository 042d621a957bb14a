"""Foci that cannot be reached are named before anything is solved."""

import csv
import json

import numpy as np
import pytest

from airtact.cli import main
from cli.running import done, output, rejected

SCENE = """[medium]
celsius = 20.0
humidity = 0.5
[array]
layout = "{layout}"
[[foci]]
point = [0.0, 0.0, {height}]
{pressure}
"""


@pytest.mark.parametrize(
    ("layout", "height", "pressure", "words"),
    [
        ("surrounding_box", 0.5, "", ("focus 1 is out of the array's reach", "7.1%")),
        (
            "flat_boards",
            0.1,
            "pressure = 1e6",
            ("the requested pressure of focus 1 is 1,000,000 Pa", "in open air"),
        ),
        ("flat_boards", 0.2, "pressure = 5e3", ()),
    ],
)
def test_what_cannot_be_reached_is_named_before_it_is_solved(
    tmp_path, capsys, layout, height, pressure, words
) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.format(layout=layout, height=height, pressure=pressure))
    assert main(["check", str(path)]) == 0
    printed = capsys.readouterr().out
    assert [word for word in words if word not in printed] == []
    assert ("Warning" in printed) == bool(words)


BALL = """medium = { celsius = 20.0 }
array = { layout = "flat_boards", rows = 1, columns = 1 }
obstacles = [{ sphere = { radius = 8e-3 }, pose = { translation = [0.0, 0.0, 0.15] } }]
foci = [{ name = "far side", point = [0.0, 0.0, 0.159] }, { point = [0.0, 0.0, 0.141] }]
"""


def test_check_names_foci_that_face_away(tmp_path, capsys) -> None:
    path = tmp_path / "ball.toml"
    path.write_text(BALL)
    code, printed, _ = output(capsys, "check", path, "--json")
    assert code == 0
    (words,) = json.loads(printed)["warnings"]
    assert "far side faces away" in words
    assert "airtact place" in words


def test_reach_writes_a_table_and_a_page(tmp_path, capsys) -> None:
    path = tmp_path / "ball.toml"
    path.write_text(BALL)
    words = ["reach", path, "--points", 30, "--out", tmp_path / "out"]
    code, printed, steps = output(capsys, *words, "--json")
    assert code == 0
    record = json.loads(printed)
    bounds = [row["bound_Pa"] for row in record["points"]]
    lowest = record["points"][int(np.argmax(bounds))]
    assert lowest["z"] < 0.15  # on the side of the board
    rows = list(csv.DictReader((tmp_path / "out" / "reach.csv").read_text().splitlines()))
    assert len(rows) == len(bounds) == 30
    page = (tmp_path / "out" / "reach.html").read_text()
    assert f"{1e-3 * max(bounds):.2f}" in page
    assert "http" not in page.split("<!-- three.js")[0]
    assert "evaluating" in steps
    # A run without pictures does not leave the page of an older one.
    done(capsys, *words, "--no-pictures")
    assert not (tmp_path / "out" / "reach.html").exists()
    assert "[out_of_range]" in rejected(capsys, *words, "--accuracy", 0)
    path.write_text(SCENE.format(layout="flat_boards", height=0.2, pressure=""))
    assert "[empty]" in rejected(capsys, *words)


def test_why_draws_a_bar_for_each_cause(tmp_path, capsys) -> None:
    path = tmp_path / "ball.toml"
    path.write_text(BALL)
    code, printed, _ = output(capsys, "why", path, "--page", tmp_path / "why.html", "--json")
    assert code == 0
    record = json.loads(printed)
    page = (tmp_path / "why.html").read_text()
    assert record["advice"] in page
    for cause in record["causes"]:
        assert page.count(f"<span>{cause['name']}</span>") == 2
        assert all(f"{pressure:,.0f} Pa" in page for pressure in cause["pressures"])
