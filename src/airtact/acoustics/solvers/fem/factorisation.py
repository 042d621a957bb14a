"""Factorisation of the sparse complex symmetric finite element matrix by Pardiso or NGSolve."""

import ctypes
import importlib.metadata
import weakref
from abc import ABC, abstractmethod
from functools import cache, partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64
from scipy.sparse import csr_array

from airtact.acoustics.solvers.fem.libraries import (
    AssembledForm,
    many_threads,
    ngsolve_library,
    thread_count,
)
from airtact.acoustics.solvers.fem.mesh import Box
from airtact.acoustics.solvers.shared import Coefficients, available_memory
from airtact.errors import InvalidInput, NotConverged

# Largest number of refinement steps in single precision; two or three are usually enough.
MAX_REFINEMENTS = 12

# Up to this order, a residual of 1e-3 is enough because the error of the elements is far larger.
COARSE_ORDER = 5


class Factor(ABC):
    """A factorised matrix from which the unknowns inside tetrahedra have been eliminated.

    The unknowns shared by tetrahedra are solved for where the mask ``free`` is True, and are 0
    elsewhere.
    """

    def __init__(self, form: AssembledForm, free: Bool[np.ndarray, "unknowns"]) -> None:
        self.form, self.free = form, free

    @abstractmethod
    def solve_shared(self, right: Coefficients) -> Coefficients:
        """Return the solution for the unknowns shared by tetrahedra, with 0 for all others."""

    def solve(self, right: Coefficients) -> Coefficients:
        """Return the solution for each column of ``right``, which contains right-hand sides."""
        form = self.form
        solution = np.empty_like(right)
        column = form.mat.CreateColVector()
        inner = form.mat.CreateColVector()
        with many_threads():
            for number in range(right.shape[1]):
                column.FV().NumPy()[:] = right[:, number]
                # Static condensation moves the loads inside tetrahedra to shared unknowns,
                column.data += form.harmonic_extension_trans * column
                solution[:, number] = column.FV().NumPy()
            shared = self.solve_shared(solution)
            for number in range(right.shape[1]):
                inner.FV().NumPy()[:] = solution[:, number]
                column.FV().NumPy()[:] = shared[:, number]
                # It also computes the unknowns inside from the shared unknowns afterwards.
                column.data += form.harmonic_extension * column
                column.data += form.inner_solve * inner
                solution[:, number] = column.FV().NumPy()
        return solution

    def _times(self, matrix: Any, vectors: Coefficients) -> Coefficients:
        products = np.empty_like(vectors)
        vector = self.form.mat.CreateColVector()
        product = vector.CreateVector()
        for number in range(vectors.shape[1]):
            vector.FV().NumPy()[:] = vectors[:, number]
            product.data = matrix * vector
            products[:, number] = product.FV().NumPy()
        return products


class SparseCholesky(Factor):
    """NGSolve's L D Lᵀ factorisation in double precision."""

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
    """MKL's Pardiso in single precision, refined with the matrix in double precision.

    The refinement uses generalised conjugate residuals (S. Eisenstat, H. Elman, M. Schultz, SIAM J.
    Numer. Anal. 20 (1983) 345), which converge even where plain refinement does not. ``residual``
    is the largest allowed residual relative to the right-hand side.
    """

    def __init__(
        self, form: AssembledForm, free: Bool[np.ndarray, "unknowns"], residual: float
    ) -> None:
        super().__init__(form, free)
        library = ctypes.CDLL(str(pardiso_library()))
        library.MKL_Set_Num_Threads(thread_count())
        self._residual = residual
        matrix = _upper_backwards(form, free)
        # Pardiso's settings, numbered from 0: METIS in all threads, pivots of at least 1e-8, single
        # pivots (pairs take a third longer for the same residual), and single precision.
        values = {0: 1, 1: 3, 9: 8, 17: -1, 20: 0, 27: 1, 34: 1}
        settings = (ctypes.c_int * 64)()
        for number, value in values.items():
            settings[number] = value
        self._call = partial(
            _pardiso,
            library,
            (ctypes.c_int64 * 64)(),
            settings,
            (matrix.data.astype(np.complex64), matrix.indptr, matrix.indices),
        )
        self._call(12)
        # Pardiso's memory is not managed by Python, so it is released with this object.
        weakref.finalize(self, self._call, -1)

    def solve_shared(self, right: Coefficients) -> Coefficients:
        """Solve and refine until the residual is small, or raise ``NotConverged`` if it stalls."""
        residual = np.where(self.free[:, None], right, 0)
        size = _norms(residual)
        solution = np.zeros_like(residual)
        worst = 0.0
        directions: list[tuple[Coefficients, Coefficients]] = []
        for _ in range(MAX_REFINEMENTS):
            scale = np.abs(residual).max() or 1.0
            step = self._solved_once(residual / scale)
            change = np.where(self.free[:, None], self._times(self.form.mat, step), 0)
            # A change orthogonal to the earlier changes does not undo what they gained.
            for earlier, its_change in directions:
                part = (its_change.conj() * change).sum(axis=0)
                step = step - part * earlier
                change = change - part * its_change
            length = _norms(change)
            step = step / length
            change = change / length
            directions.append((step, change))
            part = (change.conj() * residual).sum(axis=0)
            solution = solution + part * step
            residual = residual - part * change
            worst = float((np.linalg.norm(residual, axis=0) / size).max())
            if worst <= self._residual:
                return solution
        raise NotConverged(
            f"Pardiso leaves a residual of {worst:.2g} of the right-hand side after "
            f"{MAX_REFINEMENTS} refinements, above the limit of {self._residual:.2g}: the matrix "
            "is nearly singular; use another order, or uninstall mkl to factorise in double "
            "precision.",
            code="not_converged",
        )

    def _solved_once(self, right: Coefficients) -> Coefficients:
        # The unknowns are in reverse order, as in the matrix.
        columns = np.asfortranarray(right[self.free][::-1], dtype=np.complex64)
        solved = np.zeros_like(columns)
        self._call(33, columns, solved)
        solution = np.zeros_like(right)
        solution[self.free] = solved[::-1]
        return solution


