"""Factorises the sparse complex symmetric matrix of finite elements: MKL's Pardiso, or NGSolve's sparse Cholesky."""

import ctypes
import importlib.metadata
import weakref
from abc import ABC, abstractmethod
from functools import cache, partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex128, Int32
from scipy.sparse import csr_array

from airtact.acoustics.solvers.arrays import Coefficients
from airtact.acoustics.solvers.fem.meshing.netgen import (
    AssembledForm,
    many_threads,
    ngsolve_library,
    thread_count,
)
from airtact.acoustics.solvers.fem.meshing.volume import Box
from airtact.acoustics.solvers.memory import available_memory
from airtact.errors import InvalidInput, NotConverged

COMPLEX_SYMMETRIC = 6
"""Pardiso's number for matrices that equal their transpose."""

SETTINGS = {0: 1, 1: 3, 9: 8, 17: -1, 20: 0, 34: 1}
"""Pardiso's settings, by number from 0: METIS in all threads, pivots of 1e-8 at least, single ones.

Pairs of pivots take a third longer and leave as large a residual.
"""

SINGLE_PRECISION = 27
"""Number of the setting that is 1 for single precision."""

REFINEMENTS = 12
"""Refinements at most that make up for single precision: two or three are enough."""

RESIDUAL, COARSE_RESIDUAL = 1e-6, 1e-3
"""Residual over the right-hand side after them; and up to order ``COARSE``, whose own error is far larger."""

COARSE = 5

TETRAHEDRA = 8.0
"""Tetrahedra that Netgen fills a cube with whose edge is that of the tetrahedra."""

FILL = {"pardiso": (8, 10.0), "sparsecholesky": (16, 14.0)}
"""Bytes of an entry of a factor, and entries over the 4/3 power of the unknowns, as nested dissection leaves them."""

OVERHEAD = 1.5
"""Memory in all over that of the factor's entries."""


class Factor(ABC):
    """A factorised matrix whose unknowns inside tetrahedra are eliminated before (static condensation).

    ``free`` are the unknowns shared by tetrahedra that are solved for; the others are 0.
    """

    def __init__(self, form: AssembledForm, free: Bool[np.ndarray, "unknowns"]) -> None:
        self.form, self.free = form, free

    @abstractmethod
    def solve_shared(self, right: Coefficients) -> Coefficients:
        """Solve for the unknowns that tetrahedra share; the others are 0."""

    def solve(self, right: Coefficients) -> Coefficients:
        """Solution for each column of a right-hand side."""
        form, found = self.form, np.empty_like(right)
        column, inner = form.mat.CreateColVector(), form.mat.CreateColVector()
        with many_threads():
            for number in range(right.shape[1]):
                column.FV().NumPy()[:] = right[:, number]
                column.data += form.harmonic_extension_trans * column
                found[:, number] = column.FV().NumPy()
            solved = self.solve_shared(found)
            for number in range(right.shape[1]):
                inner.FV().NumPy()[:] = found[:, number]
                column.FV().NumPy()[:] = solved[:, number]
                column.data += form.harmonic_extension * column
                column.data += form.inner_solve * inner
                found[:, number] = column.FV().NumPy()
        return found

    def _times(self, matrix: Any, vectors: Coefficients) -> Coefficients:
        """Product of one of NGSolve's matrices with each column."""
        found, vector = np.empty_like(vectors), self.form.mat.CreateColVector()
        product = vector.CreateVector()
        for number in range(vectors.shape[1]):
            vector.FV().NumPy()[:] = vectors[:, number]
            product.data = matrix * vector
            found[:, number] = product.FV().NumPy()
        return found


class SparseCholesky(Factor):
    """NGSolve's own L D Lᵀ in double precision."""

    def __init__(self, form: AssembledForm, free: Bool[np.ndarray, "unknowns"]) -> None:
        super().__init__(form, free)
        with many_threads():
            self._inverse = form.mat.Inverse(
                ngsolve_library().BitArray(free.tolist()), inverse="sparsecholesky"
            )

    def solve_shared(self, right: Coefficients) -> Coefficients:
        """Solve column by column."""
        return self._times(self._inverse, right)


