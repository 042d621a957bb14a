"""The first scene: what init writes is checked, rendered and emitted as it stands, and nothing is overwritten."""

import json
import tomllib

import numpy as np
import pytest

import airtact as at
from airtact.cli import main
from airtact.cli.init import PLACES
from airtact.transducers.boards import BOARDS
from paths import HANDS

ALL = ("thumb.pad", "index.pad", "middle.pad", "ring.pad", "pinky.pad", "palm")
FILES = ["hand-LICENSE.txt", "hand.json", "scene.toml"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def init(place, board="autd3", hand=None):
    options = [] if hand is None else ["--hand", str(hand)]
    assert main(["init", str(place), "--board", board, *options]) == 0
    return place if place.suffix == ".toml" else place / "scene.toml"


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.parametrize("board", BOARDS)
def test_the_hand_lies_over_the_middle_of_the_board_with_its_palm_down(tmp_path, board):
    setup = at.read_scene(init(tmp_path / "new", board))
    assert names(tmp_path / "new") == FILES
    assert (setup.board, len(setup.array)) == (board, len(BOARDS[board]))
    assert setup.foci == (PLACES if board == "nano16" else ALL)
    np.testing.assert_allclose(setup.array.positions.mean(axis=0), 0.0, atol=1e-3)
    facing = setup.target.points[[setup.foci.index(place) for place in PLACES]]
    # Half way between palm and fingertips, which point along x, the longer side of the board.
    fingers = facing[:2, :2].mean(axis=0)
    np.testing.assert_allclose(fingers, -facing[2, :2], atol=2e-3)
    assert fingers[0] == pytest.approx(0.055, abs=2e-3)
    assert fingers[1] == pytest.approx(0.0, abs=2e-3)
    lowest = 0.06 if board == "nano16" else 0.15
    assert facing[:, 2].min() == pytest.approx(lowest, abs=2e-3)
    # Half a millimetre off the skin; a centimetre further down there is air, up the hand.
    np.testing.assert_allclose(-setup.scene.depth(setup.target.points), 0.5e-3, atol=1e-5)
    assert (setup.scene.depth(setup.target.points - [0.0, 0.0, 0.01]) < 0.0).all()
    assert (setup.scene.depth(facing + [0.0, 0.0, 0.004]) > 0.0).all()


@pytest.mark.parametrize(
    ("board", "frequency"), [("autd3", 200.0), ("nano16", 87.0), ("sonicsurface", 44.0)]
)
def test_the_modulation_is_one_that_the_board_can_play(tmp_path, board, frequency):
    scene = init(tmp_path / "new", board)
    assert (
        tomllib.loads(scene.read_text(encoding="utf-8"))["drive"]["modulation"]["frequency"]
        == frequency
    )


def test_another_hand_is_named_by_the_scene_and_turned_to_the_board(tmp_path):
    pose = tmp_path / "poses/mine.json"
    pose.parent.mkdir()
    pose.write_bytes((HANDS / "relaxed.json").read_bytes())
    scene = init(tmp_path / "new/mine.toml", hand=pose)
    assert names(tmp_path / "new") == ["mine.toml"]
    setup = at.read_scene(scene)
    facing = [setup.foci.index(place) for place in PLACES]
    assert setup.target.points[facing, 2].min() == pytest.approx(0.15, abs=2e-3)
    (obstacle,) = tomllib.loads(scene.read_text(encoding="utf-8"))["obstacles"]
    assert obstacle["hand"] == "../poses/mine.json"


def test_a_right_hand_is_the_left_one_mirrored(tmp_path):
    command = ["init", str(tmp_path / "right"), "--right"]
    assert main(command) == 0
    left, right = (
        at.read_scene(file).target.points
        for file in (init(tmp_path / "left"), tmp_path / "right/scene.toml")
    )
    np.testing.assert_allclose(right * [1, -1, 1], left, atol=2e-3)
    assert at.load_hand(tmp_path / "right/hand.json").side == "right"
    assert main([*command, "--hand", str(HANDS / "pinch.json")]) == 2


def test_nothing_is_overwritten(tmp_path, capsys):
    (tmp_path / "hand.json").write_text("mine")
    assert main(["init", str(tmp_path)]) == 2
    assert capsys.readouterr().err.endswith("[would_overwrite]\n")
    assert names(tmp_path) == ["hand.json"]
    assert (tmp_path / "hand.json").read_text() == "mine"


def test_a_hand_at_fault_leaves_no_files(tmp_path):
    (tmp_path / "empty.json").write_text("{}")
    command = ["init", str(tmp_path / "new"), "--hand", str(tmp_path / "empty.json")]
    assert main(command) == 2
    assert not (tmp_path / "new").exists()


def test_the_first_scene_is_checked_rendered_and_emitted(capsys, here):
    assert main(["init"]) == 0
    assert capsys.readouterr().out.endswith("Next: airtact render --open\n")
    scene = here / "scene.toml"
    text = scene.read_text(encoding="utf-8")
    assert "accuracy = 0.03" in text
    scene.write_text(
        text.replace("accuracy = 0.03", "accuracy = 0.3"), encoding="utf-8"
    )  # for a test's time
    assert main(["check", "scene.toml"]) == 0
    capsys.readouterr()
    assert main(["render", "--no-pictures", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [focus["name"] for focus in found["foci"]] == list(ALL)
    assert min(focus["pressure"] for focus in found["foci"]) > 1000.0
    drive = str(here / "out/scene/drive.h5")
    assert (
        main(["emit", drive, "--board", "autd3", "--link", "audit", "--yes", "--seconds", "0.3"])
        == 0
    )
    assert "The last one silences the boards" in capsys.readouterr().out


def test_pads_that_touch_are_not_felt(tmp_path):
    setup = at.read_scene(init(tmp_path / "new", hand=HANDS / "pinch.json"))
    assert setup.foci == tuple(place for place in ALL if place not in ("thumb.pad", "index.pad"))
