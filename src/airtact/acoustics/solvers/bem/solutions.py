"""The dual-surface equation on curved panels, its two solutions, and the fields that follow.

Each point x of the surface has a second point x' = x − δ n inside the body. For a sound-hard body
and outgoing waves e^{+ikr}/r, the pressure p on the surface solves the equation

    p(x)/2 − D[p](x) + i D[p](x') = p_inc(x) − i p_inc(x'),

where p_inc is the pressure of the sources alone and D is the double layer. On a surface of
impedance Z, a single layer is added to D (``layer_potentials``). The second point makes the
solution unique at every frequency. With the other sign of i, GMRES needs many times as many
iterations.

Collocation at the nodes makes this a linear system with one row for each node x_i and one column
for each node x_j. Its entries are 1/2 δ_ij − D(x_i, x_j) + i D(x'_g(i), x_j), with corrected
integrals over near panels. Three neighbouring nodes share the second point of their group g. By
reciprocity, solving the transposed system gives the strengths of monopoles at x and x' that radiate
the scattered field.

A. Mohsen, R. Piscoya, M. Ochmann, Acta Acustica united with Acustica 97 (2011) 699.

The direct solution is the pressure on the surface; the field is the incident pressure plus the
double layer of this pressure. The transposed (adjoint) solution is a density of monopoles on and
under the surface that radiates the scattered field. By reciprocity it is accurate away from the
bodies, even if a source touches one of them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Complex128, Float64

from airtact import _kernels
from airtact.acoustics.scene import Plane, with_images
from airtact.acoustics.solvers.bem.block_matrix import (
    BlockMatrix,
    Store,
    blocks_of,
    check_memory,
    near_blocks,
)
from airtact.acoustics.solvers.bem.layer_potentials import (
    Cells,
    NearRule,
    double_layer_pressure,
    double_layer_transposed,
    monopole_layer,
    near_rows,
    project_contacts,
)
from airtact.acoustics.solvers.bem.quadrature import Nodes, near_lists, place_nodes, thickness
from airtact.acoustics.solvers.shared import (
    GroupPoints,
    Mask,
    NodeValues,
    Points,
    Pressures,
    SourcePoints,
    Vectors,
    monopole_pressure,
)
from airtact.acoustics.sources import Monopoles, nearest_source
from airtact.geometry.mesh.triangles import cut

# Bodies thicker than this have x' at a depth of 0.2 λ = 0.3 · 2/3 λ, so the thickness is measured
# only up to this value [λ].
THICK_FROM = 2 / 3


@dataclass(frozen=True, eq=False)
class DualSurface:
    """The discrete dual-surface equation of a scene.

    Attributes
    ----------
    nodes : nodes of the panels, which are the first set of collocation points x.
    shifted : second set of collocation points x', inside the bodies [m]; three neighbouring nodes
        of a panel share one of them.
    wavenumber : k, whose imaginary part is the absorption [rad/m].
    near_rule : integration rule for near panels.
    precision : working precision, "float32" or "float64".
    error : allowed relative error of sums over thousands of distant sources, in float32.
    """

    nodes: Nodes
    shifted: GroupPoints
    wavenumber: complex
    near_rule: NearRule
    precision: str
    error: float = 0.0


def dual_surface(
    nodes: Nodes,
    wavenumber: complex,
    near_rule: NearRule,
    precision: str,
    least_thickness: Float64[np.ndarray, "nodes"] | None = None,
    error: float = 0.0,
) -> DualSurface:
    """Build the dual-surface equation, with its second collocation points inside the bodies.

    Every second collocation point lies below the surface, at a depth of 0.3 times the local
    thickness, but at most 0.2 λ.

    Sharing each point among three nodes saves a third of the kernel evaluations at equal accuracy.
    ``least_thickness`` is a lower bound on the thickness at each node [m]. ``error`` is that of
    ``DualSurface``.
    """
    wavelength = 2 * np.pi / wavenumber.real
    # Deeper points would come near the opposite side of a thin body.
    depth = 0.3 * thickness(nodes, THICK_FROM * wavelength, least_thickness)
    inside = (nodes.points - depth[:, None] * nodes.normals).reshape(-1, _kernels.sharing, 3)
    shifted = np.einsum("gsd->gd", inside) / _kernels.sharing  # np.mean takes ten times as long
    return DualSurface(nodes, shifted, wavenumber, near_rule, precision, error)


def assemble(
    surface: DualSurface, store: Store, error: float | None = None, image: Plane | None = None
) -> BlockMatrix:
    """Fill the matrix of the dual-surface equation.

    Parameters
    ----------
    surface : nodes and second collocation points.
    store : number format of the matrix.
    error : allowed Frobenius norm of the errors of all low-rank blocks together, relative to that
        of the matrix's identity term I/2; if None, every block is stored in full.
    image : plane in which the bodies are mirrored; if given, the matrix contains only the
        contribution of the image. The image has the same pressure, and its double layer at x equals
        the double layer of the bodies at the image of x. Only the collocation points change, and
        the term 1/2 is omitted.

    Raises
    ------
    InvalidInput
        If the matrix does not fit into memory.
    """
    nodes = surface.nodes
    points = nodes.points
    shifted = surface.shifted
    centres = nodes.centres
    if image is not None:
        points = image.image(points)
        shifted = image.image(shifted)
        centres = image.image(centres)
    # The entries of panels near a collocation point are corrected by a near integral.
    collocation_points = np.concatenate([points, shifted])
    rows = near_rows(
        nodes, collocation_points, surface.wavenumber, surface.near_rule, surface.precision
    )
    near, near_shifted = rows.split(len(points))
    # Blocks with corrected entries, or with panels close to each other, are stored in full.
    block_rows = blocks_of(len(points))
    stored_whole = np.ones((block_rows, block_rows), dtype=bool)
    if error is not None:
        # Low-rank terms converge fast where panels are more than 0.2 λ apart.
        gap = 0.2 * 2 * np.pi / surface.wavenumber.real
        beside = near_lists(nodes, centres, 2 * nodes.radii + gap)
        corrected = [(part.first, part.panel) for part in (near, near_shifted)]
        stored_whole = near_blocks(len(nodes.centres), beside, *corrected)
    layer = nodes.layer(surface.wavenumber)

    # The matrix has block_rows² blocks of ``lanes`` rows each, so ‖I/2‖ = ½ √(block_rows · lanes).
    # The squared error is shared evenly among all blocks.
    tolerance = 0.5 * (error or 0.0) * math.sqrt(_kernels.lanes / block_rows)
    # Low-rank terms come first, because their number is known only once they are filled. A block
    # has about 12 terms of two factors each. There is room for 24 on average; if that is not
    # enough, the fill is repeated with the room it reported.
    stored = int(np.count_nonzero(stored_whole))
    needed = 2 * 24 * (stored_whole.size - stored)
    while True:
        room = needed
        # Only half of the space is checked, since the terms usually need no more.
        check_memory(len(points), store, stored, room // 2)
        matrix = BlockMatrix.empty(len(points), store, stored_whole, room)
        if room:
            needed = _kernels.dual_low_rank(
                points, shifted, layer, matrix.far, tolerance, matrix.factors
            )
        if needed <= room:
            break

    _kernels.dual_blocks(
        points,
        shifted,
        layer,
        diagonal=0.5 if image is None else 0.0,
        near=near,
        near_shifted=near_shifted,
        whole=matrix.whole,
        out=matrix.blocks,
    )
    return matrix


def direct_right_side(
    surface: DualSurface,
    positions: SourcePoints,
    strengths: Complex[np.ndarray, "sources excitations"],
) -> NodeValues:
    """Return the direct equation's right-hand side p_inc(x) − i p_inc(x') for monopoles."""
    collocation_points = np.concatenate([surface.nodes.points, surface.shifted])
    # The hundreds of sources of an array are far from the bodies, so float32 suffices for them.
    precision = "float64"
    if len(positions) > 256:
        wavelength = 2 * np.pi / surface.wavenumber.real
        sources = Monopoles(positions, strengths)
        if nearest_source(collocation_points, sources, wavelength)[0].min() > wavelength:
            precision = surface.precision
    pressure = monopole_pressure(
        collocation_points,
        positions,
        strengths,
        wavenumber=surface.wavenumber,
        precision=precision,
        error=surface.error,
    )
    count = len(surface.nodes.points)
    return pressure[:count] - 1j * np.repeat(pressure[count:], _kernels.sharing, axis=0)


def transposed_right_side(
    surface: DualSurface,
    positions: SourcePoints,
    strengths: Complex128[np.ndarray, "sources excitations"],
    planes: Sequence[Plane] = (),
) -> tuple[NodeValues, Float64[np.ndarray, "sources"]]:
    """Return the right-hand side of the transposed equation, and a factor for each source.

    The right-hand side is the transposed double layer of the monopoles, including their images in
    ``planes``. The strength of a source is multiplied by 1 off the surface and by 2 on it. On the
    surface, Green's formula yields only half of the pressure, p/2 = p_inc + D[p]. By reciprocity,
    the strength of a source there is doubled. This also holds for surfaces with an impedance,
    because D then includes their single-layer term.
    """
    positions, contact = project_contacts(surface.nodes, positions)
    factors = np.where(contact, 2.0, 1.0)
    emitting = with_images(planes, Monopoles(positions, factors[:, None] * strengths))
    # The images follow the sources and touch nothing.
    touching = np.zeros(len(emitting.positions), dtype=bool)
    touching[: len(contact)] = contact
    right = double_layer_transposed(
        emitting.positions,
        surface.nodes,
        emitting.strengths,
        surface.wavenumber,
        near_rule=surface.near_rule,
        precision=surface.precision,
        contact=touching,
        error=surface.error,
    )
    return right, factors


# Nodes, and the pressure at them [Pa].
NodalPressure = tuple[Nodes, NodeValues]


@dataclass(frozen=True, eq=False)
class DirectSolution:
    """The pressure on the surface [Pa], from which Green's formula computes the field."""

    sources: Monopoles
    surface: DualSurface
    pressure: NodeValues

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
        """Return the total or scattered pressure [Pa] at points.

        Parameters
        ----------
        points : positions [m]. Points in contact with the surface must already be projected
            onto it.
        contact : mask of the points on the surface. At these points, the total pressure is twice
            the sum of the incident pressure and the double layer.
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
        """Return the pressure [Pa] at points on or near the surface, refining panels near them."""
        if not len(points):
            return np.empty((0, self.pressure.shape[1]), dtype=np.complex128)
        if contact is None:
            points, contact = project_contacts(self.surface.nodes, points)
        return self.at(points, contact, total, self.refined(points))

    def refined(self, points: Vectors) -> NodalPressure:
        """Return nodes and pressure on the surface, with smaller panels near some points.

        Each panel near the points is divided into four. The pressure on the pieces follows from the
        integral equation itself, and is smoother than the quadratic through the six nodes (Nyström
        interpolation, Atkinson, The Numerical Solution of Integral Equations of the Second Kind,
        1997, section 4).
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
    factors : factor for the strength of each source: 1 away from the surface, and 2 on the surface,
        where the source coincides with its mirror image.
    """

    sources: Monopoles
    surface: DualSurface
    density: NodeValues
    factors: Float64[np.ndarray, "sources"]

    @cached_property
    def emitted(self) -> Monopoles:
        """The sources, with doubled strengths for those on the surface."""
        return Monopoles(self.sources.positions, self.factors[:, None] * self.sources.strengths)

    @cached_property
    def scattering(self) -> Monopoles:
        """Monopoles at all collocation points, which radiate the scattered field."""
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
                points,
                positions,
                strengths,
                wavenumber=wavenumber,
                precision=self.surface.precision,
                error=self.surface.error,
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
            points[group],
            sources.positions,
            sources.strengths,
            wavenumber=surface.wavenumber,
            precision=precision,
            error=surface.error,
        )
    return out
