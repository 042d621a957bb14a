"""GMRES for several right-hand sides at once: one pass over the matrix an iteration serves them all.

Each column keeps its own Krylov space, as in Saad & Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856; scipy's own
solver takes one right-hand side, and reading the matrix is where all the time goes.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float64

from airtact.conventions import NotConverged


@dataclass(frozen=True, eq=False)
class GmresResult:
    """Solutions of a linear system.

    Attributes
    ----------
    solution : (M, S) one column a right-hand side.
    residuals : (S,) relative residual of each column.
    iterations : passes over the matrix.
    """

    solution: Complex[np.ndarray, "unknowns columns"]
    residuals: Float64[np.ndarray, "columns"]
    iterations: int


def gmres(
    product: Callable[[np.ndarray], np.ndarray],
    right_sides: Complex[np.ndarray, "unknowns columns"],
    tolerance: float,
    most_iterations: int = 120,
) -> GmresResult:
    """Solve A x = b for every column of b.

    Parameters
    ----------
    product : v (M, S) -> A v.
    right_sides : (M, S); its precision is the working precision.
    tolerance : relative residual at which the slowest column may stop.

    Raises
    ------
    NotConverged
        The tolerance was not reached in ``most_iterations``, or the right-hand sides are not finite.
    """
    if not np.isfinite(right_sides).all():
        raise NotConverged(
            f"{np.count_nonzero(~np.isfinite(right_sides))} of {right_sides.size} numbers of the right-hand sides are "
            "NaN or infinite before the 1st iteration; are the sources' strengths beyond the range of float32?"
        )
    unknowns, columns = right_sides.shape
    norms = np.linalg.norm(right_sides, axis=0)
    scale = np.where(norms > 0, norms, 1)
    basis = [np.ascontiguousarray((right_sides / scale).T)]
    hessenberg = np.zeros((columns, most_iterations + 1, most_iterations), dtype=np.complex128)
    residuals = np.ones(columns)
    for step in range(most_iterations):
        grown = product(basis[step].T).T
        for _ in range(2):  # a second sweep keeps float32 bases orthogonal
            for i, vector in enumerate(basis):
                overlap = np.einsum("sm,sm->s", vector.conj(), grown)
                grown = grown - overlap[:, None].astype(grown.dtype) * vector
                hessenberg[:, i, step] += overlap
        length = np.linalg.norm(grown, axis=1)
        hessenberg[:, step + 1, step] = length
        basis.append((grown / np.where(length > 0, length, 1)[:, None]).astype(grown.dtype))
        weights, residuals = _least_squares(hessenberg[:, : step + 2, : step + 1])
        residuals = np.where(norms > 0, residuals, 0)
        if residuals.max(initial=0) < tolerance:
            solution = np.zeros((columns, unknowns), dtype=right_sides.dtype)
            for i, vector in enumerate(basis[:-1]):
                solution += weights[:, i, None].astype(right_sides.dtype) * vector
            return GmresResult((solution * scale[:, None].astype(solution.dtype)).T, residuals, step + 1)
    raise NotConverged(
        f"GMRES stopped at a relative residual of {residuals.max():.1e} (wanted {tolerance:.0e}) after "
        f"{most_iterations} iterations; likely a gap or a body is much thinner than a panel: ask for a finer accuracy, "
        "or move the bodies apart."
    )


def _least_squares(
    hessenberg: Complex[np.ndarray, "columns rows steps"],
) -> tuple[Complex[np.ndarray, "columns steps"], Float64[np.ndarray, "columns"]]:
    """Minimise |e₁ − H y| for every column; gives y and the residual."""
    weights, residuals = [], []
    first = np.zeros(hessenberg.shape[1])
    first[0] = 1
    for matrix in hessenberg:
        weight = np.linalg.lstsq(matrix, first, rcond=None)[0]
        weights.append(weight)
        residuals.append(float(np.linalg.norm(first - matrix @ weight)))
    return np.array(weights), np.array(residuals)
