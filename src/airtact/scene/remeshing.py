"""New triangles of a wanted size for a closed mesh, by MMG, its sharp edges kept.

Source: C. Dapogny, C. Dobrzynski, P. Frey, "Three-dimensional adaptive domain remeshing, implicit domain meshing, and
applications to free and moving boundary problems", J. Comput. Phys. 262, 358 (2014); MMG's surface remesher.
"""

import numpy as np
from jaxtyping import Float64, Int, Int64, Real
from scipy.spatial import KDTree

from airtact.conventions import InvalidInput

STRETCHES = (1.4, 1.2, 1.0, 0.85)
"""Longest edge asked for over the edge of the equilateral triangle wanted, tried until there are enough triangles."""

ENOUGH = 0.9
"""Share of the wanted number of triangles that will do."""

FLATTEST = 0.15
"""Distance of a straight triangle from the curved skin, over the edge wanted, above which it is made smaller."""

FINE = 0.25
"""Mean edge over the edge wanted of a mesh that is thinned out first, and ..."""

COARSE = 0.5
"""... the longest edge that it is thinned out to."""

GRADING = 1.5
"""Ratio of neighbouring edges at most."""

SMALLEST = 0.1
"""Edges are not made shorter than this share of the edge wanted, but for the shape's own sharp edges."""


def remeshed(
    vertices: Real[np.ndarray, "vertices 3"],
    triangles: Int[np.ndarray, "triangles 3"],
    ridges: Int[np.ndarray, "ridges 2"],
    sizes: Real[np.ndarray, "vertices"],
    edge: float,
    wanted: float,
) -> tuple[Float64[np.ndarray, "corners 3"], Int64[np.ndarray, "pieces 3"], Int64[np.ndarray, "creases 2"]]:
    """Mesh a closed surface anew with triangles about as large as equilateral ones of a given edge.

    Parameters
    ----------
    vertices : (V, 3) [m].
    triangles : (T, 3) vertex indices.
    ridges : (K, 2) ends of the edges that stay sharp.
    sizes : (V,) longest edge allowed at each vertex, beside what ``edge`` asks for [m].
    edge : edge of the equilateral triangle wanted [m].
    wanted : number of triangles that the area asks for.

    Returns
    -------
    vertices : (W, 3) near the curved skin of the surface [m], triangles (S, 3) and sharp edges (J, 2).

    Raises
    ------
    InvalidInput
        When MMG cannot mesh the surface.
    """
    vertices, sizes, found = vertices / edge, sizes / edge, None
    for stretch in STRETCHES:
        try:
            if _mean_edge(vertices, triangles) < FINE:
                vertices, triangles, ridges, sizes = _coarser(vertices, triangles, ridges, sizes)
            found = _meshed(vertices, triangles, ridges, np.clip(sizes, SMALLEST, stretch), FLATTEST)
        except RuntimeError as fault:
            raise InvalidInput(
                f"the surface of {len(triangles)} triangles cannot be meshed anew with an edge of {1e3 * edge:.3g} mm "
                f"({fault}); repair it, or give a mesh with fewer slivers."
            ) from fault
        if len(found[1]) >= ENOUGH * wanted:
            break
    assert found is not None
    return edge * found[0], found[1], found[2]


def _mean_edge(vertices: Real[np.ndarray, "vertices 3"], triangles: Int[np.ndarray, "triangles 3"]) -> float:
    corners = vertices[triangles]
    return float(np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).mean())


def _coarser(
    vertices: Real[np.ndarray, "vertices 3"],
    triangles: Int[np.ndarray, "triangles 3"],
    ridges: Int[np.ndarray, "ridges 2"],
    sizes: Real[np.ndarray, "vertices"],
) -> tuple[
    Float64[np.ndarray, "corners 3"],
    Int64[np.ndarray, "pieces 3"],
    Int64[np.ndarray, "creases 2"],
    Float64[np.ndarray, "corners"],
]:
    """Thin out a fine mesh first, or MMG takes the roughness of a scan for curvature and keeps its triangles small."""
    found = _meshed(vertices, triangles, ridges, np.clip(sizes, SMALLEST, COARSE), FLATTEST / 3)
    return *found, sizes[KDTree(vertices).query(found[0])[1]]


def _meshed(
    vertices: Float64[np.ndarray, "vertices 3"],
    triangles: Int[np.ndarray, "triangles 3"],
    ridges: Int[np.ndarray, "ridges 2"],
    sizes: Real[np.ndarray, "vertices"],
    flattest: float,
) -> tuple[Float64[np.ndarray, "corners 3"], Int64[np.ndarray, "pieces 3"], Int64[np.ndarray, "creases 2"]]:
    """Run MMG on a surface whose wanted edge has length 1."""
    import mmgpy  # brings its own libraries, which only surfaces from meshes need

    mesh = mmgpy.MmgMeshS()
    mesh.set_mesh_size(vertices=len(vertices), triangles=len(triangles), edges=len(ridges))
    mesh.set_vertices(np.ascontiguousarray(vertices))
    mesh.set_triangles(np.ascontiguousarray(triangles, dtype=np.int32))
    if len(ridges):
        mesh.set_edges(np.ascontiguousarray(ridges, dtype=np.int32))
        mesh.set_ridge_edges(np.arange(len(ridges), dtype=np.int32))
    mesh.set_field("metric", sizes.reshape(-1, 1))
    mesh.remesh(hmax=sizes.max(), hmin=SMALLEST, hausd=flattest, hgrad=GRADING, angle=0, verbose=-1)
    creases = np.asarray(mesh.get_edges(), dtype=np.int64).reshape(-1, 2)
    return np.array(mesh.get_vertices()), np.asarray(mesh.get_triangles(), dtype=np.int64), creases
