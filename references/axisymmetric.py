"""Sound-hard bodies of revolution by rings of monopoles inside them: independent of every solver in src.

A meridian curve is turned about the z axis. Rings of monopoles stand a given depth under it and
rings of fitting points on it, all with the same number of points around, so the matrix of ∂p/∂n is
block-circulant and a discrete Fourier transform along the azimuth leaves one small least-squares
problem for each order (A. Karageorghis and G. Fairweather, "The method of fundamental solutions for
axisymmetric potential problems", Int. J. Numer. Meth. Engng 44 (1999) 1653). The residual ∂p/∂n at
surface points between the fitted ones, and the change from a coarser fit, bound the error.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

import airtact as at

SAMPLES = 2000
"""Samples of each smooth piece of a meridian, between which its length is interpolated."""

Piece = Callable[[np.ndarray], np.ndarray]
"""Points (P, 2) of a smooth piece of a meridian, distance from the axis and height [m], at parameters 0 to 1."""


def arc(
    middle: tuple[float, float], semi_axes: tuple[float, float], start: float, end: float
) -> Piece:
    """Part of an ellipse or circle about ``middle`` [m], from one angle to another [degrees]."""
    first, last = np.radians([start, end])

    def points(share: np.ndarray) -> np.ndarray:
        angle = first + (last - first) * share
        return np.stack(
            [middle[0] + semi_axes[0] * np.cos(angle), middle[1] + semi_axes[1] * np.sin(angle)],
            axis=1,
        )

    return points


def line(start: tuple[float, float], end: tuple[float, float]) -> Piece:
    """Straight piece [m]."""
    return lambda share: np.asarray(start) + share[:, None] * (np.asarray(end) - np.asarray(start))


@dataclass(frozen=True)
class Meridian:
    """Curve whose turning about the z axis is the surface, the body on its left; from pole to pole, or closed.

    ``wall`` is the least thickness of the body across [m]: monopoles stand at most a third of it
    deep.
    """

    pieces: Sequence[Piece]
    wall: float

    @property
    def lengths(self) -> np.ndarray:
        """Length of each piece [m]."""
        return np.array([_lengths(piece)[-1] for piece in self.pieces])

    def at(self, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (P, 2) and outward normals (P, 2) at lengths along the curve [m]."""
        bounds = np.concatenate([[0.0], np.cumsum(self.lengths)])
        which = np.clip(np.searchsorted(bounds, lengths, side="right") - 1, 0, len(self.pieces) - 1)
        points, normals = np.empty((2, len(lengths), 2))
        for index, piece in enumerate(self.pieces):
            own = which == index
            share = np.interp(
                lengths[own] - bounds[index], _lengths(piece), np.linspace(0, 1, SAMPLES + 1)
            )
            points[own] = piece(share)
            along = piece(share + 1e-6) - piece(share - 1e-6)
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            normals[own] = np.stack([along[:, 1], -along[:, 0]], axis=1)
        return points, normals

    def spaced(
        self, spacing: Callable[[np.ndarray], np.ndarray], offset: float = 0.5
    ) -> np.ndarray:
        """Lengths along the curve whose steps are about a spacing at the local points [m]."""
        total = float(self.lengths.sum())
        fine = (np.arange(20000) + 0.5) / 20000 * total
        density = 1.0 / spacing(self.at(fine)[0])
        count = np.concatenate([[0.0], np.cumsum(density) * total / 20000])
        number = int(np.ceil(count[-1]))
        wanted = (np.arange(number) + offset) / number * count[-1]
        return np.interp(wanted, count, np.linspace(0, total, 20001))


def _lengths(piece: Piece) -> np.ndarray:
    points = piece(np.linspace(0, 1, SAMPLES + 1))
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def spheroid(equatorial: float, polar: float, height: float = 0.0) -> Meridian:
    """Spheroid of two semi-axes about a point of the axis [m]."""
    thin = min(equatorial, polar**2 / equatorial if polar < equatorial else equatorial**2 / polar)
    return Meridian([arc((0.0, height), (equatorial, polar), -90, 90)], 2 * thin)


def upright_capsule(radius: float, length: float, height: float = 0.0) -> Meridian:
    """Capsule along the axis [m]."""
    low, high = height - length / 2, height + length / 2
    ends = arc((0, low), (radius, radius), -90, 0), arc((0, high), (radius, radius), 0, 90)
    return Meridian(
        [ends[0], line((radius, low), (radius, high)), ends[1]] if length else [*ends], 2 * radius
    )


def torus(ring: float, tube: float) -> Meridian:
    """Torus with a ring radius and a tube radius [m]."""
    return Meridian([arc((ring, 0), (tube, tube), -180, 180)], 2 * tube)


