"""Two spheres, sound-hard or of an impedance, by multipoles about both centres: independent of every solver in src.

In the frame whose z axis joins the centres p = p_inc + Σ c_snm h_n(k r_s)/h_n(k a_s) P_n^m(cos θ_s)
e^{imφ} over the spheres s. Rotation about that axis keeps the azimuthal orders m apart, so each m
is one small least-squares problem for ∂p/∂n + ikβ p = 0 at Gauss points of both meridians, β being
a sphere's admittance ρc/Z; a Fourier transform brings the incident slopes to orders m. (The ansatz
is that of P. A. Martin, Multiple Scattering, Cambridge 2006, section 4.6; the coefficients are
fitted instead.)
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import sph_legendre_p_all

from airtact.geometry.primitives import Capsule

MOST_ORDERS = 110


def pressure_at(
    spheres: Sequence[Capsule],
    wavenumber: complex,
    sources: np.ndarray,
    receivers: np.ndarray,
    wanted: float = 1e-5,
    admittances: Sequence[complex] = (0.0, 0.0),
) -> tuple[np.ndarray, float]:
    """Total pressure of unit monopoles e^{ikr}/r beside two spheres.

    Parameters
    ----------
    spheres : two capsules of length 0.
    wavenumber : k [1/m].
    sources, receivers : (N, 3) and (P, 3) outside [m]. By reciprocity the set that stays further
        from the skins speaks, so one of the two may come as close as it likes; both within a few
        millimetres needs too many orders.
    wanted : own error at which to stop raising the order.
    admittances : β of each sphere, 0 for a sound-hard one.

    Returns
    -------
    (P, N) pressure [Pa] and the own error: the larger of the relative residual at skin points that were not fitted and
    the relative change at the receivers over the last rise of the order.
    """
    if clearance(spheres, sources) < clearance(spheres, receivers):
        pressure, error = pressure_at(spheres, wavenumber, receivers, sources, wanted, admittances)
        return pressure.T, error
    first, last = 0.0 + 0.0j, np.inf
    order = int(abs(wavenumber) * max(s.radius for s in spheres)) + 14
    while True:
        fit = fitted(spheres, wavenumber, sources, order, admittances)
        pressure = fit.pressure(receivers)
        change = np.linalg.norm(pressure - first) / np.linalg.norm(pressure)
        last = max(change, fit.residual())
        order, first = int(1.3 * order), pressure
        if last < wanted or order > MOST_ORDERS:
            return pressure, float(last)


def clearance(spheres: Sequence[Capsule], points: np.ndarray) -> float:
    """Distance of the nearest point from the skins [m]."""
    return float(min(-sphere.depth(points).max() for sphere in spheres))


def monopole_slopes(
    points: np.ndarray, normals: np.ndarray, sources: np.ndarray, wavenumber: complex
) -> np.ndarray:
    """Derivative of e^{ikr}/r along the normals at (Q, 3) points: (Q, N)."""
    offset = points[:, None, :] - sources[None, :, :]
    distance = np.linalg.norm(offset, axis=2)
    along = np.einsum("qni,qi->qn", offset, normals) / distance
    return (
        (1j * wavenumber - 1.0 / distance) * np.exp(1j * wavenumber * distance) / distance * along
    )


def incident_rise(
    points: np.ndarray, normals: np.ndarray, sources: np.ndarray, k: complex, admittance: complex
):
    """∂p/∂n + ikβ p of e^{ikr}/r at (Q, 3) points: (Q, N)."""
    slope = monopole_slopes(points, normals, sources, k)
    if not admittance:
        return slope
    distance = np.linalg.norm(points[:, None, :] - sources[None, :, :], axis=2)
    return slope + 1j * k * admittance * np.exp(1j * k * distance) / distance


def hankel(order: int, argument: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Spherical Hankel functions of the first kind h_0 ... h_order, and their derivatives: (order + 1, P) each."""
    # The upward recurrence is stable, since no solution of it grows faster than h_n.
    h = np.empty((order + 2, len(argument)), dtype=np.complex128)
    h[0] = -1j * np.exp(1j * argument) / argument
    h[1] = h[0] * (1.0 / argument - 1j)
    for n in range(1, order + 1):
        h[n + 1] = (2 * n + 1) / argument * h[n] - h[n - 1]
    return h[:-1], np.arange(order + 1)[:, None] / argument * h[:-1] - h[1:]


