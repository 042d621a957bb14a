"""Curved triangles over the bodies' surfaces that meet corner to corner, as a volume mesh needs them.

Where a mirror plane cuts a body, the triangles follow the cut, and only those on its positive side
are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.acoustics.solvers.arrays import Mask, Points, Vectors
from airtact.acoustics.solvers.fem.meshing.symmetry import Mirror, images
from airtact.geometry.mesh.arrays import QuadraticTriangles
from airtact.geometry.mesh.edge_limits import bend_sizes, strip_sizes
from airtact.geometry.mesh.remeshing import RidgedMesh, remeshed
from airtact.geometry.shape import Shape
from airtact.printing import in_short

LARGEST = 1.5
"""Longest edge over the edge of the equilateral triangles wanted."""

BEND = 0.6
"""Edge along a bend over the one along which it turns by one radian."""

LARGEST_TO_GAP = 1.5
"""Triangles that face another body have edges of at most this many gaps ..."""

LEAST = 0.15
"""... but not below this fraction of the edge wanted."""

SNAP = 0.2
"""Vertices nearer to a mirror plane than this fraction of the starting mesh's edge are put onto it before it is cut."""

ON_PLANE = 0.12
"""Fraction of the edge within which the end of a sharp edge of MMG's lies on a mirror plane."""


@dataclass(frozen=True, eq=False)
class SurfaceMesh:
    """Curved triangles over the surfaces of all bodies, or of those parts that are on the positive side of mirrors.

    Attributes
    ----------
    vertices : (V, 3) [m].
    triangles : (T, 3) vertex indices, anticlockwise seen from outside the body.
    middles : (T, 3, 3) the curved surface over the middles of edges 01, 12, 20 [m], the same for
        both neighbours.
    body : (T,) obstacle of each.
    """

    vertices: Float64[np.ndarray, "vertices 3"]
    triangles: Int64[np.ndarray, "triangles 3"]
    middles: Float64[np.ndarray, "triangles 3 3"]
    body: Int64[np.ndarray, "triangles"]

    __repr__ = in_short

    @property
    def quadratic_triangles(self) -> QuadraticTriangles:
        """(T, 6, 3) the curved triangles as panels [m]."""
        return np.concatenate([self.vertices[self.triangles], self.middles], axis=1)


def surface_mesh(
    shapes: Sequence[Shape],
    edge: float,
    mirrors: Sequence[Mirror],
    refined: Real[np.ndarray, "refined 3"] | None = None,
) -> SurfaceMesh:
    """Cover the surfaces of some bodies; raises ``InvalidInput`` when MMG cannot.

    ``edge`` is that of the equilateral triangle as large as those wanted [m]; near ``refined``
    points [m] triangles are small, as beside another body.
    """
    rough = [shape.coarse_meshes(LARGEST * edge) for shape in shapes]
    vertices, triangles, middles, body, count = [], [], [], [], 0
    for index, shape in enumerate(shapes):
        others = list(images(mirrors, np.empty((0, 3)) if refined is None else refined)) + [
            part.vertices for other, parts in enumerate(rough) if other != index for part in parts
        ]
        for part in rough[index]:
            if any((part.vertices[:, mirror.axis] <= mirror.position).all() for mirror in mirrors):
                continue
            own, corners, between = _covered(shape, part, edge, np.concatenate(others), mirrors)
            vertices.append(own)
            triangles.append(corners + count)
            middles.append(between)
            body.append(np.full(len(corners), index))
            count += len(own)
    return SurfaceMesh(*(np.concatenate(parts) for parts in (vertices, triangles, middles, body)))