def _norms(vectors: Coefficients) -> Float64[np.ndarray, "excitations"]:
    """Return the norm of each column as a divisor, with 1 in place of 0."""
    norms = np.linalg.norm(vectors, axis=0)
    return np.where(norms == 0, 1.0, norms)


def _pardiso(
    library: ctypes.CDLL,
    memory: Any,
    settings: Any,
    matrix: tuple[np.ndarray, np.ndarray, np.ndarray],
    phase: int,
    right: np.ndarray | None = None,
    solution: np.ndarray | None = None,
) -> None:
    """Run one phase of Pardiso.

    Phase 12 factorises, phase 33 solves for the columns of ``right``, and phase -1 frees the
    memory.
    """

    def integer(number: int) -> Any:
        return ctypes.byref(ctypes.c_int(number))

    def start(array: np.ndarray | None) -> Any:
        return None if array is None else array.ctypes.data_as(ctypes.c_void_p)

    entries, row_starts, columns = matrix
    fault = ctypes.c_int(0)
    count = 1 if right is None else right.shape[1]
    complex_symmetric = 6
    library.pardiso(
        memory, integer(1), integer(1), integer(complex_symmetric), integer(phase),
        integer(len(row_starts) - 1), start(entries), start(row_starts), start(columns), None,
        integer(count), settings, integer(0), start(right), start(solution), ctypes.byref(fault),
    )  # fmt: skip
    if fault.value:
        raise MemoryError(f"Pardiso stopped in phase {phase} with error {fault.value}.")


def _upper_backwards(form: AssembledForm, free: Bool[np.ndarray, "unknowns"]) -> csr_array:
    """Return the upper triangle of the matrix of free unknowns, with the last row first.

    NGSolve stores the lower triangle. Read backwards, it is the upper triangle of the matrix with
    its unknowns reversed.
    """
    entries, columns, row_starts = (np.asarray(part) for part in form.mat.CSR())
    rows = np.repeat(np.arange(len(free)), np.diff(row_starts.astype(np.int64)))
    chosen = free[rows] & free[columns]
    number = np.cumsum(free[::-1])[::-1] - 1  # of the free unknowns; the last has number 0
    count = int(free.sum())
    row_ends = np.cumsum(np.bincount(number[rows[chosen]], minlength=count))
    return csr_array(
        (
            entries[chosen][::-1],
            number[columns[chosen]][::-1].astype(np.int32),
            np.concatenate([[0], row_ends]).astype(np.int32),
        ),
        shape=(count, count),
    )


@cache
def pardiso_library() -> str | None:
    """Return the path of MKL's library, or None if the package ``mkl`` is not installed."""
    try:
        files = importlib.metadata.distribution("mkl").files or []
    except importlib.metadata.PackageNotFoundError:
        return None
    return next((str(file.locate()) for file in files if "mkl_rt" in file.name), None)


def factorised(
    form: AssembledForm, free: Bool[np.ndarray, "unknowns"], order: int, method: str
) -> Factor:
    """Factorise a finite-element matrix with the ``method`` "pardiso" or "sparsecholesky".

    ``order`` is the polynomial order of the elements.
    """
    if method == "sparsecholesky":
        return SparseCholesky(form, free)
    # Largest residual after refinement, relative to the right-hand side.
    return Pardiso(form, free, 1e-3 if order <= COARSE_ORDER else 1e-6)


def check_memory(
    box: Box, wavelength: float, order: int, elements_per_wavelength: float, method: str
) -> None:
    """Raise an error if there is not enough memory for a factorisation."""
    volume = float((box.outer_high - box.outer_low).prod()) / wavelength**3
    # Netgen fills a cube with about 8 tetrahedra whose edges are as long as those of the cube.
    unknowns = 8.0 * volume * elements_per_wavelength**3 * order**3 / 6
    # With nested dissection, the number of entries grows as the unknowns to the power of 4/3. The
    # workspace adds half as much memory.
    bytes_per_entry, fill = (8, 10.0) if method == "pardiso" else (16, 14.0)
    size = 1.5 * bytes_per_entry * fill * unknowns ** (4 / 3)
    free = available_memory()
    if size > 0.9 * free:
        raise InvalidInput(
            f"finite elements of order {order} need about {unknowns:.2g} unknowns and "
            f"{size / 2**30:.1f} GiB for a box of "
            f"{(box.high - box.low).prod() / wavelength**3:.0f} cubic wavelengths, but only "
            f"{free / 2**30:.1f} GiB of memory are free. Use BoundaryElement, a lower order for a "
            "preview, or fewer bodies.",
            code="too_little_memory",
        )
