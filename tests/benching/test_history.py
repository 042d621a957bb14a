"""The benchmarks of our own history run: airspeed velocity's own dry run, in this environment."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from paths import ROOT

ASV = Path(sys.executable).parent / "asv"


@pytest.mark.skipif(
    not (ROOT / ".git").exists(), reason="airspeed velocity asks git for the history"
)
def test_every_benchmark_of_the_history_runs_once(tmp_path: Path) -> None:
    own = os.environ | {"HOME": str(tmp_path), "OMP_NUM_THREADS": "1"}
    for words in (
        ["machine", "--yes"],
        ["run", "--quick", "--dry-run", "--python=same", "--show-stderr"],
    ):
        done = subprocess.run(
            [str(ASV), *words], cwd=ROOT, env=own, capture_output=True, text=True, timeout=600
        )
        assert done.returncode == 0, done.stdout + done.stderr
    for name in (
        "deformed_to_drive",
        "each_moved",
        "whole_moved",
        "slice",
        "peakmem_solve",
        "track_error",
    ):
        line = next(line for line in done.stdout.splitlines() if name in line)
        assert "failed" not in line
        assert re.search(r"\s\d[\d.]*(±[\d.]+)?(μs|ms|s|k|M|G)?$", line), line
