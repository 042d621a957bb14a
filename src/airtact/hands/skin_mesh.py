"""Even triangles on the body of a hand, closed whatever the fingers do.

Marching cubes on a grid of the distance give closed triangles. Passes of splitting, collapsing,
flipping and smoothing make them even; each pass projects the corners onto the skin. On the grid,
fingers that stand apart are carved out round each other, so that even a coarse grid resolves the
air between them; their triangles then grow back onto the skin.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from airtact import _kernels
from airtact.checks import fixed
from airtact.errors import extra
from airtact.geometry.mesh.quadratic_triangles import smallest_angles, with_middles
from airtact.geometry.mesh.topology import cone_volumes, edge_keys
from airtact.geometry.panels import LARGEST_TO_GAP
from airtact.hands.sphere_mesh import Hulls

GRADING = 0.35
"""How much longer edges may get over a distance, over that distance."""

SMALLEST_EDGE = 0.8e-3
"""Gaps and bends make edges no smaller than this, nor than ``SMALLEST`` of the edge wanted [m]."""


@dataclass(frozen=True, eq=False)
class HandMesh:
    """Triangles on the skin of a hand.

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
        """Copy it into arrays that are read-only."""
        triangles = self.triangles.copy()
        triangles.flags.writeable = False
        return HandMesh(fixed(self.vertices), triangles, fixed(self.sizes))

    @property
    def angles(self) -> Float64[np.ndarray, "triangles"]:
        """Smallest angle of each triangle [degrees]."""
        return smallest_angles(with_middles(self.vertices[self.triangles]))


# --- whole meshes ---------------------------------------------------------------------------------------------------

PASSES = 4
"""Passes at the size wanted."""

GRIDS = (
    (0.0, 1.0),
    (0.2, 1.0),
    (-0.2, 1.0),
    (0.4, 1.0),
    (0.0, 0.8),
    (0.3, 0.8),
    (0.0, 0.63),
    (0.4, 0.63),
    (0.0, 0.5),
)
"""Levels of the distance, over the step, and shares of the usual step. They are tried in turn until a mesh is good: a
tiny tunnel that spoils one grid vanishes in another, or is resolved."""

COARSEST, FINE = 0.42, 0.9
"""Largest steps of the grid, over the radius of the smallest ball and over the edge wanted."""

FIRST, COARSENING = 1.2, 1.7
"""Edge of the first pass over the step of the grid, and the factor by which it grows from pass to pass."""


def even_skin(hulls: Hulls, edge: float) -> HandMesh:
    """Cover a body with equilateral triangles of about an edge [m]; bends and narrow gaps get smaller ones."""
    best, least = None, np.inf
    for level, share in GRIDS:
        step = share * min(FINE * edge, COARSEST * hulls.thinnest)
        mesh = _projected(hulls, _marching_cubes(hulls, step, level * step), edge)
        now = FIRST * step
        while now < edge:
            mesh = _evened(hulls, mesh, edge, now)
            now *= COARSENING
        for _ in range(PASSES):
            mesh = _evened(hulls, mesh, edge)
        fault, mesh = _repaired(hulls, mesh, edge)
        if best is None or fault < least:
            best, least = mesh, fault
        if fault <= 0.0:
            break
    assert best is not None
    return best


BESIDE = 4.0
"""Edges stay fine within this distance of the points of ``graded``, over the fine edge."""


def graded(
    hulls: Hulls, mesh: HandMesh, edge: float, fine: float, points: Float64[np.ndarray, "points 3"]
) -> HandMesh:
    """Make the triangles of a mesh of an edge [m] smaller beside points (P, 3) [m], with ``fine`` edges [m] there."""
    tree = KDTree(points)
    for _ in range(PASSES):
        away = tree.query(mesh.vertices)[0]
        sizes = np.clip(fine + GRADING * (away - BESIDE * fine), fine, edge)
        mesh = _evened(hulls, replace(mesh, sizes=sizes), edge, hold=True)
    return _repaired(hulls, mesh, edge)[1]


SETTLING = 2
"""Passes of ``settled``."""


def settled(hulls: Hulls, mesh: HandMesh, edge: float) -> HandMesh:
    """Project triangles near a body, made with an edge [m], onto it and smooth them, without changing their corners."""
    found = _projected(hulls, mesh, edge)
    for _ in range(SETTLING):
        found = _evened(hulls, found, edge, keep=True)
    return found


# --- repair of poor triangles ---------------------------------------------------------------------------------------

LEAST, MOST_BULGING, OFF = 20.0, 0.47, 1e-6
"""A mesh is good with a smallest angle above the first [degrees], no point over the middle of an edge farther off than
the second times the edge, and no corner farther off the skin than the third [m]."""

REPAIRS, PATIENCE = 6, 3
"""Passes that repair a mesh at most, and after how many of them the triangles that are still poor get smaller ..."""

