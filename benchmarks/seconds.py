"""Wall and processor time of the commands that a new user runs, and the time until a drive exists.

Run as ``python -m benchmarks.seconds [RUNS] [word ...]`` for the commands that contain a word, such
as ``open_hand``. Each figure is the least of the runs. Wall times need a quiet machine.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COMMANDS = (
    "render pinch --no-pictures",
    "render pinch",
    "render open_hand --no-pictures",
    "render open_hand",
    "compare pinch",
    "init && render",
)


def run(command: str, bytecode: str) -> tuple[float, float, float]:
    """Run a command in an empty folder; return wall, processor and drive time [s]."""
    # An installed package has bytecode, so each command may keep that of the first.
    environment = {**os.environ, "PYTHONPYCACHEPREFIX": bytecode}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    airtact = f"{sys.executable} -m airtact "
    words = airtact + command.replace("&& ", "&& " + airtact)
    with tempfile.TemporaryDirectory() as folder:
        before = os.times()
        began = time.perf_counter()
        child = subprocess.Popen(
            words,
            shell=True,
            cwd=folder,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        drive = float("nan")
        while child.poll() is None:
            if drive != drive and list(Path(folder).rglob("drive.h5")):
                drive = time.perf_counter() - began
            time.sleep(0.005)
        wall = time.perf_counter() - began
        assert child.returncode == 0, command
    after = os.times()
    processor = after.children_user + after.children_system
    return wall, processor - before.children_user - before.children_system, drive


def main() -> None:
    """Print the figures of each command."""
    words = [word for word in sys.argv[1:] if not word.isdecimal()]
    runs = next((int(word) for word in sys.argv[1:] if word.isdecimal()), 3)
    with tempfile.TemporaryDirectory() as bytecode:
        run("render pinch", bytecode)  # compiles the modules
        for command in COMMANDS:
            if not words or any(word in command for word in words):
                figures = [run(command, bytecode) for _ in range(runs)]
                wall, processor, drive = (min(column) for column in zip(*figures, strict=True))
                print(f"{command:30} {wall:6.2f} s, processor {processor:6.2f}, drive {drive:6.2f}")


if __name__ == "__main__":
    main()
