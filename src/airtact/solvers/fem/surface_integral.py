"""The surface integral of Kirchhoff and Helmholtz for finite elements, by compiled loops that no other solver uses."""

import numpy as np
from jaxtyping import Complex128, Real

from airtact import _kernels


def surface_integral(
    points: Real[np.ndarray, "points 3"],
    positions: Real[np.ndarray, "nodes 3"],
    normals: Real[np.ndarray, "nodes 3"],
    monopoles: Complex128[np.ndarray, "nodes excitations"],
    dipoles: Complex128[np.ndarray, "nodes excitations"],
    wavenumber: complex,
) -> Complex128[np.ndarray, "points excitations"]:
    """Return Σ_j m_j G(x, y_j) + d_j ∂G(x, y_j)/∂n_j with G = e^{ikr}/r at points x off the positions y_j."""
    found = np.empty((len(points), monopoles.shape[1]), dtype=np.complex128)
    _kernels.surface_integral(*_plain(points, positions, normals, monopoles, dipoles), complex(wavenumber), found)
    return found


def normal_derivative(
    points: Real[np.ndarray, "points 3"],
    normals: Real[np.ndarray, "points 3"],
    positions: Real[np.ndarray, "sources 3"],
    strengths: Complex128[np.ndarray, "sources excitations"],
    wavenumber: complex,
) -> Complex128[np.ndarray, "points excitations"]:
    """Return Σ_j s_j ∂G(x, y_j)/∂n at points x with normals n, off the positions y_j."""
    found = np.empty((len(points), strengths.shape[1]), dtype=np.complex128)
    _kernels.normal_derivative(*_plain(points, normals, positions, strengths), complex(wavenumber), found)
    return found


def _plain(*arrays: np.ndarray) -> list[np.ndarray]:
    """Arrays as the compiled loops take them: contiguous, in double precision."""
    return [
        np.ascontiguousarray(array, dtype=np.complex128 if np.iscomplexobj(array) else np.float64) for array in arrays
    ]
