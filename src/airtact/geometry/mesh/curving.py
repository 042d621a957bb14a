"""Curves triangles from their normals: where the true surface passes over the middles of their edges.

Every edge gets a tangent at either end. On a smooth surface it is the edge laid into the tangent
plane, whose normal is the mean of the triangles round that corner up to the next sharp edges,
weighted by their angles; along a sharp edge that runs on smoothly it is its own direction. The
middle of the edge then moves as it does on a circular arc with these tangents, so spheres and
cylinders come out exactly round, flat faces stay flat and sharp edges sharp.

Source of the weights: G. Thürmer, C. A. Wüthrich, "Computing vertex normals from polygonal facets",
Journal of Graphics Tools 3, 43 (1998).
"""

import numpy as np
from jaxtyping import Bool, Float64, Int64

from airtact.geometry.mesh.quadratic_triangles import (
    NODE_PLACES,
    QuadraticTriangles,
    area_vectors,
    corner_angles,
    longest_edges,
    normals_at,
    unit,
)
from airtact.geometry.mesh.topology import (
    Triangles,
    Twins,
    Vertices,
    components,
    edge_twins,
    smooth_patches,
)

Vectors = Float64[np.ndarray, "triangles 3 3"]
"""(T, 3, 3) a vector of each corner or edge of the triangles."""
Normals = Float64[np.ndarray, "triangles 3"]
"""(T, 3) normals of the flat triangles."""
Edges = Bool[np.ndarray, "triangles 3"]
"""(T, 3) whether edges 01, 12, 20 are of some kind."""

SHARP_DEGREES = 75.0
"""Edges whose two triangles turn by more than this stay sharp."""

CAP_RIM = 40.0
"""Angle at the rim of a cap, and largest angle of its triangles to their mean [degrees]."""

CAP_TRIANGLES = 6
"""Fewest triangles of a cap: fewer are a facet of a coarse round body."""

STEEPEST = np.cos(np.radians(60.0))
"""Cosine of the largest angle between an edge and its tangents that still curves it."""


