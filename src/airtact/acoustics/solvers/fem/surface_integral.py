"""The surface integral of Kirchhoff and Helmholtz for finite elements, by compiled loops that no other solver uses."""

import numpy as np
from jaxtyping import Complex128, Real

from airtact import _kernels
from airtact.acoustics.solvers.arrays import Points, Pressures, SourcePoints, Strengths


def surface_integral(
    points: Points,
    positions: Real[np.ndarray, "nodes 3"],
    normals: Real[np.ndarray, "nodes 3"],
    monopoles: Complex128[np.ndarray, "nodes excitations"],
    dipoles: Complex128[np.ndarray, "nodes excitations"],
    wavenumber: complex,
) -> Pressures:
    """Return Σ_j m_j G(x, y_j) + d_j ∂G(x, y_j)/∂n_j with G = e^{ikr}/r at points x off the positions y_j."""
    found = np.empty((len(points), monopoles.shape[1]), dtype=np.complex128)
    where, nodes, directions = (
        np.ascontiguousarray(one, dtype=np.float64) for one in (points, positions, normals)
    )
    monopoles, dipoles = np.ascontiguousarray(monopoles), np.ascontiguousarray(dipoles)
    _kernels.surface_integral(
        where, nodes, directions, monopoles, dipoles, complex(wavenumber), found
    )
    return found


def normal_derivative(
    points: Points,
    normals: Points,
    positions: SourcePoints,
    strengths: Strengths,
    wavenumber: complex,
) -> Pressures:
    """Return Σ_j s_j ∂G(x, y_j)/∂n at points x with normals n, off the positions y_j."""
    found = np.empty((len(points), strengths.shape[1]), dtype=np.complex128)
    where, directions, sources = (
        np.ascontiguousarray(one, dtype=np.float64) for one in (points, normals, positions)
    )
    strengths = np.ascontiguousarray(strengths)
    _kernels.normal_derivative(where, directions, sources, strengths, complex(wavenumber), found)
    return found
