"""Curving of a triangle mesh by its normals: midpoints of the edges on a smooth surface.

Every edge has a tangent at each end: the projection of the edge onto the tangent plane there. The
normal of the plane is the angle-weighted mean normal of the triangles around the corner, up to the
next sharp edges. Along a sharp edge that continues smoothly, the tangent follows the line of sharp
edges. The midpoint of the edge moves to the middle of a circular arc with these tangents. Spheres
and cylinders become exactly round, flat faces remain flat, and sharp edges remain sharp.

Source of the weights: G. Thürmer, C. A. Wüthrich, "Computing vertex normals from polygonal facets",
Journal of Graphics Tools 3, 43 (1998).
"""

import numpy as np
from jaxtyping import Bool, Int64

from airtact.geometry.mesh.triangles import (
    NODE_REFERENCES,
    SHARP_DEGREES,
    EdgeMask,
    EdgeVectors,
    QuadraticTriangles,
    Triangles,
    TriangleVectors,
    Twins,
    Vertices,
    area_vectors,
    components,
    corner_angles,
    edge_ends,
    edge_twins,
    longest_edges,
    normals_at,
    smooth_patches,
    unit,
)

# Smallest angle at the rim of a cap, and largest angle between its triangles and their mean.
_CAP_DEGREES = 40.0


