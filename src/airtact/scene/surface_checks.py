"""Checks that take a tree: surfaces that cross themselves, bodies that overlap."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from airtact.conventions import InvalidInput
from airtact.scene.closest_point import segment_distances, signed_distance
from airtact.scene.crossings import crossings_between, segment_triangle_distances
from airtact.scene.geometry import Surface
from airtact.scene.guards import counted, place
from airtact.scene.primitives import Capsule
from airtact.scene.topology import shells

TOUCH = 1e-9
"""Bodies nearer than this touch [m]."""


def check_surface(surface: Surface) -> None:
    """Refuse a surface that crosses or touches itself, or has one closed piece inside another.

    Parameters
    ----------
    surface : primitives pass at once, being exact.

    Raises
    ------
    InvalidInput
        With the number of pairs of triangles that meet and where the first does, or how deep a piece lies in another.
    """
    pairs = surface.crossings
    if len(pairs):
        first = pairs[0]
        meet = counted(len(pairs), "pair of triangles meets", "pairs of triangles meet")
        raise InvalidInput(
            f"the surface crosses itself: {meet}, the first are triangles "
            f"{int(first[0])} and {int(first[1])} near {place(surface.corners[first].mean(axis=(0, 1)))}; repair it."
        )
    if surface.primitive is None:
        _refuse_nested(surface)


def _refuse_nested(surface: Surface) -> None:
    piece = shells(surface.triangles)
    seeds = surface.corners[np.unique(piece, return_index=True)[1], 0]
    if len(seeds) == 1:
        return
    for outer in range(len(seeds)):
        depth = signed_distance(surface.vertices, surface.triangles[piece == outer]).depth(seeds)
        depth[outer] = -np.inf
        inner = int(depth.argmax())
        if depth[inner] > 0.0:
            raise InvalidInput(
                f"closed piece {inner} of {len(seeds)} lies inside piece {outer}, {depth[inner] * 1e3:.3g} mm deep "
                f"near {place(seeds[inner])}: no sound gets there, so remove it."
            )


def check_apart(surfaces: Sequence[Surface]) -> None:
    """Refuse bodies that overlap or touch.

    Parameters
    ----------
    surfaces : the bodies; two primitives are measured exactly, a primitive and a mesh by the mesh's triangles, two
        meshes by crossing triangles and by which lies in the other.

    Raises
    ------
    InvalidInput
        With the two bodies, how deep or how many triangles, and where.
    """
    for i, j in combinations(range(len(surfaces)), 2):
        found = _overlap(surfaces[i], surfaces[j])
        if found is not None:
            raise InvalidInput(f"bodies {i} and {j} overlap or touch: {found}; move them apart.")


def _overlap(one: Surface, two: Surface) -> str | None:
    if isinstance(one.primitive, Capsule) and isinstance(two.primitive, Capsule):
        return _capsules(one.primitive, two.primitive)
    if isinstance(one.primitive, Capsule):
        return _capsule_and_mesh(one.primitive, two)
    if isinstance(two.primitive, Capsule):
        return _capsule_and_mesh(two.primitive, one)
    return _meshes(one, two)


def _capsules(one: Capsule, two: Capsule) -> str | None:
    distance, here, there = segment_distances(one.axis[None], two.axis[None])
    depth = one.radius + two.radius - float(distance[0])
    if depth < -TOUCH:
        return None
    return f"{depth * 1e3:.3g} mm deep near {place((here[0] + there[0]) / 2.0)}"


def _capsule_and_mesh(rod: Capsule, mesh: Surface) -> str | None:
    distance = segment_triangle_distances(np.broadcast_to(rod.axis, (len(mesh.triangles), 2, 3)), mesh.corners)
    nearest = int(distance.argmin())
    inside = float(mesh.depth(rod.axis).max())
    depth = rod.radius + (inside if inside > 0.0 else -float(distance[nearest]))
    if depth < -TOUCH:
        return None
    return f"{depth * 1e3:.3g} mm deep near {place(mesh.corners[nearest].mean(axis=0))}"


def _meshes(one: Surface, two: Surface) -> str | None:
    pairs = crossings_between(one.corners, two.corners)
    if len(pairs):
        meet = counted(len(pairs), "pair of triangles meets", "pairs of triangles meet")
        return f"{meet}, the first near {place(one.corners[pairs[0, 0]].mean(axis=0))}"
    for inner, outer in ((one, two), (two, one)):
        seeds = inner.corners[np.unique(shells(inner.triangles), return_index=True)[1], 0]
        depth = outer.depth(seeds)
        if depth.max() > 0.0:
            return f"one lies {depth.max() * 1e3:.3g} mm inside the other near {place(seeds[depth.argmax()])}"
    return None
