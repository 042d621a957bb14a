"""Sphere and capsule: exact shapes and their curved meshes."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64, Real

from airtact.conventions import InvalidInput, Vector
from airtact.scene.geometry import Pose, Surface
from airtact.scene.guards import positive, refuse_not_finite

_SECTORS = 5  # triangles round a pole; five keep every angle above 30 degrees
_MOST_RINGS = 400  # 1.6 million triangles: beyond it the edge is a slip of units


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within ``radius`` of a segment: the local z axis from -length/2 to +length/2. Length 0 is a sphere.

    Attributes
    ----------
    radius : [m], above zero.
    length : length of the axis [m], zero or more.
    pose : where it stands.

    Raises
    ------
    InvalidInput
        When the radius is not above zero or the length is negative or not finite.

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
        """Check the two lengths."""
        object.__setattr__(self, "radius", positive(self.radius, "radius", "m"))
        length = float(self.length)
        if not math.isfinite(length) or length < 0.0:
            raise InvalidInput(f"a capsule's axis has length {length:g} m, but it must be finite and not negative.")
        object.__setattr__(self, "length", length)

    @property
    def extent(self) -> float:
        """Largest distance between two of its points [m]."""
        return self.length + 2.0 * self.radius

    @property
    def area(self) -> float:
        """Area of the skin [m²]."""
        return 2.0 * math.pi * self.radius * self.extent

    @property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        return math.pi * self.radius**2 * (self.length + 4.0 / 3.0 * self.radius)

    @property
    def axis(self) -> Float64[np.ndarray, "2 3"]:
        """Start and end of the axis (2, 3) [m]."""
        return self.pose.apply(np.array([[0.0, 0.0, -self.length / 2.0], [0.0, 0.0, self.length / 2.0]]))

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance to the skin [m] of points (P, 3) [m], positive inside."""
        local = self.pose.inverse().apply(points)
        return self.radius - np.linalg.norm(local - self._nearest_on_axis(local), axis=1)

    def moved(self, pose: Pose) -> "Capsule":
        """Move it rigidly.

        Parameters
        ----------
        pose : the motion.
        """
        return Capsule(self.radius, self.length, pose @ self.pose)

    def mesh(self, edge: float) -> Surface:
        """Draw it with curved triangles whose vertices and midpoints lie exactly on it.

        Each cap is a hemisphere of m rings, ring i having 5 i points; the cylinder between has rings of 5 m points, each
        turned by half a step. The mesh is made at rest and then moved, so that it moves exactly with the pose.

        Parameters
        ----------
        edge : longest straight edge allowed [m]; there are at least three rings a cap, whatever it says.

        Raises
        ------
        InvalidInput
            When ``edge`` is not above zero, or so small that a cap would need more than 400 rings.
        """
        edge = positive(edge, "edge", "m")
        rings = max(3, math.ceil(1.9 * self.radius / edge)) if edge > self.radius / _MOST_RINGS else _MOST_RINGS + 1
        while rings <= _MOST_RINGS:
            vertices, triangles = _mesh(rings, self.length / self.radius)
            corners = self.radius * vertices[triangles]
            if rings > 3 and np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max() > edge:
                rings += 1
                continue
            return self._surface(self.radius * vertices, triangles)
        raise InvalidInput(
            f"an edge of {edge * 1e3:.4g} mm on a radius of {self.radius * 1e3:.4g} mm needs more than {_MOST_RINGS} rings "
            "a cap; ask for a longer edge."
        )

    def _surface(
        self, vertices: Float64[np.ndarray, "vertices 3"], triangles: Int64[np.ndarray, "triangles 3"]
    ) -> Surface:
        corners = vertices[triangles]
        middles = ((corners + np.roll(corners, -1, axis=1)) / 2.0).reshape(-1, 3)
        feet = self._nearest_on_axis(middles)
        out = middles - feet
        midpoints = feet + self.radius * out / np.linalg.norm(out, axis=1, keepdims=True)
        rest = Capsule(self.radius, self.length, Pose.identity())
        return Surface(vertices, triangles, midpoints.reshape(-1, 3, 3), rest).moved(self.pose)

    def _nearest_on_axis(self, local: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        foot = np.zeros(local.shape)
        foot[:, 2] = np.clip(local[:, 2], -self.length / 2.0, self.length / 2.0)
        return foot


def sphere(radius: float, edge: float, centre: Vector = (0, 0, 0)) -> Surface:
    """Mesh a sphere.

    Parameters
    ----------
    radius : [m].
    edge : longest edge of its triangles [m].
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
    return Capsule(radius, 0.0, Pose(np.eye(3), _point(centre, "sphere centre"))).mesh(edge)


def capsule(start: Vector, end: Vector, radius: float, edge: float) -> Surface:
    """Mesh a capsule, the skin at ``radius`` round the segment from ``start`` to ``end``.

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
    first, last = _point(start, "capsule start"), _point(end, "capsule end")
    length = float(np.linalg.norm(last - first))
    rotation = _turn_from_z((last - first) / length) if length > 0.0 else np.eye(3)
    return Capsule(radius, length, Pose(rotation, (first + last) / 2.0)).mesh(edge)


def _point(given: Vector, what: str) -> Float64[np.ndarray, "3"]:
    point = np.array(given, dtype=np.float64)
    if point.shape != (3,):
        raise InvalidInput(f"{what} has shape {point.shape}, but a point has shape (3,).")
    refuse_not_finite(point, what)
    return point


def _turn_from_z(direction: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Rotation that brings the z axis to a unit direction."""
    x, y, z = direction
    if z < 0.0:  # by way of half a turn about x, which keeps the formula away from its pole at -z
        return np.diag([1.0, -1.0, -1.0]) @ _turn_from_z(np.array([x, -y, -z]))
    s = 1.0 / (1.0 + z)
    return np.array([[1.0 - s * x * x, -s * x * y, x], [-s * x * y, 1.0 - s * y * y, y], [-x, -y, z]])


def _mesh(rings: int, length: float) -> tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "triangles 3"]]:
    """Mesh the capsule of radius 1 whose axis has the given length."""
    cap, cap_triangles = _cap(rings)
    around = _SECTORS * rings
    step = math.sqrt(3.0) * math.sin(math.pi / around)  # height of an equilateral triangle over one ring's edge
    bands = max(1, round(length / step)) if length > 0.6 * step else 0
    turns = np.arange(around)
    rows = [cap + [0.0, 0.0, length / 2.0 if bands else 0.0]]
    if not bands:  # the cylinder is too short for a band: both caps share its waist and reach past it
        rows[0][: len(cap) - around, 2] += length / 2.0
    for band in range(1, bands + 1):
        angle = 2.0 * math.pi / around * (turns + 0.5 * band)
        height = np.full(around, length / 2.0 - length * band / bands)
        rows.append(np.stack([np.cos(angle), np.sin(angle), height], axis=1))
    below = len(cap) - around + np.arange(bands)[:, None] * around
    here, after = below + turns, below + (turns + 1) % around
    belt = np.concatenate(
        [np.stack([here, here + around, after], axis=2), np.stack([after, here + around, after + around], axis=2)]
    ).reshape(-1, 3)
    waist = len(cap) - around + bands * around
    inner = cap[: len(cap) - around]
    spin = math.pi / around * bands
    turned = inner @ np.array(
        [[math.cos(spin), math.sin(spin), 0.0], [-math.sin(spin), math.cos(spin), 0.0], [0, 0, -1.0]]
    )
    rows.append(turned - [0.0, 0.0, length / 2.0])
    renamed = np.r_[waist + around + np.arange(len(inner)), waist + turns]
    return np.concatenate(rows), np.concatenate([cap_triangles, belt, renamed[cap_triangles][:, ::-1]]).astype(np.int64)


def _cap(rings: int) -> tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "triangles 3"]]:
    """Mesh the upper half of the unit sphere: the pole, then ring i of 5 i points at polar angle (π/2)(i/m)."""
    points, triangles = [np.array([[0.0, 0.0, 1.0]])], []
    for ring in range(1, rings + 1):
        polar = math.pi / 2.0 * ring / rings
        angle = 2.0 * math.pi * np.arange(_SECTORS * ring) / (_SECTORS * ring)
        height = 0.0 if ring == rings else math.cos(polar)
        points.append(
            np.stack([math.sin(polar) * np.cos(angle), math.sin(polar) * np.sin(angle), np.full(len(angle), height)], 1)
        )
        sector, across = np.divmod(np.arange(_SECTORS * ring), ring)
        inner, outer = (
            1 + _SECTORS * ring * (ring - 1) // 2 - _SECTORS * (ring - 1),
            1 + _SECTORS * ring * (ring - 1) // 2,
        )
        inside = (sector * (ring - 1) + across) % max(1, _SECTORS * (ring - 1))
        if ring == 1:
            inner = 0
        here = np.arange(_SECTORS * ring)
        triangles.append(np.stack([inner + inside, outer + here, outer + (here + 1) % (_SECTORS * ring)], axis=1))
        again = here[across > 0]
        before = inside[again] - 1
        before = (sector[again] * (ring - 1) + across[again] - 1) % max(1, _SECTORS * (ring - 1))
        triangles.append(np.stack([inner + before, outer + again, inner + inside[again]], axis=1))
    return np.concatenate(points), np.concatenate(triangles)
