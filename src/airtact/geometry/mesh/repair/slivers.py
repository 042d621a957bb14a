"""Slivers: needles lose their short edge, caps hand their long edge to the neighbour, on plain arrays.

A surface with slivers is closed and right, but their normals point anywhere. Both cures move the
surface by no more than the sliver is high. Source: M. Botsch, L. Kobbelt, "A robust procedure to
eliminate degenerate faces from triangle meshes", VMV 2001.
"""

import math
from collections import deque
from operator import mul

import numpy as np
from jaxtyping import Bool, Float64, Int64

from airtact.checks import counted, in_mm
from airtact.geometry.mesh.intersections import self_crossings
from airtact.geometry.mesh.topology import Triangles, Vertices

FLATTEST = 1e-3
"""A triangle is a sliver when its height is below this share of its longest edge ..."""
HIGHEST = 5e-6
"""... and below this [m], which is as far as the surface is moved."""
ATTEMPTS = 4
"""Where a repair lets the surface cross itself, it is done again without the slivers there, so often at most."""


def without_slivers(
    vertices: Vertices, triangles: Triangles, notes: list[str]
) -> Int64[np.ndarray, "left 3"]:
    """Collapse needles and flip long edges of caps of a mesh with two triangles at an edge at most, without folds."""
    thin = np.flatnonzero(are_slivers(vertices[triangles]))
    if len(thin) == 0:
        return triangles
    left_alone = np.zeros(len(vertices), dtype=bool)
    for _ in range(ATTEMPTS):
        fabric = _Fabric(vertices, triangles)
        needles, caps = _repair(fabric, thin[~left_alone[triangles[thin]].any(axis=1)])
        crossing = fabric.crossing()
        if len(crossing) == 0:
            break
        left_alone[crossing] = True
    else:
        return triangles
    flipped = "flat cap was removed by flipping its longest edge"
    all_flipped = "flat caps were removed by flipping their longest edges"
    collapsed = "needle was collapsed", "needles were collapsed"
    for found, one, many in ((needles, *collapsed), (caps, flipped, all_flipped)):
        if found:
            middle = vertices[triangles[found[0]]].mean(axis=0)
            notes.append(f"{counted(len(found), one, many)}, the first near {in_mm(middle)}.")
    return fabric.triangles[fabric.alive]


def _repair(fabric: "_Fabric", thin: Int64[np.ndarray, "some"]) -> tuple[list[int], list[int]]:
    """Repair slivers and what becomes one: which were collapsed and which flipped."""
    queue, left = deque(thin.tolist()), 20 * len(thin)
    needles, caps = [], []
    while queue and left > 0:
        left -= 1
        one = queue.popleft()
        if not fabric.thin(one):
            continue
        changed = fabric.collapse(one)
        if changed is not None:
            needles.append(one)
        else:
            changed = fabric.flip(one)
            if changed is not None:
                caps.append(one)
        queue.extend(other for other in changed or [] if fabric.thin(other))
    return needles, caps


def are_slivers(corners: Float64[np.ndarray, "some 3 3"]) -> Bool[np.ndarray, "some"]:
    """Whether triangles are so flat that their normals mean nothing."""
    a, b, c = np.moveaxis(corners, 1, 0)
    along, up = b - a, c - a
    longest = np.sqrt(np.maximum(np.maximum(_squares(along), _squares(up)), _squares(c - b)))
    return np.sqrt(_squares(np.cross(along, up))) < longest * np.minimum(
        FLATTEST * longest, HIGHEST
    )


def _squares(vectors: Float64[np.ndarray, "some 3"]) -> Float64[np.ndarray, "some"]:
    return np.einsum("ni,ni->n", vectors, vectors)


