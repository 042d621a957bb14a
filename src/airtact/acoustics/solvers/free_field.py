"""Monopoles in open air, in closed form: p(x) = Σ_j s_j e^{ik|x - x_j|} / |x - x_j|."""

from dataclasses import dataclass

import numpy as np

from airtact.acoustics.scene import Scene, before_planes, check_sources
from airtact.acoustics.solvers.problem import (
    PLANES,
    RadiatedField,
    Solver,
    SolveReport,
    SurfaceField,
)
from airtact.acoustics.solvers.shared import (
    Mask,
    Pressures,
    Vectors,
)
from airtact.acoustics.sources import STANDS_ON, Monopoles, nearest_source
from airtact.errors import InvalidInput, counted


@dataclass(frozen=True, eq=False, repr=False)
class OpenAirField(RadiatedField):
    """The field of monopoles, and of their images in a plane, in a scene without obstacles."""

    @property
    def on_surface(self) -> SurfaceField:
        """A surface field without points, because there is no surface."""
        return SurfaceField.empty(self.sources)

    def _at(self, points: Vectors) -> Pressures:
        pressure = self._incident(points)
        for plane in self.scene.planes:
            pressure += self._incident(plane.image(points))
        pressure[~self._valid(points)] = np.nan
        return pressure

    def _scattered_at(self, points: Vectors) -> Pressures:
        # Only the images in a plane count as scattered.
        scattered = np.zeros((len(points), self.excitations), dtype=np.complex128)
        for plane in self.scene.planes:
            images = Monopoles(plane.image(self.sources.positions), self.sources.strengths)
            on = nearest_source(points, images, STANDS_ON)[0] < STANDS_ON
            scattered[~on] += self._incident(plane.image(points[~on]))
            scattered[on] = np.nan
        scattered[~self._valid(points)] = np.nan
        return scattered

    def _valid(self, points: Vectors) -> Mask:
        return before_planes(self.scene.planes, points)


@dataclass(frozen=True)
class FreeField(Solver):
    """Solver for scenes without obstacles, in closed form: open air, or air in front of a plane."""

    def radiate(self, scene: Scene, sources: Monopoles) -> OpenAirField:
        """Return the field of the monopoles in a scene without obstacles.

        Raises
        ------
        InvalidInput
            If the scene has obstacles, or an argument has the wrong type.
        """
        check_sources(scene, sources, planes=True)
        if len(scene.obstacles) > 0:
            bodies = counted(len(scene.obstacles), "obstacle", "obstacles")
            raise InvalidInput(
                f"FreeField only solves for open air, but the scene has {bodies}; use a solver "
                "for bodies, such as BoundaryElement.",
                code="not_supported",
            )
        settings = {PLANES: len(scene.planes)} if scene.planes else {}
        return OpenAirField(scene, sources, SolveReport(solver="FreeField", settings=settings))
