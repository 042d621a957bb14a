"""Sums over many sources at many points close together, such as those of a picture.

The points are sorted into cells narrower than a wavelength. The field of sources away from a cell
is smooth there: it is summed on a grid of Chebyshev points and interpolated between them; the
sources nearby are summed at each point.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Complex128, Float32, Float64, Int64, Real

from airtact import _kernels
from airtact.acoustics.solvers.chebyshev import chebyshev_weights
from airtact.printing import in_short

WIDTH = 1.0
"""Largest width of a cell, in wavelengths."""

ORDERS = {1e-3: (8, 0.3), 2e-5: (10, 0.6)}
"""Points of the grid along each edge of a cell, and wavelengths beyond its corners within which sources are summed at
each point, by the relative error that they leave."""

FLAT = 1e-5
"""Wavelengths over which points may spread along an axis that needs no grid."""

MOST = 2**16
"""Cells that points may be sorted into."""

HARD = np.empty(0, dtype=np.complex128)
"""The single layer of sound-hard surfaces."""

PAYS = 0.5
"""Most points of the grids over the points themselves for the cells to pay."""


@dataclass(frozen=True, eq=False)
class Cells:
    """Points sorted into cells [m]: ``order`` is the original index of each, ``first`` where each cell's points begin.

    Sources nearer to a centre than ``reach`` are near its cell; ``weights`` are those of a cell's
    grid for each point along each axis.
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
        sources: Float64[np.ndarray, "sources 3"],
        normals: Float64[np.ndarray, "sources 3"] | None,
        strengths: Complex[np.ndarray, "sources sounds"],
        wavenumber: complex,
        least: float = 0.0,
        single: Complex128[np.ndarray, "some"] = HARD,
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Sum monopoles, or with normals (times area) a double layer, at the points in their original order.

        The sums are in float32, with the centre of each cell as origin. The double layer leaves out
        nodes nearer than ``least`` [m], and has the ``single`` layer of ``Nodes.single_layer`` with
        it.
        """
        strengths = np.ascontiguousarray(strengths, dtype=np.complex128)
        given = (
            np.ascontiguousarray(sources),
            normals,
            single,
            strengths,
            complex(wavenumber),
            least,
        )
        near = np.empty((len(self.points), strengths.shape[1]), dtype=np.complex128)
        _kernels.apply_in_cells(
            self.points, self.first, self.centres, self.reach, True, *given, near
        )
        far = np.empty((len(self.grids), strengths.shape[1]), dtype=np.complex128)
        each = len(self.grids) // len(self.centres)
        bounds = each * np.arange(len(self.first))
        _kernels.apply_in_cells(self.grids, bounds, self.centres, self.reach, False, *given, far)
        out = np.empty_like(near)
        out[self.order] = near + self._between(far)
        return out

    def _between(
        self, far: Complex128[np.ndarray, "grids sounds"]
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Interpolate the grids at the points."""
        sounds, (_, b, c) = far.shape[1], (part.shape[1] for part in self.weights)
        cell = np.repeat(np.arange(len(self.centres)), np.diff(self.first))
        read = np.empty((len(self.points), sounds), dtype=np.complex128)
        first, steps = (
            cell * (far.size // len(self.centres)),
            np.array([b * c * sounds, c * sounds]),
        )
        _kernels.interpolate(far.astype(np.complex64).ravel(), first, steps, *self.weights, read)
        return read


def cells_of(points: Real[np.ndarray, "points 3"], wavelength: float, error: float) -> Cells | None:
    """Sort points (P, 3) [m] into cells for sums to a relative error, or return None where that does not pay."""
    order, beyond = min(
        (choice for left, choice in ORDERS.items() if left <= error), default=(0, 0.0)
    )
    if not order or len(points) < order**2 / PAYS:
        return None
    middle = points.mean(axis=0)
    across = np.ascontiguousarray((points - middle).T)
    _, axes = np.linalg.eigh(across @ across.T)  # the thinnest first
    local = axes.T @ across
    low = local.min(axis=1)
    extent = local.max(axis=1) - low
    deep = extent > FLAT * wavelength
    size, count = (
        np.where(deep, order, 1),
        np.where(deep, np.ceil(extent / (WIDTH * wavelength)), 1).astype(np.int64),
    )
    if count.prod() > MOST or size.prod() > PAYS * len(points):
        return None
    width = np.where(deep, extent, wavelength) / count
    number = np.zeros(len(points), dtype=np.int64)
    for axis in np.flatnonzero(count > 1):
        index = ((local[axis] - low[axis]) / width[axis]).astype(np.int64)
        number += count[axis + 1 :].prod() * np.minimum(index, count[axis] - 1)
    used = np.flatnonzero(np.bincount(number))
    if len(used) * size.prod() > PAYS * len(points):
        return None
    sorting = np.argsort(number.astype(np.uint16), kind="stable")
    number = np.searchsorted(used, number[sorting])
    centres = low + (np.stack(np.unravel_index(used, count), axis=1) + 0.5) * width
    centres[:, ~deep] = (low + 0.5 * extent)[~deep]
    nodes = [np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in size.tolist()]
    grid = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 3) * width / 2
    a, b, c = (
        _weights(
            (local[axis][sorting] - centres[number, axis]) / (0.5 * width[axis]), int(size[axis])
        )
        for axis in range(3)
    )
    return Cells(
        np.ascontiguousarray(points[sorting], dtype=np.float64),
        sorting,
        np.searchsorted(number, np.arange(len(used) + 1)),
        middle + centres @ axes.T,
        0.5 * float(np.linalg.norm(width[deep])) + beyond * wavelength,
        np.ascontiguousarray((middle + (centres[:, None] + grid) @ axes.T).reshape(-1, 3)),
        (a, b, c),
    )


def _weights(
    coordinates: Float64[np.ndarray, "points"], count: int
) -> Float32[np.ndarray, "points count"]:
    """Weights of a cell's grid along one of its axes; one for each point where it has no extent."""
    if count == 1:
        return np.ones((len(coordinates), 1), dtype=np.float32)
    return chebyshev_weights(coordinates.astype(np.float32), count)
