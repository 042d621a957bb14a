"""How many threads the solvers use."""

import os


def thread_count() -> int:
    """Threads to use: ``OMP_NUM_THREADS`` where it is set, else the processors that this process may run on."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
