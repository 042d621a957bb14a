"""Neighbours, pieces and orientation of the triangles of a mesh, and their checks."""

import numpy as np
from jaxtyping import Bool, Float64, Int, Int64, Real
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from airtact.errors import InvalidInput, counted, in_mm
from airtact.geometry.mesh.arrays import (
    Corners,
    EdgeMask,
    TriangleLabels,
    Triangles,
    Twins,
)
from airtact.geometry.mesh.quadratic_triangles import longest_edges

AnyTriangles = Int[np.ndarray, "triangles 3"]
AnyVertices = Real[np.ndarray, "vertices 3"]

# Edges stay sharp if the normals of their triangles differ by more than this [degrees].
SHARP_DEGREES = 75.0


def edge_twins(triangles: AnyTriangles) -> Twins:
    """Return the reverse of each directed edge 01, 12, 20 as an index 3 t + e.

    The index refers to edge e of triangle t. It is -1 if there is no reverse edge, and -2 if the
    directed edge itself occurs more than once.
    """
    start = triangles.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    count = int(triangles.max()) + 1 if triangles.size else 1
    forward = (start * count + end).ravel()
    backward = (end * count + start).ravel()
    order = np.argsort(forward, kind="stable")
    ranked = forward[order]
    match = np.minimum(np.searchsorted(ranked, backward), len(ranked) - 1)
    twins = np.where(ranked[match] == backward, order[match], -1)
    repeated = np.zeros(len(ranked), dtype=bool)
    repeated[1:] |= ranked[1:] == ranked[:-1]
    repeated[:-1] |= ranked[1:] == ranked[:-1]
    twins[order[repeated]] = -2
    return twins.reshape(-1, 3)


def edge_keys(triangles: AnyTriangles) -> Triangles:
    """Return a key for each edge 01, 12, 20: low * count + high, the same in both directions."""
    start = triangles.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    count = int(triangles.max()) + 1 if triangles.size else 1
    return np.minimum(start, end) * count + np.maximum(start, end)


def edge_ends(triangles: AnyTriangles) -> Int[np.ndarray, "triangles 3 2"]:
    """Return the start and end of edges 01, 12, 20 of each triangle."""
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)


def are_among(
    edges: Int[np.ndarray, "*edges 2"], listed: Int[np.ndarray, "*listed 2"]
) -> Bool[np.ndarray, "*edges"]:
    """Return whether a list contains each edge, given as a pair of vertices in any order."""
    count = max(int(edges.max(initial=0)), int(listed.max(initial=0))) + 1
    return np.isin(np.sort(edges, axis=-1) @ [count, 1], np.sort(listed, axis=-1) @ [count, 1])