@dataclass
class Fit:
    """Coefficients of the multipoles: (sphere, n = 0 ... order, m = -turns ... turns, sound)."""

    centres: list[np.ndarray]
    radii: list[float]
    to_frame: np.ndarray
    origin: np.ndarray
    wavenumber: complex
    sources: np.ndarray
    order: int
    turns: int
    coefficients: np.ndarray
    admittances: Sequence[complex]

    def pressure(self, points: np.ndarray) -> np.ndarray:
        """Total pressure (P, N) at points (P, 3) of the room."""
        local = (points - self.origin) @ self.to_frame.T
        distance = np.linalg.norm(local[:, None, :] - self.sources, axis=2)
        total = np.exp(1j * self.wavenumber * distance) / distance
        for which in range(2):
            waves, _ = self._waves(which, local, np.zeros_like(local))
            total += np.einsum("nmp,nms->ps", waves, self.coefficients[which])
        return total

    def residual(self) -> float:
        """Norm of ∂p/∂n + ikβ p at random skin points over that of the incident sound."""
        normals = np.random.default_rng(11).normal(size=(300, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        defect, incident = 0.0, 0.0
        for centre, radius, admittance in zip(
            self.centres, self.radii, self.admittances, strict=True
        ):
            points = centre + radius * normals
            slope = incident_rise(points, normals, self.sources, self.wavenumber, admittance)
            incident += np.linalg.norm(slope) ** 2
            for which in range(2):
                waves, slopes = self._waves(which, points, normals)
                slopes = slopes + 1j * self.wavenumber * admittance * waves
                slope = slope + np.einsum("nmp,nms->ps", slopes, self.coefficients[which])
            defect += np.linalg.norm(slope) ** 2
        return float(np.sqrt(defect / incident))

    def _waves(
        self, which: int, local: np.ndarray, normals: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Multipoles of one sphere (n, m, P) at points of the frame, and their slopes along the normals."""
        offset = local - self.centres[which]
        flat = np.maximum(
            np.hypot(offset[:, 0], offset[:, 1]), 1e-15
        )  # on the axis there is no azimuth
        azimuth = np.arctan2(offset[:, 1], offset[:, 0])
        around = np.array([-np.sin(azimuth), np.cos(azimuth)])
        flatwise = normals[:, 0] * around[1] - normals[:, 1] * around[0]
        waves, slopes = meridian_waves(
            self.order,
            self.wavenumber,
            self.radii[which],
            flat,
            offset[:, 2],
            flatwise,
            normals[:, 2],
        )
        orders = np.arange(-self.turns, self.turns + 1)
        turn = np.exp(1j * orders[:, None] * azimuth)
        swirl = (
            1j * orders[:, None] * (normals[:, 0] * around[0] + normals[:, 1] * around[1]) / flat
        )
        picked = np.abs(orders)
        return waves[:, picked] * turn, (slopes[:, picked] + waves[:, picked] * swirl) * turn


def meridian_waves(
    order: int,
    wavenumber: complex,
    radius: float,
    flat: np.ndarray,
    height: np.ndarray,
    normal_flat: np.ndarray,
    normal_height: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Waves h_n(kr)/h_n(ka) P_n^m(cos θ), m >= 0, in the half-plane φ = 0: (n, m, P), and slopes along normals."""
    distance, polar = np.hypot(flat, height), np.arctan2(flat, height)
    legendre = sph_legendre_p_all(order, order, polar, diff_n=1)[:, :, : order + 1]
    scale, _ = hankel(order, np.array([wavenumber * radius]))
    outgoing, slope = hankel(order, wavenumber * distance)
    radial, rise = (outgoing / scale)[:, None], (wavenumber * slope / scale)[:, None]
    sine, cosine = flat / distance, height / distance
    outward, southward = (
        normal_flat * sine + normal_height * cosine,
        normal_flat * cosine - normal_height * sine,
    )
    return radial * legendre[0], rise * legendre[0] * outward + radial * legendre[
        1
    ] * southward / distance


def fitted(
    spheres: Sequence[Capsule],
    wavenumber: complex,
    sources: np.ndarray,
    order: int,
    admittances: Sequence[complex] = (0.0, 0.0),
) -> Fit:
    """Fit multipoles up to an order to the condition ∂p/∂n + ikβ p = 0 on both spheres."""
    origin = np.asarray(spheres[0].pose.translation)
    frame, gap = joining_frame(np.asarray(spheres[1].pose.translation) - origin)
    heights, radii = [0.0, gap], [float(sphere.radius) for sphere in spheres]
    local_sources = (sources - origin) @ frame.T
    cosine, weight = np.polynomial.legendre.leggauss(2 * order + 8)
    sine = np.sqrt(1.0 - cosine**2)
    rows = [[np.empty(0)] * 2 for _ in range(2)]
    for on in range(2):
        for of in range(2):
            height = heights[on] - heights[of] + radii[on] * cosine
            waves, rises = meridian_waves(
                order, wavenumber, radii[of], radii[on] * sine, height, sine, cosine
            )
            rows[on][of] = rises + 1j * wavenumber * admittances[on] * waves
    slopes = [
        incident_orders(
            cosine, sine, radii[on], heights[on], local_sources, wavenumber, admittances[on]
        )
        for on in range(2)
    ]
    loudness = sum(np.linalg.norm(slope, axis=(0, 2)) for slope in slopes)
    turns = min(order, int(np.flatnonzero(loudness[: order + 1] > 1e-11 * loudness.max()).max()))
    balance = np.sqrt(np.concatenate([weight, weight]))[:, None]
    coefficients = np.zeros((2, order + 1, 2 * turns + 1, len(sources)), dtype=np.complex128)
    for m in range(turns + 1):
        matrix = balance * np.concatenate(
            [np.concatenate([rows[on][of][m:, m] for of in (0, 1)]).T for on in (0, 1)]
        )
        signs = (m,) if m == 0 else (m, -m)
        right = np.concatenate(
            [np.concatenate([slopes[on][:, sign] for on in (0, 1)]) for sign in signs], axis=1
        )
        size = np.linalg.norm(matrix, axis=0)
        found = np.linalg.lstsq(matrix / size, -balance * right, rcond=1e-15)[0] / size[:, None]
        for sign, part in zip(signs, np.split(found, len(signs), axis=1), strict=True):
            coefficients[:, m:, turns + sign] = part.reshape(2, order + 1 - m, -1)
    places = [np.array([0.0, 0.0, height]) for height in heights]
    return Fit(
        places,
        radii,
        frame,
        origin,
        wavenumber,
        local_sources,
        order,
        turns,
        coefficients,
        admittances,
    )


def joining_frame(axis: np.ndarray) -> tuple[np.ndarray, float]:
    """Rotation (rows x, y, z) whose z is along the axis, and the axis' length."""
    length = float(np.linalg.norm(axis))
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(axis / length, across), axis / length]), length


def incident_orders(
    cosine: np.ndarray,
    sine: np.ndarray,
    radius: float,
    height: float,
    sources: np.ndarray,
    wavenumber: complex,
    admittance: complex,
) -> np.ndarray:
    """Azimuthal orders of the incident slope on the rings of a sphere: (latitudes, orders as np.fft gives them, N)."""
    azimuth = 2.0 * np.pi * np.arange(len(cosine) + 2) / (len(cosine) + 2)
    ring = [
        np.outer(sine, np.cos(azimuth)),
        np.outer(sine, np.sin(azimuth)),
        np.outer(cosine, np.ones_like(azimuth)),
    ]
    normals = np.stack(ring, axis=2).reshape(-1, 3)
    skin = [0.0, 0.0, height] + radius * normals
    parts = []
    for first in range(0, len(sources), 50):
        slope = incident_rise(skin, normals, sources[first : first + 50], wavenumber, admittance)
        slope = slope.reshape(len(cosine), len(azimuth), -1)
        parts.append(np.fft.fft(slope, axis=1) / len(azimuth))
    return np.concatenate(parts, axis=2)
