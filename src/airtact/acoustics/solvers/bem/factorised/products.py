"""Dense matrices that are multiplied by a few vectors: it takes as long as the matrix takes to read from memory."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float32, Int16, Num

from airtact import _kernels
from airtact.acoustics.solvers.loops import loop_for
from airtact.printing import in_short

FEW = 8
"""Vectors up to which a compiled loop multiplies them: BLAS is slower and leaves threads spinning."""

ROUNDING = 0.2
"""Largest error of the rounding over the error wanted."""

LARGEST = np.iinfo(np.int16).max
"""Whole number that the largest of each row becomes."""


@dataclass(frozen=True, eq=False)
class RoundedMatrix:
    """A complex matrix in half the memory of single precision: each row in 16-bit whole numbers times its own scale.

    Real and imaginary parts are in turn. A number is off by half a scale at most: 1.5e-5 of the
    row's largest.
    """

    numbers: Int16[np.ndarray, "rows columns 2"]
    scales: Float32[np.ndarray, "rows"]

    __repr__ = in_short

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.numbers.shape[0], self.numbers.shape[1]

    @property
    def dtype(self) -> np.dtype:
        """Precision of its products."""
        return np.dtype(np.complex64)

    def as_complex(self) -> Complex[np.ndarray, "rows columns"]:
        """Return the matrix in single precision."""
        return (self.numbers * self.scales[:, None, None]).view(np.complex64)[..., 0]


Matrix = Complex[np.ndarray, "_ _"] | RoundedMatrix


def rounded(matrix: Complex[np.ndarray, "rows columns"], wanted: float) -> Matrix:
    """Return a matrix in single precision as a rounded one, or as it is where the relative error wanted forbids it."""
    if matrix.dtype != np.complex64:
        return matrix
    parts = np.ascontiguousarray(matrix).view(np.float32).reshape(*matrix.shape, 2)
    scales = np.abs(parts).max(axis=(1, 2), initial=0.0) / np.float32(LARGEST)
    scales[scales < np.finfo(np.float32).tiny] = 1.0
    found = RoundedMatrix(np.rint(parts / scales[:, None, None]).astype(np.int16), scales)
    off = np.linalg.norm(found.as_complex() - matrix)
    return found if off <= ROUNDING * wanted * np.linalg.norm(matrix) else matrix


def product(
    matrix: Matrix, vectors: Num[np.ndarray, "vectors inner"], transposed: bool = False
) -> Complex[np.ndarray, "vectors outer"]:
    """Multiply a matrix, or its transpose, by vectors, which are rows here; in the precision of the matrix."""
    if len(vectors) > FEW:
        whole = matrix.as_complex() if isinstance(matrix, RoundedMatrix) else matrix
        return vectors.astype(whole.dtype, copy=False) @ (whole if transposed else whole.T)
    vectors = np.ascontiguousarray(vectors, dtype=matrix.dtype)
    out = np.empty((len(vectors), matrix.shape[int(transposed)]), dtype=matrix.dtype)
    if isinstance(matrix, RoundedMatrix):
        _kernels.few_rounded_products(matrix.numbers, matrix.scales, vectors, transposed, out)
    else:
        loop_for("few_products", matrix.dtype)(matrix, vectors, transposed, out)
    return out
