"""The fields that ``BoundaryElement`` returns around bodies and boards, and their estimated error.

The pressure near elements in the face of a reflecting board varies faster than panels resolve, so
the direct solution fails there. The monopoles of the transposed solution on the boards radiate the
reflections of the boards. Together with the elements, these monopoles are the sources of a second,
smaller solve around the other bodies, which is also accurate on and near their surfaces.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Complex128, Float64

from airtact import _kernels
from airtact.acoustics.scene import Plane, Scene, before_planes, with_images
from airtact.acoustics.solvers.bem.layer_potentials import (
    Cells,
    Located,
    cells_of,
    locate,
    near_surface,
    project_contacts,
)
from airtact.acoustics.solvers.bem.quadrature import RULE_POINTS, place_nodes
from airtact.acoustics.solvers.bem.solutions import (
    DirectSolution,
    DualSurface,
    TransposedSolution,
    incident_pressure,
)
from airtact.acoustics.solvers.problem import (
    RadiatedField,
    SolveReport,
    SurfaceField,
)
from airtact.acoustics.solvers.shared import (
    Mask,
    NodeValues,
    Points,
    Pressures,
    Vectors,
)
from airtact.acoustics.sources import STANDS_ON, Monopoles, nearest_source
from airtact.errors import InvalidInput, in_mm, points_of
from airtact.geometry.distances import nearest

# In a reflected panel, corners 0 and 2 are exchanged so that its normal points outward. Corner 1
# stays, and the three nodes near it, which share a second collocation point, remain a group.
_MIRRORED = np.array([2, 1, 0, 4, 3, 5])
_TURNED_RULE = np.stack([RULE_POINTS[:, 0], 1 - RULE_POINTS.sum(axis=1)], axis=1)
# Node of a panel for each node of its image.
_NODE_ORDER = np.linalg.norm(_TURNED_RULE[:, None] - RULE_POINTS, axis=2).argmin(axis=1)


def surface_with_images(surface: DualSurface, planes: Sequence[Plane]) -> DualSurface:
    """Return the surface of the bodies, followed by the surface of their images in the planes."""
    for plane in planes:
        nodes = surface.nodes
        panels = nodes.quadratic_triangles
        # The images count as further bodies.
        mirrored = plane.image(panels.reshape(-1, 3)).reshape(panels.shape)[:, _MIRRORED]
        bodies = nodes.body[::6]
        all_nodes = place_nodes(
            np.concatenate([panels, mirrored]),
            body=np.concatenate([bodies, bodies + bodies.max() + 1]),
            deviation=np.zeros(2 * len(panels)),
            admittance=np.tile(nodes.admittance, 2),
        )
        surface = replace(
            surface,
            nodes=replace(all_nodes, contact=np.tile(nodes.contact, 2)),
            shifted=np.concatenate([surface.shifted, plane.image(surface.shifted)]),
        )
    return surface


def values_with_images(
    values: Complex128[np.ndarray, "nodes excitations"], planes: Sequence[Plane]
) -> Complex128[np.ndarray, "all excitations"]:
    """Return values at the nodes, such as the pressure, followed by the values at their images."""
    for _ in planes:
        by_panel = values.reshape(-1, 6, values.shape[1])
        values = np.concatenate([values, by_panel[:, _NODE_ORDER].reshape(values.shape)])
    return values


@dataclass(frozen=True, eq=False, repr=False)
class BoundaryField(RadiatedField):
    """The field of monopoles around bodies, solved by ``BoundaryElement``.

    On and near the surface, the pressure is taken from the direct solution. Elsewhere, excitations
    with a source near the surface use the transposed solution. All other excitations use the mean
    of both solutions, which makes the field reciprocal. Many points close together, such as those
    of a picture, are evaluated in cells, which adds a relative error of 0.04 times ``accuracy``. In
    cells, the direct solution is used for all excitations without a source near the surface. The
    field raises ``InvalidInput`` on and near the surface if the direct equation was not solved
    (``estimate=False``).

    Attributes
    ----------
    surface : collocation points of the bodies, without their images in a plane.
    pressure : the direct solution, which is the pressure at the nodes [Pa]; None if not computed.
    density : the transposed solution; None if not computed.
    factors : factor by which each source's strength is multiplied: 2 on a body and 1 elsewhere.
    accuracy : target relative error.
    max_error : relative error above which the report contains a warning.
    coarse : whether the direct solution is evaluated everywhere, in single precision and without
        smaller panels near the points.
    """

    surface: DualSurface
    pressure: NodeValues | None
    density: NodeValues | None
    factors: Float64[np.ndarray, "sources"]
    accuracy: float
    max_error: float
    coarse: bool = False

    @cached_property
    def direct(self) -> DirectSolution:
        """The direct solution. Raises ``InvalidInput`` if it was not computed."""
        if self.pressure is None:
            raise InvalidInput(
                "this solution does not provide the pressure on or near the surface, because "
                "estimate is False; solve with estimate = True.",
                code="not_supported",
            )
        pressure = values_with_images(self.pressure, self.scene.planes)
        return DirectSolution(self._emitting, self._mirrored, pressure)

    @cached_property
    def transposed(self) -> TransposedSolution:
        """The transposed solution, if it was computed."""
        assert self.density is not None
        planes = self.scene.planes
        density = values_with_images(self.density, planes)
        factors = np.tile(self.factors, 1 + len(planes))
        return TransposedSolution(self._emitting, self._mirrored, density, factors)

    @cached_property
    def _mirrored(self) -> DualSurface:
        return surface_with_images(self.surface, self.scene.planes)

    @cached_property
    def _emitting(self) -> Monopoles:
        return with_images(self.scene.planes, self.sources)

    @property
    def scattering_sources(self) -> Monopoles | None:
        """Monopoles of the transposed solution, and a second copy of each source on a body.

        The result is None if the scene has a plane, because the mirror images of the sources would
        be missing.
        """
        if self.density is None or self.scene.planes:
            return None
        monopoles = self.transposed.scattering
        images = self.factors > 1
        if not images.any():
            return monopoles
        return Monopoles(
            np.concatenate([monopoles.positions, self.sources.positions[images]]),
            np.concatenate([monopoles.strengths, self.sources.strengths[images]]),
        )

    @property
    def without_images(self) -> "BoundaryField":
        """The field of sources and bodies without their images in a plane."""
        return replace(self, scene=replace(self.scene, planes=())) if self.scene.planes else self

    @property
    def for_pictures(self) -> "BoundaryField":
        """The field of the direct solution alone (if it was computed), without refined panels.

        The rms difference from the full field is 0.1 % of the largest pressure; at the skin, the
        difference is up to 4 %.
        """
        return self if self.pressure is None else replace(self, coarse=True)

    @property
    def on_surface(self) -> SurfaceField:
        """Total pressure at the nodes from the direct solution, which must have been computed."""
        nodes = self.surface.nodes
        pressure = self.direct.pressure[: len(nodes.points)]  # without the images
        return SurfaceField(nodes.points, nodes.normals, nodes.weights, pressure)

    def _valid(self, points: Vectors) -> Mask:
        return locate(self.scene, self._mirrored.nodes, points, self._mirrored.near_rule).outside

    def _at(self, points: Vectors) -> Pressures:
        return self._evaluated(points, total=True)

    def _scattered_at(self, points: Vectors) -> Pressures:
        out = self._evaluated(points, total=False)
        distance, source = nearest_source(points, self.sources, STANDS_ON)
        on = np.flatnonzero(distance < STANDS_ON)
        # The image of a source that touches a body makes the scattered pressure there infinite.
        out[on[self.factors[source[on]] > 1]] = np.nan
        for plane in self.scene.planes:
            images = Monopoles(plane.image(self.sources.positions), self.sources.strengths)
            off = nearest_source(points, images, STANDS_ON)[0] >= STANDS_ON
            out[off] += incident_pressure(points[off], images, self._mirrored)
            out[~off] = np.nan
        return out

    def _evaluated(self, points: Vectors, total: bool) -> Pressures:
        located = locate(self.scene, self._mirrored.nodes, points, self._mirrored.near_rule)
        out = self.nowhere(points)
        if self.coarse:
            outside = located.outside
            out[outside] = self.direct.at(
                located.points[outside], located.contact[outside], total, coarse=True
            )
            return out
        near = located.outside & located.near
        # Projected points are no longer in the plane of a picture, so they are not put into cells.
        off = located.outside & ~located.contact
        error = 0.04 * self.accuracy if self._mirrored.precision == "float32" else 0.0
        cells = cells_of(located.points[off], self.scene.wavelength, error)
        if cells is not None:
            return self._in_cells(cells, located, off, total)
        if near.any():
            out[near] = self.direct.near(located.points[near], located.contact[near], total)
        away = located.outside & ~located.near
        if self.density is None:
            out[away] = self.direct_at(located.points[away], total)
            return out
        out[away] = self.transposed.at(located.points[away], total)
        # The mean of both solutions is symmetric in source and receiver.
        averaged = self._served_by_both
        if averaged.any():
            direct = self.direct_at(located.points[away], total)[:, averaged]
            out[np.ix_(away, averaged)] = 0.5 * (out[np.ix_(away, averaged)] + direct)
        return out

    def _in_cells(self, cells: Cells, located: Located, off: Mask, total: bool) -> Pressures:
        """Return the pressure [Pa] at many points; those ``off`` the surface are computed in cells.

        A solution that one of the points needs is evaluated at all points.
        """
        out = self.nowhere(located.points)
        points = located.points[off]
        near = located.near[off]
        direct = self._served_by_both | (self.density is None)
        if not direct.all() and not near.all():
            out[off] = self.transposed.at(points, total, cells)
        # The direct solution is better near the surface and for sources away from it.
        close = located.near & located.outside
        if direct.any() or close.any():
            refined = self.direct.refined(located.points[close])
            nowhere = np.zeros(len(points), dtype=bool)
            pressure = self.direct.at(points, nowhere, total, refined, cells)
            out[off] = np.where(near[:, None] | direct, pressure, out[off])
            touching = located.points[located.contact]
            on_surface = np.ones(len(touching), dtype=bool)
            out[located.contact] = self.direct.at(touching, on_surface, total, refined)
        return out

    @cached_property
    def _served_by_both(self) -> Bool[np.ndarray, "excitations"]:
        """Excitations with all sources away from the surface, if both equations were solved."""
        if self.pressure is None:
            return np.zeros(self.excitations, dtype=bool)
        nodes = self._mirrored.nodes
        near = near_surface(nodes, self.sources.positions, self._mirrored.near_rule.reach)
        return ~(self.sources.strengths[near] != 0).any(axis=0)

    def direct_at(self, points: Points, total: bool = True) -> Pressures:
        """Return the pressure [Pa] outside the bodies from the direct solution alone."""
        points = points_of(points, "points", least=0)
        projected, contact = project_contacts(self._mirrored.nodes, points)
        return self.direct.at(projected, contact, total)

    def error_at(self, points: Points) -> Float64[np.ndarray, "excitations"]:
        """Return the rms error of the direct solution at points, relative to the rms pressure.

        The error is estimated as the difference between the two solutions, plus
        0.15 times the target error ``accuracy`` times the scattered pressure. The second term
        accounts for the errors of panels and quadrature, which are the same in both solutions. The
        transposed solution is accurate only away from the surface, so points on or near the surface
        are moved away from it by the radius of a panel if there is room. The error is NaN without a
        direct solution.
        """
        squares, size = self._errors(points_of(points, "points"))
        size = np.linalg.norm(size, axis=0)
        return np.sqrt(squares.sum(axis=0)) / np.where(size > 0, size, 1)

    def _errors(self, points: Vectors) -> tuple[Float64[np.ndarray, "points excitations"], ...]:
        """Return squared error [Pa²] and pressure [Pa] away from the surface; NaN if unknown."""
        if self.pressure is None or self.density is None:
            unknown = np.full((len(points), self.excitations), np.nan)
            return unknown, unknown
        points, touching = self._lifted(points)
        # The difference between the solutions shows the errors that they do not share.
        transposed = self.transposed.at(points)
        difference = self.direct_at(points) - transposed
        # At a surface the difference is mostly the error of the transposed solution.
        difference[touching] *= 0.35
        scattered = transposed - incident_pressure(points, self.sources, self._mirrored)
        squares = np.abs(difference) ** 2 + (0.15 * self.accuracy * np.abs(scattered)) ** 2
        return squares, np.abs(transposed)

    def _lifted(self, points: Vectors) -> tuple[Vectors, Mask]:
        """Move points near the surface away by a panel's radius, unless another surface is near.

        The second result is whether each point is still within a quarter of a panel's radius of
        a surface.
        """
        nodes = self._mirrored.nodes
        near = np.flatnonzero(near_surface(nodes, points, self._mirrored.near_rule.reach))
        touching = np.zeros(len(points), dtype=bool)
        if not len(near):
            return points, touching
        node = nearest(points[near], nodes.points)[1]
        radius = nodes.radii[node // 6]
        away = points[near] + radius[:, None] * nodes.normals[node]
        # Moved points must not come near another surface or an image behind a plane.
        free = -self.scene.depth(away) > 0.5 * radius
        for plane in self.scene.planes:
            free &= -self.scene.depth(plane.image(away)) > 0.5 * radius
        points = points.copy()
        touching[near] = ~free & (-self.scene.depth(points[near]) < 0.25 * radius)
        points[near[free]] = away[free]
        return points, touching

    def report_at(self, points: Points) -> SolveReport:
        """Return the report, with its error raised to the largest error estimated at the points.

        The error in the report never decreases. Points inside bodies are ignored. The error at a
        point is relative to the pressure there, or to a tenth of the strongest pressure if that is
        larger. If an error exceeds 1.25 times ``max_error``, a warning names the worst point.
        Without a direct solution or without points, the report is unchanged.
        """
        points = points_of(points, "points", least=0)
        outside = (self.scene.depth(points) <= 0.0) & before_planes(self.scene.planes, points)
        points = points[outside]
        if self.pressure is None or self.density is None or not len(points):
            return self.report
        squares, _ = self._errors(points)
        # The error is relative to the pressure at the point, which is low in a shadow. A point with
        # almost no pressure matters less than one with a high pressure.
        pressure = self._at(points)
        # Near the surface, refined panels yield a more accurate pressure than plain ones. In a
        # shadow both are inaccurate if the panels are too large. The error of refined panels is up
        # to 0.7 of the difference.
        squares = squares + np.abs(0.7 * (pressure - self.direct_at(points))) ** 2
        pressure = np.abs(pressure)
        size = np.maximum(pressure, 0.1 * pressure.max(axis=0))
        errors = (np.sqrt(squares) / np.where(size > 0, size, 1)).max(axis=1)
        error = float(errors.max())
        warnings = self.report.warnings
        if error > 1.25 * self.max_error:  # the estimate itself scatters
            warnings = (
                *warnings,
                f"near {in_mm(points[errors.argmax()])} the pressure has an estimated error of "
                f"{100 * error:.1f} %, above the limit of {100 * self.max_error:.1f} %: points "
                "in a shadow, a narrow gap or a cavity need a smaller value of accuracy, such as "
                f"{self.max_error / 3:.2g}.",
            )
        return replace(
            self.report,
            estimated_error=float(np.fmax(error, self.report.estimated_error)),
            warnings=warnings,
        )


NOT_ESTIMATED = (
    "the estimated error applies around the bodies and excludes the errors of the boards' "
    "reflections"
)


@dataclass(frozen=True, eq=False, repr=False)
class BoardField(RadiatedField):
    """The field of elements in reflecting boards, around the other bodies of a scene.

    Attributes
    ----------
    scene : scene without the boards.
    boards : scene with only the boards.
    around : field whose sources are the elements and the boards.
    reach : distance from a board within which the field is unknown [m].
    """

    boards: Scene
    around: RadiatedField
    reach: float

    @property
    def on_surface(self) -> SurfaceField:
        """Total pressure on the surfaces of the bodies other than the boards."""
        return self.around.on_surface

    def _valid(self, points: Vectors) -> Mask:
        return self.around.valid(points) & (self.boards.depth(points) < -self.reach)

    def _at(self, points: Vectors) -> Pressures:
        pressure = self.around.at(points)
        pressure[self.boards.depth(points) >= -self.reach] = np.nan
        return pressure

    def report_at(self, points: Points) -> SolveReport:
        """Return the report of this field, with the error and warnings of the field ``around``."""
        report = self.around.report_at(points)
        warnings = dict.fromkeys((*self.report.warnings, *report.warnings))  # without duplicates
        return replace(
            self.report, estimated_error=report.estimated_error, warnings=tuple(warnings)
        )


def in_boards(scene: Scene, sources: Monopoles) -> Bool[np.ndarray, "sources"]:
    """Return a mask of the sources within a micrometre of the faces of reflecting boards."""
    inside = np.zeros(len(sources.positions), dtype=bool)
    for index in scene.boards:
        inside |= np.abs(scene.obstacles[index].surface.depth(sources.positions)) < 1e-6
    return inside


def elements_and_boards(solved: BoundaryField) -> Monopoles:
    """Return a field's sources, and monopoles that radiate the sound scattered by its boards."""
    transposed = solved.without_images.transposed
    nodes = np.isin(transposed.surface.nodes.body, solved.scene.boards)
    of_boards = np.concatenate([nodes, nodes[:: _kernels.sharing]])
    emitted = transposed.emitted
    scattering = transposed.scattering
    return Monopoles(
        np.concatenate([emitted.positions, scattering.positions[of_boards]]),
        np.concatenate([emitted.strengths, scattering.strengths[of_boards]]),
    )
