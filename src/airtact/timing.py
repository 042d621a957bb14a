"""Wall time by step, for reports and for lines of progress.

And threads and processes that would only lengthen it.
"""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache

from threadpoolctl import ThreadpoolController

# What a long computation calls with the words of each step as it begins
Progress = Callable[[str], None]


def no_progress(step: str) -> None:
    """Report nothing."""


class Clock:
    """Measure the wall time of each step, and report each step as it begins.

    Attributes
    ----------
    seconds : wall time by step [s]; the times of a step that runs again add up.

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
        """Report a step in ``words`` or by its name, and add its time to ``seconds[name]``."""
        if self._progress is not None:
            self._progress(words or name)
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begun


@contextmanager
def one_thread() -> Iterator[None]:
    """Let linear algebra use one thread inside the block."""
    with _threads().limit(limits=1, user_api="blas"):
        yield


@cache
def _threads() -> ThreadpoolController:
    """Find the libraries whose threads can be limited, once: it takes milliseconds."""
    return ThreadpoolController()


def give_way(nice: int) -> None:
    """Lower the priority of this process by ``nice`` steps, where the system can.

    Linux divides the processors among sessions first (its autogroups), so that ``nice`` counts
    inside a session only: a process in a session of its own lowers the session, too.
    """
    with suppress(AttributeError, OSError):
        os.nice(nice)
        if os.getsid(0) == os.getpid():
            with open("/proc/self/autogroup", "w", encoding="ascii") as group:
                group.write(str(nice))
