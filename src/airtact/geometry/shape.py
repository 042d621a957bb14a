"""The interface of a body's true surface, with defaults for exact shapes such as spheres."""

import math
from abc import ABC, abstractmethod
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from airtact.geometry.mesh.remeshing import RidgedMesh
from airtact.geometry.mesh.triangles import (
    EdgeVectors,
    IndexPairs,
    PointLengths,
    Points,
    PointVectors,
    QuadraticTriangles,
    Vector3,
)
from airtact.geometry.pose import Pose

# Default angle between the normals at opposite edges of a panel on a round surface [rad].
BEND = math.pi / 5


class Shape(ABC):
    """The true surface of a body: an exact shape such as a sphere, or a curved mesh.

    This is the abstract base class. ``Surface.shape`` contains an instance; solvers use it instead
    of the flat triangles. ``depth`` measures the distance of points from the surface, ``project``
    projects points onto it, and ``panels`` covers it with curved panels. Subclasses implement these
    methods, ``extreme_points``, ``coarse_meshes``, ``extent``, ``area`` and ``volume``. The
    arguments and results of all methods are in the frame of the scene.

    Attributes
    ----------
    pose : ``Pose`` that maps the shape's own frame, in which its other attributes are given, to the
        frame of the scene.
    """

    pose: Pose

    @property
    @abstractmethod
    def extent(self) -> float:
        """Largest dimension [m] of an exact shape, or longest side of a mesh's bounding box."""

    @property
    @abstractmethod
    def area(self) -> float:
        """Area of the surface [m²]."""

    @property
    @abstractmethod
    def volume(self) -> float:
        """Enclosed volume [m³]."""

    @property
    def thinnest(self) -> float:
        """Thickness [m] (see ``thickness_at``) if it is the same everywhere, otherwise 0."""
        return 0.0

    @property
    def least_thickness(self) -> float:
        """Lower bound [m] on the thickness (see ``thickness_at``), or 0 if unknown."""
        return self.thinnest

    def thickness_at(
        self, points: Points, normals: PointVectors, largest: float
    ) -> Float64[np.ndarray, "points"]:
        """Return a lower bound (P,) [m] on the thickness of the body at surface points (P, 3).

        The thickness at a point is the diameter of the largest ball in the body that touches the
        surface there. ``normals`` (P, 3) point outwards. Bounds above ``largest`` [m] need not be
        accurate.
        """
        return np.full(len(points), self.least_thickness)

    @property
    def crossings(self) -> IndexPairs:
        """Pairs of triangles (K, 2) that meet, other than at a common corner or edge."""
        return np.zeros((0, 2), dtype=np.int64)

    def nested_piece(self) -> tuple[int, int, float, Vector3] | None:
        """Find a piece that lies inside another piece, or return None if there is none.

        The results are the indices of the inner and the outer piece, the depth [m] of the inner
        piece below the outer one, and a point (3,) of the inner piece [m].
        """
        return None

    @abstractmethod
    def depth(self, points: Points) -> PointLengths:
        """Return the depth [m] of points (P, 3) below the surface, negative outside."""

    @abstractmethod
    def project(self, points: Points) -> PointVectors:
        """Return the nearest point (P, 3) of the surface for each of P points (P, 3) [m]."""

    def project_on_sharp_edges(self, points: Points) -> PointVectors:
        """Return the nearest points [m] of the sharp edges, or of the surface if there are none."""
        return self.project(points)

    def fitted(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        """Return panels (P, 6, 3) [m] that fit the surface, starting from panels near it."""
        return self.project(panels.reshape(-1, 3)).reshape(panels.shape)

    def edge_middles(self, corners: EdgeVectors) -> EdgeVectors:
        """Return the surface points at the middles of edges 01, 12, 20 of triangles [m]."""
        straight = 0.5 * (corners + np.roll(corners, -1, axis=1))
        return self.project(straight.reshape(-1, 3)).reshape(straight.shape)

    def off_triangles(self, points: Points) -> PointLengths:
        """Return the distance [m] of points from the mesh triangles, or 0 for exact shapes."""
        return np.zeros(len(points))

    @abstractmethod
    def panels(self, edge: float, bend: float = BEND, away: float = math.inf) -> QuadraticTriangles:
        """Cover the surface with curved panels as large as equilateral triangles of side ``edge``.

        On an exact shape, the normal turns by at most about ``bend`` [rad] from one edge of a panel
        to another. On smooth parts of a mesh, the rms deviation of panels from the surface is at
        most about ``away`` [m].
        """

    @abstractmethod
    def extreme_points(self) -> PointVectors:
        """Return points (P, 3) [m] with the same axis-aligned bounding box as the body."""

    def farthest(self, direction: Vector3) -> Vector3:
        """Return the point (3,) of the body [m] that is farthest along a unit direction."""
        points = self.extreme_points()
        return points[(points @ direction).argmax()]

    @abstractmethod
    def coarse_meshes(self, edge: float) -> list[RidgedMesh]:
        """Return initial triangles, with edges of about ``edge`` [m], for remeshing each piece."""

    def moved(self, pose: Pose) -> "Shape":
        """Return the shape after a rigid motion."""
        return replace(self, pose=pose @ self.pose)  # type: ignore[type-var]
