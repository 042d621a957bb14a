"""Closed-form sound field of one sphere: sound-hard, with an impedance, or filled with a fluid."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from airtact.acoustics.scene import CONTACT, Obstacle, Scene, check_sources
from airtact.acoustics.solvers.arrays import (
    Lengths,
    Mask,
    Points,
    Pressures,
    Vectors,
)
from airtact.acoustics.solvers.problem import (
    RadiatedField,
    Solver,
    SolveReport,
    SurfaceField,
)
from airtact.acoustics.solvers.spherical.modes import ACCURACY, SphereModes
from airtact.acoustics.sources import STANDS_ON, Monopoles, nearest_source
from airtact.errors import InvalidInput
from airtact.geometry.primitives import Capsule
from airtact.timing import Clock

# Number of pairs of point and source that are summed at a time: as many as fit into the cache.
PAIRS_PER_BLOCK = 1 << 14

_CITATIONS = (
    "J. J. Bowman, T. B. A. Senior, P. L. E. Uslenghi, Electromagnetic and Acoustic Scattering by "
    "Simple Shapes (1987)",
    "V. C. Anderson, Sound scattering from a fluid sphere, J. Acoust. Soc. Am. 22, 426 (1950)",
    "D. R. Yennie, D. G. Ravenhall, R. N. Wilson, Phys. Rev. 95, 500 (1954)",
)


@dataclass(frozen=True, eq=False, repr=False)
class SphereField(RadiatedField):
    """The field of monopoles around one sphere, and inside it if it is filled.

    The error of the field is 1e-8 of the open-air pressures. A point within micrometres of a source
    that touches the surface raises ``NotConverged``. ``centre`` is the centre of the sphere [m].
    """

    modes: SphereModes
    centre: Float64[np.ndarray, "3"]

    @property
    def on_surface(self) -> SurfaceField:
        """Pressure at Gauss-Legendre latitudes and equally spaced longitudes."""
        latitudes = int(np.ceil(2.0 * abs(self.modes.size))) + 12
        cosine, weight = np.polynomial.legendre.leggauss(latitudes)
        longitude = 2.0 * np.pi * (np.arange(2 * latitudes) + 0.5) / (2 * latitudes)
        sine = np.sqrt(1.0 - cosine**2)
        x = np.outer(sine, np.cos(longitude)).ravel()
        y = np.outer(sine, np.sin(longitude)).ravel()
        normals = np.stack([x, y, np.repeat(cosine, len(longitude))], axis=1)
        areas = np.repeat(weight, len(longitude)) * np.pi / latitudes * self.modes.radius**2
        points = self.centre + self.modes.radius * normals
        return SurfaceField(points, normals, areas, self.at(points))

    def _valid(self, points: Vectors) -> Mask:
        if self.modes.inner_wavenumber is not None:
            return np.ones(len(points), dtype=np.bool_)
        return ~self._inside(points)

    def _at(self, points: Vectors) -> Pressures:
        pressure = self.nowhere(points)
        inside = self._inside(points)
        outside = np.flatnonzero(~inside)
        pressure[outside] = self._incident(points[outside])
        pressure[outside] += self._scattered(points[outside], inside=False)
        if self.modes.inner_wavenumber is not None:
            pressure[inside] = self._scattered(points[inside], inside=True)
        return pressure

    def _scattered_at(self, points: Vectors) -> Pressures:
        pressure = self.nowhere(points)
        inside = self._inside(points)
        on_source = nearest_source(points, self.sources, STANDS_ON)[0] < STANDS_ON
        distance = np.linalg.norm(points - self.centre, axis=1)
        unbounded = on_source & (distance <= self.modes.radius + CONTACT)
        outside = np.flatnonzero(~inside & ~unbounded)
        pressure[outside] = self._scattered(points[outside], inside=False, alone=True)
        if self.modes.inner_wavenumber is not None:
            # Inside a fluid, the series is the total pressure.
            total = self._scattered(points[inside], inside=True)
            pressure[inside] = total - self._incident(points[inside])
        return pressure

    def _inside(self, points: Points) -> Mask:
        # Points on the surface count as outside despite rounding.
        return np.linalg.norm(points - self.centre, axis=1) < self.modes.radius - CONTACT

    def _scattered(self, points: Points, inside: bool, alone: bool = False) -> Pressures:
        """Sum the series at points on one side of the surface.

        The error is ``ACCURACY`` times the open-air pressure. If ``alone`` is set, the open-air
        pressure is evaluated no closer than the distance of the source's image, so that it is
        finite at the source itself.
        """
        pressure = np.zeros((len(points), self.excitations), dtype=np.complex128)
        radii, directions = self._polar(points)
        source_radii, source_directions = self._polar(self.sources.positions)
        # Rounding may place sources on the surface slightly below it.
        source_radii = np.maximum(source_radii, self.modes.radius)
        if not inside:
            radii = np.maximum(radii, self.modes.radius)
        # The points of a block need about the same number of terms, and a block fits into the
        # cache.
        order = np.argsort(KDTree(self.sources.positions).query(points)[0])
        rows = max(1, PAIRS_PER_BLOCK // len(self.sources.positions))
        for first in range(0, len(points), rows):
            index = order[first : first + rows]
            distance = cdist(points[index], self.sources.positions)
            if alone:
                # The image is as far below the surface as the source is above it.
                heights = radii[index, None] + source_radii - 2.0 * self.modes.radius
                distance = np.maximum(distance, heights)
            scale = np.exp(-self.scene.wavenumber.imag * distance) / distance
            # Half the square of the chord preserves the digits of 1 - cos γ at small angles.
            versine = 0.5 * cdist(directions[index], source_directions, "sqeuclidean")
            unit = self.modes.scattered(inside, radii[index], source_radii, versine, scale)
            pressure[index] = unit @ self.sources.strengths
        return pressure

    def _polar(self, points: Points) -> tuple[Lengths, Vectors]:
        offset = points - self.centre
        radius = np.linalg.norm(offset, axis=1)
        at_centre = radius == 0.0
        direction = offset / np.where(at_centre, 1.0, radius)[:, None]
        direction[at_centre] = (0.0, 0.0, 1.0)  # any direction is valid
        return radius, direction


@dataclass(frozen=True)
class SphereSeries(Solver):
    """Separation-of-variables solver for one sphere; it serves as a reference for other solvers.

    The sphere is sound-hard, has an impedance, or is filled. Sources lie outside or on the sphere.
    """

    def radiate(self, scene: Scene, sources: Monopoles) -> SphereField:
        """Return the field of monopoles around the single sphere of the scene.

        Raises
        ------
        InvalidInput
            If the scene is not a single sphere, if a source is inside the sphere, or if an argument
            has the wrong type.
        """
        check_sources(scene, sources)
        clock = Clock()
        with clock.step("prepare"):
            obstacle, sphere = _only_sphere(scene)
            modes = _modes(scene, obstacle, float(sphere.radius))
        centre = np.asarray(sphere.pose.translation, dtype=np.float64)
        report = SolveReport(
            solver="SphereSeries",
            estimated_error=ACCURACY,
            seconds=clock.seconds,
            settings={"accuracy": ACCURACY, "boundary": obstacle.boundary},
            citations=_CITATIONS,
        )
        return SphereField(scene, sources, report, modes, centre)


def _only_sphere(scene: Scene) -> tuple[Obstacle, Capsule]:
    count = len(scene.obstacles)
    if count != 1:
        raise InvalidInput(
            f"SphereSeries solves for one sphere, but the scene has {count} obstacles; use "
            "BoundaryElement.",
            code="not_supported",
        )
    obstacle = scene.obstacles[0]
    shape = obstacle.surface.primitive
    if not isinstance(shape, Capsule) or shape.length != 0.0:
        kind = "a capsule" if isinstance(shape, Capsule) else "a mesh"
        raise InvalidInput(
            f"SphereSeries only solves for exact spheres, but the obstacle is {kind}; build it "
            "with sphere(radius, edge, centre), or use BoundaryElement.",
            code="not_supported",
        )
    return obstacle, shape


def _modes(scene: Scene, obstacle: Obstacle, radius: float) -> SphereModes:
    if obstacle.boundary == "filled":
        assert obstacle.medium is not None
        inner = obstacle.medium.wavenumber(scene.frequency)
        ratio = scene.medium.density / obstacle.medium.density
        return SphereModes(radius, scene.wavenumber, inner_wavenumber=inner, density_ratio=ratio)
    if obstacle.boundary == "impedance":
        assert obstacle.ratio is not None
        return SphereModes(radius, scene.wavenumber, admittance=1.0 / obstacle.ratio)
    return SphereModes(radius, scene.wavenumber)
