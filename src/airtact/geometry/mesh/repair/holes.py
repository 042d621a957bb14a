"""Holes of a triangle mesh: their rims, whether they may be filled, and the mesh with them filled, on plain arrays.

A hole is filled only where the surface round it shows what is missing: it is narrow, and the
surface leans so little out of its plane that even a cone drawn on from the rim would add next to
nothing to the body. The open end of a tube, a single loose triangle or a lost fingertip lean too
much, and raise an error.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist

from airtact.checks import counted, in_mm
from airtact.errors import InvalidInput
from airtact.geometry.mesh.quadratic_triangles import area_vectors, unit
from airtact.geometry.mesh.repair.hole_filling import patch
from airtact.geometry.mesh.topology import (
    Numbers,
    Triangles,
    Twins,
    Vertices,
    cone_volumes,
    edge_keys,
    edge_twins,
    shells,
)

LARGEST_SHARE = 5e-3
"""Share of a body's volume that may be missing with its holes."""
FACING = 0.5
"""Cosine of the angle (60 degrees) off straight ahead within which two near holes face each other."""
STEEPEST = 0.17
"""Cosine of the largest mean angle (80 degrees) between the surface round a hole and the plane of the hole."""
MOST_EDGES = 400
"""Longest rim of a hole that is filled."""


@dataclass(frozen=True, eq=False)
class Hole:
    """A hole of a mesh.

    Its ``rim`` (N,) are vertices in the direction of the triangles that would fill it, ``beside``
    (N,) the triangles beside the edge from each to the next; ``width`` is the largest distance of
    two of them, ``middle`` their mean [m].
    """

    rim: Int64[np.ndarray, "rim"]
    beside: Int64[np.ndarray, "rim"]
    width: float
    middle: Float64[np.ndarray, "3"]


def without_holes(
    vertices: Vertices, triangles: Triangles, largest: float, notes: list[str]
) -> Int64[np.ndarray, "more 3"]:
    """Fill the holes, at most ``largest`` [m] wide, of a mesh whose neighbours run alike.

    Holes are errors that are too wide, whose missing part is unknown, or that no triangles over
    their vertices close.
    """
    holes = find_holes(vertices, triangles)
    if not holes:
        return triangles
    _check_wide(holes, largest)
    normals = unit(area_vectors(vertices[triangles]))
    missing = np.array([_missing(vertices, normals, hole) for hole in holes])
    _check_none(
        [hole for hole, volume in zip(holes, missing, strict=True) if not np.isfinite(volume)],
        "cannot be filled, because the surface round it runs out of its plane: what is missing there is unknown",
    )
    keys = np.unique(edge_keys(triangles))
    count = int(triangles.max()) + 1
    fillings = [patch(vertices, hole.rim, normals[hole.beside], keys, count) for hole in holes]
    unfilled = [hole for hole, filling in zip(holes, fillings, strict=True) if filling is None]
    no_way = "cannot be filled without meeting the surface again"
    _check_none(unfilled, no_way)
    whole = np.concatenate([triangles, *(filling for filling in fillings if filling is not None)])
    twins = edge_twins(whole)
    _check_none([hole for hole in holes if _still_open(hole, whole, twins)], no_way)
    _check_doubtful(vertices, whole, twins, holes, missing)
    up_to = f"of up to {max(hole.width for hole in holes) * 1e3:.2g} mm"
    filled = counted(len(holes), f"hole {up_to} was", f"holes {up_to} were")
    notes.append(f"{filled} filled, the first near {in_mm(holes[0].middle)}.")
    return whole


def _check_wide(holes: list[Hole], largest: float) -> None:
    wide = [hole for hole in holes if hole.width > largest]
    if wide:
        widest = max(wide, key=lambda hole: hole.width)
        are = counted(len(wide), "hole is", "holes are")
        raise InvalidInput(
            f"the surface is open: {are} wider than {largest * 1e3:g} mm, the largest {widest.width * 1e3:.3g} mm "
            f"across near {in_mm(widest.middle)}; close it in the file, or let wider ones be filled with largest_hole.",
            widest.middle,
            code="mesh_faulty",
        )
    long = [hole for hole in holes if len(hole.rim) > MOST_EDGES]
    _check_none(long, f"of more than {MOST_EDGES} edges cannot be filled")


def _ahead(vertices: Vertices, hole: Hole) -> Float64[np.ndarray, "3"]:
    """Find the area vector of a hole, over its length: which way its filling will look."""
    points = vertices[hole.rim] - hole.middle
    area = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0) / 2.0
    return area / max(float(np.linalg.norm(area)), 1e-30)


def _check_none(holes: list[Hole], fault: str) -> None:
    if holes:
        widest = max(holes, key=lambda hole: hole.width)
        raise InvalidInput(
            f"the surface is open: {counted(len(holes), 'hole', 'holes')} {fault}, the largest "
            f"{widest.width * 1e3:.3g} mm across near {in_mm(widest.middle)}; close it in the file.",
            widest.middle,
            code="mesh_faulty",
        )


def _check_doubtful(
    vertices: Vertices,
    whole: Triangles,
    twins: Twins,
    holes: list[Hole],
    missing: Float64[np.ndarray, "holes"],
) -> None:
    """Check that no holes face each other or may have taken an audible share of their body."""
    piece = shells(whole, twins)
    volumes = np.bincount(piece, weights=cone_volumes(vertices[whole]))
    where = piece[[hole.beside[0] for hole in holes]]
    turned = np.sign(volumes[where])  # a body that is still inside out looks the other way
    _check_facing(holes, turned[:, None] * [_ahead(vertices, hole) for hole in holes])
    share = np.bincount(where, weights=missing, minlength=len(volumes)) / np.maximum(
        np.abs(volumes), 1e-30
    )
    worst = float(share.max())
    if worst > LARGEST_SHARE:
        here = [
            hole for hole, number in zip(holes, where, strict=True) if share[number] > LARGEST_SHARE
        ]
        _check_none(
            here,
            f"may have taken {100 * worst:.2g} % of a body's volume, more than {100 * LARGEST_SHARE:g} %",
        )


