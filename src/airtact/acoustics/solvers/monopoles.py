"""The open-air field of monopoles, which every solver adds to the scattered field."""

import numpy as np
from jaxtyping import Complex

from airtact.acoustics.solvers.arrays import Points, Pressures, SourcePoints
from airtact.acoustics.solvers.loops import loop


def monopole_pressure(
    points: Points,
    positions: SourcePoints,
    strengths: Complex[np.ndarray, "sources excitations"],
    wavenumber: complex,
    precision: str,
) -> Pressures:
    """Open-air pressure Σ_j s_j e^{ikr}/r at points [Pa]; ``precision`` is float32 or float64."""
    out = np.empty((len(points), strengths.shape[1]), dtype=np.complex128)
    points, positions = (np.ascontiguousarray(one, dtype=np.float64) for one in (points, positions))
    strengths = np.ascontiguousarray(strengths, dtype=np.complex128)
    loop("apply_monopoles", precision)(points, positions, strengths, complex(wavenumber), out)
    return out
