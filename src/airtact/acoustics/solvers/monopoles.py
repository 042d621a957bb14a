"""The open-air field of monopoles, which every solver adds to the scattered field."""

import numpy as np
from jaxtyping import Complex

from airtact import _kernels
from airtact.acoustics.solvers.arrays import Points, Pressures, SourcePoints


def monopole_pressure(
    points: Points,
    positions: SourcePoints,
    strengths: Complex[np.ndarray, "sources excitations"],
    wavenumber: complex,
    precision: str,
) -> Pressures:
    """Open-air pressure Σ_j s_j e^{ikr}/r at points [Pa]; ``precision`` is float32 or float64."""
    return _kernels.apply_monopoles(points, positions, strengths, complex(wavenumber), precision)