class Pardiso(Factor):
    """MKL's Pardiso in single precision, refined against the matrix in double precision.

    Generalised conjugate residuals (S. Eisenstat, H. Elman, M. Schultz, SIAM J. Numer. Anal. 20
    (1983) 345) converge also where plain refinement does not. Where they stall, the factor is made
    again in double precision. ``residual`` is the largest residual over the right-hand side.
    """

    def __init__(
        self, form: AssembledForm, free: Bool[np.ndarray, "unknowns"], residual: float
    ) -> None:
        super().__init__(form, free)
        self._library, self._residual = ctypes.CDLL(str(pardiso_library())), residual
        self._library.MKL_Set_Num_Threads(thread_count())
        self._factorise(np.complex64)

    def _factorise(self, kind: type[np.complex64 | np.complex128]) -> None:
        entries, columns, ends = _upper_backwards(self.form, self.free)
        memory, settings, self._kind = (ctypes.c_int64 * 64)(), (ctypes.c_int * 64)(), kind
        for number, value in {**SETTINGS, SINGLE_PRECISION: int(kind == np.complex64)}.items():
            settings[number] = value
        self._call = partial(
            _pardiso, self._library, memory, settings, (entries.astype(kind), ends, columns)
        )
        self._call(12)
        self._release = weakref.finalize(self, self._call, -1)

    def solve_shared(self, right: Coefficients) -> Coefficients:
        """Solve, and solve again for the residual.

        Raises
        ------
        NotConverged
            The residual stays too large in double precision too.
        """
        solution, worst = self._refined(right)
        if worst > self._residual and self._kind == np.complex64:
            self._release()
            self._factorise(np.complex128)
            solution, worst = self._refined(right)
        if worst > self._residual:
            raise NotConverged(
                f"Pardiso leaves a residual of {worst:.2g} of the right-hand side after {REFINEMENTS} refinements, "
                f"more than {self._residual:.2g}: the matrix is nearly singular; take factorisation 'sparsecholesky'.",
                code="not_converged",
            )
        return solution

    def _refined(self, right: Coefficients) -> tuple[Coefficients, float]:
        """Solution, and the largest residual that it leaves over its right-hand side."""
        left, worst = np.where(self.free[:, None], right, 0), 0.0
        size = np.linalg.norm(left, axis=0)
        size[size == 0] = 1.0
        solution, found = np.zeros_like(left), []
        for _ in range(REFINEMENTS):
            scale = np.abs(left).max() or 1.0
            step = self._solved_once(left / scale)
            change = np.where(self.free[:, None], self._times(self.form.mat, step), 0)
            for before, its_change in found:
                part = (its_change.conj() * change).sum(axis=0)
                step, change = step - part * before, change - part * its_change
            length = np.linalg.norm(change, axis=0)
            length[length == 0] = 1.0
            step, change = step / length, change / length
            found.append((step, change))
            part = (change.conj() * left).sum(axis=0)
            solution, left = solution + part * step, left - part * change
            worst = float((np.linalg.norm(left, axis=0) / size).max())
            if worst <= self._residual:
                break
        return solution, worst

    def _solved_once(self, right: Coefficients) -> Coefficients:
        columns = np.asfortranarray(right[self.free][::-1], dtype=self._kind)
        solved, found = np.zeros_like(columns), np.zeros_like(right)
        self._call(33, columns, solved)
        found[self.free] = solved[::-1]
        return found


