"""Curved triangles over the bodies' surfaces that meet corner to corner.

Where a mirror plane cuts a body, the triangles follow the cut, and those on its negative side are
dropped.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.acoustics.solvers.arrays import Mask, Points, Vectors
from airtact.acoustics.solvers.fem.symmetry import Mirror
from airtact.geometry.mesh.arrays import QuadraticTriangles
from airtact.geometry.mesh.edge_limits import bend_sizes, strip_sizes
from airtact.geometry.mesh.remeshing import RidgedMesh, remeshed
from airtact.geometry.shape import Shape

# Ratio of the longest edge to the nominal edge
MAX_EDGE_RATIO = 1.5

# Ratio of the edge along a bend to the length over which the bend turns by one radian
BEND_RATIO = 0.6


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceMesh:
    """Curved triangles over the surfaces of all bodies, on the positive side of mirrors.

    Attributes
    ----------
    vertices : (V, 3) [m].
    triangles : (T, 3) vertex indices, anticlockwise seen from outside the body.
    middles : (T, 3, 3) points of the curved surface at the middles of edges 01, 12, 20 [m], the
        same for both neighbours.
    body : (T,) index of each triangle's obstacle.
    """

    vertices: Float64[np.ndarray, "vertices 3"]
    triangles: Int64[np.ndarray, "triangles 3"]
    middles: Float64[np.ndarray, "triangles 3 3"]
    body: Int64[np.ndarray, "triangles"]

    @property
    def quadratic_triangles(self) -> QuadraticTriangles:
        """(T, 6, 3) the curved triangles as panels [m]."""
        return np.concatenate([self.vertices[self.triangles], self.middles], axis=1)


def surface_mesh(shapes: Sequence[Shape], edge: float, mirrors: Sequence[Mirror]) -> SurfaceMesh:
    """Cover the surfaces of bodies with triangles of a nominal edge [m]; raise if MMG cannot."""
    rough = [shape.coarse_meshes(MAX_EDGE_RATIO * edge) for shape in shapes]
    vertices, triangles, middles, body = [], [], [], []
    count = 0
    for index, shape in enumerate(shapes):
        neighbours = [
            part.vertices
            for neighbour, parts in enumerate(rough)
            for part in parts
            if neighbour != index
        ]
        for part in rough[index]:
            if any((part.vertices[:, mirror.axis] <= mirror.position).all() for mirror in mirrors):
                continue
            points, corners, between = _covered(shape, part, edge, neighbours, mirrors)
            vertices.append(points)
            triangles.append(corners + count)
            middles.append(between)
            body.append(np.full(len(corners), index))
            count += len(points)
    return SurfaceMesh(
        np.concatenate(vertices),
        np.concatenate(triangles),
        np.concatenate(middles),
        np.concatenate(body),
    )


def _covered(
    shape: Shape,
    rough: RidgedMesh,
    edge: float,
    neighbours: Sequence[Real[np.ndarray, "_ 3"]],
    mirrors: Sequence[Mirror],
) -> tuple[
    Float64[np.ndarray, "vertices 3"],
    Int64[np.ndarray, "triangles 3"],
    Float64[np.ndarray, "triangles 3 3"],
]:
    """Vertices, triangles and mid-edge points over one closed piece, cut at the mirrors."""
    for mirror in mirrors:
        rough = _with_cut(rough, mirror)
    largest = MAX_EDGE_RATIO * edge
    bends = bend_sizes(rough.vertices, rough.triangles, rough.ridges, largest / BEND_RATIO)
    sizes = np.minimum(strip_sizes(rough.vertices, rough.ridges, largest), BEND_RATIO * bends)
    if len(neighbours):
        # Triangles that face another body have edges of at most 1.5 gaps, but never tiny ones.
        gap = KDTree(np.concatenate(neighbours)).query(rough.vertices)[0]
        sizes = np.minimum(sizes, np.maximum(1.5 * gap, 0.15 * edge))
    corners = rough.vertices[rough.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(normals, axis=1).sum()
    flat = remeshed(rough, sizes, edge, area / (np.sqrt(3) / 4 * edge**2))
    vertices, middles = _on_the_surface(shape, flat, edge, mirrors)
    positive = np.ones(len(flat.triangles), dtype=bool)
    for mirror in mirrors:
        positive &= vertices[flat.triangles].mean(axis=1)[:, mirror.axis] > mirror.position
    used, triangles = np.unique(flat.triangles[positive], return_inverse=True)
    return vertices[used], triangles.reshape(-1, 3), middles[positive]


def _on_the_surface(
    shape: Shape, flat: RidgedMesh, edge: float, mirrors: Sequence[Mirror]
) -> tuple[Float64[np.ndarray, "vertices 3"], Float64[np.ndarray, "triangles 3 3"]]:
    count = len(flat.vertices)
    ridges = np.sort(flat.ridges, axis=1)
    on_ridge = np.isin(np.arange(count), ridges)
    held = np.zeros((count, len(mirrors)), dtype=bool)
    for column, mirror in enumerate(mirrors):
        # MMG moves the ends of a cut away from the mirror by up to an eighth of an edge.
        off = np.abs(flat.vertices[:, mirror.axis] - mirror.position)
        held[:, column] = (off < 0.12 * edge) & on_ridge
    sharp = ridges[~(held[ridges[:, 0]] & held[ridges[:, 1]]).any(axis=1)]
    on_sharp = np.isin(np.arange(count), sharp)
    vertices = _projected(shape, flat.vertices, on_sharp, held, mirrors)
    ends = np.stack([flat.triangles, np.roll(flat.triangles, -1, axis=1)], axis=2)
    ends = np.sort(ends.reshape(-1, 2), axis=1)
    unique, inverse = np.unique(ends, axis=0, return_inverse=True)
    keys = unique @ [count, 1]
    on_cut = np.isin(keys, ridges @ [count, 1])
    both_held = held[unique[:, 0]] & held[unique[:, 1]] & on_cut[:, None]
    on_sharp = np.isin(keys, sharp @ [count, 1])
    middles = _projected(shape, vertices[unique].mean(axis=1), on_sharp, both_held, mirrors)
    return vertices, middles[inverse.ravel()].reshape(-1, 3, 3)


def _projected(
    shape: Shape,
    points: Points,
    on_sharp: Mask,
    held: Bool[np.ndarray, "points mirrors"],
    mirrors: Sequence[Mirror],
) -> Vectors:
    """Nearest points of the surface, on its sharp edges, or on mirrors, as marked."""
    points = _put_on(points, held, mirrors)
    projected = shape.project(points)
    if on_sharp.any():
        projected[on_sharp] = shape.project_on_sharp_edges(points[on_sharp])
    return _put_on(projected, held, mirrors)


def _put_on(
    points: Points, held: Bool[np.ndarray, "points mirrors"], mirrors: Sequence[Mirror]
) -> Vectors:
    points = np.array(points, dtype=np.float64)
    for column, mirror in enumerate(mirrors):
        points[held[:, column], mirror.axis] = mirror.position
    return points


def _with_cut(mesh: RidgedMesh, mirror: Mirror) -> RidgedMesh:
    """Cut the triangles of a mesh along a plane; MMG preserves the cut as a sharp edge."""
    corners = mesh.vertices[mesh.triangles]
    mean_edge = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).mean()
    vertices = np.array(mesh.vertices)
    side = vertices[:, mirror.axis] - mirror.position
    near = np.abs(side) < 0.2 * mean_edge  # a cut beside a vertex would leave slivers
    vertices[near, mirror.axis] = mirror.position
    side[near] = 0.0
    if side.min() >= 0 or side.max() <= 0:
        return RidgedMesh(vertices, mesh.triangles, mesh.ridges)
    ends = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=2)
    ends = np.sort(ends.reshape(-1, 2), axis=1)
    edges, inverse = np.unique(ends, axis=0, return_inverse=True)
    crossed = side[edges[:, 0]] * side[edges[:, 1]] < 0
    middle = np.full(len(edges), -1)  # vertex at which an edge is cut
    middle[crossed] = len(vertices) + np.arange(crossed.sum())
    start, end = edges[crossed].T
    fraction = (side[start] / (side[start] - side[end]))[:, None]
    added = vertices[start] * (1 - fraction) + vertices[end] * fraction
    added[:, mirror.axis] = mirror.position
    vertices = np.concatenate([vertices, added])
    side = np.concatenate([side, np.zeros(len(added))])
    triangles = _cut_triangles(mesh.triangles, middle[inverse.ravel()].reshape(-1, 3))
    ridges = mesh.ridges
    if len(ridges):
        # Ridges that the plane cuts are split in two.
        keys = np.sort(ridges, axis=1) @ [len(vertices), 1]
        cut = middle[np.searchsorted(edges @ [len(vertices), 1], keys)]
        split = cut >= 0
        halves = [np.stack([ridges[split, end], cut[split]], axis=1) for end in (0, 1)]
        ridges = np.concatenate([ridges[~split], *halves])
    # The new sharp edges are the edges on the plane of the triangles on its positive side.
    positive = side[triangles].sum(axis=1) > 0
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)
    on_plane = (side[ends] == 0).all(axis=2) & positive[:, None]
    return RidgedMesh(vertices, triangles, np.concatenate([ridges, ends[on_plane]]))


def _cut_triangles(
    triangles: Int64[np.ndarray, "triangles 3"], middle: Int64[np.ndarray, "triangles 3"]
) -> Int64[np.ndarray, "pieces 3"]:
    """Triangles cut where their edges 01, 12, 20 have a vertex (-1: none)."""
    count = (middle >= 0).sum(axis=1)
    pieces = [triangles[count == 0]]
    for corner in range(3):
        a, b, c = np.roll(triangles, -corner, axis=1).T
        ab, _, ca = np.roll(middle, -corner, axis=1).T
        two = (ab >= 0) & (ca >= 0)
        pieces += [np.stack(piece, axis=1)[two] for piece in ((a, ab, ca), (ab, b, c), (ab, c, ca))]
        single = (count == 1) & (ab >= 0)
        pieces += [np.stack(piece, axis=1)[single] for piece in ((a, ab, c), (ab, b, c))]
    return np.concatenate(pieces)
