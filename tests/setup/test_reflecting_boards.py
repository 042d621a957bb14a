"""Scene files whose boards reflect."""

import numpy as np

import airtact as at
from airtact.cli import main
from faults import raises_code

TEXT = """
frequency = 40e3
[medium]
celsius = 20
[array]
layout = "boards"
poses = [{ translation = [-0.086, -0.066, 0.0] }]
reflects = true
[[obstacles]]
sphere = { radius = 0.008, centre = [0.0, 0.0, 0.1] }
[[foci]]
point = [0.0, 0.0, 0.091]
[solver]
accuracy = 0.1
"""


BOARDS = 'layout = "boards"\nposes = [{ translation = [-0.086, -0.066, 0.0] }]'
OWN = "x,y,z,nx,ny,nz\n0,0,0,0,0,1\n0.01,0,0,0,0,1\n"


def written(folder, old="", new=""):
    path = folder / "scene.toml"
    path.write_text(TEXT.replace(old, new) if old else TEXT)
    return path


def test_boards_reflect_as_the_file_says(tmp_path):
    setup = at.read_scene(written(tmp_path))
    assert setup.bodies == ("sphere", "boards")
    assert [one.board for one in setup.scene.obstacles] == [False, True]
    assert np.abs(setup.scene.obstacles[1].surface.depth(setup.array.positions)).max() < 1e-9
    raised = "reflects = true\npose = { translation = [0, 0, 0.01] }"
    moved = at.read_scene(written(tmp_path, "reflects = true", raised))
    assert np.isclose(moved.scene.obstacles[1].surface.vertices[:, 2].max(), 0.01)
    assert len(at.read_scene(written(tmp_path, "reflects = true")).scene.obstacles) == 1


def test_what_does_not_go_with_reflecting_boards_is_rejected(tmp_path):
    with raises_code("bodies_overlap", "body 0 cuts into"):
        at.read_scene(written(tmp_path, "0.1]", "0.005]"))
    with raises_code("unknown_name", "openmpd"):
        at.read_scene(
            written(tmp_path, 'layout = "boards"', 'layout = "boards"\nboard = "openmpd"')
        )
    with raises_code("not_supported", "finite_element"):
        at.read_scene(written(tmp_path, "[solver]", '[solver]\nname = "finite_element"'))
    with raises_code("wrong_kind"):
        (tmp_path / "own.csv").write_text(OWN)
        at.read_scene(written(tmp_path, BOARDS, 'layout = "own.csv"'))


def test_check_names_the_boards(tmp_path, capsys):
    assert main(["check", str(written(tmp_path))]) == 0
    said = capsys.readouterr().out
    for words in ("reflecting-board", "in the faces of boards that reflect", "unknowns"):
        assert words in " ".join(said.split())
