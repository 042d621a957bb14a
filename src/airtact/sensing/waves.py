"""Spherical waves with real harmonics about one centre, and what a rigid motion does to them.

With Z_nm the real, orthonormal spherical harmonics, a field without sources in a ball is Σ a_nm j_n(kr) Z_nm and one
that leaves it is Σ b_nm h_n(kr) Z_nm; wave (n, m) has the index n² + n + m. A monopole e^{ikR}/R at x has
a_nm = 4πik h_n(k|x|) Z_nm(x) (DLMF 10.60.1 and 14.30.9). Moving a field by τ and turning it by ω about the centre is
exp(τ·∇ + ω·(r × ∇)), and both operators are sparse between waves: r × ∇ keeps n, and

    ∂z (j_n Z_nm)/k = A_nm j_(n−1) Z_(n−1)m − A_(n+1)m j_(n+1) Z_(n+1)m,  A_nm² = (n² − m²)/(4n² − 1)

(P. A. Martin, Multiple Scattering, 2006, section 3.9). The other derivatives are commutators of these.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Complex128, Float64, Real
from scipy.sparse import csr_matrix, diags
from scipy.special import jv, sph_harm_y_all, spherical_jn

Waves = Complex128[np.ndarray, "waves columns"]

CUT = 1e-7
"""Terms of an exponential below this are left out."""


def wave_count(order: int) -> int:
    """Count the waves up to an order."""
    return (order + 1) ** 2


def order_of(waves: Waves) -> int:
    """Order of so many waves."""
    return round(np.sqrt(len(waves))) - 1


def orders_of_waves(order: int) -> Float64[np.ndarray, "waves"]:
    """Order n of each wave, (waves,)."""
    return np.repeat(np.arange(order + 1.0), 2 * np.arange(order + 1) + 1)


def harmonics(order: int, offsets: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "waves points"]:
    """Real harmonics (waves, P) in the directions of offsets (P, 3) from the centre."""
    x, y, z = offsets.T
    polar, azimuth = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    alone = np.real(sph_harm_y_all(order, order, polar, np.zeros(len(offsets))))
    turn = np.arange(order + 1)[:, None] * azimuth
    sign = np.sqrt(2.0) * (-1.0) ** np.arange(order + 1)
    sign[0] = 1.0
    cosines, sines = sign[:, None] * np.cos(turn), sign[:, None] * np.sin(turn)
    out = np.empty((wave_count(order), len(offsets)))
    for n in range(order + 1):
        rows, legendre = out[n * n : (n + 1) ** 2], alone[n, : n + 1]
        rows[n:] = legendre * cosines[: n + 1]
        rows[:n] = (legendre * sines[: n + 1])[:0:-1]
    return out


def outgoing_radial(order: int, radii: Real[np.ndarray, "points"], wavenumber: complex) -> Waves:
    """Hankel functions h_n(kr) of every wave, (waves, P)."""
    argument = wavenumber * np.asarray(radii, dtype=np.complex128)
    hankel = np.empty((order + 2, len(argument)), dtype=np.complex128)
    hankel[0] = -1j * np.exp(1j * argument) / argument
    hankel[1] = hankel[0] * (1.0 / argument - 1j)
    for n in range(1, order):  # upwards h_n grows, so that its recurrence is stable
        hankel[n + 1] = (2 * n + 1) / argument * hankel[n] - hankel[n - 1]
    return np.repeat(hankel[: order + 1], 2 * np.arange(order + 1) + 1, axis=0)


def projected(
    order: int,
    offsets: Real[np.ndarray, "points 3"],
    strengths: Complex128[np.ndarray, "points columns"],
    wavenumber: complex,
) -> Waves:
    """Outgoing waves (waves, S) of monopoles at offsets (P, 3) from the centre with strengths (P, S) [Pa·m]."""
    radii = np.linalg.norm(offsets, axis=1)
    radial = spherical_jn(np.arange(order + 1)[:, None], wavenumber * radii[None, :])
    waves = np.repeat(radial, 2 * np.arange(order + 1) + 1, axis=0) * harmonics(order, offsets)
    return 4j * np.pi * wavenumber * (waves @ strengths)


def monopole_waves(order: int, offsets: Real[np.ndarray, "points 3"], wavenumber: complex) -> Waves:
    """Regular waves (waves, P) about the centre of unit monopoles at offsets (P, 3) from it, of 1 Pa·m each."""
    radial = outgoing_radial(order, np.linalg.norm(offsets, axis=1), wavenumber)
    return 4j * np.pi * wavenumber * radial * harmonics(order, offsets)


@lru_cache(maxsize=8)
def motions(order: int) -> tuple[csr_matrix, ...]:
    """Six real antisymmetric matrices on regular waves: ∂x/k, ∂y/k, ∂z/k, and r × ∇ about x, y and z."""
    degrees = np.concatenate([np.arange(-n, n + 1) for n in range(order + 1)])
    n = orders_of_waves(order)
    index = np.arange(len(n))
    size = (len(n), len(n))
    raised = np.flatnonzero(degrees < n)
    ladder = np.sqrt(n * (n + 1) - degrees * (degrees + 1.0))
    up = csr_matrix((ladder[raised], (index[raised] + 1, index[raised])), size)
    down = up.T
    lower = np.flatnonzero(np.abs(degrees) < n)
    below = (index - 2 * n).astype(np.int64)[lower]  # (n − 1, m) has the index n² − n + m
    coupling = np.sqrt((n**2 - degrees**2)[lower] / (4 * n**2 - 1)[lower])
    along = csr_matrix((coupling, (below, index[lower])), size)
    along_z = along - along.T
    real = _to_real(order)
    turns = [
        np.real(real.conj() @ (1j * one) @ real.T)
        for one in ((up + down) / 2, (up - down) / 2j, diags(degrees.astype(float)))
    ]
    along_z = np.real(real.conj() @ along_z @ real.T)
    along_x = along_z @ turns[1] - turns[1] @ along_z
    along_y = turns[0] @ along_z - along_z @ turns[0]
    made = [csr_matrix(one) for one in (along_x, along_y, along_z, *turns)]
    for one in made:
        one.data[np.abs(one.data) < 1e-13] = 0.0
        one.eliminate_zeros()
    return tuple(made)


def moved(twist: Real[np.ndarray, "6"], waves: Waves, wavenumber: float) -> Waves:
    """Regular waves about a centre that moves by a twist: translation [m] and turn [rad] in its own frame, (6,).

    The exponential of an antisymmetric matrix V of norm at most s is summed as Σ (2 − δ_j0) J_j(s) φ_j(V/s), with
    φ_0 = 1, φ_1 = x, φ_(j+1) = 2x φ_j + φ_(j−1): Chebyshev's expansion (DLMF 10.12.3).
    """
    order = order_of(waves)
    size = wavenumber * float(np.linalg.norm(twist[:3])) + order * float(np.linalg.norm(twist[3:]))
    if size == 0.0:
        return waves
    parts = np.concatenate([wavenumber * np.asarray(twist[:3]), twist[3:]]) / size
    whole = csr_matrix(sum(part * one for part, one in zip(parts, motions(order), strict=True)))
    bessel = jv(np.arange(int(size + 8 * np.cbrt(size)) + 12), size)
    bessel = bessel[: int(np.flatnonzero(np.abs(bessel) > CUT)[-1]) + 1]
    before = np.ascontiguousarray(waves).view(np.float64)  # the matrices are real
    here, total = whole @ before, bessel[0] * before
    for factor in bessel[1:]:
        total += 2 * factor * here
        before, here = here, 2 * (whole @ here) + before
    return total.view(np.complex128)


def _to_real(order: int) -> csr_matrix:
    """Unitary U with Z = U Y, for Y the complex harmonics with the phase of Condon and Shortley."""
    rows, columns, values = [], [], []
    for n in range(order + 1):
        middle = n * n + n
        rows.append(middle)
        columns.append(middle)
        values.append(1.0)
        for m in range(1, n + 1):
            sign = (-1.0) ** m
            rows += [middle + m, middle + m, middle - m, middle - m]
            columns += [middle + m, middle - m] * 2
            values += [sign / np.sqrt(2), 1 / np.sqrt(2), -1j * sign / np.sqrt(2), 1j / np.sqrt(2)]
    size = wave_count(order)
    return csr_matrix((values, (rows, columns)), (size, size), dtype=np.complex128)