def shell(outer: float, wall: float, opening: float) -> Meridian:
    """Spherical shell with a round rim that is open upwards: 90 degrees is a bowl, less a cavity."""
    inner, middle = outer - wall, outer - wall / 2
    cut = np.radians(opening)
    rim = (middle * np.sin(cut), middle * np.cos(cut))
    turn = 90 - opening
    pieces = [
        arc((0, 0), (outer, outer), -90, turn),
        arc(rim, (wall / 2, wall / 2), turn, turn + 180),
        arc((0, 0), (inner, inner), turn, -90),
    ]
    return Meridian(pieces, wall)


def cup(radius: float, height: float, wall: float) -> Meridian:
    """Cylindrical cup, open upwards, with a round rim and rounded outer and inner edges at its floor."""
    inner, bend = radius - wall, 1.5 * wall
    within = bend - wall / 2
    pieces = [
        line((0, 0), (radius - bend, 0)),
        arc((radius - bend, bend), (bend, bend), -90, 0),
        line((radius, bend), (radius, height)),
        arc((radius - wall / 2, height), (wall / 2, wall / 2), 0, 180),
        line((inner, height), (inner, wall + within)),
        arc((inner - within, wall + within), (within, within), 0, -90),
        line((inner - within, wall), (0, wall)),
    ]
    return Meridian(pieces, 0.9 * wall)


@dataclass(frozen=True)
class Fit:
    """Rings of monopoles [m] with their strengths (rings, around, sources) [Pa·m]."""

    rings: np.ndarray
    strengths: np.ndarray
    wavenumber: complex
    sources: np.ndarray
    residual: float

    def pressure(self, points: np.ndarray) -> np.ndarray:
        """Total pressure (P, N) [Pa] of each unit source at points outside (P, 3)."""
        return _waves(points, self.sources, self.wavenumber) + self.scattered(points)

    def scattered(self, points: np.ndarray) -> np.ndarray:
        """Scattered pressure (P, N) [Pa] of each unit source at points outside (P, 3)."""
        around = self.strengths.shape[1]
        places = _turned(self.rings, around).reshape(-1, 3)
        strengths = self.strengths.reshape(len(places), -1)
        total = np.zeros((len(points), strengths.shape[1]), dtype=complex)
        for block in np.array_split(
            np.arange(len(places)), 1 + len(points) * len(places) // 4_000_000
        ):
            total += _waves(points, places[block], self.wavenumber) @ strengths[block]
        return total


def fitted(
    meridians: Sequence[Meridian],
    wavenumber: complex,
    sources: np.ndarray,
    fineness: float = 2.0,
    around: int = 0,
) -> Fit:
    """Fit rings of monopoles, ``fineness`` of them per depth, to ∂p/∂n = 0 on bodies beside unit sources (N, 3)."""
    wavelength = 2 * np.pi / abs(wavenumber)
    rings, points, normals, checks = [], [], [], []
    finest = np.inf
    for own in meridians:
        others = [
            other.at(np.linspace(0, other.lengths.sum(), 4000))[0]
            for other in meridians
            if other is not own
        ]
        depth = _depth(own, others, wavelength)
        lengths = own.spaced(lambda p, depth=depth: np.minimum(depth(p) / fineness, wavelength / 8))
        base, outward = own.at(lengths)
        ring = base - depth(base)[:, None] * outward
        rings.append(ring[ring[:, 0] > 1e-9])
        finest = min(finest, float((depth(base) / np.maximum(base[:, 0], 1e-9)).min()))
        half = own.spaced(
            lambda p, depth=depth: 0.5 * np.minimum(depth(p) / fineness, wavelength / 8)
        )
        for lists, where in ((1, half), (0, own.spaced(lambda p, depth=depth: depth(p), 0.31))):
            at_, out = own.at(where)
            if lists:
                points.append(at_)
                normals.append(out)
            else:
                checks.append((at_, out))
    around = around or int(2 ** np.ceil(np.log2(max(32, 2 * np.pi * fineness / finest))))
    source_rings = np.concatenate(rings)
    fit_points, fit_normals = np.concatenate(points), np.concatenate(normals)
    angles = 2 * np.pi * np.arange(around) / around
    placed, outward = _turned(fit_points, around), _turned(fit_normals, around)
    incident = _slopes(placed.reshape(-1, 3), outward.reshape(-1, 3), sources, wavenumber)
    right = np.fft.fft(incident.reshape(len(fit_points), around, -1), axis=1)
    sizes = np.abs(right).max(axis=(0, 2))
    orders = np.flatnonzero(sizes > 1e-9 * sizes.max())
    kernel = np.concatenate(
        [
            np.fft.fft(_ring_kernel(at_, out, source_rings, angles, wavenumber), axis=2)[
                :, :, orders
            ]
            for at_, out in zip(
                np.array_split(fit_points, 40), np.array_split(fit_normals, 40), strict=True
            )
        ]
    )
    strengths = np.zeros((len(source_rings), around, len(sources)), dtype=complex)
    weight = np.sqrt(fit_points[:, 0] / fit_points[:, 0].max())[:, None]
    for index, order in enumerate(orders):
        matrix = weight * kernel[:, :, index]
        scale = np.linalg.norm(matrix, axis=0)
        found = np.linalg.lstsq(matrix / scale, -weight * right[:, order], rcond=1e-12)[0]
        strengths[:, order] = found / scale[:, None]
    fit = Fit(source_rings, np.fft.ifft(strengths, axis=1), wavenumber, sources, np.nan)
    return Fit(fit.rings, fit.strengths, wavenumber, sources, _residual(fit, checks))


