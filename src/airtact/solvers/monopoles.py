"""The free field of monopoles, which every solver adds to what bodies scatter."""

import numpy as np
from jaxtyping import Complex, Complex128, Real

from airtact import _kernels


def monopole_pressure(
    points: Real[np.ndarray, "points 3"],
    positions: Real[np.ndarray, "sources 3"],
    strengths: Complex[np.ndarray, "sources sounds"],
    wavenumber: complex,
    precision: str,
) -> Complex128[np.ndarray, "points sounds"]:
    """Free-field pressure Σ_j s_j e^{ikr}/r at points [Pa]."""
    out = np.empty((len(points), strengths.shape[1]), dtype=np.complex128)
    getattr(_kernels, f"apply_monopoles_{precision}")(
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(positions, dtype=np.float64),
        np.ascontiguousarray(strengths, dtype=np.complex128),
        complex(wavenumber),
        out,
    )
    return out
