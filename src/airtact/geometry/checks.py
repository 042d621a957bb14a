"""Checks of bodies: surfaces that cross themselves or are too thin, bodies that overlap.

Distances are those of the true, curved surfaces. They are measured between flat triangles, which
are split where they deviate from the true surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from weakref import WeakSet

import numpy as np

from airtact.errors import InvalidInput, counted, in_mm
from airtact.geometry.mesh.arrays import Corners, FlatMesh, Points, Vector3
from airtact.geometry.mesh.mesh_distance import (
    FirstCorners,
    SecondCorners,
    nearest_between,
    segment_distances,
    segment_to_triangle,
)
from airtact.geometry.mesh.quadratic_triangles import shape_functions
from airtact.geometry.mesh.remeshing import split_pieces
from airtact.geometry.mesh.topology import edge_twins, shells
from airtact.geometry.primitives import Capsule
from airtact.geometry.surface import Body, Surface

TOUCH = 1e-9
"""Distance below which bodies touch [m]."""
NEAREST = 0.3e-3
"""Smallest distance of two bodies [m]: panels cannot resolve less air between them."""
THINNEST = 0.5e-3
"""Smallest thickness of a body [m]."""
FLAT_TOLERANCE = 10e-6
"""Largest distance of ``flattened`` triangles from the true surface [m]."""

_MIDDLE_SHARE = 0.75
# Distance of the surface from the middle of a straight edge, over that from the middle of its
# triangle, at least.

# Surfaces never change, so one that passed is not checked again, wherever it moves.
_PASSED: WeakSet[Body] = WeakSet()


def check_surface(surface: Surface) -> None:
    """Check that a surface does not cross itself, has no nested pieces, and is thick enough."""
    if surface.body not in _PASSED:
        check_not_crossed(surface)
        part = thin_part(surface, THINNEST, short=THINNEST)
        if part is not None:
            thickness, where = part
            raise InvalidInput(
                f"the body is {thickness * 1e3:.3g} mm thick near {in_mm(where)}, less than "
                f"{THINNEST * 1e3:g} mm; make it thicker there, or cut that part off.",
                where,
                code="out_of_range",
            )
        _PASSED.add(surface.body)


def check_not_crossed(surface: Surface) -> None:
    """Check that a surface neither crosses nor touches itself, and has no piece inside another."""
    pairs = surface.crossings
    if len(pairs):
        first, second = pairs[0]
        where = surface.corners[pairs[0]].mean(axis=(0, 1))
        raise InvalidInput(
            f"the surface crosses itself: {_pairs_meet(len(pairs))}, the first are triangles "
            f"{first} and {second} near {in_mm(where)}; repair it.",
            where,
            code="mesh_faulty",
        )
    nested = surface.shape.nested_piece()
    if nested is not None:
        inner, outer, depth, where = nested
        raise InvalidInput(
            f"closed piece {inner} of {shells(surface.triangles).max() + 1} lies inside piece "
            f"{outer}, {depth * 1e3:.3g} mm deep near {in_mm(where)}: no sound gets there, so "
            "remove it.",
            where,
            code="mesh_faulty",
        )


def _pairs_meet(count: int) -> str:
    return counted(count, "pair of triangles meets", "pairs of triangles meet")


def thin_part(surface: Surface, thinnest: float, short: float) -> tuple[float, Vector3] | None:
    """Find a part of a body thinner than a length: its thickness [m] and its position (3,) [m].

    The thickness at a point is the diameter of the largest inner ball that touches the surface
    there and reaches surface of the opposite direction, to 20 degrees, so the edges of wedges are
    thick enough. A part counts if the body is not thick enough anywhere within ``short`` [m]:
    bumps, ribs and necks shorter than that pass. A tenth less passes too, because meshes are rough,
    or coarse on round bodies.
    """
    if surface.shape.least_thickness >= thinnest * (1.0 - 1e-9):
        return None
    if surface.shape.thinnest > 0.0:
        return surface.shape.thinnest, surface.vertices.mean(axis=0)
    from airtact.geometry.mesh.thickness import thin_position

    # Move each triangle to where the middle of its curved panel is: the weight of a mid-edge node
    # there is 4/9.
    corners = surface.corners
    straight = 0.5 * (corners + np.roll(corners, -1, axis=1))
    rise = 4.0 / 9.0 * (surface.quadratic_triangles[:, 3:] - straight).sum(axis=1)
    return thin_position(
        corners + rise[:, None], surface.triangles, surface.depth, 0.9 * thinnest, short
    )


# --- distances of bodies ----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Approach:
    """Distance of two bodies [m], a position (3,) between them [m], and how they overlap, if so."""

    distance: float
    position: Vector3
    overlap: str | None = None


def check_apart(surfaces: Sequence[Surface]) -> None:
    """Check that no bodies overlap, touch or come nearer than ``NEAREST``."""
    cure = (
        "move them apart, or merge them: airtact.geometry.merged([one, two]), in a scene file "
        "merge_bodies = true"
    )
    for i, j in combinations(range(len(surfaces)), 2):
        near = approach(surfaces[i], surfaces[j], NEAREST * (1.0 - 1e-9))
        if near is None:
            continue
        if near.overlap is not None:
            fault = f"overlap or touch: {near.overlap}"
        else:
            apart = f"{near.distance * 1e3:.3g} mm apart near {in_mm(near.position)}"
            fault = f"are {apart}, nearer than {NEAREST * 1e3:g} mm"
        raise InvalidInput(
            f"bodies {i} and {j} {fault}; {cure}.", near.position, code="bodies_overlap"
        )


def approach(first: Surface, second: Surface, within: float = np.inf) -> Approach | None:
    """Distance of the true surfaces of two bodies; None if it is ``within`` [m] or more.

    Capsules are measured exactly, meshes by their triangles and by which lies in the other.
    """
    match first.shape, second.shape:
        case Capsule() as capsule, Capsule() as other_capsule:
            distance, on_first, on_second = segment_distances(
                capsule.axis[None], other_capsule.axis[None]
            )
            near = _round_bodies(
                float(distance[0]), on_first[0], on_second[0], capsule.radius, other_capsule.radius
            )
        case Capsule() as capsule, _:
            near = _capsule_and_mesh(capsule, second, within)
        case _, Capsule() as capsule:
            near = _capsule_and_mesh(capsule, first, within)
        case _:
            near = _meshes(first, second, within)
    return near if near is not None and near.distance < within else None


def _round_bodies(
    distance: float, on_first: Vector3, on_second: Vector3, radius: float, other_radius: float
) -> Approach:
    """Approach of all points within radii of two bodies, from the closest points of these."""
    gap = distance - radius - other_radius
    middle = (
        on_first + (radius + gap / 2.0) * (on_second - on_first) / distance
        if distance > 0.0
        else on_first
    )
    if gap <= TOUCH:
        return Approach(0.0, middle, f"{-gap * 1e3:.3g} mm deep near {in_mm(middle)}")
    return Approach(gap, middle)


def _capsule_and_mesh(capsule: Capsule, mesh: Surface, within: float) -> Approach | None:
    from airtact.geometry.mesh.intersections import segment_triangle_distances

    corners = mesh.corners
    bulge = _bulge(mesh)
    axes = np.broadcast_to(capsule.axis, (len(corners), 2, 3))
    inside = max(float(mesh.depth(capsule.axis).max()), 0.0)
    distances = segment_triangle_distances(axes, corners)
    if inside == 0.0 and distances.min() >= capsule.radius + bulge + within:
        return None
    if bulge > FLAT_TOLERANCE:
        corners = corners_of(flattened(mesh))
        axes = np.broadcast_to(capsule.axis, (len(corners), 2, 3))
        distances = segment_triangle_distances(axes, corners)
    nearest = int(distances.argmin())
    if inside > 0.0 or distances[nearest] == 0.0:
        where = corners[nearest].mean(axis=0)
        deep = f"{(capsule.radius + inside) * 1e3:.3g} mm deep near {in_mm(where)}"
        return Approach(0.0, where, deep)
    distance, on_axis, on_mesh = segment_to_triangle(axes[[nearest]], corners[[nearest]])
    return _round_bodies(float(distance[0]), on_axis[0], on_mesh[0], capsule.radius, 0.0)


def _meshes(first: Surface, second: Surface, within: float) -> Approach | None:
    bulges = (_bulge(first), _bulge(second))
    low = np.maximum(first.vertices.min(axis=0), second.vertices.min(axis=0))
    high = np.minimum(first.vertices.max(axis=0), second.vertices.max(axis=0))
    if np.linalg.norm(np.maximum(low - high, 0.0)) >= within + sum(bulges):
        return None
    # A small body is first compared by its vertices: no point of a triangle is farther from its
    # corners than the longest edge over the square root of three.
    if len(first.vertices) <= 2000:
        between = float(first.edge_lengths.max()) / np.sqrt(3.0)
        if -second.depth(first.vertices).max() > within + max(bulges) + between:
            return None
    overlap = _wide_overlap(first, second, max(bulges))
    if overlap is not None:
        return overlap
    near = _triangles(first.corners, second.corners, within + sum(bulges))
    if near is not None and max(bulges) > FLAT_TOLERANCE:
        near = _triangles(corners_of(flattened(first)), corners_of(flattened(second)), within)
    if near is not None and near.overlap is not None:
        return near
    # Where no triangles cross, a piece of one body may lie wholly in the other.
    for inner, outer in ((first, second), (second, first)):
        first_triangles = np.unique(shells(inner.triangles), return_index=True)[1]
        nested = _deepest(inner.corners[first_triangles, 0], outer)
        if nested is not None:
            return nested
    return near


def _deepest(points: Points, body: Surface) -> Approach | None:
    """Overlap of a body with the deepest of some points; None if none is inside."""
    depth = body.depth(points)
    if not depth.max() > 0.0:
        return None
    where = points[depth.argmax()]
    deep = f"one lies {depth.max() * 1e3:.3g} mm inside the other near {in_mm(where)}"
    return Approach(0.0, where, deep)


def _wide_overlap(first: Surface, second: Surface, bulge: float) -> Approach | None:
    """Overlap that some 200 vertices show, before all triangles are compared.

    A body that is given twice has all its vertices on the surface of the other.
    """
    if (
        first.vertices.shape == second.vertices.shape
        and np.abs(first.vertices - second.vertices).max() <= TOUCH
    ):
        where = first.vertices[0]
        same = f"one has all its {len(first.vertices)} vertices on the other, near {in_mm(where)}"
        return Approach(0.0, where, same)
    for inner, outer in ((first, second), (second, first)):
        samples = inner.vertices[:: 1 + len(inner.vertices) // 200]
        if np.count_nonzero(outer.depth(samples) > bulge + TOUCH) > len(samples) // 5:
            return _deepest(samples, outer)
    return None


def _triangles(first: FirstCorners, second: SecondCorners, within: float) -> Approach | None:
    from airtact.geometry.mesh.intersections import crossings_between

    pairs = crossings_between(first, second)
    if len(pairs):
        where = first[pairs[0, 0]].mean(axis=0)
        return Approach(0.0, where, f"{_pairs_meet(len(pairs))}, the first near {in_mm(where)}")
    nearest = nearest_between(first, second, within)
    return None if nearest is None else Approach(nearest[0], (nearest[1] + nearest[2]) / 2.0)


# --- flat triangles close to the true surface -------------------------------------------------


def _bulge(surface: Surface) -> float:
    """Largest distance of the true surface from the flat triangles of a mesh [m]."""
    straight = 0.5 * (surface.corners + np.roll(surface.corners, -1, axis=1))
    rise = np.linalg.norm(surface.quadratic_triangles[:, 3:] - straight, axis=2)
    return float(rise.max()) / _MIDDLE_SHARE


def corners_of(mesh: FlatMesh) -> Corners:
    """Corners (T, 3, 3) of the triangles of a mesh [m]."""
    vertices, triangles = mesh
    return vertices[triangles]


def flattened(surface: Surface) -> FlatMesh:
    """Flat triangles within ``FLAT_TOLERANCE`` of the true surface: its own, split where needed."""
    exact = surface.shape.flat_mesh(FLAT_TOLERANCE)
    if exact is not None:
        return exact
    pieces = split_pieces([[3, 1, 4], [0, 3, 4], [0, 4, 2]])
    vertices = surface.vertices
    triangles = surface.triangles
    # Each piece knows its panel and the reference coordinates of its corners on it.
    parent = np.arange(len(triangles))
    references = np.broadcast_to([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], (len(triangles), 3, 2))
    while True:
        between = 0.5 * (references + np.roll(references, -1, axis=1))
        shape = shape_functions(between.reshape(-1, 2)).reshape(-1, 3, 6)
        middles = np.einsum("ten,tnd->ted", shape, surface.quadratic_triangles[parent])
        corners = vertices[triangles]
        rise = np.linalg.norm(middles - 0.5 * (corners + np.roll(corners, -1, axis=1)), axis=2)
        twins = edge_twins(triangles)
        split = rise > _MIDDLE_SHARE * FLAT_TOLERANCE
        split |= split.ravel()[twins]
        if not split.any():
            return vertices, triangles
        # The middle of an edge is numbered once, by the first of its two triangles.
        once = split & (np.arange(split.size).reshape(-1, 3) < twins)
        number = np.zeros(split.shape, dtype=np.int64)
        number[once] = len(vertices) + np.arange(np.count_nonzero(once))
        number = np.maximum(number, number.ravel()[twins])
        vertices = np.concatenate([vertices, middles[once]])
        pattern = split @ np.array([1, 2, 4])
        nodes = []
        rows = []
        for bits in (0, 7, 1, 3, 2, 6, 4, 5):
            chosen = np.flatnonzero(pattern == bits)
            nodes.append(np.tile(pieces[bits], (len(chosen), 1)))
            rows.append(np.repeat(chosen, len(pieces[bits])))
        node = np.concatenate(nodes).astype(np.int64)
        row = np.concatenate(rows)
        triangles = np.concatenate([triangles, number], axis=1)[row[:, None], node]
        references = np.concatenate([references, between], axis=1)[row[:, None], node]
        parent = parent[row]
