"""GMRES for several right-hand sides at once: one pass over the matrix an iteration serves them all.

Each keeps its own Krylov space, as in Saad & Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856; scipy's own
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
    solution : (S, M) one row a right-hand side.
    residuals : (S,) relative residual of each.
    iterations : passes over the matrix.
    """

    solution: Complex[np.ndarray, "sides unknowns"]
    residuals: Float64[np.ndarray, "sides"]
    iterations: int


def gmres(
    product: Callable[[np.ndarray], np.ndarray],
    right_sides: Complex[np.ndarray, "sides unknowns"],
    tolerance: float,
    most_iterations: int = 120,
) -> GmresResult:
    """Solve A x = b for several b.

    Parameters
    ----------
    product : A v for each row v of (S, M).
    right_sides : (S, M); its precision is the working precision.
    tolerance : relative residual at which the slowest may stop.

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
    sides, unknowns = right_sides.shape
    norms = np.linalg.norm(right_sides, axis=1)
    scale = np.where(norms > 0, norms, 1).astype(norms.dtype)[:, None]
    basis = np.empty((sides, most_iterations + 1, unknowns), dtype=right_sides.dtype)
    basis[:, 0] = right_sides / scale
    hessenberg = np.zeros((sides, most_iterations + 1, most_iterations), dtype=np.complex128)
    residuals = np.ones(sides)
    for step in range(most_iterations):
        grown, so_far = product(basis[:, step]), basis[:, : step + 1]
        for _ in range(2):  # a second sweep keeps float32 bases orthogonal
            # einsum, not matmul: BLAS threads go on spinning and would take a core from the next product
            overlap = np.einsum("skm,sm->sk", so_far, grown.conj()).conj()
            grown = grown - np.einsum("sk,skm->sm", overlap, so_far)
            hessenberg[:, : step + 1, step] += overlap
        length = np.linalg.norm(grown, axis=1)
        hessenberg[:, step + 1, step] = length
        basis[:, step + 1] = grown / np.where(length > 0, length, 1).astype(length.dtype)[:, None]
        weights, residuals = _least_squares(hessenberg[:, : step + 2, : step + 1])
        residuals = np.where(norms > 0, residuals, 0)
        if residuals.max(initial=0) < tolerance:
            solution = np.einsum("sk,skm->sm", weights.astype(right_sides.dtype), so_far)
            return GmresResult(solution * scale, residuals, step + 1)
    raise NotConverged(
        f"GMRES stopped at a relative residual of {residuals.max():.1e} (wanted {tolerance:.0e}) after "
        f"{most_iterations} iterations; likely a gap or a body is much thinner than a panel: ask for a finer accuracy, "
        "or move the bodies apart."
    )


def _least_squares(
    hessenberg: Complex[np.ndarray, "sides rows steps"],
) -> tuple[Complex[np.ndarray, "sides steps"], Float64[np.ndarray, "sides"]]:
    """Minimise |e₁ − H y| for every side; gives y and the residual."""
    weights = np.linalg.pinv(hessenberg)[:, :, 0]
    left = -np.einsum("srk,sk->sr", hessenberg, weights)
    left[:, 0] += 1
    return weights, np.linalg.norm(left, axis=1)
