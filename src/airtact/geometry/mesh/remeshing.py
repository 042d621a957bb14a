"""Remeshing of a closed mesh with sharp edges, using MMG.

Source: C. Dapogny, C. Dobrzynski, P. Frey, "Three-dimensional adaptive domain remeshing, implicit
domain meshing, and applications to free and moving boundary problems", J. Comput. Phys. 262, 358
(2014).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float64, Int64

from airtact.errors import InvalidInput, extra
from airtact.geometry.mesh.arrays import (
    EdgeMask,
    FlatMesh,
    QuadraticTriangles,
    Ridges,
    Triangles,
    VertexSizes,
    Vertices,
)
from airtact.geometry.mesh.quadratic_triangles import (
    NODE_REFERENCES,
    edge_lengths,
    shape_functions,
    with_middles,
)
from airtact.geometry.mesh.topology import edge_ends, edge_twins

# Ratio of the shortest edge to the target edge length, except along sharp edges of the shape.
MIN_EDGE = 0.06


@dataclass(frozen=True, eq=False)
class RidgedMesh:
    """A closed mesh, and the two ends (K, 2) of each of its sharp edges."""

    vertices: Vertices
    triangles: Triangles
    ridges: Ridges


def coarsened(
    mesh: RidgedMesh, edge: float, wall: float = np.inf, fraction: float = 0.25
) -> RidgedMesh:
    """Coarsen a mesh if its edges are on average shorter than ``fraction`` times ``edge`` [m].

    This removes the roughness of scans, which the remesher MMG would treat as bends. ``wall`` is
    the thickness of the thinnest wall [m], which limits the deviation so that the rim of the wall
    remains.
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
            f"the surface of {len(triangles)} triangles cannot be remeshed with an edge of "
            f"{1e3 * edge:.3g} mm ({fault}). Repair it, or use a mesh with fewer slivers.",
            code="mesh_faulty",
        ) from fault
    result = np.asarray(mesh.get_triangles(), dtype=np.int64)
    if len(result) < 4 or edge_twins(result).min() < 0:
        raise InvalidInput(
            f"the surface of {len(triangles)} triangles does not remain closed when it is remeshed "
            f"with an edge of {1e3 * edge:.3g} mm. Repair it, or use a shorter edge.",
            code="mesh_faulty",
        )
    ridges = np.asarray(mesh.get_edges(), dtype=np.int64).reshape(-1, 2)
    return RidgedMesh(np.array(mesh.get_vertices()) * edge, result, ridges)


def with_short_edges(
    panels: QuadraticTriangles, triangles: Triangles, sharp: EdgeMask, longest: float
) -> RidgedMesh:
    """Halve edges of a closed mesh along its panels until none is longer than ``longest`` [m]."""
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
            new_panels.append(np.einsum("na,tad->tnd", shape, panels[chosen]))
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
