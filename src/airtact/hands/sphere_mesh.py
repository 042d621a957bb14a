"""The exact body of a hand: blended hulls of two or three balls each.

Source: A. Tkach, M. Pauly, A. Tagliasacchi, "Sphere-meshes for real-time hand modeling and
tracking", ACM Trans. Graph. 35, 222 (2016): a hull of balls is all points nearer to some point of
their simplex than the radius interpolated there.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64, Real

from airtact import _kernels
from airtact.printing import in_short


class Look(NamedTuple):
    """Distance and surroundings of points (P, 3).

    Attributes
    ----------
    distance : (P,) to the skin [m], negative inside.
    gradient : (P, 3) of the distance, with the blend radius held fixed.
    bend : (P,) radius of curvature of the skin there [m].
    facing : (P,) distance of the nearest of the hulls that stand apart from the nearest hull [m].
    nearest : (P,) the nearest hull.
    """

    distance: Float64[np.ndarray, "points"]
    gradient: Float64[np.ndarray, "points 3"]
    bend: Float64[np.ndarray, "points"]
    facing: Float64[np.ndarray, "points"]
    nearest: Int64[np.ndarray, "points"]


PROJECTION = (12, 2e-3, 1e-9, 0.5e-3, 24)
"""How a point is projected onto the skin: Newton iterations at most, their longest step [m], the distance from which a
point is on the skin [m], and where they do not settle, how far it is searched for [m] and with how
many halvings."""


@dataclass(frozen=True, eq=False)
class Hulls:
    """Hulls of balls and how they are joined.

    Two hulls with outward normals n, m are joined by the smooth minimum of their distances with a
    blend radius of ``blend`` (1 - n·m)/2: skins that face each other are one where nearer than half
    of ``blend``, a right angle has half that radius, and hulls that share a ball join without a
    swelling.

    Attributes
    ----------
    balls : (B, 4) centres and radii [m].
    parts : (H, 3) the two or three balls of each hull; the third is -1 for two.
    blend : (H, H) blend radius of skins that face each other [m]; 0 for none.
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

    def look(
        self, points: Real[np.ndarray, "points 3"], carve: float = 0.0, reach: float = 0.0
    ) -> Look:
        """Evaluate distance, gradient and surroundings of points (P, 3) [m].

        Hulls that stand apart are carved out to a distance ``carve`` round each other [m]. Hulls
        farther than the nearest by more than ``reach`` [m], and by more than the largest blend
        radius, are left out.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        count = len(points)
        found = Look(
            np.empty(count),
            np.empty((count, 3)),
            np.empty(count),
            np.empty(count),
            np.empty(count, np.int64),
        )
        reach = max(reach, carve, float(self.blend.max()))
        tables = (self.balls, self.parts, self.blend, self.apart)
        _kernels.blended_distance(points, *tables, carve, reach, *found)
        return found

    def each(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points hulls"]:
        """Distance of points (P, 3) [m] to each hull by itself (P, H) [m]."""
        out = np.empty((len(points), len(self.parts)))
        _kernels.hull_distances(
            np.ascontiguousarray(points, dtype=np.float64), self.balls, self.parts, out
        )
        return out

    def project(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Project points (P, 3) [m] near the skin onto it, along the gradient of the distance."""
        points = np.array(points, dtype=np.float64, order="C")
        tables = (self.balls, self.parts, self.blend, self.apart)
        _kernels.project_on_hulls(points, *tables, float(self.blend.max()), *PROJECTION)
        return points
