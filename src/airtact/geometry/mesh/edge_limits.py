"""Upper limits of the edge length at each vertex when larger triangles replace a fine mesh.

Each function finds one kind of detail that large triangles would lose. It returns a limit [m] for
each vertex, at most ``largest``, the edge length used elsewhere:

- ``bend_sizes``: tight bends, across which a large triangle would cut;
- ``tip_sizes``: rounded tips, which bend in both directions;
- ``wall_sizes``: thin walls, whose sides would deviate too far from the true surface or cross each
  other;
- ``strip_sizes``: narrow strips between two sharp edges, in which slivers would form.

A ridge is a sharp edge of the mesh. Remeshing uses the smallest limit at each vertex.
"""

import numpy as np
from scipy.spatial import KDTree

from airtact.geometry.mesh.arrays import Ridges, Triangles, VertexSizes, Vertices
from airtact.geometry.mesh.quadratic_triangles import area_vectors, corner_angles, unit
from airtact.geometry.mesh.topology import are_among, edge_ends, edge_twins, smooth_patches

# Ratio of the longest edge on a thin wall to the wall's thickness.
MAX_EDGE_TO_WALL = 3.0


def bend_sizes(
    vertices: Vertices, triangles: Triangles, ridges: Ridges, largest: float, factor: float = 1.0
) -> VertexSizes:
    """Return, at each vertex, the edge length [m] over which the surface turns by 1 rad.

    The radius of a bend is estimated from pairs of triangles whose normals differ by 75 to 150
    degrees and that lie on a common arc. Pairs across a sharp edge (``ridges``) are ignored.
    ``factor`` scales the limits. It is below 1 if panels must be closer to the surface.
    """
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
    """Return, at each vertex, the edge length [m] over which a rounded tip turns by ``turn``.

    The radius of a tip follows from its Gaussian curvature: the sum of the angle defects 2π − Σ
    angles of its vertices, divided by its area. Coarse triangles preserve the sum of the defects
    (Gauss-Bonnet), and the roughness of a scan cancels in this sum. Bends in one direction, such as
    creases, have no angle defects. Defects at sharp edges (``ridges``) are ignored. ``turn`` is in
    radians.
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
    """Return the edge length [m] over which a sphere as curved as the body turns by ``turn``.

    The sphere has the body's mean Gaussian curvature: the sum of the angle defects away from sharp
    edges (``ridges``), divided by the area there. The result is infinite for bodies of flat faces.
    ``turn`` is in radians.
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
    """Return whether the angle defects at vertices are those of a smooth body, not of a scan."""
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
    """Return the longest edge [m] allowed at each vertex: twice the distance to the next ridge.

    Vertices that are not on sharp edges get ``largest``. Near a corner the limit is smaller,
    because the other edge of the corner is close.
    """
    width = np.full(len(vertices), largest / 2.0)
    if not len(ridges):
        return 2.0 * width
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