def _pardiso(
    library: ctypes.CDLL,
    memory: Any,
    settings: Any,
    matrix: tuple[np.ndarray, np.ndarray, np.ndarray],
    phase: int,
    right: np.ndarray | None = None,
    solution: np.ndarray | None = None,
) -> None:
    """Run a phase of Pardiso: 12 factorises, 33 solves for the columns of ``right``, -1 releases the memory."""

    def whole(number: int) -> Any:
        return ctypes.byref(ctypes.c_int(number))

    def start(array: np.ndarray | None) -> Any:
        return None if array is None else array.ctypes.data_as(ctypes.c_void_p)

    entries, ends, columns = matrix
    fault, count = ctypes.c_int(0), 1 if right is None else right.shape[1]
    library.pardiso(
        memory, whole(1), whole(1), whole(COMPLEX_SYMMETRIC), whole(phase), whole(len(ends) - 1),
        start(entries), start(ends), start(columns), None, whole(count), settings, whole(0),
        start(right), start(solution), ctypes.byref(fault),
    )  # fmt: skip
    if fault.value:
        raise MemoryError(f"Pardiso stopped in phase {phase} with error {fault.value}.")


def _upper_backwards(
    form: AssembledForm, free: Bool[np.ndarray, "unknowns"]
) -> tuple[
    Complex128[np.ndarray, "entries"], Int32[np.ndarray, "entries"], Int32[np.ndarray, "ends"]
]:
    """Entries, columns and ends of rows of the upper triangle of the free unknowns, the last row first.

    NGSolve keeps the lower triangle: read backwards, it is the upper one of a matrix whose unknowns
    are reversed.
    """
    entries, columns, first = (np.asarray(part) for part in form.mat.CSR())
    lower = csr_array((entries, columns, first.astype(np.int32)), shape=(len(free), len(free)))
    rows = np.repeat(np.arange(len(free)), np.diff(lower.indptr))
    chosen = free[rows] & free[lower.indices]
    number = np.cumsum(free[::-1])[::-1] - 1  # of the free unknowns, the last is 0
    ends = np.cumsum(np.bincount(number[rows[chosen]], minlength=int(free.sum())))
    return (
        lower.data[chosen][::-1],
        number[lower.indices[chosen]][::-1].astype(np.int32),
        np.concatenate([[0], ends]).astype(np.int32),
    )


@cache
def pardiso_library() -> str | None:
    """Path of MKL's library, or None where the package ``mkl`` is not installed."""
    try:
        files = importlib.metadata.distribution("mkl").files or []
    except importlib.metadata.PackageNotFoundError:
        return None
    paths = [str(file.locate()) for file in files if "mkl_rt" in file.name]
    return paths[0] if paths else None


def chosen_method(asked: str) -> str:
    """Factorisation taken for "found", "sparsecholesky" or "pardiso"; raises where ``mkl`` is not installed for it."""
    if asked == "found":
        return "sparsecholesky" if pardiso_library() is None else "pardiso"
    if asked == "pardiso" and pardiso_library() is None:
        raise InvalidInput(
            "the factorisation 'pardiso' was asked for, but the package mkl is not installed (0 files found); "
            "pip install 'airtact[mkl]', or take 'sparsecholesky'.",
            code="extra_missing",
        )
    return asked


def factorised(
    form: AssembledForm, free: Bool[np.ndarray, "unknowns"], order: int, method: str
) -> Factor:
    """Factorise the assembled matrix of elements of an order by "sparsecholesky" or "pardiso"."""
    if method == "sparsecholesky":
        return SparseCholesky(form, free)
    return Pardiso(form, free, COARSE_RESIDUAL if order <= COARSE else RESIDUAL)


def check_memory(
    box: Box, wavelength: float, order: int, elements_per_wavelength: float, method: str
) -> None:
    """Raise "too_little_memory" where the machine has not the memory of a factorisation, before it is taken."""
    volume = float((box.outer_high - box.outer_low).prod()) / wavelength**3
    unknowns = TETRAHEDRA * volume * elements_per_wavelength**3 * order**3 / 6
    each, fill = FILL[method]
    size, free = OVERHEAD * each * fill * unknowns ** (4 / 3), available_memory()
    if size > 0.9 * free:
        raise InvalidInput(
            f"finite elements of order {order} need some {unknowns:.2g} unknowns and {size / 2**30:.1f} GiB for a box "
            f"of {(box.high - box.low).prod() / wavelength**3:.0f} cubic wavelengths, but {free / 2**30:.1f} GiB of "
            "memory are free; take BoundaryElement, a lower order for a preview, or fewer bodies.",
            code="too_little_memory",
        )
