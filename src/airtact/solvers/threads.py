"""The number of threads of the solvers."""

import os


def thread_count() -> int:
    """Return the number of threads: ``OMP_NUM_THREADS`` if it is set, else the processors of this process."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
