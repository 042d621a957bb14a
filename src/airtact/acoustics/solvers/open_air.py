"""Monopoles in open air, whose field every solver adds to the scattered one, and velocities.

The particle velocity of a sound field is v = ∇p / (iωρ), because ρ ∂v/∂t = −∇p and e^{−iωt}.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Complex, Real

from airtact import _kernels
from airtact.acoustics.solvers.arrays import Gradients, Lengths, Points, Pressures, SourcePoints
from airtact.acoustics.sources import Monopoles


def velocity_of(
    gradient: Gradients, frequency: float, density: Real[np.ndarray, "points"] | float
) -> Gradients:
    """Particle velocity [m/s] from ∇p [Pa/m], the frequency [Hz] and the density [kg/m³]."""
    density = np.broadcast_to(density, len(gradient))[:, None, None]
    return gradient / (2j * np.pi * frequency * density)


def open_air_gradient(points: Points, sources: Monopoles, wavenumber: complex) -> Gradients:
    """∇p [Pa/m] of monopoles in open air: Σ_j s_j (ik − 1/r) e^{ikr}/r · (x − x_j)/r."""
    gradient = np.empty((len(points), 3, sources.strengths.shape[1]), dtype=np.complex128)
    rows = max(1, (1 << 18) // len(sources.positions))  # bounds the memory
    for first in range(0, len(points), rows):
        block = slice(first, first + rows)
        away = points[block, None, :] - sources.positions[None, :, :]
        distance = np.linalg.norm(away, axis=-1)
        wave = np.exp(1j * wavenumber * distance)
        factor = wave * (1j * wavenumber - 1.0 / distance) / distance**2
        for axis in range(3):
            gradient[block, axis] = (factor * away[:, :, axis]) @ sources.strengths
    return gradient


def differences(
    pressure: Callable[[Points], Pressures], points: Points, step: Lengths
) -> Gradients:
    """∇p [Pa/m] by central differences, whose error falls as the fourth power of the step [m].

    The pressure must exist two steps away on all sides.
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
    """Open-air pressure Σ_j s_j e^{ikr}/r at points [Pa]; ``precision`` is float32 or float64."""
    return _kernels.apply_monopoles(points, positions, strengths, complex(wavenumber), precision)
