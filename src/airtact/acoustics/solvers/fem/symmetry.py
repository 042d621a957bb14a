"""Mirror planes of a scene, and the even and odd parts of a pressure about them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float64, Real

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.arrays import Points, Vectors
from airtact.errors import InvalidInput

AXES = "xyz"

# Distance of the surfaces from their mirror images that still counts as symmetric [λ]
TOLERANCE = 1e-3


@dataclass(frozen=True)
class Mirror:
    """A plane across one axis, 0, 1 or 2 for x, y or z, and its position there [m]."""

    axis: int
    position: float

    def image(self, points: Real[np.ndarray, "*axes 3"]) -> Float64[np.ndarray, "*axes 3"]:
        """Mirror images of points (..., 3) [m]."""
        image = np.array(points, dtype=np.float64)
        image[..., self.axis] = 2 * self.position - image[..., self.axis]
        return image


def mirrors_of(scene: Scene, axes: Sequence[str] | None) -> tuple[Mirror, ...]:
    """Planes of symmetry of a scene, through the middle of the bodies.

    None finds all symmetries. ``axes`` names those to use; a missing one raises "does_not_match".
    """
    shapes = [obstacle.surface.shape for obstacle in scene.obstacles]
    # Sources do not matter: any source is a sum of even and odd parts.
    corners = np.concatenate([shape.extreme_points() for shape in shapes])
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    tolerance = TOLERANCE * scene.wavelength
    mirrors = []
    for axis, name in enumerate(AXES):
        if axes is not None and name not in axes:
            continue
        mirror = Mirror(axis, float(middle[axis]))
        off = _asymmetry(scene, mirror)
        if off <= tolerance:
            mirrors.append(mirror)
        elif axes is not None:
            raise InvalidInput(
                f"the bodies deviate by {1e3 * off:.3g} mm from symmetry about the plane {name} = "
                f"{1e3 * mirror.position:.4g} mm (inf if boundaries differ); leave {name!r} out of "
                "symmetry.",
                code="does_not_match",
            )
    return tuple(mirrors)


def images(mirrors: Sequence[Mirror], points: Points) -> list[Vectors]:
    """Points (P, 3) reflected by each subset of the mirrors, in the order of ``parities``."""
    sets = []
    for choice in parities(mirrors):
        image = np.array(points, dtype=np.float64)
        for mirror, reflected in zip(mirrors, choice, strict=True):
            if reflected:
                image = mirror.image(image)
        sets.append(image)
    return sets


def parities(mirrors: Sequence[object]) -> list[tuple[int, ...]]:
    """Every choice of even (0) or odd (1) about each mirror."""
    return list(product((0, 1), repeat=len(mirrors)))


def signs(parity: Sequence[int]) -> Float64[np.ndarray, "images"]:
    """Sign of a pressure of that parity at each of the ``images`` of a point."""
    return np.array([(-1.0) ** np.dot(parity, choice) for choice in parities(parity)])


def _asymmetry(scene: Scene, mirror: Mirror) -> float:
    """Largest distance of mirrored surfaces from the surfaces [m]; inf if boundaries differ."""
    largest = 0.0
    for obstacle in scene.obstacles:
        image = mirror.image(obstacle.surface.quadratic_triangles.reshape(-1, 3))
        distances = [
            float(np.abs(candidate.surface.shape.depth(image)).max())
            for candidate in scene.obstacles
        ]
        facing = scene.obstacles[int(np.argmin(distances))]
        if (facing.boundary, facing.ratio, facing.medium) != (
            obstacle.boundary,
            obstacle.ratio,
            obstacle.medium,
        ):
            return float("inf")
        largest = max(largest, min(distances))
    return largest
