"""Shape of a hand for solvers: exact distance, curved panels, and meshes that follow the pose."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Real

from airtact.geometry.mesh.remeshing import RidgedMesh
from airtact.geometry.mesh.triangles import (
    QuadraticTriangles,
    Vertices,
    enclosed_volume,
    panel_areas,
)
from airtact.geometry.pose import Pose, nearest_motion
from airtact.geometry.shape import BEND, Shape
from airtact.hands.body import Hulls
from airtact.hands.joints import PerPoint, Point, Points, cross, unit
from airtact.hands.skin_mesh import HandMesh, even_skin, midpoints, settled

# Largest motion at which a frame keeps the keyframe of the previous frame [m].
NEAR_KEYFRAME = 2.5e-3

# Longest chain of keyframes. Deforming a mesh along it takes no longer than generating a new one.
MAX_KEYFRAMES = 16


@dataclass(frozen=True, eq=False)
class HandShape(Shape):
    """The exact body of a hand in a pose.

    In a sequence, the mesh of a frame is deformed from the mesh of an earlier frame, its keyframe.
    The mesh of the keyframe is, in turn, deformed from the mesh of the previous keyframe. The poses
    alone determine the keyframes, so a mesh depends only on the bodies in this chain and not on
    earlier computations.

    Attributes
    ----------
    hulls : hulls of the body in the pose in which it was built.
    pose : pose relative to the frame in which the body was built.
    follows : the keyframe whose meshes are deformed to fit this shape; None if there is none.
    meshes : meshes of ``hulls`` that were already generated, by edge length [m].
    """

    hulls: Hulls
    pose: Pose
    follows: "HandShape | None" = None
    meshes: dict[float, HandMesh] = field(default_factory=dict, compare=False, repr=False)

    @cached_property
    def keyframe(self) -> "HandShape":
        """Keyframe for the next frame: this shape, or ``follows`` if both shapes are similar."""
        if self.follows is None or motion(self.follows.hulls, self.hulls) > NEAR_KEYFRAME:
            return self
        return self.follows

    @cached_property
    def keyframes(self) -> int:
        """Number of earlier shapes on which this shape is based, directly or indirectly."""
        return 0 if self.follows is None else 1 + self.follows.keyframes

    @staticmethod
    def following(hulls: Hulls, keyframe: "HandShape | None") -> "HandShape":
        """Build a shape, deformed from the keyframe if the motion is small and contacts persist."""
        if keyframe is not None and np.array_equal(hulls.apart, keyframe.hulls.apart):
            moved = motion(keyframe.hulls, hulls)
            # After a motion of more than 12 mm, a new mesh is generated instead.
            may_chain = moved <= 12e-3 and keyframe.keyframes < MAX_KEYFRAMES
            if moved <= NEAR_KEYFRAME or may_chain:
                return HandShape(hulls, Pose.identity(), keyframe)
        return HandShape(hulls, Pose.identity())

    @property
    def extent(self) -> float:
        # The box around the balls contains the hulls.
        centres = self.hulls.balls[:, :3]
        radii = self.hulls.balls[:, 3:]
        return float(((centres + radii).max(axis=0) - (centres - radii).min(axis=0)).max())

    @property
    def area(self) -> float:
        return float(panel_areas(self._measured_panels).sum())

    @property
    def volume(self) -> float:
        return enclosed_volume(self._measured_panels)

    @cached_property
    def _measured_panels(self) -> QuadraticTriangles:
        return curved_panels(self.hulls, self.skin(3e-3))

    @property
    def least_thickness(self) -> float:
        """Diameter of the body's smallest ball [m] if no hulls are blended, and 0 otherwise.

        A ball of this size fits inside the body at every point of a hull, but not at the creases
        between blended hulls.
        """
        alone = bool((self.hulls.apart + np.eye(len(self.hulls.parts)) == 1.0).all())
        return 2.0 * float(self.hulls.balls[:, 3].min()) if alone else 0.0

    def thickness_at(
        self,
        points: Real[np.ndarray, "points 3"],
        normals: Points,
        largest: float,
    ) -> PerPoint:
        """Return a lower bound (P,) [m] on the thickness of the body at points of the skin.

        The bound is ``largest`` [m] where a ball of this diameter fits into the body, and
        ``least_thickness`` elsewhere.
        """
        smallest = self.least_thickness
        if smallest >= largest:
            return np.full(len(points), smallest)
        # Panels deviate slightly from the body, so a ball may protrude by 5 % of its diameter.
        fits = self.depth(points - 0.5 * largest * normals) >= 0.5 * (1.0 - 0.05) * largest
        return np.where(fits, largest, smallest)

    def depth(self, points: Real[np.ndarray, "points 3"]) -> PerPoint:
        return -self.hulls.look(self.pose.inverse().apply(points)).distance

    def project(self, points: Real[np.ndarray, "points 3"]) -> Points:
        return self.pose.apply(self.hulls.project(self.pose.inverse().apply(points)))

    def panels(self, edge: float, bend: float = BEND, away: float = math.inf) -> QuadraticTriangles:
        """Return curved panels about as large as equilateral triangles of side ``edge`` [m]."""
        return self.pose.apply(curved_panels(self.hulls, self.skin(edge)))

    def extreme_points(self) -> Points:
        balls = self.hulls.balls
        reach = balls[:, 3, None, None] * np.concatenate([np.eye(3), -np.eye(3)])
        return (self.pose.apply(balls[:, :3])[:, None] + reach).reshape(-1, 3)

    def coarse_meshes(self, edge: float) -> list[RidgedMesh]:
        skin = self.skin(edge / 3.0)
        # A hand has no ridges.
        ridges = np.empty((0, 2), dtype=np.int64)
        return [RidgedMesh(self.pose.apply(skin.vertices), skin.triangles, ridges)]

    def skin(self, edge: float) -> HandMesh:
        """Return a mesh of edge length ``edge`` [m], deformed from a keyframe if possible."""
        if edge not in self.meshes:
            mesh = (
                None
                if self.follows is None
                else deformed(self.follows.hulls, self.follows.skin(edge), self.hulls, edge)
            )
            self.meshes[edge] = (even_skin(self.hulls, edge) if mesh is None else mesh).fixed()
        return self.meshes[edge]


def curved_panels(hulls: Hulls, skin: HandMesh) -> QuadraticTriangles:
    """Curve flat triangles so that the midpoints of their edges also lie on the skin."""
    return np.concatenate([skin.vertices[skin.triangles], midpoints(hulls, skin)], axis=1)


# --- deformed meshes --------------------------------------------------------------------------


def motion(before: Hulls, now: Hulls) -> float:
    """Return the largest displacement [m] of a ball beyond the rigid motion of the hand."""
    turn, shift = nearest_motion(before.balls[:, :3], now.balls[:, :3])
    off = before.balls[:, :3] @ turn.T + shift - now.balls[:, :3]
    return float(np.linalg.norm(off, axis=1).max())


def deformed(before: Hulls, mesh: HandMesh, now: Hulls, edge: float) -> HandMesh | None:
    """Deform a mesh of edge length ``edge`` [m] to another pose in which the same parts touch.

    Only the vertices move; the triangles keep the indices of their corners. The function returns
    None if a triangle becomes too thin or too long.
    """
    weights = hull_weights(before, mesh.vertices)
    moved = replace(mesh, vertices=moved_with_hulls(before, now, mesh.vertices, weights))
    new = settled(now, moved, edge)
    ends = np.roll(new.triangles, -1, axis=1)
    lengths = np.linalg.norm(new.vertices[new.triangles] - new.vertices[ends], axis=2)
    sizes = mesh.sizes[new.triangles].max(axis=1, keepdims=True)
    return new if new.angles.min() >= 20.0 and (lengths / sizes).max() <= 2.0 else None


def hull_weights(hulls: Hulls, vertices: Vertices) -> Float64[np.ndarray, "vertices hulls"]:
    """Return the weights (V, H) of the hulls near each vertex (V, 3); each row adds up to 1."""
    distance = hulls.each(vertices)
    weight = np.exp(-((distance - distance.min(axis=1, keepdims=True)) / 3e-3))
    return weight / weight.sum(axis=1, keepdims=True)


def moved_with_hulls(
    before: Hulls, now: Hulls, vertices: Vertices, weight: Float64[np.ndarray, "vertices hulls"]
) -> Vertices:
    """Move vertices (V, 3) with the hulls to another pose, using the weights of the hulls."""
    turn, shift = nearest_motion(before.balls[:, :3], now.balls[:, :3])
    old = before.balls[:, :3] @ turn.T + shift
    new = now.balls[:, :3]
    start = vertices @ turn.T + shift
    moved = np.zeros_like(vertices)
    for hull, part in enumerate(now.parts):
        balls = part[part >= 0]
        hull_turn, hull_shift = (
            nearest_motion(old[balls], new[balls])
            if len(balls) > 2
            else _motion_of_pair(old[balls], new[balls])
        )
        moved += weight[:, hull, None] * (start @ hull_turn.T + hull_shift)
    return moved


def _motion_of_pair(
    old: Float64[np.ndarray, "2 3"], new: Float64[np.ndarray, "2 3"]
) -> tuple[Float64[np.ndarray, "3 3"], Point]:
    """Return the rotation and translation that map two points onto two others, without twist."""
    start = unit(old[1] - old[0])
    end = unit(new[1] - new[0])
    x, y, z = cross(start, end)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + across + across @ across / (1.0 + start @ end)
    return turn, new.mean(axis=0) - turn @ old.mean(axis=0)