def curved(
    vertices: Vertices, triangles: Triangles, sharp_degrees: float
) -> tuple[EdgeVectors, EdgeMask]:
    """Return the midpoints of the edges after curving [m], and a mask of the sharp edges.

    Caps that close a cut body, such as a hand cut at the wrist, remain flat with sharp rims.
    """
    corners = vertices[triangles]
    twins = edge_twins(triangles)
    flat = unit(area_vectors(corners))
    turn = np.einsum("td,ted->te", flat, flat[twins // 3])
    bent = turn < np.cos(np.radians(min(_CAP_DEGREES, sharp_degrees)))
    cap, rim = _caps(corners, triangles, twins, flat, bent)
    sharp = rim | (turn < np.cos(np.radians(sharp_degrees)))
    # An edge that meets no other sharp edge is a kink of a coarse mesh, not the edge of a body.
    starts = np.bincount(triangles[sharp], minlength=len(vertices))
    sharp &= (starts[edge_ends(triangles)] > 1).any(axis=2)
    rise = _rises(corners, triangles, twins, flat, sharp)
    rise[cap[:, None] & ~sharp] = 0.0
    straight = 0.5 * (corners + np.roll(corners, -1, axis=1))
    # Rounding differs between the two triangles of an edge, but their mean is the same for both.
    straight = 0.5 * (straight + straight.reshape(-1, 3)[twins])
    rise = 0.5 * (rise + rise.reshape(-1, 3)[twins])
    for _ in range(8):
        folded = _is_folded(np.concatenate([corners, straight + rise], axis=1), flat)
        if not folded.any():
            break
        rise[folded[:, None] | folded[twins // 3]] *= 0.5
    return straight + rise, sharp


def _rises(
    corners: EdgeVectors,
    triangles: Triangles,
    twins: Twins,
    flat: TriangleVectors,
    sharp: EdgeMask,
) -> EdgeVectors:
    """Return the shift [m] of each edge's midpoint onto an arc with the tangents at its ends."""
    along = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(along, axis=2, keepdims=True)
    along = along / length
    normals = corner_normals(along, flat, triangles, twins, sharp)
    start = _in_tangent_plane(along, normals)
    end = _in_tangent_plane(along, np.roll(normals, -1, axis=1))
    if sharp.any():
        leaving, arriving = _ridge_tangents(along, triangles, sharp)
        start[sharp] = leaving[sharp]
        end[sharp] = arriving[sharp]
    return length / 4 * (_half_tangent(start, along) - _half_tangent(end, along))


def _is_folded(panels: QuadraticTriangles, flat: TriangleVectors) -> Bool[np.ndarray, "triangles"]:
    corners = panels[:, :3]
    rise = panels[:, 3:] - 0.5 * (corners + np.roll(corners, -1, axis=1))
    twice_area = np.linalg.norm(area_vectors(corners), axis=1)
    # Nearly flat panels cannot fold.
    folded = np.abs(rise).max(axis=(1, 2)) * longest_edges(panels) > 0.05 * twice_area
    suspect = panels[folded]
    normals = normals_at(suspect, NODE_REFERENCES)
    upright = np.einsum("tnd,td->tn", normals, flat[folded])
    folded[folded] = (upright < 0.5 * np.linalg.norm(normals, axis=2)).any(axis=1)
    return folded


def _caps(
    corners: EdgeVectors,
    triangles: Triangles,
    twins: Twins,
    flat: TriangleVectors,
    bent: EdgeMask,
) -> tuple[Bool[np.ndarray, "triangles"], EdgeMask]:
    """Find the triangles of caps and the edges of their rims.

    A cap is a patch of at least six triangles with nearly the same normal between bent edges. All
    its vertices are on its rim.
    """
    if not bent.any():
        return np.zeros(len(triangles), dtype=bool), bent
    patch = smooth_patches(twins, bent)
    area = np.linalg.norm(area_vectors(corners), axis=1)
    mean = np.stack([np.bincount(patch, weights=area * flat[:, axis]) for axis in range(3)], axis=1)
    smallest_cosine = np.ones(len(mean))
    np.minimum.at(smallest_cosine, patch, np.einsum("td,td->t", unit(mean)[patch], flat))
    # A vertex with the same lowest and highest patch lies inside that patch.
    lowest = np.full(int(triangles.max()) + 1, len(mean))
    highest = np.full(int(triangles.max()) + 1, -1)
    np.minimum.at(lowest, triangles, patch[:, None])
    np.maximum.at(highest, triangles, patch[:, None])
    inner_vertices = np.bincount(lowest[lowest == highest], minlength=len(mean))
    even = smallest_cosine > np.cos(np.radians(_CAP_DEGREES))
    # Patches of fewer than six triangles are facets of a coarse round body.
    cap = ((np.bincount(patch) >= 6) & even & (inner_vertices == 0))[patch]
    outer = patch[twins // 3] != patch[:, None]
    return cap, outer & (cap[:, None] | cap[twins // 3])


def _in_tangent_plane(along: EdgeVectors, normals: EdgeVectors) -> EdgeVectors:
    return unit(along - np.einsum("tei,tei->te", along, normals)[:, :, None] * normals)


def _half_tangent(tangent: EdgeVectors, along: EdgeVectors) -> EdgeVectors:
    """Return vectors of length tan(a/2) across an edge, for a tangent at an angle a to the edge.

    The vectors are 0 if a exceeds 60°.
    """
    cosine = np.einsum("tei,tei->te", tangent, along)[:, :, None]
    across = (tangent - cosine * along) / (1 + np.maximum(cosine, 0))
    return np.where(cosine > np.cos(np.radians(60.0)), across, 0.0)


def corner_normals(
    along: EdgeVectors,
    flat: TriangleVectors,
    triangles: Triangles,
    twins: Twins,
    sharp: EdgeMask,
) -> EdgeVectors:
    """Return each corner's normal, averaged over the triangles around it up to sharp edges."""
    weighted = (corner_angles(along)[:, :, None] * flat[:, None, :]).reshape(-1, 3)
    sector = sectors(triangles, twins, sharp)
    sums = np.stack([np.bincount(sector, weights=weighted[:, axis]) for axis in range(3)], axis=1)
    return unit(sums)[sector].reshape(-1, 3, 3)


def sectors(triangles: Triangles, twins: Twins, sharp: EdgeMask) -> Int64[np.ndarray, "corners"]:
    """Return a label for each corner; corner c of triangle t has the index 3 t + c.

    Corners at the same vertex have the same label if no sharp edge separates them.
    """
    if not sharp.any():
        return triangles.ravel()
    # Edge c of a triangle starts at its corner c, and the twin of that edge ends there.
    corner = np.flatnonzero(~sharp.ravel())
    twin = twins.ravel()[corner]
    return components(corner, twin - twin % 3 + (twin + 1) % 3, 3 * len(triangles))


def _ridge_tangents(
    along: EdgeVectors, triangles: Triangles, sharp: EdgeMask
) -> tuple[EdgeVectors, EdgeVectors]:
    """Return the tangents of sharp edges at their start and end, along a line of sharp edges.

    If the line ends, forks or turns sharply at an end, the tangent there is the direction of the
    edge.
    """
    triangle, edge = np.nonzero(sharp)
    start = triangles[triangle, edge]
    out = along[triangle, edge]
    # Each sharp edge leaves each of its ends once, in one of its two triangles.
    count = np.bincount(start, minlength=int(triangles.max()) + 1)
    total = np.stack(
        [np.bincount(start, weights=out[:, axis], minlength=len(count)) for axis in range(3)],
        axis=1,
    )
    straight_on = np.linalg.norm(total, axis=1) < 2 * np.sin(np.radians(SHARP_DEGREES / 2))
    through = (count == 2) & straight_on
    # Of two edges that leave a vertex, the first and the reversed second have the same direction.
    # Their sum is twice the first minus the total.
    leaving = along.copy()
    at_start = through[start]
    leaving[triangle[at_start], edge[at_start]] = unit(2 * out[at_start] - total[start[at_start]])
    arriving = along.copy()
    end = triangles[triangle, (edge + 1) % 3]
    at_end = through[end]
    arriving[triangle[at_end], edge[at_end]] = unit(2 * out[at_end] + total[end[at_end]])
    return leaving, arriving
