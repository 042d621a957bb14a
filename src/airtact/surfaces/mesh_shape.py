"""The shape of a mesh: its curved skin, wherever it was moved, and new panels on it."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64, Real

from airtact.mesh.edge_splitting import split
from airtact.mesh.quadratic_triangles import QuadraticTriangles
from airtact.mesh.remeshing import Ridged, thinned
from airtact.pose import Pose
from airtact.printing import in_short
from airtact.surfaces.curved_mesh import CurvedMesh
from airtact.surfaces.panelling import covered
from airtact.surfaces.shape import BEND


@dataclass(frozen=True, eq=False)
class CurvedShape:
    """A curved mesh that may have been moved; what was found out about it at rest is kept.

    Attributes
    ----------
    mesh : the skin where it was made.
    pose : where it stands now.
    kept : panels made before, at rest, by their edge.
    """

    mesh: CurvedMesh
    pose: Pose
    kept: dict[float, QuadraticTriangles] = field(default_factory=dict, compare=False)

    __repr__ = in_short

    @property
    def extent(self) -> float:
        """Largest side of the upright box round it at rest [m]."""
        return float(np.ptp(self.mesh.quadratic_triangles.reshape(-1, 3), axis=0).max())

    @property
    def area(self) -> float:
        """Area of the skin [m²]."""
        return self.mesh.area

    @property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        return self.mesh.volume

    @property
    def thinnest(self) -> float:
        """Return 0: how thin a mesh is has to be measured."""
        return 0.0

    @property
    def quadratic_triangles(self) -> QuadraticTriangles:
        """Its panels (T, 6, 3) [m]."""
        return self.pose.apply(self.mesh.quadratic_triangles)

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance to the skin [m] of points (P, 3) [m], positive inside."""
        return self.mesh.depth(self.pose.inverse().apply(points))

    def project(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Nearest points of the skin (P, 3) [m] to points (P, 3) [m]."""
        return self.pose.apply(self.mesh.project(self.pose.inverse().apply(points)))

    def fitted(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        """Bring panels (P, 6, 3) near the skin to where it lies evenly on both sides of each [m]."""
        return self.pose.apply(self.mesh.fitted(self.pose.inverse().apply(panels)))

    def off_triangles(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance of points (P, 3) [m] from the flat triangles that it was made from [m]."""
        return self.mesh.flat_tree.closest(self.pose.inverse().apply(points))[2]

    def panels(self, edge: float, bend: float = BEND) -> QuadraticTriangles:
        """Cover it with curved panels about as large as equilateral triangles of a given edge [m]."""
        if edge not in self.kept:
            self.kept[edge] = covered(self.mesh, edge)
        return self.pose.apply(self.kept[edge])

    def extreme_points(self) -> Float64[np.ndarray, "points 3"]:
        """Nodes (P, 3) of all panels [m]."""
        return self.quadratic_triangles.reshape(-1, 3)

    def coarse_meshes(self, edge: float) -> list[Ridged]:
        """Triangles to start a mesh from, with edges of at most ``edge`` [m] where they are not sharp."""
        found = []
        for mesh in self.mesh.pieces:
            quadratic_triangles, triangles, sharp = split(mesh.quadratic_triangles, mesh.triangles, mesh.sharp, edge)
            vertices = np.empty((int(triangles.max()) + 1, 3))
            vertices[triangles] = self.pose.apply(quadratic_triangles[:, :3])
            triangle, corner = np.nonzero(sharp)
            ridges = np.stack([triangles[triangle, corner], triangles[triangle, (corner + 1) % 3]], axis=1)
            found.append(thinned(Ridged(vertices, triangles, ridges[ridges[:, 0] < ridges[:, 1]]), edge / 1.5))
        return found

    def moved(self, pose: Pose) -> "CurvedShape":
        """Move it rigidly."""
        return replace(self, pose=pose @ self.pose)
