"""Netgen and NGSolve: imported when they are needed, kept silent and to the threads that this process may use."""

import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from airtact.acoustics.solvers.memory import processor_count
from airtact.errors import extra


@runtime_checkable
class Untyped(Protocol):
    """An object of Netgen's or NGSolve's: neither library has types."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


@runtime_checkable
class NetgenMesh(Untyped, Protocol):
    """Netgen's ``Mesh``."""

    Coordinates: Callable


@runtime_checkable
class CurvedMesh(Untyped, Protocol):
    """NGSolve's ``Mesh``."""

    MapToAllElements: Callable


@runtime_checkable
class FiniteSpace(Untyped, Protocol):
    """NGSolve's ``H1``."""

    FreeDofs: Callable


@runtime_checkable
class AssembledForm(Untyped, Protocol):
    """NGSolve's ``BilinearForm``, assembled with its inner unknowns eliminated."""

    Assemble: Callable


@runtime_checkable
class Expression(Protocol):
    """NGSolve's symbolic expressions and integrals."""

    __add__: Callable
    __rmul__: Callable


def ngsolve_library() -> ModuleType:
    """NGSolve, which takes a second to import."""
    with extra("fem", "finite elements need NGSolve"):
        import ngsolve

    ngsolve.ngsglobals.msg_level = 0
    return ngsolve


def netgen_libraries() -> tuple[ModuleType, ModuleType]:
    """Netgen's modules ``meshing`` and ``occ``."""
    with extra("fem", "finite elements need Netgen"):
        from netgen import meshing, occ

    return meshing, occ


def thread_count() -> int:
    """Return the number of threads: ``OMP_NUM_THREADS`` if it is set, else the processors of this process."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return processor_count()


@contextmanager
def many_threads() -> Iterator[None]:
    """Run NGSolve on all threads."""
    ngsolve = ngsolve_library()
    ngsolve.SetNumThreads(thread_count())
    with ngsolve.TaskManager():
        yield


@contextmanager
def heeding_interrupts() -> Iterator[None]:
    """Let Ctrl-C raise ``KeyboardInterrupt`` again: after meshing, Netgen lets it end the process."""
    try:
        yield
    finally:
        handler = signal.getsignal(signal.SIGINT)  # what Python believes is set, and what was
        if handler is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, handler)


@contextmanager
def muted() -> Iterator[None]:
    """Drop what compiled code prints: Netgen prints faults that are looked for afterwards."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(1), os.dup(2)]
    with tempfile.TemporaryFile() as nowhere:
        try:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
            yield
        finally:
            for number, old in enumerate(kept, start=1):
                os.dup2(old, number)
                os.close(old)
