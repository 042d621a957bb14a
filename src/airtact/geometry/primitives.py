"""Spheres and capsules: exact shapes and their curved meshes."""

import itertools
import math
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from jaxtyping import Float64

from airtact.errors import InvalidInput, Vector, fixed, number, point_of, positive
from airtact.geometry.mesh.remeshing import RidgedMesh
from airtact.geometry.mesh.triangles import (
    FlatMesh,
    PointLengths,
    Points,
    PointVectors,
    QuadraticTriangles,
    Triangles,
    Vector3,
    Vertices,
    check_size,
    enclosed_volume,
    longest_edges,
    with_middles,
)
from airtact.geometry.pose import Pose
from airtact.geometry.shape import BEND, Shape
from airtact.geometry.surface import Surface


@dataclass(frozen=True, eq=False)
class Capsule(Shape):
    """All points within ``radius`` [m] of a segment on the local z axis.

    The segment extends from -length/2 to +length/2 [m]. If its length is 0, the shape is a sphere.

    Examples
    --------
    >>> ball = Capsule(radius=0.01, length=0.0, pose=Pose.identity())
    >>> ball.depth(np.array([[0.0, 0.0, 0.008]])).round(6).tolist()
    [0.002]
    """

    radius: float
    length: float
    pose: Pose

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", positive(self.radius, "radius", "m"))
        length = number(self.length, "the length of a capsule's axis", "m")
        if not math.isfinite(length) or length < 0.0:
            raise InvalidInput(
                f"a capsule's axis has length {length:g} m; it must be finite and not negative.",
                code="out_of_range",
            )
        object.__setattr__(self, "length", length)

    @property
    def extent(self) -> float:
        return self.length + 2.0 * self.radius

    @property
    def area(self) -> float:
        return 2.0 * math.pi * self.radius * self.extent

    @property
    def volume(self) -> float:
        return math.pi * self.radius**2 * (self.length + 4.0 / 3.0 * self.radius)

    @property
    def thinnest(self) -> float:
        return 2.0 * self.radius

    @property
    def axis(self) -> Float64[np.ndarray, "2 3"]:
        """Start and end of the axis, (2, 3) [m]."""
        half = self.length / 2.0
        return self.pose.apply(np.array([[0.0, 0.0, -half], [0.0, 0.0, half]]))

    def depth(self, points: Points) -> PointLengths:
        x, y, z = self.pose.inverse().apply(points).T
        beyond = np.maximum(np.abs(z) - self.length / 2.0, 0.0)
        return self.radius - np.sqrt(x * x + y * y + beyond * beyond)

    def project(self, points: Points) -> PointVectors:
        return self.pose.apply(self._around_axis(self.pose.inverse().apply(points), self.radius))

    def _around_axis(self, local: PointVectors, radius: float) -> PointVectors:
        along = np.clip(local[:, 2], -self.length / 2.0, self.length / 2.0)
        out = local.copy()
        out[:, 2] -= along
        out[~out.any(axis=1), 0] = 1.0  # a point on the axis has no radial direction
        out *= (radius / np.sqrt(np.einsum("pd,pd->p", out, out)))[:, None]
        out[:, 2] += along
        return out

    def extreme_points(self) -> PointVectors:
        reach = self.radius * np.concatenate([np.eye(3), -np.eye(3)])
        return (self.axis[:, None] + reach).reshape(-1, 3)

    def farthest(self, direction: Vector3) -> Vector3:
        return self.axis[(self.axis @ direction).argmax()] + self.radius * direction

    def coarse_meshes(self, edge: float) -> list[RidgedMesh]:
        surface = self.mesh(min(edge / 3.0, 0.5 * self.radius))
        no_ridges = np.empty((0, 2), dtype=np.int64)
        return [RidgedMesh(np.array(surface.vertices), np.array(surface.triangles), no_ridges)]

    def flat_mesh(self, away: float) -> FlatMesh:
        """Return flat triangles close to the surface.

        Their distance from it is at most ``away`` [m] and at most 1 % of the radius.
        """
        sagitta = min(away, 0.01 * self.radius)
        mesh = self.mesh(float(np.sqrt(8.0 * sagitta * self.radius)))
        return mesh.vertices, mesh.triangles

    def panels(self, edge: float, bend: float = BEND, away: float = math.inf) -> QuadraticTriangles:
        """Cover the surface with curved panels as large as equilateral triangles of side ``edge``.

        The normal turns by at most ``bend`` [rad] from one edge of a panel to another.
        """
        # Panels around a pole are narrow, so 1.35 times as many are needed.
        needed = 1.35 * self.area / (np.sqrt(3) / 4 * edge**2)
        length = self.length / self.radius
        max_rings = math.ceil(max(2.0 * self.radius / edge, 2.0 / bend)) + 3
        min_around = math.ceil(2.0 * math.pi / (1.001 * bend))
        # With 3 or 4 points around for each ring of a cap, panels are about as high as wide.
        options = []
        for rings in itertools.count(2):
            # Large spheres with small panels need up to a tenth more rings.
            if rings > max_rings and options:
                break
            for around in range(max(3 * rings, min_around), 4 * rings + 1):
                count = _triangle_count(rings, around, length)
                if count >= needed:
                    options.append((count, rings, around))
        _, rings, around = min(options)
        vertices, triangles = _mesh(rings, around, length)
        nodes = with_middles(self.radius * vertices[triangles]).reshape(-1, 3)
        nodes = self._around_axis(nodes, self.radius)
        # Quadratics through points of a round surface enclose too small a volume, so the nodes are
        # moved outwards until the volume is exact.
        missing = self.volume - enclosed_volume(nodes.reshape(-1, 6, 3))
        nodes = self._around_axis(nodes, self.radius + missing / self.area)
        return self.pose.apply(nodes).reshape(-1, 6, 3)

    def mesh(self, edge: float) -> Surface:
        """Mesh the capsule with curved triangles whose vertices and midpoints are exactly on it.

        Each cap is a hemisphere of m rings, with 5·i points on ring i. The cylinder has rings of
        5·m points, each turned by half a step. The mesh is generated in the capsule's own frame and
        then moved. ``edge`` is the longest straight edge [m]. A cap has at most 400 rings.
        """
        edge = positive(edge, "edge", "m")
        check_size(self.extent)
        max_rings = 400  # 1.6 million triangles; with more the edge is probably in a wrong unit
        fewest = max_rings + 1
        if edge > self.radius / max_rings:
            fewest = max(2, math.ceil(1.6 * self.radius / edge))
        for rings in range(fewest, max_rings + 1):
            around = 5 * rings  # five triangles around a pole keep every angle above 30 degrees
            count = _triangle_count(rings, around, self.length / self.radius)
            if count > 2_000_000:  # a length is probably in a wrong unit
                raise InvalidInput(
                    f"a capsule of {1e3 * self.radius:.4g} mm radius and {1e3 * self.length:.4g} "
                    f"mm length needs {count:,} triangles, but at most 2,000,000 are allowed. Use "
                    "metres for all lengths.",
                    self.pose.translation,
                    code="too_many",
                )
            vertices, triangles = _mesh(rings, around, self.length / self.radius)
            vertices = self.radius * vertices
            if longest_edges(vertices[triangles]).max() <= edge:
                at_rest = Capsule(self.radius, self.length, Pose.identity())
                return Surface(
                    fixed(self.pose.apply(vertices)),
                    triangles,
                    fixed(self.pose.apply(at_rest.edge_middles(vertices[triangles]))),
                    primitive=self,
                    _known_shape=self,
                )
        raise InvalidInput(
            f"an edge of {edge * 1e3:.4g} mm on a radius of {self.radius * 1e3:.4g} mm needs more "
            f"than {max_rings} rings for each cap; use a longer edge.",
            self.pose.translation,
            code="out_of_range",
        )


