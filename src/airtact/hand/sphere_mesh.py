"""The exact body of a hand: hulls of two or three balls each, its creases filled.

Source: A. Tkach, M. Pauly, A. Tagliasacchi, "Sphere-meshes for real-time hand modeling and tracking", ACM Trans. Graph.
35, 222 (2016): a hull of balls is all points nearer to some point of their simplex than the radius interpolated there.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64, Real

from airtact import _kernels
from airtact.pose import Pose
from airtact.printing import in_short

STEPS = 12
"""Newton steps that bring a point onto the skin at most."""

LONGEST_STEP = 2e-3
"""Longest of them [m]."""

STRIDE = 0.5e-3
"""How far from it the skin is looked for where they do not settle [m]."""

HALVINGS = 24
"""How often that is halved."""

ON_SKIN = 1e-9
"""Points nearer than this are on the skin [m]."""


class Look(NamedTuple):
    """What is found at points (P, 3).

    Attributes
    ----------
    distance : (P,) to the skin [m], negative inside.
    gradient : (P, 3) of that, but for the slow change of the width of a filled crease.
    bend : (P,) radius at which the skin bends there [m].
    facing : (P,) distance of the nearest hull that stands apart from the nearest one [m].
    nearest : (P,) the nearest hull.
    """

    distance: Float64[np.ndarray, "points"]
    gradient: Float64[np.ndarray, "points 3"]
    bend: Float64[np.ndarray, "points"]
    facing: Float64[np.ndarray, "points"]
    nearest: Int64[np.ndarray, "points"]


@dataclass(frozen=True, eq=False)
class Hulls:
    """Hulls of balls and how they are joined.

    Between two hulls with outward normals n, m the crease is filled over a width of ``blend`` (1 - n·m)/2, as the
    smooth minimum of their distances: skins that face each other are one where nearer than half that width, a right
    angle is filled over half of it, and hulls that share a ball pass into each other without a swelling.

    Attributes
    ----------
    balls : (B, 4) centres and radii [m].
    parts : (H, 3) the two or three balls of each hull; the third is -1 for two.
    blend : (H, H) width of filled creases between skins that face each other [m]; 0 for none.
    apart : (H, H) 1 where two hulls stand apart, else 0.
    """

    balls: Float64[np.ndarray, "balls 4"]
    parts: Int64[np.ndarray, "hulls 3"]
    blend: Float64[np.ndarray, "hulls hulls"]
    apart: Float64[np.ndarray, "hulls hulls"]

    __repr__ = in_short

    @property
    def thinnest(self) -> float:
        """Radius of the smallest ball [m]."""
        return float(self.balls[:, 3].min())

    def look(self, points: Real[np.ndarray, "points 3"], carve: float = 0.0, reach: float = 0.0) -> Look:
        """Find distance, gradient and surroundings of points (P, 3) [m].

        Parameters
        ----------
        points : (P, 3) [m].
        carve : hulls that stand apart are carved out to this distance round each other [m].
        reach : hulls are looked at that are farther than the nearest by no more [m]; at least as filling creases needs.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        count = len(points)
        found = Look(np.empty(count), np.empty((count, 3)), np.empty(count), np.empty(count), np.empty(count, np.int64))
        reach = max(reach, carve, float(self.blend.max()))
        tables = (self.balls, self.parts, self.blend, self.apart)
        _kernels.blended_distance(points, *tables, carve, reach, *found)
        return found

    def each(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points hulls"]:
        """Distance of points (P, 3) [m] to each hull by itself (P, H) [m]."""
        out = np.empty((len(points), len(self.parts)))
        _kernels.hull_distances(np.ascontiguousarray(points, dtype=np.float64), self.balls, self.parts, out)
        return out

    def project(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Bring points (P, 3) [m] near the skin onto it, along the gradient of the distance."""
        points = np.array(points, dtype=np.float64, order="C")
        tables = (self.balls, self.parts, self.blend, self.apart)
        reach = float(self.blend.max())
        _kernels.project_on_hulls(points, *tables, reach, STEPS, LONGEST_STEP, ON_SKIN, STRIDE, HALVINGS)
        return points

    def moved(self, pose: Pose) -> "Hulls":
        """Move it rigidly.

        Parameters
        ----------
        pose : the motion.
        """
        balls = np.column_stack([pose.apply(self.balls[:, :3]), self.balls[:, 3]])
        return Hulls(np.ascontiguousarray(balls), self.parts, self.blend, self.apart)
