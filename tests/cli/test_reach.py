"""Foci that cannot be reached are named before anything is solved."""

import pytest

from airtact.cli import main

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
        ("surrounding_box", 0.5, "", ("focus 1 is out of the array's reach", "7.5%")),
        (
            "flat_boards",
            0.1,
            "pressure = 1e6",
            ("focus 1 has a request of 1,000,000 Pa", "in open air"),
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
