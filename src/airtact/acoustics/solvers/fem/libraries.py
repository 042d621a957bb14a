"""Functions that import Netgen and NGSolve on demand, silence them and set their threads."""

import os
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from airtact.acoustics.solvers.shared import processor_count
from airtact.errors import extra

# Neither library has type annotations; these names describe their objects.
NetgenMesh = Any  # Netgen's Mesh
CurvedMesh = Any  # NGSolve's Mesh
FiniteSpace = Any  # NGSolve's H1
AssembledForm = Any  # an assembled BilinearForm without the unknowns inside tetrahedra
Expression = Any  # symbolic expressions and integrals


def ngsolve_library() -> ModuleType:
    """Import NGSolve, which takes about a second."""
    with extra("fem", "finite elements require NGSolve"):
        import ngsolve

    ngsolve.ngsglobals.msg_level = 0
    return ngsolve


def netgen_libraries() -> tuple[ModuleType, ModuleType]:
    """Import Netgen's modules ``meshing`` and ``occ``."""
    with extra("fem", "finite elements require Netgen"):
        from netgen import meshing, occ

    return meshing, occ


def thread_count() -> int:
    """Return ``OMP_NUM_THREADS`` or, by default, the number of processors of this process."""
    count = os.environ.get("OMP_NUM_THREADS", "")
    return int(count) if count.isdigit() and int(count) > 0 else processor_count()


@contextmanager
def many_threads() -> Iterator[None]:
    """Allow NGSolve to use all threads."""
    ngsolve = ngsolve_library()
    ngsolve.SetNumThreads(thread_count())
    with ngsolve.TaskManager():
        yield


@contextmanager
def heeding_interrupts() -> Iterator[None]:
    """Restore the handling of Ctrl-C after meshing, because Netgen's handler ends the process."""
    try:
        yield
    finally:
        handler = signal.getsignal(signal.SIGINT)  # the handler before Netgen replaces it
        if handler is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, handler)


@contextmanager
def muted() -> Iterator[None]:
    """Silence compiled code, because Netgen prints failures that airtact handles later."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved = [os.dup(1), os.dup(2)]
    with tempfile.TemporaryFile() as sink:
        try:
            os.dup2(sink.fileno(), 1)
            os.dup2(sink.fileno(), 2)
            yield
        finally:
            for descriptor, original in enumerate(saved, start=1):
                os.dup2(original, descriptor)
                os.close(original)
