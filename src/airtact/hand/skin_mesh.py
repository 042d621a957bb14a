"""Even triangles on the body of a hand, closed whatever the fingers do.

A grid of the distance gives closed triangles; passes of splitting, collapsing, flipping and smoothing make them even,
each followed by bringing the corners onto the skin. Fingers that stand apart are carved out round each other first, so
that no grid is too coarse to see the air between them; their triangles then grow back onto the skin.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from airtact import _kernels
from airtact.hand.sphere_mesh import Hulls
from airtact.mesh.quadratic_triangles import smallest_angles, with_middles
from airtact.mesh.topology import cone_volumes
from airtact.surfaces.panels import LARGEST_TO_GAP
from airtact.validation import fixed

COARSEST = 0.42
"""Step of the grid over the radius of the smallest ball, at most."""

FINE = 0.9
"""Step of the grid over the edge wanted, where that is finer."""

CARVED = 1.15
"""How far fingers are carved out round each other, over the step of the grid."""

BLOCK = 4
"""Points along a side of the blocks of which the middle is looked at first; then those of half of it, and so on."""

BENDING = 1.1
"""Edge over the radius at which the skin bends, at most."""

SMALLEST = 0.25
"""Edges are not made smaller for a gap's or a bend's sake than this share of the edge wanted ..."""

SMALLEST_EDGE = 0.8e-3
"""... or this [m]."""

GRADING = 0.35
"""How much longer edges may get over a distance, over that distance."""

GRIDS = ((0.0, 1.0), (0.2, 1.0), (-0.2, 1.0), (0.4, 1.0), (0.0, 0.8), (0.3, 0.8), (0.0, 0.63), (0.4, 0.63), (0.0, 0.5))
"""Levels of the distance, over the step, and shares of the usual step that are tried one after the other: another grid
has no tunnel where a tiny one is in the way, or sees it whole."""

HIGHEST = 0.4
"""Highest of these levels."""

LEAST, MOST_BULGING = 20.0, 0.47
"""Smallest angle [degrees] and largest bulge of triangles with which no other level is tried."""

OFF = 1e-6
"""So far may corners be off the skin [m]."""

GRADED = 3
"""Rounds over all edges that see to that."""

BESIDE = 4.0
"""Edges stay fine within this distance of the points that ask for it, over the edge."""

FIRST = 1.2
"""Edges of the first pass over the step of the grid."""

COARSENING = 1.7
"""From one pass to the next the edges grow by this at most."""

PASSES = 4
"""Passes at the size wanted."""

REPAIRS = 6
"""More passes, until the smallest angle is ``GOOD``."""

PATIENCE = 3
"""Passes after which triangles that are still not good are made smaller ..."""

BULGING = 0.3
"""Distance of the skin from the middle of an edge over its length above which nearer points are looked for ..."""

ASIDE = (0.4, 0.6, 0.3, 0.7)
"""... over these shares of the edge."""

SHRINKING = 0.7
"""... by this factor."""

MOST = 1.25
"""Factor by which there may be more of them for that."""

GOOD = 22.0
"""Smallest angle that ends them [degrees]."""

SETTLING = 2
"""Passes that only move corners, for a mesh that follows the hand."""

PULL = 0.6
"""Share of the way to the middle of its neighbours that a corner moves in a pass."""


@dataclass(frozen=True, eq=False)
class HandMesh:
    """Triangles on the skin.

    Attributes
    ----------
    vertices : (V, 3) [m].
    triangles : (T, 3) vertex indices, outward.
    sizes : (V,) length of edges that was wanted there [m].
    """

    vertices: Float64[np.ndarray, "vertices 3"]
    triangles: Int64[np.ndarray, "triangles 3"]
    sizes: Float64[np.ndarray, "vertices"]

    def fixed(self) -> "HandMesh":
        """Copy it into arrays that nobody can write to."""
        triangles = self.triangles.copy()
        triangles.flags.writeable = False
        return HandMesh(fixed(self.vertices), triangles, fixed(self.sizes))

    @property
    def angles(self) -> Float64[np.ndarray, "triangles"]:
        """Smallest angle of each triangle [degrees]."""
        return smallest_angles(with_middles(self.vertices[self.triangles]))


class Graded(NamedTuple):
    """Edges that are finer beside some points.

    Attributes
    ----------
    edge : far from them [m].
    fine : beside them [m].
    points : (P, 3) [m].
    """

    edge: float
    fine: float
    points: Float64[np.ndarray, "points 3"]

    def at(self, places: Float64[np.ndarray, "places 3"]) -> Float64[np.ndarray, "places"]:
        """Return the edges wanted at places (P, 3) [m]."""
        away = KDTree(self.points).query(places)[0]
        return np.clip(self.fine + GRADING * (away - BESIDE * self.fine), self.fine, self.edge)


def even_skin(hulls: Hulls, edge: float, graded: Graded | None = None) -> HandMesh:
    """Cover a body with even triangles.

    Parameters
    ----------
    hulls : the body.
    edge : edge of the equilateral triangles wanted [m]; bends and narrow gaps get finer ones.
    graded : finer triangles beside some points, or None.
    """
    skin = _best_skin(hulls, edge)
    for _ in range(PASSES if graded else 0):
        assert graded is not None
        skin = _pass(hulls, HandMesh(skin.vertices, skin.triangles, graded.at(skin.vertices)), edge, hold=True)
    return skin if graded is None else _repaired(hulls, skin, edge)[1]


def _best_skin(hulls: Hulls, edge: float) -> HandMesh:
    best = None
    for level, share in GRIDS:
        fault, skin = _evened(hulls, edge, level, share)
        if best is None or fault < best[0]:
            best = fault, skin
        if fault <= 0.0:
            break
    assert best is not None
    return best[1]


def _evened(hulls: Hulls, edge: float, level: float, share: float) -> tuple[float, HandMesh]:
    """Even triangles from one grid, and their fault."""
    step = share * min(FINE * edge, COARSEST * hulls.thinnest)
    skin = _onto(hulls, _gridded(hulls, step, level * step), edge)
    now = FIRST * step
    while now < edge:
        skin = _pass(hulls, skin, edge, now)
        now *= COARSENING
    for _ in range(PASSES):
        skin = _pass(hulls, skin, edge)
    return _repaired(hulls, skin, edge)


def _repaired(hulls: Hulls, skin: HandMesh, edge: float) -> tuple[float, HandMesh]:
    """Make triangles more even, and smaller where a narrow crease asks for it, until all are good; the least fault."""
    best = _fault(hulls, skin), skin
    for attempt in range(REPAIRS):
        if best[0] <= 0.0 or len(skin.triangles) > MOST * len(best[1].triangles):
            break
        poor = skin.angles < GOOD
        if attempt >= PATIENCE:
            poor |= (bulges(skin, midpoints(hulls, skin)) > MOST_BULGING).any(axis=1)
            sizes = skin.sizes.copy()
            sizes[skin.triangles[poor]] *= SHRINKING
            skin = HandMesh(skin.vertices, skin.triangles, np.maximum(sizes, SMALLEST_EDGE / 2.0))
        skin = _pass(hulls, skin, edge, needle=GOOD, pull=0.4, hold=True)
        fault = _fault(hulls, skin)
        if fault < best[0]:
            best = fault, skin
    return best


def _fault(hulls: Hulls, skin: HandMesh) -> float:
    """How far triangles are from good: 0 or less for those that are."""
    ends = np.stack([skin.triangles, np.roll(skin.triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    bulge = float(_middles(hulls, skin, ends[ends[:, 0] < ends[:, 1]])[1].max())  # closed: each edge runs both ways
    off = float(np.abs(hulls.look(skin.vertices).distance).max())
    return max(1.0 - float(skin.angles.min()) / LEAST, bulge / MOST_BULGING - 1.0, off / OFF - 1.0)


def settled(hulls: Hulls, skin: HandMesh, edge: float) -> HandMesh:
    """Bring triangles of a pose nearby onto a body and even them out, without changing which corners they join.

    Parameters
    ----------
    hulls : the body.
    skin : triangles near its skin.
    edge : edge that they were made with [m].
    """
    found = _onto(hulls, skin, edge)
    for _ in range(SETTLING):
        found = _pass(hulls, found, edge, keep=True)
    return found


def _gridded(hulls: Hulls, step: float, level: float) -> HandMesh:
    """Make closed triangles from a grid of the distance."""
    from skimage.measure import marching_cubes  # takes long to import, and only hands need it

    distance, low = _grid(hulls, step)
    distance = distance - level
    distance[np.abs(distance) < 1e-3 * step] = 1e-3 * step  # triangles without an area would follow
    vertices, triangles, _, _ = marching_cubes(
        distance.astype(np.float32), 0.0, spacing=(step, step, step), gradient_direction="descent"
    )
    vertices, triangles = _outer(vertices.astype(np.float64) + low, triangles.astype(np.int64), (2.0 * step) ** 3)
    return HandMesh(vertices, triangles, np.full(len(vertices), step))


def _outer(
    vertices: Float64[np.ndarray, "vertices 3"], triangles: Int64[np.ndarray, "triangles 3"], smallest: float
) -> tuple[Float64[np.ndarray, "used 3"], Int64[np.ndarray, "outer 3"]]:
    """Leave out hollows inside the body, where no sound gets, and specks."""
    one, two, three = triangles.T
    ties = coo_array(
        (np.ones(2 * len(one), dtype=bool), (np.r_[one, two], np.r_[two, three])), shape=(len(vertices),) * 2
    )
    count, piece = connected_components(ties, directed=False)
    if count == 1:
        return vertices, triangles
    volume = np.bincount(piece[one], cone_volumes(vertices[triangles]), count)
    used = volume[piece] > smallest
    place = np.cumsum(used) - 1
    return vertices[used], place[triangles[used[one]]]


def _grid(hulls: Hulls, step: float) -> tuple[Float64[np.ndarray, "nx ny nz"], Float64[np.ndarray, "3"]]:
    """Find the distance on a grid, in the middle of a block of points for all of it where the skin is far."""
    centres, radii = hulls.balls[:, :3], hulls.balls[:, 3:]
    low = (centres - radii).min(axis=0) - 1.6 * step
    blocks = np.ceil(((centres + radii).max(axis=0) + 1.6 * step - low) / (BLOCK * step)).astype(np.int64)
    values = np.empty(BLOCK * blocks)
    corners, side = BLOCK * _corners(blocks), BLOCK
    while True:
        rough = hulls.look(low + step * (corners + (side - 1) / 2), carve=CARVED * step).distance
        cells = values.reshape(np.stack([BLOCK * blocks // side, [side] * 3], axis=1).ravel())
        x, y, z = (corners // side).T
        cells[x, :, y, :, z, :] = rough[:, None, None, None]
        if side == 1:
            return values, low
        near = np.abs(rough) < step * (1.3 * np.sqrt(3) * (side - 1) / 2 + HIGHEST)
        side //= 2
        corners = (corners[near, None] + side * _corners(np.array([2, 2, 2]))).reshape(-1, 3)


def _corners(counts: Int64[np.ndarray, "3"]) -> Int64[np.ndarray, "corners 3"]:
    return np.stack(np.meshgrid(*[np.arange(count) for count in counts], indexing="ij"), axis=-1).reshape(-1, 3)


def _onto(
    hulls: Hulls, skin: HandMesh, edge: float, longest: Float64[np.ndarray, "vertices"] | None = None
) -> HandMesh:
    """Bring the corners onto the skin and say how large the edges there may be."""
    vertices = hulls.project(skin.vertices)
    found = hulls.look(vertices, reach=edge)
    least = max(SMALLEST * edge, min(SMALLEST_EDGE, edge))
    wanted = np.minimum(BENDING * found.bend, LARGEST_TO_GAP * np.maximum(found.facing, 0.0))
    sizes = np.clip(wanted, least, edge)
    if longest is not None:
        sizes = np.minimum(sizes, longest)
    _kernels.grade_sizes(vertices, skin.triangles, GRADING, GRADED, sizes)
    return HandMesh(vertices, skin.triangles, sizes)


def _pass(
    hulls: Hulls,
    skin: HandMesh,
    edge: float,
    longest: float = np.inf,
    needle: float = 0.0,
    pull: float = PULL,
    keep: bool = False,
    hold: bool = False,
) -> HandMesh:
    """Make the triangles more even, and bring them back onto the skin."""
    count = len(skin.vertices)
    most = 2 * count + 1000
    vertices, sizes = np.empty((most, 3)), np.empty(most)
    triangles = np.empty((2 * most, 3), dtype=np.int64)
    counts = np.array([count, len(skin.triangles)], dtype=np.int64)
    vertices[:count], triangles[: counts[1]] = skin.vertices, skin.triangles
    sizes[:count] = np.minimum(skin.sizes, longest)
    cosine = float(np.cos(np.radians(needle))) if needle else 1.0
    _kernels.even_pass(vertices, sizes, triangles, counts, keep, cosine, pull)
    count = counts[0]
    skin = HandMesh(vertices[:count].copy(), triangles[: counts[1]].copy(), sizes[:count].copy())
    return _onto(hulls, skin, edge, sizes[:count] if hold else None)


def midpoints(hulls: Hulls, skin: HandMesh) -> Float64[np.ndarray, "triangles 3 3"]:
    """Find the points of the skin over the middles of edges 01, 12, 20 (T, 3, 3) [m].

    Parameters
    ----------
    hulls : the body.
    skin : its triangles.
    """
    ends, place = _edges(skin.triangles)
    return _middles(hulls, skin, ends)[0][place]


def _middles(
    hulls: Hulls, skin: HandMesh, ends: Int64[np.ndarray, "edges 2"]
) -> tuple[Float64[np.ndarray, "edges 3"], Float64[np.ndarray, "edges"]]:
    """Points of the skin over the middles of edges (E, 3), and how far off them, over the length of each edge (E,)."""
    starts, ways = skin.vertices[ends[:, 0]], skin.vertices[ends[:, 1]] - skin.vertices[ends[:, 0]]
    straight, lengths = starts + 0.5 * ways, np.sqrt(np.einsum("ei,ei->e", ways, ways))
    middles = hulls.project(straight)
    off = np.linalg.norm(middles - straight, axis=1)
    for share in ASIDE:  # over a narrow crease the flanks are nearer than its bottom
        far = np.flatnonzero(off > BULGING * lengths)
        tried = hulls.project(starts[far] + share * ways[far])
        nearer = np.linalg.norm(tried - straight[far], axis=1)
        better = nearer < off[far]
        middles[far[better]], off[far[better]] = tried[better], nearer[better]
    return middles, off / lengths


def _edges(
    triangles: Int64[np.ndarray, "triangles 3"],
) -> tuple[Int64[np.ndarray, "edges 2"], Int64[np.ndarray, "triangles 3"]]:
    """Both ends of every edge once, and which of them edges 01, 12, 20 of each triangle are."""
    start, end = triangles, np.roll(triangles, -1, axis=1)
    count = int(triangles.max()) + 1
    keys, place = np.unique(np.minimum(start, end) * count + np.maximum(start, end), return_inverse=True)
    return np.stack([keys // count, keys % count], axis=1), place.reshape(triangles.shape)


def bulges(skin: HandMesh, middles: Float64[np.ndarray, "triangles 3 3"]) -> Float64[np.ndarray, "triangles 3"]:
    """Tell how far points over the middles of edges are off them, over the length of the edge (T, 3).

    Parameters
    ----------
    skin : triangles.
    middles : (T, 3, 3) the points [m].
    """
    starts = skin.vertices[skin.triangles]
    ends = np.roll(starts, -1, axis=1)
    return np.linalg.norm(middles - 0.5 * (starts + ends), axis=2) / np.linalg.norm(ends - starts, axis=2)