def _covered(
    shape: Shape,
    rough: RidgedMesh,
    edge: float,
    others: Real[np.ndarray, "others 3"],
    mirrors: Sequence[Mirror],
) -> tuple[
    Float64[np.ndarray, "vertices 3"],
    Int64[np.ndarray, "triangles 3"],
    Float64[np.ndarray, "triangles 3 3"],
]:
    """Vertices, triangles and mid-edge points over one closed piece, cut at the mirrors."""
    for mirror in mirrors:
        rough = _with_cut(rough, mirror, SNAP * _mean_edge(rough))
    sizes = np.minimum(
        strip_sizes(rough.vertices, rough.ridges, LARGEST * edge),
        BEND * bend_sizes(rough.vertices, rough.triangles, rough.ridges, LARGEST / BEND * edge),
    )
    gap = KDTree(others).query(rough.vertices)[0] if len(others) else np.full(len(sizes), np.inf)
    sizes = np.minimum(sizes, np.maximum(LARGEST_TO_GAP * gap, LEAST * edge))
    corners = rough.vertices[rough.triangles]
    area = (
        0.5
        * np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        ).sum()
    )
    found = remeshed(rough, sizes, edge, area / (np.sqrt(3) / 4 * edge**2))
    vertices, middles = _on_the_surface(shape, found, edge, mirrors)
    triangles, kept = found.triangles, np.ones(len(found.triangles), dtype=bool)
    for mirror in mirrors:
        kept &= vertices[triangles].mean(axis=1)[:, mirror.axis] > mirror.position
    used, triangles = np.unique(triangles[kept], return_inverse=True)
    return vertices[used], triangles.reshape(-1, 3), middles[kept]


def _on_the_surface(
    shape: Shape, flat: RidgedMesh, edge: float, mirrors: Sequence[Mirror]
) -> tuple[Float64[np.ndarray, "vertices 3"], Float64[np.ndarray, "triangles 3 3"]]:
    """Vertices and mid-edge points on the true surface, moved outwards until they enclose its volume."""
    ridges, key = np.sort(flat.ridges, axis=1), len(flat.vertices)
    held = _on_mirrors(flat.vertices, edge, mirrors) & np.isin(np.arange(key), ridges)[:, None]
    sharp = ridges[~(held[ridges[:, 0]] & held[ridges[:, 1]]).any(axis=1)]
    vertices = _projected(shape, flat.vertices, np.isin(np.arange(key), sharp), held, mirrors)
    ends = np.sort(
        np.stack([flat.triangles, np.roll(flat.triangles, -1, axis=1)], axis=2).reshape(-1, 2),
        axis=1,
    )
    unique, inverse = np.unique(ends, axis=0, return_inverse=True)
    cut = np.isin(unique @ [key, 1], ridges @ [key, 1])
    both = held[unique[:, 0]] & held[unique[:, 1]] & cut[:, None]
    middles = _projected(
        shape,
        vertices[unique].mean(axis=1),
        np.isin(unique @ [key, 1], sharp @ [key, 1]),
        both,
        mirrors,
    )
    return vertices, middles[inverse.ravel()].reshape(-1, 3, 3)


def _on_mirrors(
    points: Points, edge: float, mirrors: Sequence[Mirror]
) -> Bool[np.ndarray, "points mirrors"]:
    near = [
        np.abs(points[:, mirror.axis] - mirror.position) < ON_PLANE * edge for mirror in mirrors
    ]
    return np.stack(near, axis=1) if near else np.zeros((len(points), 0), dtype=bool)


def _projected(
    shape: Shape,
    points: Points,
    on_sharp: Mask,
    held: Bool[np.ndarray, "points mirrors"],
    mirrors: Sequence[Mirror],
) -> Vectors:
    """Nearest points of the surface, on its sharp edges and on the mirrors where those are asked for."""
    points = _put_on(points, held, mirrors)
    found = shape.project(points)
    if on_sharp.any():
        found[on_sharp] = shape.project_on_sharp_edges(points[on_sharp])
    return _put_on(found, held, mirrors)


