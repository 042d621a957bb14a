"""Solids with a signed distance, in closed form or interpolated on a grid for meshes."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float64, Real

from airtact.errors import (
    InvalidInput,
    Vector,
    direction_of,
    fixed,
    in_short,
    point_of,
    positive,
)
from airtact.geometry.mesh.triangles import FlatMesh, PointLengths, Vector3, check_size
from airtact.geometry.primitives import Capsule, turn_from_z
from airtact.geometry.surface import Surface

Points = Real[np.ndarray, "points 3"]


class Solid(ABC):
    """A solid that skin can enter: the abstract base class of all shapes of virtual objects.

    Use a subclass, such as ``Box``, as the ``shape`` of a ``VirtualObject``. A subclass of your own
    implements three methods: ``depth(points)`` returns the depths (P,) of points (P, 3) below the
    surface, negative outside; ``ball()`` returns the centre (3,) and the radius of an enclosing
    ball; and ``mesh()`` returns vertices (V, 3) and triangles (T, 3), which are only displayed. All
    points and lengths are in the solid's own coordinates [m], which ``VirtualObject.pose`` maps to
    those of the scene.
    """

    @abstractmethod
    def depth(self, points: Points) -> PointLengths:
        """Return the depth (P,) [m] of points (P, 3) below the surface, negative outside."""

    def exact_depth(self, points: Points) -> PointLengths:
        """Return the same depths as ``depth``, but without interpolation."""
        return self.depth(points)

    @abstractmethod
    def ball(self) -> tuple[Vector3, float]:
        """Centre (3,) and radius [m] of an enclosing ball; a half-space has an infinite radius."""

    @abstractmethod
    def mesh(self) -> FlatMesh:
        """Vertices (V, 3) [m] and triangles (T, 3) for display."""


@dataclass(frozen=True, eq=False)
class Box(Solid):
    """A box with sides parallel to the axes of its own frame, as the shape of a ``VirtualObject``.

    To turn or move the box, set ``VirtualObject.pose``.

    Attributes
    ----------
    sides : (3,) side lengths along x, y and z [m], above 0; the longest is 0.5 mm to 2 m.
    centre : (3,) centre of the box [m], at most 2 m from the origin of its own frame; by default,
        the origin.

    Raises
    ------
    InvalidInput
        If a length or the centre is outside its range, or a number is NaN or infinite.

    Examples
    --------
    >>> box = Box((0.04, 0.02, 0.02))
    >>> box.depth(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.03]])).round(6).tolist()
    [0.01, -0.02]
    """

    sides: Vector
    centre: Vector = (0.0, 0.0, 0.0)

    __repr__ = in_short

    def __post_init__(self) -> None:
        sides = point_of(self.sides, "the sides of a box")
        for side in sides:
            positive(float(side), "a side of a box", "m")
        check_size(float(sides.max()))
        object.__setattr__(self, "sides", sides)
        object.__setattr__(self, "centre", near_point(self.centre, "the centre of a box"))

    def depth(self, points: Points) -> PointLengths:
        beyond = np.abs(points - self.centre) - 0.5 * np.asarray(self.sides)
        return _depth_in(*beyond.T)

    def ball(self) -> tuple[Vector3, float]:
        return np.asarray(self.centre), 0.5 * float(np.linalg.norm(self.sides))

    def mesh(self) -> FlatMesh:
        from trimesh.creation import box

        made = box(extents=self.sides)
        return fixed(made.vertices + self.centre), made.faces.astype(np.int64)


@dataclass(frozen=True, eq=False)
class Cylinder(Solid):
    """A cylinder with flat ends, as the shape of a ``VirtualObject``.

    Attributes
    ----------
    start, end : (3,) centres of the two end faces [m], at most 2 m from the origin of the
        cylinder's own frame.
    radius : radius of the cylinder [m].

    Raises
    ------
    InvalidInput
        If the radius or the length is not above zero, if the larger of length and diameter is not
        between 0.5 mm and 2 m, or if an end is more than 2 m from the frame's origin.

    Examples
    --------
    >>> rod = Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.1), radius=0.01)
    >>> rod.depth(np.array([[0.0, 0.0, 0.02], [0.013, 0.0, 0.104]])).round(6).tolist()
    [0.01, -0.005]
    """

    start: Vector
    end: Vector
    radius: float

    __repr__ = in_short

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", positive(self.radius, "the radius of a cylinder", "m"))
        object.__setattr__(self, "start", near_point(self.start, "the start of a cylinder"))
        object.__setattr__(self, "end", near_point(self.end, "the end of a cylinder"))
        positive(self.length, "the length of a cylinder", "m")
        check_size(max(2.0 * self.radius, self.length))

    @cached_property
    def length(self) -> float:
        """Length along the axis [m]."""
        return float(np.linalg.norm(np.asarray(self.end) - self.start))

    @cached_property
    def _axis(self) -> Vector3:
        return (np.asarray(self.end) - self.start) / self.length

    def depth(self, points: Points) -> PointLengths:
        relative = points - self.start
        along = relative @ self._axis
        square = np.einsum("pi,pi->p", relative, relative) - along * along
        beside = np.sqrt(np.maximum(square, 0.0)) - self.radius
        half = 0.5 * self.length
        return _depth_in(beside, np.abs(along - half) - half)

    def ball(self) -> tuple[Vector3, float]:
        middle = 0.5 * (np.asarray(self.start) + self.end)
        return middle, float(np.hypot(self.radius, 0.5 * self.length))

    def mesh(self) -> FlatMesh:
        from trimesh.creation import cylinder

        made = cylinder(radius=self.radius, height=self.length, sections=48)
        middle = 0.5 * (np.asarray(self.start) + self.end)
        vertices = made.vertices @ turn_from_z(self._axis).T + middle
        return fixed(vertices), made.faces.astype(np.int64)


@dataclass(frozen=True, eq=False)
class HalfSpace(Solid):
    """A solid that fills the space behind an infinite plane, such as a virtual table.

    Points and vectors are in the solid's own coordinates, which the pose of a ``VirtualObject``
    maps to those of the scene.

    Attributes
    ----------
    point : (3,) any point on the plane [m], at most 2 m from the origin.
    normal : (3,) vector that points out of the solid; a vector of any length is stored with unit
        length.

    Raises
    ------
    InvalidInput
        If the point is farther than 2 m from the frame's origin, if the normal is zero, or if a
        number is NaN or infinite.

    Examples
    --------
    >>> HalfSpace((0, 0, 0.1), (0, 0, 1)).depth(np.array([[5.0, 0.0, 0.08]])).round(6).tolist()
    [0.02]
    """

    point: Vector
    normal: Vector

    __repr__ = in_short

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", near_point(self.point, "the point of a half-space"))
        object.__setattr__(self, "normal", direction_of(self.normal, "the normal of a half-space"))

    def depth(self, points: Points) -> PointLengths:
        normal = np.asarray(self.normal)
        return float(np.asarray(self.point) @ normal) - points @ normal

    def ball(self) -> tuple[Vector3, float]:
        return np.asarray(self.point), np.inf

    def mesh(self) -> FlatMesh:
        # Display a disc of 0.2 m in the plane.
        turn = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
        circle = 0.1 * np.stack([np.cos(turn), np.sin(turn), np.zeros(48)], axis=1)
        vertices = np.concatenate([np.zeros((1, 3)), circle])
        rim = np.arange(48)
        triangles = np.stack([np.zeros(48, np.int64), rim + 1, (rim + 1) % 48 + 1], axis=1)
        return fixed(vertices @ turn_from_z(np.asarray(self.normal)).T + self.point), triangles


@dataclass(frozen=True, eq=False)
class Button(Solid):
    """A disc that can be pressed in, as the shape of a ``VirtualObject``.

    Unless the object's ``stiffness`` is set, the strength of a touch rises linearly from 0.2 at the
    disc's face to 1 at the depth ``travel``, and stays 1 beyond. The disc does not move. The button
    is a solid cylinder from the face to 20 mm below the end of the travel; skin farther below does
    not touch it. Depths are distances from the nearest point of the cylinder's surface, so near its
    side they are distances from the side.

    Attributes
    ----------
    centre : (3,) centre of the disc's face [m], at most 2 m from the origin of the button's own
        frame.
    radius : radius of the disc [m], at most 1.
    travel : depth at which the button is fully pressed [m].
    normal : (3,) vector of any length above zero that points out of the button, opposite to the
        direction of pressing.

    Raises
    ------
    InvalidInput
        If a length is not above zero, the normal is zero, or the cylinder is more than 2 m long,
        more than 2 m wide or more than 2 m from the frame's origin.

    Examples
    --------
    >>> button = Button((0.0, 0.0, 0.0), radius=0.01, travel=0.004)
    >>> button.depth(np.array([[0.0, 0.0, -0.003]])).round(6).tolist()
    [0.003]
    """

    centre: Vector
    radius: float
    travel: float
    normal: Vector = (0.0, 0.0, 1.0)

    __repr__ = in_short

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", near_point(self.centre, "the centre of a button"))
        object.__setattr__(self, "normal", direction_of(self.normal, "the normal of a button"))
        object.__setattr__(self, "travel", positive(self.travel, "the travel of a button", "m"))
        self._body  # noqa: B018 (checks the radius)

    @cached_property
    def _body(self) -> Cylinder:
        # If a finger is pressed through, up to 20 mm beyond the travel still counts as contact.
        below = (self.travel + 20e-3) * np.asarray(self.normal)
        return Cylinder(np.asarray(self.centre) - below, self.centre, self.radius)

    def depth(self, points: Points) -> PointLengths:
        return self._body.depth(points)

    def ball(self) -> tuple[Vector3, float]:
        return self._body.ball()

    def mesh(self) -> FlatMesh:
        bottom = np.asarray(self.centre) - self.travel * np.asarray(self.normal)
        return Cylinder(bottom, self.centre, self.radius).mesh()


@dataclass(frozen=True, eq=False)
class SurfaceSolid(Solid):
    """The solid inside a closed surface; depths are exact for spheres and capsules.

    For a mesh, an exact depth takes 10 µs per point. ``depth`` therefore interpolates between
    the nodes of a grid with a spacing of 1/40 of the longest side. This takes 0.3 µs per point.

    Attributes
    ----------
    surface : the closed surface.
    """

    surface: Surface

    __repr__ = in_short

    @cached_property
    def _grid(self) -> tuple[Vector3, float, Float64[np.ndarray, "x y z"]]:
        # First node and spacing [m] of a grid that extends 2 mm beyond the mesh, and the depths.
        lowest = self.surface.vertices.min(axis=0) - 2e-3
        spans = self.surface.vertices.max(axis=0) + 2e-3 - lowest
        # With 40 steps there are at most 69,000 nodes; their depths take 1 to 2 s per mesh.
        step = float(spans.max()) / 40.0
        axes = [
            low + step * np.arange(int(np.ceil(span / step)) + 1)
            for low, span in zip(lowest, spans, strict=True)
        ]
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        return lowest, step, self.surface.depth(nodes.reshape(-1, 3)).reshape(nodes.shape[:3])

    @cached_property
    def error(self) -> float:
        """Root-mean-square error of ``depth`` at 500 points within 2 mm of the surface [m]."""
        rng = np.random.default_rng(0)
        corners = self.surface.vertices[self.surface.triangles]
        chosen = corners[rng.integers(len(corners), size=500)]
        points = np.einsum("pc,pci->pi", rng.dirichlet(np.ones(3), 500), chosen)
        points = points + rng.uniform(-2e-3, 2e-3, (500, 3)) / np.sqrt(3.0)
        return float(np.sqrt(np.mean((self.depth(points) - self.exact_depth(points)) ** 2)))

    def depth(self, points: Points) -> PointLengths:
        if isinstance(self.surface.shape, Capsule):
            return self.surface.shape.depth(points)
        from scipy.ndimage import map_coordinates

        lowest, step, depths = self._grid
        cells = (points - lowest) / step
        nearest = np.clip(cells, 0.0, np.array(depths.shape) - 1.0)
        # Outside the grid, subtract the distance to it, which gives a lower bound of the depth.
        beyond = step * np.linalg.norm(cells - nearest, axis=1)
        return map_coordinates(depths, nearest.T, order=1) - beyond

    def exact_depth(self, points: Points) -> PointLengths:
        return self.surface.shape.depth(points)

    def ball(self) -> tuple[Vector3, float]:
        return self._ball

    @cached_property
    def _ball(self) -> tuple[Vector3, float]:
        vertices = self.surface.vertices
        centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        return centre, float(np.linalg.norm(vertices - centre, axis=1).max())

    def mesh(self) -> FlatMesh:
        return self.surface.vertices, self.surface.triangles


@lru_cache(maxsize=64)  # a moving object keeps its surface, and therefore its grid
def solid_of(surface: Surface) -> SurfaceSolid:
    """Return the solid inside a surface; the grid of a mesh is computed on first use."""
    return SurfaceSolid(surface)


def near_point(vector: Vector, what: str) -> Vector3:
    """Check that a point is finite and within 2 m of the origin, and return it."""
    point = point_of(vector, what)
    distance = float(np.linalg.norm(point))
    if distance > 2.0:
        raise InvalidInput(
            f"{what} is {distance:.4g} m from the origin, but at most 2 m is allowed: is it in "
            "millimetres? Use metres.",
            point,
            code="not_in_metres",
        )
    return point


def _depth_in(*beyond: PointLengths) -> PointLengths:
    """Return the depth [m] from signed distances to the sides along perpendicular axes [m]."""
    # Work axis by axis, because NumPy is slow at reducing short axes.
    square = np.zeros_like(beyond[0])
    nearest = np.full_like(square, -np.inf)
    for distance in beyond:
        outside = np.maximum(distance, 0.0)
        square += outside * outside
        nearest = np.maximum(nearest, distance)
    return -(np.sqrt(square) + np.minimum(nearest, 0.0))
