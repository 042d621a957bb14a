"""Monopoles in open air, in closed form: p(x) = Σ_j s_j e^{ik|x - x_j|} / |x - x_j|."""

from dataclasses import dataclass

import numpy as np

from airtact.acoustics.planes import before_planes, with_images
from airtact.acoustics.scene import Scene, check_sources
from airtact.acoustics.solvers.arrays import (
    ComplexPairs,
    Mask,
    Points,
    Pressures,
    SourcePoints,
    Vectors,
)
from airtact.acoustics.solvers.problem import (
    PLANES,
    RadiatedField,
    Solver,
    SolveReport,
    SurfaceField,
)
from airtact.acoustics.sources import STANDS_ON, Monopoles, nearest_source
from airtact.errors import InvalidInput, counted

# Pairs of points and sources that are evaluated at once
MAX_PAIRS = 1 << 20


def unit_monopoles(points: Points, positions: SourcePoints, wavenumber: complex) -> ComplexPairs:
    """Pressure e^{ikr}/r of monopoles of 1 Pa·m in open air [Pa]; no point may be on a monopole."""
    distance = np.sqrt(np.sum((points[:, None, :] - positions[None, :, :]) ** 2, axis=-1))
    return np.exp(1j * wavenumber * distance) / distance


def open_air_pressure(points: Points, sources: Monopoles, wavenumber: complex) -> Pressures:
    """Pressure of ``sources`` in open air [Pa] of each excitation at points (P, 3) [m]."""
    rows = max(1, MAX_PAIRS // max(1, len(sources.positions)))
    pressure = np.zeros((len(points), sources.strengths.shape[1]), dtype=np.complex128)
    for first in range(0, len(points), rows):
        block = slice(first, first + rows)
        pressure[block] = (
            unit_monopoles(points[block], sources.positions, wavenumber) @ sources.strengths
        )
    return pressure


@dataclass(frozen=True, eq=False, repr=False)
class OpenAirField(RadiatedField):
    """The field of monopoles, and of their images in a plane, in a scene without obstacles."""

    @property
    def on_surface(self) -> SurfaceField:
        """No surface: arrays of length 0."""
        return SurfaceField.empty(self.sources)

    def _at(self, points: Vectors) -> Pressures:
        pressure = open_air_pressure(points, self._emitting, self.scene.wavenumber)
        pressure[~self._valid(points)] = np.nan
        return pressure

    def _scattered_at(self, points: Vectors) -> Pressures:
        # only the images in a plane scatter
        scattered = np.zeros((len(points), self.excitations), dtype=np.complex128)
        for plane in self.scene.planes:
            images = Monopoles(plane.image(self.sources.positions), self.sources.strengths)
            on = nearest_source(points, images, STANDS_ON)[0] < STANDS_ON
            scattered[~on] += open_air_pressure(points[~on], images, self.scene.wavenumber)
            scattered[on] = np.nan
        scattered[~self._valid(points)] = np.nan
        return scattered

    def _valid(self, points: Vectors) -> Mask:
        return before_planes(self.scene.planes, points)

    @property
    def _emitting(self) -> Monopoles:
        return with_images(self.scene.planes, self.sources)


@dataclass(frozen=True)
class FreeField(Solver):
    """Sound in open air or before a plane in closed form, for scenes without obstacles."""

    def radiate(self, scene: Scene, sources: Monopoles) -> OpenAirField:
        """Field of the monopoles in a scene without obstacles.

        Raises
        ------
        InvalidInput
            If the scene has obstacles, or an argument is of another kind.
        """
        check_sources(scene, sources, planes=True)
        if len(scene.obstacles) > 0:
            bodies = counted(len(scene.obstacles), "obstacle", "obstacles")
            raise InvalidInput(
                f"FreeField solves for open air only, and the scene has {bodies}; "
                "take a solver that scatters, such as BoundaryElement.",
                code="not_supported",
            )
        settings = {PLANES: len(scene.planes)} if scene.planes else {}
        return OpenAirField(scene, sources, SolveReport(solver="FreeField", settings=settings))
