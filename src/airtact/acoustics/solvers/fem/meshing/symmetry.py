"""Mirror planes of a scene, and pressures as sums of parts that are even or odd about them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float64, Real

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.arrays import Points, Vectors
from airtact.errors import InvalidInput

AXES = "xyz"

TOLERANCE = 1e-3
"""Distance of the surfaces from their mirror images that still counts as symmetric, in wavelengths."""


@dataclass(frozen=True)
class Mirror:
    """A plane across one axis, 0, 1 or 2 for x, y or z, and its position there [m]."""

    axis: int
    position: float

    def image(self, points: Real[np.ndarray, "*axes 3"]) -> Float64[np.ndarray, "*axes 3"]:
        """Mirror images of points (..., 3) [m]."""
        found = np.array(points, dtype=np.float64)
        found[..., self.axis] = 2 * self.position - found[..., self.axis]
        return found


def mirrors_of(scene: Scene, asked: Sequence[str] | None) -> tuple[Mirror, ...]:
    """Planes across x, y and z, through the middle of the bodies, that the scene is symmetric about.

    ``asked`` are the axes of the planes to take, None for all that there are; raises
    "hand_implausible" where the scene is not symmetric about a plane that was asked for.
    """
    corners = np.concatenate(
        [obstacle.surface.shape.extreme_points() for obstacle in scene.obstacles]
    )
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    found = []
    for axis in range(3):
        if asked is not None and AXES[axis] not in asked:
            continue
        mirror = Mirror(axis, float(middle[axis]))
        off = _off_symmetry(scene, mirror)
        if off <= TOLERANCE * scene.wavelength:
            found.append(mirror)
        elif asked is not None:
            apart = f"the bodies are {1e3 * off:.3g} mm off it"
            raise InvalidInput(
                f"symmetry about the plane {AXES[axis]} = {1e3 * mirror.position:.4g} mm was asked for, but "
                f"{apart if np.isfinite(off) else 'bodies of 2 kinds face each other'}, more than "
                f"{1e3 * TOLERANCE * scene.wavelength:.2g} mm; leave {AXES[axis]!r} out of symmetry.",
                code="hand_implausible",
            )
    return tuple(found)


def images(mirrors: Sequence[Mirror], points: Points) -> list[Vectors]:
    """Points (P, 3) reflected by every choice of the mirrors: 1, 2, 4 or 8 sets, in the order of ``parities``."""
    found = []
    for choice in product((0, 1), repeat=len(mirrors)):
        image = np.array(points, dtype=np.float64)
        for mirror, taken in zip(mirrors, choice, strict=True):
            image = mirror.image(image) if taken else image
        found.append(image)
    return found


def parities(mirrors: Sequence[Mirror]) -> list[tuple[int, ...]]:
    """Every choice of even (0) or odd (1) about each mirror."""
    return list(product((0, 1), repeat=len(mirrors)))


def signs(parity: Sequence[int]) -> Float64[np.ndarray, "images"]:
    """Sign of a pressure of that parity at each of the ``images`` of a point."""
    return np.array(
        [(-1.0) ** np.dot(parity, choice) for choice in product((0, 1), repeat=len(parity))]
    )


def _off_symmetry(scene: Scene, mirror: Mirror) -> float:
    """Largest distance of mirrored surfaces from the surfaces [m]; infinite where bodies of two kinds face."""
    off = 0.0
    for obstacle in scene.obstacles:
        image = mirror.image(obstacle.surface.quadratic_triangles.reshape(-1, 3))
        distances = [
            float(np.abs(other.surface.shape.depth(image)).max()) for other in scene.obstacles
        ]
        nearest = scene.obstacles[int(np.argmin(distances))]
        if (nearest.boundary, nearest.ratio, nearest.medium) != (
            obstacle.boundary,
            obstacle.ratio,
            obstacle.medium,
        ):
            return float("inf")
        off = max(off, min(distances))
    return off
