"""Timing and progress of steps, child processes, and limits on threads and priority."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController

# Callback for long computations; it receives the description of each step as it begins
Progress = Callable[[str], None]


def no_progress(step: str) -> None:
    """Report nothing."""


def duration(seconds: float) -> str:
    """Format a duration [s] in milliseconds or seconds.

    Examples
    --------
    >>> duration(6.7e-7), duration(0.0123), duration(65.0)
    ('under 1 ms', '12 ms', '65.0 s')
    """
    if seconds < 1e-3:
        return "under 1 ms"
    return f"{1e3 * seconds:.0f} ms" if seconds < 1.0 else f"{seconds:.1f} s"


class Clock:
    """Measure the wall time of each step, and report each step as it begins.

    Attributes
    ----------
    seconds : wall time of each step by name [s]; the times of a repeated step add
        up.

    Examples
    --------
    >>> clock = Clock(print)
    >>> with clock.step("matrix", "filling the matrix"):
    ...     total = sum(range(10))
    filling the matrix
    >>> list(clock.seconds)
    ['matrix']
    """

    def __init__(self, progress: Progress | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress

    @contextmanager
    def step(self, name: str, words: str | None = None) -> Iterator[None]:
        """Report a step by ``words`` or else its name; add its duration to ``seconds[name]``."""
        if self._progress is not None:
            self._progress(words or name)
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begun


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit linear algebra to one thread inside a ``with`` block."""
    with _threads().limit(limits=1, user_api="blas"):
        yield


@cache
def _threads() -> ThreadpoolController:
    """Return the controller of the loaded libraries; finding them takes milliseconds."""
    return ThreadpoolController()


def give_way(nice: int) -> None:
    """Lower the priority of this process by ``nice`` steps, if the system supports it.

    Linux first divides the processors among sessions (autogroups), so ``nice`` only has an effect
    within a session. If the process has its own session, the priority of the session is therefore
    lowered as well.
    """
    with suppress(AttributeError, OSError):
        os.nice(nice)
        if os.getsid(0) == os.getpid():
            with open("/proc/self/autogroup", "w", encoding="ascii") as group:
                group.write(str(nice))


def start_python(*arguments: str, **options: Any) -> "subprocess.Popen[bytes]":
    """Start Python in its own session, with a single thread for linear algebra.

    The new process has the same import path as this one. ``options`` are passed to
    ``subprocess.Popen``.
    """
    paths = os.pathsep.join(os.path.abspath(path) for path in sys.path)
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    # Without -P, the current folder comes first, and a random.py in it would hide Python's module.
    child: subprocess.Popen[Any] = subprocess.Popen(
        [sys.executable, "-P", *arguments],
        env={**os.environ, **one_thread, "PYTHONPATH": paths},
        start_new_session=True,  # signals to this session, such as Ctrl-C, do not reach it
        **options,
    )
    return child
