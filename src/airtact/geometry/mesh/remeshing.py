"""Remeshing of a closed mesh with sharp edges, using MMG, and limits of its edge lengths.

When larger triangles replace a fine mesh, an upper limit of the edge length applies at each vertex.
Each function finds one kind of detail that large triangles would lose. It returns a limit [m] for
each vertex, at most ``largest``, the edge length used elsewhere:

- ``bend_sizes``: tight bends, across which a large triangle would cut;
- ``tip_sizes``: rounded tips, which bend in both directions;
- ``wall_sizes``: thin walls, whose sides would deviate too far from the true surface or cross each
  other;
- ``strip_sizes``: narrow strips between two sharp edges, in which slivers would form.

A ridge is a sharp edge of the mesh. Remeshing uses the smallest limit at each vertex.

Source: C. Dapogny, C. Dobrzynski, P. Frey, "Three-dimensional adaptive domain remeshing, implicit
domain meshing, and applications to free and moving boundary problems", J. Comput. Phys. 262, 358
(2014).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float64, Int64

from airtact.errors import InvalidInput, extra
from airtact.geometry.mesh.triangles import (
    NODE_REFERENCES,
    EdgeMask,
    FlatMesh,
    QuadraticTriangles,
    Ridges,
    Triangles,
    VertexSizes,
    Vertices,
    are_among,
    area_vectors,
    corner_angles,
    edge_ends,
    edge_lengths,
    edge_twins,
    shape_functions,
    smooth_patches,
    unit,
    with_middles,
)

# Ratio of the shortest edge to the target edge length, except along sharp edges of the shape.
MIN_EDGE = 0.06


@dataclass(frozen=True, eq=False)
class RidgedMesh:
    """A closed mesh, and the vertex indices (K, 2) of the ends of its sharp edges."""

    vertices: Vertices
    triangles: Triangles
    ridges: Ridges


def coarsened(
    mesh: RidgedMesh, edge: float, wall: float = np.inf, fraction: float = 0.25
) -> RidgedMesh:
    """Coarsen a mesh if its edges are on average shorter than ``fraction`` times ``edge`` [m].

    Coarsening removes the roughness of scans, which the remesher MMG would treat as bends. ``wall``
    is the thickness of the thinnest wall [m], which limits the deviation so that the rim of the
    wall remains.
    """
    if edge_lengths(mesh.vertices[mesh.triangles]).mean() > fraction * edge:
        return mesh
    # The roughness of a scan is about 0.06 of the edge length.
    deviation = min(0.06, 0.1 * wall / edge)
    return _mmg(mesh, np.full(len(mesh.vertices), 0.25), edge, deviation)


def remeshed(
    mesh: RidgedMesh, sizes: VertexSizes, edge: float, expected: float, wall: float = np.inf
) -> RidgedMesh:
    """Remesh a closed surface with triangles as large as equilateral ones of edge length ``edge``.

    The vertices of the result are near the curved surface but not on it.

    Parameters
    ----------
    mesh : the surface.
    sizes : (V,) longest edge allowed at each vertex [m].
    edge : edge length of the equilateral triangles [m].
    expected : expected number of triangles.
    wall : thickness of the thinnest wall [m], as in ``coarsened``.
    """
    deviation = min(0.15, 0.3 * wall / edge)
    # MMG generates fewer triangles than expected from the largest edge, so the edge is shortened
    # until 90 % of the expected number is reached.
    for stretch in (1.4, 1.2, 1.0):
        result = _mmg(mesh, np.clip(sizes / edge, MIN_EDGE, stretch), edge, deviation)
        if len(result.triangles) >= 0.9 * expected:
            return result
    return _mmg(mesh, np.clip(sizes / edge, MIN_EDGE, 0.85), edge, deviation)


def _mmg(surface: RidgedMesh, sizes: VertexSizes, edge: float, deviation: float) -> RidgedMesh:
    """Run MMG in units of ``edge``; ``deviation`` is the largest distance from the surface."""
    with extra("mesh", "remeshing a surface needs MMG"):
        import mmgpy

    mesh = mmgpy.MmgMeshS()
    triangles = surface.triangles.astype(np.int32)
    ridges = surface.ridges.astype(np.int32)
    mesh.set_mesh_size(vertices=len(surface.vertices), triangles=len(triangles), edges=len(ridges))
    mesh.set_vertices(np.ascontiguousarray(surface.vertices / edge))
    mesh.set_triangles(triangles)
    if len(ridges):
        mesh.set_edges(ridges)
        mesh.set_ridge_edges(np.arange(len(ridges), dtype=np.int32))
    mesh.set_field("metric", sizes.reshape(-1, 1))
    try:
        mesh.remesh(
            hmax=max(sizes.max(), 1.1 * MIN_EDGE),
            hmin=MIN_EDGE,
            hausd=deviation,
            hgrad=1.5,  # largest ratio between neighbouring edges
            angle=0,  # the sharp edges are known; MMG must not detect others
            verbose=-1,
        )
    except RuntimeError as fault:
        raise InvalidInput(
            f"the surface of {len(triangles)} triangles cannot be remeshed with an edge length "
            f"of {1e3 * edge:.3g} mm ({fault}). Repair it, or use a mesh with fewer slivers.",
            code="mesh_faulty",
        ) from fault
    result = np.asarray(mesh.get_triangles(), dtype=np.int64)
    if len(result) < 4 or edge_twins(result).min() < 0:
        raise InvalidInput(
            f"the surface of {len(triangles)} triangles does not remain closed when it is remeshed "
            f"with an edge length of {1e3 * edge:.3g} mm. Repair it, or use a shorter edge.",
            code="mesh_faulty",
        )
    ridges = np.asarray(mesh.get_edges(), dtype=np.int64).reshape(-1, 2)
    return RidgedMesh(np.array(mesh.get_vertices()) * edge, result, ridges)


def with_short_edges(
    panels: QuadraticTriangles, triangles: Triangles, sharp: EdgeMask, longest: float
) -> RidgedMesh:
    """Halve the edges of a closed mesh of panels until none is longer than ``longest`` [m]."""
    while (long := edge_lengths(panels) > longest).any():
        panels, triangles, sharp = _split_edges(panels, triangles, sharp, long)
    vertices = _vertices(panels, triangles)
    ridges = edge_ends(triangles)[sharp]
    return RidgedMesh(vertices, triangles, ridges[ridges[:, 0] < ridges[:, 1]])


def near_surface(panels: QuadraticTriangles, triangles: Triangles, away: float) -> FlatMesh:
    """Return flat triangles at most ``away`` [m] from the curved panels of a closed mesh."""
    sharp = np.zeros(triangles.shape, dtype=bool)
    while True:
        straight = with_middles(panels[:, :3])
        rise = np.linalg.norm(panels[:, 3:] - straight[:, 3:], axis=2)
        # The middle of a triangle rises by up to 4/3 of the rise of its edges.
        split = rise > 0.75 * away
        split |= split.ravel()[edge_twins(triangles)]
        if not split.any():
            return _vertices(panels, triangles), triangles
        panels, triangles, sharp = _split_edges(panels, triangles, sharp, split)


def _vertices(panels: QuadraticTriangles, triangles: Triangles) -> Vertices:
    vertices = np.empty((int(triangles.max()) + 1, 3))
    vertices[triangles] = panels[:, :3]
    return vertices


def _split_edges(
    panels: QuadraticTriangles, triangles: Triangles, sharp: EdgeMask, split: EdgeMask
) -> tuple[
    Float64[np.ndarray, "pieces 6 3"], Int64[np.ndarray, "pieces 3"], Bool[np.ndarray, "pieces 3"]
]:
    """Halve some edges; return the panels, vertex indices and sharp edges of the pieces."""
    directed = np.arange(3 * len(triangles)).reshape(-1, 3)
    edge = np.minimum(directed, edge_twins(triangles))  # the same for both triangles
    middle = int(triangles.max()) + 1 + np.searchsorted(np.unique(edge[split]), edge)
    vertices = np.concatenate([triangles, middle], axis=1)
    # A fourth column for edges inside a triangle, which are never sharp.
    sharp = np.concatenate([sharp, np.zeros((len(sharp), 1), dtype=bool)], axis=1)
    nodes_on_edges = ({0, 1, 3}, {1, 2, 4}, {2, 0, 5})
    new_panels = []
    new_triangles = []
    new_sharp = []
    for pattern, pieces in _split_pieces().items():
        chosen = np.flatnonzero(split @ [1, 2, 4] == pattern)
        for nodes in pieces:
            parent_edges = []
            for start, end in ((0, 1), (1, 2), (2, 0)):
                ends = {nodes[start], nodes[end]}
                on = [number for number in range(3) if ends <= nodes_on_edges[number]]
                parent_edges.append(on[0] if on else 3)
            shape = shape_functions(with_middles(NODE_REFERENCES[nodes][None])[0])
            new_panels.append(shape @ panels[chosen])
            new_triangles.append(vertices[chosen][:, nodes])
            new_sharp.append(sharp[chosen][:, parent_edges])
    return np.concatenate(new_panels), np.concatenate(new_triangles), np.concatenate(new_sharp)


@cache
def _split_pieces() -> dict[int, list[list[int]]]:
    """Return the nodes of a triangle's pieces for each set of split edges (bits 01, 12, 20)."""
    result = {0: [[0, 1, 2]]}
    two_split = [[0, 3, 2], [3, 1, 4], [3, 4, 2]]
    for pattern, pieces in ((1, [[0, 3, 2], [3, 1, 2]]), (3, two_split)):
        for turn in range(3):
            turned = (pattern << turn | pattern >> (3 - turn)) & 7
            result[turned] = [
                [node // 3 * 3 + (node + turn) % 3 for node in piece] for piece in pieces
            ]
    result[7] = [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]
    return result


# Ratio of the longest edge on a thin wall to the wall's thickness.
MAX_EDGE_TO_WALL = 3.0


def bend_sizes(
    vertices: Vertices, triangles: Triangles, ridges: Ridges, largest: float, factor: float = 1.0
) -> VertexSizes:
    """Return, at each vertex, the edge length [m] over which the surface normal turns by 1 rad.

    The radius of a bend is estimated from pairs of triangles whose normals differ by 75 to 150
    degrees and that lie on a common arc. Pairs across a sharp edge (``ridges``) are ignored. The
    result is ``factor`` times the radius of the bend and at most ``largest``. ``factor`` is below 1
    if panels must be closer to the surface.
    """
    from scipy.spatial import KDTree  # importing it takes 0.2 s

    corners = vertices[triangles]
    centres = corners.mean(axis=1)
    normals = unit(area_vectors(corners))
    patch = smooth_patches(edge_twins(triangles), are_among(edge_ends(triangles), ridges))

    # MMG itself refines wide bends, so only bends with a radius below largest / (1.4 factor) limit
    # the edges. The search radius is the chord of 75 degrees on the widest of these bends.
    reach = 2 * np.sin(np.radians(75.0) / 2) / (factor * 1.4) * largest
    tree = KDTree(centres)
    neighbours = tree.query_ball_point(centres, reach, return_length=True)
    # Pairs are sought for some of the triangles at a time, because a printed part with many holes
    # has a thousand million pairs.
    part = np.cumsum(neighbours) // 10_000_000
    pairs = []
    for number in range(part[-1] + 1):
        own = np.flatnonzero(part == number)
        near = KDTree(centres[own]).sparse_distance_matrix(tree, reach, output_type="ndarray")
        first = own[near["i"]]
        second = near["j"]
        # Below 75 degrees the pair may be a kink between two flat parts. Above 150 degrees it is
        # more likely the other side of a wall.
        cosine = np.einsum("pd,pd->p", normals[first], normals[second])
        cos_75, cos_150 = np.cos(np.radians([75.0, 150.0]))
        bent = (first < second) & (cosine < cos_75) & (cosine > cos_150)
        bent &= patch[first] == patch[second]
        pairs.append(np.stack([first[bent], second[bent]]))
    first, second = np.concatenate(pairs, axis=1)
    cosine = np.einsum("pd,pd->p", normals[first], normals[second])
    chord = centres[second] - centres[first]
    length = np.linalg.norm(chord, axis=1)

    # On a common arc of angle a and radius R, the chord has length 2 R sin(a/2). The unit chord has
    # the components −sin(a/2) and +sin(a/2) along the two normals. Pairs whose components deviate
    # by more than 0.35 are not on a common arc.
    half_sine = np.sqrt(0.5 * (1 - cosine))
    at_first = np.einsum("pd,pd->p", chord, normals[first]) / length
    at_second = np.einsum("pd,pd->p", chord, normals[second]) / length
    symmetric = np.abs(at_first + at_second) < 0.35
    on_arc = symmetric & (np.abs(np.abs(at_first - at_second) / 2 - half_sine) < 0.35)
    radius = length[on_arc] / (2 * half_sine[on_arc])

    limit = factor * radius
    triangle_limits = np.full(len(triangles), largest)
    np.minimum.at(triangle_limits, first[on_arc], limit)
    np.minimum.at(triangle_limits, second[on_arc], limit)
    sizes = np.full(len(vertices), largest)
    np.minimum.at(sizes, triangles, triangle_limits[:, None])
    return sizes


def tip_sizes(
    vertices: Vertices, triangles: Triangles, ridges: Ridges, largest: float, turn: float
) -> VertexSizes:
    """Return, at each vertex, the edge length [m] over which a tip's normal turns by ``turn``.

    The radius of a tip follows from its Gaussian curvature: the sum of the angle defects
    (2π − Σ angles) of its vertices, divided by its area. Coarse triangles preserve the sum of the
    defects (Gauss-Bonnet), and the roughness of a scan cancels in this sum. Bends in one direction,
    such as creases, have no angle defects. Defects at sharp edges (``ridges``) are ignored.
    ``turn`` is in radians.
    """
    defect, area = _angle_defects(vertices, triangles, ridges)
    count = len(vertices)
    start = triangles.ravel()
    end = np.roll(triangles, -1, axis=1).ravel()
    # The mean over a vertex and its neighbours is smoother than the value at the vertex.
    defect += np.bincount(start, defect[end], count)
    area += np.bincount(start, area[end], count)
    return np.minimum(largest, turn * np.sqrt(area / np.maximum(defect, 1e-9)))


def round_size(vertices: Vertices, triangles: Triangles, ridges: Ridges, turn: float) -> float:
    """Return the edge length [m] over which the normal of a sphere turns by ``turn``.

    The sphere has the body's mean Gaussian curvature: the sum of the angle defects divided by the
    area, both away from sharp edges (``ridges``). The result is infinite for bodies with flat
    faces. ``turn`` is in radians.
    """
    defect, area = _angle_defects(vertices, triangles, ridges)
    total_defect = float(defect.sum())
    if total_defect < 1e-3:
        return np.inf
    # The walls of a bore do not count; in a box with rounded corners the flat faces do.
    round_area = area[np.abs(defect) > 1e-5].sum()
    total_area = area.sum()
    counted = round_area if round_area > 0.5 * total_area else total_area
    return turn * float(np.sqrt(counted / total_defect))


def is_smooth(vertices: Vertices, triangles: Triangles, ridges: Ridges) -> bool:
    """Return whether the angle defects at vertices suggest a smooth body rather than a scan."""
    defect, _ = _angle_defects(vertices, triangles, ridges)
    # Roughness has defects of both signs.
    return float(np.abs(defect).sum()) < 3 * 4 * np.pi


def _angle_defects(
    vertices: Vertices, triangles: Triangles, ridges: Ridges
) -> tuple[VertexSizes, VertexSizes]:
    """Return each vertex's angle defect 2π − Σ angles (0 on ridges) and its share of the area."""
    corners = vertices[triangles]
    along = unit(np.roll(corners, -1, axis=1) - corners)
    start = triangles.ravel()
    defect = 2 * np.pi - np.bincount(start, corner_angles(along).ravel(), len(vertices))
    defect[ridges] = 0.0
    thirds = np.linalg.norm(area_vectors(corners), axis=1) / 6
    return defect, np.bincount(start, np.repeat(thirds, 3), len(vertices))


def wall_sizes(vertices: Vertices, triangles: Triangles, largest: float) -> VertexSizes:
    """Return the longest edge [m] allowed at each vertex: three times the wall thickness."""
    from scipy.spatial import KDTree  # importing it takes 0.2 s

    normals = np.zeros((len(vertices), 3))
    np.add.at(normals, triangles, area_vectors(vertices[triangles])[:, None])
    normals = unit(normals)
    # The other side of a wall is near and has the opposite normal. The tree therefore contains
    # positions and scaled normals, and the queries have reversed normals. ``reach`` is both the
    # largest distance and the length of the normals, so sides may be 60 degrees from parallel.
    reach = 0.6 * largest
    tree = KDTree(np.concatenate([vertices, reach * normals], axis=1))
    queries = np.concatenate([vertices, -reach * normals], axis=1)
    distance, opposite = tree.query(queries, distance_upper_bound=reach)
    met = np.flatnonzero(distance < reach)
    across = vertices[met] - vertices[np.asarray(opposite)[met]]
    thickness = np.einsum("nd,nd->n", across, normals[met])
    # Negative values are gaps of air between two parts of the body. Sides over 30 degrees from
    # parallel are a wedge, such as around the mouth of a bore.
    cosine = np.einsum("nd,nd->n", normals[met], normals[np.asarray(opposite)[met]])
    solid = (thickness > 0.0) & (cosine < -np.cos(np.radians(30.0)))
    sizes = np.full(len(vertices), largest)
    sizes[met[solid]] = np.minimum(largest, MAX_EDGE_TO_WALL * thickness[solid])
    return sizes


def strip_sizes(vertices: Vertices, ridges: Ridges, largest: float) -> VertexSizes:
    """Return the longest edge [m] allowed at each vertex on narrow strips between sharp edges.

    The limit is twice the distance to the nearest other sharp edge, and ``largest`` at vertices
    that are not on sharp edges. Near a corner the limit is smaller, because the other edge of the
    corner is close.
    """
    width = np.full(len(vertices), largest / 2.0)
    if not len(ridges):
        return 2.0 * width
    from scipy.spatial import KDTree  # importing it takes 0.2 s

    # Distances to other ridges are measured at eight points on each ridge.
    steps = 8
    ends = vertices[ridges]
    fractions = np.arange(steps) / steps
    samples = (ends[:, :1] + fractions[:, None] * (ends[:, 1:] - ends[:, :1])).reshape(-1, 3)
    tree = KDTree(samples)
    for start, end in (ridges.T, ridges.T[::-1]):
        along = unit(vertices[end] - vertices[start])
        near = KDTree(vertices[start]).sparse_distance_matrix(
            tree, largest / 2.0, output_type="ndarray"
        )
        row = near["i"]
        sample = near["j"]
        gap = samples[sample] - vertices[start][row]
        distance = near["v"]
        # A sample bounds a strip if it lies sideways, more than 60 degrees off the ridge, and on a
        # ridge that does not share this vertex.
        sideways = np.abs(np.einsum("pd,pd->p", gap, along[row])) < 0.5 * distance
        separate = (ridges[sample // steps] != start[row][:, None]).all(axis=1) & sideways
        np.minimum.at(width, start[row[separate]], distance[separate])
    return 2.0 * width
