"""Solving by Gaussian elimination, which beats iterations where there are hundreds of right-hand sides."""

from collections.abc import Sequence

import numpy as np
import scipy.linalg
from jaxtyping import Complex, Complex128

from airtact.acoustics.solvers.bem.blocks import blocks_of
from airtact.acoustics.solvers.bem.operator import DualMatrix, check_memory
from airtact.acoustics.solvers.gmres import GmresResult

SIDES = 0.05
"""Right-hand sides over unknowns from which on elimination is quicker, measured with 2,000 to 5,000 unknowns at
accuracies from 0.02 to 0.005: what iterations hold for all sides at once is then far larger than a
cache."""

MOST_UNKNOWNS = 16_000
"""Unknowns up to which it is taken: 2 GiB for the matrix in single precision."""

COPIES = 2
"""Matrices in memory at once: in blocks, and in one piece to be overwritten by its factors."""


def worth_eliminating(unknowns: int, sides: int) -> bool:
    """Whether elimination is quicker than iterations."""
    return sides >= SIDES * unknowns and unknowns <= MOST_UNKNOWNS


def check_elimination(unknowns: int, precision: str) -> None:
    """Raise where the matrix and its factors do not fit into memory."""
    check_memory(
        unknowns,
        "float64" if precision == "float64" else "float32",
        COPIES * blocks_of(unknowns) ** 2,
        0,
    )


def eliminate(
    matrices: Sequence[DualMatrix], right: Complex128[np.ndarray, "nodes sounds"], transposed: bool
) -> GmresResult:
    """Solve with the sum of matrices without low-rank blocks.

    All residuals are that of the sum of the right-hand sides, which one product with the matrix
    gives.
    """
    whole: Complex[np.ndarray, "nodes nodes"] = matrices[0].dense()
    for one in matrices[1:]:
        whole += one.dense()
    factors = scipy.linalg.lu_factor(whole, overwrite_a=True, check_finite=False)
    sides = right.astype(whole.dtype)
    solved = scipy.linalg.lu_solve(factors, sides, trans=int(transposed), check_finite=False)
    total = np.ascontiguousarray(solved.sum(axis=1)[None])
    back = sum(one.times(total, transposed)[0] for one in matrices)
    wanted = right.sum(axis=1)
    residual = float(np.linalg.norm(back - wanted)) / max(float(np.linalg.norm(wanted)), 1e-300)
    return GmresResult(np.ascontiguousarray(solved.T), np.full(sides.shape[1], residual), 0)
