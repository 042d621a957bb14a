"""What a skin can be asked, whatever it is made of."""

import math
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64, Real

from airtact.mesh.quadratic_triangles import QuadraticTriangles
from airtact.mesh.remeshing import Ridged
from airtact.pose import Pose

BEND = math.pi / 5
"""Angle that a panel of a round skin may turn by [rad], where nothing coarser will do."""


@runtime_checkable
class Shape(Protocol):
    """The true skin of a body: a closed form, or the curved panels of a mesh."""

    @property
    def extent(self) -> float:
        """Largest distance between two of its points, or largest side of the box round it [m]."""
        ...

    @property
    def area(self) -> float:
        """Area of the skin [m²]."""
        ...

    @property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        ...

    @property
    def thinnest(self) -> float:
        """Diameter [m] that every largest ball which touches the skin from inside has at least; 0 if none is known."""
        ...

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance to the skin [m] of points (P, 3) [m], positive inside."""
        ...

    def project(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Nearest points of the skin (P, 3) [m] to points (P, 3) [m]."""
        ...

    def fitted(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        """Bring the nodes of panels (P, 6, 3) near the skin to where the panels follow it best [m]."""
        ...

    def off_triangles(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance of points (P, 3) [m] from the flat triangles that it was made from [m]; 0 for a closed form."""
        ...

    def panels(self, edge: float, bend: float = BEND) -> QuadraticTriangles:
        """Cover it with curved panels about as large as equilateral triangles of a given edge [m].

        Panels of a round skin in closed form turn by at most about ``bend`` [rad] from edge to edge.
        """
        ...

    def extreme_points(self) -> Float64[np.ndarray, "points 3"]:
        """Points (P, 3) [m] that span the same upright box as the body."""
        ...

    def coarse_meshes(self, edge: float) -> list[Ridged]:
        """Triangles to start a mesh from, with edges of at most about ``edge`` [m]; one mesh for each closed piece."""
        ...

    def moved(self, pose: Pose) -> "Shape":
        """Move it rigidly."""
        ...
