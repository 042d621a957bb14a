"""The clock of solvers and renderings, and processes that give way."""

import subprocess
import sys
from pathlib import Path

import pytest

from airtact.setup.sweeping import processes
from airtact.timing import Clock, start_python


def test_a_clock_reports_steps_and_adds_up_their_times():
    lines: list[str] = []
    clock = Clock(lines.append)
    for _ in range(2):
        with clock.step("matrix", "filling the matrix"):
            pass
    once = clock.seconds["matrix"]
    with pytest.raises(ZeroDivisionError), clock.step("matrix"):
        _ = 1 / 0
    assert lines == ["filling the matrix"] * 2 + ["matrix"]
    assert list(clock.seconds) == ["matrix"]
    assert clock.seconds["matrix"] > once > 0


GIVES_WAY = """
import os
from airtact.timing import give_way
give_way(5)
print(os.nice(0), open("/proc/self/autogroup").read().split()[-1])
"""


def _autogroup() -> list[str]:
    """Read the words of this process's autogroup; none where the system shows none."""
    path = Path("/proc/self/autogroup")
    return path.read_text().split() if path.exists() else []


@pytest.mark.skipif(
    not _autogroup(), reason="only Linux has autogroups, where they are built in and shown"
)
def test_a_process_gives_way_with_its_session_only_where_that_is_its_own():
    for own, group in ((True, "5"), (False, _autogroup()[-1])):
        ran = subprocess.run(
            [sys.executable, "-c", GIVES_WAY],
            capture_output=True,
            text=True,
            check=True,
            start_new_session=own,
        )
        nice, found = ran.stdout.split()
        assert int(nice) >= 5
        assert found == group


def test_no_child_imports_from_the_current_folder(tmp_path, monkeypatch) -> None:
    for name in ("random", "copy", "token", "pickle", "signal", "numpy", "h5py"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'run')!r}, 'w')")
    monkeypatch.chdir(tmp_path)
    with start_python("-c", "import random, h5py") as child:
        assert child.wait() == 0
    with processes(1) as pool:
        assert pool.submit(abs, -2).result() == 2
    assert not (tmp_path / "run").exists()