def curved(vertices: Vertices, triangles: Triangles, sharp_degrees: float) -> tuple[Vectors, Edges]:
    """Find the points of the curved surface over the middles of a closed mesh's edges [m], and which edges are sharp.

    A cap closes a body that was cut off, a hand at the wrist: triangles that look much the same way
    and have all their vertices on the rim, where the surface turns by more than ``CAP_RIM``
    degrees. Caps stay flat and their rims sharp.
    """
    corners = vertices[triangles]
    twins = edge_twins(triangles)
    flat = unit(area_vectors(corners))
    turn = np.einsum("td,ted->te", flat, flat[twins // 3])
    bent = turn < np.cos(np.radians(min(CAP_RIM, sharp_degrees)))
    cap, rim = _caps(corners, triangles, twins, flat, bent)
    sharp = rim | (turn < np.cos(np.radians(sharp_degrees)))
    rise = _rises(corners, triangles, twins, flat, sharp)
    rise[cap[:, None] & ~sharp] = 0.0
    straight = 0.5 * (corners + np.roll(corners, -1, axis=1))
    straight, rise = (
        0.5 * (part + part.reshape(-1, 3)[twins]) for part in (straight, rise)
    )  # alike from both sides
    for _ in range(8):
        folded = _is_folded(np.concatenate([corners, straight + rise], axis=1), flat)
        if not folded.any():
            break
        rise[folded[:, None] | folded[twins // 3]] *= 0.5
    return straight + rise, sharp


def _rises(
    corners: Vectors, triangles: Triangles, twins: Twins, flat: Normals, sharp: Edges
) -> Vectors:
    """How far the middle of each edge moves when it becomes an arc with its tangents [m]."""
    along = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(along, axis=2, keepdims=True)
    along = along / length
    normals = _corner_normals(along, flat, triangles, twins, sharp)
    start, end = _laid(along, normals), _laid(along, np.roll(normals, -1, axis=1))
    if sharp.any():
        leaving, arriving = _ridge_tangents(along, triangles, sharp)
        start[sharp], end[sharp] = leaving[sharp], arriving[sharp]
    return length / 4 * (_half_tangent(start, along) - _half_tangent(end, along))


def _is_folded(
    quadratic_triangles: QuadraticTriangles, flat: Normals
) -> Bool[np.ndarray, "triangles"]:
    """Whether a curved panel turns by more than 60 degrees from its flat triangle at any of its nodes."""
    corners = quadratic_triangles[:, :3]
    rise = np.abs(quadratic_triangles[:, 3:] - 0.5 * (corners + np.roll(corners, -1, axis=1))).max(
        axis=(1, 2)
    )
    twice_area = np.linalg.norm(area_vectors(corners), axis=1)
    folded = (
        rise * longest_edges(quadratic_triangles) > 0.05 * twice_area
    )  # far from it are those that rise little
    some = quadratic_triangles[folded]
    steep = np.zeros(len(some), dtype=bool)
    for node in NODE_PLACES:
        normal = normals_at(some, node)
        steep |= np.einsum("td,td->t", normal, flat[folded]) < 0.5 * np.linalg.norm(normal, axis=1)
    folded[folded] = steep
    return folded


def _caps(
    corners: Vectors, triangles: Triangles, twins: Twins, flat: Normals, bent: Edges
) -> tuple[Bool[np.ndarray, "triangles"], Edges]:
    """Find the triangles of caps and the edges of their rims, among the patches that bent edges part."""
    if not bent.any():
        return np.zeros(len(triangles), dtype=bool), bent
    patch = smooth_patches(twins, bent)
    area = np.linalg.norm(area_vectors(corners), axis=1)
    mean = np.stack([np.bincount(patch, weights=area * flat[:, axis]) for axis in range(3)], axis=1)
    evenness = np.ones(len(mean))
    np.minimum.at(evenness, patch, np.einsum("td,td->t", unit(mean)[patch], flat))
    lowest, highest = (
        np.full(int(triangles.max()) + 1, len(mean)),
        np.full(int(triangles.max()) + 1, -1),
    )
    np.minimum.at(lowest, triangles, patch[:, None])
    np.maximum.at(highest, triangles, patch[:, None])
    within = np.bincount(
        lowest[lowest == highest], minlength=len(mean)
    )  # vertices of no other patch
    even = evenness > np.cos(np.radians(CAP_RIM))
    cap = ((np.bincount(patch) >= CAP_TRIANGLES) & even & (within == 0))[patch]
    outer = patch[twins // 3] != patch[:, None]
    return cap, outer & (cap[:, None] | cap[twins // 3])


def _laid(along: Vectors, normals: Vectors) -> Vectors:
    """Lay unit edges into the tangent planes."""
    return unit(along - np.einsum("tei,tei->te", along, normals)[:, :, None] * normals)


def _half_tangent(tangent: Vectors, along: Vectors) -> Vectors:
    """Tangent of half the angle between a tangent and its edge, towards where the tangent leaves it; zero if steep."""
    cosine = np.einsum("tei,tei->te", tangent, along)[:, :, None]
    return np.where(
        cosine > STEEPEST, (tangent - cosine * along) / (1 + np.maximum(cosine, 0)), 0.0
    )


def _corner_normals(
    along: Vectors, flat: Normals, triangles: Triangles, twins: Twins, sharp: Edges
) -> Vectors:
    """Average the normals round each vertex, as far as no sharp edge parts them: one for each corner."""
    weighted = (corner_angles(along)[:, :, None] * flat[:, None, :]).reshape(-1, 3)
    sector = _sectors(triangles, twins, sharp)
    sums = np.stack([np.bincount(sector, weights=weighted[:, axis]) for axis in range(3)], axis=1)
    return unit(sums)[sector].reshape(-1, 3, 3)


def _sectors(triangles: Triangles, twins: Twins, sharp: Edges) -> Int64[np.ndarray, "corners"]:
    """Label the corners of triangles (3 t + c) that share a vertex with no sharp edge between them."""
    if not sharp.any():
        return triangles.ravel()
    here = np.flatnonzero(~sharp.ravel())  # edge c of a triangle starts at its corner c
    there = twins.ravel()[here]
    there = there - there % 3 + (there + 1) % 3  # and its twin ends there
    return components(here, there, 3 * len(triangles))


def _ridge_tangents(along: Vectors, triangles: Triangles, sharp: Edges) -> tuple[Vectors, Vectors]:
    """Directions of sharp edges at their ends as parts of a line; their own where the line ends or forks."""
    triangle, edge = np.nonzero(sharp)
    start = triangles[triangle, edge]
    out = along[triangle, edge]
    count = np.bincount(
        start, minlength=int(triangles.max()) + 1
    )  # each sharp edge leaves either of its ends once
    total = np.stack(
        [np.bincount(start, weights=out[:, axis], minlength=len(count)) for axis in range(3)],
        axis=1,
    )
    leaving, arriving = along.copy(), along.copy()
    through = (count == 2) & (
        np.linalg.norm(total, axis=1) < 2 * np.sin(np.radians(SHARP_DEGREES / 2))
    )
    # of two edges that leave a vertex, one and minus the other run the same way
    one = through[start]
    leaving[triangle[one], edge[one]] = unit(2 * out[one] - total[start[one]])
    finish = triangles[triangle, (edge + 1) % 3]
    last = through[finish]
    arriving[triangle[last], edge[last]] = unit(2 * out[last] + total[finish[last]])
    return leaving, arriving
