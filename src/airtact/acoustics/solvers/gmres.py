"""GMRES for several right-hand sides at once: each iteration passes over the matrix once for all of them.

Each right-hand side has its own Krylov space, as in Saad & Schultz, SIAM J. Sci. Stat. Comput. 7
(1986) 856. SciPy's solver takes one right-hand side, and most of the time goes into reading the
matrix.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Complex128, Float64

from airtact.acoustics.solvers.loops import loop_for
from airtact.errors import NotConverged

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

    ``product`` returns A v for each row v of (S, M); ``tolerance`` is the relative residual that
    all must reach, or ``NotConverged`` is raised, as where the right-hand sides are not finite.
    Where A is ill-conditioned, as sound in a cavity makes it, a small residual leaves a large
    error: beyond ``ORDINARY`` times the residual, iterations go on until the relative error is at
    most about ``error``, or to the last one.
    """
    if not np.isfinite(right_sides).all():
        raise NotConverged(
            f"{np.count_nonzero(~np.isfinite(right_sides))} of {right_sides.size} numbers of the right-hand sides are "
            "NaN or infinite before the 1st iteration; are the sources' strengths beyond the range of float32?",
            code="not_finite",
        )
    sides, unknowns = right_sides.shape
    norms = np.linalg.norm(
        right_sides.astype(np.complex128), axis=1
    )  # squares may leave the range of single precision
    real = np.float32 if right_sides.dtype == np.complex64 else np.float64
    scale = np.where(norms > 0, norms, 1).astype(real)[:, None]
    basis = np.empty((min(most_iterations, ROOM_FOR) + 1, sides, unknowns), dtype=right_sides.dtype)
    basis[0] = right_sides / scale
    spaces = _Spaces.begun(norms > 0, most_iterations)
    step_of, residuals = loop_for("krylov_step", basis.dtype), np.ones(sides)
    for step in range(most_iterations):
        if step + 1 == len(basis):
            basis = np.concatenate([basis, np.empty_like(basis)])
        basis[step + 1] = product(basis[step])
        step_of(basis[: step + 2], *spaces)
        residuals = np.abs(spaces.right[:, step + 1])
        if not (residuals < tolerance).all():  # NaN is never small
            continue
        weights = spaces.weights[:, : step + 1]
        if step + 1 == most_iterations or _settled(spaces, step + 1, residuals, error):
            return GmresResult(_sum(weights, basis) * scale, residuals, step + 1)
    raise NotConverged(
        f"GMRES stopped at a relative residual of {np.max(residuals):.1e} (wanted {tolerance:.0e}) after "
        f"{most_iterations} iterations; likely a gap or a body is much thinner than a panel: ask for a smaller "
        "accuracy, or move the bodies apart.",
        code="not_converged",
    )


class _Spaces(NamedTuple):
    """What the steps so far have made of each right-hand side, as ``Krylov`` in ``src/kernels/kernels.hpp`` says."""

    rotations: Complex128[np.ndarray, "sides most 2"]
    right: Complex128[np.ndarray, "sides one_more"]
    triangles: Complex128[np.ndarray, "sides packed"]
    inverses: Complex128[np.ndarray, "sides packed"]
    weights: Complex128[np.ndarray, "sides most"]
    squares: Float64[np.ndarray, "sides"]

    @classmethod
    def begun(cls, some: Bool[np.ndarray, "sides"], most: int) -> "_Spaces":
        """Begin ``most`` steps at most for right-hand sides, of which some are not zero."""
        sides = len(some)
        made = cls(
            np.empty((sides, most, 2), dtype=np.complex128),
            np.empty((sides, most + 1), dtype=np.complex128),
            np.empty((sides, most * (most + 1) // 2), dtype=np.complex128),
            np.empty((sides, most * (most + 1) // 2), dtype=np.complex128),
            np.empty((sides, most), dtype=np.complex128),
            np.zeros(sides),
        )
        made.right[:, 0] = some
        return made


def _settled(
    spaces: _Spaces, steps: int, residuals: Float64[np.ndarray, "sides"], error: float
) -> bool:
    """Whether all solutions are right to about ``error``, or to ``ORDINARY`` times the residual.

    The relative error is at most the residual over the least singular value of A; that of the
    triangle stands for it, or one over the length of its inverse, which is quicker and never
    larger.
    """
    if math.isinf(error):
        return True
    size = np.linalg.norm(spaces.weights[:, :steps], axis=1)
    if _small(
        residuals, size / np.sqrt(np.where(spaces.squares > 0, spaces.squares, np.inf)), error
    ):
        return True
    triangles, (column, row) = (
        np.zeros((len(size), steps, steps), dtype=np.complex128),
        np.tril_indices(steps),
    )
    triangles[:, row, column] = spaces.triangles[:, : len(row)]
    return _small(residuals, np.linalg.svd(triangles, compute_uv=False)[:, -1] * size, error)


def _small(
    residuals: Float64[np.ndarray, "sides"], size: Float64[np.ndarray, "sides"], error: float
) -> bool:
    return bool(((residuals <= error * size) | (ORDINARY * size >= 1.0)).all())


def _sum(
    weights: Complex128[np.ndarray, "sides steps"],
    basis: Complex[np.ndarray, "room sides unknowns"],
) -> Complex[np.ndarray, "sides unknowns"]:
    total = np.zeros_like(basis[0])
    for weight, vectors in zip(weights.T.astype(basis.dtype), basis, strict=False):
        total += weight[:, None] * vectors
    return total
