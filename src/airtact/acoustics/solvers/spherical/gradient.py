"""Gradient of the pressure around one sphere, by differentiating its series term by term.

With R_n(r) = h_n(kr)/h_n(ka), dR_n/dr = (n/r) R_n − k [h_(n+1)(ka)/h_n(ka)] R_(n+1) (DLMF 10.51.2),
and alike for j_n inside a fluid sphere. For Legendre polynomials dP_n/dx = x dP_(n−1)/dx + n
P_(n−1).
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.solvers.arrays import ComplexPairs, Lengths, Pairs
from airtact.acoustics.solvers.spherical.modes import SphereModes
from airtact.acoustics.solvers.spherical.radial_functions import (
    legendre_polynomials,
    outgoing_quotients,
    outgoing_ratios,
    regular_derivatives,
    regular_ratios,
)
from airtact.errors import NotConverged

_MOST_TERMS = 4000
_STOP = 1e-11
_SMALLEST_RADIUS = 1e-6
"""Smallest radius inside a fluid sphere, over that of the sphere, at which the gradient is evaluated."""


def scattered_gradient(
    modes: SphereModes,
    inside: bool,
    radii: Lengths,
    source_radii: Float64[np.ndarray, "sources"],
    versine: Pairs,
) -> tuple[ComplexPairs, ComplexPairs]:
    """Differentiate the scattered pressure of unit monopoles, or the total one inside a fluid sphere.

    ``versine`` is 1 - cos γ of every point and source; the points are all ``inside`` the sphere or
    all outside.

    Returns
    -------
    (P, N) ∂p/∂r and (1/r) ∂p/∂cos γ [Pa/m].

    Raises
    ------
    NotConverged
        If 4000 terms do not suffice: both a point and a source are within about 0.3 % of the radius from the surface.
    """
    radii = np.maximum(radii, _SMALLEST_RADIUS * modes.radius)
    outward = np.zeros(versine.shape, dtype=np.complex128)
    along = np.zeros(versine.shape, dtype=np.complex128)
    angular, before = np.zeros_like(versine), np.zeros_like(versine)
    source_waves = outgoing_ratios(modes.wavenumber * source_radii, modes.size)
    radial = _radial(modes, inside, radii)
    waves = zip(
        modes.terms(inside), radial, source_waves, legendre_polynomials(versine), strict=False
    )
    small = 0
    for order, (term, (wave, derivative), source_wave, polynomial) in enumerate(waves):
        angular = (1.0 - versine) * angular + order * before
        before = polynomial
        added = (
            term * derivative[:, None] * source_wave * polynomial,
            term * (wave / radii)[:, None] * source_wave * angular,
        )
        outward, along = outward + added[0], along + added[1]
        least = _STOP * (np.abs(outward) + np.abs(along) + np.finfo(float).tiny)
        reached = order >= modes.first_safe_order() and np.all(
            np.abs(added[0]) + np.abs(added[1]) <= least
        )
        small = small + 1 if reached else 0
        if small == 4:  # a polynomial may vanish by chance, so that one small term is not enough
            return outward, along
        if order == _MOST_TERMS:
            break
    raise NotConverged(
        f"the gradient of the series of a sphere of radius {1e3 * modes.radius:g} mm did not converge in {_MOST_TERMS} "
        f"terms at a point {1e3 * (float(radii.min()) - modes.radius):.2g} mm and a source "
        f"{1e3 * (float(source_radii.min()) - modes.radius):.2g} mm off the surface; move one of them away from it.",
        code="not_converged",
    )


def _radial(
    modes: SphereModes, inside: bool, radii: Lengths
) -> Iterator[tuple[Complex128[np.ndarray, "points"], Complex128[np.ndarray, "points"]]]:
    """Yield the radial function of every order and its derivative [1/m]."""
    if inside and modes.inner_wavenumber is not None:
        wavenumber = modes.inner_wavenumber
        ratios = regular_ratios(wavenumber * radii, wavenumber * modes.radius)
        # j_(n+1)/j_n at the surface, from the logarithmic derivatives n/z - j_(n+1)/j_n
        size = wavenumber * modes.radius
        quotients = (
            order / size - derivative for order, derivative in enumerate(regular_derivatives(size))
        )
    else:
        wavenumber = modes.wavenumber
        ratios, quotients = (
            outgoing_ratios(wavenumber * radii, modes.size),
            outgoing_quotients(modes.size),
        )
    for order, (quotient, (wave, following)) in enumerate(
        zip(quotients, pairwise(ratios), strict=False)
    ):
        yield wave, order / radii * wave - wavenumber * quotient * following