SHRINKING, MOST = 0.7, 1.25
"""... by this factor, as long as there are no more than this times the triangles of the best mesh."""

GOOD = 22.0
"""Triangles with a smaller angle are poor [degrees]."""

REPAIR_PULL = 0.4
"""``PULL`` of the passes that repair."""


def _repaired(hulls: Hulls, mesh: HandMesh, edge: float) -> tuple[float, HandMesh]:
    """Make poor triangles more even, and smaller where skins meet; return the least fault and its mesh."""
    best = _fault(hulls, mesh), mesh
    for attempt in range(REPAIRS):
        if best[0] <= 0.0 or len(mesh.triangles) > MOST * len(best[1].triangles):
            break
        poor = mesh.angles < GOOD
        if attempt >= PATIENCE:
            ends, edges = _edges(mesh.triangles)
            poor |= (_middles(hulls, mesh, ends)[1][edges] > MOST_BULGING).any(axis=1)
            sizes = mesh.sizes.copy()
            sizes[mesh.triangles[poor]] *= SHRINKING
            mesh = replace(mesh, sizes=np.maximum(sizes, SMALLEST_EDGE / 2.0))
        mesh = _evened(hulls, mesh, edge, needle=GOOD, pull=REPAIR_PULL, hold=True)
        fault = _fault(hulls, mesh)
        if fault < best[0]:
            best = fault, mesh
    return best


def _fault(hulls: Hulls, mesh: HandMesh) -> float:
    """How far a mesh is from good: 0 or less for a good one."""
    ends = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    bulge = float(
        _middles(hulls, mesh, ends[ends[:, 0] < ends[:, 1]])[1].max()
    )  # closed: each edge runs both ways
    off = float(np.abs(hulls.look(mesh.vertices).distance).max())
    return max(1.0 - float(mesh.angles.min()) / LEAST, bulge / MOST_BULGING - 1.0, off / OFF - 1.0)


# --- triangles from a grid ------------------------------------------------------------------------------------------

CARVED = 1.15
"""How far fingers are carved out round each other, over the step of the grid."""

BLOCK = 4
"""Points along a side of the blocks whose middle is evaluated first; blocks near the skin are halved."""


def _marching_cubes(hulls: Hulls, step: float, level: float) -> HandMesh:
    """Make closed triangles from a grid of the distance."""
    with extra("mesh", "the skin of a hand needs scikit-image"):
        from skimage.measure import marching_cubes

    distance, low = _distance_grid(hulls, step)
    distance = distance - level
    distance[np.abs(distance) < 1e-3 * step] = 1e-3 * step  # triangles without an area would follow
    vertices, triangles, _, _ = marching_cubes(
        distance.astype(np.float32), 0.0, spacing=(step, step, step), gradient_direction="descent"
    )
    vertices, triangles = _outer(
        vertices.astype(np.float64) + low, triangles.astype(np.int64), (2.0 * step) ** 3
    )
    return HandMesh(vertices, triangles, np.full(len(vertices), step))


def _outer(
    vertices: Float64[np.ndarray, "vertices 3"],
    triangles: Int64[np.ndarray, "triangles 3"],
    smallest: float,
) -> tuple[Float64[np.ndarray, "used 3"], Int64[np.ndarray, "outer 3"]]:
    """Leave out hollows inside the body, which no sound reaches, and specks."""
    one, two, three = triangles.T
    ties = coo_array(
        (np.ones(2 * len(one), dtype=bool), (np.r_[one, two], np.r_[two, three])),
        shape=(len(vertices),) * 2,
    )
    count, piece = connected_components(ties, directed=False)
    if count == 1:
        return vertices, triangles
    volume = np.bincount(piece[one], cone_volumes(vertices[triangles]), count)
    used = volume[piece] > smallest
    new_index = np.cumsum(used) - 1
    return vertices[used], new_index[triangles[used[one]]]


