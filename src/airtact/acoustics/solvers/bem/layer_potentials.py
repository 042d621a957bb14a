"""Layer potentials of curved panels at any points, and where points lie relative to panels.

With the outward normal n and the sources' pressure p_inc, Green's formula outside the bodies is
p = p_inc + D[p], where D is the double layer. On a surface of impedance Z, ∂p/∂n = −(ikρc/Z) p, so
the single layer of (ikρc/Z) p is added; here the term "double layer" includes it.

For a panel far from a point, the integral is a sum over the panel's nodes. For a near panel, a
correction is added: the near integral minus this plain sum. With k = 0 and p = 1, the double layer
is the solid angle of the bodies, which distinguishes inner from outer points.

For many points close together, such as those of a picture, the points are sorted into cells
narrower than a wavelength. The field of sources away from a cell is smooth in the cell, so it is
summed on a grid of Chebyshev points and interpolated between them. Sources near the cell are summed
at each point.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Complex128, Float32, Float64, Int64

from airtact import _kernels
from airtact.acoustics.scene import Scene, before_planes
from airtact.acoustics.solvers.bem.quadrature import (
    CONTACT_REACH,
    NODAL,
    Nodes,
    near_lists,
    near_quadrature,
)
from airtact.acoustics.solvers.shared import (
    MIN_CLUSTERED,
    Mask,
    NearLists,
    NodeValues,
    Points,
    Pressures,
    SourcePoints,
    Vectors,
    chebyshev_weights,
)
from airtact.geometry.mesh.triangles import shape_functions

# Relative error, number of points along each edge of a cell's grid, and distance from the cell's
# corners within which sources are near [λ].
GRIDS = ((1e-3, 8, 0.3), (2e-5, 10, 0.6))

# Largest ratio of grid points to points at which cells are faster.
MAX_GRID_SHARE = 0.5


def monopole_layer(positions: SourcePoints, wavenumber: complex) -> _kernels.Layer:
    """Represent monopoles as a layer, so that ``Cells.sums`` can sum them."""
    hard = np.empty(0, dtype=np.complex128)
    return _kernels.Layer(np.ascontiguousarray(positions), None, hard, complex(wavenumber))


@dataclass(frozen=True, eq=False)
class Cells:
    """Points sorted into cells, so that the field of many sources can be summed quickly.

    Attributes
    ----------
    points, order : the sorted points [m], and the original index of each.
    first : index of the first point of each cell.
    centres : centres of the cells [m].
    reach : distance from a cell's centre within which sources are summed without interpolation [m].
    grids : Chebyshev points of all cells [m], ordered by cell.
    weights : interpolation weights of a cell's grid points for each point, along each axis of the
        cell.
    """

    points: Float64[np.ndarray, "points 3"]
    order: Int64[np.ndarray, "points"]
    first: Int64[np.ndarray, "bounds"]
    centres: Float64[np.ndarray, "cells 3"]
    reach: float
    grids: Float64[np.ndarray, "grids 3"]
    weights: tuple[
        Float32[np.ndarray, "points a"],
        Float32[np.ndarray, "points b"],
        Float32[np.ndarray, "points c"],
    ]

    def sums(
        self,
        layer: _kernels.Layer,
        strengths: Complex[np.ndarray, "sources excitations"],
        min_distance: float = 0.0,
    ) -> Complex128[np.ndarray, "points excitations"]:
        """Return the field of a double layer or of monopoles at the points.

        The values are in the original order of the points. They are computed in float32, with each
        cell's centre as the origin. For a double layer, nodes closer than ``min_distance`` [m] are
        omitted.
        """
        cells = len(self.centres)
        at_points = _kernels.Cells(self.points, self.first, self.centres, self.reach)
        near = _kernels.apply_in_cells(at_points, True, layer, strengths, min_distance)
        bounds = len(self.grids) // cells * np.arange(cells + 1)
        at_grids = _kernels.Cells(self.grids, bounds, self.centres, self.reach)
        smooth = _kernels.apply_in_cells(at_grids, False, layer, strengths, min_distance)
        # The far part is smooth in a cell, so it is interpolated.
        cell = np.repeat(np.arange(cells), np.diff(self.first))
        _, b, c = (part.shape[1] for part in self.weights)
        steps = np.array([b * c, c]) * smooth.shape[1]
        table = smooth.astype(np.complex64)
        between = _kernels.interpolate(table, cell * (smooth.size // cells), steps, *self.weights)
        out = np.empty_like(near)
        out[self.order] = near + between
        return out


def cells_of(points: Points, wavelength: float, error: float) -> Cells | None:
    """Sort points into cells, or return None if sums in cells would not be faster.

    The cells are chosen so that the relative error of ``Cells.sums`` is at most ``error``.
    """
    grids = [(order, beyond) for left, order, beyond in GRIDS if left <= error]
    if not grids or len(points) < grids[0][0] ** 2 / MAX_GRID_SHARE:
        return None
    order, beyond = grids[0]
    middle = points.mean(axis=0)
    across = np.ascontiguousarray((points - middle).T)
    # Cells lie along the principal axes of the points, so that a picture has one layer of them.
    _, axes = np.linalg.eigh(across @ across.T)  # the thinnest direction first
    local = axes.T @ across
    low = local.min(axis=1)
    extent = local.max(axis=1) - low
    deep = extent > 1e-5 * wavelength  # the other axes need no grid
    size = np.where(deep, order, 1)
    count = np.where(deep, np.ceil(extent / wavelength), 1).astype(np.int64)
    # Cell numbers must fit into 16 bits.
    if count.prod() > 2**16 or size.prod() > MAX_GRID_SHARE * len(points):
        return None
    width = np.where(deep, extent, wavelength) / count
    # Cells are numbered row by row, without the empty ones.
    number = np.zeros(len(points), dtype=np.int64)
    for axis in np.flatnonzero(count > 1):
        index = ((local[axis] - low[axis]) / width[axis]).astype(np.int64)
        number += count[axis + 1 :].prod() * np.minimum(index, count[axis] - 1)
    used = np.flatnonzero(np.bincount(number))
    if len(used) * size.prod() > MAX_GRID_SHARE * len(points):
        return None
    sorting = np.argsort(number.astype(np.uint16), kind="stable")
    number = np.searchsorted(used, number[sorting])
    centres = low + (np.stack(np.unravel_index(used, count), axis=1) + 0.5) * width
    centres[:, ~deep] = (low + 0.5 * extent)[~deep]
    # These are the Chebyshev points in each cell and their weights at the points.
    nodes = [np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in size.tolist()]
    grid = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 3) * width / 2
    weights = [
        chebyshev_weights(
            ((local[axis][sorting] - centres[number, axis]) / (0.5 * width[axis])).astype(
                np.float32
            ),
            order,
        )
        if deep[axis]
        else np.ones((len(points), 1), dtype=np.float32)
        for axis in range(3)
    ]
    return Cells(
        points=np.ascontiguousarray(points[sorting], dtype=np.float64),
        order=sorting,
        first=np.searchsorted(number, np.arange(len(used) + 1)),
        centres=middle + centres @ axes.T,
        reach=0.5 * float(np.linalg.norm(width[deep])) + beyond * wavelength,
        grids=np.ascontiguousarray((middle + (centres[:, None] + grid) @ axes.T).reshape(-1, 3)),
        weights=(weights[0], weights[1], weights[2]),
    )


# Indices of the points that touch a panel, the panel of each, and its reference coordinates there.
Contacts = tuple[
    Int64[np.ndarray, "contacts"], Int64[np.ndarray, "contacts"], Float64[np.ndarray, "contacts 2"]
]


@dataclass(frozen=True)
class NearRule:
    """Settings for integrals over panels near a point.

    Attributes
    ----------
    reach : a panel is near if its centre is within this many panel radii of the point.
    gauss_points : numbers of Gauss points in angle and radius; nearly singular integrals use more.
    """

    reach: float
    gauss_points: tuple[int, int]


class NearRows(_kernels.NearRows):
    """Corrections for panels near the points, which are added to the plain sum over all nodes.

    Each pair consists of a point and a panel near it. Point j has the pairs ``first[j]`` to
    ``first[j + 1] - 1``, as in ``near_lists``. ``excess`` (pairs, 6) is the accurate integral for
    each of the panel's six nodes, minus the node's term in the plain sum.
    """

    def split(self, points: int) -> tuple["NearRows", "NearRows"]:
        """Separate the pairs of the first ``points`` points from those of all later points."""
        begin = int(self.first[points])
        return (
            NearRows(self.first[: points + 1], self.panel[:begin], self.excess[:begin]),
            NearRows(self.first[points:] - begin, self.panel[begin:], self.excess[begin:]),
        )

    def times(self, pressure: NodeValues) -> Pressures:
        """Return the corrections for a pressure at the nodes. Each point needs a near panel."""
        by_panel = pressure.reshape(-1, 6, pressure.shape[1])
        # One excitation at a time, which limits the memory
        columns = [
            np.einsum("pj,pj->p", self.excess, by_panel[self.panel, :, excitation])
            for excitation in range(pressure.shape[1])
        ]
        return np.add.reduceat(np.stack(columns, axis=1), self.first[:-1])


def near_rows(
    nodes: Nodes,
    points: Points,
    wavenumber: complex,
    near_rule: NearRule,
    precision: str,
    min_distance: float = 0.0,
    lists: NearLists | None = None,
) -> NearRows:
    """Compute the corrections to the plain sums for panels near the points.

    The plain sums omit nodes closer than ``min_distance`` [m]. In float32, no point may touch a
    panel at its edge. ``lists`` contains the near panels, if they are already known.
    """
    if lists is None:
        lists = near_lists(nodes, points, near_rule.reach * nodes.radii)
    rows = NearRows(*lists, np.empty((len(lists[1]), 6), dtype=np.complex128))
    _kernels.near_excess(
        points,
        rows,
        panels=nodes.panels,
        layer=nodes.layer(wavenumber),
        nodal=NODAL,
        least=min_distance,
        quadrature=near_quadrature(*near_rule.gauss_points),
        precision=precision,
    )
    return rows


def double_layer_pressure(
    points: Points,
    nodes: Nodes,
    pressure: NodeValues,
    wavenumber: complex,
    near_rule: NearRule,
    precision: str,
    cells: Cells | None = None,
    nodal: bool = False,
    contact: Mask | None = None,
    coarse: bool = False,
) -> Pressures:
    """Return the double layer D[p] of a surface pressure at points on or off the panels.

    On a panel the result is the principal value.

    Parameters
    ----------
    cells : the points sorted into cells, or None. With cells, no point may be on a panel.
    nodal : whether all points lie inside panels, away from the edges, as nodes do. The working
        precision is then sufficient for the integrals over near panels.
    contact : mask of the points that were projected onto a panel.
    coarse : whether to use single precision, with an error of about 0.1 %.
    """
    layer = nodes.layer(wavenumber)
    # Single precision resolves this distance to 1 % in the largest scenes.
    beside = 0.05 * float(nodes.radii.min())
    if coarse:
        min_distance = beside
        out = _kernels.apply_double_layer(points, layer, pressure, min_distance, "float32")
        near_precision = "float64"
    elif cells is None:
        # float32 does not resolve the position of a node closer than ``min_distance``. The plain
        # sum may omit such nodes if all their panels are near.
        min_distance = 1e-3 * float(np.abs(nodes.points - nodes.points.mean(axis=0)).max())
        reach = 0.5 * (near_rule.reach - 1) * nodes.radii.min()
        if precision != "float32" or min_distance >= reach:
            min_distance = 0.0
            precision = "float64"
        out = _kernels.apply_double_layer(points, layer, pressure, min_distance, precision)
        near_precision = precision if nodal else "float64"
    else:
        min_distance = beside
        out = cells.sums(layer, pressure, min_distance)
        near_precision = precision if nodal else "float32"
    groups = _near_groups(
        nodes, points, contact, wavenumber, near_rule, near_precision, min_distance
    )
    for group, rows in groups:
        out[group] += rows.times(pressure)
    return out


def _near_groups(
    nodes: Nodes,
    points: Vectors,
    contact: Mask | None,
    wavenumber: complex,
    near_rule: NearRule,
    precision: str,
    min_distance: float = 0.0,
) -> list[tuple[Mask, NearRows]]:
    """Return the near rows (``NearRows``) of points off the panels, and of points on a panel.

    Adjacent panels deviate from the true surface by different amounts. If a point on one panel
    counted as above or below an adjacent panel, the solid angle at their common corner would be
    halved or doubled. A point on one panel is therefore also treated as touching the adjacent panel
    if its distance is within the sum of both contact lengths.
    """
    first, panel = near_lists(nodes, points, near_rule.reach * nodes.radii)
    near = np.diff(first) > 0
    if not near.any():
        return []
    on = np.zeros(len(points), dtype=bool) if contact is None else near & contact
    if not on.any():
        # Points without near panels have no entries, so their bounds can be dropped.
        lists = np.append(first[:-1][near], first[-1]), panel
        rows = near_rows(nodes, points[near], wavenumber, near_rule, precision, min_distance, lists)
        return [(near, rows)]
    _, touched, _ = find_contacts(nodes, points[on])
    largest = nodes.contact[touched].max(initial=0.0)
    widened = replace(nodes, contact=nodes.contact + largest)
    return [
        (group, near_rows(panels, points[group], wavenumber, near_rule, precision, min_distance))
        for group, panels in ((near & ~on, nodes), (on, widened))
        if group.any()
    ]


def double_layer_transposed(
    points: Points,
    nodes: Nodes,
    strengths: Complex128[np.ndarray, "points excitations"],
    wavenumber: complex,
    near_rule: NearRule,
    precision: str,
    contact: Mask | None = None,
    error: float = 0.0,
) -> NodeValues:
    """Return Σ_i s_i D(x_i, y_j) at each node y_j, for sources of strength s_i at x_i.

    This sum is called the transposed double layer. ``contact`` marks points that were projected
    onto a panel. ``error`` is the allowed relative error of sums over thousands of distant sources,
    in float32.
    """
    excitations = strengths.shape[1]
    total = np.zeros((len(nodes.points), excitations), dtype=np.complex128)
    near = np.zeros(len(points), dtype=bool)
    # Near sources need double precision, because they may touch a panel at its edge.
    for group, rows in _near_groups(nodes, points, contact, wavenumber, near_rule, "float64"):
        pairs = np.repeat(strengths[group], np.diff(rows.first), axis=0)
        by_panel = total.reshape(-1, 6, excitations)
        np.add.at(by_panel, rows.panel, rows.excess[:, :, None] * pairs[:, None])
        near |= group
    layer = nodes.layer(wavenumber)
    for group, kind in ((near, "float64"), (~near, precision)):
        if not group.any():
            continue
        sources = points[group]
        if kind == "float32" and error > 0 and min(len(sources), len(total)) >= MIN_CLUSTERED:
            total += _kernels.apply_distant(layer, sources, strengths[group], error)
            continue
        if excitations <= 64:  # BLAS would be slower and would leave threads spinning
            total += _kernels.apply_transposed(sources, layer, strengths[group], kind)
            continue
        part = np.zeros_like(total)
        for start in range(0, len(sources), 512):  # limits the memory of the matrix
            block = slice(start, start + 512)
            matrix = _kernels.double_layer_matrix(sources[block], layer, kind)
            part += matrix.T @ strengths[group][block].astype(matrix.dtype)
        total += part
    return total


def find_contacts(nodes: Nodes, points: Points) -> Contacts:
    """Find the points that touch the surface, and the nearest panel of each."""
    first, panel = near_lists(nodes, points, 1.1 * nodes.radii)
    target = np.repeat(np.arange(len(points)), np.diff(first))
    # The integrals are not used, so one Gauss point is enough.
    _, distance, reference = _kernels.near_integrals(
        False, points, target, panel, nodes.panels, wavenumber=0j, quadrature=near_quadrature(1, 1)
    )
    touching = np.flatnonzero(distance < nodes.contact[panel])
    nearest_first = touching[np.argsort(distance[touching], kind="stable")]
    _, unique = np.unique(target[nearest_first], return_index=True)
    pair = nearest_first[unique]
    return target[pair], panel[pair], reference[pair]


def project_contacts(nodes: Nodes, points: Points) -> tuple[Vectors, Mask]:
    """Project points that touch the surface onto its panels, and return a mask of these points."""
    points = np.array(points, dtype=np.float64)
    target, panel, reference = find_contacts(nodes, points)
    contact = np.zeros(len(points), dtype=bool)
    contact[target] = True
    shape = shape_functions(reference)
    points[target] = np.einsum("en,end->ed", shape, nodes.quadratic_triangles[panel])
    return points, contact


def near_surface(nodes: Nodes, points: Points, reach: float) -> Mask:
    """Return a mask of the points within ``reach`` panel radii of the centre of a panel."""
    return np.diff(near_lists(nodes, points, reach * nodes.radii)[0]) > 0


@dataclass(frozen=True, eq=False)
class Located:
    """Points and their positions relative to the panels of all bodies, as returned by ``locate``.

    Attributes
    ----------
    points : (P, 3) positions in the frame of the scene [m]; those in contact with the surface are
        projected onto their panel.
    near : (P,) mask of the points that need accurate integrals over near panels.
    contact : (P,) mask of the points that touch a panel.
    outside : (P,) mask of the points outside the bodies or on their panels; False behind a plane.
    """

    points: Vectors
    near: Mask
    contact: Mask
    outside: Mask


def locate(scene: Scene, nodes: Nodes, points: Points, near_rule: NearRule) -> Located:
    """Determine which points are outside the bodies, on their panels, or near panels.

    Away from the panels, points are classified by the solid angle, or by the scene's signed
    distance if all bodies are spheres or capsules. Near the panels, they are classified by the
    signed distance if it exceeds the panels' deviation from the true surface. Points closer to the
    surface are projected onto a panel if they practically lie on it; the others are classified by
    the solid angle, with accurate integrals over near panels. Points behind a plane do not count
    as outside.

    Parameters
    ----------
    scene : the bodies and the planes.
    nodes : quadrature nodes of the panels that cover all bodies.
    points : (P, 3) points in the frame of the scene [m].
    near_rule : settings that define which panels are near a point.

    Returns
    -------
    A ``Located`` with the points and masks (P,); points in contact are moved onto a panel.
    """
    positions = np.array(points, dtype=np.float64)
    contact = np.zeros(len(positions), dtype=bool)
    outside = np.ones(len(positions), dtype=bool)
    first, panel = near_lists(nodes, positions, near_rule.reach * nodes.radii)
    near = np.diff(first) > 0
    # Every point beyond the box around all panels is outside.
    reach = nodes.radii[:, None]
    lower = (nodes.centres - reach).min(axis=0)
    upper = (nodes.centres + reach).max(axis=0)
    in_box = ((positions > lower) & (positions < upper)).all(axis=1)
    if near.any() or in_box.any():
        # This is the distance within which a point may touch one of its near panels.
        touch = np.zeros(len(positions))
        if len(panel):
            touch[near] = np.maximum.reduceat(nodes.contact[panel], first[:-1][near])
        primitive = all(obstacle.surface.primitive is not None for obstacle in scene.obstacles)
        measured = np.flatnonzero(near | in_box if primitive else near)
        depth = scene.depth(positions[measured])
        outside[measured] = depth < 0
        in_box[measured] = False
        # The solid angle is −1 inside. Away from the panels, each panel is summed as one node.
        area = nodes.weighted_normals.reshape(-1, 6, 3).sum(axis=1)
        layer = _kernels.Layer(nodes.centres, area, np.empty(0, dtype=np.complex128), 0j)
        ones = np.ones((len(nodes.points), 1), dtype=np.complex128)
        solid = _kernels.apply_double_layer(
            positions[in_box], layer, ones[: len(area)], 0.0, "float32"
        )
        outside[in_box] = np.real(solid[:, 0]) > -0.5
        # The panels deviate from the true surface, so its distance only preselects contacts.
        close = measured[np.abs(depth) < CONTACT_REACH * touch[measured]]
        positions[close], contact[close] = project_contacts(nodes, positions[close])
        outside[contact] = True
        # Between the true surface and the panels, the side of the panels counts, because the field
        # is computed from them.
        doubtful = measured[(np.abs(depth) < touch[measured]) & ~contact[measured]]
        solid = double_layer_pressure(positions[doubtful], nodes, ones, 0j, near_rule, "float32")
        outside[doubtful] = np.real(solid[:, 0]) > -0.5
        # A panel may deviate further between the points at which this was measured. Points on the
        # true surface that are inside such a panel are projected onto it.
        hidden = measured[(depth <= 0.0) & ~outside[measured]]
        wide = replace(nodes, contact=CONTACT_REACH * nodes.contact)
        positions[hidden], contact[hidden] = project_contacts(wide, positions[hidden])
        outside[hidden] = contact[hidden]
    if scene.planes:
        outside[~before_planes(scene.planes, points)] = False
    return Located(positions, near, contact, outside)
