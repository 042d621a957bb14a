"""Removes slivers: needles are collapsed along their short edge, caps flip their long edge.

A surface with slivers is closed and correct, but their normals are arbitrary. Neither cure moves
the surface by more than the height of the sliver. Source: M. Botsch, L. Kobbelt, "A robust
procedure to eliminate degenerate faces from triangle meshes", VMV 2001.
"""

import math
from collections import deque
from operator import mul

import numpy as np
from jaxtyping import Bool, Float64, Int64

from airtact.errors import counted, in_mm
from airtact.geometry.mesh.arrays import NewTriangles, Triangles, Vertices
from airtact.geometry.mesh.intersections import self_crossings

MAX_FLATNESS = 1e-3
"""Height of a sliver, over its longest edge."""
MAX_HEIGHT = 5e-6
"""Height of a sliver [m], by which the surface may move when it is removed."""


def without_slivers(vertices: Vertices, triangles: Triangles, notes: list[str]) -> NewTriangles:
    """Remove slivers from a mesh with at most two triangles at an edge, without folding it."""
    thin = np.flatnonzero(are_slivers(vertices[triangles]))
    if len(thin) == 0:
        return triangles
    left_alone = np.zeros(len(vertices), dtype=bool)
    for _ in range(4):
        mesh = _EditableMesh(vertices, triangles)
        needles, caps = _remove(mesh, thin[~left_alone[triangles[thin]].any(axis=1)])
        crossing = mesh.crossing_vertices()
        if len(crossing) == 0:
            break
        # Where the surface came to cross itself, try again without the slivers there.
        left_alone[crossing] = True
    else:
        return triangles
    for removed, singular, plural in (
        (needles, "needle was collapsed", "needles were collapsed"),
        (
            caps,
            "flat cap was removed by flipping its longest edge",
            "flat caps were removed by flipping their longest edges",
        ),
    ):
        if removed:
            where = in_mm(vertices[triangles[removed[0]]].mean(axis=0))
            notes.append(f"{counted(len(removed), singular, plural)}, the first near {where}.")
    return mesh.triangles[mesh.alive]


def _remove(mesh: "_EditableMesh", thin: Int64[np.ndarray, "_"]) -> tuple[list[int], list[int]]:
    """Remove slivers and those that result from it; list which were collapsed and flipped."""
    queue = deque(thin.tolist())
    needles = []
    caps = []
    for _ in range(20 * len(thin)):  # flips can go on forever
        if not queue:
            break
        sliver = queue.popleft()
        if not mesh.is_sliver(sliver):
            continue
        changed = mesh.collapse(sliver)
        if changed is not None:
            needles.append(sliver)
        else:
            changed = mesh.flip(sliver)
            if changed is not None:
                caps.append(sliver)
        queue.extend(triangle for triangle in changed or [] if mesh.is_sliver(triangle))
    return needles, caps


def are_slivers(corners: Float64[np.ndarray, "n 3 3"]) -> Bool[np.ndarray, "n"]:
    """Whether triangles are so flat that their normals are meaningless."""
    a, b, c = np.moveaxis(corners, 1, 0)
    along = b - a
    up = c - a
    longest = np.sqrt(np.maximum(np.maximum(_squares(along), _squares(up)), _squares(c - b)))
    twice_area = np.sqrt(_squares(np.cross(along, up)))
    return twice_area < longest * np.minimum(MAX_FLATNESS * longest, MAX_HEIGHT)


