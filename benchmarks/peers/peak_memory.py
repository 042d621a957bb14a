"""Peak memory of this process from a moment on, as Linux counts it; no part of airtact is imported."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np


def forget_peak() -> int:
    """Reset the peak; return what the process holds now [byte], 0 on systems that do neither."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
        return _status("VmRSS")
    except OSError:
        return 0


def peak() -> int:
    """Return the peak since ``forget_peak`` or the start [byte], libraries included; 0 on Windows, which reports none.

    Linux counts in ``ru_maxrss`` what the parent had when it started this process, but not in
    ``VmHWM``.
    """
    try:
        return _status("VmHWM")
    except (OSError, StopIteration):
        if sys.platform == "win32":
            return 0
        import resource

        per_unit = 1 if sys.platform == "darwin" else 1024
        return per_unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def write_answer(file: str, case: Mapping, solve: Callable, version: str) -> None:
    """Run ``solve``, which returns matrix, seconds and unknowns for a mesh, as often as the case asks."""
    before, seconds, matrix, unknowns = forget_peak(), [], np.empty(0), 0
    for _ in range(int(case["runs"])):
        matrix, took, unknowns = solve(case["vertices"], case["triangles"])
        seconds.append(took)
    np.savez(
        file,
        matrix=matrix,
        seconds=seconds,
        peak=peak() - before,
        unknowns=unknowns,
        version=version,
    )


def _status(name: str) -> int:
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(name + ":"))
