"""The field that finite elements found: from the tetrahedra beside the bodies, from a surface integral elsewhere."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from jaxtyping import Bool

from airtact.acoustics.scene import CONTACT, Scene
from airtact.acoustics.solvers.arrays import Gradients, Mask, Points, Pressures
from airtact.acoustics.solvers.fem.meshing.symmetry import TOLERANCE, images
from airtact.acoustics.solvers.fem.solution import PointSources, Solution, solve
from airtact.acoustics.solvers.fem.system import System
from airtact.acoustics.solvers.problem import (
    DIFFERENCE,
    RadiatedField,
    SolveReport,
    SurfaceField,
    receivers,
)
from airtact.acoustics.solvers.velocity import differences, velocity_of
from airtact.acoustics.sources import STANDS_ON, Monopoles, nearest_source
from airtact.checks import in_mm, points_of

NEAR = 0.25
"""Distance from the surfaces, in wavelengths, up to which points and sources count as beside the bodies."""

CLEAR = 1.0
"""Distance from the surfaces, in wavelengths, from which few quadrature points on them suffice."""

TOUCHING = 0.04
"""Distance from a filled body, in wavelengths, up to which a source is a point load for its own surroundings too."""

ROUGH = 0.5
"""Distance from a source that touches an impedance or filled body, in wavelengths, up to which little is right."""


@dataclass(frozen=True, eq=False)
class FiniteField(RadiatedField):
    """The field of some monopoles, as ``FiniteElement`` solved it.

    Attributes
    ----------
    from_afar : the solution with the sources beside the bodies as point loads: right away from the
        bodies.
    workspace : whether the whole workspace is meshed and read off the mesh, as the paper does.
    """

    scene: Scene
    sources: Monopoles
    from_afar: Solution
    report: SolveReport
    workspace: bool = False

    __repr__ = RadiatedField.__repr__

    @property
    def system(self) -> System:
        """The assembled equation."""
        return self.from_afar.system

    @property
    def on_surface(self) -> SurfaceField:
        """Total pressure at the quadrature points of the surfaces."""
        length, nodes, mirrors = self.scene.wavelength, self.system.surface, self.system.mirrors
        pressure = np.concatenate(self.from_nearby.at_nodes(nodes)) / length
        points = np.concatenate(images(mirrors, nodes.points)) * length
        tips = np.concatenate(images(mirrors, nodes.points + nodes.normals)) * length
        areas = np.tile(nodes.areas, 2 ** len(mirrors)) * length**2
        return SurfaceField(points, (tips - points) / length, areas, pressure)

    @property
    def from_nearby(self) -> Solution:
        """The solution that is right beside the bodies."""
        return self.from_afar if self.workspace else self._scattering

    @cached_property
    def _scattering(self) -> Solution:
        """The solution for the scattered pressure of all sources but those that touch filled bodies."""
        if not (self.workspace or beside(self.scene, self.sources.positions).any()):
            return self.from_afar
        sources, touching = _scaled(self.scene, self.sources), self._touching_filled
        return solve(
            self.system, sources.chosen(~touching).and_also(self._images), sources.chosen(touching)
        )

    @cached_property
    def _touching_filled(self) -> Bool[np.ndarray, "sources"]:
        return _touching(
            self.scene, self.sources.positions, ("filled",), TOUCHING * self.scene.wavelength
        )

    @cached_property
    def _images(self) -> list[PointSources]:
        """Images of the sources beside bodies that sound does not enter: what is left to solve for is smooth there.

        An image stands as deep in the nearest body as meshed as its source stands off it; where the
        body is too thin to hold it, there is none.
        """
        sources, length = _scaled(self.scene, self.sources), self.scene.wavelength
        near, found = beside(self.scene, self.sources.positions) & ~self._touching_filled, []
        for number in np.flatnonzero(near):
            source = sources.chosen(np.arange(len(near)) == number)
            depths = [
                float(one.surface.depth(source.positions * length)[0])
                for one in self.scene.obstacles
            ]
            nearest = self.scene.obstacles[int(np.argmax(depths))]
            if nearest.boundary == "filled":
                continue
            image = 2 * self.system.nearest_on_surface(source.positions)[0] - source.positions
            if (
                float(nearest.surface.depth(image * length)[0])
                > -0.9 * max(depths) - TOLERANCE * length
            ):
                found.append(PointSources(image, source.strengths))
        return found

    def valid(self, points: Points) -> Mask:
        """Whether points (P, 3) [m] lie outside the bodies, on them or in a filled one; and in the workspace."""
        points = points_of(points, "points", least=0)
        valid = (
            self._in_workspace(points) if self.workspace else np.ones(len(points), dtype=np.bool_)
        )
        for obstacle in self.scene.obstacles:
            if obstacle.boundary != "filled":
                valid &= obstacle.surface.depth(points) <= CONTACT
        return valid

    def at(self, points: Points) -> Pressures:
        """Total pressure [Pa] at points (P, 3) [m], as ``RadiatedField.at``."""
        points = receivers(points, self.sources)
        found = np.full((len(points), self.sources.strengths.shape[1]), np.nan, dtype=np.complex128)
        close, away = self._close_and_away(points)
        length = self.scene.wavelength
        if close.any():
            found[close] = self.from_nearby.total(points[close] / length) / length
        if away.any():
            found[away] = self._total_away(points[away])
        return found

    def scattered_at(self, points: Points) -> Pressures:
        """Scattered pressure [Pa] at points (P, 3) [m], as ``RadiatedField.scattered_at``.

        A source within 0.04 wavelengths of a filled body touches it.
        """
        points = points_of(points, "points", least=0)
        found = np.full((len(points), self.sources.strengths.shape[1]), np.nan, dtype=np.complex128)
        close, away = self._close_and_away(points)
        length, k = self.scene.wavelength, self.system.wavenumber
        if away.any():
            found[away] = self._scattered_away(points[away])
        if close.any():
            some = points[close] / length
            scattered = self._scattering.finite_elements(some)
            for image in self._images:
                scattered += image.pressure(some, k)
            scattered -= (
                _scaled(self.scene, self.sources).chosen(self._touching_filled).pressure(some, k)
            )
            found[close] = scattered / length
        distance, source = nearest_source(points, self.sources, STANDS_ON)
        touching = self._touching_filled | (self.scene.depth(self.sources.positions) > -STANDS_ON)
        on = np.flatnonzero(distance < STANDS_ON)
        found[on[touching[source[on]]]] = np.nan
        return found

    def velocity(self, points: Points) -> Gradients:
        """Particle velocity [m/s] at points (P, 3) [m], as ``RadiatedField.velocity``.

        Beside the bodies, on their surfaces and in them it is the gradient of the finite elements:
        along the surface where that is sound-hard, and on either side of a filled body's. Elsewhere
        the surface integral is differentiated.
        """
        points = receivers(points, self.sources)
        close, away = self._close_and_away(points)
        gradients = np.full(
            (len(points), 3, self.sources.strengths.shape[1]), np.nan, dtype=np.complex128
        )
        density, length = np.full(len(points), self.scene.medium.density), self.scene.wavelength
        if close.any():
            gradients[close], density[close] = self.from_nearby.gradients(points[close] / length)
            gradients /= length**2
            hard = close & _touching(self.scene, points, ("sound_hard",), CONTACT)
            normals = self.system.nearest_on_surface(points[hard] / length)[1]
            gradients[hard] -= (
                normals[:, :, None] * np.einsum("pd,pds->ps", normals, gradients[hard])[:, None]
            )
        if away.any():
            step = np.full(int(away.sum()), DIFFERENCE * length)
            gradients[away] = differences(partial(self._total_away, fine=True), points[away], step)
        return velocity_of(gradients, self.scene.frequency, density)

    def _close_and_away(self, points: Points) -> tuple[Mask, Mask]:
        """Find the valid points beside the bodies or in a meshed workspace, and the other valid ones."""
        valid, near = self.valid(points), self.workspace | beside(self.scene, points)
        return valid & near, valid & ~near

    def _total_away(self, points: Points, fine: bool = False) -> Pressures:
        length = self.scene.wavelength
        free_field = (
            _scaled(self.scene, self.sources).pressure(points / length, self.system.wavenumber)
            / length
        )
        return self._scattered_away(points, fine) + free_field

    def _scattered_away(self, points: Points, fine: bool = False) -> Pressures:
        """Scattered pressure at points off the bodies; if not ``fine``, from few quadrature points where those do."""
        length = self.scene.wavelength
        clear = (
            np.zeros(len(points), dtype=bool)
            if fine
            else self.scene.depth(points) < -CLEAR * length
        )
        found = np.zeros((len(points), self.sources.strengths.shape[1]), dtype=np.complex128)
        for some, apart in ((clear, True), (~clear, False)):
            if some.any():
                found[some] = self.from_afar.scattered(points[some] / length, apart) / length
        return found

    def _in_workspace(self, points: Points) -> Mask:
        folded = images(self.system.mirrors, points / self.scene.wavelength)
        return np.any(
            [self.system.box.holds(image * self.scene.wavelength) for image in folded], axis=0
        )


def beside(scene: Scene, points: Points) -> Mask:
    """Whether points lie in a body or within ``NEAR`` wavelengths of one."""
    return scene.depth(points) > -NEAR * scene.wavelength


def solved_from_afar(system: System, scene: Scene, sources: Monopoles, workspace: bool) -> Solution:
    """Solve with the sources beside the bodies (or all) as point loads, and the others by what they scatter.

    Away from the bodies this is as right as the pressure of a far source is beside them, by
    reciprocity.
    """
    near, scaled = workspace | beside(scene, sources.positions), _scaled(scene, sources)
    return solve(system, scaled.chosen(~near), scaled.chosen(near))


def touching_warnings(scene: Scene, sources: Monopoles) -> tuple[str, ...]:
    """Warn of sources that touch bodies that are not sound-hard: right beside them the pressure is rough."""
    touching = np.flatnonzero(
        _touching(scene, sources.positions, ("impedance", "filled"), TOUCHING * scene.wavelength)
    )
    if not len(touching):
        return ()
    return (
        f"{len(touching)} of {len(sources.positions)} sources touch impedance or filled bodies, the first at "
        f"{in_mm(sources.positions[touching[0]])}: within {1e3 * ROUGH * scene.wavelength:.3g} mm of such a "
        "source the pressure beside the bodies is 4 to 50 % off (elsewhere it is not); move sources "
        f"{1e3 * TOUCHING * scene.wavelength:.2g} mm off the body to evaluate it there.",
    )


def _scaled(scene: Scene, sources: Monopoles) -> PointSources:
    return PointSources(
        sources.positions / scene.wavelength, np.asarray(sources.strengths, dtype=np.complex128)
    )


def _touching(scene: Scene, points: Points, boundaries: Sequence[str], gap: float) -> Mask:
    """Whether points are less than a gap [m] off bodies of some kinds, or in them."""
    found = np.zeros(len(points), dtype=np.bool_)
    for obstacle in scene.obstacles:
        if obstacle.boundary in boundaries:
            found |= obstacle.surface.depth(points) > -gap
    return found
