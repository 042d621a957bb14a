"""Spherical waves with real harmonics about one centre, and their rigid motions.

Z_nm are the real, orthonormal spherical harmonics. A field without sources in a ball is Σ a_nm
j_n(kr) Z_nm, and an outgoing field is Σ b_nm h_n(kr) Z_nm. Wave (n, m) has the index n² + n + m. A
monopole e^{ikR}/R at x has a_nm = 4πik h_n(k|x|) Z_nm(x) (DLMF 10.60.1 and 14.30.9). A translation
τ and rotation ω of a field about the centre is exp(τ·∇ + ω·(r × ∇)). Both operators are sparse: r ×
∇ couples waves of the same n, and

    ∂z (j_n Z_nm)/k = A_nm j_(n−1) Z_(n−1)m − A_(n+1)m j_(n+1) Z_(n+1)m,  A_nm² = (n² − m²)/(4n² −
    1)

(P. A. Martin, Multiple Scattering, 2006, section 3.9). The other derivatives are commutators of
these operators.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Complex, Complex128, Float32, Float64, Int, Num, Real, Shaped
from scipy.sparse import csr_matrix
from scipy.special import jv, spherical_jn

from airtact import _kernels

# Coefficients of waves, in single or double precision.
Waves = Complex[np.ndarray, "waves columns"]


def wave_count(order: int) -> int:
    """Return the number of spherical waves up to an order, (order + 1)²."""
    return (order + 1) ** 2


def order_of(waves: Waves) -> int:
    """Return the highest order of a set of waves, computed from the number of waves."""
    return round(np.sqrt(len(waves))) - 1


def harmonics(
    order: int, offsets: Real[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "waves points"]:
    """Return real spherical harmonics (waves, P) in the directions of offsets (P, 3).

    The normalised Legendre functions of each order n are computed from the two preceding orders,
    for all degrees m at once (DLMF 14.10.3). The recurrence is stable because the functions grow
    with n.
    """
    x, y, z = (np.asarray(offsets, dtype=np.float64) / np.linalg.norm(offsets, axis=1)[:, None]).T
    sine = np.hypot(x, y)
    turn = np.arange(order + 1)[:, None] * np.arctan2(y, x)
    cosines = np.sqrt(2.0) * np.cos(turn)
    cosines[0] = 1.0
    sines = np.sqrt(2.0) * np.sin(turn)
    out = np.empty((wave_count(order), len(offsets)))
    below = np.zeros((1, len(offsets)))
    legendre = np.full((1, len(offsets)), 1 / np.sqrt(4 * np.pi))
    for n in range(order + 1):
        if n:
            m = np.arange(n)[:, None]
            grown = np.empty((n + 1, len(offsets)))
            grown[:n] = np.sqrt((4 * n**2 - 1) / (n**2 - m**2)) * z * legendre
            factor = ((2 * n + 1) * ((n - 1) ** 2 - m**2)) / (max(2 * n - 3, 1) * (n**2 - m**2))
            grown[: n - 1] -= np.sqrt(factor[: n - 1]) * below[: n - 1]
            # Degree n has no predecessor two orders below, so it follows from degree n − 1.
            grown[n] = np.sqrt((2 * n + 1) / (2 * n)) * sine * legendre[n - 1]
            below = legendre
            legendre = grown
        # Degrees 0 to n follow the middle of the order's waves; −n to −1 precede it.
        np.multiply(legendre, cosines[: n + 1], out=out[n * n + n : (n + 1) ** 2])
        np.multiply(legendre[:0:-1], sines[n:0:-1], out=out[n * n : n * n + n])
    return out


def outgoing_radial(
    order: int, radii: Real[np.ndarray, "points"], wavenumber: complex
) -> Complex128[np.ndarray, "orders points"]:
    """Return the (order + 1, P) Hankel functions h_n(kr) of all orders at P distances."""
    argument = wavenumber * np.asarray(radii, dtype=np.complex128)
    hankel = np.empty((order + 2, len(argument)), dtype=np.complex128)
    hankel[0] = -1j * np.exp(1j * argument) / argument
    hankel[1] = hankel[0] * (1.0 / argument - 1j)
    for n in range(1, order):  # the upward recurrence is stable because h_n grows
        hankel[n + 1] = (2 * n + 1) / argument * hankel[n] - hankel[n - 1]
    return hankel[: order + 1]


def of_waves(
    order: int, radial: Shaped[np.ndarray, "orders *points"]
) -> Shaped[np.ndarray, "waves *points"]:
    """Repeat row n of an array 2n + 1 times, once for each wave of order n."""
    return np.repeat(radial, 2 * np.arange(order + 1) + 1, axis=0)


def projected(
    order: int,
    offsets: Real[np.ndarray, "points 3"],
    strengths: Complex128[np.ndarray, "points columns"],
    wavenumber: complex,
) -> Waves:
    """Expand monopoles of strengths (P, S) at offsets (P, 3) in outgoing waves.

    The function returns the coefficients (waves, S). The sums are computed in single precision,
    whose error is smaller than that of the solvers.
    """
    waves = regular_waves(order, offsets, wavenumber)
    strengths = np.ascontiguousarray(strengths, dtype=np.complex64)
    real = not wavenumber.imag  # real waves take half the work
    summed = mixed(waves, strengths) if real else waves.astype(np.complex64) @ strengths
    return 4j * np.pi * wavenumber * summed.astype(np.complex128)


def regular_waves(
    order: int, offsets: Real[np.ndarray, "points 3"], wavenumber: complex
) -> Shaped[np.ndarray, "waves points"]:
    """Return regular waves j_n(kr) Z_nm (waves, P) at offsets (P, 3); they are real for real k."""
    # A real argument keeps the waves and all products with them real.
    argument = np.linalg.norm(offsets, axis=1) * (
        wavenumber if wavenumber.imag else wavenumber.real
    )
    radial = spherical_jn(np.arange(order + 1)[:, None], argument[None, :])
    return of_waves(order, radial) * harmonics(order, offsets)


def monopole_waves(
    order: int,
    offsets: Real[np.ndarray, "points 3"],
    wavenumber: complex,
    strengths: Num[np.ndarray, "points"] | float = 1.0,
) -> Waves:
    """Expand monopoles of strengths (P,) [Pa·m] in regular waves; return the coefficients."""
    radial = outgoing_radial(order, np.linalg.norm(offsets, axis=1), wavenumber)
    radial *= 4j * np.pi * wavenumber * strengths
    waves = of_waves(order, radial.astype(np.complex64))
    waves *= harmonics(order, offsets).astype(np.float32)
    return waves


@lru_cache(maxsize=8)
def motions(order: int) -> tuple[csr_matrix, ...]:
    """Return matrices that apply ∂x/k, ∂y/k, ∂z/k and (r × ∇) along x, y, z to regular waves."""
    n = of_waves(order, np.arange(order + 1.0))
    m = np.concatenate([np.arange(-n, n + 1) for n in range(order + 1)])
    index = np.arange(len(n))

    def antisymmetric(values: Float64[np.ndarray, "waves"], to: Int[np.ndarray, "waves"]) -> Any:
        used = values != 0.0
        matrix = csr_matrix((values[used], (to[used], index[used])), (len(n), len(n)))
        return matrix - matrix.T

    # (n, m) couples to (n − 1, m), whose index is n² − n + m.
    along_z = antisymmetric(
        np.sqrt((n**2 - m**2) / (4 * n**2 - 1)), (index - 2 * n).astype(np.int64)
    )
    # ∂/∂φ turns cos mφ into sin |m|φ and vice versa.
    about_z = antisymmetric(-np.maximum(m, 0.0), index - 2 * m)
    # About y, cos mφ couples to cos (m − 1)φ, and sin mφ to sin (m − 1)φ.
    lowered = 0.5 * np.sqrt(n * (n + 1) - np.abs(m) * (np.abs(m) - 1.0))
    lowered *= np.where(m == 1, np.sqrt(2.0), 1.0) * (m != 0) * (m != -1)
    about_y = antisymmetric(lowered, index - np.sign(m))
    # The other matrices are commutators of these operators.
    about_x = about_z @ about_y - about_y @ about_z
    along_x = along_z @ about_y - about_y @ along_z
    along_y = about_x @ along_z - along_z @ about_x
    matrices = [
        csr_matrix(matrix) for matrix in (along_x, along_y, along_z, about_x, about_y, about_z)
    ]
    for matrix in matrices:
        # Remove entries that cancel to within rounding; they would double the work of products.
        matrix.data[np.abs(matrix.data) < 1e-13] = 0.0
        matrix.eliminate_zeros()
    return tuple(csr_matrix(matrix, dtype=np.float32) for matrix in matrices)


def along_motions(waves: Waves, wavenumber: float) -> Complex[np.ndarray, "6 waves columns"]:
    """Differentiate regular waves with respect to translations [1/m] and rotations [1/rad]."""
    along = np.stack([matrix @ waves for matrix in motions(order_of(waves))])
    along[:3] *= wavenumber
    return along


def moved(twist: Real[np.ndarray, "6"], waves: Waves, wavenumber: float) -> Waves:
    """Return regular waves moved by a twist (6,): translation [m] and rotation [rad].

    The exponential of an antisymmetric matrix V of norm at most s is computed as the Chebyshev
    series Σ (2 − δ_j0) J_j(s) φ_j(V/s), with φ_0 = 1, φ_1 = x, φ_(j+1) = 2x φ_j + φ_(j−1) (DLMF
    10.12.3).
    """
    order = order_of(waves)
    size = wavenumber * float(np.linalg.norm(twist[:3])) + order * float(np.linalg.norm(twist[3:]))
    if size == 0.0:
        return waves
    # J_j falls faster than exponentially once j exceeds its argument by a few cube roots of it.
    bessel = jv(np.arange(int(size + 8 * np.cbrt(size)) + 12), size)
    # Smaller terms are omitted, except the first two, which start the recurrence.
    bessel = bessel[: max(int(np.flatnonzero(np.abs(bessel) > 1e-6)[-1]) + 1, 2)]
    bessel[1:] *= 2.0
    parts = np.concatenate([wavenumber * np.asarray(twist[:3]), twist[3:]]) / size
    total = waves.astype(np.complex64, order="C")
    values, columns, rows = _together(order)
    _kernels.chebyshev_sum(
        values=(2 * parts @ values).astype(np.float32),
        columns=columns,
        rows=rows,
        factors=bessel.astype(np.float32),
        x=total.view(np.float32),
    )
    return total


def mixed(
    weights: Real[np.ndarray, "mixtures waves"], waves: Waves
) -> Complex[np.ndarray, "mixtures columns"]:
    """Multiply a real matrix by complex waves with real arithmetic, which halves the work."""
    real = np.ascontiguousarray(waves).view(np.real(waves).dtype)
    return (weights.astype(real.dtype, copy=False) @ real).view(waves.dtype)


@lru_cache(maxsize=16)
def _together(
    order: int,
) -> tuple[Float32[np.ndarray, "6 entries"], Int[np.ndarray, "entries"], Int[np.ndarray, "ends"]]:
    # Return the entries of the six ``motions`` in a common sparse pattern, with its columns and
    # rows. A weighted sum of the matrices is then a sum of their values.
    shared = csr_matrix(sum(abs(matrix) for matrix in motions(order)))
    shared.sort_indices()
    row, column = shared.tocoo().coords
    values = np.stack([np.asarray(matrix[row, column]).reshape(-1) for matrix in motions(order)])
    return values, shared.indices, shared.indptr
