"""Rigid planes, such as a table or a wall.

Image sources behind a plane produce the reflected field in front of it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Real

from airtact.acoustics.sources import Monopoles
from airtact.errors import (
    InvalidInput,
    Vector,
    fixed,
    in_mm,
    millimetres,
    of_kind,
    one_line,
    point_of,
)
from airtact.geometry.checks import NEAREST
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface

# Points up to this distance behind a plane count as lying on it [m].
ON_PLANE = 1e-9

# Smallest distance of a body from a plane [m]. The body and its image are then as far apart as two
# bodies must be.
MIN_GAP = 0.5 * NEAREST


@dataclass(frozen=True, eq=False)
class Plane:
    """An infinite rigid plane. The sound is on the side to which its normal points.

    Attributes
    ----------
    point : (3,) any point of the plane [m].
    normal : (3,) unit normal.
    """

    point: Float64[np.ndarray, "3"]
    normal: Float64[np.ndarray, "3"]

    def __repr__(self) -> str:
        return one_line(
            self, f"through {in_mm(self.point)}", f"normal {np.round(self.normal, 3) + 0.0}"
        )

    def height(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Return the distance [m] of points (P, 3) from the plane; negative behind the plane."""
        return (points - self.point) @ self.normal

    def image(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Return the mirror images (P, 3) of points (P, 3) in the plane [m]."""
        return points - 2.0 * self.height(points)[:, None] * self.normal

    def moved(self, motion: Pose) -> "Plane":
        """Return the plane after a rigid motion."""
        return Plane(fixed(motion.apply(self.point)), fixed(motion.rotate(self.normal)))

    def kept_by(self, motion: Pose) -> bool:
        """Return whether a rigid motion, such as a shift along the plane, keeps the plane in place.

        A field solved in front of the plane remains valid if the bodies move in this way.
        """
        turned = motion.rotate(self.normal[None])[0]
        height = self.height(motion.apply(self.point[None]))[0]
        return bool(np.linalg.norm(turned - self.normal) < 1e-9 and abs(height) < ON_PLANE)


def plane(point: Vector, normal: Vector) -> Plane:
    """Build a rigid plane, such as a table or a wall.

    On the plane, ∂p/∂n = 0, and all sound is in front of it. The field is exact, because it is
    computed with mirror images of the sources and bodies. A point source on the plane radiates
    twice its open-air pressure. A transducer mounted flush with the plane keeps its
    sensitivity, because sensitivities are stated for transducers mounted in a board.

    Parameters
    ----------
    point : (3,) any point of the plane [m].
    normal : (3,) direction toward the side with the sound, of any length.

    Returns
    -------
    The plane, with a normal of unit length.

    Raises
    ------
    InvalidInput
        If the normal has length 0, or if a number is NaN or infinite.

    Examples
    --------
    >>> table = plane(point=(0, 0, -0.1), normal=(0, 0, 1))
    >>> table.height(np.array([[0.0, 0, 0]])).tolist()
    [0.1]
    """
    point = point_of(point, "the point of a plane")
    normal = point_of(normal, "the normal of a plane")
    length = float(np.linalg.norm(normal))
    if length == 0.0:
        raise InvalidInput(
            "the normal of a plane has length 0; use a vector that points to its front.",
            code="out_of_range",
        )
    return Plane(point, fixed(normal / length))


def planes_of(planes: Sequence[Plane], surfaces: Sequence[Surface]) -> tuple[Plane, ...]:
    """Check that a scene has at most one plane, and that no body touches or crosses the plane."""
    if isinstance(planes, Plane) or not isinstance(planes, Iterable):
        raise InvalidInput(
            f"the planes of a scene must be a list such as [plane], not a {type(planes).__name__}.",
            code="wrong_kind",
        )
    planes = tuple(planes)
    for index, plane in enumerate(planes):
        of_kind(plane, Plane, f"plane {index}", "plane(point, normal)")
    if len(planes) > 1:
        # The sum over the images between parallel planes does not converge, and crossing planes
        # form a corner with additional images.
        raise InvalidInput(
            f"the scene has {len(planes)} planes, but at most one is supported; keep only the "
            "plane nearest to the foci.",
            code="too_many",
        )
    for plane in planes:
        for index, surface in enumerate(surfaces):
            nearest = surface.shape.farthest(-plane.normal)
            gap = float(plane.height(nearest[None])[0])
            if gap < MIN_GAP * (1.0 - 1e-6):
                side = "behind" if gap < 0.0 else "in front of"
                raise InvalidInput(
                    f"body {index} reaches {millimetres(abs(gap), 3)} {side} the plane at "
                    f"{in_mm(nearest)}, but it must be at least {1e3 * MIN_GAP:g} mm in front of "
                    "it. Move it away, or reverse the normal of the plane.",
                    nearest,
                    code="bodies_overlap",
                )
    return planes


def images_in(
    planes: Sequence[Plane], points: Real[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "images 3"]:
    """Return points (P, 3) [m], followed by their mirror images if there is a plane."""
    return np.concatenate([points, *(plane.image(points) for plane in planes)])


def with_images(planes: Sequence[Plane], sources: Monopoles) -> Monopoles:
    """Return sources and their images in the plane, if there is one."""
    if not planes:
        return sources
    strengths = np.tile(sources.strengths, (1 + len(planes), 1))
    return Monopoles(images_in(planes, sources.positions), strengths)


def before_planes(
    planes: Sequence[Plane], points: Real[np.ndarray, "points 3"]
) -> Bool[np.ndarray, "points"]:
    """Return whether each of the points (P, 3) is on or in front of all planes."""
    before = np.ones(len(points), dtype=np.bool_)
    for plane in planes:
        before &= plane.height(points) >= -ON_PLANE
    return before


def check_before_planes(
    planes: Sequence[Plane], points: Real[np.ndarray, "points 3"], name: str
) -> None:
    """Raise an error if one of the points (P, 3) is behind a plane."""
    for plane in planes:
        height = plane.height(points)
        behind = np.flatnonzero(height < -ON_PLANE)
        if len(behind):
            deepest = int(height.argmin())
            raise InvalidInput(
                f"{len(behind)} of {len(points)} {name} points are behind the plane: {name} "
                f"{deepest} at {in_mm(points[deepest])} is {millimetres(-height[deepest], 3)} "
                "behind it. Move it in front of the plane, or reverse the normal of the plane.",
                points[deepest],
                code="behind_plane",
            )