def _check_facing(holes: list[Hole], ahead: Float64[np.ndarray, "holes 3"]) -> None:
    """Check that no bridge is missing between holes: filled, they would part what belongs together."""
    middles = np.array([hole.middle for hole in holes])
    widths = np.array([hole.width for hole in holes])
    pairs = KDTree(middles).query_pairs(float(widths.max()), output_type="ndarray")
    way = middles[pairs[:, 1]] - middles[pairs[:, 0]]
    gap = np.linalg.norm(way, axis=1)
    faces = np.einsum("pi,pi->p", ahead[pairs[:, 0]], way) > FACING * gap
    faces &= np.einsum("pi,pi->p", ahead[pairs[:, 1]], -way) > FACING * gap
    faces &= gap < widths[pairs].max(axis=1)
    if faces.any():
        first = int(faces.argmax())
        between = middles[pairs[first]].mean(axis=0)
        raise InvalidInput(
            f"the surface is open: {counted(int(faces.sum()), 'pair of holes faces', 'pairs of holes face')} each "
            f"other, the first {gap[first] * 1e3:.2g} mm apart near {in_mm(between)}, so "
            "the bridge between them may be missing; close them in the file.",
            between,
            code="mesh_faulty",
        )


def _still_open(hole: Hole, whole: Triangles, twins: Twins) -> bool:
    torn = (twins < 0).any(axis=1)
    return bool(torn.any()) and bool(np.isin(whole[torn], hole.rim).any())


def _missing(vertices: Vertices, normals: Float64[np.ndarray, "triangles 3"], hole: Hole) -> float:
    """Volume of the cone that the surface round a hole closes to if it goes on straight [m³]; infinite for a tube."""
    points = vertices[hole.rim] - hole.middle
    after = np.roll(points, -1, axis=0)
    ahead = _ahead(vertices, hole)
    size = float(ahead @ np.cross(points, after).sum(axis=0)) / 2.0
    lengths = np.linalg.norm(after - points, axis=1)
    cosine = float(lengths @ (normals[hole.beside] @ ahead)) / max(float(lengths.sum()), 1e-30)
    if cosine < STEEPEST:
        return np.inf
    tangent = np.sqrt(max(1.0 - cosine**2, 0.0)) / cosine
    return size * hole.width / 2.0 * float(tangent) / 3.0


def find_holes(vertices: Vertices, triangles: Triangles) -> list[Hole]:
    """Walk along the borders of a mesh whose neighbours run alike.

    Where several holes meet in a vertex, the walk takes the border that comes next round that
    vertex, so that it goes round one gap at a time.
    """
    border = np.flatnonzero(edge_twins(triangles).ravel() < 0)
    starts = np.roll(triangles, -1, axis=1).ravel()[
        border
    ]  # a hole runs against the triangles beside it
    ends = triangles.ravel()[border]
    after = _next_edges(vertices, triangles, starts, ends)
    holes, seen = [], np.zeros(len(border), dtype=bool)
    for first in range(len(border)):
        if seen[first]:
            continue
        walk = []
        here = first
        while not seen[here]:
            seen[here] = True
            walk.append(here)
            here = int(after[here])
        rim = starts[walk]
        points = vertices[rim]
        holes.append(Hole(rim, border[walk] // 3, _width(points), points.mean(axis=0)))
    return holes


def _next_edges(
    vertices: Vertices, triangles: Triangles, starts: Numbers, ends: Numbers
) -> Numbers:
    """Which border edge follows each along its hole, by the vertices at which they start and end."""
    order = np.argsort(starts, kind="stable")
    ranked = starts[order]
    after = order[np.searchsorted(ranked, ends)]
    meeting = ranked[1:][ranked[1:] == ranked[:-1]]
    for vertex in np.unique(meeting):
        coming, going = np.flatnonzero(ends == vertex), np.flatnonzero(starts == vertex)
        normal = unit(area_vectors(vertices[triangles[(triangles == vertex).any(axis=1)]])).sum(
            axis=0
        )
        one = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        two = np.cross(normal, one) / max(float(np.linalg.norm(normal)), 1e-300)
        away = vertices[np.r_[starts[coming], ends[going]]] - vertices[vertex]
        angle = np.arctan2(away @ two, away @ one)
        clockwise = (angle[: len(coming), None] - angle[None, len(coming) :]) % (2.0 * np.pi)
        after[coming] = _matched(going, clockwise)
    return after


def _matched(
    going: Int64[np.ndarray, "pairs"], turn: Float64[np.ndarray, "pairs pairs"]
) -> Int64[np.ndarray, "pairs"]:
    """Give each coming edge its own going edge, the least turn first."""
    chosen = np.zeros(len(going), dtype=np.int64)
    for _ in range(len(going)):
        one, two = np.unravel_index(int(turn.argmin()), turn.shape)
        chosen[one] = going[two]
        turn[one], turn[:, two] = np.inf, np.inf
    return chosen


def _width(points: Float64[np.ndarray, "rim 3"]) -> float:
    if len(points) <= MOST_EDGES:
        return float(pdist(points).max())
    far = points[
        np.linalg.norm(points - points[0], axis=1).argmax()
    ]  # two sweeps are near enough for an error
    return float(np.linalg.norm(points - far, axis=1).max())
