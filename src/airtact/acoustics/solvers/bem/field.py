"""The field around bodies that ``BoundaryElement`` returns: which solution serves where."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.acoustics.planes import before_planes, with_images
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.images import surface_without_images, values_without_images
from airtact.acoustics.solvers.bem.layer_potentials import (
    Located,
    find_contacts,
    locate,
    near_surface,
    project_contacts,
)
from airtact.acoustics.solvers.bem.operator import DualSurface
from airtact.acoustics.solvers.bem.solutions import (
    DirectSolution,
    TransposedSolution,
    incident_pressure,
    surface_gradient,
)
from airtact.acoustics.solvers.bem.target_cells import Cells, cells_of
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
from airtact.errors import InvalidInput
from airtact.geometry.mesh.quadratic_triangles import points_at

COMMON_ERROR = 0.15
"""Part of the accuracy that the error estimate never goes below, where all of the pressure is scattered."""

ERROR_OF_CELLS = 0.04
"""Part of the accuracy that the evaluation of many points in cells may cost."""

WARN_ABOVE = 1.2
"""Estimated error at the points asked for, over what is wanted, above which a warning names the worst of them."""

LEAST_HEIGHT = 1.0 / 60.0
"""Height over the surface, in wavelengths, below which differences of the pressure are too noisy."""


@dataclass(frozen=True, eq=False)
class BoundaryField(RadiatedField):
    """The field of some monopoles around bodies, as ``BoundaryElement`` solved it.

    ``pressure`` is the direct solution: the pressure at the nodes [Pa]; ``density`` and ``factors``
    are those of the transposed solution. Either is None where it was not asked for. The accuracy is
    that of the solver, and ``wanted`` the error against which is warned. Where the scene has a
    plane, the images of the bodies follow them in ``surface``, ``pressure`` and ``density``.
    """

    scene: Scene
    sources: Monopoles
    surface: DualSurface
    pressure: Complex128[np.ndarray, "nodes sounds"] | None
    density: Complex128[np.ndarray, "nodes sounds"] | None
    factors: Float64[np.ndarray, "sources"]
    accuracy: float
    wanted: float
    report: SolveReport

    __repr__ = RadiatedField.__repr__

    @cached_property
    def direct(self) -> DirectSolution:
        """The direct solution; ``InvalidInput`` where it was not asked for (``estimate=False``)."""
        if self.pressure is None:
            raise InvalidInput(
                "the pressure on and near the surface was not solved for (estimate = False): 1 of 2 equations is "
                "enough for a transfer matrix only; solve with estimate = True.",
                code="not_supported",
            )
        return DirectSolution(self._emitting, self.surface, self.pressure)

    @cached_property
    def transposed(self) -> TransposedSolution:
        """The transposed solution, where there is one."""
        assert self.density is not None
        factors = np.tile(self.factors, len(self._emitting.positions) // len(self.factors))
        return TransposedSolution(self._emitting, self.surface, self.density, factors)

    @property
    def _sounds(self) -> int:
        return self.sources.strengths.shape[1]

    @cached_property
    def _emitting(self) -> Monopoles:
        """The sources and their images in planes."""
        return with_images(self.scene.planes, self.sources)

    @property
    def scattering_sources(self) -> Monopoles | None:
        """The transposed solution's monopoles on and under the surface; None where a source touches a body.

        Before a plane there are none either, because the sources' images would be missing.
        """
        if self.density is None or (self.factors > 1).any() or self.scene.planes:
            return None
        return self.transposed.scattering

    @property
    def without_images(self) -> "BoundaryField":
        """What sources and bodies radiate, as they do here, without their images in a plane."""
        planes = self.scene.planes
        if not planes:
            return self
        return replace(
            self,
            scene=replace(self.scene, planes=()),
            surface=surface_without_images(self.surface, planes),
            pressure=None
            if self.pressure is None
            else values_without_images(self.pressure, planes),
            density=None if self.density is None else values_without_images(self.density, planes),
        )

    @property
    def on_surface(self) -> SurfaceField:
        """Total pressure at the nodes of the panels, from the direct solution; ``InvalidInput`` without it."""
        nodes = self.surface.nodes
        own = slice(len(nodes.points) // (1 + len(self.scene.planes)))
        return SurfaceField(
            nodes.points[own], nodes.normals[own], nodes.weights[own], self.direct.pressure[own]
        )

    def valid(self, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        """Whether points (P, 3) [m] lie outside the bodies or on their surfaces, and not behind a plane."""
        return self._located(points_of(points, "points", least=0)).outside

    def _located(self, points: Float64[np.ndarray, "points 3"]) -> Located:
        return locate(self.scene, self.surface.nodes, points, self.surface.near_rule)

    def at(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure [Pa] at points (P, 3) for each of the S excitations; NaN inside the bodies.

        On and near the surface it is the direct solution's. Elsewhere it is the transposed one's
        for excitations with a source near the surface, and the mean of both for the others, which
        makes the field reciprocal.

        Many points close together, such as those of a picture, are evaluated in cells, to
        ``ERROR_OF_CELLS`` of the accuracy; the excitations without a source near the surface are
        then the direct solution's everywhere, from panels refined near the points. ``InvalidInput``
        is raised where a point is NaN or infinite, or stands on a source; or on or near the surface
        if the direct solution was not asked for (``estimate=False``).
        """
        return self._evaluated(receivers(points, self.sources))

    def scattered_at(
        self, points: Real[np.ndarray, "points 3"]
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Scattered pressure [Pa] at points (P, 3) for each of the S excitations: ``at`` less the open-air pressure.

        It is evaluated from the bodies' own monopoles or double layer, so that it is right at the
        sources' positions too. There it is NaN only if the source touches a body, where its image
        makes the scattered pressure infinite. ``InvalidInput`` is raised as by ``at``.
        """
        points = points_of(points, "points", least=0)
        out = self._evaluated(points, total=False)
        distance, source = nearest_source(points, self.sources, STANDS_ON)
        on = np.flatnonzero(distance < STANDS_ON)
        out[on[self.factors[source[on]] > 1]] = np.nan
        for one in self.scene.planes:
            images = Monopoles(one.image(self.sources.positions), self.sources.strengths)
            off = nearest_source(points, images, STANDS_ON)[0] >= STANDS_ON
            out[off] += incident_pressure(points[off], images, self.surface)
            out[~off] = np.nan
        return out

    def _evaluated(
        self, points: Float64[np.ndarray, "points 3"], total: bool = True
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Total (or scattered) pressure at points [Pa]; NaN inside the bodies."""
        located = self._located(points)
        most = (
            located.outside & ~located.contact
        )  # a projected point is no longer in the plane of a picture
        cells = cells_of(located.points[most], self.scene.wavelength, self._cells_error)
        if cells is not None:
            return self._in_cells(cells, located, most, total)
        out = np.full((len(points), self._sounds), np.nan, dtype=np.complex128)
        near, away = located.outside & located.near, located.outside & ~located.near
        if near.any():
            out[near] = self.direct.near(located.points[near], located.contact[near], total)
        if self.density is None:
            out[away] = self.direct_at(located.points[away], total)
            return out
        out[away] = self.transposed.at(located.points[away], total)
        by_both = self._by_both
        if by_both.any():
            direct = self.direct_at(located.points[away], total)[:, by_both]
            out[np.ix_(away, by_both)] = 0.5 * (out[np.ix_(away, by_both)] + direct)
        return out

    def _in_cells(
        self, cells: Cells, located: Located, most: Bool[np.ndarray, "points"], total: bool
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Pressure at many points, most of them in cells; each solution at all of these if it is needed at some."""
        out = np.full((len(most), self._sounds), np.nan, dtype=np.complex128)
        points, near, direct = (
            located.points[most],
            located.near[most],
            self._by_both | (self.density is None),
        )
        if not direct.all() and not near.all():
            out[most] = self.transposed.at(points, total, cells)
        if direct.any() or (located.near & located.outside).any():
            given = self.direct.refined(located.points[located.near & located.outside])
            pressure = self.direct.at(
                points, np.zeros(len(points), dtype=bool), total, given, cells
            )
            out[most] = np.where(near[:, None] | direct, pressure, out[most])
            touching = located.points[located.contact]
            out[located.contact] = self.direct.at(
                touching, np.ones(len(touching), dtype=bool), total, given
            )
        return out

    @cached_property
    def _by_both(self) -> Bool[np.ndarray, "sounds"]:
        """Excitations that both solutions serve, all their sources being away from the surface."""
        if self.pressure is None:
            return np.zeros(self._sounds, dtype=bool)
        near = near_surface(
            self.surface.nodes, self.sources.positions, self.surface.near_rule.reach
        )
        return ~(self.sources.strengths[near] != 0).any(axis=0)

    @property
    def _cells_error(self) -> float:
        return ERROR_OF_CELLS * self.accuracy if self.surface.precision == "float32" else 0.0

    def direct_at(
        self, points: Real[np.ndarray, "points 3"], total: bool = True
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Total (or scattered) pressure by the direct solution alone [Pa], at points (P, 3) outside the bodies."""
        return self.direct.at(
            *project_contacts(self.surface.nodes, points_of(points, "points", least=0)), total
        )

    def error_at(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "sounds"]:
        """Relative error of the direct solution over points (P, 3), for each excitation.

        It is the difference of the direct and the transposed solution, together with
        ``COMMON_ERROR`` of the accuracy asked for, as far as the pressure is scattered: errors of
        panels and quadrature that both share show in neither. Points on or near the surface are
        lifted off it by a panel's radius, where there is room, because the transposed solution is
        right only there. NaN without a direct solution.
        """
        return self._errors(points_of(points, "points"))[0]

    def _errors(
        self, points: Float64[np.ndarray, "points 3"]
    ) -> tuple[Float64[np.ndarray, "sounds"], Float64[np.ndarray, "points"]]:
        """Relative errors of excitations over points, and each point's largest part in the squares of one."""
        if self.pressure is None or self.density is None:
            return np.full(self._sounds, np.nan), np.full(len(points), np.nan)
        points = self._lifted(points)
        transposed = self.transposed.at(points)
        size = np.linalg.norm(transposed, axis=0)
        difference = self.direct_at(points) - transposed
        scattered = transposed - incident_pressure(points, self.sources, self.surface)
        squares = np.abs(difference) ** 2 + (COMMON_ERROR * self.accuracy * np.abs(scattered)) ** 2
        relative = squares / np.where(size > 0, size, 1) ** 2
        return np.sqrt(relative.sum(axis=0)), relative.max(axis=1)

    def _lifted(self, points: Float64[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Move points near the surface away from it by the radius of the nearest panel, where that meets no other."""
        nodes = self.surface.nodes
        near = np.flatnonzero(near_surface(nodes, points, self.surface.near_rule.reach))
        if not len(near):
            return points
        nearest = KDTree(nodes.points).query(points[near])[1]
        radius = nodes.radii[nearest // 6]
        away = points[near] + radius[:, None] * nodes.normals[nearest]
        free = -self.scene.depth(away) > 0.5 * radius
        points = points.copy()
        points[near[free]] = away[free]
        return points

    def report_at(self, points: Real[np.ndarray, "points 3"]) -> SolveReport:
        """Return the report with the error estimated at points (P, 3) [m] outside the bodies, where it is larger.

        Where it exceeds what was asked, a warning names the worst point and what to do. Without a
        direct solution, or without points, it is the plain report.
        """
        points = points_of(points, "points", least=0)
        points = points[
            (self.scene.depth(points) <= 0.0) & before_planes(self.scene.planes, points)
        ]
        if self.pressure is None or self.density is None or not len(points):
            return self.report
        errors, parts = self._errors(points)
        error, warnings = float(errors.max()), self.report.warnings
        if error > WARN_ABOVE * self.wanted:
            warnings = (
                *warnings,
                f"at {in_mm(points[parts.argmax()])} and the points beside it the pressure is estimated to be "
                f"{100 * error:.1f} % off, and {100 * self.wanted:.1f} % was asked: points in a "
                f"narrow gap or a cavity need a smaller accuracy, such as {self.wanted / 3:.2g}.",
            )
        return replace(
            self.report,
            estimated_error=float(np.fmax(error, self.report.estimated_error)),
            warnings=warnings,
        )

    def velocity(
        self, points: Real[np.ndarray, "points 3"]
    ) -> Complex128[np.ndarray, "points 3 sounds"]:
        """Particle velocity [m/s] at points (P, 3) for each of the S excitations; NaN inside the bodies.

        On the surface it is the tangential gradient of the direct solution (at accuracy = 0.01 it
        was 1.5 % off on a sphere of 10 mm, 6 % on one of 6 mm) and, along the normal, what an
        impedance makes of its pressure; near the surface it is the difference of that solution's
        pressure, between the two within 1/60 of a wavelength, and elsewhere the gradient of the
        transposed solution in closed form. ``InvalidInput`` is raised as by ``at``.
        """
        points = receivers(points, self.sources)
        located = self._located(points)
        gradient = np.full((len(points), 3, self._sounds), np.nan, dtype=np.complex128)
        between, away = located.outside & located.near, located.outside & ~located.near
        close, gradient_close = self._gradient_at_surface(points, np.flatnonzero(located.outside))
        gradient[close] = gradient_close
        between[close] = away[close] = False
        gradient[between] = self._gradient_near(points[between])
        by_differences = self.density is None
        gradient[away] = (self._gradient_near if by_differences else self.transposed.gradient)(
            points[away]
        )
        return velocity_of(gradient, self.scene.frequency, self.scene.medium.density)

    def _gradient_near(
        self, points: Real[np.ndarray, "points 3"]
    ) -> Complex128[np.ndarray, "points 3 sounds"]:
        """∇p by differences [Pa/m], at points near the surface and outside it."""
        step = np.minimum(DIFFERENCE * self.scene.wavelength, 0.4 * -self.scene.depth(points))
        if not len(points):
            return np.empty((0, 3, self._sounds), dtype=np.complex128)
        return differences(self.direct.near, points, step)

    def _gradient_at_surface(
        self, points: Float64[np.ndarray, "points 3"], outside: Int64[np.ndarray, "outside"]
    ) -> tuple[Int64[np.ndarray, "close"], Complex128[np.ndarray, "close 3 sounds"]]:
        """Which of the points outside lie within ``LEAST_HEIGHT`` of the surface, and ∇p there [Pa/m]."""
        nodes, least = self.surface.nodes, LEAST_HEIGHT * self.scene.wavelength
        close = find_contacts(nodes, points[outside], least)
        target = outside[close.target]
        if not len(target):
            return target, np.empty((0, 3, self._sounds), dtype=np.complex128)
        projections, normals = points_at(nodes.quadratic_triangles[close.panel], close.reference)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        height = np.where(close.distance < nodes.contact[close.panel], 0.0, close.distance / least)
        gradient = surface_gradient(nodes, close.panel, close.reference, self.direct_at)
        yielding = nodes.admittance[close.panel] != 0
        if yielding.any():
            rates = -1j * self.scene.wavenumber * nodes.admittance[close.panel[yielding], None]
            rises = rates * self.direct_at(projections[yielding])
            gradient[yielding] += normals[yielding, :, None] * rises[:, None]
        off = height > 0.0
        weight, lifted = height[off, None, None], projections[off] + least * normals[off]
        gradient[off] = (1.0 - weight) * gradient[off] + weight * self._gradient_near(lifted)
        return target, gradient
