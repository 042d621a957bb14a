"""The field around rigid bodies, heard from the boundary element solution."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real
from scipy.spatial import KDTree

from airtact import _kernels
from airtact.conventions import InvalidInput
from airtact.scene.guards import points_of
from airtact.scene.printing import in_short
from airtact.scene.scene import Scene
from airtact.scene.six_nodes import cut, points_at
from airtact.scene.sources import Monopoles, check_off_sources
from airtact.solvers.boundary_operator import DualSurface
from airtact.solvers.boundary_pressure import (
    double_layer_pressure,
    find_contacts,
    is_outside,
    monopole_pressure,
    near_skin,
    project_contacts,
)
from airtact.solvers.boundary_quadrature import Nodes, find_near, place_nodes
from airtact.solvers.boundary_slopes import skin_slopes
from airtact.solvers.particle_velocity import differences, open_air_slopes, velocity_of
from airtact.solvers.problem import DIFFERENCE, RadiatedField, Skin, SolveReport

SHARED_ERROR = 0.15
"""Share of the accuracy that the error estimate never goes below, where all the sound is scattered."""

LEAST_ROOM = 1.0 / 60.0
"""Height over the skin, in wavelengths, below which differences of the pressure are too noisy."""


@dataclass(frozen=True, eq=False)
class BoundaryField(RadiatedField):
    """The field of some monopoles around rigid bodies, as ``BoundaryElement`` solved it.

    Attributes
    ----------
    scene, sources : what was solved.
    surface : where and how the equation was written down.
    pressure : (M, S) direct solution: the pressure at the nodes [Pa]; None where it was not asked for.
    density : (M, S) transposed solution: the monopoles at the nodes that stand for the bodies' scattering.
    factors : (N,) 1 for sources off the skin, 2 for those on it, which speak with their image.
    report : how it was made.
    """

    scene: Scene
    sources: Monopoles
    surface: DualSurface
    pressure: Complex128[np.ndarray, "nodes sounds"] | None
    density: Complex128[np.ndarray, "nodes sounds"]
    factors: Float64[np.ndarray, "sources"]
    report: SolveReport

    __repr__ = in_short

    @property
    def skin(self) -> Skin:
        """Pressure at the nodes of the skin, from the direct solution."""
        nodes = self.surface.nodes
        return Skin(nodes.points, nodes.normals, nodes.weights, self._skin_pressure)

    @property
    def _skin_pressure(self) -> Complex128[np.ndarray, "nodes sounds"]:
        if self.pressure is None:
            raise InvalidInput(
                "the pressure on and near the skin was not solved for (estimate = False): 1 of 2 equations is "
                "enough for a transfer matrix only; solve with estimate = True."
            )
        return self.pressure

    def valid(self, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        """Whether points (P, 3) [m] lie outside the bodies or on their skin."""
        return is_outside(self.surface.nodes, points_of(points, "points", least=0), self.surface.near_rule)

    def at(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure [Pa] at points (P, 3) for each of the S sounds; NaN inside the bodies.

        On and near the skin it is the direct solution's. Elsewhere it is the transposed one's for sounds that have a
        source near the skin, and the mean of both for the others, which makes A heard at B equal B heard at A.

        Raises
        ------
        InvalidInput
            A point is NaN or infinite, or stands on a source.
        """
        points = points_of(points, "points", least=0)
        check_off_sources(points, self.sources)
        near = near_skin(self.surface.nodes, points, self.surface.near_rule.reach)
        outside = self.valid(points)
        out = np.full((len(points), self.density.shape[1]), np.nan, dtype=np.complex128)
        out[outside & near] = self._heard_near(points[outside & near])
        out[outside & ~near] = self._heard_away(points[outside & ~near])
        return out

    def velocity(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points 3 sounds"]:
        """Particle velocity [m/s] at points (P, 3) for each of the S sounds; NaN inside the bodies.

        On the skin it is the slope of the direct solution along it (at accuracy = 0.01 it was 1.5 % off on a ball of 10
        mm, 6 % on one of 6 mm), near the skin the difference of that solution's pressure, between the two within 1/60
        of a wavelength, and elsewhere the slope of the transposed solution in closed form.

        Raises
        ------
        InvalidInput
            A point is NaN or infinite, or stands on a source.
        """
        points = points_of(points, "points", least=0)
        check_off_sources(points, self.sources)
        nodes, least = self.surface.nodes, LEAST_ROOM * self.scene.wavelength
        near, outside = near_skin(nodes, points, self.surface.near_rule.reach), self.valid(points)
        slopes = np.full((len(points), 3, self.density.shape[1]), np.nan, dtype=np.complex128)
        close = find_contacts(nodes, points[outside], least)
        target = np.flatnonzero(outside)[close.target]
        between, away = outside & near, outside & ~near
        between[target] = away[target] = False
        if len(target):
            feet, normals = points_at(nodes.six_nodes[close.panel], close.foot)
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            height = np.where(close.distance < nodes.contact[close.panel], 0.0, close.distance / least)
            slopes[target] = skin_slopes(nodes, close.panel, close.foot, self.direct_at)
            off = height > 0.0
            share, lifted = height[off, None, None], feet[off] + least * normals[off]
            slopes[target[off]] = (1.0 - share) * slopes[target[off]] + share * self._slopes_near(lifted)
        slopes[between] = self._slopes_near(points[between])
        slopes[away] = self._slopes_from_density(points[away])
        return velocity_of(slopes, self.scene.frequency, self.scene.medium.density)

    def _slopes_near(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points 3 sounds"]:
        """∇p by differences [Pa/m], at points near the skin and outside it."""
        step = np.minimum(DIFFERENCE * self.scene.wavelength, 0.4 * -self.scene.depth(points))
        return differences(self._heard_near, points, step)

    def _heard_away(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        transposed = self._heard_from_density(points)
        near = near_skin(self.surface.nodes, self.sources.positions, self.surface.near_rule.reach)
        away = ~(self.sources.strengths[near] != 0).any(axis=0)
        if away.any() and self.pressure is not None:
            transposed[:, away] = 0.5 * (transposed[:, away] + self.direct_at(points)[:, away])
        return transposed

    def error_at(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "sounds"]:
        """Relative error of the direct solution over points (P, 3) away from the skin, estimated for each sound.

        It is the difference of the direct and the transposed solution, together with ``SHARED_ERROR`` of the accuracy
        asked for, as far as the pressure is scattered: what panels and quadrature do wrong alike shows in neither.
        NaN without a direct solution.
        """
        points = points_of(points, "points")
        if self.pressure is None:
            return np.full(self.density.shape[1], np.nan)
        transposed = self._heard_from_density(points)
        size = np.linalg.norm(transposed, axis=0)
        difference = np.linalg.norm(self.direct_at(points) - transposed, axis=0)
        scattered = np.linalg.norm(transposed - self._free(points, self.sources.strengths), axis=0)
        accuracy = float(self.report.settings["accuracy"])
        return np.hypot(difference, SHARED_ERROR * accuracy * scattered) / np.where(size > 0, size, 1)

    def direct_at(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure by the direct solution alone [Pa], at points (P, 3) outside the bodies."""
        return self._heard_from_skin(self.surface.nodes, self._skin_pressure, points_of(points, "points", least=0))

    def _heard_from_skin(
        self, nodes: Nodes, pressure: Complex128[np.ndarray, "nodes sounds"], points: Real[np.ndarray, "points 3"]
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Incident pressure plus the double layer of a pressure on the skin; twice that on the skin itself."""
        surface = self.surface
        points, contact = project_contacts(nodes, points)
        out = self._free(points, self.sources.strengths)
        out += double_layer_pressure(points, nodes, pressure, surface.wavenumber, surface.near_rule, surface.precision)
        return np.where(contact, 2, 1)[:, None] * out

    def _heard_near(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Pressure on and near the skin.

        The panels near the points are cut in four and given the pressure that the equation itself says (twice the
        incident pressure plus the double layer), which is smoother than the quadratic through the six nodes: Nyström's
        own interpolation (Atkinson, The Numerical Solution of Integral Equations of the Second Kind, 1997, section 4).
        """
        if not len(points):
            return np.empty((0, self.density.shape[1]), dtype=np.complex128)
        nodes = self.surface.nodes
        close = np.zeros(len(nodes.centres), dtype=bool)
        close[find_near(nodes, points, self.surface.near_rule.reach)[1]] = True
        pieces, parents = cut(nodes.six_nodes[close], np.full(int(close.sum()), 2))
        contact = nodes.contact[close][parents]
        fine = place_nodes(pieces, np.zeros(len(pieces), dtype=np.int64), contact)
        fine_pressure = self._heard_from_skin(nodes, self._skin_pressure, fine.points)
        mixed = np.concatenate([nodes.six_nodes[~close], pieces])
        contact = np.concatenate([nodes.contact[~close], contact])
        return self._heard_from_skin(
            place_nodes(mixed, np.zeros(len(mixed), dtype=np.int64), contact),
            np.concatenate([self._skin_pressure[np.repeat(~close, 6)], fine_pressure]),
            points,
        )

    def _heard_from_density(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure by the transposed solution: right for beacons near the skin, heard away from it."""
        surface = self.surface
        places = np.concatenate([surface.nodes.points, surface.shifted])
        strengths = self._spoken
        scattered = monopole_pressure(points, places, strengths, surface.wavenumber, surface.precision)
        return self._free(points, self.factors[:, None] * self.sources.strengths) + scattered

    @property
    def _spoken(self) -> Complex128[np.ndarray, "places sounds"]:
        """Monopoles at the nodes and the shifted points [Pa·m]."""
        shared = self.density.reshape(-1, _kernels.sharing, self.density.shape[1]).sum(axis=1)
        return np.concatenate([self.density, -1j * shared])

    def _slopes_from_density(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points 3 sounds"]:
        """∇p by the transposed solution [Pa/m], away from the skin."""
        places = np.concatenate([self.sources.positions, self.surface.nodes.points, self.surface.shifted])
        spoken = self.factors[:, None] * self.sources.strengths
        everything = Monopoles(places, np.concatenate([spoken, self._spoken]))
        return open_air_slopes(points, everything, self.surface.wavenumber)

    def _free(
        self, points: Real[np.ndarray, "points 3"], strengths: Complex128[np.ndarray, "sources sounds"]
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Pressure of the sources alone, in float32 where that is the precision and they are a wavelength off."""
        close = np.ones(len(points), dtype=bool)
        if self.surface.precision == "float32":
            within = self.scene.wavelength
            close = KDTree(self.sources.positions).query(points, distance_upper_bound=within)[0] < within
        out = np.empty((len(points), strengths.shape[1]), dtype=np.complex128)
        for chosen, precision in ((close, "float64"), (~close, "float32")):
            some, places = points[chosen], self.sources.positions
            out[chosen] = monopole_pressure(some, places, strengths, self.surface.wavenumber, precision)
        return out