def _put_on(
    points: Points, held: Bool[np.ndarray, "points mirrors"], mirrors: Sequence[Mirror]
) -> Vectors:
    points = np.array(points, dtype=np.float64)
    for column, mirror in enumerate(mirrors):
        points[held[:, column], mirror.axis] = mirror.position
    return points


def _mean_edge(mesh: RidgedMesh) -> float:
    corners = mesh.vertices[mesh.triangles]
    return float(np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).mean())


def _with_cut(mesh: RidgedMesh, mirror: Mirror, snap: float) -> RidgedMesh:
    """Cut the triangles of a mesh along a plane; the cut becomes a sharp edge, which MMG keeps."""
    vertices = np.array(mesh.vertices)
    side = vertices[:, mirror.axis] - mirror.position
    vertices[np.abs(side) < snap, mirror.axis] = mirror.position
    side = np.where(np.abs(side) < snap, 0.0, side)
    triangles, ridges = mesh.triangles, mesh.ridges
    if side.min() >= 0 or side.max() <= 0:
        return RidgedMesh(vertices, triangles, ridges)
    ends = np.sort(
        np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1
    )
    unique, inverse = np.unique(ends, axis=0, return_inverse=True)
    crossed = side[unique[:, 0]] * side[unique[:, 1]] < 0
    number = np.full(len(unique), -1)
    number[crossed] = len(vertices) + np.arange(crossed.sum())
    one, other = unique[crossed].T
    fraction = (side[one] / (side[one] - side[other]))[:, None]
    added = vertices[one] * (1 - fraction) + vertices[other] * fraction
    added[:, mirror.axis] = mirror.position
    vertices, side = np.concatenate([vertices, added]), np.concatenate([side, np.zeros(len(added))])
    pieces = _pieces(triangles, number[inverse.ravel()].reshape(-1, 3))
    split_ridges = _split_ridges(ridges, unique, number, len(vertices))
    return RidgedMesh(
        vertices, pieces, np.concatenate([split_ridges, _edges_between(pieces, side)])
    )


def _pieces(
    triangles: Int64[np.ndarray, "triangles 3"], middle: Int64[np.ndarray, "triangles 3"]
) -> Int64[np.ndarray, "pieces 3"]:
    """Triangles cut where their edges 01, 12, 20 have a vertex (-1: none)."""
    count = (middle >= 0).sum(axis=1)
    found = [triangles[count == 0]]
    for corner in range(3):
        a, b, c = (np.roll(triangles, -corner, axis=1)[:, i] for i in range(3))
        ab, ca = np.roll(middle, -corner, axis=1)[:, [0, 2]].T
        two = (ab >= 0) & (ca >= 0)
        found += [np.stack(piece, axis=1)[two] for piece in ((a, ab, ca), (ab, b, c), (ab, c, ca))]
        one = (count == 1) & (ab >= 0)
        found += [np.stack(piece, axis=1)[one] for piece in ((a, ab, c), (ab, b, c))]
    return np.concatenate(found)


def _split_ridges(
    ridges: Int64[np.ndarray, "ridges 2"],
    edges: Int64[np.ndarray, "edges 2"],
    number: Int64[np.ndarray, "edges"],
    count: int,
) -> Int64[np.ndarray, "pieces 2"]:
    if not len(ridges):
        return ridges
    found = number[np.searchsorted(edges @ [count, 1], np.sort(ridges, axis=1) @ [count, 1])]
    parted = found >= 0
    halves = [np.stack([ridges[parted, end], found[parted]], axis=1) for end in (0, 1)]
    return np.concatenate([ridges[~parted], *halves])


def _edges_between(
    triangles: Int64[np.ndarray, "triangles 3"], side: Float64[np.ndarray, "vertices"]
) -> Int64[np.ndarray, "edges 2"]:
    """Edges whose ends lie on the plane and that part the two sides."""
    sides = np.sign(side[triangles].sum(axis=1))
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)
    on = (side[ends] == 0).all(axis=2) & (sides > 0)[:, None]
    return ends[on]
