"""The examples: those in the package are found by their names, and the scripts in examples/ run."""

import re
import socket
import sys
from dataclasses import replace

import matplotlib.image
import pytest
from matplotlib import pyplot

import airtact as at
from faults import raises_code
from paths import EXAMPLES, ROOT

SCRIPTS = ROOT / "examples"

# What each script prints
PRINTED = {
    "bead_near_finger": r"considered: trap .*0\.49\d, .* N/m.*\n.*ignored: trap .*0\.45\d?, ",
    "autd3_emulator": r"the fields differ by 0\.0\d+ Pa of 67\d\d Pa",
    "finger_over_table": r"with the table: (99\d|100\d) Pa\n.* without the table: 7\d\d Pa",
    "focus": r"45\d\d Pa at the focus with 249 transducers",
    "hand_landmarks": r"left hand: (79\d|8[01]\d), (79\d|8[01]\d), (79\d|8[01]\d) Pa",
    "live_websocket": r"[12]\d\d frames received, [1-9]\d+ drives played",
    "opposed_boards": r"(trap at \(.*, 0\.13\d, .*\n){4}",
    "own_array": r"2000 Pa at the fingertip from 91 transducers",
    "own_stl": r"1500 Pa above the bowl, 7\d\d Pa with a drive computed for empty air",
    "palm_stm": r"24 frames; (199\d|200\d) to (199\d|200\d) Pa at the focus",
    "tinylev": r"trap at \(.*, -2\.3\d, .*\(0\.0034\d*, 0\.06[23]\d*, 0\.0034",
    "touch_ball": r"\d+ Pa at the contact \(-6\.00, -?0\.00, -?0\.00\) mm\n\d+ Pa .* \(6\.00,",
    "two_fingers": r"for the fingers: 1[45]\d\d and 1[45]\d\d Pa\n.*empty air: 11\d\d and 11\d\d Pa",
}


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_a_scene_is_found_by_its_name_and_read(path) -> None:
    # The example is that of the package, which may be an installed wheel.
    assert at.read_scene(path.stem).text == path.read_text(encoding="utf-8")


def test_a_file_goes_before_an_example_of_its_name(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pinch").write_bytes(at.example("air_letters").read_bytes())
    assert at.read_scene("pinch").foci == at.read_scene("air_letters").foci
    with raises_code("unknown_name", "there is no file nose", "open_hand"):
        at.read_scene("nose")
    with raises_code("file_missing", "nose.toml"):
        at.read_scene("nose.toml")


@pytest.mark.parametrize(
    "name", ["pinch.json", "relaxed.json", "pinching.jsonl", "seen_hand.ply", "pinch_scan.csv"]
)
def test_other_files_are_found_by_their_names(name) -> None:
    assert at.example(name).name == name
    assert at.example(name).stat().st_size > 1000


def test_an_unknown_name_lists_the_examples() -> None:
    with raises_code("unknown_name", "'nose'", "open_hand", "relaxed.json"):
        at.example("nose")


def test_every_script_is_run_and_listed() -> None:
    scripts = {path.stem for path in SCRIPTS.glob("*.py")}
    assert scripts == set(PRINTED)
    listed = (SCRIPTS / "README.md").read_text(encoding="utf-8")
    assert {name for name in scripts if f"]({name}.py)" not in listed} == set()


@pytest.mark.parametrize("name", sorted(PRINTED))
def test_a_script_prints_its_result_and_writes_its_picture(
    name, tmp_path, monkeypatch, capsys
) -> None:
    path = SCRIPTS / f"{name}.py"
    monkeypatch.setattr(sys, "argv", [str(path), str(tmp_path)])
    # Coarser solutions give nearly the printed numbers, and coarser maps of potentials are pictures too.
    text = path.read_text(encoding="utf-8")
    if name != "own_stl":  # its bowl takes longer to mesh with large panels
        text = re.sub(r"accuracy=0\.0\d+", "accuracy=0.12", text)
    text = text.replace('"--no-page"', '"--no-page", "--ignore-hand"')
    text = re.sub(r"(meshgrid\(.*, )\d+(\), .*, )\d+\)", r"\g<1>21\g<2>21)", text)
    render = at.render
    if name == "palm_stm":
        coarse = {"solver": at.BoundaryElement(accuracy=0.2), "accuracy": 0.2}
        monkeypatch.setattr(at, "render", lambda setup: render(replace(setup, **coarse)))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        text = text.replace("PORT = 8765", f"PORT = {free.getsockname()[1]}")
    exec(compile(text, path, "exec"), {"__name__": "__main__", "__file__": str(path)})
    pyplot.close("all")
    assert re.search(PRINTED[name], capsys.readouterr().out)
    (picture,) = tmp_path.glob("*.png")
    assert picture.stem == name
    assert matplotlib.image.imread(picture)[..., :3].std() > 0.05
