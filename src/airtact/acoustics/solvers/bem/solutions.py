"""The two solutions of the dual-surface equation, and the fields that follow from them.

The direct solution is the pressure on the surface; the field is the incident pressure plus the
double layer of this pressure. The transposed (adjoint) solution is a density of monopoles on and
under the surface that radiates the scattered field. By reciprocity it is accurate away from the
bodies, even if a source touches one of them.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex128, Float64

from airtact import _kernels
from airtact.acoustics.solvers.arrays import (
    Mask,
    NodeValues,
    Points,
    Pressures,
    Vectors,
)
from airtact.acoustics.solvers.bem.layer_potentials import double_layer_pressure, project_contacts
from airtact.acoustics.solvers.bem.operator import DualSurface
from airtact.acoustics.solvers.bem.quadrature import Nodes, near_lists, place_nodes
from airtact.acoustics.solvers.bem.target_cells import Cells, monopole_layer
from airtact.acoustics.solvers.open_air import monopole_pressure
from airtact.acoustics.sources import Monopoles, nearest_source
from airtact.errors import in_short
from airtact.geometry.mesh.quadratic_triangles import cut

# Nodes, and the pressure at them [Pa].
NodalPressure = tuple[Nodes, NodeValues]


@dataclass(frozen=True, eq=False)
class DirectSolution:
    """The pressure on the surface [Pa], from which Green's formula computes the field."""

    sources: Monopoles
    surface: DualSurface
    pressure: NodeValues

    __repr__ = in_short

    def at(
        self,
        points: Vectors,
        contact: Mask,
        total: bool = True,
        on_surface: NodalPressure | None = None,
        cells: Cells | None = None,
        nodal: bool = False,
        coarse: bool = False,
    ) -> Pressures:
        """Return the total or scattered pressure [Pa].

        Parameters
        ----------
        points : positions [m]. Points in contact with the surface must already be projected
            onto it.
        contact : mask of the points on the surface. There the total pressure is twice the sum of
            incident pressure and double layer.
        on_surface : nodes and pressure on the surface; by default those of the solution.
        cells : the points sorted into cells, if sums in cells are faster.
        nodal : whether all points are on panels and away from their edges.
        coarse : whether single precision is enough for all sums.
        """
        nodes, pressure = on_surface or (self.surface.nodes, self.pressure)
        layer = double_layer_pressure(
            points,
            nodes,
            pressure,
            self.surface.wavenumber,
            near_rule=self.surface.near_rule,
            precision=self.surface.precision,
            cells=cells,
            nodal=nodal,
            contact=None if nodal else contact,
            coarse=coarse,
        )
        factor = np.where(contact, 2, 1)[:, None]
        if total:
            return factor * (incident_pressure(points, self.sources, self.surface, cells) + layer)
        layer *= factor
        layer[contact] += incident_pressure(points[contact], self.sources, self.surface)
        return layer

    def near(self, points: Vectors, contact: Mask | None = None, total: bool = True) -> Pressures:
        """Return the pressure [Pa] at points on or near the surface, with smaller panels there."""
        if not len(points):
            return np.empty((0, self.pressure.shape[1]), dtype=np.complex128)
        if contact is None:
            points, contact = project_contacts(self.surface.nodes, points)
        return self.at(points, contact, total, self.refined(points))

    def refined(self, points: Vectors) -> NodalPressure:
        """Return nodes and pressure on the surface, with smaller panels near some points.

        The panels near the points are divided into four. The pressure on the pieces follows from
        the integral equation itself, and is smoother than the quadratic through the six nodes
        (Nyström interpolation, Atkinson, The Numerical Solution of Integral Equations of the Second
        Kind, 1997, section 4).
        """
        nodes = self.surface.nodes
        first, panel = near_lists(nodes, points, self.surface.near_rule.reach * nodes.radii)
        near_points = np.repeat(points, np.diff(first), axis=0)
        offset = nodes.points.reshape(-1, 6, 3)[panel] - near_points[:, None]
        height = np.einsum("nsd,nsd->ns", offset, nodes.normals.reshape(-1, 6, 3)[panel])
        # The double layer of a flat sound-hard panel is zero in its plane.
        in_plane = (np.abs(height).max(axis=1) < 1e-9) & (nodes.admittance[panel] == 0)
        close = np.zeros(len(nodes.centres), dtype=bool)
        close[panel[~in_plane]] = True
        if not close.any():
            return nodes, self.pressure
        # The pressure on the pieces follows from the integral equation, by Nyström interpolation.
        pieces, parents = cut(nodes.quadratic_triangles[close], np.full(int(close.sum()), 2))
        contact = nodes.contact[close][parents]
        admittance = nodes.admittance[close][parents]
        fine = place_nodes(pieces, np.zeros(len(pieces), dtype=np.int64), contact, admittance)
        fine_pressure = self.at(fine.points, np.ones(len(fine.points), dtype=bool), nodal=True)
        # All other panels stay as they are.
        mixed = np.concatenate([nodes.quadratic_triangles[~close], pieces])
        placed = place_nodes(
            mixed,
            body=np.zeros(len(mixed), dtype=np.int64),
            deviation=np.zeros(len(mixed)),
            admittance=np.concatenate([nodes.admittance[~close], admittance]),
        )
        placed = replace(placed, contact=np.concatenate([nodes.contact[~close], contact]))
        return placed, np.concatenate([self.pressure[np.repeat(~close, 6)], fine_pressure])


