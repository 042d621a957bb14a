"""The field that finite elements found: heard from the tetrahedra beside the bodies, from their skins elsewhere."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real

from airtact.printing import in_short
from airtact.scene.scene import CONTACT, Scene
from airtact.scene.sources import Monopoles
from airtact.solvers.fem.meshing.symmetry import TOLERANCE, images
from airtact.solvers.fem.solution import ReadySystem, Solution, joined, nothing
from airtact.solvers.monopoles import monopole_pressure
from airtact.solvers.problem import DIFFERENCE, RadiatedField, SolveReport, SurfaceField, receivers
from airtact.solvers.velocity import differences, velocity_of
from airtact.validation import in_mm, points_of

NEAR = 0.25
"""Distance from the skins, in wavelengths, up to which points and sources are taken to be beside the bodies."""

CLEAR = 1.0
"""Distance from the skins, in wavelengths, from which sparse spots on them suffice."""

TOUCHING = 0.04
"""Distance from a filled body, in wavelengths, up to which a source is a point load for its own surroundings too."""


ROUGH = 0.5
"""Distance from a source that touches an impedance or filled body, in wavelengths, up to which little is right."""


@dataclass(frozen=True, eq=False)
class FiniteField(RadiatedField):
    """The field of some monopoles, as ``FiniteElement`` solved it.

    Attributes
    ----------
    scene, sources : what was solved.
    ready : the factorised system.
    from_afar : the solution with the sources beside the bodies as point loads: right away from the bodies.
    report : how it was made.
    workspace : whether the whole workspace is meshed and read off the mesh, as the paper does.
    """

    scene: Scene
    sources: Monopoles
    ready: ReadySystem
    from_afar: Solution
    report: SolveReport
    workspace: bool = False

    __repr__ = in_short

    @property
    def on_surface(self) -> SurfaceField:
        """Pressure at the quadrature points of the skins."""
        length, spots, mirrors = self.scene.wavelength, self.ready.system.skin, self.ready.mirrors
        pressure = np.concatenate(self.ready.on_spots(self.from_nearby, spots)) / length
        points = np.concatenate(images(mirrors, spots.points)) * length
        tips = np.concatenate(images(mirrors, spots.points + spots.normals)) * length
        areas = np.tile(spots.areas, 2 ** len(mirrors)) * length**2
        return SurfaceField(points, (tips - points) / length, areas, pressure)

    @cached_property
    def from_nearby(self) -> Solution:
        """The solution for the scattered pressure of all sources, right beside the bodies."""
        near = beside(self.scene, self.sources.positions)
        if self.workspace or not near.any():
            return self.from_afar
        places, strengths = _scaled(self.scene, self.sources)
        touching = near & _touching(self.scene, self.sources.positions, ("filled",))
        mirrored = _mirrored(self.ready, self.scene, self.sources, near & ~touching)
        outer = joined([(places[~touching], strengths[~touching]), mirrored])
        return self.ready.solve(outer, (places[touching], strengths[touching]))

    def valid(self, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        """Whether points (P, 3) [m] lie outside the bodies, on their skin, or in a filled one; and in the workspace."""
        points = points_of(points, "points", least=0)
        valid = self._in_workspace(points) if self.workspace else np.ones(len(points), dtype=np.bool_)
        for obstacle in self.scene.obstacles:
            if obstacle.boundary != "filled":
                valid &= obstacle.surface.depth(points) <= CONTACT
        return valid

    def at(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure [Pa] at points (P, 3) [m] for each of the S sounds; NaN where ``valid`` is False.

        Raises
        ------
        InvalidInput
            A point is NaN or infinite, or stands on a source.
        """
        points = receivers(points, self.sources)
        found = np.full((len(points), self.sources.strengths.shape[1]), np.nan, dtype=np.complex128)
        valid, near = self.valid(points), self.workspace | beside(self.scene, points)
        clear = ~near & (self.scene.depth(points) < -CLEAR * self.scene.wavelength)
        length = self.scene.wavelength
        if (valid & near).any():
            found[valid & near] = self.ready.near(self.from_nearby, points[valid & near] / length) / length
        for some, apart in ((valid & ~near & ~clear, False), (valid & clear, True)):
            if some.any():
                found[some] = self._heard_away(points[some], apart)
        return found

    def velocity(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points 3 sounds"]:
        """Particle velocity [m/s] at points (P, 3) [m] for each of the S sounds; NaN where ``valid`` is False.

        Beside the bodies, on their skins and in them it is the slope of the finite elements: along the skin where that
        is sound-hard, and on either side of a filled body's. Elsewhere the surface integral is differentiated.

        Raises
        ------
        InvalidInput
            As ``at``.
        """
        points = receivers(points, self.sources)
        valid, near = self.valid(points), self.workspace | beside(self.scene, points)
        slopes = np.full((len(points), 3, self.sources.strengths.shape[1]), np.nan, dtype=np.complex128)
        density, length = np.full(len(points), self.scene.medium.density), self.scene.wavelength
        if (close := valid & near).any():
            slopes[close], density[close] = self.ready.slopes_near(self.from_nearby, points[close] / length)
            slopes /= length**2
            hard = close & self._on_hard(points)
            normals = self.ready.skin_normals(points[hard] / length)
            slopes[hard] -= normals[:, :, None] * np.einsum("pd,pds->ps", normals, slopes[hard])[:, None]
        if (away := valid & ~near).any():
            step = np.full(int(away.sum()), DIFFERENCE * length)
            slopes[away] = differences(self._heard_away, points[away], step)
        return velocity_of(slopes, self.scene.frequency, density)

    def _heard_away(
        self, points: Real[np.ndarray, "points 3"], clear: bool = False
    ) -> Complex128[np.ndarray, "points sounds"]:
        away, length = points / self.scene.wavelength, self.scene.wavelength
        return (self.ready.away(self.from_afar, away, clear) + self._open_air(away)) / length

    def _on_hard(self, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        found = np.zeros(len(points), dtype=np.bool_)
        for obstacle in self.scene.obstacles:
            if obstacle.boundary == "sound_hard":
                found |= obstacle.surface.depth(points) >= -CONTACT
        return found

    def _in_workspace(self, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        folded = images(self.ready.mirrors, points / self.scene.wavelength)
        box = self.ready.system.box
        return np.any([box.holds(image * self.scene.wavelength) for image in folded], axis=0)

    def _open_air(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        places, strengths = _scaled(self.scene, self.sources)
        return monopole_pressure(points, places, strengths, self.ready.system.wavenumber, "float64")


def beside(scene: Scene, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
    """Whether points lie in a body or within ``NEAR`` wavelengths of one."""
    return scene.depth(points) > -NEAR * scene.wavelength


def solved_from_afar(ready: ReadySystem, scene: Scene, sources: Monopoles, workspace: bool) -> Solution:
    """Solve with the sources beside the bodies (or all) as point loads, and the others by what is scattered of them.

    Away from the bodies this is as right as the pressure of a far source is beside them, by reciprocity.
    """
    places, strengths = _scaled(scene, sources)
    near = workspace | beside(scene, sources.positions)
    return ready.solve((places[~near], strengths[~near]), (places[near], strengths[near]))


def rough_places(scene: Scene, sources: Monopoles) -> tuple[str, ...]:
    """Warn of sources that touch bodies that give way to sound: right beside them the pressure is rough."""
    touching = np.flatnonzero(_touching(scene, sources.positions, ("impedance", "filled")))
    if not len(touching):
        return ()
    return (
        f"{len(touching)} of {len(sources.positions)} sources touch impedance or filled bodies, the first at "
        f"{in_mm(sources.positions[touching[0]])}: within {1e3 * ROUGH * scene.wavelength:.3g} mm of such a "
        "source the pressure beside the bodies is 4 to 50 % off (elsewhere it is not); move sources "
        f"{1e3 * TOUCHING * scene.wavelength:.2g} mm off the body to hear it there.",
    )


def _scaled(
    scene: Scene, sources: Monopoles
) -> tuple[Float64[np.ndarray, "sources 3"], Complex128[np.ndarray, "sources sounds"]]:
    return sources.positions / scene.wavelength, np.asarray(sources.strengths, dtype=np.complex128)


def _touching(
    scene: Scene, points: Real[np.ndarray, "points 3"], boundaries: Sequence[str]
) -> Bool[np.ndarray, "points"]:
    """Whether points touch bodies of some kinds, or nearly so: an image in a filled one would stand in the sound."""
    found = np.zeros(len(points), dtype=np.bool_)
    for obstacle in scene.obstacles:
        if obstacle.boundary in boundaries:
            found |= obstacle.surface.depth(points) > -TOUCHING * scene.wavelength
    return found


def _mirrored(
    ready: ReadySystem, scene: Scene, sources: Monopoles, near: Bool[np.ndarray, "sources"]
) -> tuple[Float64[np.ndarray, "images 3"], Complex128[np.ndarray, "images sounds"]]:
    """Images of the sources beside bodies that sound does not enter: what is left to solve for is smooth there.

    An image stands as deep in the nearest body as meshed as its source stands off it; where the body is too thin to
    hold it, there is none.
    """
    places, strengths = _scaled(scene, sources)
    found = [nothing(strengths.shape[1])]
    for source in np.flatnonzero(near):
        position = sources.positions[[source]]
        depths = [float(obstacle.surface.depth(position)[0]) for obstacle in scene.obstacles]
        nearest = scene.obstacles[int(np.argmax(depths))]
        if nearest.boundary == "filled":
            continue
        image = 2 * ready.meshed_skin(places[[source]]) - places[[source]]
        if (
            float(nearest.surface.depth(image * scene.wavelength)[0])
            > -0.9 * max(depths) - TOLERANCE * scene.wavelength
        ):
            found.append((image, strengths[[source]]))
    return joined(found)
