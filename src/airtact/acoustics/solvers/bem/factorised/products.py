"""Dense matrices times a few vectors, which takes as long as reading the matrix from memory."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float32, Int16, Num

from airtact import _kernels
from airtact.printing import in_short

# Vectors up to which a compiled loop multiplies: BLAS is slower and leaves threads spinning
FEW = 8


@dataclass(frozen=True, eq=False)
class RoundedMatrix:
    """A complex matrix in half the memory of single precision.

    Each row is 16-bit integers (real and imaginary parts in turn) times its own scale. A number is
    off by half a scale at most: 1.5e-5 of the row's largest.
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
    """Round a single-precision matrix, if that costs at most a fifth of the error wanted."""
    if matrix.dtype != np.complex64:
        return matrix
    parts = np.ascontiguousarray(matrix).view(np.float32).reshape(*matrix.shape, 2)
    scales = np.abs(parts).max(axis=(1, 2), initial=0.0) / np.float32(np.iinfo(np.int16).max)
    scales[scales < np.finfo(np.float32).tiny] = 1.0
    candidate = RoundedMatrix(np.rint(parts / scales[:, None, None]).astype(np.int16), scales)
    off = np.linalg.norm(candidate.as_complex() - matrix)
    return candidate if off <= 0.2 * wanted * np.linalg.norm(matrix) else matrix


def product(
    matrix: Matrix, vectors: Num[np.ndarray, "vectors inner"], transposed: bool = False
) -> Complex[np.ndarray, "vectors outer"]:
    """Multiply a matrix, or its transpose, by row vectors, in the matrix's precision."""
    if len(vectors) > FEW:
        full = matrix.as_complex() if isinstance(matrix, RoundedMatrix) else matrix
        return vectors.astype(full.dtype, copy=False) @ (full if transposed else full.T)
    vectors = np.ascontiguousarray(vectors, dtype=matrix.dtype)
    if isinstance(matrix, RoundedMatrix):
        return _kernels.few_rounded_products(matrix.numbers, matrix.scales, vectors, transposed)
    return _kernels.few_products(matrix, vectors, transposed)
