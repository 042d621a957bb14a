"""The shape of a mesh, wherever it was moved, and new panels on it."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64, Int64, Real

from airtact.geometry.mesh.quadratic_triangles import QuadraticTriangles
from airtact.geometry.mesh.remeshing import RidgedMesh, coarsened
from airtact.geometry.panelling import covered
from airtact.geometry.pose import Pose
from airtact.geometry.quadratic_mesh import QuadraticMesh
from airtact.geometry.shape import BEND, Shape
from airtact.printing import in_short


@dataclass(frozen=True, eq=False)
class MeshShape(Shape):
    """A mesh of quadratic triangles that stands at a pose; its panels at rest are ``cached`` by edge and distance."""

    mesh: QuadraticMesh
    pose: Pose
    cached: dict[tuple[float, float], QuadraticTriangles] = field(
        default_factory=dict, compare=False
    )

    __repr__ = in_short

    @property
    def extent(self) -> float:
        """Largest side of the upright box round its triangles at rest [m]."""
        return float(np.ptp(self.mesh.vertices[self.mesh.triangles].reshape(-1, 3), axis=0).max())

    @property
    def area(self) -> float:
        """Area of the surface [m²]."""
        return self.mesh.area

    @property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        return self.mesh.volume

    @property
    def crossings(self) -> Int64[np.ndarray, "crossings 2"]:
        """Pairs of flat triangles (K, 2) that cross or touch beyond what they share as neighbours."""
        return self.mesh.crossings

    def nested_piece(self) -> tuple[int, int, float, Float64[np.ndarray, "3"]] | None:
        """Find a closed piece inside another: both numbers, how deep [m] and a point (3,) there [m]; None if none."""
        seeds = np.array([piece.vertices[piece.triangles[0, 0]] for piece in self.mesh.pieces])
        if len(seeds) == 1:
            return None
        for outer, piece in enumerate(self.mesh.pieces):
            depth = piece.depth(seeds)
            depth[outer] = -np.inf
            inner = int(depth.argmax())
            if depth[inner] > 0.0:
                return inner, outer, float(depth[inner]), self.pose.apply(seeds[inner])
        return None

    @property
    def quadratic_triangles(self) -> QuadraticTriangles:
        """Its panels (T, 6, 3) [m]."""
        return self.pose.apply(self.mesh.quadratic_triangles)

    def edge_middles(
        self, corners: Float64[np.ndarray, "triangles 3 3"]
    ) -> Float64[np.ndarray, "triangles 3 3"]:
        """Points of the surface over the middles of edges 01, 12, 20 of its triangles (T, 3, 3) [m]."""
        return self.quadratic_triangles[:, 3:]

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance to the surface [m] of points (P, 3) [m], positive inside."""
        return self.mesh.depth(self.pose.inverse().apply(points))

    def project(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Nearest points of the surface (P, 3) [m] to points (P, 3) [m]."""
        return self.pose.apply(self.mesh.project(self.pose.inverse().apply(points)))

    def project_on_sharp_edges(
        self, points: Real[np.ndarray, "points 3"]
    ) -> Float64[np.ndarray, "points 3"]:
        """Nearest points of the sharp edges (P, 3) [m] to points (P, 3) [m]."""
        return self.pose.apply(self.mesh.project_on_sharp_edges(self.pose.inverse().apply(points)))

    def fitted(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        """Bring panels (P, 6, 3) near the surface to where it lies evenly on both sides of each [m]."""
        return self.pose.apply(self.mesh.fitted(self.pose.inverse().apply(panels)))

    def off_triangles(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance of points (P, 3) [m] from the flat triangles that it was made from [m]."""
        return self.mesh.flat_tree.closest(self.pose.inverse().apply(points))[2]

    def panels(self, edge: float, bend: float = BEND, away: float = math.inf) -> QuadraticTriangles:
        """Cover it with curved panels about as large as equilateral triangles of a given edge [m].

        Where it is smooth, they lie at most about ``away`` [m] off, in root mean square.
        """
        if (edge, away) not in self.cached:
            self.cached[edge, away] = np.concatenate(
                [covered(piece, edge, away) for piece in self.mesh.pieces]
            )
        return self.pose.apply(self.cached[edge, away])

    def extreme_points(self) -> Float64[np.ndarray, "points 3"]:
        """Nodes (P, 3) of all panels [m]."""
        return self.quadratic_triangles.reshape(-1, 3)

    def coarse_meshes(self, edge: float) -> list[RidgedMesh]:
        """Triangles to start a mesh from, with edges of at most ``edge`` [m] where they are not sharp."""
        found = []
        for piece in self.mesh.pieces:
            split = piece.with_short_edges(edge)
            placed = RidgedMesh(self.pose.apply(split.vertices), split.triangles, split.ridges)
            found.append(coarsened(placed, edge / 1.5))
        return found

    def moved(self, pose: Pose) -> "MeshShape":
        """Move it rigidly."""
        return replace(self, pose=pose @ self.pose)
