"""Rigid planes, such as a table or a wall: what sound does before one follows from images behind it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Real

from airtact.acoustics.sources import Monopoles
from airtact.checks import fixed, in_mm, of_kind, point_of
from airtact.errors import InvalidInput, Vector
from airtact.geometry.checks import NEAREST
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.printing import one_line

ON_PLANE = 1e-9
"""Points up to this deep behind a plane count as on it [m]."""

PARALLEL = 1e-6
"""Sine of the angle between two planes up to which they are parallel."""

LEAST_GAP = 0.5 * NEAREST
"""Air between a body and a plane at least [m]: the body and its image are then as far apart as two bodies must be."""


@dataclass(frozen=True, eq=False)
class Plane:
    """A rigid plane without end; sound is on the side that its normal points to. ``plane`` makes it.

    Attributes
    ----------
    point : (3,) any point of it [m].
    normal : (3,) unit normal.
    """

    point: Float64[np.ndarray, "3"]
    normal: Float64[np.ndarray, "3"]

    def __repr__(self) -> str:
        return one_line(
            self, f"through {in_mm(self.point)}", f"normal {np.round(self.normal, 3) + 0.0}"
        )

    def height(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance of points (P, 3) [m] before the plane [m], negative behind it."""
        return (points - self.point) @ self.normal

    def image(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Mirror points (P, 3) [m] in the plane."""
        return points - 2.0 * self.height(points)[:, None] * self.normal

    def moved(self, motion: Pose) -> "Plane":
        """Return the plane after a rigid motion."""
        return Plane(fixed(motion.apply(self.point)), fixed(motion.rotate(self.normal)))

    def kept_by(self, motion: Pose) -> bool:
        """Whether a rigid motion brings the plane onto itself: along it, and turns about its normal.

        After such a motion of the bodies a field solved before the plane still holds for them and
        the plane, which has stayed where it was.
        """
        turned, moved = motion.rotate(self.normal[None])[0], motion.apply(self.point[None])
        return bool(
            np.linalg.norm(turned - self.normal) < 1e-9 and np.abs(self.height(moved))[0] < ON_PLANE
        )


def plane(point: Vector, normal: Vector, ratio: complex | float | None = None) -> Plane:
    """Make a rigid plane, such as a table or a wall: ∂p/∂n = 0 all over it, and all sound before it.

    The image of each source and body in the plane makes the field exactly. A source or element on
    the plane radiates twice the pressure that it has in open air, as one let into a table does
    whose surface keeps moving the same air.

    Parameters
    ----------
    point : (3,) any point of the plane [m].
    normal : (3,) direction towards the side where the sound is; its length does not matter.
    ratio : None. A plane with an impedance Z/(ρc) is rejected: its image is exact for plane waves
        only.

    Raises
    ------
    InvalidInput
        A normal of length 0, NaN or infinity, or a ratio.

    Examples
    --------
    >>> table = plane(point=(0, 0, -0.1), normal=(0, 0, 1))
    >>> table.height(np.array([[0.0, 0, 0]])).tolist()
    [0.1]
    """
    at, along = point_of(point, "the point of a plane"), point_of(normal, "the normal of a plane")
    length = float(np.linalg.norm(along))
    if length == 0.0:
        raise InvalidInput(
            "the normal of a plane has length 0; give the direction to its front.",
            code="out_of_range",
        )
    if ratio is not None:
        raise InvalidInput(
            f"a plane of impedance ratio {ratio} is not solved, rigid ones are; leave ratio out.",
            code="not_supported",
        )
    return Plane(at, fixed(along / length))


def planes_of(given: Sequence[Plane], surfaces: Sequence[Surface]) -> tuple[Plane, ...]:
    """Return the planes of a scene, at most one; raise where a body touches it or reaches behind it."""
    if isinstance(given, Plane) or not isinstance(given, Iterable):
        raise InvalidInput(
            f"the planes of a scene are 1 {type(given).__name__} by itself; put it into a list: [plane].",
            code="wrong_kind",
        )
    planes = tuple(
        of_kind(one, Plane, f"plane {index}", "plane(point, normal)")
        for index, one in enumerate(given)
    )
    if len(planes) > 1:
        raise InvalidInput(
            f"the scene has {len(planes)} planes, but 1 is solved: {_why_not_two(planes[0], planes[1])}; leave out "
            "those that are farther from the foci.",
            code="too_many",
        )
    for one in planes:
        for index, surface in enumerate(surfaces):
            _check_before(one, index, surface)
    return planes


def _why_not_two(one: Plane, other: Plane) -> str:
    if np.linalg.norm(np.cross(one.normal, other.normal)) > PARALLEL:
        return "planes that cross make a corner, which has other images"
    apart = 1e3 * abs(float(one.height(other.point[None])[0]))
    return (
        f"rigid planes {apart:.3g} mm apart absorb nothing, so that the images between them fall off only as one over "
        "their number and their sum does not converge"
    )


def _check_before(one: Plane, index: int, surface: Surface) -> None:
    where = surface.shape.farthest(-one.normal)
    gap = float(one.height(where[None])[0])
    if gap >= LEAST_GAP * (1.0 - 1e-6):
        return
    how = f"reaches {-1e3 * gap:.3g} mm behind" if gap < 0.0 else f"is {1e3 * gap:.3g} mm before"
    raise InvalidInput(
        f"body {index} {how} the plane at {in_mm(where)}, but it must stay {1e3 * LEAST_GAP:g} mm or more before it: "
        "move it away, or turn the normal of the plane.",
        where,
        code="bodies_overlap",
    )


def images_in(
    planes: Sequence[Plane], points: Real[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "images 3"]:
    """Return points (P, 3) [m], then their images in the plane, if there is one."""
    return np.concatenate([points, *(one.image(points) for one in planes)])


def with_images(planes: Sequence[Plane], sources: Monopoles) -> Monopoles:
    """Return sources and their images in the plane, which emit with them; without planes the sources themselves."""
    if not planes:
        return sources
    strengths = np.tile(sources.strengths, (1 + len(planes), 1))
    return Monopoles(images_in(planes, sources.positions), strengths)


def before_planes(
    planes: Sequence[Plane], points: Real[np.ndarray, "points 3"]
) -> Bool[np.ndarray, "points"]:
    """Whether points (P, 3) [m] are on or before all planes."""
    before = np.ones(len(points), dtype=np.bool_)
    for one in planes:
        before &= one.height(points) >= -ON_PLANE
    return before


def check_before_planes(
    planes: Sequence[Plane], points: Real[np.ndarray, "points 3"], what: str
) -> None:
    """Raise "behind_plane" where one of the points (P, 3) [m] is behind a plane; ``what`` names one point."""
    for one in planes:
        height = one.height(points)
        behind = np.flatnonzero(height < -ON_PLANE)
        if len(behind):
            deepest = int(height.argmin())
            raise InvalidInput(
                f"{len(behind)} of {len(points)} {what} points behind the plane: {what} {deepest} at "
                f"{in_mm(points[deepest])} by {-1e3 * height[deepest]:.3g} mm; move it to the front, or turn the "
                "normal of the plane.",
                points[deepest],
                code="behind_plane",
            )
