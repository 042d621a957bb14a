"""Steepening of strong sound: the fraction of the linear pressure that remains in real air.

The sound at a focus is a sum of plane waves, one for each patch of the array. By perturbation
theory of the isentropic Euler equations, every pair of waves generates a second harmonic (second
order), and every pair together with a third wave reduces the fundamental (third order). Parallel
waves interact over their whole path; crossing waves hardly interact. A box of boards therefore
loses almost no pressure where a single board loses a quarter. ``benchmarks/nonlinear.py`` compares
the estimate with the Euler equations.

Sources
-------
- M. F. Hamilton, D. T. Blackstock, "On the coefficient of nonlinearity β in nonlinear acoustics",
  J. Acoust. Soc. Am. 83, 74 (1988): two plane waves that cross at an angle.
- D. T. Blackstock, "Connection between the Fay and Fubini solutions for plane sound waves of finite
  amplitude", J. Acoust. Soc. Am. 39, 1019 (1966): Fubini's harmonics J_n(nσ)·2/(nσ).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex128, Float32, Float64, Num, Real

from airtact.acoustics.scene import Plane, Scene
from airtact.acoustics.sources import Monopoles
from airtact.acoustics.target_points import outward
from airtact.errors import one_line, points_of

# B/A of air: its ratio of specific heats minus 1
NONLINEARITY = 0.4


@dataclass(frozen=True, eq=False)
class Steepening:
    """Nonlinear steepening of the sound at F points, which moves energy into harmonics.

    Linear acoustics, as used by all solvers, overestimates strong pressures. Use ``kept`` for the
    fraction of the pressure that remains. ``second`` and ``depletion`` are perturbation results,
    which exceed the true values if the steepening is strong. They are NaN where no sound of the
    array arrives directly.

    Attributes
    ----------
    second : (F,) peak pressure of the second harmonic divided by that of the fundamental in linear
        acoustics, by second-order theory.
    depletion : (F,) fraction of the fundamental's pressure that is lost to harmonics, by
        third-order theory.
    doubt : (F,) relative error of the pressure due to simplified bodies, compared with the solved
        field; 0 if the simplification is exact.
    """

    second: Float64[np.ndarray, "points"]
    depletion: Float64[np.ndarray, "points"]
    doubt: Float64[np.ndarray, "points"]

    def __repr__(self) -> str:
        return one_line(self, f"second harmonic up to {self.second_harmonic.max():.0%}")

    def scaled(self, factor: float) -> "Steepening":
        """Return the steepening for the same drive multiplied by a factor."""
        return replace(self, second=factor * self.second, depletion=factor**2 * self.depletion)

    @property
    def error(self) -> Float64[np.ndarray, "points"]:
        """(F,) estimated relative error of the ratio ``kept``."""
        # The largest error in the benchmark is 0.04 of the square. The doubt about the amplitude is
        # multiplied by the largest possible depletion, that of a plane wave.
        return (0.05 + 0.5 * self.doubt) * self.second**2

    @property
    def kept(self) -> Float64[np.ndarray, "points"]:
        """(F,) ratio of the fundamental to the linear pressure; NaN where it is too uncertain.

        >>> wave = Steepening(np.array([0.25]), np.array([0.5**2 / 8]), np.zeros(1))
        >>> wave.kept.round(3).tolist()  # a plane wave at σ = 0.5: 2 J₁(0.5)/0.5
        [0.969]
        """
        # σ of the plane wave with the same third-order loss is √(8 depletion). Fubini's result for
        # that wave, 2 J₁(σ)/σ, also holds for foci, in their case up to σ = 2. This is its power
        # series in −σ²/4; up to there, the terms left out are below 1e-11.
        loss = np.clip(self.depletion, 0.0, 0.5)
        series = [1.0 / (math.factorial(n) * math.factorial(n + 1)) for n in range(9)]
        kept = np.polynomial.polynomial.polyval(-2.0 * loss, series)
        return np.where((self.depletion <= 0.5) & (self.error <= 0.2), kept, np.nan)

    @property
    def second_harmonic(self) -> Float64[np.ndarray, "points"]:
        """(F,) ratio of the second harmonic to the fundamental, or NaN where ``kept`` is NaN.

        For ratios up to 1, the relative error is at most 15 %.
        """
        # It feeds the third and higher harmonics. The factor 0.4 fits the computed foci.
        saturated = self.second / (1.0 + 0.4 * self.second**2)
        return np.where(np.isfinite(self.kept), saturated, np.nan)


def steepening(
    scene: Scene,
    sources: Monopoles,
    points: Real[np.ndarray, "points 3"],
    pressures: Num[np.ndarray, "points"],
    excitation: int = 0,
) -> Steepening:
    """Estimate how much the sound of an array has steepened at its foci.

    Parameters
    ----------
    scene : the air and the bodies in it.
    sources : the face points of the array; see ``drive_sources``.
    points : (F, 3) foci [m]. The estimate is valid only within about a wavelength of a focus.
        Beyond a focus, it overestimates the loss by up to 10 % of the pressure.
    pressures : (F,) linear pressure at the foci [Pa].
    excitation : index of the excitation for which the steepening is estimated.
    """
    points = points_of(points, "points", least=0)
    medium = scene.medium
    stiffness = medium.density * medium.sound_speed**2
    rows = []
    for point, pressure in zip(points, pressures, strict=True):
        waves = _waves_at(scene, sources, excitation, point)
        total = abs(waves.pressure.sum())
        if total == 0.0:
            # All direct sound is behind the skin: what arrives came around the body.
            unknown = np.nan if pressure != 0.0 else 0.0
            rows.append((unknown, unknown, 0.0))
            continue
        waves = waves.patches()
        rows.append(
            (
                abs(_second_order(waves)) / stiffness,
                _third_order(waves) / stiffness**2,
                abs(abs(pressure) / total - 1.0),
            )
        )
    second, depletion, doubt = np.array(rows, dtype=np.float64).reshape(-1, 3).T
    return Steepening(second, depletion, doubt)


@dataclass(frozen=True, eq=False)
class _Waves:
    """Plane waves at a focus.

    Attributes
    ----------
    pressure : (N,) pressure of each wave [Pa].
    direction : (N, 3) direction of each wave. The mean of several sources has a
        length below 1, so that products of directions are mean cosines.
    path : length of the paths times the wavenumber [rad].
    """

    pressure: Complex128[np.ndarray, "waves"]
    direction: Float64[np.ndarray, "waves 3"]
    path: float

    def patches(self) -> "_Waves":
        """Combine waves of neighbouring directions to at most 128."""
        count = len(self.pressure)
        order = np.arange(count)
        starts = order
        if count > 128:
            # Halve all parts seven times across their widest axes, without SciPy's trees, whose
            # import takes longer than the whole estimate.
            starts = np.zeros(1, dtype=np.int64)
            for parts in 2 ** np.arange(1, 8):
                part = np.repeat(np.arange(len(starts)), np.diff(starts, append=count))
                direction = self.direction[order]
                width = np.maximum.reduceat(direction, starts)
                width -= np.minimum.reduceat(direction, starts)
                along = direction[np.arange(count), width.argmax(axis=1)[part]]
                order = order[np.argsort(along + 3.0 * part)]  # parts stay in order
                starts = np.arange(parts) * count // parts
        weight = np.abs(self.pressure)[order]
        direction = np.add.reduceat(weight[:, None] * self.direction[order], starts)
        # Waves in exactly the same direction would resonate and give 0/0. This length separates
        # them by a hundredth of a radian over the path.
        longest = np.sqrt(1.0 - min(0.02 / self.path, 0.5))
        length = np.linalg.norm(direction, axis=1)
        length = np.maximum(np.add.reduceat(weight, starts), length / longest)
        return _Waves(
            np.add.reduceat(self.pressure[order], starts), direction / length[:, None], self.path
        )


def _waves_at(
    scene: Scene, sources: Monopoles, excitation: int, point: Float64[np.ndarray, "3"]
) -> _Waves:
    """Return the wave of each source and of its images at a point.

    Skin near the point reflects like its tangent plane; bodies farther away are ignored.
    """
    positions = sources.positions
    strengths = sources.strengths[:, excitation]
    for plane in [*scene.planes, *_skin_near(scene, point)]:
        front = plane.height(positions) > -1e-6
        positions = np.concatenate([positions[front], plane.image(positions[front])])
        strengths = np.tile(strengths[front], 2)
    # Sources in reflecting boards have half the strength, because the boards double it.
    strengths = 2.0 * strengths if scene.boards else strengths
    loud = strengths != 0.0
    away = point - positions[loud]
    distance = np.linalg.norm(away, axis=1)
    pressure = strengths[loud] * np.exp(1j * scene.wavenumber * distance) / distance
    if not len(pressure):
        return _Waves(pressure, away, 0.0)
    path = np.average(distance, weights=np.abs(pressure))
    return _Waves(pressure, away / distance[:, None], scene.wavenumber.real * float(path))


def _skin_near(scene: Scene, point: Float64[np.ndarray, "3"]) -> list[Plane]:
    """Return the tangent plane of a body within half a wavelength of a point, if there is one."""
    depth = float(scene.depth(point[None])[0])
    if not -depth < scene.wavelength / 2.0:
        return []
    (normal,) = outward(scene.depth, point[None])
    return [Plane(point + depth * normal, normal)]


def _second_order(waves: _Waves) -> complex:
    """Return the ratio of second harmonic to squared fundamental at the focus, times P ρc² [Pa]."""
    forced, free = _second_harmonic(waves.direction @ waves.direction.T, waves.path)
    pressure = waves.pressure
    return 2.0 * complex(pressure @ (forced * (1.0 - free)) @ pressure) / pressure.sum()


def _second_harmonic(cosine: np.ndarray, path: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the second harmonic of two plane waves of unit pressure that cross at an angle.

    The product of the waves, e^{i(k₁+k₂)x}, forces a wave that solves (∇² + 4k²)P₂ = 2βk²/(ρc²)
    P₁². A free wave e^{2ikx} in the same direction cancels the forced wave at the array.

    Returns
    -------
    The amplitude of the forced wave, times ρc²/2 [Pa], and the negative ratio of the free wave
    to the forced wave.
    """
    square = np.maximum(2.0 + 2.0 * cosine, 0.0)  # of |k₁ + k₂|/k
    gap = 4.0 - square
    coupling = NONLINEARITY / 2.0 + cosine + ((1.0 - cosine) / 2.0) ** 2
    return coupling / gap, np.exp(1j * path * gap / (2.0 + np.sqrt(square)))


