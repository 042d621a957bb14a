"""Factorises the matrix of finite elements: front by front, by NGSolve's sparse Cholesky, or by Pardiso of MKL."""

import ctypes
import importlib.metadata
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex64, Complex128, Int32
from scipy.sparse import csr_array

from airtact.conventions import InvalidInput
from airtact.solvers.fem.meshing.netgen import many_threads, ngsolve_library
from airtact.solvers.fem.multifrontal.elimination import eliminate, solve
from airtact.solvers.fem.system import System
from airtact.solvers.threads import thread_count

COMPLEX_SYMMETRIC = 6
"""Pardiso's number for matrices that equal their transpose."""

PARDISO = {0: 1, 1: 3, 9: 8, 17: -1, 20: 0, 27: 1, 34: 1}
"""Its settings, by number from 0: METIS in all threads, pivots of 1e-8 at least, single ones, single precision.

Pairs of pivots take a third longer and leave as much of a load.
"""

REFINEMENTS = 12
"""Steps of refinement at most that make up for single precision: two or three are enough."""

ENOUGH, ROUGHLY = 1e-6, 1e-3
"""What may be left of a load after them, as a share; and up to order ``ROUGH``, whose own error is far larger."""

ROUGH = 5


class Factor(ABC):
    """A factorised matrix of one parity about the mirrors."""

    def __init__(self, system: System, odd: Sequence[int]) -> None:
        self.system, self.free = system, system.free(odd, shared=True)

    @abstractmethod
    def solve_shared(
        self, right: Complex128[np.ndarray, "unknowns sounds"]
    ) -> Complex128[np.ndarray, "unknowns sounds"]:
        """Solve for the unknowns that tetrahedra share; the others are 0."""

    def solve(self, load: Complex128[np.ndarray, "unknowns sounds"]) -> Complex128[np.ndarray, "unknowns sounds"]:
        """Solution for each column of a load."""
        form, found = self.system.form, np.empty_like(load)
        column, inner = form.mat.CreateColVector(), form.mat.CreateColVector()
        with many_threads():
            for sound in range(load.shape[1]):
                column.FV().NumPy()[:] = load[:, sound]
                column.data += form.harmonic_extension_trans * column
                found[:, sound] = column.FV().NumPy()
            solved = self.solve_shared(found)
            for sound in range(load.shape[1]):
                inner.FV().NumPy()[:] = found[:, sound]
                column.FV().NumPy()[:] = solved[:, sound]
                column.data += form.harmonic_extension * column
                column.data += form.inner_solve * inner
                found[:, sound] = column.FV().NumPy()
        return found


class SparseCholesky(Factor):
    """NGSolve's own L D Lᵀ."""

    def __init__(self, system: System, odd: Sequence[int]) -> None:
        super().__init__(system, odd)
        with many_threads():
            free = ngsolve_library().BitArray(self.free.tolist())
            self._inverse = system.form.mat.Inverse(free, inverse="sparsecholesky")

    def solve_shared(
        self, right: Complex128[np.ndarray, "unknowns sounds"]
    ) -> Complex128[np.ndarray, "unknowns sounds"]:
        """Solve by triangles, sound by sound."""
        found, vector = np.empty_like(right), self.system.form.mat.CreateColVector()
        solution = vector.CreateVector()
        for sound in range(right.shape[1]):
            vector.FV().NumPy()[:] = right[:, sound]
            solution.data = self._inverse * vector
            found[:, sound] = solution.FV().NumPy()
        return found


class Refined(Factor):
    """A factor in single precision, refined against the matrix in double precision.

    By generalised conjugate residuals (S. Eisenstat, H. Elman, M. Schultz, SIAM J. Numer. Anal. 20 (1983) 345), which
    converge also where plain refinement would not.
    """

    @abstractmethod
    def _roughly(self, right: Complex64[np.ndarray, "unknowns sounds"]) -> Complex64[np.ndarray, "unknowns sounds"]:
        """Solve in single precision for a load that is 0 where nothing is free."""

    def solve_shared(
        self, right: Complex128[np.ndarray, "unknowns sounds"]
    ) -> Complex128[np.ndarray, "unknowns sounds"]:
        """Solve in single precision, and again for what that leaves."""
        left = np.where(self.free[:, None], right, 0)
        enough = (ROUGHLY if self.system.order <= ROUGH else ENOUGH) * np.linalg.norm(left, axis=0)
        solution, found = np.zeros_like(left), []
        for _ in range(REFINEMENTS):
            scale = np.abs(left).max() or 1.0
            step = self._roughly((left / scale).astype(np.complex64)).astype(np.complex128)
            change = self._times(step)
            for before, its_change in found:
                share = (its_change.conj() * change).sum(axis=0)
                step, change = step - share * before, change - share * its_change
            length = np.linalg.norm(change, axis=0)
            length[length == 0] = 1.0
            step, change = step / length, change / length
            found.append((step, change))
            share = (change.conj() * left).sum(axis=0)
            solution, left = solution + share * step, left - share * change
            if (np.linalg.norm(left, axis=0) <= enough).all():
                return solution
        size = np.linalg.norm(right, axis=0)
        return self._not_enough(right, float((np.linalg.norm(left, axis=0) / np.where(size > 0, size, 1.0)).max()))

    def _times(self, solution: Complex128[np.ndarray, "unknowns sounds"]) -> Complex128[np.ndarray, "unknowns sounds"]:
        found, vector = np.zeros_like(solution), self.system.form.mat.CreateColVector()
        product = vector.CreateVector()
        for sound in range(solution.shape[1]):
            vector.FV().NumPy()[:] = solution[:, sound]
            product.data = self.system.form.mat * vector
            found[self.free, sound] = product.FV().NumPy()[self.free]
        return found

    def _not_enough(
        self, right: Complex128[np.ndarray, "unknowns sounds"], worst: float
    ) -> Complex128[np.ndarray, "unknowns sounds"]:
        raise InvalidInput(
            f"single precision leaves {worst:.2g} of the load unsolved after {REFINEMENTS} refinements; take "
            "factorisation 'sparsecholesky'."
        )


