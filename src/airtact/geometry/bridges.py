"""What fills the narrow air between two bodies, as a closed mesh that reaches a little into both.

The filling is where the distances to the two bodies add up to at most a width and their surfaces
face each other: a furrow in which they meet at a wide angle stays as it is. Its surface is found on
a grid of cubes, refined only there, each cut into six tetrahedra in which everything is linear.

Source: A. Doi, A. Koide, "An efficient method of triangulating equi-valued surfaces by using
tetrahedral cells", IEICE Trans. E74, 214 (1991).
"""

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from airtact.errors import InvalidInput
from airtact.geometry.mesh.thickness import Depth
from airtact.geometry.shape import FlatMesh

CUBES_PER_WIDTH = 2.0
"""Width over the edge of the cubes."""

CUBES_PER_RADIUS = 3.0
"""The same of balls over their radius."""

REACH = 0.6
"""How far the filling reaches into the bodies, over the width."""

FACING = 0.9
"""Length of the sum of two outward normals from which on nothing is filled: 0 where surfaces face each other, 1.41 at
a right angle. From a third of it on the width is less and less."""

FEWEST = 8.0
"""About how many of the largest cubes the region is long."""

MOST = 1e6
"""Most cubes that are looked into."""

SNAP = 0.05
"""The filling keeps this share of an edge of the cubes away from their corners: no slivers."""

_BITS = np.array([[corner >> axis & 1 for axis in range(3)] for corner in range(8)])


@dataclass(frozen=True, eq=False)
class Filling:
    """What is to be filled between two bodies, given by their depths, in the box from ``low`` to ``high`` [m].

    ``width`` is what the distances to the bodies may add up to [m].
    """

    one: Depth
    two: Depth
    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]
    width: float

    @property
    def reach(self) -> float:
        """How far it reaches into the bodies [m]."""
        return REACH * self.width

    def distances(
        self, points: Float64[np.ndarray, "points 3"]
    ) -> tuple[Float64[np.ndarray, "points"], Float64[np.ndarray, "points"]]:
        """How far points (P, 3) [m] are out of each body [m], negative inside."""
        return -self.one(points), -self.two(points)


def filling(what: Filling, radius: float = 0.0) -> FlatMesh | None:
    """Mesh the filling between two bodies, closed and outward, in one or more pieces; None when there is none.

    Where ``radius`` [m] is above zero, it is all balls of this radius whose centres lie in the
    filling outside of the bodies, so that it is nowhere thinner than these. It is an error when it
    takes more than ``MOST`` cubes.
    """
    edge = what.width / CUBES_PER_WIDTH
    cubes = _cubes(what, edge)
    if len(cubes) == 0:
        return None
    grid = _grid(cubes, what.low, edge)
    level, out = _levels(what, grid)
    if not (level < 0.0).any():
        return None
    return (
        _mesh(grid, level)
        if radius == 0.0
        else balls(grid.points[(level < 0.0) & (out > -edge)], radius)
    )


def balls(centres: Float64[np.ndarray, "points 3"], radius: float) -> FlatMesh:
    """Mesh all points within a radius [m] of some centres (P, 3) [m]."""
    edge = radius / CUBES_PER_RADIUS
    low = centres.min(axis=0) - 2.0 * radius
    cubes = np.floor((centres - low) / edge).astype(np.int64)
    for _ in range(int(CUBES_PER_RADIUS) + 1):
        for axis in np.eye(3, dtype=np.int64):
            cubes = np.unique(np.concatenate([cubes - axis, cubes, cubes + axis]), axis=0)
    grid = _grid(cubes, low, edge)
    return _mesh(grid, _snapped(KDTree(centres).query(grid.points)[0] - radius, edge))


@dataclass(frozen=True, eq=False)
class _Grid:
    """Cubes of an edge [m] and the points [m] at their corners, whose ascending keys differ by a stride an axis."""

    edge: float
    points: Float64[np.ndarray, "points 3"]
    keys: Int64[np.ndarray, "points"]
    strides: Int64[np.ndarray, "3"]
    corners: Int64[np.ndarray, "cubes 8"]


def _grid(cubes: Int64[np.ndarray, "cubes 3"], low: Float64[np.ndarray, "3"], edge: float) -> _Grid:
    corners = cubes[:, None] + _BITS
    strides = np.array([1, *np.cumprod(corners.max(axis=(0, 1))[:2] + 2)])
    keys, inverse = np.unique(corners @ strides, return_inverse=True)
    points = np.empty((len(keys), 3))
    points[inverse.ravel()] = low + edge * corners.reshape(-1, 3)
    return _Grid(edge, points, keys, strides, inverse.reshape(-1, 8))


