"""Processes of a sweep: as many as there are processors and as memory allows, each with one thread."""

from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

from airtact.acoustics.solvers.memory import available_memory, processor_count
from airtact.errors import InvalidInput
from airtact.setup.sweeping.worker import begin

PROCESS = 1.2e8
"""Memory of a process that has loaded airtact and solves nothing [bytes]."""

SHARE = 0.8
"""Share of the memory available that the processes together may take."""


def process_count(points: int, wanted: int | None = None, memory: float = PROCESS) -> int:
    """Return the number of processes for so many points, of which each takes so much memory [bytes].

    That is one a processor, or as many as ``wanted``, no more than points, and no more than fit
    into the memory that is available now. ``InvalidInput`` is raised where not even one fits, or
    none is wanted.
    """
    if wanted is not None and wanted < 1:
        raise InvalidInput(
            f"{wanted} processes are asked for; give 1 or more.", code="out_of_range"
        )
    free = available_memory()
    if memory > free:
        raise InvalidInput(
            f"one point takes about {memory / 1e9:.2g} GB, and {free / 1e9:.2g} GB are available: end other programs, "
            "or ask for less accuracy.",
            code="too_little_memory",
        )
    fitting = SHARE * free / memory
    return int(max(1, min(processor_count() if wanted is None else wanted, points, fitting)))


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Begin so many processes; all of them end when the block is left by an error, or the program is killed."""
    context = get_context("spawn")
    stop, held = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=begin, initargs=(stop,))  # pyright: ignore
    try:
        yield pool
        pool.shutdown()
    finally:
        held.close()
        pool.shutdown(cancel_futures=True)
        stop.close()