class Multifrontal(Refined):
    """Elimination front by front; where single precision does not suffice, NGSolve's own in double precision."""

    def __init__(self, system: System, odd: Sequence[int]) -> None:
        super().__init__(system, odd)
        self._odd, self._spare = odd, None
        fronts = system.dissection.only(self.free)
        self._eliminated = eliminate(system.entries.only(self.free), fronts)

    def _roughly(self, right: Complex64[np.ndarray, "unknowns sounds"]) -> Complex64[np.ndarray, "unknowns sounds"]:
        return solve(self._eliminated, right)

    def _not_enough(
        self, right: Complex128[np.ndarray, "unknowns sounds"], worst: float
    ) -> Complex128[np.ndarray, "unknowns sounds"]:
        self._spare = self._spare or SparseCholesky(self.system, self._odd)
        return self._spare.solve_shared(right)


class Pardiso(Refined):
    """MKL's Pardiso in single precision."""

    def __init__(self, system: System, odd: Sequence[int]) -> None:
        super().__init__(system, odd)
        self._library = ctypes.CDLL(str(pardiso_library()))
        self._library.MKL_Set_Num_Threads(thread_count())
        self._handle, self._settings = (ctypes.c_int64 * 64)(), (ctypes.c_int * 64)()
        for place, value in PARDISO.items():
            self._settings[place] = value
        self._single, self._columns, self._rows = _backwards(system.lower, self.free)
        self._call(12, None, None, 1)

    def __del__(self) -> None:
        if hasattr(self, "_single"):
            self._call(-1, None, None, 1)

    def _call(
        self,
        phase: int,
        right: Complex64[np.ndarray, "free sounds"] | None,
        solution: Complex64[np.ndarray, "free sounds"] | None,
        count: int,
    ) -> None:
        def whole(number: int) -> Any:
            return ctypes.byref(ctypes.c_int(number))

        def start(array: np.ndarray | None) -> Any:
            return None if array is None else array.ctypes.data_as(ctypes.c_void_p)

        fault = ctypes.c_int(0)
        self._library.pardiso(
            self._handle, whole(1), whole(1), whole(COMPLEX_SYMMETRIC), whole(phase), whole(len(self._rows) - 1),
            start(self._single), start(self._rows), start(self._columns), None, whole(count), self._settings, whole(0),
            start(right), start(solution), ctypes.byref(fault),
        )  # fmt: skip
        if fault.value:
            raise MemoryError(f"Pardiso stopped in phase {phase} with error {fault.value}.")

    def _roughly(self, right: Complex64[np.ndarray, "unknowns sounds"]) -> Complex64[np.ndarray, "unknowns sounds"]:
        columns = np.asfortranarray(right[self.free][::-1])
        solved, found = np.zeros_like(columns), np.zeros_like(right)
        self._call(33, columns, solved, right.shape[1])
        found[self.free] = solved[::-1]
        return found


def _backwards(
    lower: csr_array, chosen: Bool[np.ndarray, "unknowns"]
) -> tuple[Complex64[np.ndarray, "entries"], Int32[np.ndarray, "entries"], Int32[np.ndarray, "ends"]]:
    """Entries, columns and ends of the rows of the upper triangle: the lower one's of some unknowns, last row first."""
    rows = np.repeat(np.arange(len(chosen)), np.diff(lower.indptr))
    kept = chosen[rows] & chosen[lower.indices]
    number = np.cumsum(chosen[::-1])[::-1] - 1  # of the chosen ones, the last is 0
    ends = np.cumsum(np.bincount(number[rows[kept]], minlength=int(chosen.sum())))
    columns = number[lower.indices[kept]][::-1]
    return (
        lower.data[kept][::-1].astype(np.complex64),
        columns.astype(np.int32),
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


def factorised(system: System, odd: Sequence[int], method: str) -> Factor:
    """Factorise a system.

    Parameters
    ----------
    system : the assembled equation.
    odd : axes of the mirrors that the sound is odd about; it is even about the others.
    method : ``"multifrontal"``, ``"sparsecholesky"`` or ``"pardiso"``.

    Raises
    ------
    InvalidInput
        Pardiso was asked for where the package ``mkl`` is not installed.
    """
    if method == "multifrontal":
        return Multifrontal(system, odd)
    if method == "sparsecholesky":
        return SparseCholesky(system, odd)
    if pardiso_library() is None:
        raise InvalidInput(
            "the factorisation 'pardiso' was asked for, but the package mkl is not installed (0 files found); "
            "pip install 'airtact[mkl]', or take 'found'."
        )
    return Pardiso(system, odd)
