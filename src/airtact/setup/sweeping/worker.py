"""What a process of a sweep does first. It imports nothing, so that the numbers of threads hold for all libraries."""

import os
import signal
import threading
from multiprocessing.connection import Connection

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What libraries read, when they are loaded, as the number of their threads."""


def begin(stop: Connection) -> None:
    """Take one thread for each library, leave Ctrl-C to the parent, and end when the pipe from it closes.

    A killed parent closes the pipe too, so that no process goes on alone.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in THREADS:
        os.environ[name] = "1"
    threading.Thread(target=_end_with, args=(stop,), daemon=True).start()

    from threadpoolctl import threadpool_limits

    threadpool_limits(1)  # of libraries that the script itself loaded before


def _end_with(stop: Connection) -> None:
    try:
        stop.recv()
    except (EOFError, OSError):
        os._exit(1)
