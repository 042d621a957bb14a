"""Array types of the solvers, the open-air pressure of monopoles, GMRES, and numerical helpers.

Axes with the same name in a signature have the same length.

GMRES solves for several right-hand sides at once, with one matrix product per iteration. Each
right-hand side has its own Krylov space (Saad & Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856).
Most of the time is spent on reading the matrix, and SciPy's solver, which accepts only one
right-hand side, would read it once for each.
"""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Complex128, Float, Float32, Float64, Int64, Real

from airtact import _kernels
from airtact.errors import NotConverged

Points = Real[np.ndarray, "points 3"]
Vectors = Float64[np.ndarray, "points 3"]  # positions or directions
Mask = Bool[np.ndarray, "points"]
Indices = Int64[np.ndarray, "points"]
Lengths = Float64[np.ndarray, "points"]
# Barycentric coordinates of each point in its tetrahedron.
Barycentric = Float64[np.ndarray, "points 4"]
Pressures = Complex128[np.ndarray, "points excitations"]
Gradients = Complex128[np.ndarray, "points 3 excitations"]  # also velocities

SourcePoints = Real[np.ndarray, "sources 3"]
Strengths = Complex128[np.ndarray, "sources excitations"]
Coefficients = Complex128[np.ndarray, "unknowns excitations"]
# A number for each pair of point and source.
Pairs = Float64[np.ndarray, "points sources"]
ComplexPairs = Complex128[np.ndarray, "points sources"]

NodePoints = Float64[np.ndarray, "nodes 3"]  # also normals
NodeValues = Complex128[np.ndarray, "nodes excitations"]
# Second collocation points, each shared by three neighbouring nodes of a panel.
GroupPoints = Float64[np.ndarray, "groups 3"]
PanelLengths = Float64[np.ndarray, "panels"]
Admittances = Complex128[np.ndarray, "panels"]
# ikρc/Z times the area of each node; empty if all bodies are sound-hard.
SingleLayer = Complex128[np.ndarray, "_"]
# Bounds of each point's panels in the list of panels, and that list.
NearLists = tuple[Int64[np.ndarray, "_"], Int64[np.ndarray, "_"]]

# Numbers of sources and of receivers from which sums between clusters are faster than plain sums.
MIN_CLUSTERED = 4096


def differences(
    pressure: Callable[[Points], Pressures], points: Points, step: Lengths
) -> Gradients:
    """Return the gradient ∇p [Pa/m], by fourth-order central differences with ``step`` [m].

    The pressure must be defined up to two steps away on all sides.
    """
    stencil = ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12))
    gradient = []
    for axis in np.eye(3):
        shifted = [
            pressure(points + count * step[:, None] * axis) * weight for count, weight in stencil
        ]
        gradient.append(sum(shifted[1:], shifted[0]) / step[:, None])
    return np.stack(gradient, axis=1)


def monopole_pressure(
    points: Points,
    positions: SourcePoints,
    strengths: Complex[np.ndarray, "sources excitations"],
    wavenumber: complex,
    precision: str,
    error: float = 0.0,
) -> Pressures:
    """Return the open-air pressure Σ_j s_j e^{ikr}/r at points [Pa], in float32 or float64.

    In float32, sums over thousands of sources at thousands of points may have a relative error of
    about ``error``. They are then interpolated between distant clusters of points and sources.
    """
    if precision == "float32" and error > 0 and min(len(points), len(positions)) >= MIN_CLUSTERED:
        hard = np.empty(0, dtype=np.complex128)
        receivers = _kernels.Layer(np.ascontiguousarray(points), None, hard, complex(wavenumber))
        return _kernels.apply_distant(receivers, positions, strengths, error)
    return _kernels.apply_monopoles(points, positions, strengths, complex(wavenumber), precision)


def sphere_rule(
    order: int,
) -> tuple[Float64[np.ndarray, "latitudes longitudes 3"], Float64[np.ndarray, "latitudes"]]:
    """Return directions and weights of a quadrature on the unit sphere.

    Gauss-Legendre latitudes and equally spaced longitudes integrate products of two spherical
    harmonics of order up to ``order`` exactly. Each latitude has one weight, which applies to all
    directions on it.
    """
    cosines, weights = np.polynomial.legendre.leggauss(order + 1)
    azimuth = 2.0 * np.pi * np.arange(2 * order + 1) / (2 * order + 1)
    sines = np.sqrt(1.0 - cosines**2)[:, None]
    x = sines * np.cos(azimuth)
    directions = np.stack(
        [x, sines * np.sin(azimuth), np.broadcast_to(cosines[:, None], x.shape)], axis=-1
    )
    return directions, weights * 2.0 * np.pi / (2 * order + 1)


def chebyshev_weights(
    coordinates: Float[np.ndarray, "points"], count: int
) -> Float32[np.ndarray, "points count"]:
    """Return the weights that interpolate from points cos(π (j + 1/2)/count) to coordinates.

    The coordinates are in [-1, 1]. The barycentric formula follows J.-P. Berrut, L. N. Trefethen,
    SIAM Review 46 (2004) 501.
    """
    angles = np.pi * (np.arange(count) + 0.5) / count
    off = coordinates[:, None] - np.cos(angles).astype(coordinates.dtype)
    off[off == 0] = 1e-30
    weights = ((-1.0) ** np.arange(count) * np.sin(angles)).astype(coordinates.dtype) / off
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32, copy=False)


def available_memory() -> float:
    """Return the memory available without swapping [bytes], or infinity if it is unknown."""
    try:
        # Unbuffered for speed, because this file is read before every solve.
        with open("/proc/meminfo", "rb", buffering=0) as file:
            _, mark, rest = (file.read(4096) or b"").partition(b"MemAvailable:")
    except OSError:
        return float("inf")
    return 1024.0 * int(rest.split(maxsplit=1)[0]) if mark else float("inf")


def processor_count() -> int:
    """Return the number of processors available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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
    """Solve A x = b for several vectors b, in the precision of the right-hand sides.

    Parameters
    ----------
    product : function that returns A v for each row v of an array (right-hand sides, unknowns).
    right_sides : the right-hand sides b, as rows.
    tolerance : relative residual that all right-hand sides must reach.
    error : approximate relative error of the solution at which the iteration stops. If A is
        ill-conditioned, as for sound in a cavity, the error can be large although the residual is
        small; the iteration then continues.
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
