"""New triangles of a wanted size for a closed mesh, by MMG, with its sharp edges.

Source: C. Dapogny, C. Dobrzynski, P. Frey, "Three-dimensional adaptive domain remeshing, implicit
domain meshing, and applications to free and moving boundary problems", J. Comput. Phys. 262, 358
(2014); MMG's surface remesher.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64, Real

from airtact.errors import InvalidInput, extra
from airtact.geometry.mesh.quadratic_triangles import edge_lengths
from airtact.geometry.mesh.topology import Triangles, Vertices, edge_twins

STRETCHES = (1.4, 1.2, 1.0, 0.85)
"""Longest edge asked for over the edge of the equilateral triangle wanted, tried until there are enough triangles."""

ENOUGH = 0.9
"""Share of the wanted number of triangles that will do."""

FLATTEST = 0.15
"""Distance of a straight triangle from the curved surface, over the edge wanted, that MMG takes for too large."""

FINE = 0.25
"""Mean edge over the edge wanted of a mesh that is coarsened out first."""

ROUGH = 0.06
"""Distance of the coarsened mesh from its surface, over the edge wanted: about the roughness of a scan."""

GRADING = 1.5
"""Ratio of neighbouring edges at most."""

SMALLEST = 0.06
"""Edges are not made shorter than this share of the edge wanted, but for the shape's own sharp edges."""


@dataclass(frozen=True, eq=False)
class RidgedMesh:
    """A closed mesh with the ends (K, 2) of the edges that stay sharp."""

    vertices: Vertices
    triangles: Triangles
    ridges: Int64[np.ndarray, "ridges 2"]


WALL_OFF, COARSE_WALL_OFF = 0.3, 0.1
"""Distance of triangles, and of the coarsened mesh, from the surface at most, over the thinnest wall's thickness."""


def coarsened(mesh: RidgedMesh, edge: float, wall: float = np.inf) -> RidgedMesh:
    """Coarsen a mesh of edges far shorter than ``edge`` [m], or MMG takes the roughness of a scan for bends.

    ``wall`` is the thickness of its thinnest wall [m], whose rim would be lost if triangles left it
    by as much.
    """
    if edge_lengths(mesh.vertices[mesh.triangles]).mean() > FINE * edge:
        return mesh
    return _meshed(
        mesh, np.full(len(mesh.vertices), FINE), edge, min(ROUGH, COARSE_WALL_OFF * wall / edge)
    )


def remeshed(
    mesh: RidgedMesh,
    sizes: Real[np.ndarray, "vertices"],
    edge: float,
    wanted: float,
    wall: float = np.inf,
) -> RidgedMesh:
    """Mesh a closed surface anew with triangles about as large as equilateral ones of a given edge.

    ``sizes`` (V,) are the longest edges allowed at each vertex beside what ``edge`` asks for [m],
    ``wanted`` is the number of triangles that the area asks for, ``wall`` is as in ``coarsened``.
    The result is near the curved surface, not on it.
    """
    flattest = min(FLATTEST, WALL_OFF * wall / edge)
    for stretch in STRETCHES[:-1]:
        found = _meshed(mesh, np.clip(sizes / edge, SMALLEST, stretch), edge, flattest)
        if len(found.triangles) >= ENOUGH * wanted:
            return found
    return _meshed(mesh, np.clip(sizes / edge, SMALLEST, STRETCHES[-1]), edge, flattest)


def _meshed(
    surface: RidgedMesh, sizes: Real[np.ndarray, "vertices"], edge: float, flattest: float
) -> RidgedMesh:
    """Run MMG in units of the edge."""
    with extra("mesh", "a surface that is meshed anew needs MMG"):
        import mmgpy

    mesh = mmgpy.MmgMeshS()
    ridges, triangles = surface.ridges.astype(np.int32), surface.triangles.astype(np.int32)
    mesh.set_mesh_size(vertices=len(surface.vertices), triangles=len(triangles), edges=len(ridges))
    mesh.set_vertices(np.ascontiguousarray(surface.vertices / edge))
    mesh.set_triangles(triangles)
    if len(ridges):
        mesh.set_edges(ridges)
        mesh.set_ridge_edges(np.arange(len(ridges), dtype=np.int32))
    mesh.set_field("metric", sizes.reshape(-1, 1))
    try:
        mesh.remesh(
            hmax=max(sizes.max(), 1.1 * SMALLEST),
            hmin=SMALLEST,
            hausd=flattest,
            hgrad=GRADING,
            angle=0,
            verbose=-1,
        )
    except RuntimeError as fault:
        raise InvalidInput(
            f"the surface of {len(triangles)} triangles cannot be meshed anew with an edge of {1e3 * edge:.3g} mm "
            f"({fault}); repair it, or give a mesh with fewer slivers.",
            code="mesh_faulty",
        ) from fault
    found = np.asarray(mesh.get_triangles(), dtype=np.int64)
    if len(found) < 4 or edge_twins(found).min() < 0:
        raise InvalidInput(
            f"the surface of {len(triangles)} triangles does not stay closed when it is meshed anew with an edge of "
            f"{1e3 * edge:.3g} mm; repair it, or ask for a shorter edge.",
            code="mesh_faulty",
        )
    ridges = np.asarray(mesh.get_edges(), dtype=np.int64).reshape(-1, 2)
    return RidgedMesh(np.array(mesh.get_vertices()) * edge, found, ridges)
