"""The two solutions of the dual-surface equation, and the fields that follow from them.

The direct solution is the pressure on the surface: the field is the incident pressure plus its
double layer. The transposed (adjoint) solution is a density of monopoles on and under the surface
that radiates what the bodies scatter: by reciprocity it is right away from the bodies even when a
source touches one of them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64, Real

from airtact import _kernels
from airtact.acoustics.solvers.bem.layer_potentials import double_layer_pressure, project_contacts
from airtact.acoustics.solvers.bem.operator import DualSurface
from airtact.acoustics.solvers.bem.quadrature import Nodes, find_near, place_nodes
from airtact.acoustics.solvers.bem.target_cells import Cells
from airtact.acoustics.solvers.monopoles import monopole_pressure
from airtact.acoustics.solvers.velocity import open_air_gradient
from airtact.acoustics.sources import Monopoles, nearest_source
from airtact.geometry.mesh.quadratic_triangles import cut, shape_functions, shape_gradients
from airtact.printing import in_short

BESIDE = 1e-4
"""Points in cells that are nearer to a source than this are evaluated in double precision [m]."""

REACH = 0.3
"""Size of the triangle of samples around a point, over that of its panel."""

POWERS = [(first, second) for first in range(4) for second in range(4 - first)]
"""Powers of the two reference coordinates in a cubic."""

SAMPLES = np.array(POWERS) / 3.0
"""(10, 2) reference coordinates of the samples that the cubic interpolates."""

CUBIC = np.linalg.inv(
    np.stack([SAMPLES[:, 0] ** a * SAMPLES[:, 1] ** b for a, b in POWERS], axis=1)
)
"""(10, 10): column j holds the coefficients of the cubic that is 1 at sample j and 0 at the others."""

IN_PLANE = 1e-9
"""Distance from the plane of a flat panel below which a point lies in it [m]."""

POINTS_AT_ONCE = 2048

NodalPressure = tuple[Nodes, Complex128[np.ndarray, "nodes sounds"]]
"""Nodes and the pressure at them."""


@dataclass(frozen=True, eq=False)
class DirectSolution:
    """Total pressure at the nodes [Pa], and the field by Green's formula."""

    sources: Monopoles
    surface: DualSurface
    pressure: Complex128[np.ndarray, "nodes sounds"]

    __repr__ = in_short

    def at(
        self,
        points: Float64[np.ndarray, "points 3"],
        contact: Bool[np.ndarray, "points"],
        total: bool = True,
        given: NodalPressure | None = None,
        cells: Cells | None = None,
        nodal: bool = False,
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Total (or scattered) pressure [Pa] at points (P, 3), some of which were projected onto the surface.

        There, the integral equation gives twice the incident pressure plus the double layer.
        ``given`` is the pressure on the surface if it is not the one at the plain nodes.
        """
        nodes, pressure = given or (self.surface.nodes, self.pressure)
        wavenumber, rule, precision = (
            self.surface.wavenumber,
            self.surface.near_rule,
            self.surface.precision,
        )
        projected = None if nodal else contact
        layer = double_layer_pressure(
            points, nodes, pressure, wavenumber, rule, precision, cells, nodal, projected
        )
        factor = np.where(contact, 2, 1)[:, None]
        if total:
            return factor * (incident_pressure(points, self.sources, self.surface, cells) + layer)
        layer *= factor
        layer[contact] += incident_pressure(points[contact], self.sources, self.surface)
        return layer

    def near(
        self,
        points: Float64[np.ndarray, "points 3"],
        contact: Bool[np.ndarray, "points"] | None = None,
        total: bool = True,
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Total (or scattered) pressure on and near the surface [Pa], from panels refined there."""
        if not len(points):
            return np.empty((0, self.pressure.shape[1]), dtype=np.complex128)
        if contact is None:
            points, contact = project_contacts(self.surface.nodes, points)
        return self.at(points, contact, total, self.refined(points))

    def refined(self, points: Float64[np.ndarray, "points 3"]) -> NodalPressure:
        """Nodes and pressure on the surface, with smaller panels near some points.

        The panels near the points are cut in four and given the pressure of the integral equation
        itself (twice the incident pressure plus the double layer), which is smoother than the
        quadratic through the six nodes: Nyström's own interpolation (Atkinson, The Numerical
        Solution of Integral Equations of the Second Kind, 1997, section 4). A flat sound-hard panel
        in one plane with a point has no double layer there, and stays as it is.
        """
        nodes = self.surface.nodes
        close = np.zeros(len(nodes.centres), dtype=bool)
        target, panel = find_near(nodes, points, self.surface.near_rule.reach)
        close[panel[~_in_one_plane(nodes, points[target], panel)]] = True
        if not close.any():
            return nodes, self.pressure
        pieces, parents = cut(nodes.quadratic_triangles[close], np.full(int(close.sum()), 2))
        contact, admittance = nodes.contact[close][parents], nodes.admittance[close][parents]
        fine = place_nodes(pieces, np.zeros(len(pieces), dtype=np.int64), contact, admittance)
        fine_pressure = self.at(fine.points, np.ones(len(fine.points), dtype=bool), nodal=True)
        mixed = np.concatenate([nodes.quadratic_triangles[~close], pieces])
        admittance = np.concatenate([nodes.admittance[~close], admittance])
        placed = place_nodes(
            mixed, np.zeros(len(mixed), dtype=np.int64), np.zeros(len(mixed)), admittance
        )
        placed = replace(placed, contact=np.concatenate([nodes.contact[~close], contact]))
        return placed, np.concatenate([self.pressure[np.repeat(~close, 6)], fine_pressure])


@dataclass(frozen=True, eq=False)
class TransposedSolution:
    """Monopoles on and under the surface that radiate the scattered field: their strengths at the nodes [Pa·m].

    ``factors`` are 1 for sources off the surface, 2 for those on it, which radiate together with
    their image.
    """

    sources: Monopoles
    surface: DualSurface
    density: Complex128[np.ndarray, "nodes sounds"]
    factors: Float64[np.ndarray, "sources"]

    __repr__ = in_short

    @cached_property
    def emitted(self) -> Monopoles:
        """The sources, together with the images of those on the surface."""
        return Monopoles(self.sources.positions, self.factors[:, None] * self.sources.strengths)

    @cached_property
    def scattering(self) -> Monopoles:
        """The monopoles at the nodes and at the shifted points."""
        return Monopoles(*self._scattering)

    @cached_property
    def _scattering(
        self,
    ) -> tuple[Float64[np.ndarray, "sources 3"], Complex128[np.ndarray, "sources sounds"]]:
        """Their positions and strengths, which ``Monopoles`` would check."""
        shared = np.einsum(
            "gns->gs", self.density.reshape(-1, _kernels.sharing, self.density.shape[1])
        )
        points = np.concatenate([self.surface.nodes.points, self.surface.shifted])
        return points, np.concatenate([self.density, -1j * shared])

    def at(
        self,
        points: Float64[np.ndarray, "points 3"],
        total: bool = True,
        cells: Cells | None = None,
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Total (or scattered) pressure [Pa] at points (P, 3) away from the surface."""
        (positions, strengths), wavenumber = self._scattering, self.surface.wavenumber
        if cells is not None:
            scattered = cells.sums(positions, None, strengths, wavenumber)
        else:
            scattered = monopole_pressure(
                points, positions, strengths, wavenumber, self.surface.precision
            )
        if total:
            return incident_pressure(points, self.emitted, self.surface, cells) + scattered
        image = self.factors > 1
        if image.any():
            images = Monopoles(self.sources.positions[image], self.sources.strengths[image])
            scattered += incident_pressure(points, images, self.surface, cells)
        return scattered

    def gradient(
        self, points: Real[np.ndarray, "points 3"]
    ) -> Complex128[np.ndarray, "points 3 sounds"]:
        """∇p of the total pressure [Pa/m] at points (P, 3) away from the surface, in closed form."""
        positions = np.concatenate([self.emitted.positions, self.scattering.positions])
        strengths = np.concatenate([self.emitted.strengths, self.scattering.strengths])
        return open_air_gradient(points, Monopoles(positions, strengths), self.surface.wavenumber)


def _in_one_plane(
    nodes: Nodes, points: Float64[np.ndarray, "pairs 3"], panel: Int64[np.ndarray, "pairs"]
) -> Bool[np.ndarray, "pairs"]:
    """Whether each point lies in the plane of a flat, sound-hard panel."""
    own = 6 * panel[:, None] + np.arange(6)
    off = np.einsum("nsd,nsd->ns", nodes.points[own] - points[:, None], nodes.normals[own])
    return (np.abs(off).max(axis=1) < IN_PLANE) & (nodes.admittance[panel] == 0)


def incident_pressure(
    points: Real[np.ndarray, "points 3"],
    sources: Monopoles,
    surface: DualSurface,
    cells: Cells | None = None,
) -> Complex128[np.ndarray, "points sounds"]:
    """Pressure of the sources alone [Pa], in float32 where that is the precision and they are a wavelength away."""
    if cells is not None:
        pressure = cells.sums(sources.positions, None, sources.strengths, surface.wavenumber)
        beside = np.flatnonzero(nearest_source(points, sources, BESIDE)[0] < BESIDE)
        pressure[beside] = incident_pressure(points[beside], sources, surface)
        return pressure
    close = np.ones(len(points), dtype=bool)
    if surface.precision == "float32":
        wavelength = 2 * np.pi / surface.wavenumber.real
        close = nearest_source(points, sources, wavelength)[0] < wavelength
    if not close.any():
        return monopole_pressure(
            points, sources.positions, sources.strengths, surface.wavenumber, "float32"
        )
    out = np.empty((len(points), sources.strengths.shape[1]), dtype=np.complex128)
    given = sources.positions, sources.strengths, surface.wavenumber
    for chosen, precision in ((close, "float64"), (~close, "float32")):
        out[chosen] = monopole_pressure(points[chosen], *given, precision)
    return out


def _cubic_gradients(
    points: Real[np.ndarray, "points 2"],
) -> tuple[Float64[np.ndarray, "points 10"], ...]:
    """Differentiate the cubics of the ten samples along both reference coordinates, at points (P, 2)."""
    u, v = points[:, 0], points[:, 1]
    along_u = np.stack([a * u ** max(a - 1, 0) * v**b for a, b in POWERS], axis=1)
    along_v = np.stack([b * u**a * v ** max(b - 1, 0) for a, b in POWERS], axis=1)
    return along_u @ CUBIC, along_v @ CUBIC


def surface_gradient(
    nodes: Nodes,
    panel: Int64[np.ndarray, "points"],
    reference: Float64[np.ndarray, "points 2"],
    pressure: Callable[
        [Float64[np.ndarray, "samples 3"]], Complex128[np.ndarray, "samples sounds"]
    ],
) -> Complex128[np.ndarray, "points 3 sounds"]:
    """Tangential gradient of the pressure [Pa/m], from a cubic through ten samples on the panel of each point.

    The points have reference coordinates on their panels. The samples fill the panel's own triangle
    shrunk towards the point, so that none leaves the panel; ``pressure`` returns the pressure [Pa]
    there.
    """
    gradients = []
    for first in range(0, len(panel), POINTS_AT_ONCE):
        block = slice(first, first + POINTS_AT_ONCE)
        six, here = nodes.quadratic_triangles[panel[block]], reference[block]
        references = (1.0 - REACH) * here[:, None] + REACH * SAMPLES
        shape = shape_functions(references.reshape(-1, 2)).reshape(len(six), -1, 6)
        sampled = pressure(np.einsum("tkn,tnd->tkd", shape, six).reshape(-1, 3)).reshape(
            len(six), len(SAMPLES), -1
        )
        # the point has the same reference coordinates in the shrunken triangle as in the panel
        rises = np.stack(
            [np.einsum("tk,tks->ts", along, sampled) / REACH for along in _cubic_gradients(here)],
            axis=1,
        )
        along = np.stack(
            [np.einsum("tn,tnd->td", each, six) for each in shape_gradients(here)], axis=1
        )
        metric = np.linalg.inv(along @ along.transpose(0, 2, 1))
        gradients.append(np.einsum("tad,tab,tbs->tds", along, metric, rises))
    return np.concatenate(gradients)
