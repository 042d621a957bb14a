"""Pressure of monopoles in open air, and the gradient of any pressure by finite differences."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Complex

from airtact import _kernels
from airtact.acoustics.solvers.arrays import Gradients, Lengths, Points, Pressures, SourcePoints


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