def _depth(
    own: Meridian, others: Sequence[np.ndarray], wavelength: float
) -> Callable[[np.ndarray], np.ndarray]:
    """Depth of the monopoles under points of a meridian (P, 2): less beside thin walls and other bodies."""

    def depth(points: np.ndarray) -> np.ndarray:
        found = np.full(len(points), min(own.wall / 3, 0.35 * wavelength))
        for other in others:
            gap = np.sqrt(((points[:, None] - other[None, ::8]) ** 2).sum(axis=2).min(axis=1))
            radius = own.wall / 2
            images = radius * (1 - np.exp(-np.arccosh(1 + gap / (2 * radius))))
            found = np.minimum(found, 0.75 * images)
        return found

    return depth


def _turned(meridian: np.ndarray, around: int) -> np.ndarray:
    """Turn points or directions (P, 2) of the meridian plane about the axis: (P, around, 3)."""
    angle = 2 * np.pi * np.arange(around) / around
    flat, height = meridian[:, 0, None], meridian[:, 1, None]
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height + 0 * angle], axis=2)


def _ring_kernel(
    points: np.ndarray,
    normals: np.ndarray,
    rings: np.ndarray,
    angles: np.ndarray,
    wavenumber: complex,
) -> np.ndarray:
    """∂p/∂n at points turned by angles, of the monopole of each ring at angle 0: (P, rings, angles)."""
    flat, height = points[:, 0, None, None], points[:, 1, None, None]
    away, up = rings[None, :, 0, None], height - rings[None, :, 1, None]
    cosine = np.cos(angles)
    square = flat**2 + away**2 - 2 * flat * away * cosine + up**2
    along = normals[:, 0, None, None] * (flat - away * cosine) + normals[:, 1, None, None] * up
    distance = np.sqrt(square)
    return (1j * wavenumber - 1 / distance) * np.exp(1j * wavenumber * distance) * along / square


def _waves(points: np.ndarray, sources: np.ndarray, wavenumber: complex) -> np.ndarray:
    distance = np.linalg.norm(points[:, None] - sources[None], axis=2)
    return np.exp(1j * wavenumber * distance) / distance


def _slopes(
    points: np.ndarray, normals: np.ndarray, sources: np.ndarray, wavenumber: complex
) -> np.ndarray:
    offset = points[:, None] - sources[None]
    distance = np.linalg.norm(offset, axis=2)
    along = np.einsum("pnd,pd->pn", offset, normals)
    return (
        (1j * wavenumber - 1 / distance) * np.exp(1j * wavenumber * distance) * along / distance**2
    )


