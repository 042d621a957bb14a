"""GMRES for several right-hand sides at once: each iteration passes over the matrix once for all of them.

Each right-hand side has its own Krylov space, as in Saad & Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856. SciPy's
solver takes one right-hand side, and most of the time goes into reading the matrix.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Complex128, Float64

from airtact.conventions import NotConverged
from airtact.solvers.loops import loop_for

ROOM_FOR = 15
"""Iterations that memory is allocated for at first: more than most solves take."""

ORDINARY = 3.0
"""Error of a solution over its relative residual, at most, of the equations of bodies without cavities: 1.3 to 2.7."""


@dataclass(frozen=True, eq=False)
class GmresResult:
    """Solutions of a linear system, the relative residual of each right-hand side, and the products with the matrix."""

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
    """Solve A x = b for several b, in the precision of the right-hand sides (S, M).

    ``product`` returns A v for each row v of (S, M); ``tolerance`` is the relative residual that all must reach, or
    ``NotConverged`` is raised, as where the right-hand sides are not finite. Where A is ill-conditioned, as sound in a
    cavity makes it, a small residual leaves a large error: beyond ``ORDINARY`` times the residual, iterations go on
    until the relative error is at most about ``error``, or to the last one.
    """
    if not np.isfinite(right_sides).all():
        raise NotConverged(
            f"{np.count_nonzero(~np.isfinite(right_sides))} of {right_sides.size} numbers of the right-hand sides are "
            "NaN or infinite before the 1st iteration; are the sources' strengths beyond the range of float32?",
            code="not_finite",
        )
    sides, unknowns = right_sides.shape
    norms = np.linalg.norm(right_sides, axis=1)
    scale = np.where(norms > 0, norms, 1).astype(norms.dtype)[:, None]
    basis = np.empty((min(most_iterations, ROOM_FOR) + 1, sides, unknowns), dtype=right_sides.dtype)
    basis[0] = right_sides / scale
    columns, rotations = [], np.empty((most_iterations, sides, 2), dtype=np.complex128)
    right = np.empty((sides, most_iterations + 1), dtype=np.complex128)
    right[:, 0] = norms > 0
    grow, residuals = loop_for("krylov_step", basis.dtype), np.ones(sides)
    for step in range(most_iterations):
        if step + 1 == len(basis):
            basis = np.concatenate([basis, np.empty_like(basis)])
        basis[step + 1] = product(basis[step])
        columns.append(np.empty((sides, step + 2), dtype=np.complex128))
        grow(basis[: step + 2], columns[step], rotations, right)
        residuals = np.abs(right[:, step + 1])
        if not (residuals < tolerance).all():  # NaN is never small
            continue
        triangles = _triangles(columns)
        weights = _weights(triangles, right[:, : step + 1])
        if step + 1 == most_iterations or _settled(triangles, weights, residuals, error):
            return GmresResult(_sum(weights, basis) * scale, residuals, step + 1)
    raise NotConverged(
        f"GMRES stopped at a relative residual of {np.max(residuals):.1e} (wanted {tolerance:.0e}) after "
        f"{most_iterations} iterations; likely a gap or a body is much thinner than a panel: ask for a smaller "
        "accuracy, or move the bodies apart.",
        code="gmres_stalled",
    )


def _triangles(columns: list[Complex128[np.ndarray, "sides _"]]) -> Complex128[np.ndarray, "sides steps steps"]:
    """Upper triangles from their columns, each with one number more than it has there."""
    triangles = np.zeros((len(columns[0]), len(columns), len(columns)), dtype=np.complex128)
    for index, column in enumerate(columns):
        triangles[:, : index + 1, index] = column[:, :-1]
    return triangles


def _weights(
    triangles: Complex128[np.ndarray, "sides steps steps"], right: Complex128[np.ndarray, "sides steps"]
) -> Complex128[np.ndarray, "sides steps"]:
    """Solve the triangular systems; a zero on the diagonal gives 0."""
    solvable, right = triangles.copy(), right.copy()
    side, step = np.nonzero(np.diagonal(triangles, axis1=1, axis2=2) == 0)
    solvable[side, step, step], right[side, step] = 1.0, 0.0
    return np.linalg.solve(solvable, right[:, :, None])[:, :, 0]


def _settled(
    triangles: Complex128[np.ndarray, "sides steps steps"],
    weights: Complex128[np.ndarray, "sides steps"],
    residuals: Float64[np.ndarray, "sides"],
    error: float,
) -> bool:
    """Whether all solutions with these weights are right to about ``error``, or to ``ORDINARY`` times the residual.

    The relative error is at most the residual over the least singular value of A; that of the triangle stands for it.
    """
    if math.isinf(error):
        return True
    size = np.linalg.svd(triangles, compute_uv=False)[:, -1] * np.linalg.norm(weights, axis=1)
    return bool(((residuals <= error * size) | (ORDINARY * size >= 1.0)).all())


def _sum(
    weights: Complex128[np.ndarray, "sides steps"], basis: Complex[np.ndarray, "room sides unknowns"]
) -> Complex[np.ndarray, "sides unknowns"]:
    total = np.zeros_like(basis[0])
    for weight, vectors in zip(weights.T.astype(basis.dtype), basis, strict=False):
        total += weight[:, None] * vectors
    return total
