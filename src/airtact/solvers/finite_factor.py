"""Factorises the matrix of finite elements: NGSolve's own sparse Cholesky, or Pardiso where MKL is installed."""

import ctypes
import importlib.metadata
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Complex, Complex128

from airtact.conventions import InvalidInput
from airtact.solvers.finite_netgen import many_threads, thread_count
from airtact.solvers.finite_system import System

COMPLEX_SYMMETRIC = 6
"""Pardiso's number for matrices that equal their transpose."""

REFINEMENTS = 2
"""Steps of refinement that make up for Pardiso's single precision."""


class Factor(ABC):
    """A factorised matrix of one parity about the mirrors."""

    def __init__(self, system: System, odd: Sequence[int]) -> None:
        self.system = system
        free = system.space.FreeDofs(True)
        taken = type(free)(free)
        for axis in odd:
            taken &= ~system.space.GetDofs(system.mesh.Boundaries(f"wall{2 * axis}"))
        self.free = taken

    @abstractmethod
    def _solve_shared(self, right: Any) -> Any:
        """Solve for the unknowns that tetrahedra share: an NGSolve vector for an NGSolve vector."""

    def solve(self, load: Complex128[np.ndarray, "unknowns sounds"]) -> Complex128[np.ndarray, "unknowns sounds"]:
        """Solution for each column of a load."""
        form, found = self.system.form, np.empty_like(load)
        right = form.mat.CreateColVector()
        with many_threads():
            for column in range(load.shape[1]):
                right.FV().NumPy()[:] = load[:, column]
                right.data += form.harmonic_extension_trans * right
                solution = self._solve_shared(right)
                solution.data += form.harmonic_extension * solution
                solution.data += form.inner_solve * right
                found[:, column] = solution.FV().NumPy()
        return found


class SparseCholesky(Factor):
    """NGSolve's own L D Lᵀ."""

    def __init__(self, system: System, odd: Sequence[int]) -> None:
        super().__init__(system, odd)
        with many_threads():
            self._inverse = system.form.mat.Inverse(self.free, inverse="sparsecholesky")

    def _solve_shared(self, right: Any) -> Any:
        solution = right.CreateVector()
        solution.data = self._inverse * right
        return solution


class Pardiso(Factor):
    """MKL's Pardiso in single precision, refined against the matrix in double precision."""

    def __init__(self, system: System, odd: Sequence[int]) -> None:
        from scipy.sparse import csr_matrix

        super().__init__(system, odd)
        entries, columns, first = (np.array(part) for part in system.form.mat.CSR())
        lower = csr_matrix((entries, columns, first), shape=(system.unknowns, system.unknowns))
        self._chosen = np.array([bool(bit) for bit in self.free])
        upper = csr_matrix(lower[self._chosen][:, self._chosen].T)
        upper.sort_indices()
        self._upper = upper
        self._lower = csr_matrix(upper.T)
        self._lower.setdiag(0)
        self._library = ctypes.CDLL(str(pardiso_library()))
        self._library.MKL_Set_Num_Threads(thread_count())
        self._handle, self._settings = (ctypes.c_int64 * 64)(), (ctypes.c_int * 64)()
        for place, value in {0: 1, 1: 2, 9: 8, 17: -1, 20: 1, 27: 1, 34: 1}.items():
            self._settings[place] = value
        self._single = upper.data.astype(np.complex64)
        self._rows, self._columns = upper.indptr.astype(np.int32), upper.indices.astype(np.int32)
        self._call(12, None, None, 1)

    def __del__(self) -> None:
        if hasattr(self, "_single"):
            self._call(-1, None, None, 1)

    def _call(
        self,
        phase: int,
        right: Complex[np.ndarray, "free"] | None,
        solution: Complex[np.ndarray, "free"] | None,
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

    def _solve_shared(self, right: Any) -> Any:
        wanted = right.FV().NumPy()[self._chosen]
        solution = np.zeros_like(wanted)
        for _ in range(1 + REFINEMENTS):
            left = wanted - self._upper @ solution - self._lower @ solution
            scale = np.abs(left).max() or 1.0
            step, single = np.zeros(len(left), dtype=np.complex64), (left / scale).astype(np.complex64)
            self._call(33, single, step, 1)
            solution += scale * step
        whole = right.CreateVector()
        whole.FV().NumPy()[:] = 0
        whole.FV().NumPy()[self._chosen] = solution
        return whole


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
    method : ``"sparsecholesky"`` or ``"pardiso"``.

    Raises
    ------
    InvalidInput
        Pardiso was asked for where the package ``mkl`` is not installed.
    """
    if method == "sparsecholesky":
        return SparseCholesky(system, odd)
    if pardiso_library() is None:
        raise InvalidInput(
            "the factorisation 'pardiso' was asked for, but the package mkl is not installed (0 files found); "
            "pip install 'airtact[mkl]', or take 'sparsecholesky'."
        )
    return Pardiso(system, odd)
