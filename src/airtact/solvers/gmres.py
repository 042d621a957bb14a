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
    fits, residuals = [_Rotated() for _ in range(sides)], [1.0] * sides
    orthonormalise = loop_for("orthonormalise", basis.dtype)
    for step in range(most_iterations):
        grown = np.ascontiguousarray(product(basis[step]), dtype=basis.dtype)
        columns = np.empty((sides, step + 2), dtype=np.complex128)
        orthonormalise(basis[: step + 1], grown, columns)
        if step + 1 == len(basis):
            basis = np.concatenate([basis, np.empty_like(basis)])
        basis[step + 1] = grown
        for fit, column in zip(fits, columns.tolist(), strict=True):
            fit.add(column)
        residuals = [fit.residual if norm > 0 else 0.0 for fit, norm in zip(fits, norms, strict=True)]
        last = step == most_iterations - 1
        if not all(residual < tolerance for residual in residuals):  # NaN is never small
            continue
        weights = [fit.weights() for fit in fits]
        if last or all(fit.settled(error, one) for fit, one in zip(fits, weights, strict=True)):
            solution = _sum(np.array(weights).reshape(sides, step + 1), basis)
            return GmresResult(solution * scale, np.array(residuals), step + 1)
    raise NotConverged(
        f"GMRES stopped at a relative residual of {np.max(residuals):.1e} (wanted {tolerance:.0e}) after "
        f"{most_iterations} iterations; likely a gap or a body is much thinner than a panel: ask for a smaller "
        "accuracy, or move the bodies apart.",
        code="gmres_stalled",
    )


class _Rotated:
    """Minimises |e₁ − H y| as H grows by a column a step, by Givens rotations (Saad & Schultz, section 3.2)."""

    def __init__(self) -> None:
        self._rotations: list[tuple[float, complex]] = []
        self._columns: list[list[complex]] = []
        self._right: list[complex] = [1.0]

    @property
    def residual(self) -> float:
        return abs(self._right[-1])

    def add(self, column: list[complex]) -> None:
        """Add a column of H, down to the entry below its diagonal."""
        for row, (cosine, sine) in enumerate(self._rotations):
            upper, lower = column[row], column[row + 1]
            column[row] = cosine * upper + sine * lower
            column[row + 1] = cosine * lower - sine.conjugate() * upper
        upper, lower = column[-2], column.pop()
        size = math.hypot(abs(upper), abs(lower))
        cosine = abs(upper) / size if size else 1.0
        sine = (upper / abs(upper) if upper else 1.0) * lower.conjugate() / size if size else 0j
        column[-1] = cosine * upper + sine * lower
        self._rotations.append((cosine, sine))
        self._columns.append(column)
        last = self._right[-1]
        self._right[-1:] = [cosine * last, -sine.conjugate() * last]

    def settled(self, error: float, weights: Complex128[np.ndarray, "steps"]) -> bool:
        """Whether the solution with these weights is right to about ``error``, or to ``ORDINARY`` times the residual.

        The relative error is at most the residual over the least singular value of A; that of H stands for it.
        """
        if math.isinf(error):
            return True
        least = float(np.linalg.svd(self._triangle(), compute_uv=False)[-1])
        size = least * float(np.linalg.norm(weights))
        return self.residual <= error * size or ORDINARY * size >= 1.0

    def weights(self) -> Complex128[np.ndarray, "steps"]:
        """Solve the remaining triangular system; a zero on the diagonal gives 0."""
        triangle, right = self._triangle(), np.array(self._right[:-1])
        zero = np.flatnonzero(triangle.diagonal() == 0)
        triangle[zero, zero], right[zero] = 1.0, 0.0
        return np.linalg.solve(triangle, right)

    def _triangle(self) -> Complex128[np.ndarray, "steps steps"]:
        steps = len(self._columns)
        triangle = np.zeros((steps, steps), dtype=np.complex128)
        for index, column in enumerate(self._columns):
            triangle[: index + 1, index] = column
        return triangle


def _sum(
    weights: Complex128[np.ndarray, "sides steps"], basis: Complex[np.ndarray, "room sides unknowns"]
) -> Complex[np.ndarray, "sides unknowns"]:
    total = np.zeros_like(basis[0])
    for weight, vectors in zip(weights.T.astype(basis.dtype), basis, strict=False):
        total += weight[:, None] * vectors
    return total
