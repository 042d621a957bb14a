"""Netgen and NGSolve: imported when they are needed, kept silent and to the threads that this process may use."""

import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Protocol, runtime_checkable

from airtact.solvers.threads import thread_count


@runtime_checkable
class NetgenMesh(Protocol):
    """What is used of Netgen's ``Mesh``; neither library has types."""

    Coordinates: Callable
    Elements3D: Callable


@runtime_checkable
class CurvedMesh(Protocol):
    """What is used of NGSolve's ``Mesh``."""

    nv: int
    nedge: int
    vertices: Iterable
    edges: Iterable
    faces: Iterable
    Elements: Callable
    Boundaries: Callable
    Materials: Callable
    GetBoundaries: Callable
    GetMaterials: Callable
    BoundaryCF: Callable
    MaterialCF: Callable
    MapToAllElements: Callable
    SetDeformation: Callable


@runtime_checkable
class FiniteSpace(Protocol):
    """What is used of NGSolve's ``H1``."""

    ndof: int
    FreeDofs: Callable
    GetDofNrs: Callable
    GetDofs: Callable
    GetFE: Callable
    SetOrder: Callable
    TestFunction: Callable
    TnT: Callable
    UpdateDofTables: Callable


@runtime_checkable
class Matrix(Protocol):
    """What is used of NGSolve's matrices."""

    CSR: Callable
    CreateColVector: Callable
    Inverse: Callable
    __mul__: Callable


@runtime_checkable
class AssembledForm(Protocol):
    """What is used of NGSolve's ``BilinearForm``, assembled with its inner unknowns eliminated."""

    mat: Matrix
    harmonic_extension: Matrix
    harmonic_extension_trans: Matrix
    inner_solve: Matrix


@runtime_checkable
class Expression(Protocol):
    """What is used of NGSolve's symbolic expressions and integrals."""

    __add__: Callable
    __rmul__: Callable


def ngsolve_library() -> ModuleType:
    """NGSolve, which takes a second to import."""
    import ngsolve

    ngsolve.ngsglobals.msg_level = 0
    return ngsolve


def netgen_libraries() -> tuple[ModuleType, ModuleType]:
    """Netgen's modules ``meshing`` and ``occ``."""
    from netgen import meshing, occ

    return meshing, occ


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