def sphere(radius: float, edge: float, centre: Vector = (0, 0, 0)) -> Surface:
    """Build a sphere. Solvers use the exact shape and their own panels instead of its mesh.

    Parameters
    ----------
    radius : radius of the sphere [m], 0.00025 to 1.
    edge : longest triangle edge of the mesh [m], at least 1/250 of the radius. The mesh is used
        only for pictures and files.
    centre : (3,) centre of the sphere in the frame of the surface [m]; by default, the origin.

    Returns
    -------
    A closed ``Surface``, with the sphere as its exact shape, for ``sound_hard`` and other functions
    that build bodies.

    Raises
    ------
    InvalidInput
        If the radius or the edge is outside its range, or the centre is not finite.

    Examples
    --------
    >>> sphere(radius=0.01, edge=0.003).midpoints is not None
    True
    """
    return Capsule(radius, 0.0, Pose(np.eye(3), point_of(centre, "sphere centre"))).mesh(edge)


def capsule(start: Vector, end: Vector, radius: float, edge: float) -> Surface:
    """Build a capsule: the surface at distance ``radius`` from the segment ``start`` to ``end``.

    Parameters
    ----------
    start, end : (3,) ends of the axis, which are ``radius`` from the ends of the capsule [m]; equal
        ends produce a sphere.
    radius : radius of the capsule [m], above 0.
    edge : longest edge of the triangles of its mesh [m], above 0. Solvers use the exact shape, so
        the mesh mainly matters for pictures and files.

    Returns
    -------
    The closed ``Surface``, with the capsule as its exact shape, in the frame of ``start`` and
    ``end``.

    Raises
    ------
    InvalidInput
        If the radius or the edge is not above zero, if an end is not finite, if the capsule is
        shorter than 0.5 mm or longer than 2 m in total, or if the edge requires more than 2,000,000
        triangles or 400 rings of triangles per cap.
    """
    first = point_of(start, "capsule start")
    last = point_of(end, "capsule end")
    length = float(np.linalg.norm(last - first))
    rotation = turn_from_z((last - first) / length) if length > 0.0 else np.eye(3)
    return Capsule(radius, length, Pose(rotation, (first + last) / 2.0)).mesh(edge)