def _squares(vectors: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n"]:
    return np.einsum("ni,ni->n", vectors, vectors)


class _EditableMesh:
    """Triangles that change one by one, with the triangles around each vertex looked at so far."""

    def __init__(self, vertices: Vertices, triangles: Triangles) -> None:
        self.vertices = vertices
        self.triangles = triangles.copy()
        # For single triangles, plain numbers are many times faster than arrays.
        self._points = vertices.tolist()
        self.alive = np.ones(len(triangles), dtype=bool)
        self._order = np.argsort(triangles.ravel(), kind="stable")
        self._ranked = triangles.ravel()[self._order]
        self._changed: set[int] = set()
        self._around: dict[int, set[int]] = {}

    def around(self, vertex: int) -> set[int]:
        """Triangles that meet in a vertex."""
        if vertex not in self._around:
            low, high = np.searchsorted(self._ranked, [vertex, vertex + 1])
            self._around[vertex] = set((self._order[low:high] // 3).tolist())
        return self._around[vertex]

    def neighbours(self, vertex: int) -> set[int]:
        """Vertices that share an edge with a vertex."""
        corners = {corner for triangle in self.around(vertex) for corner in self.corners(triangle)}
        return corners - {vertex}

    def on_border(self, vertex: int) -> bool:
        return len(self.neighbours(vertex)) != len(self.around(vertex))

    def corners(self, triangle: int) -> list[int]:
        return self.triangles[triangle].tolist()

    def is_sliver(self, triangle: int) -> bool:
        if not self.alive[triangle]:
            return False
        corners = self.corners(triangle)
        longest = max(self.lengths(corners))
        twice_area = math.hypot(*self.normal(corners))
        return twice_area < longest * min(MAX_FLATNESS * longest, MAX_HEIGHT)

    def normal(self, corners: list[int]) -> tuple[float, float, float]:
        # Of twice the area as length.
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = (self._points[corner] for corner in corners)
        bx -= ax
        by -= ay
        bz -= az
        cx -= ax
        cy -= ay
        cz -= az
        return by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx

    def lengths(self, corners: list[int]) -> list[float]:
        """Lengths of edges 01, 12, 20 of a triangle."""
        a, b, c = (self._points[corner] for corner in corners)
        return [math.dist(a, b), math.dist(b, c), math.dist(c, a)]

    def folds(self, before: list[int], after: list[int]) -> bool:
        """Whether two triangles face opposite directions."""
        return sum(map(mul, self.normal(before), self.normal(after))) <= 0.0

    def collapse(self, needle: int) -> list[int] | None:
        """Collapse the shortest edge of a triangle into one of its ends.

        Returns the changed triangles, or None if the edge is long or the surface would fold.
        """
        corners = self.corners(needle)
        lengths = self.lengths(corners)
        shortest = lengths.index(min(lengths))
        if lengths[shortest] > MAX_HEIGHT:
            return None
        start = corners[shortest]
        end = corners[shortest - 2]
        for keep, gone in ((start, end), (end, start)):
            shared = self.around(keep) & self.around(gone)
            if self._would_pinch(keep, gone, shared):
                continue
            changes: dict[int, list[int] | None] = dict.fromkeys(shared)
            for triangle in self.around(gone) - shared:
                changes[triangle] = [
                    keep if vertex == gone else vertex for vertex in self.corners(triangle)
                ]
            if self._apply(changes):
                return [triangle for triangle in changes if triangle not in shared]
        return None

    def _would_pinch(self, keep: int, gone: int, shared: set[int]) -> bool:
        """Whether a collapse would join separate parts of the surface or change a hole's shape."""
        apexes = {corner for triangle in shared for corner in self.corners(triangle)} - {keep, gone}
        if self.neighbours(keep) & self.neighbours(gone) != apexes or len(apexes) != len(shared):
            return True
        if self.on_border(gone) and (len(shared) == 2 or not self.on_border(keep)):
            return True
        opposite = {frozenset(self.corners(triangle)) - {keep} for triangle in self.around(keep)}
        return any(
            frozenset(self.corners(triangle)) - {gone} in opposite
            for triangle in self.around(gone) - shared
        )

    def flip(self, cap: int) -> list[int] | None:
        """Replace the longest edge of a triangle by the other diagonal with its neighbour.

        Returns both triangles, or None where that does not help.
        """
        corners = self.corners(cap)
        lengths = self.lengths(corners)
        longest = lengths.index(max(lengths))
        start = corners[longest]
        end = corners[longest - 2]
        apex = corners[longest - 1]
        beside = (self.around(start) & self.around(end)) - {cap}
        if len(beside) != 1:
            return None
        neighbour = beside.pop()
        (tip,) = set(self.corners(neighbour)) - {start, end}
        if tip == apex or tip in self.neighbours(apex):
            return None
        flipped = {cap: [apex, start, tip], neighbour: [tip, end, apex]}
        if min(map(self._flatness, flipped.values())) <= self._flatness(corners):
            return None
        old = self.corners(neighbour)
        if not self.is_sliver(neighbour) and any(self.folds(old, new) for new in flipped.values()):
            return None
        return [cap, neighbour] if self._apply(dict(flipped)) else None

    def _flatness(self, corners: list[int]) -> float:
        """Height over longest edge."""
        return math.hypot(*self.normal(corners)) / max(self.lengths(corners)) ** 2

    def _apply(self, changes: dict[int, list[int] | None]) -> bool:
        """Give triangles new corners, or remove them, unless one that is no sliver turns over."""
        for triangle, corners in changes.items():
            if (
                corners is not None
                and not self.is_sliver(triangle)
                and self.folds(self.corners(triangle), corners)
            ):
                return False
        for triangle, corners in changes.items():
            for vertex in self.corners(triangle):
                self.around(vertex).discard(triangle)
            self.alive[triangle] = corners is not None
            if corners is not None:
                self.triangles[triangle] = corners
                for vertex in corners:
                    self.around(vertex).add(triangle)
        self._changed.update(changes)
        return True

    def crossing_vertices(self) -> Int64[np.ndarray, "_"]:
        """Vertices of triangles near the changes that cross each other."""
        changed = np.array(
            [triangle for triangle in sorted(self._changed) if self.alive[triangle]],
            dtype=np.int64,
        )
        beside = np.zeros(len(self.vertices), dtype=bool)
        beside[self.triangles[changed]] = True
        near = self.triangles[self.alive & beside[self.triangles].any(axis=1)]
        a, b, c = np.moveaxis(self.vertices[near], 1, 0)
        near = near[_squares(np.cross(b - a, c - a)) > 0.0]
        if len(near) < 2:
            return np.zeros(0, dtype=np.int64)
        return np.unique(near[self_crossings(self.vertices[near], near)])
