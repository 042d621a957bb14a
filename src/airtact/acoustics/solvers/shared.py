"""Array types of the solvers, the open-air pressure of monopoles, and numerical helpers.

Axes with the same name in a signature have the same length.
"""

import os
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Complex, Complex128, Float, Float32, Float64, Int64, Real

from airtact import _kernels

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
PanelPoints = Float64[np.ndarray, "panels 3"]
PanelLengths = Float64[np.ndarray, "panels"]
Admittances = Complex128[np.ndarray, "panels"]
# ikρc/Z times the area of each node; empty if all bodies are sound-hard.
SingleLayer = Complex128[np.ndarray, "_"]
# Bounds of each point's panels in the list of panels, and that list.
NearLists = tuple[Int64[np.ndarray, "_"], Int64[np.ndarray, "_"]]


def differences(
    pressure: Callable[[Points], Pressures], points: Points, step: Lengths
) -> Gradients:
    """Return the gradient ∇p [Pa/m], by fourth-order central differences with a step [m].

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
) -> Pressures:
    """Return the open-air pressure Σ_j s_j e^{ikr}/r at points [Pa], in float32 or float64."""
    return _kernels.apply_monopoles(points, positions, strengths, complex(wavenumber), precision)


def chebyshev_weights(
    coordinates: Float[np.ndarray, "points"], count: int
) -> Float32[np.ndarray, "points count"]:
    """Return the weights of the points cos(π (j + 1/2)/count) for coordinates in [-1, 1].

    The barycentric formula follows J.-P. Berrut, L. N. Trefethen, SIAM Review 46 (2004) 501.
    """
    angles = np.pi * (np.arange(count) + 0.5) / count
    off = coordinates[:, None] - np.cos(angles).astype(coordinates.dtype)
    off[off == 0] = 1e-30
    weights = ((-1.0) ** np.arange(count) * np.sin(angles)).astype(coordinates.dtype) / off
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32, copy=False)


def available_memory() -> float:
    """Return the memory available without swapping [bytes]; infinity if it is not reported."""
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
