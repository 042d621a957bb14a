"""A matrix of blocks of 32 panels: near blocks stored in full, far blocks as low-rank products.

The panels are sorted so that those of a block are close together. The interaction between
distant blocks is smooth, so a few terms (column vector times row vector) approximate the matrix
between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Complex, Complex128, Float64, Int64, Shaped

from airtact import _kernels
from airtact.acoustics.solvers.shared import GmresResult, NearLists, available_memory, gmres
from airtact.errors import InvalidInput

# Number of panels in a block; each has six unknowns.
PANELS = _kernels.lanes // 6

# Number format of a matrix in memory. bfloat16 is the upper half of a float32, accurate to 0.2 %.
Store = Literal["bfloat16", "float32", "float64"]

# Free memory is not checked for matrices up to this size [bytes].
ALWAYS_FREE = 2**26


class BlockPairs(_kernels.Pairs):
    """Selected blocks of a matrix, in compressed-row form.

    The selected blocks of row block t are in the column blocks ``column[first[t]:first[t + 1]]``.
    """

    @classmethod
    def of(cls, chosen: Bool[np.ndarray, "blocks blocks"]) -> "BlockPairs":
        """Return the blocks for which a mask is True."""
        first = np.concatenate([[0], np.cumsum(chosen.sum(axis=1))])
        return cls(first.astype(np.int64), np.nonzero(chosen)[1].astype(np.int64))

    @property
    def row(self) -> Int64[np.ndarray, "pairs"]:
        """Row of each selected block, counted in blocks."""
        return np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))


def blocks_of(unknowns: int) -> int:
    """Return the number of blocks along one side of the matrix."""
    return -(-unknowns // _kernels.lanes)


def block_order(centres: Float64[np.ndarray, "panels 3"]) -> Int64[np.ndarray, "panels"]:
    """Return an order of the panels in which the panels of each block are adjacent.

    The set of panels is bisected repeatedly, each time across its longest dimension. Rigid motions
    of the bodies do not change the blocks.
    """
    return _kernels.block_order(centres, PANELS)


def near_blocks(panels: int, *lists: NearLists) -> Bool[np.ndarray, "blocks blocks"]:
    """Return a mask of the block pairs in which a point of one block is near a panel of the other.

    Each of the ``lists`` contains the near panels of one set of points. The points of a set are
    ordered by panel, and every panel has the same number of points.
    """
    blocks = -(-panels // PANELS)
    near = np.zeros((blocks, blocks), dtype=bool)
    for first, panel in lists:
        points = (len(first) - 1) // panels * PANELS
        _kernels.mark_blocks(first, panel, points, PANELS, near)
    return near


@dataclass(frozen=True, eq=False)
class BlockMatrix:
    """A square complex matrix, divided into blocks of ``_kernels.lanes`` rows and columns.

    Attributes
    ----------
    count : number of unknowns.
    whole : the blocks that are stored in full.
    blocks : rows of the blocks that are stored in full. Each row consists of its real parts
        followed by its imaginary parts, padded with zeros. Each array entry contains one number, or
        two numbers if the format is bfloat16.
    far : the blocks that are sums of low-rank terms. Block i has ``ranks[i]`` terms, whose factors
        start at ``begin[i]``: first those along the block's columns, then those along its rows.
    factors : the factors of the low-rank terms, in the number format of ``blocks``.
    """

    count: int
    whole: BlockPairs
    blocks: Shaped[np.ndarray, "pairs lanes 2 words"]
    far: _kernels.FarBlocks
    factors: Shaped[np.ndarray, "factors 2 words"]

    @classmethod
    def empty(
        cls, count: int, store: Store, whole: Bool[np.ndarray, "blocks blocks"], room: int = 0
    ) -> "BlockMatrix":
        """Allocate a matrix with some full blocks, and space for ``room`` low-rank factors."""
        lanes = _kernels.lanes
        word = np.dtype(np.uint32 if store == "bfloat16" else store)
        words = _words(store)
        pairs = BlockPairs.of(whole)
        far_pairs = BlockPairs.of(~whole)
        rows = len(pairs.column) * lanes
        # A processor reads 64 bytes at a time, so rows aligned to 64 bytes need fewer reads.
        size = (rows + room) * 2 * words
        line = 64 // word.itemsize
        numbers = np.empty(size + line, dtype=word)
        begin_of_line = -numbers.ctypes.data % 64 // word.itemsize
        numbers = numbers[begin_of_line : begin_of_line + size]
        unfilled = np.zeros((2, len(far_pairs.column)), dtype=np.int64)
        return cls(
            count=count,
            whole=pairs,
            blocks=numbers[: rows * 2 * words].reshape(-1, lanes, 2, words),
            far=_kernels.FarBlocks(far_pairs.first, far_pairs.column, *unfilled),
            factors=numbers[rows * 2 * words :].reshape(-1, 2, words),
        )

    @property
    def precision(self) -> type[np.complexfloating]:
        """Type of the products: complex64 or complex128."""
        return np.complex128 if self.blocks.dtype == np.float64 else np.complex64

    def times(
        self, vectors: Complex[np.ndarray, "columns nodes"], transposed: bool = False
    ) -> Complex[np.ndarray, "columns nodes"]:
        """Multiply the matrix, or its transpose, by row vectors, reading its entries only once."""
        vectors = np.ascontiguousarray(vectors, dtype=self.precision)
        return _kernels.dual_product(
            self.whole, self.blocks, self.far, self.factors, vectors, transposed
        )

    @cached_property
    def _inverses(self) -> Complex[np.ndarray, "blocks half half"]:
        """Inverses of the blocks of ``lanes``/2 unknowns on the diagonal, padded with ones."""
        half = _kernels.lanes // 2
        rows = self.blocks[self.whole.row == self.whole.column]
        if rows.dtype == np.uint32:
            # The lower 16 bits of each word are a number of the row's first half, the upper ones
            # of its second half.
            parts = (rows[:, :half] << 16, rows[:, half:] & np.uint32(0xFFFF0000))
            parts = [part.view(np.float32) for part in parts]
        else:
            parts = [rows[:, :half, :, :half], rows[:, half:, :, half:]]
        numbers = np.stack(parts, axis=1).reshape(-1, half, 2, half)
        diagonal = np.empty((len(numbers), half, half), dtype=self.precision)
        diagonal.real = numbers[:, :, 0]
        diagonal.imag = numbers[:, :, 1]
        # Rows after the last unknown are not filled.
        for block in range(self.count // half, len(diagonal)):
            used = max(self.count - block * half, 0)
            diagonal[block, used:] = np.eye(half)[used:]
        _kernels.invert_blocks(diagonal)
        return diagonal

    def preconditioned(
        self, vectors: Complex[np.ndarray, "columns nodes"], transposed: bool = False
    ) -> Complex[np.ndarray, "columns nodes"]:
        """Multiply the inverse of the diagonal blocks, or its transpose, by row vectors."""
        inverses = self._inverses
        padded = np.zeros((len(vectors), inverses.shape[0] * inverses.shape[1]), self.precision)
        padded[:, : self.count] = vectors
        # Row vectors times a matrix are the product of its transpose.
        if not transposed:
            inverses = inverses.transpose(0, 2, 1)
        by_block = padded.reshape(len(vectors), len(inverses), -1).transpose(1, 0, 2)
        product = (by_block @ inverses).transpose(1, 0, 2).reshape(padded.shape)
        return product[:, : self.count]

    def dense(self) -> Complex[np.ndarray, "nodes nodes"]:
        """Return the matrix as one dense array; low-rank blocks and bfloat16 are not supported."""
        lanes = _kernels.lanes
        out = np.empty((self.count, self.count), dtype=self.precision, order="F")  # for LAPACK
        rows = lanes * self.whole.row
        for block, row, column in zip(self.blocks, rows, lanes * self.whole.column, strict=True):
            part = out[row : row + lanes, column : column + lanes]
            part.real = block[: len(part), 0, : part.shape[1]]
            part.imag = block[: len(part), 1, : part.shape[1]]
        return out


def iterate(
    matrices: Sequence[BlockMatrix],
    right_sides: Complex[np.ndarray, "sides unknowns"],
    transposed: bool,
    tolerance: float,
    preconditioned: bool = True,
    **options: Any,
) -> GmresResult:
    """Solve, by GMRES, a linear system whose matrix is the sum of ``matrices``, or its transpose.

    If ``preconditioned``, the inverses of the first matrix's diagonal blocks precondition the
    system. GMRES then needs a third fewer iterations, and its solution is several times as accurate
    at the same residual, especially where panels are close to each other. The options are those of
    ``gmres``.
    """

    def product(vectors: Complex[np.ndarray, "sides unknowns"]) -> np.ndarray:
        if preconditioned:
            vectors = matrices[0].preconditioned(vectors, transposed)
        total = matrices[0].times(vectors, transposed)
        for matrix in matrices[1:]:
            total += matrix.times(vectors, transposed)
        return total

    result = gmres(product, right_sides, tolerance, **options)
    if not preconditioned:
        return result
    return replace(result, solution=matrices[0].preconditioned(result.solution, transposed))


def _words(store: Store) -> int:
    return _kernels.lanes // 2 if store == "bfloat16" else _kernels.lanes


def check_memory(count: int, store: Store, blocks: int, factors: int = 0) -> None:
    """Raise an error if a matrix of full blocks and low-rank factors does not fit into memory."""
    itemsize = 8 if store == "float64" else 4
    size = (blocks * _kernels.lanes + factors) * 2 * _words(store) * itemsize
    if size > ALWAYS_FREE and size > 0.9 * (available := available_memory()):
        raise InvalidInput(
            f"{count} unknowns need {size / 2**30:.1f} GiB for the matrix, but only "
            f"{available / 2**30:.1f} GiB of memory are free. Use a coarser accuracy or remove "
            "distant bodies.",
            code="too_little_memory",
        )


def worth_eliminating(unknowns: int, excitations: int) -> bool:
    """Return whether Gaussian elimination is faster than GMRES.

    Elimination is faster if there are at least 0.05 right-hand sides per unknown, because the
    vectors of GMRES then no longer fit into the processor's caches. This was measured with 2,000 to
    5,000 unknowns, at accuracies from 0.02 to 0.005. At 16,000 unknowns the matrix takes 2 GiB in
    single precision.
    """
    return excitations >= 0.05 * unknowns and unknowns <= 16_000


def eliminate(
    matrices: Sequence[BlockMatrix],
    right: Complex128[np.ndarray, "nodes excitations"],
    transposed: bool,
) -> GmresResult:
    """Solve, by Gaussian elimination, a linear system whose matrix is the sum of ``matrices``.

    The matrices must not contain low-rank blocks. Only the residual for the sum of all right-hand
    sides is computed, because this takes a single product with the matrix.
    """
    from scipy import linalg  # importing it takes 0.2 s

    total: Complex[np.ndarray, "nodes nodes"] = matrices[0].dense()
    for matrix in matrices[1:]:
        total += matrix.dense()
    # The factorisation is in place because the matrix is the largest object of a solve.
    factors = linalg.lu_factor(total, overwrite_a=True, check_finite=False)
    right_sides = right.astype(total.dtype)
    solution = linalg.lu_solve(factors, right_sides, trans=int(transposed), check_finite=False)
    # A single product checks all right-hand sides together.
    summed = np.ascontiguousarray(solution.sum(axis=1)[None])
    product = sum(matrix.times(summed, transposed)[0] for matrix in matrices)
    expected = right.sum(axis=1)
    residual = float(np.linalg.norm(product - expected))
    residual /= max(float(np.linalg.norm(expected)), 1e-300)
    return GmresResult(np.ascontiguousarray(solution.T), np.full(right.shape[1], residual), 0)