def _third_order(waves: _Waves) -> float:
    """Return the lost fraction of the fundamental at the focus, times (ρc²)² [Pa²]."""
    pressure = waves.pressure
    cosine = waves.direction @ waves.direction.T
    first, other = np.triu_indices(len(pressure))
    between = cosine[first, other]
    forced, free = _second_harmonic(between, waves.path)
    pairs = forced * pressure[first] * pressure[other]
    pairs[first != other] *= 2.0
    # All pairs with every fourth wave, which represents its neighbours. Single
    # precision takes a fifth of the time, and blocks of this size fit the cache.
    third = pressure[2::4] if len(pressure) > 4 else pressure
    cosine = (cosine[:, 2::4] if len(pressure) > 4 else cosine).astype(np.float32)
    # The floor avoids a division by 0 for opposite waves, which have no middle direction.
    square = np.maximum(2.0 + 2.0 * between, 1e-6).astype(np.float32)[:, None]
    free = free.astype(np.complex64)[:, None]
    lost = 0.0 + 0.0j
    for part in np.array_split(np.arange(len(pairs)), 1 + len(pairs) // 2000):
        along = cosine[first[part]] + cosine[other[part]]
        middle = along / np.sqrt(square[part])
        # The wave of frequency 2ω − ω, from the free and the forced second harmonic
        coupling = NONLINEARITY / 2.0 + middle - 8.0 * ((1.0 - middle) / 2.0) ** 2
        response = free[part] * _response(5.0 - 4.0 * middle, waves.path)
        response -= _response(square[part] + 1.0 - 2.0 * along, waves.path)
        lost -= 2.0 * complex(pairs[part] @ (coupling * response) @ third.conj())
    lost *= pressure.sum().conj() / third.sum().conj() / pressure.sum()
    # Patches are too coarse if the phase of interacting waves varies by a radian within a patch.
    # The size of the error comes from finer patches in ten arrays.
    spread = waves.path * np.average(
        1.0 - np.sum(waves.direction**2, axis=1), weights=np.abs(pressure)
    )
    return lost.real / (1.0 + 0.41 * float(spread) ** 2)


def _response(square: Float32[np.ndarray, "pairs waves"], path: float) -> np.ndarray:
    """Return the response of the fundamental to a force e^{iκx} along the path, given κ²/k².

    The response is (1 − e^{−iφ})/(κ² − 1) with φ = (κ − 1) times the path, in a form that
    avoids 0/0.
    """
    wavenumber = np.sqrt(np.maximum(square, 0.0))
    half = np.float32(0.5 * path) * (wavenumber - np.float32(1.0)) + np.float32(1e-6)
    factor = np.sin(half) / half * np.float32(path) / (wavenumber + np.float32(1.0))
    response = np.empty(square.shape, dtype=np.complex64)
    response.real = factor * np.sin(half)
    response.imag = factor * np.cos(half)
    return response