def _residual(fit: Fit, checks: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Norm of ∂p/∂n at surface points that were not fitted, over that of the incident field."""
    defect = incident = 0.0
    places = _turned(fit.rings, fit.strengths.shape[1]).reshape(-1, 3)
    strengths = fit.strengths.reshape(len(places), -1)
    pick = np.random.default_rng(5)
    for points, normals in checks:
        chosen = pick.choice(
            len(points), min(60, len(points)), replace=False, p=points[:, 0] / points[:, 0].sum()
        )
        turn = pick.uniform(0, 2 * np.pi, len(chosen))
        place, outward = (
            np.stack(
                [a[chosen, 0] * np.cos(turn), a[chosen, 0] * np.sin(turn), a[chosen, 1]], axis=1
            )
            for a in (points, normals)
        )
        arriving = _slopes(place, outward, fit.sources, fit.wavenumber)
        total = arriving.copy()
        for block in np.array_split(np.arange(len(places)), 1 + len(places) // 20000):
            total += _slopes(place, outward, places[block], fit.wavenumber) @ strengths[block]
        defect += np.linalg.norm(total) ** 2
        incident += np.linalg.norm(arriving) ** 2
    return float(np.sqrt(defect / incident))


def pressure_at(
    meridians: Sequence[Meridian],
    wavenumber: complex,
    sources: np.ndarray,
    receivers: np.ndarray,
    wanted: float = np.inf,
) -> tuple[np.ndarray, float]:
    """Total pressure (P, N) [Pa] of unit sources (N, 3) at receivers (P, 3), and its own relative error.

    The set farther from the bodies becomes the sources, by reciprocity. Rings are made finer until
    the error is as ``wanted``, if they can: near the resonance of a cavity the coarser ones are
    some percent off.
    """
    before = pressure = fitted(meridians, wavenumber, sources, 1.7).pressure(receivers)
    error = np.inf
    for fineness in (2.2, 3.0, 4.0, 5.5):
        fit = fitted(meridians, wavenumber, sources, fineness)
        pressure = fit.pressure(receivers)
        error = max(
            np.linalg.norm(pressure - before) / np.linalg.norm(pressure), 0.1 * fit.residual
        )
        if error < wanted:
            break
        before = pressure
    return pressure, float(error)


def _row_lengths(meridian: Meridian, edge: float) -> np.ndarray:
    """Lengths along the meridian of the rows of vertices [m], an even number in each piece."""
    return np.concatenate(
        [
            start + length * np.arange(count) / count
            for start, length, count in zip(
                np.concatenate([[0.0], np.cumsum(meridian.lengths)[:-1]]),
                meridian.lengths,
                2 * np.maximum(1, np.ceil(meridian.lengths / edge / 2)).astype(int),
                strict=True,
            )
        ]
    )


def surface(meridian: Meridian, edge: float) -> at.Surface:
    """Mesh the turned meridian with triangles whose middles lie on it too; the edges are about ``edge`` long [m]."""
    closed = bool(meridian.at(np.zeros(1))[0][0, 0] > 1e-9)
    steps = _row_lengths(meridian, edge)
    stops = np.append(steps, meridian.lengths.sum())
    widest = float(meridian.at(stops)[0][:, 0].max())
    around = max(12, int(np.ceil(2 * np.pi * widest / edge)))
    angles = 2 * np.pi * np.arange(around) / around

    def point(length: np.ndarray, angle: np.ndarray) -> np.ndarray:
        flat = meridian.at(length)[0]
        return np.stack(
            [flat[:, 0] * np.cos(angle), flat[:, 0] * np.sin(angle), flat[:, 1]], axis=1
        )

    parameters = []
    inner = stops[:-1] if closed else stops[1:-1]
    for row, length in enumerate(inner):
        parameters += [(length, angle + np.pi / around * (row % 2)) for angle in angles]
    rows = np.arange(len(inner) * around).reshape(len(inner), around)
    triangles = []  # corners as (index, length, angle), so that middles follow from the parameters
    given = np.array(parameters)
    pairs = [(i, (i + 1) % len(inner)) for i in range(len(inner) if closed else len(inner) - 1)]
    shift = float(meridian.lengths.sum())
    for low, high in pairs:
        for j in range(around):
            a, b = rows[low, j], rows[low, (j + 1) % around]
            k = j if low % 2 == 0 else (j + 1) % around
            c, d = rows[high, k], rows[high, (k - 1) % around]
            # d stands above a and to its left by half a step, c to its right
            triangles += [(a, b, c), (a, c, d)]
    vertices = point(given[:, 0], given[:, 1])
    parts = [vertices]
    if not closed:
        south, north = len(vertices), len(vertices) + 1
        parts.append(point(np.array([0.0, shift]), np.zeros(2)) * [0, 0, 1])
        for j in range(around):
            triangles += [
                (rows[0, (j + 1) % around], rows[0, j], south),
                (rows[-1, j], rows[-1, (j + 1) % around], north),
            ]
    vertices = np.concatenate(parts)
    index = np.array(triangles)
    lengths = np.append(given[:, 0], [0.0, shift])
    turns = np.append(given[:, 1], [0.0, 0.0])
    middles = np.empty((len(index), 3, 3))
    for edge_of in range(3):
        one, two = index[:, edge_of], index[:, (edge_of + 1) % 3]
        first, second, angle, other = (
            lengths[one].copy(),
            lengths[two].copy(),
            turns[one].copy(),
            turns[two].copy(),
        )
        pole_one, pole_two = one >= len(given), two >= len(given)
        angle[pole_one], other[pole_two] = other[pole_one], angle[pole_two]
        wrap = np.abs(first - second) > shift / 2
        low = np.minimum(first, second)
        mid = np.where(
            wrap & closed,
            low + (np.maximum(first, second) - low - shift) / 2,
            0.5 * (first + second),
        )
        turn = angle + 0.5 * (np.mod(other - angle + np.pi, 2 * np.pi) - np.pi)
        middles[:, edge_of] = point(np.mod(mid, shift) if closed else mid, turn)
    return at.Surface(vertices, index, midpoints=middles)
