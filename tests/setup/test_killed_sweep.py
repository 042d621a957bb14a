"""A sweep in processes that is killed leaves no process behind, and goes on where it was."""

import json
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from setup import sweep_functions

COUNT = 40


def begin(folder: Path) -> subprocess.Popen:
    command = [
        sys.executable,
        sweep_functions.__file__,
        str(folder / "store"),
        str(folder / "log"),
        str(COUNT),
    ]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL)


def lines_of(folder: Path) -> list[list[str]]:
    log = folder / "log"
    return (
        [line.split() for line in log.read_text(encoding="utf-8").splitlines()]
        if log.exists()
        else []
    )


def test_a_killed_sweep_is_taken_up_again(tmp_path) -> None:
    run = begin(tmp_path)
    wait_for(lambda: len(lines_of(tmp_path)) > 20 or run.poll() is not None)
    run.kill()
    run.wait()
    processes = {int(line[2]) for line in lines_of(tmp_path)}
    wait_for(lambda: not any(alive(process) for process in processes))
    kept = {
        json.loads(file.read_bytes())["row"].get("square")
        for file in (tmp_path / "store").glob("*.json")
    }
    assert 0 < len(kept) < COUNT

    assert begin(tmp_path).wait() == 0
    rows = json.loads((tmp_path / "store/rows.json").read_bytes())
    assert [row["x"] for row in rows] == list(range(COUNT))
    assert [row.get("square") for row in rows] == [None if x == 3 else x * x for x in range(COUNT)]
    times = Counter(int(line[1]) for line in lines_of(tmp_path) if line[0] == "begins")
    assert {x for x in times if x * x in kept and times[x] > 1} == set()


def test_a_process_that_ends_by_itself_is_named(tmp_path) -> None:
    import airtact as at
    from airtact.setup.sweeping import processes

    with pytest.raises(at.InvalidInput) as fault, processes(1) as pool:
        at.sweep(sweep_functions.ends, [{"x": 1}], pool)
    assert fault.value.code == "link_closed"


def alive(process: int) -> bool:
    try:
        return (
            Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]
            != "Z"
        )
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_for(condition) -> None:
    end = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)
