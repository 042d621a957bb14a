"""The shape of a hand for solvers: exact distance, curved panels, and meshes that follow the pose."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Real

from airtact.geometry.mesh.quadratic_triangles import (
    QuadraticTriangles,
    enclosed_volume,
    panel_areas,
)
from airtact.geometry.mesh.remeshing import RidgedMesh
from airtact.geometry.pose import Pose, nearest_motion
from airtact.geometry.shape import BEND, Shape
from airtact.hands.joints import unit
from airtact.hands.skin_mesh import HandMesh, even_skin, midpoints, settled
from airtact.hands.sphere_mesh import Hulls
from airtact.printing import in_short

MEASURED = 3e-3
"""Edge of the panels that area and volume are taken from [m]."""

FARTHEST = 12e-3
"""A frame follows no shape from which a ball has moved farther, the motion of the whole hand taken out [m]."""

KEYFRAME = 2.5e-3
"""A frame that has moved farther than this from the keyframe that it follows is a keyframe itself [m]."""

MOST_KEYFRAMES = 16
"""Longest chain of keyframes: to deform a mesh along it takes no longer than to make it anew."""


PANELS_OFF = 0.05
"""Share of a ball's diameter by which it may reach out of the body: panels lie a little off it."""


@dataclass(frozen=True, eq=False)
class HandShape(Shape):
    """The exact body of a hand, wherever it was moved.

    In a sequence of frames a mesh is deformed from that of a keyframe, an earlier frame. Which
    frame that is follows from the poses alone, and its mesh is deformed from the keyframe before
    it, so that a mesh of some edge depends on the bodies in this chain and on nothing that was
    asked before.

    Attributes
    ----------
    hulls : the body where it was made.
    pose : where it stands now.
    follows : the keyframe whose meshes are deformed to this shape's, or None.
    meshes : cached meshes at rest, by their edge [m].
    """

    hulls: Hulls
    pose: Pose
    follows: "HandShape | None" = None
    meshes: dict[float, HandMesh] = field(default_factory=dict, compare=False, repr=False)

    __repr__ = in_short

    @cached_property
    def keyframe(self) -> "HandShape":
        """The shape that the next frame may follow: this one, or the one that it follows itself and is still near."""
        return (
            self
            if self.follows is None or motion(self.follows.hulls, self.hulls) > KEYFRAME
            else self.follows
        )

    @cached_property
    def keyframes(self) -> int:
        """How many keyframes stand before this shape."""
        return 0 if self.follows is None else 1 + self.follows.keyframes

    @staticmethod
    def following(hulls: Hulls, keyframe: "HandShape | None") -> "HandShape":
        """Make the shape of a body, which follows a keyframe where it has moved little and the same parts touch."""
        if keyframe is not None and not np.any(hulls.apart != keyframe.hulls.apart):
            far = motion(keyframe.hulls, hulls)
            if far <= KEYFRAME or (far <= FARTHEST and keyframe.keyframes < MOST_KEYFRAMES):
                return HandShape(hulls, Pose.identity(), keyframe)
        return HandShape(hulls, Pose.identity())

    @property
    def extent(self) -> float:
        """Largest side of the axis-aligned box round it at rest [m]."""
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
    def least_thickness(self) -> float:
        """Diameter [m] of its smallest ball where no hulls are joined, 0 elsewhere.

        Every point of a hull's surface is on a ball inside that is as large as its smallest; the
        creases between joined hulls are not.
        """
        alone = bool((self.hulls.apart + np.eye(len(self.hulls.parts)) == 1.0).all())
        return 2.0 * self.hulls.thinnest if alone else 0.0

    def thickness_at(
        self,
        points: Real[np.ndarray, "points 3"],
        normals: Float64[np.ndarray, "points 3"],
        most: float,
    ) -> Float64[np.ndarray, "points"]:
        """Diameter (P,) [m] of a ball inside at each point, to within ``PANELS_OFF``: ``most`` where that fits."""
        least = self.least_thickness
        if least >= most:
            return np.full(len(points), least)
        fits = self.depth(points - 0.5 * most * normals) >= 0.5 * (1.0 - PANELS_OFF) * most
        return np.where(fits, most, least)

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance to the skin [m] of points (P, 3) [m], positive inside."""
        return -self.hulls.look(self.pose.inverse().apply(points)).distance

    def project(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Project points (P, 3) [m] near the skin onto it."""
        return self.pose.apply(self.hulls.project(self.pose.inverse().apply(points)))

    def panels(self, edge: float, bend: float = BEND, away: float = math.inf) -> QuadraticTriangles:
        """Cover it with curved panels about as large as equilateral triangles of an edge [m]."""
        return self.pose.apply(curved_panels(self.hulls, self.skin(edge)))

    def extreme_points(self) -> Float64[np.ndarray, "points 3"]:
        """Points (P, 3) [m] on the boxes round the balls that the hulls are made of."""
        balls = self.hulls.balls
        reach = balls[:, 3, None, None] * np.concatenate([np.eye(3), -np.eye(3)])
        return (self.pose.apply(balls[:, :3])[:, None] + reach).reshape(-1, 3)

    def coarse_meshes(self, edge: float) -> list[RidgedMesh]:
        """Triangles to start a mesh from, with edges of about ``edge`` / 3 [m]."""
        skin = self.skin(edge / 3.0)
        return [
            RidgedMesh(
                self.pose.apply(skin.vertices), skin.triangles, np.empty((0, 2), dtype=np.int64)
            )
        ]

    def skin(self, edge: float) -> HandMesh:
        """Mesh it at rest with even triangles of an edge [m]; the mesh of the keyframe is deformed if possible."""
        if edge not in self.meshes:
            key = self.follows
            mesh = None if key is None else deformed(key.hulls, key.skin(edge), self.hulls, edge)
            self.meshes[edge] = (even_skin(self.hulls, edge) if mesh is None else mesh).fixed()
        return self.meshes[edge]

    def moved(self, pose: Pose) -> "HandShape":
        """Move it rigidly by a pose."""
        return replace(self, pose=pose @ self.pose)

    @cached_property
    def _measures(self) -> tuple[float, float]:
        panels = curved_panels(self.hulls, self.skin(MEASURED))
        return float(panel_areas(panels).sum()), enclosed_volume(panels)


