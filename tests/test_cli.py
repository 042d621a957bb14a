"""The command line: what it prints, what it refuses, and what Ctrl-C leaves."""

import csv
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import pytest

from airtact import __version__
from airtact.cli import main

ROOT = Path(__file__).parents[1]
BALL = ROOT / "tests" / "scenes" / "ball.toml"
COMMANDS = ("check", "render")


def output(capsys, *arguments):
    code = main([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def examples(capsys, *command):
    """Return the words of each example in a command's help."""
    code, printed, _ = output(capsys, *command, "--help")
    assert code == 0
    return [line.split() for line in re.findall(r"^ *Example: (.*)$", printed, re.MULTILINE)]


@pytest.mark.parametrize("command", [(), *((name,) for name in COMMANDS)])
def test_help_has_one_example_that_names_a_file_that_is_there(capsys, command):
    ((program, name, scene, *_),) = examples(capsys, *command)
    assert program == "airtact"
    assert name in (command or COMMANDS)
    assert (ROOT / scene).is_file()


def test_the_example_of_check_runs(capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    ((_, *arguments),) = examples(capsys, "check")
    code, printed, errors = output(capsys, *arguments)
    assert (code, errors) == (0, "")
    assert "thumb" in printed


@pytest.mark.slow
def test_the_example_of_render_runs(capsys, monkeypatch, tmp_path):
    ((_, name, scene, option, folder),) = examples(capsys, "render")
    monkeypatch.chdir(tmp_path)
    code, printed, _ = output(capsys, name, ROOT / scene, option, folder)
    assert code == 0
    assert "finger.pad" in printed
    assert (tmp_path / folder / "report.html").stat().st_size > 100_000


def test_version(capsys):
    assert output(capsys, "--version")[:2] == (0, f"airtact {__version__}\n")


def test_check_says_what_is_in_a_scene(capsys):
    code, printed, _ = output(capsys, "check", BALL)
    assert code == 0
    # 4π · 25 mm² is 3.1 cm², and the foci are 0.5 and 3 mm off a ball of 5 mm.
    for words in ("sphere", "sound-hard", "3.1 cm²", "south pole", "0.5 mm", "3 mm", "900 Pa", "249", "unknowns", "MB"):
        assert words in printed


def test_render_tells_its_steps_and_what_the_foci_get(capsys, tmp_path):
    code, printed, errors = output(capsys, "render", BALL, "--out", tmp_path / "out")
    assert code == 0
    assert str(tmp_path / "out" / "report.html") in printed
    got = re.search(r"focus 2\s+(\d+) Pa", printed)
    assert got
    assert float(got[1]) == pytest.approx(600.0, rel=0.05)  # the accuracy that the scene asks for
    steps = errors.splitlines()
    assert all(re.fullmatch(r" +\d+\.\d s  \w.*", step) for step in steps)
    assert sum("solving" in step for step in steps) == 1


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[medium]", "[medum]", "airtact: scene.toml: medum is not a key of a scene file; did you mean medium?"),
        ("radius = 5e-3", "radius = 5.0", "spans 10 m, more than 2 m: is this in millimetres?"),
        ("-5.5e-3", "-4.5e-3", "is 0.5 mm deep"),
        ("density = 1.293", "density = 0.0", "density is 0"),
        ("[medium]", "medium", "this is not TOML"),
    ],
)
@pytest.mark.parametrize("command", COMMANDS)
def test_bad_input_is_one_sentence_and_exit_code_2(capsys, tmp_path, command, old, new, sentence):
    path = tmp_path / "scene.toml"
    path.write_text(BALL.read_text().replace(old, new))
    options = ["--out", tmp_path / "out"] if command == "render" else []
    code, printed, errors = output(capsys, command, path, *options)
    assert (code, printed) == (2, "")
    last = errors.splitlines()[-1]
    assert last.startswith("airtact: scene.toml: ")
    assert sentence in last
    assert "Traceback" not in errors
    assert not (tmp_path / "out").exists()


def test_a_missing_scene_and_a_wrong_option_are_exit_code_2(capsys, tmp_path):
    code, _, errors = output(capsys, "check", tmp_path / "no.toml")
    assert code == 2
    assert "no.toml: No such file or directory" in errors
    assert output(capsys, "check", BALL, "--nonsense")[0] == 2
    assert output(capsys, "render", BALL)[0] == 2


def test_a_folder_that_cannot_be_written_is_refused_before_anything_is_solved(capsys, tmp_path):
    (tmp_path / "file").touch()
    code, _, errors = output(capsys, "render", BALL, "--out", tmp_path / "file" / "out")
    assert code == 2
    assert "cannot write into the output folder" in errors.splitlines()[-1]
    assert "solving" not in errors


@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent another way there")
def test_ctrl_c_leaves_what_was_finished_readable(tmp_path):
    # Foci far apart make the steps after the drive take seconds.
    scene = tmp_path / "scene.toml"
    scene.write_text(BALL.read_text().replace("[8e-3, 0.0, 0.0]", "[0.1, 0.1, 0.1]"))
    folder = tmp_path / "out"
    command = [sys.executable, "-m", "airtact.cli", "render", str(scene), "--out", str(folder)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while not (folder / "drive.h5").exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    printed, errors = process.communicate(timeout=120)
    assert process.returncode == 130
    assert printed == ""
    assert errors.splitlines()[-1] == "airtact: broken off; what was finished is whole"
    assert "Traceback" not in errors
    assert sorted(entry.name for entry in folder.iterdir()) == ["drive.csv", "drive.h5"]
    with (folder / "drive.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == 249
    with h5py.File(folder / "drive.h5") as file:
        assert file["transfer_matrix"].shape == (2, 249)
