"""Repair of damaged triangle meshes; ambiguous damage raises an error.

Each step leaves an intact mesh unchanged. A sentence states the number of repairs and the position
of the first one. The order matters: vertices are merged before triangles are compared, holes are
filled after triangles are oriented, and slivers are removed from closed meshes. The kinds of damage
and the order follow M. Attene, M. Campen, L. Kobbelt, "Polygon mesh repairing: an application
perspective", ACM Computing Surveys 45(2), 2013, sections 2 and 3.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Integer, Real
from scipy.spatial import KDTree

from airtact.errors import InvalidInput, between, counted, in_mm, real_numbers
from airtact.geometry.mesh.triangles import (
    FlatMesh,
    Indices,
    NewTriangles,
    Triangles,
    Twins,
    Vertices,
    area_vectors,
    check_closed,
    check_indices,
    check_not_degenerate,
    check_size,
    components,
    cone_volumes,
    edge_keys,
    edge_twins,
    longest_edges,
    shells,
    unit,
)

if TYPE_CHECKING:
    from manifold3d import Manifold

# Largest width of a crack and largest height of a sliver [m]. The surface may move this far.
MAX_CRACK = 5e-6


@dataclass(frozen=True, eq=False)
class RepairedMesh:
    """A closed mesh with outward normals, and a sentence for each kind of damage repaired."""

    vertices: Vertices
    triangles: Triangles
    notes: tuple[str, ...]


def repaired(
    vertices: Real[np.ndarray, "vertices 3"],
    triangles: Integer[np.ndarray, "triangles 3"],
    largest_hole: float = 2e-3,
) -> RepairedMesh:
    """Repair a damaged triangle mesh.

    The repairs are:

    - Unused vertices are removed. Vertices within a micrometre of each other are merged.
    - Duplicate triangles are removed. Triangles without area are merged with their neighbours.
    - The vertex order is reversed in triangles and pieces that are oriented the wrong way.
    - Holes of up to ``largest_hole`` [m] get flat lids. Cracks of up to 5 micrometres are closed.

    Raises
    ------
    InvalidInput
        If an index is out of range, if a used vertex is NaN, if the extent is over 2 m or under 0.5
        mm, if an edge belongs to more than two triangles, if the surface is one-sided, if a hole is
        wider than ``largest_hole``, if parts touch in a single vertex, or if triangles without area
        or pieces without volume remain. The message states the position. Self-intersections are
        checked by ``check_surface``.

    Examples
    --------
    >>> corners = 0.01 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1]])
    >>> notes = repaired(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 2, 4], [1, 2, 3]])).notes
    >>> print(*notes)
    1 triangle was reversed to match its neighbours, the first near (0.00, 3.33, 3.33) mm.
    """
    largest_hole = between(largest_hole, 0.0, 0.1, "largest_hole", "m")
    vertices = real_numbers(vertices, "surface vertices")
    triangles = triangles.astype(np.int64)
    check_indices(len(vertices), triangles)
    if len(triangles) == 0:
        raise InvalidInput("the surface has no triangles; pass a closed surface.", code="empty")
    notes: list[str] = []
    vertices, triangles = _with_used_vertices(vertices, triangles, notes)
    check_size(float(np.ptp(vertices, axis=0).max()))
    # Only open meshes contain cracks.
    for near in (min(1e-6 * float(np.ptp(vertices, axis=0).max()), 1e-6), MAX_CRACK):
        vertices, triangles = _with_merged_vertices(vertices, triangles, near, notes)
        triangles = _without_collapsed(vertices, triangles, notes)
        triangles = _without_repeats(vertices, triangles, notes)
        if (edge_twins(triangles) >= 0).all():
            break
    else:
        triangles = _oriented(vertices, triangles, notes)
        if (edge_twins(triangles) == -2).any():
            check_closed(vertices, triangles)  # rejects fins and one-sided pieces
        triangles = _without_holes(vertices, triangles, largest_hole, notes)
    twins = check_closed(vertices, triangles)
    _check_no_bow_ties(vertices, triangles, twins)
    vertices, triangles = without_slivers(vertices, triangles, notes)
    check_not_degenerate(vertices, triangles)
    triangles = _turned_outward(vertices, triangles, notes)
    return RepairedMesh(vertices, triangles, tuple(notes))


def _note(
    notes: list[str],
    count: int | np.integer,
    singular: str,
    plural: str,
    where: Real[np.ndarray, "*points 3"],
) -> None:
    """Append a sentence; ``where`` contains the corners of the first triangle, or one point."""
    place = in_mm(where.reshape(-1, 3).mean(axis=0))
    notes.append(f"{counted(int(count), singular, plural)}, the first near {place}.")


# --- vertices ---------------------------------------------------------------------------------


def _with_vertices(
    vertices: Vertices, triangles: Triangles, keep: Bool[np.ndarray, "vertices"]
) -> FlatMesh:
    if keep.all():
        return vertices, triangles
    return vertices[keep], (np.cumsum(keep) - 1)[triangles]


def _with_used_vertices(vertices: Vertices, triangles: Triangles, notes: list[str]) -> FlatMesh:
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    wrong = np.flatnonzero(used & ~np.isfinite(vertices).all(axis=1))
    if len(wrong):
        neighbours = vertices[triangles[(triangles == wrong[0]).any(axis=1)]].reshape(-1, 3)
        finite = neighbours[np.isfinite(neighbours).all(axis=1)]
        where = finite.mean(axis=0) if len(finite) else None
        beside = "" if where is None else f" near {in_mm(where)}"
        are = counted(len(wrong), "vertex of the surface is", "vertices of the surface are")
        raise InvalidInput(
            f"{are} NaN or infinite; the first is vertex {wrong[0]}{beside}. Set its position "
            "or remove its triangles.",
            where,
            code="not_finite",
        )
    unused = np.flatnonzero(~used)
    if len(unused):
        were = counted(len(unused), "unused vertex was", "unused vertices were")
        notes.append(f"{were} removed; the first is vertex {unused[0]}.")
    return _with_vertices(vertices, triangles, used)


def _with_merged_vertices(
    vertices: Vertices, triangles: Triangles, near: float, notes: list[str]
) -> FlatMesh:
    """Merge vertices closer than ``near`` [m] into the first of them, which stays in place."""
    # Exact copies are not reported, because some formats repeat the vertices for every triangle.
    order = np.lexsort(vertices.T)
    ranked = vertices[order]
    new = np.r_[True, (ranked[1:] != ranked[:-1]).any(axis=1)]
    first = np.empty(len(vertices), dtype=np.int64)
    first[order] = order[new][np.cumsum(new) - 1]
    vertices, triangles = _with_vertices(
        vertices, first[triangles], first == np.arange(len(vertices))
    )
    tree = KDTree(vertices, compact_nodes=False, balanced_tree=False)
    pairs = tree.query_pairs(near, output_type="ndarray")
    if len(pairs) == 0:
        return vertices, triangles
    cluster = components(pairs[:, 0], pairs[:, 1], len(vertices))
    first = np.unique(cluster, return_index=True)[1][cluster]
    is_first = first == np.arange(len(vertices))
    merged = f"merged with another within {near * 1e6:.2g} micrometres"
    where = vertices[(~is_first).argmax()]
    _note(notes, (~is_first).sum(), f"vertex was {merged}", f"vertices were {merged}", where)
    return _with_vertices(vertices, first[triangles], is_first)


# --- triangles --------------------------------------------------------------------------------


def _without_collapsed(vertices: Vertices, triangles: Triangles, notes: list[str]) -> NewTriangles:
    """Remove triangles that use a vertex twice; their neighbours already share an edge."""
    collapsed = (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)
    if not collapsed.any():
        return triangles
    _note(
        notes,
        collapsed.sum(),
        "triangle with two corners at one vertex was removed",
        "triangles with two corners at one vertex were removed",
        vertices[triangles[collapsed.argmax()]],
    )
    if collapsed.all():
        raise InvalidInput(
            "all triangles of the surface have zero area; check its unit and scale.", code="empty"
        )
    return triangles[~collapsed]


def _without_repeats(vertices: Vertices, triangles: Triangles, notes: list[str]) -> NewTriangles:
    corners = np.sort(triangles, axis=1)
    order = np.lexsort(corners.T)
    repeated = np.zeros(len(triangles), dtype=bool)
    repeated[order[1:]] = (corners[order[1:]] == corners[order[:-1]]).all(axis=1)
    if not repeated.any():
        return triangles
    _note(
        notes,
        repeated.sum(),
        "duplicate triangle was removed",
        "duplicate triangles were removed",
        vertices[triangles[repeated.argmax()]],
    )
    return triangles[~repeated]


def without_slivers(vertices: Vertices, triangles: Triangles, notes: list[str]) -> FlatMesh:
    """Remove triangles of a closed mesh that are too flat to have meaningful normals."""
    corners = vertices[triangles]
    longest = longest_edges(corners)
    twice_area = np.linalg.norm(area_vectors(corners), axis=1)
    slivers = np.flatnonzero(twice_area < longest * np.minimum(1e-3 * longest, MAX_CRACK))
    if len(slivers) == 0:
        return vertices, triangles
    solid = solid_of(vertices, triangles).as_original().simplify(MAX_CRACK)
    vertices, triangles = flat_mesh_of(solid)
    _note(
        notes,
        len(slivers),
        "triangle without area was merged with its neighbours",
        "triangles without area were merged with their neighbours",
        corners[slivers[0]],
    )
    return vertices, triangles


def solid_of(vertices: Vertices, triangles: Triangles) -> "Manifold":
    """Convert a closed mesh to a manifold3d body."""
    from manifold3d import Manifold, Mesh64

    return Manifold(Mesh64(np.array(vertices), triangles.astype(np.uint64)))


def flat_mesh_of(solid: "Manifold") -> FlatMesh:
    """Convert a manifold3d body to vertices and triangles."""
    mesh = solid.to_mesh64()
    return mesh.vert_properties[:, :3].astype(np.float64), mesh.tri_verts.astype(np.int64)


# --- holes ------------------------------------------------------------------------------------


def _without_holes(
    vertices: Vertices, triangles: Triangles, largest: float, notes: list[str]
) -> NewTriangles:
    """Close the holes of a consistently oriented mesh by triangles over their vertices.

    A lid is triangulated in projection along its normal. It may cross a surface that extends over
    the hole, which ``check_not_crossed`` detects. The function raises ``InvalidInput`` for holes
    wider than ``largest`` [m], except for cracks, which enclose no area.
    """
    from manifold3d import triangulate

    rims = _rims(triangles)
    if not rims:
        return triangles
    lids = [triangles]
    widest = 0.0
    for rim in rims:
        points = vertices[rim]
        middle = points.mean(axis=0)
        width = float(np.ptp(points, axis=0).max())
        area = np.cross(points - middle, np.roll(points, -1, axis=0) - middle).sum(axis=0) / 2.0
        if width > largest and np.linalg.norm(area) > MAX_CRACK * width:
            raise InvalidInput(
                f"the surface is open: {counted(len(rims), 'hole', 'holes')}, one of "
                f"them {width * 1e3:.3g} mm wide near {in_mm(middle)}. The limit is "
                f"{largest * 1e3:g} mm: increase "
                "largest_hole, or close the hole in the file.",
                middle,
                code="mesh_faulty",
            )
        widest = max(widest, width)
        # The plane of the lid contains the two principal directions of its points.
        along = np.linalg.svd(points - middle, full_matrices=False)[2][0]
        across = np.cross(unit(area), along)
        lids.append(rim[triangulate([(points - middle) @ np.stack([along, across], axis=1)])])
    up_to = f"of up to {widest * 1e3:.2g} mm"
    where = vertices[rims[0]]
    _note(notes, len(rims), f"hole {up_to} was filled", f"holes {up_to} were filled", where)
    return np.concatenate(lids)


def _rims(triangles: Triangles) -> list[Indices]:
    border = np.flatnonzero(edge_twins(triangles).ravel() == -1)
    # The rim runs against the edges of adjacent triangles. Holes that meet in a vertex are split.
    starts = np.roll(triangles, -1, axis=1).ravel()[border].tolist()
    ends = triangles.ravel()[border].tolist()
    after: dict[int, list[int]] = {}
    for start, end in zip(starts, ends, strict=True):
        after.setdefault(start, []).append(end)
    rims = []
    for first in starts:
        rim: list[int] = []
        place: dict[int, int] = {}
        vertex = first
        while after[vertex]:
            place[vertex] = len(rim)
            rim.append(vertex)
            vertex = after[vertex].pop()
            if vertex in place:
                rims.append(np.array(rim[place[vertex] :]))
                for passed in rim[place[vertex] :]:
                    del place[passed]
                del rim[len(rim) - len(rims[-1]) :]
    return rims


# --- orientation ------------------------------------------------------------------------------


def _oriented(vertices: Vertices, triangles: Triangles, notes: list[str]) -> Triangles:
    """Reverse as few triangles as possible so that neighbours have the same orientation.

    The graph has two nodes for each triangle, one for each orientation. Every node is linked to the
    consistent nodes of its neighbours, so an orientable piece has two mirrored components.
    One-sided pieces and edges that more than two triangles share remain for ``check_closed`` to
    reject.
    """
    count = len(triangles)
    keys = edge_keys(triangles).ravel()
    order = np.argsort(keys, kind="stable")
    _, starts, sizes = np.unique(keys[order], return_index=True, return_counts=True)
    pair = starts[sizes == 2]
    first = order[pair]
    second = order[pair + 1]
    agree = triangles.ravel()[first] != triangles.ravel()[second]
    triangle = first // 3
    mirrored = second // 3 + np.where(agree, 0, count)
    label = components(
        np.concatenate([triangle, triangle + count]),
        np.concatenate([mirrored, (mirrored + count) % (2 * count)]),
        2 * count,
    )
    plain = label[:count]
    turned = label[count:]
    unturned = np.bincount(plain, minlength=2 * count)
    flip = (unturned[plain] < unturned[turned]) | (
        (unturned[plain] == unturned[turned]) & (plain > turned)
    )
    if not flip.any():
        return triangles
    _note(
        notes,
        flip.sum(),
        "triangle was reversed to match its neighbours",
        "triangles were reversed to match their neighbours",
        vertices[triangles[flip.argmax()]],
    )
    return np.where(flip[:, None], triangles[:, ::-1], triangles)


def _turned_outward(vertices: Vertices, triangles: Triangles, notes: list[str]) -> Triangles:
    """Reverse closed pieces of negative volume, and check that no piece has zero volume."""
    piece = shells(triangles)
    corners = vertices[triangles]
    volumes = np.bincount(piece, weights=cone_volumes(corners))
    areas = np.bincount(piece, weights=np.linalg.norm(area_vectors(corners), axis=1))
    flat = np.flatnonzero(np.abs(volumes) <= 1e-9 * areas**1.5)
    if len(flat):
        where = vertices[triangles[(piece == flat[0]).argmax()]].mean(axis=0)
        raise InvalidInput(
            f"{counted(len(flat), 'closed piece encloses', 'closed pieces enclose')} 0 cm³, the "
            f"first near {in_mm(where)}; remove it or make it thicker.",
            where,
            code="mesh_faulty",
        )
    inward = np.flatnonzero(volumes < 0.0)
    if len(inward) == 0:
        return triangles
    flip = (volumes < 0.0)[piece]
    _note(
        notes,
        len(inward),
        "closed piece was inside out and was reversed",
        "closed pieces were inside out and were reversed",
        vertices[triangles[flip.argmax()]],
    )
    return np.where(flip[:, None], triangles[:, ::-1], triangles)


def _check_no_bow_ties(vertices: Vertices, triangles: Triangles, twins: Twins) -> None:
    """Check that no parts of a closed mesh are joined by a single vertex."""
    # Corners around a vertex form one ring, or several rings if parts only touch there. Edge c
    # starts at corner c, and its twin ends there.
    corner = np.arange(triangles.size)
    ring = components(corner, (3 * (twins // 3) + (twins + 1) % 3).ravel(), len(corner))
    first_of_ring = np.unique(ring, return_index=True)[1]
    rings = np.bincount(triangles.ravel()[first_of_ring], minlength=len(vertices))
    tied = np.flatnonzero(rings > 1)
    if len(tied):
        where = vertices[tied[0]]
        join = counted(len(tied), "vertex joins", "vertices join")
        raise InvalidInput(
            f"{join} parts of the surface that touch nowhere else, the first near "
            f"{in_mm(where)}; move the parts apart or join them.",
            where,
            code="mesh_faulty",
        )