def shells(triangles: AnyTriangles, twins: Twins | None = None) -> TriangleLabels:
    """Label the triangles (T,) of a closed mesh by piece, in the order of the first triangles."""
    twins = edge_twins(triangles) if twins is None else twins
    count = len(twins)
    graph = csr_array(
        (np.ones(3 * count, dtype=bool), twins.ravel() // 3, np.arange(0, 3 * count + 1, 3))
    )
    # All links are mutual, so strong connection gives the same labels and is faster.
    return connected_components(graph, connection="strong")[1].astype(np.int64)


def components(
    start: Int[np.ndarray, "links"], end: Int[np.ndarray, "links"], count: int
) -> Int64[np.ndarray, "members"]:
    """Label the connected components of a graph of ``count`` nodes with the given links."""
    links = coo_array((np.ones(len(start), dtype=bool), (start, end)), shape=(count, count))
    return connected_components(links, directed=False)[1].astype(np.int64)


def smooth_patches(twins: Twins, borders: EdgeMask) -> TriangleLabels:
    """Label the patches of a closed mesh that the border edges separate."""
    triangle, edge = np.nonzero(~borders)
    return components(triangle, twins[triangle, edge] // 3, len(twins))


def cone_volumes(corners: Corners) -> Float64[np.ndarray, "triangles"]:
    """Return the signed volume [m³] of the tetrahedron from the mean corner to each triangle.

    The volumes add up to the volume of the body.
    """
    a, b, c = np.moveaxis(corners - corners.mean(axis=(0, 1)), 1, 0)
    return np.einsum("ti,ti->t", a, np.cross(b, c)) / 6.0


def check_size(extent: float) -> None:
    """Raise ``InvalidInput`` for an extent outside 0.5 mm to 2 m, which suggests a wrong unit."""
    largest = 2.0
    smallest = 0.5e-3
    if extent > largest * (1.0 + 1e-9):
        raise InvalidInput(
            f"the surface spans {extent:.4g} m, but at most {largest:g} m is allowed: is it in "
            "millimetres? Use metres, or scale it by 1e-3.",
            code="not_in_metres",
        )
    if extent < smallest * (1.0 - 1e-9):
        raise InvalidInput(
            f"the surface spans {extent * 1e3:.4g} mm, but at least {smallest * 1e3:g} mm is "
            "required: was it converted from millimetres twice? Check the scale.",
            code="not_in_metres",
        )


def check_indices(count: int, triangles: AnyTriangles) -> None:
    """Raise ``InvalidInput`` for triangles with vertex indices outside 0 to ``count`` - 1."""
    wrong = (triangles < 0) | (triangles >= count)
    if wrong.any():
        triangle, corner = np.argwhere(wrong)[0]
        named = counted(int(wrong.any(axis=1).sum()), "triangle contains", "triangles contain")
        raise InvalidInput(
            f"{named} vertices that do not exist: triangle {triangle} contains vertex "
            f"{triangles[triangle, corner]}, but indices are from 0 to {count - 1}.",
            code="out_of_range",
        )


def check_not_degenerate(vertices: AnyVertices, triangles: AnyTriangles) -> None:
    """Raise ``InvalidInput`` for triangles whose height is below 1e-6 of their longest edge."""
    corners = vertices[triangles]
    edges = np.roll(corners, -1, axis=1) - corners
    twice_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    thin = np.flatnonzero(twice_area <= 1e-6 * longest_edges(corners) ** 2)
    if len(thin):
        where = corners[thin[0]].mean(axis=0)
        raise InvalidInput(
            f"{counted(len(thin), 'triangle is', 'triangles are')} degenerate (no area); the first "
            f"is triangle {thin[0]} near {in_mm(where)}. Remove them or merge their vertices.",
            where,
            code="mesh_faulty",
        )


def check_closed(vertices: AnyVertices, triangles: AnyTriangles) -> Twins:
    """Return ``edge_twins``, and check that each edge has exactly one reverse edge."""
    twins = edge_twins(triangles)
    for mark, singular, plural, fault, code in (
        (
            -2,
            "edge is",
            "edges are",
            "traversed in the same direction by more than one triangle (neighbours with opposite "
            "orientations, a fin, or parts that share an edge, which union=True joins)",
            "mesh_not_oriented",
        ),
        (
            -1,
            "edge has",
            "edges have",
            "a triangle on one side only, so the surface is open",
            "mesh_open",
        ),
    ):
        marked = np.argwhere(twins == mark)
        if len(marked):
            ends = edge_ends(triangles)[tuple(marked.T)]
            count = len(np.unique(np.sort(ends, axis=1), axis=0))
            where = vertices[ends[0]].mean(axis=0)
            raise InvalidInput(
                f"{counted(count, singular, plural)} {fault}; the first is near {in_mm(where)}: "
                "repair the mesh.",
                where,
                code=code,
            )
    return twins


def check_orientation(
    vertices: AnyVertices, triangles: AnyTriangles, twins: Twins | None = None
) -> None:
    """Raise ``InvalidInput`` for closed pieces whose normals point inward."""
    corners = vertices[triangles]
    piece = shells(triangles, twins)
    volumes = np.bincount(piece, weights=cone_volumes(corners))
    inward = np.flatnonzero(volumes <= 0.0)
    if len(inward):
        where = corners[np.flatnonzero(piece == inward[0])[0]].mean(axis=0)
        number = int(np.isin(piece, inward).sum())
        are = f"{len(inward)} of {len(volumes)} closed pieces {'is' if len(inward) == 1 else 'are'}"
        raise InvalidInput(
            f"{'the surface is' if len(volumes) == 1 else are} inside out (the first piece "
            f"encloses {volumes[inward[0]] * 1e6:.4g} cm³, near {in_mm(where)}); reverse the "
            f"{number} triangles.",
            where,
            code="mesh_faulty",
        )
