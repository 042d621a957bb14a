"""How small panels must be where the surface bends tightly or runs in a narrow strip."""

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from airtact.geometry.mesh.mesh_distance import pairs_near
from airtact.geometry.mesh.quadratic_triangles import area_vectors, unit
from airtact.geometry.mesh.topology import (
    Triangles,
    Vertices,
    are_among,
    edge_ends,
    edge_twins,
    smooth_patches,
)

Ridges = Int64[np.ndarray, "ridges 2"]
"""(K, 2) ends of the sharp edges."""

TIGHT_TURN, WIDE_TURN = 1.0, 1.4
"""Angles that tight and wide bends may turn by along an edge [rad]: MMG's own tolerance sees wide ones too."""

WIDE = 0.3
"""Radius of a wide bend over the largest size."""

LEAST, MOST = np.cos(np.radians([75.0, 150.0]))
"""Cosines of the angles between triangles that show how the surface bends: less may be a kink, more another side."""

AWRY = 0.35
"""How far the line between two triangles may lie off the chord of an arc that is tangent to both, as a sine."""

STRIP = 2.0
"""Longest edge beside a narrow strip between two sharp edges, over its width."""

WALL = 3.0
"""Longest edge on a thin wall, over its thickness."""

OPPOSITE = 0.6
"""Distance, over the largest size, within which the other side of a wall is looked for."""

PIECES = 8
"""Pieces of a sharp edge between which the nearest other one is looked for."""


def bend_sizes(
    vertices: Vertices, triangles: Triangles, ridges: Ridges, largest: float, share: float = 1.0
) -> Float64[np.ndarray, "vertices"]:
    """Longest edge at each vertex of a closed mesh along which the surface turns by one radian or little more.

    ``share`` of that is taken where panels must lie nearer to the surface.

    Two triangles on the same side of all sharp edges, less than ``largest`` apart, that look in
    directions at least 75 degrees apart, and lie as if on one arc, show the radius of that arc.
    ``largest`` [m] is the largest size returned.
    """
    corners = vertices[triangles]
    centres = corners.mean(axis=1)
    normals = unit(area_vectors(corners))
    patch = smooth_patches(edge_twins(triangles), are_among(edge_ends(triangles), ridges))
    size = np.full(len(triangles), largest)
    # over this chord an arc turns by 75 degrees whose radius asks for the largest size
    reach = 2 * np.sin(np.radians(75.0) / 2) / (share * WIDE_TURN) * largest
    one, other = KDTree(centres).query_pairs(reach, output_type="ndarray").T
    cosine = np.einsum("pd,pd->p", normals[one], normals[other])
    bent = (cosine < LEAST) & (cosine > MOST) & (patch[one] == patch[other])
    one, other, cosine = one[bent], other[bent], cosine[bent]
    chord = centres[other] - centres[one]
    distance = np.linalg.norm(chord, axis=1)
    half = np.sqrt(0.5 * (1 - cosine))  # sine of half the angle
    here, there = (np.einsum("pd,pd->p", chord, normals[end]) / distance for end in (one, other))
    arc = (np.abs(here + there) < AWRY) & (np.abs(np.abs(here - there) / 2 - half) < AWRY)
    radius = distance[arc] / (2 * half[arc])
    turn = TIGHT_TURN + (WIDE_TURN - TIGHT_TURN) * np.minimum(1.0, radius / (WIDE * largest))
    fitting = share * radius * turn
    np.minimum.at(size, one[arc], fitting)
    np.minimum.at(size, other[arc], fitting)
    sizes = np.full(len(vertices), largest)
    np.minimum.at(sizes, triangles, size[:, None])
    return sizes


def wall_sizes(
    vertices: Vertices, triangles: Triangles, largest: float
) -> Float64[np.ndarray, "vertices"]:
    """Longest edge, at most ``largest``, at each vertex of a closed mesh that suits a thin wall there [m].

    Coarser panels of both sides would deviate by much of the thickness, or cross each other.
    Vertices are neighbours if they are near to each other and look in opposite directions, so the
    tree holds normals too.
    """
    area = area_vectors(vertices[triangles])
    normals = np.zeros((len(vertices), 3))
    np.add.at(normals, triangles, area[:, None])
    normals = unit(normals)
    reach = OPPOSITE * largest
    tree = KDTree(np.concatenate([vertices, reach * normals], axis=1))
    sought = np.concatenate([vertices, -reach * normals], axis=1)
    distance, other = tree.query(sought, distance_upper_bound=reach)
    met = np.flatnonzero(distance < reach)
    depth = np.einsum("nd,nd->n", vertices[met] - vertices[np.asarray(other)[met]], normals[met])
    size = np.full(len(vertices), largest)
    inside = depth > 0.0
    size[met[inside]] = np.minimum(largest, WALL * depth[inside])
    return size


def strip_sizes(
    vertices: Vertices, ridges: Ridges, largest: float
) -> Float64[np.ndarray, "vertices"]:
    """Longest edge, at most ``largest``, at each vertex that suits the narrow strip to the next sharp edge [m]."""
    width = np.full(len(vertices), largest / STRIP)
    if not len(ridges):
        return STRIP * width
    ends = vertices[ridges]
    share = np.arange(PIECES) / PIECES
    samples = (ends[:, :1] + share[:, None] * (ends[:, 1:] - ends[:, :1])).reshape(-1, 3)
    tree = KDTree(samples)
    for start, finish in (ridges.T, ridges.T[::-1]):
        along = unit(vertices[finish] - vertices[start])
        row, sample = pairs_near(tree, vertices[start], largest / STRIP)
        gap = samples[sample] - vertices[start][row]
        distance = np.linalg.norm(gap, axis=1)
        across = np.abs(np.einsum("pd,pd->p", gap, along[row])) < 0.5 * distance
        foreign = (ridges[sample // PIECES] != start[row][:, None]).all(axis=1) & across
        np.minimum.at(width, start[row[foreign]], distance[foreign])
    return STRIP * width
