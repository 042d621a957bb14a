"""Fills small holes of a triangle mesh where the surface around them shows what is missing.

A hole is filled if it is narrow and the surface around it leans so little out of its plane that
even a cone continued from the rim would add next to nothing to the body. The open end of a tube, a
single loose triangle or a lost fingertip lean too much and raise an error.

All triangulations of the rim are weighed by dynamic programming, after G. Barequet and M. Sharir,
"Filling gaps in the boundary of a polyhedron", CAGD 12, 1995, and P. Liepa, "Filling holes in
meshes", SGP 2003. The weight is the sum of the angles at all edges, including those towards the
surface around the hole. A sharp edge of the body continues through the hole, because one sharp fold
weighs less than many half-sharp ones.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist

from airtact.errors import InvalidInput, counted, in_mm
from airtact.geometry.mesh.arrays import (
    Indices,
    NewTriangles,
    Triangles,
    TriangleVectors,
    Twins,
    Vector3,
    Vertices,
)
from airtact.geometry.mesh.quadratic_triangles import area_vectors, unit
from airtact.geometry.mesh.topology import cone_volumes, edge_keys, edge_twins, shells

MAX_RIM_EDGES = 400
"""Longest rim of a hole that is filled: the time grows with its cube."""


@dataclass(frozen=True, eq=False)
class Hole:
    """A hole of a mesh.

    Attributes
    ----------
    rim : (N,) vertices, in the direction of the triangles that would fill it.
    beside : (N,) triangle beside the edge from each vertex to the next.
    width : largest distance of two of the vertices [m].
    middle : (3,) their mean [m].
    """

    rim: Int64[np.ndarray, "rim"]
    beside: Int64[np.ndarray, "rim"]
    width: float
    middle: Vector3


def without_holes(
    vertices: Vertices, triangles: Triangles, largest: float, notes: list[str]
) -> NewTriangles:
    """Fill the holes, at most ``largest`` [m] wide, of a consistently oriented mesh.

    Holes that are wider, whose missing part is unknown, or that no triangles over their vertices
    close, raise ``InvalidInput``.
    """
    holes = find_holes(vertices, triangles)
    if not holes:
        return triangles
    wide = [hole for hole in holes if hole.width > largest]
    _check_none(
        wide,
        f"of over {largest * 1e3:g} mm",
        "let wider ones be filled with largest_hole, or close it in the file",
    )
    long = [hole for hole in holes if len(hole.rim) > MAX_RIM_EDGES]
    _check_none(long, f"of more than {MAX_RIM_EDGES} edges")
    normals = unit(area_vectors(vertices[triangles]))
    missing = np.array([_missing_volume(vertices, normals, hole) for hole in holes])
    unknown = [hole for hole, volume in zip(holes, missing, strict=True) if not np.isfinite(volume)]
    _check_none(unknown, "where the surface leans out of the hole, so what is missing is unknown")
    keys = np.unique(edge_keys(triangles))
    count = int(triangles.max()) + 1
    fillings = [_patch(vertices, hole.rim, normals[hole.beside], keys, count) for hole in holes]
    no_way = "that no triangles close without meeting the surface again"
    _check_none(
        [hole for hole, filling in zip(holes, fillings, strict=True) if filling is None], no_way
    )
    filled = np.concatenate([triangles, *(filling for filling in fillings if filling is not None)])
    twins = edge_twins(filled)
    torn = filled[(twins < 0).any(axis=1)]
    _check_none([hole for hole in holes if np.isin(torn, hole.rim).any()], no_way)
    _check_doubtful(vertices, filled, twins, holes, missing)
    up_to = f"of up to {max(hole.width for hole in holes) * 1e3:.2g} mm"
    were = counted(len(holes), f"hole {up_to} was", f"holes {up_to} were")
    notes.append(f"{were} filled, the first near {in_mm(holes[0].middle)}.")
    return filled


def _check_none(holes: list[Hole], fault: str, cure: str = "close it in the file") -> None:
    if holes:
        widest = max(holes, key=lambda hole: hole.width)
        raise InvalidInput(
            f"the surface is open: {counted(len(holes), 'hole', 'holes')} {fault}, the largest "
            f"{widest.width * 1e3:.3g} mm across near {in_mm(widest.middle)}; {cure}.",
            widest.middle,
            code="mesh_faulty",
        )


def _direction(vertices: Vertices, hole: Hole) -> Vector3:
    """Find the unit normal of the filling of a hole."""
    points = vertices[hole.rim] - hole.middle
    area = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0) / 2.0
    return area / max(float(np.linalg.norm(area)), 1e-30)


def _missing_volume(vertices: Vertices, normals: TriangleVectors, hole: Hole) -> float:
    """Volume of the cone that continues the surface around a hole [m³]; infinite for a tube."""
    points = vertices[hole.rim] - hole.middle
    after = np.roll(points, -1, axis=0)
    direction = _direction(vertices, hole)
    area = float(direction @ np.cross(points, after).sum(axis=0)) / 2.0
    lengths = np.linalg.norm(after - points, axis=1)
    weighted = float(lengths @ (normals[hole.beside] @ direction))
    cosine = weighted / max(float(lengths.sum()), 1e-30)
    if cosine < 0.17:  # the surface leans by over 80 degrees in the mean
        return np.inf
    tangent = np.sqrt(max(1.0 - cosine**2, 0.0)) / cosine
    return area * hole.width / 2.0 * float(tangent) / 3.0


def _check_doubtful(
    vertices: Vertices,
    filled: Triangles,
    twins: Twins,
    holes: list[Hole],
    missing: Float64[np.ndarray, "holes"],
) -> None:
    """Check that no holes face each other and no body may have lost 0.5 % of its volume."""
    piece = shells(filled, twins)
    volumes = np.bincount(piece, weights=cone_volumes(vertices[filled]))
    body = piece[[hole.beside[0] for hole in holes]]
    outward = np.sign(volumes[body])  # bodies that are inside out are turned only later
    _check_facing(holes, outward[:, None] * [_direction(vertices, hole) for hole in holes])
    lost = np.bincount(body, weights=missing, minlength=len(volumes))
    share = lost / np.maximum(np.abs(volumes), 1e-30)
    max_share = 5e-3
    doubtful = [hole for hole, number in zip(holes, body, strict=True) if share[number] > max_share]
    _check_none(
        doubtful,
        f"with which up to {100 * share.max():.2g} % of a body's volume may be missing, more than "
        f"{100 * max_share:g} %",
    )


def _check_facing(holes: list[Hole], direction: Float64[np.ndarray, "holes 3"]) -> None:
    """Check that no bridge is missing between holes: filling them would separate its ends."""
    middles = np.array([hole.middle for hole in holes])
    widths = np.array([hole.width for hole in holes])
    pairs = KDTree(middles).query_pairs(float(widths.max()), output_type="ndarray")
    between = middles[pairs[:, 1]] - middles[pairs[:, 0]]
    gap = np.linalg.norm(between, axis=1)
    # Two near holes face each other if each lies within 60 degrees of the other's direction.
    faces = np.einsum("pi,pi->p", direction[pairs[:, 0]], between) > 0.5 * gap
    faces &= np.einsum("pi,pi->p", direction[pairs[:, 1]], -between) > 0.5 * gap
    faces &= gap < widths[pairs].max(axis=1)
    if faces.any():
        first = int(faces.argmax())
        where = middles[pairs[first]].mean(axis=0)
        face = counted(int(faces.sum()), "pair of holes faces", "pairs of holes face")
        raise InvalidInput(
            f"the surface is open: {face} each other, "
            f"the first {gap[first] * 1e3:.2g} mm apart near {in_mm(where)}, so the bridge between "
            "them may be missing; close them in the file.",
            where,
            code="mesh_faulty",
        )


def find_holes(vertices: Vertices, triangles: Triangles) -> list[Hole]:
    """Walk along the borders of a consistently oriented mesh.

    Where several holes meet in a vertex, the walk takes the border that comes next around that
    vertex, so that it goes around one gap at a time.
    """
    border = np.flatnonzero(edge_twins(triangles).ravel() < 0)
    # A hole runs against the triangles beside it.
    starts = np.roll(triangles, -1, axis=1).ravel()[border]
    ends = triangles.ravel()[border]
    after = _next_edges(vertices, triangles, starts, ends)
    holes = []
    seen = np.zeros(len(border), dtype=bool)
    for first in range(len(border)):
        if seen[first]:
            continue
        walk = []
        edge = first
        while not seen[edge]:
            seen[edge] = True
            walk.append(edge)
            edge = int(after[edge])
        points = vertices[starts[walk]]
        if len(points) <= MAX_RIM_EDGES:
            width = float(pdist(points).max())
        else:  # two sweeps are accurate enough for an error
            farthest = points[np.linalg.norm(points - points[0], axis=1).argmax()]
            width = float(np.linalg.norm(points - farthest, axis=1).max())
        holes.append(Hole(starts[walk], border[walk] // 3, width, points.mean(axis=0)))
    return holes


def _next_edges(
    vertices: Vertices, triangles: Triangles, starts: Indices, ends: Indices
) -> Indices:
    """Border edge that follows each along its hole, given their start and end vertices."""
    order = np.argsort(starts, kind="stable")
    ranked = starts[order]
    after = order[np.searchsorted(ranked, ends)]
    meeting = ranked[1:][ranked[1:] == ranked[:-1]]
    for vertex in np.unique(meeting):
        coming = np.flatnonzero(ends == vertex)
        going = np.flatnonzero(starts == vertex)
        around = vertices[triangles[(triangles == vertex).any(axis=1)]]
        normal = unit(area_vectors(around)).sum(axis=0)
        x_axis = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        y_axis = np.cross(normal, x_axis) / max(float(np.linalg.norm(normal)), 1e-300)
        away = vertices[np.r_[starts[coming], ends[going]]] - vertices[vertex]
        angle = np.arctan2(away @ y_axis, away @ x_axis)
        clockwise = (angle[: len(coming), None] - angle[None, len(coming) :]) % (2.0 * np.pi)
        # Give each incoming edge its own outgoing edge, the smallest turn first.
        for _ in range(len(going)):
            row, column = np.unravel_index(int(clockwise.argmin()), clockwise.shape)
            after[coming[row]] = going[column]
            clockwise[row] = np.inf
            clockwise[:, column] = np.inf
    return after


def _patch(
    vertices: Vertices,
    rim: Int64[np.ndarray, "rim"],
    beside: Float64[np.ndarray, "rim 3"],
    edges: Int64[np.ndarray, "edges"],
    count: int,
) -> Int64[np.ndarray, "_ 3"] | None:
    """Triangulate the rim of a hole over its own vertices; None if every way repeats an edge.

    ``beside`` are the unit normals beside the edge from each rim vertex to the next; ``edges`` are
    the sorted keys low * ``count`` + high of the edges of the mesh.
    """
    size = len(rim)
    points = vertices[rim]
    lengths = np.linalg.norm(points[:, None] - points[None], axis=2)
    # Chords that the mesh already has as an edge, or that lead from a vertex to itself.
    low = np.minimum(rim[:, None], rim[None])
    high = np.maximum(rim[:, None], rim[None])
    keys = low * count + high
    match = np.minimum(np.searchsorted(edges, keys), len(edges) - 1)
    barred = (edges[match] == keys) | (low == high)
    # cost[i, j] is the smallest weight of a triangulation between rim vertices i and j,
    # normal[i, j] the normal of its triangle over the chord ij, split[i, j] the third corner of
    # that triangle.
    cost = np.full((size, size), np.inf)
    normal = np.zeros((size, size, 3))
    split = np.zeros((size, size), dtype=np.int64)
    index = np.arange(size - 1)
    cost[index, index + 1] = 0.0
    normal[index, index + 1] = beside[:-1]
    for gap in range(2, size):
        row = np.arange(size - gap)
        first = row[:, None]
        middle = first + np.arange(1, gap)[None]
        last = first + gap
        facing = np.cross(points[middle] - points[first], points[last] - points[first])
        twice_area = np.linalg.norm(facing, axis=2)
        facing = facing / np.maximum(twice_area, 1e-300)[:, :, None]
        longest = np.maximum(lengths[first, middle], lengths[middle, last])
        thin = twice_area <= 1e-3 * np.maximum(longest, lengths[first, last]) ** 2
        # A triangle without area weighs 100 rad: it is taken only where there is nothing else.
        weight = cost[first, middle] + cost[middle, last] + 100.0 * thin
        weight += _angles(facing, normal[first, middle]) + _angles(facing, normal[middle, last])
        if gap == size - 1:
            weight += _angles(facing, np.broadcast_to(beside[-1], facing.shape))
        best = weight.argmin(axis=1)
        # Of similar patches, prefer short edges: one as long as the hole is wide weighs 0.05 rad.
        chords = 0.05 * lengths[row, row + gap] / lengths.max()
        cost[row, row + gap] = weight[row, best] + chords
        normal[row, row + gap] = facing[row, best]
        split[row, row + gap] = middle[row, best]
        if gap < size - 1:
            used = row[barred[row, row + gap]]
            cost[used, used + gap] = np.inf
    if not np.isfinite(cost[0, size - 1]):
        return None
    filling = []
    open_chords = [(0, size - 1)]
    while open_chords:
        start, end = open_chords.pop()
        if end - start >= 2:
            third = int(split[start, end])
            filling.append((start, third, end))
            open_chords += [(start, third), (third, end)]
    return rim[np.array(filling, dtype=np.int64)]


def _angles(
    first: Float64[np.ndarray, "rows columns 3"], second: Float64[np.ndarray, "rows columns 3"]
) -> Float64[np.ndarray, "rows columns"]:
    return np.arccos(np.clip(np.einsum("rsi,rsi->rs", first, second), -1.0, 1.0))
