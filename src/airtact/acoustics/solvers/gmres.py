"""GMRES for several right-hand sides at once, with one matrix product per iteration.

Each right-hand side has its own Krylov space (Saad & Schultz, SIAM J. Sci. Stat. Comput. 7 (1986)
856). Most of the time is spent on reading the matrix, and SciPy's solver, which accepts only one
right-hand side, would read it once for each.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float64

from airtact import _kernels
from airtact.errors import NotConverged


@dataclass(frozen=True, eq=False)
class GmresResult:
    """Solutions of a linear system.

    Attributes
    ----------
    solution : solution for each right-hand side.
    residuals : relative residual of each solution.
    iterations : number of multiplications by the matrix; 0 for a direct solution.
    """

    solution: Complex[np.ndarray, "sides unknowns"]
    residuals: Float64[np.ndarray, "sides"]
    iterations: int


def gmres(
    product: Callable[[np.ndarray], np.ndarray],
    right_sides: Complex[np.ndarray, "sides unknowns"],
    tolerance: float,
    error: float = math.inf,
    most_iterations: int = 120,
) -> GmresResult:
    """Solve A x = b for several b, in the precision of the right-hand sides.

    Parameters
    ----------
    product : function that returns A v for each row v of an array (sides, unknowns).
    right_sides : the right-hand sides b, as rows.
    tolerance : relative residual that all right-hand sides must reach.
    error : approximate relative error of the solution at which the iteration stops. If A is
        ill-conditioned, as for sound in a cavity, this error is large even if the residual is
        small, and more iterations are made.
    most_iterations : largest number of iterations.

    Raises
    ------
    NotConverged
        If the tolerance was not reached, or if the right-hand sides are not finite.
    """
    finite = np.isfinite(right_sides)
    if not finite.all():
        raise NotConverged(
            f"{np.count_nonzero(~finite)} of {finite.size} values of the right-hand sides are NaN "
            "or infinite; are the sources' strengths beyond the range of float32?",
            code="not_finite",
        )
    sides, unknowns = right_sides.shape
    # Double precision is used because squares may leave the range of float32.
    norms = np.linalg.norm(right_sides.astype(np.complex128), axis=1)
    real = np.float32 if right_sides.dtype == np.complex64 else np.float64
    scale = np.where(norms > 0, norms, 1).astype(real)[:, None]
    room = min(most_iterations, 15) + 1  # most solves need fewer; the basis grows if needed
    basis = np.empty((room, sides, unknowns), dtype=right_sides.dtype)
    basis[0] = right_sides / scale
    packed = most_iterations * (most_iterations + 1) // 2
    spaces = _kernels.KrylovSpaces(
        rotations=np.empty((sides, most_iterations, 2), dtype=np.complex128),
        right=np.empty((sides, most_iterations + 1), dtype=np.complex128),
        triangles=np.empty((sides, packed), dtype=np.complex128),
        inverses=np.empty((sides, packed), dtype=np.complex128),
        weights=np.empty((sides, most_iterations), dtype=np.complex128),
        squares=np.zeros(sides),
    )
    spaces.right[:, 0] = norms > 0
    residuals = np.ones(sides)
    for step in range(1, most_iterations + 1):
        if step == len(basis):
            basis = np.concatenate([basis, np.empty_like(basis)])
        basis[step] = product(basis[step - 1])
        _kernels.krylov_step(basis[: step + 1], spaces)
        # Givens rotations leave the residual in the last entry.
        residuals = np.abs(spaces.right[:, step])
        if not (residuals < tolerance).all():  # NaN is never small
            continue
        if step == most_iterations or _settled(spaces, step, residuals, error):
            solution = np.zeros_like(basis[0])
            weights = spaces.weights[:, :step].T.astype(basis.dtype)
            for weight, vectors in zip(weights, basis[:step], strict=True):
                solution += weight[:, None] * vectors
            return GmresResult(solution * scale, residuals, step)
    raise NotConverged(
        f"GMRES reached a relative residual of {np.max(residuals):.1e} in {most_iterations} "
        f"iterations instead of {tolerance:.0e}: a gap or a body is probably much thinner than a "
        "panel. Use a smaller value of accuracy, or move the bodies apart.",
        code="not_converged",
    )


def _settled(
    spaces: _kernels.KrylovSpaces,
    steps: int,
    residuals: Float64[np.ndarray, "sides"],
    error: float,
) -> bool:
    """Return whether all errors are at most about ``error``, or A is well-conditioned.

    The relative error is at most the residual divided by the smallest singular value of A. GMRES's
    triangular matrix has about the same smallest singular value.
    """
    if math.isinf(error):
        return True
    column, row = np.tril_indices(steps)
    triangles = np.zeros((len(residuals), steps, steps), dtype=np.complex128)
    triangles[:, row, column] = spaces.triangles[:, : len(row)]
    smallest = np.linalg.svd(triangles, compute_uv=False)[:, -1]
    size = smallest * np.linalg.norm(spaces.weights[:, :steps], axis=1)
    # Without cavities the error is 1.3 to 2.7 times the residual, so ratios up to 3 count as
    # well-conditioned.
    return bool(((residuals <= error * size) | (3.0 * size >= 1.0)).all())
