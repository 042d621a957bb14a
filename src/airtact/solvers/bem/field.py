"""The field around rigid bodies, heard from the boundary element solution."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real
from scipy.spatial import KDTree

from airtact import _kernels
from airtact.conventions import InvalidInput
from airtact.mesh.quadratic_triangles import cut, points_at
from airtact.printing import in_short
from airtact.scene.scene import Scene
from airtact.scene.sources import Monopoles, nearest_source
from airtact.solvers.bem.layer_potentials import double_layer_pressure, find_contacts, near_skin, project_contacts
from airtact.solvers.bem.operator import DualSurface
from airtact.solvers.bem.point_location import Sides, sides_of
from airtact.solvers.bem.quadrature import Nodes, find_near, place_nodes
from airtact.solvers.bem.surface_gradient import skin_slopes
from airtact.solvers.bem.target_cells import Cells, cells_of
from airtact.solvers.monopoles import monopole_pressure
from airtact.solvers.problem import DIFFERENCE, RadiatedField, SolveReport, SurfaceField, receivers
from airtact.solvers.velocity import differences, open_air_slopes, velocity_of
from airtact.validation import points_of

SHARED_ERROR = 0.15
"""Share of the accuracy that the error estimate never goes below, where all the sound is scattered."""

SHARE_OF_CELLS = 0.04
"""Share of the accuracy that hearing many points in cells may cost."""

BESIDE = 1e-4
"""Points of a picture that are nearer to a source are not heard in single precision [m]."""

LEAST_ROOM = 1.0 / 60.0
"""Height over the skin, in wavelengths, below which differences of the pressure are too noisy."""


OnSkin = tuple[Nodes, Complex128[np.ndarray, "nodes sounds"]]
"""Nodes and the pressure at them."""


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
    def on_surface(self) -> SurfaceField:
        """Pressure at the nodes of the skin, from the direct solution."""
        nodes = self.surface.nodes
        return SurfaceField(nodes.points, nodes.normals, nodes.weights, self._skin_pressure)

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
        return self._sides(points_of(points, "points", least=0)).outside

    def _sides(self, points: Float64[np.ndarray, "points 3"]) -> Sides:
        return sides_of(self.scene, self.surface.nodes, points, self.surface.near_rule)

    def at(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure [Pa] at points (P, 3) for each of the S sounds; NaN inside the bodies.

        On and near the skin it is the direct solution's. Elsewhere it is the transposed one's for sounds that have a
        source near the skin, and the mean of both for the others, which makes A heard at B equal B heard at A.

        Many points close together, such as those of a picture, are heard in cells, to ``SHARE_OF_CELLS`` of the
        accuracy; there the others are the direct solution's everywhere, from the finer panels that near points ask for.

        Raises
        ------
        InvalidInput
            A point is NaN or infinite, or stands on a source.
        """
        points = receivers(points, self.sources)
        sides = self._sides(points)
        most = sides.outside & ~sides.contact  # what was put on its panel is no longer in the plane of a picture
        cells = cells_of(sides.places[most], self.scene.wavelength, self._error_of_cells)
        if cells is not None:
            return self._heard_in_cells(cells, sides, most)
        out = np.full((len(points), self.density.shape[1]), np.nan, dtype=np.complex128)
        near, away = sides.outside & sides.near, sides.outside & ~sides.near
        out[near] = self._heard_near(sides.places[near], sides.contact[near])
        out[away] = self._heard_away(sides.places[away])
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
        points = receivers(points, self.sources)
        nodes, least = self.surface.nodes, LEAST_ROOM * self.scene.wavelength
        sides = self._sides(points)
        near, outside = sides.near, sides.outside
        slopes = np.full((len(points), 3, self.density.shape[1]), np.nan, dtype=np.complex128)
        close = find_contacts(nodes, points[outside], least)
        target = np.flatnonzero(outside)[close.target]
        between, away = outside & near, outside & ~near
        between[target] = away[target] = False
        if len(target):
            feet, normals = points_at(nodes.quadratic_triangles[close.panel], close.foot)
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
        transposed, away = self._heard_from_density(points), self._sources_away
        if away.any():
            transposed[:, away] = 0.5 * (transposed[:, away] + self.direct_at(points)[:, away])
        return transposed

    @property
    def _sources_away(self) -> Bool[np.ndarray, "sounds"]:
        """Sounds that are heard by both solutions, all sources being away from the skin."""
        if self.pressure is None:
            return np.zeros(self.density.shape[1], dtype=bool)
        near = near_skin(self.surface.nodes, self.sources.positions, self.surface.near_rule.reach)
        return ~(self.sources.strengths[near] != 0).any(axis=0)

    def _heard_in_cells(
        self, cells: Cells, sides: Sides, most: Bool[np.ndarray, "points"]
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Pressure at many points, most of them in cells; each solution at all of these if it is needed at some."""
        out = np.full((len(most), self.density.shape[1]), np.nan, dtype=np.complex128)
        places, near, direct = sides.places[most], sides.near[most], self._sources_away
        if not direct.all() and not near.all():
            out[most] = self._heard_from_density(places, cells)
        if direct.any() or (sides.near & sides.outside).any():
            finer = self._finer(sides.places[sides.near & sides.outside])
            heard = self._heard_from_skin(finer, places, np.zeros(len(places), dtype=bool), cells)
            out[most] = np.where(near[:, None] | direct, heard, out[most])
            touching = sides.places[sides.contact]
            out[sides.contact] = self._heard_from_skin(finer, touching, np.ones(len(touching), dtype=bool))
        return out

    @property
    def _error_of_cells(self) -> float:
        return SHARE_OF_CELLS * float(self.report.settings["accuracy"]) if self.surface.precision == "float32" else 0.0

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
        places, contact = project_contacts(self.surface.nodes, points_of(points, "points", least=0))
        return self._heard_from_skin((self.surface.nodes, self._skin_pressure), places, contact)

    def _heard_from_skin(
        self,
        on_skin: OnSkin,
        points: Float64[np.ndarray, "points 3"],
        contact: Bool[np.ndarray, "points"],
        cells: Cells | None = None,
        nodal: bool = False,
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Incident pressure plus the double layer of a pressure on the skin; twice that on the skin itself."""
        wavenumber, rule, precision = self.surface.wavenumber, self.surface.near_rule, self.surface.precision
        out = self._free(points, self.sources.strengths, cells)
        touching = None if nodal else contact
        out += double_layer_pressure(points, *on_skin, wavenumber, rule, precision, cells, nodal, touching)
        return np.where(contact, 2, 1)[:, None] * out

    def _heard_near(
        self, points: Float64[np.ndarray, "points 3"], contact: Bool[np.ndarray, "points"] | None = None
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Pressure on and near the skin, at points of which some touch it."""
        if not len(points):
            return np.empty((0, self.density.shape[1]), dtype=np.complex128)
        if contact is None:
            points, contact = project_contacts(self.surface.nodes, points)
        return self._heard_from_skin(self._finer(points), points, contact)

    def _finer(self, points: Float64[np.ndarray, "points 3"]) -> OnSkin:
        """Nodes and pressure on the skin, finer near some points.

        The panels near the points are cut in four and given the pressure that the equation itself says (twice the
        incident pressure plus the double layer), which is smoother than the quadratic through the six nodes: Nyström's
        own interpolation (Atkinson, The Numerical Solution of Integral Equations of the Second Kind, 1997, section 4).
        """
        nodes = self.surface.nodes
        if not len(points):
            return nodes, self._skin_pressure
        close = np.zeros(len(nodes.centres), dtype=bool)
        close[find_near(nodes, points, self.surface.near_rule.reach)[1]] = True
        pieces, parents = cut(nodes.quadratic_triangles[close], np.full(int(close.sum()), 2))
        contact = nodes.contact[close][parents]
        fine = place_nodes(pieces, np.zeros(len(pieces), dtype=np.int64), contact)
        touching = np.ones(len(fine.points), dtype=bool)
        fine_pressure = self._heard_from_skin((nodes, self._skin_pressure), fine.points, touching, nodal=True)
        mixed = np.concatenate([nodes.quadratic_triangles[~close], pieces])
        contact = np.concatenate([nodes.contact[~close], contact])
        coarse = self._skin_pressure[np.repeat(~close, 6)]
        placed = place_nodes(mixed, np.zeros(len(mixed), dtype=np.int64), contact)
        return replace(placed, contact=contact), np.concatenate([coarse, fine_pressure])

    def _heard_from_density(
        self, points: Real[np.ndarray, "points 3"], cells: Cells | None = None
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure by the transposed solution: right for beacons near the skin, heard away from it."""
        surface = self.surface
        places = np.concatenate([surface.nodes.points, surface.shifted])
        free = self._free(points, self.factors[:, None] * self.sources.strengths, cells)
        if cells is not None:
            return free + cells.heard(places, None, self._spoken, surface.wavenumber)
        return free + monopole_pressure(points, places, self._spoken, surface.wavenumber, surface.precision)

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
        self,
        points: Real[np.ndarray, "points 3"],
        strengths: Complex128[np.ndarray, "sources sounds"],
        cells: Cells | None = None,
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Pressure of the sources alone, in float32 where that is the precision and they are a wavelength off."""
        if cells is not None:
            heard = cells.heard(self.sources.positions, None, strengths, self.surface.wavenumber)
            beside = np.flatnonzero(nearest_source(points, self.sources, BESIDE)[0] < BESIDE)
            heard[beside] = self._free(points[beside], strengths)
            return heard
        close = np.ones(len(points), dtype=bool)
        if self.surface.precision == "float32":
            within = self.scene.wavelength
            close = KDTree(self.sources.positions).query(points, distance_upper_bound=within)[0] < within
        out = np.empty((len(points), strengths.shape[1]), dtype=np.complex128)
        for chosen, precision in ((close, "float64"), (~close, "float32")):
            some, places = points[chosen], self.sources.positions
            out[chosen] = monopole_pressure(some, places, strengths, self.surface.wavenumber, precision)
        return out