def _cubes(what: Filling, edge: float) -> Int64[np.ndarray, "cubes 3"]:
    """Cubes of the grid, counted from the box's corner, which the surface of the filling may pass."""
    size = edge * 2.0 ** max(0, round(np.log2((what.high - what.low).max() / (FEWEST * edge))))
    counts = np.maximum(np.ceil((what.high - what.low) / size).astype(np.int64), 1)
    cubes = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=3).reshape(-1, 3)
    while True:
        one, two = what.distances(what.low + size * (cubes + 0.5))
        radius = np.sqrt(0.75) * size
        cubes = cubes[
            (np.minimum(one, two) > -what.reach - radius) & (one + two < what.width + 2.0 * radius)
        ]
        if len(cubes) > MOST:
            raise InvalidInput(
                f"the bodies run so close over so large an area that filling in between takes more than {MOST:g} cubes "
                f"of {size * 1e3:.3g} mm; move them apart, or make one body of them before.",
                0.5 * (what.low + what.high),
                code="too_many",
            )
        if size <= edge * 1.5:
            return cubes
        cubes, size = (2 * cubes[:, None] + _BITS).reshape(-1, 3), size / 2.0


def _levels(
    what: Filling, grid: _Grid
) -> tuple[Float64[np.ndarray, "points"], Float64[np.ndarray, "points"]]:
    """Find what is negative in the filling, and how far out of both bodies the corners of the cubes are [m]."""
    one, two = what.distances(grid.points)
    total, out = one + two, np.minimum(one, two)
    around = grid.keys[:, None] + grid.strides * np.array([1, -1])[:, None, None]
    found = np.minimum(np.searchsorted(grid.keys, around), len(grid.keys) - 1)
    ahead, behind = total[found]
    steepness = np.linalg.norm(ahead - behind, axis=1) / (2.0 * grid.edge)
    facing = np.clip(
        1.5 * (1.0 - steepness / FACING), -1.0, 1.0
    )  # below zero the filling keeps off a furrow
    facing[
        (grid.keys[found] != around).any(axis=(0, 2))
    ] = -1.0  # all around what is filled there are cubes
    return _snapped(np.maximum(total - what.width * facing, -out - what.reach), grid.edge), out


def _snapped(level: Float64[np.ndarray, "points"], edge: float) -> Float64[np.ndarray, "points"]:
    return np.where(level < 0.0, np.minimum(level, -SNAP * edge), np.maximum(level, SNAP * edge))


def _mesh(grid: _Grid, level: Float64[np.ndarray, "points"]) -> FlatMesh:
    """Mesh where the level passes zero."""
    tetrahedra = grid.corners[:, _TETRAHEDRA].reshape(-1, 4)
    pattern = (level[tetrahedra] < 0.0) @ np.array([1, 2, 4, 8])
    ends = [np.zeros((0, 3, 2), dtype=np.int64)]
    for number, table in _TRIANGLES.items():
        ends.append(tetrahedra[pattern == number][:, table].reshape(-1, 3, 2))
    both = np.sort(np.concatenate(ends).reshape(-1, 2), axis=1) @ np.array([len(level), 1])
    edges, triangles = np.unique(both, return_inverse=True)
    here, there = np.divmod(edges, len(level))
    share = (level[here] / (level[here] - level[there]))[:, None]
    return grid.points[here] * (1.0 - share) + grid.points[there] * share, triangles.reshape(
        -1, 3
    ).astype(np.int64)


def _tetrahedra() -> Int64[np.ndarray, "6 4"]:
    """Corners of the six tetrahedra round a diagonal of a cube, right-handed."""
    found = []
    for one, two, _ in permutations((1, 2, 4)):
        path = [0, one, one + two, 7]
        edges = _BITS[path[1:]] - _BITS[0]
        found.append(path if np.linalg.det(edges) > 0.0 else [0, one + two, one, 7])
    return np.array(found)


def _triangles() -> dict[int, Int64[np.ndarray, "triangles 3 2"]]:
    """Triangles between what is inside and outside of a right-handed tetrahedron, by which corners (bits) are inside.

    A corner of a triangle is given by the two ends of the edge that it lies on.
    """
    found = {}
    for a, b, c, d in permutations(range(4)):
        if np.linalg.det(np.eye(4)[[a, b, c, d]]) > 0.0:
            found[1 << a] = np.array([[[a, b], [a, c], [a, d]]])
            found[15 - (1 << a)] = found[1 << a][:, ::-1]
            found[1 << a | 1 << b] = np.array([[[a, c], [a, d], [b, d]], [[a, c], [b, d], [b, c]]])
    return found


_TETRAHEDRA, _TRIANGLES = _tetrahedra(), _triangles()
