"""What every room may ask of a body's true surface, whatever it is made of; the answers here are a closed form's."""

import math
from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Float64, Int64, Real

from airtact.geometry.mesh.quadratic_triangles import QuadraticTriangles
from airtact.geometry.mesh.remeshing import RidgedMesh
from airtact.geometry.pose import Pose

BEND = math.pi / 5
"""Angle that a panel of a round surface may turn by [rad], where nothing coarser will do."""

FlatMesh = tuple[Float64[np.ndarray, "_ 3"], Int64[np.ndarray, "_ 3"]]
"""Vertices (V, 3) [m] and triangles (T, 3) of vertex indices."""


class Shape(ABC):
    """The true surface of a body: a closed form, or the curved triangles of a mesh."""

    @property
    @abstractmethod
    def extent(self) -> float:
        """Largest distance between two of its points, or largest side of the box round it at rest [m]."""

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
        """Diameter [m] of the largest ball inside that touches the surface, if it is the same everywhere; else 0."""
        return 0.0

    @property
    def least_thickness(self) -> float:
        """Diameter [m] that the largest ball inside has at least, wherever it touches the surface; 0 if unknown."""
        return self.thinnest

    def thickness_at(
        self,
        points: Real[np.ndarray, "points 3"],
        normals: Float64[np.ndarray, "points 3"],
        most: float,
    ) -> Float64[np.ndarray, "points"]:
        """Diameter (P,) [m] that the largest ball inside has at least that touches the surface at each of some points.

        The points (P, 3) [m] have outward normals (P, 3); diameters above ``most`` [m] are of no
        interest.
        """
        return np.full(len(points), self.least_thickness)

    @property
    def crossings(self) -> Int64[np.ndarray, "crossings 2"]:
        """Pairs of triangles (K, 2) that cross or touch beyond what they share as neighbours."""
        return np.zeros((0, 2), dtype=np.int64)

    def nested_piece(self) -> tuple[int, int, float, Float64[np.ndarray, "3"]] | None:
        """Find a closed piece inside another: both numbers, how deep [m] and a point (3,) there [m]; None if none."""
        return None

    @abstractmethod
    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance to the surface [m] of points (P, 3) [m], positive inside."""

    @abstractmethod
    def project(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Nearest points of the surface (P, 3) [m] to points (P, 3) [m]."""

    def project_on_sharp_edges(
        self, points: Real[np.ndarray, "points 3"]
    ) -> Float64[np.ndarray, "points 3"]:
        """Nearest points of the sharp edges (P, 3) [m] to points (P, 3) [m]; of the surface where there are none."""
        return self.project(points)

    def fitted(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        """Bring the nodes of panels (P, 6, 3) near the surface to where the panels follow it best [m]."""
        return self.project(panels.reshape(-1, 3)).reshape(panels.shape)

    def edge_middles(
        self, corners: Float64[np.ndarray, "triangles 3 3"]
    ) -> Float64[np.ndarray, "triangles 3 3"]:
        """Points of the surface over the middles of edges 01, 12, 20 of its own triangles (T, 3, 3) [m]."""
        straight = 0.5 * (corners + np.roll(corners, -1, axis=1))
        return self.project(straight.reshape(-1, 3)).reshape(straight.shape)

    def off_triangles(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance of points (P, 3) [m] from the flat triangles that it was made from [m]; 0 for a closed form."""
        return np.zeros(len(points))

    @abstractmethod
    def panels(self, edge: float, bend: float = BEND, away: float = math.inf) -> QuadraticTriangles:
        """Cover it with curved panels about as large as equilateral triangles of a given edge [m].

        Panels of a round surface in closed form turn by at most about ``bend`` [rad] from edge to
        edge. Panels of a mesh that lie more than ``away`` [m] off its surface, in root mean square,
        are smaller where that is smooth.
        """

    def flat_mesh(self, away: float) -> FlatMesh | None:
        """Mesh it with flat triangles at most ``away`` [m] off; None if it has to be done from given triangles."""
        return None

    @abstractmethod
    def extreme_points(self) -> Float64[np.ndarray, "points 3"]:
        """Points (P, 3) [m] that span the same upright box as the body."""

    def farthest(self, direction: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
        """Point of the body (3,) that lies farthest along a unit direction [m]."""
        points = self.extreme_points()
        return points[(points @ direction).argmax()]

    @abstractmethod
    def coarse_meshes(self, edge: float) -> list[RidgedMesh]:
        """Triangles to start a mesh from, with edges of at most about ``edge`` [m]; one mesh for each closed piece."""

    @abstractmethod
    def moved(self, pose: Pose) -> "Shape":
        """Move it rigidly."""
