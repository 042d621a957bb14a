"""The examples in the help of emit and export, run as they are printed; and what a missing extra says."""

import re
import sys

import pytest

from airtact.cli import main


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    """A folder in which ``airtact render pinch`` was run."""
    folder = tmp_path_factory.mktemp("fresh")
    assert main(["render", "pinch", "--no-pictures", "--out", str(folder / "out" / "pinch")]) == 0
    return folder


@pytest.mark.parametrize(
    ("name", "shown"), [("emit", "0 dropped"), ("export", "20 frames for 4 boards")]
)
def test_the_examples_run_as_printed_from_a_fresh_run(
    capsys, monkeypatch, fresh, name: str, shown: str
) -> None:
    monkeypatch.chdir(fresh)
    assert main([name, "--help"]) == 0
    (example,) = re.findall(r"Example: airtact (.*(?:\n +.*)*)", capsys.readouterr().out)
    code = main(example.split())
    printed = capsys.readouterr()
    assert code == 0, printed.err
    assert shown in " ".join(printed.out.split())
    assert "threshold of detection" in " ".join(printed.out.split())


def test_the_default_level_of_an_example_is_under_the_limit(capsys, monkeypatch, fresh) -> None:
    """142 to 148 dB at full scale, and no more than the limit that is printed beside it."""
    monkeypatch.chdir(fresh)
    emit = [
        "emit",
        "out/pinch/drive.h5",
        "--board",
        "autd3",
        "--link",
        "audit",
        "--yes",
        "--seconds",
        "0.05",
    ]
    levels = []
    for options in ([], ["--full-scale"]):
        assert main([*emit, *options]) == 0
        found = re.search(r"up to (\d+) dB SPL", capsys.readouterr().out)
        assert found
        levels.append(int(found[1]))
    assert levels[0] <= 110 < 130 < levels[1]


def test_emit_without_its_extra_names_it(capsys, monkeypatch, fresh, tmp_path) -> None:
    monkeypatch.chdir(fresh)
    (tmp_path / "pyautd3.py").write_text("raise ImportError")
    monkeypatch.syspath_prepend(tmp_path)  # which the link process has too
    emit = ["emit", "out/pinch/drive.h5", "--board", "autd3", "--link", "audit", "--yes"]
    assert main(emit) == 2
    errors = capsys.readouterr().err
    assert "AUTD3 boards need pyautd3" in errors
    assert "pip install 'airtact[autd3]'" in errors


def test_boards_keeps_the_name_of_the_extra(capsys, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    monkeypatch.setitem(sys.modules, "serial.tools", None)
    assert main(["boards"]) == 0
    assert "pip install 'airtact[serial]'" in capsys.readouterr().out
