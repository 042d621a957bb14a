"""Repairing damaged triangle meshes: what can be put right is put right and listed, what cannot raises an error.

Every step leaves a mesh without its damage as it is, and notes in one sentence each what it
changed, with a number and the position of the first. The order matters: vertices are made one
before triangles are compared, triangles run alike before slivers are flipped, holes are filled
before the enclosed volume shows what is outside. Source of the kinds of damage and of the order: M.
Attene, M. Campen, L. Kobbelt, "Polygon mesh repairing: an application perspective", ACM Computing
Surveys 45(2), 2013, sections 2 and 3.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, Integer, Real
from scipy.spatial import KDTree

from airtact.checks import between, counted, in_mm, real_numbers
from airtact.errors import InvalidInput
from airtact.geometry.mesh.repair.cracks import without_cracks
from airtact.geometry.mesh.repair.holes import without_holes
from airtact.geometry.mesh.repair.slivers import without_slivers
from airtact.geometry.mesh.repair.winding import check_no_bow_ties, turned_outward, wound_alike
from airtact.geometry.mesh.topology import (
    Triangles,
    Vertices,
    check_closed,
    check_indices,
    check_not_degenerate,
    check_size,
    components,
    edge_twins,
)
from airtact.printing import in_short

Mesh = tuple[Float64[np.ndarray, "_ 3"], Triangles]
"""Vertices (V, 3) [m] and triangles."""
Changed = Int64[np.ndarray, "_ 3"]
"""(T, 3) triangles of another number."""

SAME_PLACE = 1e-6
"""Vertices nearer than this share of the whole extent are one vertex ..."""
FARTHEST_MERGED = 1e-6
"""... but never farther apart than this [m], a five-hundredth of the thinnest body."""
LARGEST_HOLE = 0.1
"""No hole wider than this can be asked to be filled [m]."""


@dataclass(frozen=True, eq=False)
class RepairedMesh:
    """A closed mesh whose pieces look outward, and one sentence for each kind of damage that was repaired."""

    vertices: Vertices
    triangles: Triangles
    notes: tuple[str, ...]

    __repr__ = in_short


def repaired(
    vertices: Real[np.ndarray, "vertices 3"],
    triangles: Integer[np.ndarray, "triangles 3"],
    largest_hole: float = 2e-3,
) -> RepairedMesh:
    """Repair a damaged triangle mesh, or raise an error with the position of what cannot be repaired.

    Repaired are: vertices that no triangle names or that stand within a micrometre of another,
    triangles that repeat another or have no area, needles and caps, cracks without width, patches
    and pieces wound the wrong way, and small holes, up to ``largest_hole`` [m], where the surface
    round them shows what is missing. Errors are: indices out of range, NaN in a vertex that is
    named, an extent over 2 m or under 0.5 mm, edges of more than two triangles, one-sided surfaces,
    holes that are too large or whose missing part is unknown, parts that hang together in a point,
    triangles or pieces that stay flat. ``check_surface`` looks for crossings of the surface with
    itself.

    Examples
    --------
    >>> corners = 0.01 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1]])
    >>> notes = repaired(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 2, 4], [1, 2, 3]])).notes
    >>> print(*notes)
    1 triangle ran against its neighbours and was turned, the first near (0.00, 3.33, 3.33) mm.
    """
    largest_hole = between(
        largest_hole, 0.0, LARGEST_HOLE, "largest_hole", "m", "is it in millimetres?"
    )
    vertices, triangles = real_numbers(vertices, "surface vertices"), triangles.astype(np.int64)
    check_indices(len(vertices), triangles)
    if len(triangles) == 0:
        raise InvalidInput("the surface holds 0 triangles; give a closed one.", code="empty")
    notes: list[str] = []
    vertices, triangles = _with_named_vertices(vertices, triangles, notes)
    check_size(float(np.ptp(vertices, axis=0).max()))
    vertices, triangles = _with_merged_vertices(vertices, triangles, notes)
    triangles = _with_three_corners(vertices, triangles, notes)
    triangles = _without_repeats(vertices, triangles, notes)
    triangles = _closed(vertices, triangles, largest_hole, notes)
    check_not_degenerate(vertices, triangles)
    twins = check_closed(vertices, triangles)
    check_no_bow_ties(vertices, triangles, twins)
    triangles = turned_outward(vertices, triangles, twins, notes)
    return RepairedMesh(
        *_with_vertices(vertices, triangles, _named(vertices, triangles)), tuple(notes)
    )


def _closed(
    vertices: Vertices, triangles: Triangles, largest_hole: float, notes: list[str]
) -> Changed:
    """Close the mesh with all triangles running alike."""
    if (edge_twins(triangles) >= 0).all():
        return without_slivers(vertices, triangles, notes)
    triangles = without_cracks(vertices, triangles, notes)
    triangles = wound_alike(vertices, triangles, notes)
    triangles = without_slivers(vertices, triangles, notes)
    filled = without_holes(vertices, triangles, largest_hole, notes)
    if filled is not triangles:
        filled = without_slivers(
            vertices, filled, notes
        )  # a rim along a straight line is filled with caps
    return filled


def _named(vertices: Vertices, triangles: Triangles) -> Bool[np.ndarray, "vertices"]:
    """Which vertices a triangle names."""
    named = np.zeros(len(vertices), dtype=bool)
    named[triangles] = True
    return named


def _with_vertices(
    vertices: Vertices, triangles: Triangles, keep: Bool[np.ndarray, "vertices"]
) -> Mesh:
    """Keep some vertices and count them anew."""
    if keep.all():
        return vertices, triangles
    return vertices[keep], (np.cumsum(keep) - 1)[triangles]


def _with_named_vertices(vertices: Vertices, triangles: Triangles, notes: list[str]) -> Mesh:
    """Drop the vertices that no triangle names; raise ``InvalidInput`` for NaN in the others."""
    named = _named(vertices, triangles)
    wrong = np.flatnonzero(named & ~np.isfinite(vertices).all(axis=1))
    if len(wrong):
        count = counted(len(wrong), "vertex of the surface is", "vertices of the surface are")
        neighbours = vertices[triangles[(triangles == wrong[0]).any(axis=1)]].reshape(-1, 3)
        known = neighbours[np.isfinite(neighbours).all(axis=1)]
        beside = known.mean(axis=0) if len(known) else None
        near = "" if beside is None else f" beside {in_mm(beside)}"
        raise InvalidInput(
            f"{count} NaN or infinite, the first is vertex {int(wrong[0])}{near}; give it a position or remove its "
            "triangles.",
            beside,
            code="not_finite",
        )
    idle = np.flatnonzero(~named)
    if len(idle):
        count = counted(
            len(idle), "vertex that no triangle names was", "vertices that no triangle names were"
        )
        notes.append(f"{count} dropped, the first is vertex {int(idle[0])}.")
    return _with_vertices(vertices, triangles, named)


def _with_merged_vertices(vertices: Vertices, triangles: Triangles, notes: list[str]) -> Mesh:
    """Make vertices at the same position one: the first of them, which stays where it is."""
    first = _first_alike(vertices)
    own = first == np.arange(len(vertices))
    vertices, triangles = _with_vertices(vertices, first[triangles], own)
    near = min(SAME_PLACE * float(np.ptp(vertices, axis=0).max()), FARTHEST_MERGED)
    pairs = KDTree(vertices, compact_nodes=False, balanced_tree=False).query_pairs(
        near, output_type="ndarray"
    )
    if len(pairs) == 0:
        return vertices, triangles
    cluster = components(pairs[:, 0], pairs[:, 1], len(vertices))
    first = np.unique(cluster, return_index=True)[1][cluster]
    own = first == np.arange(len(vertices))
    merged = counted(int((~own).sum()), "vertex was", "vertices were")
    notes.append(
        f"{merged} merged with another within {near * 1e6:.2g} micrometres, the first near "
        f"{in_mm(vertices[(~own).argmax()])}."
    )
    return _with_vertices(vertices, first[triangles], own)


def _first_alike(vertices: Vertices) -> Int64[np.ndarray, "vertices"]:
    """For each vertex the first one with exactly the same coordinates."""
    order = np.lexsort(vertices.T)
    ranked = vertices[order]
    new = np.r_[True, (ranked[1:] != ranked[:-1]).any(axis=1)]
    first = np.empty(len(vertices), dtype=np.int64)
    first[order] = order[new][np.cumsum(new) - 1]
    return first


def _with_three_corners(vertices: Vertices, triangles: Triangles, notes: list[str]) -> Changed:
    """Drop triangles that name a vertex twice: their two other neighbours already share their edge."""
    collapsed = (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)
    if not collapsed.any():
        return triangles
    one, many = (
        "triangle with two corners in one vertex was",
        "triangles with two corners in one vertex were",
    )
    count = counted(int(collapsed.sum()), one, many)
    notes.append(
        f"{count} removed, the first near {in_mm(vertices[triangles[collapsed.argmax()]].mean(axis=0))}."
    )
    triangles = triangles[~collapsed]
    if len(triangles) == 0:
        raise InvalidInput(
            "0 triangles of the surface have an area; check its unit and its scale.",
            code="empty",
        )
    return triangles


def _without_repeats(vertices: Vertices, triangles: Triangles, notes: list[str]) -> Changed:
    """Keep the first of triangles over the same three vertices, however they run."""
    corners = np.sort(triangles, axis=1)
    order = np.lexsort(corners.T)
    again = np.zeros(len(triangles), dtype=bool)
    again[order[1:]] = (corners[order[1:]] == corners[order[:-1]]).all(axis=1)
    if not again.any():
        return triangles
    count = counted(
        int(again.sum()), "triangle that repeats another was", "triangles that repeat others were"
    )
    notes.append(
        f"{count} dropped, the first near {in_mm(vertices[triangles[again.argmax()]].mean(axis=0))}."
    )
    return triangles[~again]
