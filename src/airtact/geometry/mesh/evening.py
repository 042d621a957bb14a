"""Evening of a remeshed surface: triangles as large as the panels need, and no smaller.

MMG shortens edges at every kink between the flat triangles of a coarse mesh, so the fingers of a
hand get three times as many triangles as their curvature requires. Evening splits long edges,
collapses short ones, flips diagonals and moves vertices within the surface.

Sources: M. Botsch, L. Kobbelt, "A remeshing approach to multiresolution modeling", Symposium on
Geometry Processing 2004; S. Rusinkiewicz, "Estimating curvatures and their derivatives on triangle
meshes", 3DPVT 2004.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float64

from airtact import _kernels
from airtact.geometry.mesh.curving import corner_normals, sectors
from airtact.geometry.mesh.remeshing import RidgedMesh
from airtact.geometry.mesh.triangles import (
    FlatMesh,
    Points,
    PointVectors,
    Triangles,
    VertexSizes,
    Vertices,
    are_among,
    area_vectors,
    corner_angles,
    edge_ends,
    edge_twins,
    unit,
)


def even_pass(
    vertices: Vertices,
    sizes: VertexSizes,
    triangles: Triangles,
    pull: float,
    smallest_angle: float = 0.0,
    keep: bool = False,
) -> tuple[FlatMesh, Float64[np.ndarray, "_"]]:
    """Make triangles more even in one pass; return the mesh and the target edge lengths.

    Parameters
    ----------
    vertices, triangles : the mesh. Edges on the border of an open mesh are kept.
    sizes : (V,) target edge length at each vertex [m].
    pull : distance by which a vertex is moved toward the centre of its neighbours, as a fraction of
        its distance from this centre.
    smallest_angle : triangles with a smaller angle are collapsed [degrees].
    keep : whether the triangles stay the same and only the vertices move.
    """
    count = len(vertices)
    room = 2 * count + 1000
    places = np.empty((room, 3))
    places[:count] = vertices
    lengths = np.empty(room)
    lengths[:count] = sizes
    corners = np.empty((2 * room, 3), dtype=np.int64)
    corners[: len(triangles)] = triangles
    counts = np.array([count, len(triangles)], dtype=np.int64)
    cosine = float(np.cos(np.radians(smallest_angle)))
    _kernels.even_pass(places, lengths, corners, counts, keep, cosine, pull)
    mesh = (places[: counts[0]].copy(), corners[: counts[1]].copy())
    return mesh, lengths[: counts[0]]


def evened(
    mesh: RidgedMesh,
    sizes_at: Callable[[Points], VertexSizes],
    project: Callable[[Points], PointVectors],
) -> RidgedMesh:
    """Make the triangles of a closed mesh as large as the target sizes; ridges stay as they are.

    If two ridges merge or a triangle has an angle below 10 degrees, the mesh is returned unchanged.

    Parameters
    ----------
    mesh : the surface.
    sizes_at : function that returns the target edge length [m] at points.
    project : function that moves points onto the surface.
    """
    # The mesh is cut open along its ridges, because a pass keeps the edges of a border. The
    # vertices of ridges come first. A pass may move them but keeps their order.
    sharp = are_among(edge_ends(mesh.triangles), mesh.ridges)
    _, first, corner = np.unique(
        sectors(mesh.triangles, edge_twins(mesh.triangles), sharp),
        return_index=True,
        return_inverse=True,
    )
    origin = mesh.triangles.ravel()[first]
    on_ridge = np.isin(origin, mesh.ridges)
    order = np.argsort(~on_ridge, kind="stable")
    origin = origin[order]
    fixed = int(on_ridge.sum())
    triangles = np.argsort(order)[corner].reshape(-1, 3)
    vertices = mesh.vertices[origin]
    on_border = np.count_nonzero(edge_twins(triangles) < 0)
    passes = 5
    for number in range(passes + 1):
        (vertices, triangles), _ = even_pass(
            vertices,
            sizes_at(vertices),
            triangles,
            pull=0.6,
            smallest_angle=20.0 if number > 1 else 0.0,
            keep=number == passes,
        )
        vertices[:fixed] = mesh.vertices[origin[:fixed]]
        vertices[fixed:] = project(vertices[fixed:])
    corners = vertices[triangles]
    angles = corner_angles(unit(np.roll(corners, -1, axis=1) - corners))
    merged = np.count_nonzero(edge_twins(triangles) < 0) != on_border
    if merged or angles.min() < np.radians(10.0):
        return mesh
    ridge_vertices, joined = np.unique(origin[:fixed], return_inverse=True)
    free = np.arange(len(vertices) - fixed) + len(ridge_vertices)
    together = np.concatenate([joined, free])
    closed = np.empty((len(ridge_vertices) + len(free), 3))
    closed[together] = vertices
    triangles = together[triangles]
    # A single ridge edge between smooth parts is no border and may be lost.
    ridges = np.searchsorted(ridge_vertices, mesh.ridges)
    remaining = are_among(ridges, edge_ends(triangles).reshape(-1, 2))
    return RidgedMesh(closed, triangles, ridges[remaining])


def turn_sizes(mesh: RidgedMesh, largest: float, reach: float, turn: float) -> VertexSizes:
    """Return, at each vertex, the edge length [m] over which the normal turns by ``turn`` [rad].

    The curvature of a triangle is the largest change of the vertex normals per unit length. It is
    averaged within ``reach`` [m] to smooth out the kinks of a coarse mesh. The result is at most
    ``largest`` [m].
    """
    from scipy.spatial import KDTree  # importing it takes 0.2 s

    corners = mesh.vertices[mesh.triangles]
    along = np.roll(corners, -1, axis=1) - corners
    vectors = area_vectors(corners)
    flat = unit(vectors)
    sharp = are_among(edge_ends(mesh.triangles), mesh.ridges)
    normals = corner_normals(unit(along), flat, mesh.triangles, edge_twins(mesh.triangles), sharp)
    turned = np.roll(normals, -1, axis=1) - normals
    # Least squares over the three edges of each triangle, in its plane.
    first = unit(along[:, 0])
    axes = np.stack([first, np.cross(flat, first)], axis=2)
    change = np.linalg.pinv(along @ axes) @ (turned @ axes)
    curvature = np.linalg.norm(change, ord=2, axis=(1, 2))
    tree = KDTree(corners.mean(axis=1))
    near = tree.sparse_distance_matrix(tree, reach, output_type="ndarray")
    row = near["i"]
    column = near["j"]
    same_side = np.einsum("pd,pd->p", flat[row], flat[column]) > 0.5
    weight = np.linalg.norm(vectors, axis=1)[column] * same_side
    mean = np.bincount(row, weight * curvature[column]) / np.bincount(row, weight)
    at_vertices = np.full(len(mesh.vertices), turn / largest)
    np.maximum.at(at_vertices, mesh.triangles, mean[:, None])
    return turn / at_vertices
