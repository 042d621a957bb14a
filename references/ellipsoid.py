"""Sound-hard ellipsoids by fundamental solutions: independent of every solver in src.

Monopoles inside, fitted by least squares to ∂p/∂n = 0 (see ``references.capsules``). They stand on
the normals of the skin at a share of the smaller radius of curvature, and the own error is the
change against a coarser fit.
"""

import numpy as np

from references.fundamental_solutions import least_squares, normal_derivatives, waves

DEPTH = 0.55
"""Depth of the monopoles over the smaller radius of curvature."""


def surface_points(
    axes: np.ndarray, number: int, start: float = 0.5
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Spread points over an ellipsoid, with normals and the smaller radius of curvature there."""
    height = 2 * (np.arange(number) + start) / number - 1
    azimuth = np.pi * (3 - np.sqrt(5)) * np.arange(number)
    flat = np.sqrt(1 - height**2)
    ball = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height], axis=1)
    steep = ball / axes
    size = np.linalg.norm(steep, axis=1)
    # Gaussian curvature is 1/((abc)^2 size^4); the mean one by the trace of the second fundamental
    # form
    gauss = 1 / (np.prod(axes) ** 2 * size**4)
    mean = (np.sum(axes**2) - np.sum((axes * ball) ** 2, axis=1)) / (
        2 * np.prod(axes) ** 2 * size**3
    )
    return axes * ball, steep / size[:, None], 1 / (mean + np.sqrt(np.maximum(mean**2 - gauss, 0)))


def pressure_at(
    axes: np.ndarray, wavenumber: complex, sources: np.ndarray, receivers: np.ndarray
) -> tuple[np.ndarray, float]:
    """Total pressure (P, N) of unit monopoles beside an ellipsoid with semi-axes (3,) [m], and the own error."""
    found = [
        _fitted_pressure(axes, wavenumber, sources, receivers, number) for number in (700, 1100)
    ]
    error = np.linalg.norm(found[1] - found[0], axis=0) / np.linalg.norm(found[1], axis=0)
    return found[1], float(error.max())


def _fitted_pressure(
    axes: np.ndarray, wavenumber: complex, sources: np.ndarray, receivers: np.ndarray, number: int
) -> np.ndarray:
    skin, normals, radius = surface_points(axes, number)
    monopoles = skin - DEPTH * radius[:, None] * normals
    points, outward, _ = surface_points(axes, 3 * number, start=0.31)
    matrix = normal_derivatives(points, outward, monopoles, wavenumber)
    sizes = np.linalg.norm(matrix, axis=0)
    strengths = (
        least_squares(matrix / sizes, -normal_derivatives(points, outward, sources, wavenumber))
        / sizes[:, None]
    )
    return (
        waves(receivers, sources, wavenumber) + waves(receivers, monopoles, wavenumber) @ strengths
    )
