"""Sphere and capsule: exact shapes and their curved meshes."""

import math
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from jaxtyping import Float64, Real

from airtact.checks import fixed, number, point_of, positive
from airtact.errors import MOST_TRIANGLES, InvalidInput, Vector
from airtact.geometry.mesh.quadratic_triangles import (
    QuadraticTriangles,
    enclosed_volume,
    longest_edges,
    with_middles,
)
from airtact.geometry.mesh.remeshing import RidgedMesh
from airtact.geometry.mesh.topology import Triangles, Vertices, check_size
from airtact.geometry.pose import Pose
from airtact.geometry.shape import BEND, FlatMesh, Shape
from airtact.geometry.surface import Surface
from airtact.printing import in_short

_SECTORS = 5  # triangles round a pole; five keep every angle above 30 degrees
_MOST_RINGS = 400  # 1.6 million triangles: beyond it the edge is in a wrong unit
_SURPLUS = (
    1.35  # panels over those that the edge asks for, as the narrow ones round a pole give less
)
_LARGEST_SAGITTA = 0.01  # farthest that a flat mesh lies off, over the radius


@dataclass(frozen=True, eq=False)
class Capsule(Shape):
    """All points within ``radius`` [m] of a segment: the local z axis from -length/2 to +length/2 [m]; 0 is a sphere.

    Examples
    --------
    >>> ball = Capsule(radius=0.01, length=0.0, pose=Pose.identity())
    >>> ball.depth(np.array([[0.0, 0.0, 0.008]])).round(6).tolist()
    [0.002]
    """

    radius: float
    length: float
    pose: Pose

    __repr__ = in_short

    def __post_init__(self) -> None:
        """Check the two lengths."""
        object.__setattr__(self, "radius", positive(self.radius, "radius", "m"))
        length = number(self.length, "the length of a capsule's axis", "m")
        if not math.isfinite(length) or length < 0.0:
            raise InvalidInput(
                f"a capsule's axis has length {length:g} m, but it must be finite and not negative.",
                code="out_of_range",
            )
        object.__setattr__(self, "length", length)

    @property
    def extent(self) -> float:
        """Largest distance between two of its points [m]."""
        return self.length + 2.0 * self.radius

    @property
    def area(self) -> float:
        """Area of the surface [m²]."""
        return 2.0 * math.pi * self.radius * self.extent

    @property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        return math.pi * self.radius**2 * (self.length + 4.0 / 3.0 * self.radius)

    @property
    def thinnest(self) -> float:
        """Diameter of the largest ball inside that touches the surface, the same everywhere [m]."""
        return 2.0 * self.radius

    @property
    def axis(self) -> Float64[np.ndarray, "2 3"]:
        """Start and end of the axis (2, 3) [m]."""
        return self.pose.apply(
            np.array([[0.0, 0.0, -self.length / 2.0], [0.0, 0.0, self.length / 2.0]])
        )

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance to the surface [m] of points (P, 3) [m], positive inside."""
        x, y, z = self.pose.inverse().apply(points).T
        beyond = np.maximum(np.abs(z) - self.length / 2.0, 0.0)
        return self.radius - np.sqrt(x * x + y * y + beyond * beyond)

    def project(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Bring points (P, 3) [m] that are off the axis to the nearest points of the surface."""
        return self.pose.apply(self._around_axis(self.pose.inverse().apply(points), self.radius))

    def _around_axis(
        self, local: Float64[np.ndarray, "points 3"], radius: float
    ) -> Float64[np.ndarray, "points 3"]:
        """Bring points of the capsule's own frame to a distance ``radius`` from its axis [m]."""
        along = np.clip(local[:, 2], -self.length / 2.0, self.length / 2.0)
        out = local.copy()
        out[:, 2] -= along
        out *= (radius / np.sqrt(np.einsum("pd,pd->p", out, out)))[:, None]
        out[:, 2] += along
        return out

    def moved(self, pose: Pose) -> "Capsule":
        """Move it rigidly."""
        return Capsule(self.radius, self.length, pose @ self.pose)

    def extreme_points(self) -> Float64[np.ndarray, "points 3"]:
        """Points (12, 3) [m] on the upright boxes round the two caps."""
        reach = self.radius * np.concatenate([np.eye(3), -np.eye(3)])
        return (self.axis[:, None] + reach).reshape(-1, 3)

    def farthest(self, direction: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
        """Point of the body (3,) that lies farthest along a unit direction [m]."""
        return self.axis[(self.axis @ direction).argmax()] + self.radius * direction

    def coarse_meshes(self, edge: float) -> list[RidgedMesh]:
        """Triangles to start a mesh from, with edges of at most ``edge`` / 3 [m]."""
        surface = self.mesh(min(edge / 3.0, 0.5 * self.radius))
        return [
            RidgedMesh(
                np.array(surface.vertices),
                np.array(surface.triangles),
                np.empty((0, 2), dtype=np.int64),
            )
        ]

    def flat_mesh(self, away: float) -> FlatMesh:
        """Mesh it with flat triangles at most ``away`` [m] off."""
        mesh = self.mesh(
            float(np.sqrt(8.0 * min(away, _LARGEST_SAGITTA * self.radius) * self.radius))
        )
        return mesh.vertices, mesh.triangles

    def panels(self, edge: float, bend: float = BEND, away: float = math.inf) -> QuadraticTriangles:
        """Cover it with curved panels about as large as equilateral triangles of a given edge [m].

        They turn by at most ``bend`` [rad] from edge to edge.

        The mesh is as coarse as its panels' mean area allows, and moved outwards until it holds the
        exact volume: quadratics through points of a round surface hold less.
        """
        wanted = _SURPLUS * self.area / (np.sqrt(3) / 4 * edge**2)
        length, most = (
            self.length / self.radius,
            math.ceil(max(2.0 * self.radius / edge, 2.0 / bend)) + 3,
        )
        least = 2.0 * math.pi / (1.001 * bend)
        # 3 or 4 points around for each ring of a cap, whose panels are about as high as wide then
        ways = (
            (m, around)
            for m in range(2, most + 1)
            for around in range(max(3 * m, math.ceil(least)), 4 * m + 1)
        )
        enough = [(count, way) for way in ways if (count := _count(*way, length)) >= wanted]
        vertices, triangles = _mesh(*min(enough)[1], length)
        nodes = with_middles(self.radius * vertices[triangles]).reshape(-1, 3)
        nodes = self._around_axis(nodes, self.radius)
        missing = self.volume - enclosed_volume(nodes.reshape(-1, 6, 3))
        return self.pose.apply(self._around_axis(nodes, self.radius + missing / self.area)).reshape(
            -1, 6, 3
        )

    def mesh(self, edge: float) -> Surface:
        """Draw it with curved triangles whose vertices and midpoints lie exactly on it.

        Each cap is a hemisphere of m rings, ring i having 5 i points; the cylinder between has
        rings of 5 m points, each turned by half a step. The mesh is made at rest and then moved, so
        that it moves exactly with the pose. ``edge`` is the longest straight edge allowed [m], so
        long that a cap needs 400 rings at most.
        """
        edge = positive(edge, "edge", "m")
        check_size(self.extent)
        rings = (
            max(2, math.ceil(1.6 * self.radius / edge))
            if edge > self.radius / _MOST_RINGS
            else _MOST_RINGS + 1
        )
        while rings <= _MOST_RINGS:
            self._check_count(rings)
            vertices, triangles = _mesh(rings, _SECTORS * rings, self.length / self.radius)
            corners = self.radius * vertices[triangles]
            if longest_edges(corners).max() <= edge:
                return self._surface(self.radius * vertices, triangles)
            rings += 1
        raise InvalidInput(
            f"an edge of {edge * 1e3:.4g} mm on a radius of {self.radius * 1e3:.4g} mm needs more than {_MOST_RINGS} "
            "rings a cap; ask for a longer edge.",
            self.pose.translation,
            code="out_of_range",
        )

    def _check_count(self, rings: int) -> None:
        """Raise "too_many" before a mesh of so many rings is made."""
        count = _count(rings, _SECTORS * rings, self.length / self.radius)
        if count > MOST_TRIANGLES:
            raise InvalidInput(
                f"a capsule of {1e3 * self.radius:.4g} mm radius and {1e3 * self.length:.4g} mm length needs {count:,} "
                f"triangles, more than {MOST_TRIANGLES:,}: are its lengths in different units? Give metres.",
                self.pose.translation,
                code="too_many",
            )

    def _surface(self, vertices: Vertices, triangles: Triangles) -> Surface:
        midpoints = Capsule(self.radius, self.length, Pose.identity()).edge_middles(
            vertices[triangles]
        )
        placed = fixed(self.pose.apply(vertices)), triangles, fixed(self.pose.apply(midpoints))
        return Surface(*placed, primitive=self, _known_shape=self)


def sphere(radius: float, edge: float, centre: Vector = (0, 0, 0)) -> Surface:
    """Make a sphere. Boundary elements use its formula and choose panels themselves, whatever the edge is.

    Parameters
    ----------
    radius : [m].
    edge : longest edge of the triangles of its mesh, for pictures and files [m].
    centre : (3,) [m].

    Raises
    ------
    InvalidInput
        When a length is not above zero or the centre is not finite.

    Examples
    --------
    >>> sphere(radius=0.01, edge=0.003).midpoints is not None
    True
    """
    return Capsule(radius, 0.0, Pose(np.eye(3), point_of(centre, "sphere centre"))).mesh(edge)


def capsule(start: Vector, end: Vector, radius: float, edge: float) -> Surface:
    """Mesh a capsule, the surface at ``radius`` round the segment from ``start`` to ``end``.

    Parameters
    ----------
    start, end : (3,) ends of the axis [m]; equal ends make a sphere.
    radius : [m].
    edge : longest edge of its triangles [m].

    Raises
    ------
    InvalidInput
        When a length is not above zero or an end is not finite.
    """
    first, last = point_of(start, "capsule start"), point_of(end, "capsule end")
    length = float(np.linalg.norm(last - first))
    rotation = turn_from_z((last - first) / length) if length > 0.0 else np.eye(3)
    return Capsule(radius, length, Pose(rotation, (first + last) / 2.0)).mesh(edge)


def turn_from_z(direction: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Find a rotation that brings the z axis to a direction (3,), a unit vector."""
    x, y, z = direction
    if z < 0.0:  # by way of half a turn about x, which keeps the formula away from its pole at -z
        return np.diag([1.0, -1.0, -1.0]) @ turn_from_z(np.array([x, -y, -z]))
    s = 1.0 / (1.0 + z)
    return np.array(
        [[1.0 - s * x * x, -s * x * y, x], [-s * x * y, 1.0 - s * y * y, y], [-x, -y, z]]
    )


def _mesh(rings: int, around: int, length: float) -> tuple[Vertices, Triangles]:
    """Mesh the capsule of radius 1 whose axis has the given length, with so many rings a cap and points around."""
    cap, _ = _cap(rings, around)
    above, waist = cap[:-around], cap[-around:]
    bands = _bands(around, length)
    half = np.array([0.0, 0.0, length / 2.0])
    belt = np.empty((bands + 1, around, 3))
    turn = math.pi / around * np.arange(bands + 1)[:, None]
    belt[:, :, 0] = np.cos(turn) * waist[:, 0] - np.sin(turn) * waist[:, 1]
    belt[:, :, 1] = np.sin(turn) * waist[:, 0] + np.cos(turn) * waist[:, 1]
    belt[:, :, 2] = (
        half[2] * (1.0 - 2.0 * np.arange(bands + 1) / bands if bands else np.zeros(1))[:, None]
    )
    below = _spun(above, math.pi / around * bands) * [1.0, 1.0, -1.0]
    return np.concatenate([above + half, belt.reshape(-1, 3), below - half]), _triangles(
        rings, around, bands
    )


@lru_cache(maxsize=16)
def _triangles(rings: int, around: int, bands: int) -> Triangles:
    """Triangles of ``_mesh``, to be read only."""
    cap, triangles = _cap(rings, around)
    above = len(cap) - around
    last = above + bands * around
    mirrored = np.r_[last + around + np.arange(above), last + np.arange(around)][triangles][:, ::-1]
    both = np.concatenate([triangles, _belt(above, bands, around), mirrored]).astype(np.int64)
    both.flags.writeable = False
    return both


def _bands(around: int, length: float) -> int:
    step = math.sqrt(3.0) * math.sin(
        math.pi / around
    )  # height of an equilateral triangle over one edge of the waist
    # A cylinder too short for a band of good triangles gets none: both caps share one ring in its
    # middle.
    return max(1, round(length / step)) if length > 0.6 * step else 0


def _count(rings: int, around: int, length: float) -> int:
    """Count the triangles of ``_mesh``."""
    return 2 * (2 * _inner_points(rings, around) + around + around * _bands(around, length))


@cache
def _inner_points(rings: int, around: int) -> int:
    """Count the points of a cap between its pole and its last ring."""
    return sum(_points(ring, rings, around) for ring in range(1, rings))


def _points(ring: int, rings: int, around: int) -> int:
    """Count the points of a ring of a cap, the last one having ``around``: as many as fit its height, 3 at least."""
    return max(3, (2 * around * ring + rings) // (2 * rings))


def _spun(points: Float64[np.ndarray, "points 3"], angle: float) -> Float64[np.ndarray, "points 3"]:
    """Turn points about the z axis."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return points @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _belt(first: int, bands: int, around: int) -> Triangles:
    """Triangulate between rings of as many points each, the first ring starting at a given vertex."""
    steps = np.arange(around)
    ring = first + around * np.arange(bands)[:, None]
    here, after = ring + steps, ring + (steps + 1) % around
    down = np.stack([here, here + around, after], axis=2)
    up = np.stack([after, here + around, after + around], axis=2)
    return np.concatenate([down, up]).reshape(-1, 3)


@lru_cache(maxsize=16)
def _cap(rings: int, around: int) -> tuple[Vertices, Triangles]:
    """Mesh the upper half of the unit sphere: the pole, then ring i at polar angle (π/2)(i/m).

    Between two rings the edges of both come in the order of their middles, each with the other
    ring's point before it.
    """
    points, triangles, inner, fewer = [np.array([[0.0, 0.0, 1.0]])], [], 0, 1
    for ring in range(1, rings + 1):
        count, outer = _points(ring, rings, around), inner + fewer
        polar, angle = math.pi / 2.0 * ring / rings, 2.0 * math.pi * np.arange(count) / count
        height = 0.0 if ring == rings else math.cos(polar)
        flat = math.sin(polar) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        points.append(np.column_stack([flat, np.full(count, height)]))
        here, above = np.arange(count), np.arange(fewer)
        before = ((2 * here + 1) * fewer + count - 1) // (2 * count) % fewer
        triangles.append(
            np.stack([inner + before, outer + here, outer + (here + 1) % count], axis=1)
        )
        after = ((2 * above + 1) * count + fewer) // (2 * fewer) % count
        if fewer > 1:
            triangles.append(
                np.stack([inner + above, outer + after, inner + (above + 1) % fewer], axis=1)
            )
        inner, fewer = outer, count
    return np.concatenate(points), np.concatenate(triangles)
