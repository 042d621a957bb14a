"""The field of finite elements: in tetrahedra near the bodies, by a surface integral elsewhere."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool

from airtact import _kernels
from airtact.acoustics.scene import CONTACT, Scene
from airtact.acoustics.solvers.fem.libraries import ngsolve_library
from airtact.acoustics.solvers.fem.system import QuadraturePoints, System
from airtact.acoustics.solvers.problem import RadiatedField, SurfaceField
from airtact.acoustics.solvers.shared import (
    Coefficients,
    Mask,
    NodeValues,
    Points,
    Pressures,
    SourcePoints,
    Strengths,
    Vectors,
    monopole_pressure,
)
from airtact.acoustics.sources import Monopoles
from airtact.errors import in_mm

# Sources within this distance of a filled body remain point loads even near the body [λ].
TOUCHING = 0.04


@dataclass(frozen=True, eq=False)
class PointSources:
    """Positions [λ] and strengths of any number of monopoles e^{ikr}/r."""

    positions: SourcePoints
    strengths: Strengths

    def chosen(self, mask: Bool[np.ndarray, "sources"]) -> "PointSources":
        """Return the sources for which the mask is True."""
        return PointSources(self.positions[mask], self.strengths[mask])

    def pressure(self, points: Points, wavenumber: complex) -> Pressures:
        """Return the open-air pressure of the monopoles at points (P, 3) [λ]."""
        if not len(self.positions) or not len(points):
            return np.zeros((len(points), self.strengths.shape[1]), dtype=np.complex128)
        return monopole_pressure(points, self.positions, self.strengths, wavenumber, "float64")


@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """Pressure in the box: the open-air field of monopoles plus the field of the finite elements.

    Attributes
    ----------
    system : the equation that was solved.
    outer : monopoles whose open-air field is added to that of the finite elements.
    coefficients : (unknowns, S) coefficients of the finite elements.
    """

    system: System
    outer: PointSources
    coefficients: Coefficients

    def total(self, points: Points) -> Pressures:
        """Return the total pressure at points (P, 3) [λ] in the box, interpolated in tetrahedra."""
        mapped = self.system.mesh_points(*self.system.holding(points))
        pressure = self.outer.pressure(points, self.system.wavenumber)
        function = ngsolve_library().GridFunction(self.system.space)
        for column in range(pressure.shape[1]):
            function.vec.FV().NumPy()[:] = self.coefficients[:, column]
            pressure[:, column] += np.asarray(function(mapped)).ravel()
        return pressure

    def scattered(self, points: Points, clear: bool = False) -> Pressures:
        """Return the scattered pressure at points (P, 3) [λ] outside the bodies.

        The pressure is computed by the surface integral, with a coarser quadrature if all points
        are ``clear`` of the bodies.
        """
        system = self.system
        surface = system.coarse_surface if clear else system.surface
        interior = system.interior
        positions = np.concatenate([surface.points, interior.points])
        normals = np.concatenate([surface.normals, interior.normals])
        # Kirchhoff-Helmholtz integral: the solution itself is the test function of L_y.
        w_d, w_s, w_v = system.weights / (4 * np.pi)
        dipole_weights = w_d[surface.body] * surface.areas
        dipole_weights = np.concatenate([dipole_weights, np.zeros(len(interior.body))])[:, None]
        monopole_weights = np.concatenate(
            [w_s[surface.body] * surface.areas, w_v[interior.body] * interior.areas]
        )[:, None]
        pressure = np.concatenate([self.at_nodes(surface), self.at_nodes(interior)])
        # Σ_j m_j G(x, y_j) + d_j ∂G(x, y_j)/∂n_j with G = e^{ikr}/r.
        return _kernels.surface_integral(
            points,
            positions,
            normals,
            monopole_weights * pressure,
            dipole_weights * pressure,
            system.wavenumber,
        )

    def at_nodes(self, nodes: QuadraturePoints) -> NodeValues:
        """Return the total pressure at quadrature points."""
        return self.outer.pressure(nodes.points, self.system.wavenumber) + nodes.pressure(
            self.coefficients
        )


def solve(system: System, outer: PointSources, inner: PointSources) -> Solution:
    """Compute the field scattered from ``outer`` monopoles, plus that of ``inner`` loads."""
    right = np.zeros((system.unknowns, outer.strengths.shape[1]), dtype=np.complex128)
    if len(outer.positions):
        right += system.right_hand_side(outer.positions, outer.strengths)
    number, weights = system.holding(inner.positions)
    for source, strengths in enumerate(inner.strengths):
        right += system.point_load(int(number[source]), weights[source])[:, None] * strengths
    return Solution(system, outer, system.factor.solve(right))


@dataclass(frozen=True, eq=False, repr=False)
class FiniteField(RadiatedField):
    """The field of monopoles computed by ``FiniteElement``.

    A source within 0.04 wavelengths of a filled body is treated as touching it.

    Attributes
    ----------
    from_afar : solution in which sources near the bodies are point loads; it is accurate away
        from the bodies.
    """

    from_afar: Solution

    @property
    def system(self) -> System:
        """The assembled equation."""
        return self.from_afar.system

    @cached_property
    def _scaled(self) -> PointSources:
        return _scaled(self.scene, self.sources)

    @property
    def on_surface(self) -> SurfaceField:
        """Total pressure at the quadrature points of the surfaces."""
        length = self.scene.wavelength
        nodes = self.system.surface
        return SurfaceField(
            nodes.points * length,
            nodes.normals,
            nodes.areas * length**2,
            self._scattering.at_nodes(nodes) / length,
        )

    @cached_property
    def _scattering(self) -> Solution:
        """Solution that is accurate near the bodies.

        Its unknown is the scattered pressure of all sources that do not touch a filled body, and of
        the images of the sources near bodies that sound does not enter. With the images subtracted,
        the scattered pressure is smooth near the sources. An image is as deep in the nearest body
        as its source is above it. An image is omitted if the body is too thin to contain it.
        """
        near = beside(self.scene, self.sources.positions)
        if not near.any():
            return self.from_afar
        length = self.scene.wavelength
        touching = _touching(self.scene, self.sources.positions, ("filled",), TOUCHING * length)
        outer = [self._scaled.chosen(~touching)]
        for number in np.flatnonzero(near & ~touching):
            source = self._scaled.chosen(np.arange(len(near)) == number)
            position = source.positions * length
            depths = [float(body.surface.depth(position)[0]) for body in self.scene.obstacles]
            nearest = self.scene.obstacles[int(np.argmax(depths))]
            if nearest.boundary == "filled":
                continue
            image = 2 * self.system.nearest_on_surface(source.positions) - source.positions
            depth = float(nearest.surface.depth(image * length)[0])
            if depth > -0.9 * max(depths) - 1e-3 * length:
                outer.append(PointSources(image, source.strengths))
        joined = PointSources(
            np.concatenate([sources.positions for sources in outer]),
            np.concatenate([sources.strengths for sources in outer]),
        )
        return solve(self.system, joined, self._scaled.chosen(touching))

    def _valid(self, points: Vectors) -> Mask:
        valid = np.ones(len(points), dtype=np.bool_)
        for obstacle in self.scene.obstacles:
            if obstacle.boundary != "filled":
                valid &= obstacle.surface.depth(points) <= CONTACT
        return valid

    def _at(self, points: Vectors) -> Pressures:
        pressure = self.nowhere(points)
        close, away = self._close_and_away(points)
        length = self.scene.wavelength
        if close.any():
            pressure[close] = self._scattering.total(points[close] / length) / length
        if away.any():
            pressure[away] = self._scattered_away(points[away]) + self._incident(points[away])
        return pressure

    def _scattered_at(self, points: Vectors) -> Pressures:
        pressure = self.nowhere(points)
        close, away = self._close_and_away(points)
        if away.any():
            pressure[away] = self._scattered_away(points[away])
        if close.any():
            scattered = self._at(points[close]) - self._incident(points[close])
            # The value is unknown at such a source, where both pressures are infinite.
            pressure[close] = np.where(np.isfinite(scattered), scattered, np.nan)
        return pressure

    def _close_and_away(self, points: Points) -> tuple[Mask, Mask]:
        valid = self._valid(points)
        near = beside(self.scene, points)
        return valid & near, valid & ~near

    def _scattered_away(self, points: Points) -> Pressures:
        length = self.scene.wavelength
        pressure = self.nowhere(points)
        clear = self.scene.depth(points) < -length  # few quadrature points are enough there
        for group, coarse in ((clear, True), (~clear, False)):
            if group.any():
                scaled = points[group] / length
                pressure[group] = self.from_afar.scattered(scaled, coarse) / length
        return pressure


def beside(scene: Scene, points: Points) -> Mask:
    """Return a mask of the points in a body or within a quarter of a wavelength of one."""
    return scene.depth(points) > -0.25 * scene.wavelength


def solved_from_afar(system: System, scene: Scene, sources: Monopoles) -> Solution:
    """Solve with the sources near the bodies modelled as point loads.

    By reciprocity, the result far from the bodies is as accurate as the pressure that a far source
    produces near them.
    """
    near = beside(scene, sources.positions)
    scaled = _scaled(scene, sources)
    return solve(system, scaled.chosen(~near), scaled.chosen(near))


def touching_warnings(scene: Scene, sources: Monopoles) -> tuple[str, ...]:
    """Return a warning if sources touch impedance or filled bodies, where the error is large."""
    gap = TOUCHING * scene.wavelength
    touching = _touching(scene, sources.positions, ("impedance", "filled"), gap)
    if not touching.any():
        return ()
    return (
        f"{touching.sum()} of {len(sources.positions)} sources touch impedance or filled bodies, "
        f"the first at {in_mm(sources.positions[np.argmax(touching)])}: within "
        f"{1e3 * 0.5 * scene.wavelength:.3g} mm of such a source the pressure near the bodies has "
        "an error of 4 to 50 %. To evaluate the pressure there, move the sources at least "
        f"{1e3 * gap:.2g} mm away from the body.",
    )


def _scaled(scene: Scene, sources: Monopoles) -> PointSources:
    return PointSources(
        sources.positions / scene.wavelength, np.asarray(sources.strengths, dtype=np.complex128)
    )


def _touching(scene: Scene, points: Points, boundaries: Sequence[str], gap: float) -> Mask:
    touching = np.zeros(len(points), dtype=np.bool_)
    for obstacle in scene.obstacles:
        if obstacle.boundary in boundaries:
            touching |= obstacle.surface.depth(points) > -gap
    return touching