def _distance_grid(
    hulls: Hulls, step: float
) -> tuple[Float64[np.ndarray, "nx ny nz"], Float64[np.ndarray, "3"]]:
    """Evaluate the distance on a grid; a block of points far from the skin takes the value at its middle."""
    highest = max(level for level, _ in GRIDS)
    centres, radii = hulls.balls[:, :3], hulls.balls[:, 3:]
    low = (centres - radii).min(axis=0) - 1.6 * step
    blocks = np.ceil(((centres + radii).max(axis=0) + 1.6 * step - low) / (BLOCK * step)).astype(
        np.int64
    )
    values = np.empty(BLOCK * blocks)
    corners, side = BLOCK * _corners(blocks), BLOCK
    while True:
        rough = hulls.look(low + step * (corners + (side - 1) / 2), carve=CARVED * step).distance
        cells = values.reshape(np.stack([BLOCK * blocks // side, [side] * 3], axis=1).ravel())
        x, y, z = (corners // side).T
        cells[x, :, y, :, z, :] = rough[:, None, None, None]
        if side == 1:
            return values, low
        near = np.abs(rough) < step * (1.3 * np.sqrt(3) * (side - 1) / 2 + highest)
        side //= 2
        corners = (corners[near, None] + side * _corners(np.array([2, 2, 2]))).reshape(-1, 3)


def _corners(counts: Int64[np.ndarray, "3"]) -> Int64[np.ndarray, "corners 3"]:
    return np.ascontiguousarray(np.indices(tuple(counts)).reshape(3, -1).T)


# --- one pass -------------------------------------------------------------------------------------------------------

PULL = 0.6
"""Share of the way to the middle of its neighbours that a corner moves in a pass."""

BENDING = 1.1
"""Edge over the radius at which the skin bends, at most."""

SMALLEST = 0.25
"""Gaps and bends make edges no smaller than this share of the edge wanted."""

GRADED = 3
"""Rounds over all edges that enforce ``GRADING``."""


def _evened(
    hulls: Hulls,
    mesh: HandMesh,
    edge: float,
    longest: float = np.inf,
    needle: float = 0.0,
    pull: float = PULL,
    keep: bool = False,
    hold: bool = False,
) -> HandMesh:
    """Make the triangles more even in one pass, with edges of ``longest`` [m] at most, and project them onto the skin.

    Triangles with an angle below ``needle`` [degrees] are collapsed. ``keep`` moves corners only;
    ``hold`` keeps the sizes of the mesh where gaps and bends ask for no smaller ones.
    """
    count = len(mesh.vertices)
    most = 2 * count + 1000
    vertices, sizes = np.empty((most, 3)), np.empty(most)
    triangles = np.empty((2 * most, 3), dtype=np.int64)
    counts = np.array([count, len(mesh.triangles)], dtype=np.int64)
    vertices[:count], triangles[: counts[1]] = mesh.vertices, mesh.triangles
    sizes[:count] = np.minimum(mesh.sizes, longest)
    cosine = float(np.cos(np.radians(needle))) if needle else 1.0
    _kernels.even_pass(vertices, sizes, triangles, counts, keep, cosine, pull)
    count = counts[0]
    mesh = HandMesh(vertices[:count].copy(), triangles[: counts[1]].copy(), sizes[:count])
    return _projected(hulls, mesh, edge, sizes[:count] if hold else np.inf)


def _projected(
    hulls: Hulls,
    mesh: HandMesh,
    edge: float,
    longest: Float64[np.ndarray, "vertices"] | float = np.inf,
) -> HandMesh:
    """Project the corners onto the skin and find how large the edges there may be."""
    vertices = hulls.project(mesh.vertices)
    found = hulls.look(vertices, reach=edge)
    least = max(SMALLEST * edge, min(SMALLEST_EDGE, edge))
    wanted = np.minimum(BENDING * found.bend, LARGEST_TO_GAP * np.maximum(found.facing, 0.0))
    sizes = np.minimum(np.clip(wanted, least, edge), longest)
    _kernels.grade_sizes(vertices, mesh.triangles, GRADING, GRADED, sizes)
    return HandMesh(vertices, mesh.triangles, sizes)


# --- points over the middles of edges -------------------------------------------------------------------------------

BULGING, ASIDE = 0.3, (0.4, 0.6, 0.3, 0.7)
"""Where the projected middle of an edge is farther off than the first times the edge, points at these other shares of
the edge are projected: where two skins meet, their flanks are nearer than the bottom between
them."""


def midpoints(hulls: Hulls, mesh: HandMesh) -> Float64[np.ndarray, "triangles 3 3"]:
    """Find the points of the skin over the middles of edges 01, 12, 20 (T, 3, 3) [m]."""
    ends, edges = _edges(mesh.triangles)
    return _middles(hulls, mesh, ends)[0][edges]


def _middles(
    hulls: Hulls, mesh: HandMesh, ends: Int64[np.ndarray, "edges 2"]
) -> tuple[Float64[np.ndarray, "edges 3"], Float64[np.ndarray, "edges"]]:
    """Points of the skin over the middles of edges (E, 3), and how far off them, over the length of each edge (E,)."""
    starts, ways = mesh.vertices[ends[:, 0]], mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]]
    straight, lengths = starts + 0.5 * ways, np.sqrt(np.einsum("ei,ei->e", ways, ways))
    middles = hulls.project(straight)
    off = np.linalg.norm(middles - straight, axis=1)
    for share in ASIDE:
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
    keys, edges = np.unique(edge_keys(triangles), return_inverse=True)
    return np.stack(np.divmod(keys, triangles.max() + 1), axis=1), edges.reshape(triangles.shape)