@dataclass(frozen=True, eq=False)
class TransposedSolution:
    """Monopoles on and under the surface that radiate the scattered field.

    Attributes
    ----------
    density : strengths of the monopoles at the nodes [Pa·m].
    factors : factor for each source: 1 off the surface, and 2 on it, where a source coincides
        with its image.
    """

    sources: Monopoles
    surface: DualSurface
    density: NodeValues
    factors: Float64[np.ndarray, "sources"]

    __repr__ = in_short

    @cached_property
    def emitted(self) -> Monopoles:
        """The sources, together with the images of those on the surface."""
        return Monopoles(self.sources.positions, self.factors[:, None] * self.sources.strengths)

    @cached_property
    def scattering(self) -> Monopoles:
        """The monopoles at the nodes and at the second collocation points."""
        return Monopoles(*self._scattering)

    @cached_property
    def _scattering(
        self,
    ) -> tuple[Float64[np.ndarray, "monopoles 3"], Complex128[np.ndarray, "monopoles excitations"]]:
        """Positions and strengths of ``scattering``, without the checks of ``Monopoles``."""
        # Three nodes share a second point, which radiates −i times the sum of their strengths.
        groups = self.density.reshape(-1, _kernels.sharing, self.density.shape[1])
        points = np.concatenate([self.surface.nodes.points, self.surface.shifted])
        return points, np.concatenate([self.density, -1j * np.einsum("gns->gs", groups)])

    def at(self, points: Vectors, total: bool = True, cells: Cells | None = None) -> Pressures:
        """Return the total or scattered pressure [Pa] at points away from the surface."""
        positions, strengths = self._scattering
        wavenumber = self.surface.wavenumber
        if cells is None:
            scattered = monopole_pressure(
                points, positions, strengths, wavenumber, self.surface.precision
            )
        else:
            scattered = cells.sums(monopole_layer(positions, wavenumber), strengths)
        if total:
            return incident_pressure(points, self.emitted, self.surface, cells) + scattered
        image = self.factors > 1
        if image.any():
            images = Monopoles(self.sources.positions[image], self.sources.strengths[image])
            scattered += incident_pressure(points, images, self.surface, cells)
        return scattered


def incident_pressure(
    points: Points, sources: Monopoles, surface: DualSurface, cells: Cells | None = None
) -> Pressures:
    """Return the pressure of the sources alone [Pa], in float64 within 1 λ of a source."""
    if cells is not None:
        layer = monopole_layer(sources.positions, surface.wavenumber)
        pressure = cells.sums(layer, sources.strengths)
        near = 1e-4  # single precision is not enough closer to a source [m]
        beside = np.flatnonzero(nearest_source(points, sources, near)[0] < near)
        pressure[beside] = incident_pressure(points[beside], sources, surface)
        return pressure
    # Beside a source, float32 causes a large relative error of the distance.
    close = np.ones(len(points), dtype=bool)
    if surface.precision == "float32":
        wavelength = 2 * np.pi / surface.wavenumber.real
        close = nearest_source(points, sources, wavelength)[0] < wavelength
    out = np.empty((len(points), sources.strengths.shape[1]), dtype=np.complex128)
    for group, precision in ((close, "float64"), (~close, "float32")):
        out[group] = monopole_pressure(
            points[group], sources.positions, sources.strengths, surface.wavenumber, precision
        )
    return out
