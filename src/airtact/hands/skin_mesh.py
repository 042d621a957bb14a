"""Even triangles on the body of a hand, closed in every pose of the fingers.

Marching cubes on a grid of the distance produce a closed mesh. Passes of splitting, collapsing,
flipping and smoothing then make its triangles even, and each pass projects the vertices onto the
skin. On the grid, separate fingers are made thinner, so that a coarse grid resolves the air between
them. The projection moves their triangles back to the skin.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from airtact import _kernels
from airtact.errors import extra, fixed
from airtact.geometry.mesh.evening import even_pass
from airtact.geometry.mesh.triangles import (
    Triangles,
    VertexSizes,
    Vertices,
    components,
    cone_volumes,
    edge_keys,
    smallest_angles,
    with_middles,
)
from airtact.hands.body import Hulls
from airtact.hands.joints import Points

# Level of the distance divided by the grid step, and grid step divided by the usual step. The pairs
# are tried in order until a mesh is good: a tiny tunnel that one grid meshes badly vanishes or is
# resolved in another grid.
GRIDS = (
    *((0.0, 1.0), (0.2, 1.0), (-0.2, 1.0), (0.4, 1.0)),
    *((0.0, 0.8), (0.3, 0.8), (0.0, 0.63), (0.4, 0.63), (0.0, 0.5)),
)

# Largest increase of the edge length per distance along the skin.
GRADING = 0.35

# Largest distance of the skin from an edge's midpoint, divided by the edge length.
MAX_BULGE = 0.47

# Smallest target edge length at gaps and bends [m].
SMALLEST_EDGE = 0.8e-3

# Triangles with a smaller angle are poor and are collapsed during repair [degrees].
POOR_ANGLE = 22.0


@dataclass(frozen=True, eq=False)
class HandMesh:
    """Triangles on the skin of a hand.

    Attributes
    ----------
    vertices : (V, 3) positions of the vertices [m].
    triangles : (T, 3) vertex indices, counter-clockwise when seen from outside.
    sizes : (V,) target length of the edges at each vertex [m].
    """

    vertices: Vertices
    triangles: Triangles
    sizes: VertexSizes

    def fixed(self) -> "HandMesh":
        """Return a copy with read-only arrays."""
        triangles = self.triangles.copy()
        triangles.flags.writeable = False
        return HandMesh(fixed(self.vertices), triangles, fixed(self.sizes))

    @property
    def angles(self) -> Float64[np.ndarray, "triangles"]:
        """Smallest angle of each triangle [degrees]."""
        return smallest_angles(with_middles(self.vertices[self.triangles]))


def even_skin(hulls: Hulls, edge: float) -> HandMesh:
    """Mesh a body with edges of length ``edge``, and shorter ones at bends and narrow gaps."""
    best = None
    best_fault = np.inf
    # The grid must resolve the smallest ball.
    usual_step = min(0.9 * edge, 0.42 * float(hulls.balls[:, 3].min()))
    for level, share in GRIDS:
        step = share * usual_step
        mesh = _projected(hulls, _marching_cubes(hulls, step, level * step), edge)
        # The edges grow from pass to pass, up to the target length.
        growing = 1.2 * step
        while growing < edge:
            mesh = _evened(hulls, mesh, edge, max_size=growing)
            growing *= 1.7
        for _ in range(4):
            mesh = _evened(hulls, mesh, edge)
        fault, mesh = _repaired(hulls, mesh, edge)
        if best is None or fault < best_fault:
            best = mesh
            best_fault = fault
        if fault <= 0.0:
            break
    assert best is not None
    return best


def graded(hulls: Hulls, mesh: HandMesh, edge: float, fine: float, points: Points) -> HandMesh:
    """Refine a mesh of edge length ``edge`` to edge length ``fine`` near points (P, 3) [m]."""
    from scipy.spatial import KDTree  # importing it takes 0.2 s

    tree = KDTree(points)
    for _ in range(4):
        away = tree.query(mesh.vertices)[0]
        # Edges stay fine within four edge lengths of the points.
        sizes = np.clip(fine + GRADING * (away - 4.0 * fine), fine, edge)
        mesh = _evened(hulls, replace(mesh, sizes=sizes), edge, hold=True)
    return _repaired(hulls, mesh, edge)[1]


def settled(hulls: Hulls, mesh: HandMesh, edge: float) -> HandMesh:
    """Project triangles onto a nearby body and smooth them, without adding triangles."""
    mesh = _projected(hulls, mesh, edge)
    for _ in range(2):
        mesh = _evened(hulls, mesh, edge, keep=True)
    return mesh


def midpoints(hulls: Hulls, mesh: HandMesh) -> Float64[np.ndarray, "triangles 3 3"]:
    """Return the midpoints (T, 3, 3) [m] of edges 01, 12 and 20, projected onto the skin."""
    ends, edges = _edges(mesh.triangles)
    return _middles(hulls, mesh, ends)[0][edges]


# --- repair of poor triangles -----------------------------------------------------------------


def _repaired(hulls: Hulls, mesh: HandMesh, edge: float) -> tuple[float, HandMesh]:
    """Improve poor triangles, including where skins meet; return the ``_fault`` and the mesh."""
    best = mesh
    best_fault = _fault(hulls, mesh)
    for attempt in range(6):
        if best_fault <= 0.0 or len(mesh.triangles) > 1.25 * len(best.triangles):
            break
        # If passes of ``_evened`` are not enough, poor triangles are also made smaller.
        if attempt >= 3:
            ends, edges = _edges(mesh.triangles)
            bulging = (_middles(hulls, mesh, ends)[1][edges] > MAX_BULGE).any(axis=1)
            poor = bulging | (mesh.angles < POOR_ANGLE)
            sizes = mesh.sizes.copy()
            sizes[mesh.triangles[poor]] *= 0.7
            mesh = replace(mesh, sizes=np.maximum(sizes, SMALLEST_EDGE / 2.0))
        mesh = _evened(hulls, mesh, edge, collapse_angle=POOR_ANGLE, pull=0.4, hold=True)
        fault = _fault(hulls, mesh)
        if fault < best_fault:
            best = mesh
            best_fault = fault
    return best_fault, best


def _fault(hulls: Hulls, mesh: HandMesh) -> float:
    """Return the largest relative excess over the limits for a good mesh; at most 0 if good."""
    ends = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    ends = ends[ends[:, 0] < ends[:, 1]]  # a closed mesh has each edge in both directions
    off = float(np.abs(hulls.look(mesh.vertices).distance).max())
    return max(
        1.0 - float(mesh.angles.min()) / 20.0,  # smallest angle [degrees]
        float(_middles(hulls, mesh, ends)[1].max()) / MAX_BULGE - 1.0,
        off / 1e-6 - 1.0,  # largest distance of a vertex from the skin [m]
    )


# --- triangles from a grid --------------------------------------------------------------------


def _marching_cubes(hulls: Hulls, step: float, level: float) -> HandMesh:
    """Extract a closed mesh without cavities or specks from a grid of distances."""
    with extra("mesh", "the skin of a hand needs scikit-image"):
        from skimage.measure import marching_cubes

    distance, low = _distance_grid(hulls, step)
    distance = distance - level
    distance[np.abs(distance) < 1e-3 * step] = 1e-3 * step  # avoids triangles without area
    vertices, triangles, _, _ = marching_cubes(
        distance.astype(np.float32), 0.0, spacing=(step, step, step), gradient_direction="descent"
    )
    vertices = vertices.astype(np.float64) + low
    triangles = triangles.astype(np.int64)
    first, second, third = triangles.T
    piece = components(np.r_[first, second], np.r_[second, third], len(vertices))
    if piece.max() > 0:
        # Cavities, whose volume is negative, are dropped because sound does not reach them.
        volume = np.bincount(piece[first], cone_volumes(vertices[triangles]))
        used = volume[piece] > (2.0 * step) ** 3
        new_index = np.cumsum(used) - 1
        triangles = new_index[triangles[used[first]]]
        vertices = vertices[used]
    return HandMesh(vertices, triangles, np.full(len(vertices), step))


def _distance_grid(
    hulls: Hulls, step: float
) -> tuple[Float64[np.ndarray, "nx ny nz"], Float64[np.ndarray, "3"]]:
    """Return the distance on a grid with spacing ``step`` [m], and the grid's first corner [m].

    All points of a block far from the skin get the value at its middle; other blocks are halved.
    """
    side = 4
    highest_level = max(level for level, _ in GRIDS)
    centres = hulls.balls[:, :3]
    radii = hulls.balls[:, 3:]
    low = (centres - radii).min(axis=0) - 1.6 * step
    extent = (centres + radii).max(axis=0) + 1.6 * step - low
    shape = side * np.ceil(extent / (side * step)).astype(np.int64)
    values = np.empty(shape)
    corners = side * _grid_indices(shape // side)
    while True:
        middles = low + step * (corners + (side - 1) / 2)
        # Separate fingers are cut back by slightly more than a grid step.
        distance = hulls.look(middles, carve=1.15 * step).distance
        blocks = values.reshape(np.stack([shape // side, [side] * 3], axis=1).ravel())
        x, y, z = (corners // side).T
        blocks[x, :, y, :, z, :] = distance[:, None, None, None]
        if side == 1:
            return values, low
        half_diagonal = np.sqrt(3) * (side - 1) / 2
        near = np.abs(distance) < step * (1.3 * half_diagonal + highest_level)
        side //= 2
        halves = side * _grid_indices(np.array([2, 2, 2]))
        corners = (corners[near, None] + halves).reshape(-1, 3)


def _grid_indices(counts: Int64[np.ndarray, "3"]) -> Int64[np.ndarray, "cells 3"]:
    return np.ascontiguousarray(np.indices(tuple(counts)).reshape(3, -1).T)


# --- one pass ---------------------------------------------------------------------------------


def _evened(
    hulls: Hulls,
    mesh: HandMesh,
    edge: float,
    *,
    max_size: float = np.inf,
    collapse_angle: float = 0.0,
    pull: float = 0.6,
    keep: bool = False,
    hold: bool = False,
) -> HandMesh:
    """Make the triangles more even in one pass and project them onto the skin.

    Parameters
    ----------
    hulls, mesh : the body and triangles near its skin.
    edge : target edge length [m].
    max_size : largest edge length [m].
    collapse_angle : triangles with a smaller angle are collapsed [degrees].
    pull : distance by which a vertex is moved toward the centre of its neighbours, as a fraction of
        its distance from this centre.
    keep : whether the triangles stay the same and only the vertices move.
    hold : whether the ``sizes`` of the mesh are upper limits.
    """
    (vertices, triangles), sizes = even_pass(
        mesh.vertices,
        np.minimum(mesh.sizes, max_size),
        mesh.triangles,
        pull,
        collapse_angle,
        keep,
    )
    mesh = HandMesh(vertices, triangles, sizes)
    return _projected(hulls, mesh, edge, sizes if hold else np.inf)


def _projected(
    hulls: Hulls, mesh: HandMesh, edge: float, max_sizes: VertexSizes | float = np.inf
) -> HandMesh:
    """Project the vertices onto the skin, and set the edge lengths that bends and gaps allow."""
    vertices = hulls.project(mesh.vertices)
    look = hulls.look(vertices, reach=edge)
    smallest = max(0.25 * edge, min(SMALLEST_EDGE, edge))
    allowed = np.minimum(1.1 * look.bend, np.maximum(look.facing, 0.0))
    sizes = np.minimum(np.clip(allowed, smallest, edge), max_sizes)
    # Three passes over all edges
    _kernels.grade_sizes(vertices, mesh.triangles, GRADING, 3, sizes)
    return HandMesh(vertices, mesh.triangles, sizes)


# --- skin points above midpoints of edges -----------------------------------------------------


def _middles(
    hulls: Hulls, mesh: HandMesh, ends: Int64[np.ndarray, "edges 2"]
) -> tuple[Float64[np.ndarray, "edges 3"], Float64[np.ndarray, "edges"]]:
    """Return skin points above the edges' midpoints (E, 3) [m], and their relative height."""
    starts = mesh.vertices[ends[:, 0]]
    edges = mesh.vertices[ends[:, 1]] - starts
    straight = starts + 0.5 * edges
    lengths = np.sqrt(np.einsum("ei,ei->e", edges, edges))
    middles = hulls.project(straight)
    off = np.linalg.norm(middles - straight, axis=1)
    # Where two skins meet, their flanks are nearer than the crease between them. Points on both
    # sides of the middle are therefore projected as well, and the nearest result is used.
    for share in (0.4, 0.6, 0.3, 0.7):
        poor = np.flatnonzero(off > 0.3 * lengths)
        projected = hulls.project(starts[poor] + share * edges[poor])
        distance = np.linalg.norm(projected - straight[poor], axis=1)
        better = distance < off[poor]
        middles[poor[better]] = projected[better]
        off[poor[better]] = distance[better]
    return middles, off / lengths


def _edges(triangles: Triangles) -> tuple[Int64[np.ndarray, "edges 2"], Triangles]:
    """Return the two ends of each edge, and the indices of edges 01, 12, 20 of each triangle."""
    keys, edges = np.unique(edge_keys(triangles), return_inverse=True)
    return np.stack(np.divmod(keys, triangles.max() + 1), axis=1), edges.reshape(triangles.shape)