def turn_from_z(direction: Vector3) -> Float64[np.ndarray, "3 3"]:
    """Return a rotation that maps the z axis to a unit direction (3,)."""
    x, y, z = direction
    if z < 0.0:  # half a turn about x avoids the pole of the formula at -z
        return np.diag([1.0, -1.0, -1.0]) @ turn_from_z(np.array([x, -y, -z]))
    s = 1.0 / (1.0 + z)
    return np.array(
        [[1.0 - s * x * x, -s * x * y, x], [-s * x * y, 1.0 - s * y * y, y], [-x, -y, z]]
    )


def nearest_on_segments(
    first: Float64[np.ndarray, "2 3"], second: Float64[np.ndarray, "2 3"]
) -> tuple[Vector3, Vector3]:
    """Return the point [m] on each of two segments (2, 3) that is nearest to the other segment.

    Source: C. Ericson, *Real-Time Collision Detection*, Morgan Kaufmann (2005), section 5.1.9.
    """
    p = first[0]
    q = second[0]
    u = first[1] - p
    v = second[1] - q
    a = u @ u
    b = u @ v
    c = v @ v
    d = u @ (p - q)
    e = v @ (p - q)
    determinant = a * c - b * b
    skew = determinant > 1e-14 * a * c
    s = np.clip((b * e - c * d) / determinant, 0.0, 1.0) if skew else 0.0
    t = np.clip((b * s + e) / c, 0.0, 1.0) if c > 0.0 else 0.0
    s = np.clip((b * t - d) / a, 0.0, 1.0) if a > 0.0 else 0.0
    return p + s * u, q + t * v


# --- the mesh of a capsule of radius 1 --------------------------------------------------------


