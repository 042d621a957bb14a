"""Radial functions and Legendre polynomials of every order, as ratios that never overflow.

Spherical Hankel functions h_n of the first kind grow like n!, and Bessel functions j_n shrink at
the same rate, so both leave the range of floating-point numbers. Therefore only ratios are
computed: h_n(z)/h_n(z0) by upward recurrence, which is stable because h is the growing solution,
and j_n/j_(n-1) by downward recurrence (Miller; DLMF 3.6(iii) and 10.51.1).
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Complex, Complex128, Float64

_BLOCK = 64


def outgoing_quotients(argument: complex) -> Iterator[complex]:
    """Yield h_(n+1)(z)/h_n(z) for n = 0, 1, 2, ... (upward recurrence, DLMF 10.51.1)."""
    quotient = 1.0 / argument - 1j
    order = 0
    while True:
        yield quotient
        order += 1
        quotient = (2 * order + 1) / argument - 1.0 / quotient


def outgoing_ratios(
    arguments: Complex[np.ndarray, "arguments"], reference: complex
) -> Iterator[Complex128[np.ndarray, "arguments"]]:
    """Yield h_n(z)/h_n(z0) for n = 0, 1, 2, ..., which stay bounded for |z| >= |z0|."""
    carrier = reference / arguments * np.exp(1j * (arguments - reference))
    for shape in outgoing_shapes(arguments, reference):
        yield carrier * shape


def outgoing_shapes(
    arguments: Complex[np.ndarray, "arguments"], reference: complex
) -> Iterator[Complex128[np.ndarray, "arguments"]]:
    """Yield h_n(z)/h_n(z0) divided by h_0(z)/h_0(z0), which removes the carrier wave."""
    shape = np.ones(len(arguments), dtype=np.complex128)
    quotient = 1.0 / arguments - 1j
    for order, reference_quotient in enumerate(outgoing_quotients(reference), start=1):
        yield shape
        # A quotient of quotients stays near 1, even where h_n itself overflows.
        shape = shape * (quotient / reference_quotient)
        quotient = (2 * order + 1) / arguments - 1.0 / quotient


def regular_quotients(
    arguments: Complex[np.ndarray, "arguments"], first: int, last: int
) -> Complex128[np.ndarray, "orders arguments"]:
    """Return the quotients j_n(z)/j_(n-1)(z) for n from ``first`` to ``last``.

    The quotients are computed by downward recurrence. The argument z may be zero. Where j_(n-1)
    vanishes, the quotient is about 1e30 rather than infinite.
    """
    largest = float(np.max(np.abs(arguments), initial=0.0))
    # Above the turning point |z|, each downward step reduces the initial error by the factor
    # (j_n/j_(n-1))² or more.
    start = int(max(last, largest) + 8.0 * np.cbrt(largest) + 24.0)
    quotients = np.empty((last - first + 1, len(arguments)), dtype=np.complex128)
    quotient = arguments / (2 * start + 1)
    for order in range(start, first - 1, -1):
        denominator = 2 * order + 1 - arguments * quotient
        quotient = arguments / np.where(denominator == 0.0, 1e-30, denominator)
        if order <= last:
            quotients[order - first] = quotient
    return quotients


def regular_ratios(
    arguments: Complex[np.ndarray, "arguments"], reference: complex
) -> Iterator[Complex128[np.ndarray, "arguments"]]:
    """Yield j_n(z)/j_n(z0) for n = 0, 1, 2, ..., which stay bounded for |z| <= |z0|.

    The argument z may be zero.
    """
    combined = np.append(arguments, reference).astype(np.complex128)
    first = 1
    ratio = np.ones(0)
    while True:
        quotients = regular_quotients(combined, first, first + _BLOCK - 1)
        if first == 1:
            lowest = _lowest_regular(combined, quotients[0])
            ratio = lowest[:-1] / lowest[-1]
        for quotient in quotients:
            yield ratio
            ratio = ratio * (quotient[:-1] / quotient[-1])
        first += _BLOCK


def _lowest_regular(
    arguments: Complex128[np.ndarray, "arguments"], quotients: Complex128[np.ndarray, "arguments"]
) -> Complex128[np.ndarray, "arguments"]:
    """Return j_0(z); near its zeros, it is computed as j_1 / (j_1/j_0) to keep products precise."""
    safe = np.where(arguments == 0.0, 1.0, arguments)
    zeroth = np.where(arguments == 0.0, 1.0, np.sin(safe) / safe)
    first = np.where(arguments == 0.0, 0.0, (np.sin(safe) / safe - np.cos(safe)) / safe)
    return np.where(
        np.abs(first) > np.abs(zeroth), first / np.where(quotients == 0.0, 1.0, quotients), zeroth
    )


def outgoing_derivatives(argument: complex) -> Iterator[complex]:
    """Yield the logarithmic derivatives h_n'(z)/h_n(z) for n = 0, 1, 2, ... (DLMF 10.51.2)."""
    for order, quotient in enumerate(outgoing_quotients(argument)):
        yield order / argument - quotient


def regular_derivatives(argument: complex) -> Iterator[complex]:
    """Yield the logarithmic derivatives j_n'(z)/j_n(z) (DLMF 10.51.2).

    Where j_n vanishes, the derivative is about 1e30 rather than infinite.
    """
    first = 1
    while True:
        quotients = regular_quotients(
            np.array([argument], dtype=np.complex128), first, first + _BLOCK - 1
        )[:, 0]
        for order, quotient in enumerate(quotients.tolist(), start=first - 1):
            yield order / argument - quotient
        first += _BLOCK


def legendre_polynomials(
    versine: Float64[np.ndarray, "*shape"],
) -> Iterator[Float64[np.ndarray, "*shape"]]:
    """Yield P_n(cos γ) from 1 - cos γ, which preserves precision at small angles."""
    polynomial = np.ones_like(versine)
    step = np.zeros_like(versine)
    order = 0
    while True:
        yield polynomial
        step = (order * step - (2 * order + 1) * versine * polynomial) / (order + 1)
        # Summing the steps between neighbouring orders preserves precision near γ = 0.
        polynomial = polynomial + step
        order += 1


def image_sums(
    ratio: Float64[np.ndarray, "*shape"], versine: Float64[np.ndarray, "*shape"]
) -> tuple[Float64[np.ndarray, "*shape"], Float64[np.ndarray, "*shape"]]:
    """Sum Σ x^n P_n(cos γ) and Σ x^n P_n(cos γ)/(n + 1), for a point image and a line of images.

    The sums are 1/√(1 - 2x cos γ + x²) and its mean over [0, x] (DLMF 18.12.11), for x in [0, 1]
    except x = 1 with γ = 0.
    """
    cosine = 1.0 - versine
    distance = np.sqrt((1.0 - ratio) ** 2 + 2.0 * ratio * versine)
    front = (1.0 + (2.0 * cosine - ratio) / (1.0 + distance)) / np.where(
        cosine > 0, distance + cosine - ratio, 1.0
    )
    back = (1.0 + (ratio - 2.0 * cosine) / (1.0 + distance)) / np.where(cosine > 0, 1.0, versine)
    quotient = np.where(cosine > 0, front, back)
    tiny = ratio < 1e-200
    mean = np.where(tiny, quotient, np.log1p(ratio * quotient) / np.where(tiny, 1.0, ratio))
    return 1.0 / distance, mean
