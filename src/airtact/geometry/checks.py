"""Checks that take a tree: surfaces that cross themselves or are too thin, bodies that overlap or are too near."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from weakref import WeakSet

import numpy as np
from jaxtyping import Float64

from airtact.checks import counted, in_mm
from airtact.errors import InvalidInput
from airtact.geometry.flattening import AWAY, bulge, corners_of, flattened
from airtact.geometry.mesh.intersections import crossings_between, segment_triangle_distances
from airtact.geometry.mesh.mesh_distance import (
    nearest_between,
    segment_distances,
    segment_to_triangle,
)
from airtact.geometry.mesh.thickness import thin_position
from airtact.geometry.mesh.topology import shells
from airtact.geometry.primitives import Capsule
from airtact.geometry.surface import Body, Surface

TOUCH = 1e-9
"""Bodies nearer than this touch [m]."""

NEAREST = 0.3e-3
"""Bodies nearer than this are rejected [m]: no panels are small enough to face each other across so little air."""

THINNEST = 0.5e-3
"""Bodies thinner than this are rejected [m]."""

ROUGH = 0.1
"""Share of a thickness that may be missing in a mesh."""

FEW = 2000
"""A body with so many vertices at most is compared by them first."""

SAMPLES = 200
"""Vertices that show a wide overlap."""

_PASSED: WeakSet[Body] = (
    WeakSet()
)  # surfaces never change, so one that passed is not checked again, wherever it moves

APART = "move them apart, or merge them: airtact.geometry.merged([one, two]), in a scene file merge_bodies = true"


def check_surface(surface: Surface) -> None:
    """Check that a surface does not cross itself, has no closed piece inside another, and is thick enough."""
    if surface.body not in _PASSED:
        check_not_crossed(surface)
        check_not_thin(surface)
        _PASSED.add(surface.body)


def check_not_crossed(surface: Surface) -> None:
    """Check that a surface neither crosses nor touches itself, and has no closed piece inside another."""
    pairs = surface.crossings
    if len(pairs):
        first = pairs[0]
        where = surface.corners[first].mean(axis=(0, 1))
        meet = counted(len(pairs), "pair of triangles meets", "pairs of triangles meet")
        which = f"triangles {int(first[0])} and {int(first[1])}"
        raise InvalidInput(
            f"the surface crosses itself: {meet}, the first are {which} near {in_mm(where)}; repair it.",
            where,
            code="mesh_faulty",
        )
    nested = surface.shape.nested_piece()
    if nested is not None:
        inner, outer, depth, where = nested
        raise InvalidInput(
            f"closed piece {inner} of {shells(surface.triangles).max() + 1} lies inside piece {outer}, "
            f"{depth * 1e3:.3g} mm deep near {in_mm(where)}: no sound gets there, so remove it.",
            where,
            code="mesh_faulty",
        )


def check_not_thin(surface: Surface) -> None:
    """Check that a body is nowhere thinner than ``THINNEST``; the edges of wedges are no fault.

    The thickness at a point of the surface is the diameter of the largest ball inside that touches
    the surface there and reaches surface which looks the other way, to 20 degrees. Bumps, ribs and
    necks shorter than the length pass, and a tenth less, for meshes that are rough, or coarse on
    round bodies.
    """
    found = thin_part(surface, THINNEST, short=THINNEST)
    if found is not None:
        raise InvalidInput(
            f"the body is {found[0] * 1e3:.3g} mm thick near {in_mm(found[1])}, less than {THINNEST * 1e3:g} mm; make "
            "it thicker there, or cut that part off.",
            found[1],
            code="out_of_range",
        )


def thin_part(
    surface: Surface, thinnest: float, short: float
) -> tuple[float, Float64[np.ndarray, "3"]] | None:
    """Find where a body is thinner than a length, as in ``check_not_thin``: how thin it is [m], and where (3,) [m].

    Thin parts count where the body is nowhere thick enough within the distance ``short`` [m].
    """
    if surface.shape.least_thickness >= thinnest * (1.0 - 1e-9):
        return None
    if surface.shape.thinnest > 0.0:
        return surface.shape.thinnest, surface.vertices.mean(axis=0)
    return thin_position(
        _curved_out(surface), surface.triangles, surface.depth, (1.0 - ROUGH) * thinnest, short
    )


def _curved_out(surface: Surface) -> Float64[np.ndarray, "triangles 3 3"]:
    """Corners of the triangles, each moved to where the middle of its curved panel is."""
    straight = 0.5 * (surface.corners + np.roll(surface.corners, -1, axis=1))
    rise = (
        4.0 / 9.0 * (surface.quadratic_triangles[:, 3:] - straight).sum(axis=1)
    )  # the shape functions at the middle
    return surface.corners + rise[:, None]


@dataclass(frozen=True, eq=False)
class Approach:
    """Distance of two bodies [m], a position (3,) between them [m], and in words how they overlap, if they do."""

    distance: float
    position: Float64[np.ndarray, "3"]
    overlap: str | None = None


def check_apart(surfaces: Sequence[Surface]) -> None:
    """Check that no bodies overlap, touch or come nearer than ``NEAREST``.

    Two capsules are measured exactly, a capsule and a mesh by the mesh's triangles, two meshes by
    their triangles and by which lies in the other.
    """
    for i, j in combinations(range(len(surfaces)), 2):
        found = approach(surfaces[i], surfaces[j], NEAREST * (1.0 - 1e-9))
        if found is not None and found.overlap is not None:
            raise InvalidInput(
                f"bodies {i} and {j} overlap or touch: {found.overlap}; {APART}.",
                found.position,
                code="bodies_overlap",
            )
        if found is not None:
            raise InvalidInput(
                f"bodies {i} and {j} are {found.distance * 1e3:.3g} mm apart near {in_mm(found.position)}, nearer than "
                f"{NEAREST * 1e3:g} mm; {APART}.",
                found.position,
                code="bodies_overlap",
            )


def approach(one: Surface, two: Surface, within: float = np.inf) -> Approach | None:
    """Find how near the true surfaces of two bodies come, or None when they stay ``within`` [m] or more apart."""
    match one.shape, two.shape:
        case Capsule() as rod, Capsule() as other:
            distance, here, there = segment_distances(rod.axis[None], other.axis[None])
            found = _round_bodies(float(distance[0]), here[0], there[0], rod.radius, other.radius)
        case Capsule() as rod, _:
            found = _capsule_and_mesh(rod, two, within)
        case _, Capsule() as rod:
            found = _capsule_and_mesh(rod, one, within)
        case _:
            found = _meshes(one, two, within)
    return found if found is not None and found.distance < within else None


def _round_bodies(
    distance: float,
    here: Float64[np.ndarray, "3"],
    there: Float64[np.ndarray, "3"],
    radius: float,
    other: float,
) -> Approach:
    """Find how near all points within a radius of two bodies come that are nearest at two points."""
    gap = distance - radius - other
    middle = here + (radius + gap / 2.0) * (there - here) / distance if distance > 0.0 else here
    if gap <= TOUCH:
        return Approach(0.0, middle, f"{-gap * 1e3:.3g} mm deep near {in_mm(middle)}")
    return Approach(gap, middle)


def _capsule_and_mesh(rod: Capsule, mesh: Surface, within: float) -> Approach | None:
    corners, rise = mesh.corners, bulge(mesh)
    axes = np.broadcast_to(rod.axis, (len(corners), 2, 3))
    inside = max(float(mesh.depth(rod.axis).max()), 0.0)
    if (
        inside == 0.0
        and segment_triangle_distances(axes, corners).min() >= rod.radius + rise + within
    ):
        return None
    if rise > AWAY:
        corners = corners_of(flattened(mesh))
        axes = np.broadcast_to(rod.axis, (len(corners), 2, 3))
    distances = segment_triangle_distances(axes, corners)
    nearest = int(distances.argmin())
    if inside > 0.0 or distances[nearest] == 0.0:
        where = corners[nearest].mean(axis=0)
        return Approach(
            0.0, where, f"{(rod.radius + inside) * 1e3:.3g} mm deep near {in_mm(where)}"
        )
    distance, here, there = segment_to_triangle(
        axes[nearest : nearest + 1], corners[nearest : nearest + 1]
    )
    return _round_bodies(float(distance[0]), here[0], there[0], rod.radius, 0.0)


def _meshes(one: Surface, two: Surface, within: float) -> Approach | None:
    rises = bulge(one), bulge(two)
    low, high = (
        np.stack([end(body.vertices, axis=0) for body in (one, two)]) for end in (np.min, np.max)
    )
    if np.linalg.norm(np.maximum(low.max(axis=0) - high.min(axis=0), 0.0)) >= within + sum(rises):
        return None
    if _clearly_apart(one, two, within + max(rises)):
        return None
    deep = _deeply_overlapping(one, two, max(rises))
    if deep is not None:
        return deep
    found = _triangles(one.corners, two.corners, within + sum(rises))
    if found is not None and max(rises) > AWAY:
        found = _triangles(corners_of(flattened(one)), corners_of(flattened(two)), within)
    if found is not None and found.overlap is not None:
        return found
    for inner, outer in ((one, two), (two, one)):
        seeds = inner.corners[np.unique(shells(inner.triangles), return_index=True)[1], 0]
        depth = outer.depth(seeds)
        if depth.max() > 0.0:
            where = seeds[depth.argmax()]
            lies = f"one lies {depth.max() * 1e3:.3g} mm inside the other near {in_mm(where)}"
            return Approach(0.0, where, lies)
    return found


def _clearly_apart(one: Surface, two: Surface, within: float) -> bool:
    """Whether the vertices of a body are so far from another that no point between them comes near."""
    if len(one.vertices) > FEW:
        return False
    between = float(one.edge_lengths.max()) / np.sqrt(
        3.0
    )  # no point of a triangle is farther from its corners
    return bool(-two.depth(one.vertices).max() > within + between)


def _deeply_overlapping(one: Surface, two: Surface, rise: float) -> Approach | None:
    """Find an overlap that a few vertices show, before all triangles are compared: those of bodies that overlap widely.

    A body that is given twice has all its vertices on the surface of the other one.
    """
    if (
        one.vertices.shape == two.vertices.shape
        and np.abs(one.vertices - two.vertices).max() <= TOUCH
    ):
        where = one.vertices[0]
        return Approach(
            0.0,
            where,
            f"one has all its {len(one.vertices)} vertices on the other, near {in_mm(where)}",
        )
    for inner, outer in ((one, two), (two, one)):
        some = inner.vertices[:: 1 + len(inner.vertices) // SAMPLES]
        depth = outer.depth(some)
        if np.count_nonzero(depth > rise + TOUCH) > len(some) // 5:
            where = some[depth.argmax()]
            lies = f"one lies {depth.max() * 1e3:.3g} mm inside the other near {in_mm(where)}"
            return Approach(0.0, where, lies)
    return None


def _triangles(
    one: Float64[np.ndarray, "some 3 3"], two: Float64[np.ndarray, "others 3 3"], within: float
) -> Approach | None:
    pairs = crossings_between(one, two)
    if len(pairs):
        where = one[pairs[0, 0]].mean(axis=0)
        meet = counted(len(pairs), "pair of triangles meets", "pairs of triangles meet")
        return Approach(0.0, where, f"{meet}, the first near {in_mm(where)}")
    nearest = nearest_between(one, two, within)
    return None if nearest is None else Approach(nearest[0], (nearest[1] + nearest[2]) / 2.0)