def _mesh(rings: int, around: int, length: float) -> tuple[Vertices, Triangles]:
    """Mesh the capsule of radius 1.

    Each cap has ``rings`` rings; the widest ring has ``around`` points.
    """
    cap, _ = _cap(rings, around)
    above = cap[:-around]
    waist = cap[-around:]
    bands = _bands(around, length)
    half = np.array([0.0, 0.0, length / 2.0])
    step = math.pi / around  # each ring of the cylinder is turned by half a step
    turn = step * np.arange(bands + 1)[:, None]
    belt = np.empty((bands + 1, around, 3))
    belt[:, :, 0] = np.cos(turn) * waist[:, 0] - np.sin(turn) * waist[:, 1]
    belt[:, :, 1] = np.sin(turn) * waist[:, 0] + np.cos(turn) * waist[:, 1]
    heights = 1.0 - 2.0 * np.arange(bands + 1) / bands if bands else np.zeros(1)
    belt[:, :, 2] = half[2] * heights[:, None]
    cosine = math.cos(step * bands)
    sine = math.sin(step * bands)
    turned = above @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    below = turned * [1.0, 1.0, -1.0]
    vertices = np.concatenate([above + half, belt.reshape(-1, 3), below - half])
    return vertices, _triangles(rings, around, bands)


@lru_cache(maxsize=16)
def _triangles(rings: int, around: int, bands: int) -> Triangles:
    cap, triangles = _cap(rings, around)
    above = len(cap) - around
    last = above + bands * around
    below = np.r_[last + around + np.arange(above), last + np.arange(around)]
    steps = np.arange(around)
    ring = above + around * np.arange(bands)[:, None]
    point = ring + steps
    next_point = ring + (steps + 1) % around
    down = np.stack([point, point + around, next_point], axis=2)
    up = np.stack([next_point, point + around, next_point + around], axis=2)
    belt = np.concatenate([down, up]).reshape(-1, 3)
    result = np.concatenate([triangles, belt, below[triangles][:, ::-1]]).astype(np.int64)
    result.flags.writeable = False
    return result


def _bands(around: int, length: float) -> int:
    # The step is the height of an equilateral triangle on an edge of the cylinder's rim.
    step = math.sqrt(3.0) * math.sin(math.pi / around)
    # A cylinder too short for a band of good triangles has no band. Both caps then share one ring
    # in the middle.
    return max(1, round(length / step)) if length > 0.6 * step else 0


def _triangle_count(rings: int, around: int, length: float) -> int:
    return 2 * (2 * _inner_points(rings, around) + around + around * _bands(around, length))


@cache
def _inner_points(rings: int, around: int) -> int:
    return sum(_ring_points(ring, rings, around) for ring in range(1, rings))


def _ring_points(ring: int, rings: int, around: int) -> int:
    """Return the number of points on a ring, proportional to its index, from 3 to ``around``."""
    return max(3, (2 * around * ring + rings) // (2 * rings))


@lru_cache(maxsize=16)
def _cap(rings: int, around: int) -> tuple[Vertices, Triangles]:
    """Mesh the upper half of the unit sphere: the pole, then ring i at polar angle (π/2)(i/m).

    Between two rings, the edges of both are ordered by their middles. Each edge forms a triangle
    with the preceding point of the other ring.
    """
    points = [np.array([[0.0, 0.0, 1.0]])]
    triangles = []
    inner = 0  # first vertex of the previous ring, then its number of points
    fewer = 1
    for ring in range(1, rings + 1):
        count = _ring_points(ring, rings, around)
        outer = inner + fewer
        polar = math.pi / 2.0 * ring / rings
        angle = 2.0 * math.pi * np.arange(count) / count
        height = 0.0 if ring == rings else math.cos(polar)
        flat = math.sin(polar) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        points.append(np.column_stack([flat, np.full(count, height)]))
        index = np.arange(count)
        before = ((2 * index + 1) * fewer + count - 1) // (2 * count) % fewer
        triangles.append(
            np.stack([inner + before, outer + index, outer + (index + 1) % count], axis=1)
        )
        if fewer > 1:
            above = np.arange(fewer)
            after = ((2 * above + 1) * count + fewer) // (2 * fewer) % count
            triangles.append(
                np.stack([inner + above, outer + after, inner + (above + 1) % fewer], axis=1)
            )
        inner = outer
        fewer = count
    return np.concatenate(points), np.concatenate(triangles)
