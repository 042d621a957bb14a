"""Sums over many sources at many points close together, such as those of a picture.

The points are sorted into cells narrower than a wavelength. The field of sources away from a cell
is smooth in the cell, so it is summed on a grid of Chebyshev points and interpolated between them.
Sources near the cell are summed at each point.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Complex128, Float32, Float64, Int64

from airtact import _kernels
from airtact.acoustics.solvers.shared import Points, SourcePoints, chebyshev_weights
from airtact.errors import in_short

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
    """Points sorted into cells.

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

    __repr__ = in_short

    def sums(
        self,
        layer: _kernels.Layer,
        strengths: Complex[np.ndarray, "sources excitations"],
        min_distance: float = 0.0,
    ) -> Complex128[np.ndarray, "points excitations"]:
        """Sum a double layer or monopoles at the points, in their original order.

        The sums are in float32, with each cell's centre as origin. For a double layer, nodes closer
        than ``min_distance`` [m] are omitted.
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
    """Sort points into cells for sums to a relative ``error``, or return None if this is slower."""
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
