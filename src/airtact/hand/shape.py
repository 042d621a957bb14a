"""The shape of a hand, which solvers cover with panels: exact distance, curved panels, meshes that follow the pose."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Real

from airtact.hand.mesh_tracking import Followed
from airtact.hand.skin_mesh import Skin, even_skin, midpoints
from airtact.hand.sphere_mesh import Hulls
from airtact.mesh.quadratic_triangles import QuadraticTriangles, enclosed_volume, panel_areas
from airtact.mesh.remeshing import Ridged
from airtact.pose import Pose
from airtact.printing import in_short
from airtact.surfaces.shape import BEND

MEASURED = 3e-3
"""Edge of the panels that area and volume are taken from [m]."""


@dataclass(frozen=True, eq=False)
class HandShape:
    """A body of blended hulls, wherever it was moved; the meshes made of it are kept.

    Attributes
    ----------
    hulls : the body where it was made.
    pose : where it stands now.
    followed : the shape of the frame before, whose meshes are deformed to this one's, or None.
    kept : meshes made before, at rest, by their edge.
    """

    hulls: Hulls
    pose: Pose
    followed: Followed | None = None
    kept: dict[float, Skin] = field(default_factory=dict, compare=False)

    __repr__ = in_short

    @property
    def extent(self) -> float:
        """Largest side of the upright box round it at rest [m]."""
        centres, radii = self.hulls.balls[:, :3], self.hulls.balls[:, 3:]
        return float(((centres + radii).max(axis=0) - (centres - radii).min(axis=0)).max())

    @property
    def area(self) -> float:
        """Area of the skin [m²]."""
        return self._measures[0]

    @property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        return self._measures[1]

    @property
    def thinnest(self) -> float:
        """Return 0: where fingers meet in a crease the panels are thinner than the hulls, and have to be measured."""
        return 0.0

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance to the skin [m] of points (P, 3) [m], positive inside."""
        return -self.hulls.look(self.pose.inverse().apply(points)).distance

    def project(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Bring points (P, 3) [m] near the skin onto it."""
        return self.pose.apply(self.hulls.project(self.pose.inverse().apply(points)))

    def fitted(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        """Bring the nodes of panels (P, 6, 3) near the skin onto it [m]."""
        return self.project(panels.reshape(-1, 3)).reshape(panels.shape)

    def off_triangles(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Return 0 for each of the points (P, 3) [m]: the body was made from no triangles."""
        return np.zeros(len(points))

    def panels(self, edge: float, bend: float = BEND) -> QuadraticTriangles:
        """Cover it with curved panels about as large as equilateral triangles of a given edge [m]."""
        return self.pose.apply(curved_panels(self.hulls, self.skin(edge)))

    def extreme_points(self) -> Float64[np.ndarray, "points 3"]:
        """Points (P, 3) [m] on the boxes round the balls that the hulls are made of."""
        balls = self.hulls.balls
        reach = balls[:, 3, None, None] * np.concatenate([np.eye(3), -np.eye(3)])
        return (self.pose.apply(balls[:, :3])[:, None] + reach).reshape(-1, 3)

    def coarse_meshes(self, edge: float) -> list[Ridged]:
        """Triangles to start a mesh from, with edges of about ``edge`` / 3 [m]."""
        skin = self.skin(edge / 3.0)
        return [Ridged(self.pose.apply(skin.vertices), skin.triangles, np.empty((0, 2), dtype=np.int64))]

    def skin(self, edge: float) -> Skin:
        """Mesh it at rest with even triangles of an edge [m]; the mesh of the frame before is deformed if possible."""
        if edge not in self.kept:
            deformed = None if self.followed is None else self.followed.deformed(self.hulls, edge)
            self.kept[edge] = even_skin(self.hulls, edge) if deformed is None else deformed
        return self.kept[edge]

    def moved(self, pose: Pose) -> "HandShape":
        """Move it rigidly.

        Parameters
        ----------
        pose : the motion.
        """
        return replace(self, pose=pose @ self.pose)

    @cached_property
    def _measures(self) -> tuple[float, float]:
        panels = curved_panels(self.hulls, self.skin(MEASURED))
        return float(panel_areas(panels).sum()), enclosed_volume(panels)


def curved_panels(hulls: Hulls, skin: Skin) -> QuadraticTriangles:
    """Curve triangles by the points of the skin over the middles of their edges.

    Parameters
    ----------
    hulls : the body.
    skin : its triangles.
    """
    corners = skin.vertices[skin.triangles]
    return np.concatenate([corners, midpoints(hulls, skin)], axis=1)
