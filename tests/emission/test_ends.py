"""Whatever ends the process that emits, the link process silences the boards, confirms it, and ends too."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from emission.feeder import SIGNALS, WAYS
from emission.sounds import events
from references.udp_boards import UDPBoards

TESTS = Path(__file__).parent.parent


def check(link: str, folder: Path, trials: int, ways=WAYS) -> None:
    command = [sys.executable, TESTS / "emission/feeder.py", link, folder, str(trials), *ways]
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])
    if link == "udp":
        boards = UDPBoards()
        environment["UDP_BOARDS"] = boards.address
    subprocess.run(command, env=environment, check=True)
    wrong = []
    for way in ways:
        for trial in range(trials):
            found = events(folder / f"{way}-{trial}.log")
            sounded = any(
                re.fullmatch(r"frame \d+ loudest [^0]\S*|frame \d+ loudest 0\.\S+", one)
                for one in found
            )
            if (
                found[:1] != ["opened"]
                or not sounded
                or found[-2:] != ["silence confirmed", "closed"]
            ):
                wrong.append((way, trial, found[-3:]))
    assert not wrong
    if link == "udp":
        assert boards.sounded > 0.0
        assert boards.loudest == 0
        boards.close()


# The system ends a process by these signals in the same way.
ALIKE = set(SIGNALS) - {"SIGKILL", "SIGSEGV"}


@pytest.mark.parametrize(
    ("link", "ways"),
    [
        ("recording", sorted(set(WAYS) - ALIKE)),
        ("audit", ["exit", "SIGKILL", "link-stopped-and-killed", "silence-raises"]),
        ("udp", ["SIGKILL", "hangs-SIGKILL", "silence-raises"]),
    ],
)
def test_however_the_process_ends_the_boards_are_silent(link, ways, tmp_path: Path) -> None:
    check(link, tmp_path, 1, ways)


@pytest.mark.slow
@pytest.mark.parametrize("link", ["recording", "audit", "udp"])
def test_however_the_process_ends_fifty_times(link: str, tmp_path: Path) -> None:
    check(link, tmp_path, 50)


SCRIPT = """
import os, sys, numpy as np, airtact as at
from airtact.emission import RecordingLink
with at.Emission(RecordingLink(), cap=1.0, ramp=0.0, log=sys.argv[-1]) as emission:
    emission.send(at.Drive(np.ones(249, dtype=complex)))
    assert emission.process != os.getpid()
"""


@pytest.mark.parametrize("how", ["command", "script", "standard input"])
def test_it_works_from_wherever_python_runs(how: str, tmp_path: Path) -> None:
    log = tmp_path / "log"
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    start = {"command": ["-c", SCRIPT], "script": [str(script)], "standard input": ["-"]}[how]
    subprocess.run(
        [sys.executable, *start, str(log)], input=SCRIPT, text=True, cwd=tmp_path, check=True
    )
    assert events(log) == ["opened", "frame 1 loudest 1", "silence confirmed", "closed"]
