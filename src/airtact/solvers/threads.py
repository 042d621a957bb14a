"""How many threads the solvers use."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


def thread_count() -> int:
    """Threads to use: ``OMP_NUM_THREADS`` where it is set, else the processors that this process may run on."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


_LOCK = threading.Lock()
_INSIDE: list[Any] = []
"""One for each thread of Python that is inside ``one_thread_each``, all of them the limits that the first one set."""


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Keep the linear algebra of numpy and scipy to one thread for each that calls it.

    Threads of their own would wait for each other in every small product, for long on a busy machine. Who comes while
    another is inside finds them limited already, and the last to leave lets them go.
    """
    from threadpoolctl import threadpool_limits

    with _LOCK:
        _INSIDE.append(_INSIDE[0] if _INSIDE else threadpool_limits(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _LOCK:
            if len(_INSIDE) > 1:
                _INSIDE.pop()  # the first one knows how many threads there were
            else:
                _INSIDE.pop().restore_original_limits()