class _Fabric:
    """Triangles that are changed one by one, with the triangles round the vertices that were touched."""

    def __init__(self, vertices: Vertices, triangles: Triangles) -> None:
        self.vertices = vertices
        self.triangles = triangles.copy()
        self._points = (
            vertices.tolist()
        )  # for single triangles plain numbers are many times faster than arrays
        self.alive = np.ones(len(triangles), dtype=bool)
        self._order = np.argsort(triangles.ravel(), kind="stable")
        self._ranked = triangles.ravel()[self._order]
        self.touched: set[int] = set()
        self._rounds: dict[int, set[int]] = {}

    def round(self, vertex: int) -> set[int]:
        """Triangles that meet in a vertex."""
        if vertex not in self._rounds:
            low, high = np.searchsorted(self._ranked, [vertex, vertex + 1])
            self._rounds[vertex] = set((self._order[low:high] // 3).tolist())
        return self._rounds[vertex]

    def corners(self, triangle: int) -> list[int]:
        return self.triangles[triangle].tolist()

    def thin(self, triangle: int) -> bool:
        if not self.alive[triangle]:
            return False
        corners = self.corners(triangle)
        longest = max(self.lengths(corners))
        return math.hypot(*self.normal(corners)) < longest * min(FLATTEST * longest, HIGHEST)

    def replace(self, triangle: int, corners: list[int] | None) -> None:
        """Give a triangle other corners, or none."""
        for vertex in self.corners(triangle):
            self.round(vertex).discard(triangle)
        self.alive[triangle] = corners is not None
        if corners is not None:
            self.triangles[triangle] = corners
            for vertex in corners:
                self.round(vertex).add(triangle)

    def normal(self, corners: list[int]) -> tuple[float, float, float]:
        """Twice the area vector of a triangle."""
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = (self._points[corner] for corner in corners)
        bx, by, bz, cx, cy, cz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
        return by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx

    def lengths(self, corners: list[int]) -> list[float]:
        """Lengths of edges 01, 12, 20 of a triangle."""
        a, b, c = (self._points[corner] for corner in corners)
        return [math.dist(a, b), math.dist(b, c), math.dist(c, a)]

    def folds(self, before: list[int], after: list[int]) -> bool:
        """Whether two triangles look away from each other."""
        return sum(map(mul, self.normal(before), self.normal(after))) <= 0.0

    def ring(self, vertex: int) -> set[int]:
        """Neighbours of a vertex."""
        return {corner for triangle in self.round(vertex) for corner in self.corners(triangle)} - {
            vertex
        }

    def on_border(self, vertex: int) -> bool:
        return len(self.ring(vertex)) != len(self.round(vertex))

    def collapse(self, needle: int) -> list[int] | None:
        """Draw the shortest edge of a triangle into one of its ends; None if it is long or the surface would fold."""
        corners = self.corners(needle)
        lengths = self.lengths(corners)
        shortest = lengths.index(min(lengths))
        if lengths[shortest] > HIGHEST:
            return None
        one, two = corners[shortest], corners[shortest - 2]
        for keep, gone in ((one, two), (two, one)):
            shared = self.round(keep) & self.round(gone)
            if self._would_pinch(keep, gone, shared):
                continue
            changes: dict[int, list[int] | None] = dict.fromkeys(shared)
            for triangle in self.round(gone) - shared:
                changes[triangle] = [
                    keep if vertex == gone else vertex for vertex in self.corners(triangle)
                ]
            if self._changed(changes):
                return [triangle for triangle in changes if triangle not in shared]
        return None

    def _would_pinch(self, keep: int, gone: int, shared: set[int]) -> bool:
        """Whether drawing a vertex into another would tie parts of the surface together or change a hole's shape."""
        apexes = {corner for triangle in shared for corner in self.corners(triangle)} - {keep, gone}
        if self.ring(keep) & self.ring(gone) != apexes or len(apexes) != len(shared):
            return True
        if self.on_border(gone) and (len(shared) == 2 or not self.on_border(keep)):
            return True
        there = {frozenset(self.corners(triangle)) - {keep} for triangle in self.round(keep)}
        return any(
            frozenset(self.corners(triangle)) - {gone} in there
            for triangle in self.round(gone) - shared
        )

    def flip(self, cap: int) -> list[int] | None:
        """Give the longest edge of a triangle and its neighbour the other direction; None where that is no cure."""
        corners = self.corners(cap)
        lengths = self.lengths(corners)
        longest = lengths.index(max(lengths))
        start, end, apex = corners[longest], corners[longest - 2], corners[longest - 1]
        others = (self.round(start) & self.round(end)) - {cap}
        if len(others) != 1:
            return None
        neighbour = others.pop()
        (far,) = set(self.corners(neighbour)) - {start, end}
        if far == apex or far in self.ring(apex):
            return None
        new = [apex, start, far], [far, end, apex]
        if min(self._flatness(triangle) for triangle in new) <= self._flatness(corners):
            return None
        there = self.corners(neighbour)
        if not self.thin(neighbour) and any(self.folds(there, triangle) for triangle in new):
            return None
        return [cap, neighbour] if self._changed({cap: new[0], neighbour: new[1]}) else None

    def _changed(self, changes: dict[int, list[int] | None]) -> bool:
        """Make changes and return True, unless they turn a triangle over; slivers may turn."""
        for triangle, corners in changes.items():
            if (
                corners is not None
                and not self.thin(triangle)
                and self.folds(self.corners(triangle), corners)
            ):
                return False
        for triangle, corners in changes.items():
            self.replace(triangle, corners)
        self.touched.update(changes)
        return True

    def crossing(self) -> Int64[np.ndarray, "some"]:
        """Vertices of triangles near the changes that cross each other."""
        changed = np.array(
            [triangle for triangle in sorted(self.touched) if self.alive[triangle]], dtype=np.int64
        )
        beside = np.zeros(len(self.vertices), dtype=bool)
        beside[self.triangles[changed]] = True
        near = self.triangles[self.alive & beside[self.triangles].any(axis=1)]
        a, b, c = np.moveaxis(self.vertices[near], 1, 0)
        near = near[_squares(np.cross(b - a, c - a)) > 0.0]
        if len(near) < 2:
            return np.zeros(0, dtype=np.int64)
        return np.unique(near[self_crossings(self.vertices[near], near)])

    def _flatness(self, corners: list[int]) -> float:
        """Height over longest edge."""
        return math.hypot(*self.normal(corners)) / max(self.lengths(corners)) ** 2