def curved_panels(hulls: Hulls, skin: HandMesh) -> QuadraticTriangles:
    """Curve triangles by the points of the skin over the middles of their edges."""
    corners = skin.vertices[skin.triangles]
    return np.concatenate([corners, midpoints(hulls, skin)], axis=1)


# --- deformed meshes ------------------------------------------------------------------------------------------------

BLEND = 3e-3
"""Corners move with the hulls nearest to them, weighted over about this distance [m]."""

LEAST_ANGLE = 20.0
"""A deformed mesh with a smaller angle is rejected [degrees]."""

LONGEST = 2.0
"""So is one with an edge longer than this, over the edge wanted there."""


def motion(before: Hulls, now: Hulls) -> float:
    """Find how far the farthest ball has moved [m], the rigid motion of the whole hand taken out."""
    turn, shift = nearest_motion(before.balls[:, :3], now.balls[:, :3])
    return float(
        np.linalg.norm(before.balls[:, :3] @ turn.T + shift - now.balls[:, :3], axis=1).max()
    )


def deformed(before: Hulls, mesh: HandMesh, now: Hulls, edge: float) -> HandMesh | None:
    """Deform the mesh of a body, made with an edge [m], to another pose in which the same hulls are joined.

    The triangles stay the same; None where one gets too thin or too long.
    """
    found = settled(
        now,
        replace(
            mesh,
            vertices=moved_with_hulls(
                before, now, mesh.vertices, hull_weights(before, mesh.vertices)
            ),
        ),
        edge,
    )
    ends = np.roll(found.triangles, -1, axis=1)
    lengths = np.linalg.norm(found.vertices[found.triangles] - found.vertices[ends], axis=2)
    wanted = mesh.sizes[found.triangles].max(axis=1, keepdims=True)
    good = found.angles.min() >= LEAST_ANGLE and (lengths / wanted).max() <= LONGEST
    return found if good else None


def hull_weights(
    hulls: Hulls, vertices: Float64[np.ndarray, "vertices 3"]
) -> Float64[np.ndarray, "vertices hulls"]:
    """Weigh hulls by how near they are to vertices (V, 3) [m] on the skin; the weights of each vertex add up to 1."""
    distance = hulls.each(vertices)
    weight = np.exp(-((distance - distance.min(axis=1, keepdims=True)) / BLEND))
    return weight / weight.sum(axis=1, keepdims=True)


def moved_with_hulls(
    before: Hulls,
    now: Hulls,
    vertices: Float64[np.ndarray, "vertices 3"],
    weight: Float64[np.ndarray, "vertices hulls"],
) -> Float64[np.ndarray, "vertices 3"]:
    """Carry vertices (V, 3) [m] along with the hulls, by their ``hull_weights``, to another pose, near its skin."""
    turn, shift = nearest_motion(before.balls[:, :3], now.balls[:, :3])
    old, new = before.balls[:, :3] @ turn.T + shift, now.balls[:, :3]
    start = vertices @ turn.T + shift
    moved = np.zeros_like(vertices)
    for hull, part in enumerate(now.parts):
        members = part[part >= 0]
        own_turn, own_shift = _rigid(old[members], new[members])
        moved += weight[:, hull, None] * (start @ own_turn.T + own_shift)
    return moved


def _rigid(
    old: Float64[np.ndarray, "points 3"], new: Float64[np.ndarray, "points 3"]
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]:
    """Rigid motion that brings points nearest to others, without needless twist where they are two."""
    if len(old) > 2:
        return nearest_motion(old, new)
    one, two = unit(old[1] - old[0]), unit(new[1] - new[0])
    x, y, z = np.cross(one, two)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + across + across @ across / (1.0 + one @ two)
    return turn, new.mean(axis=0) - turn @ old.mean(axis=0)
