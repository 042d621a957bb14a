"""Points for pictures and field files: windows through the foci, and boxes around the foci."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Real

from airtact.acoustics.scene import Scene

# Unit vectors of the frame by name
AXES = dict(zip("xyz", np.eye(3), strict=True))


@dataclass(frozen=True, eq=False)
class Window:
    """A rectangular grid of points in a plane, at which the field of a picture is evaluated.

    The attribute ``points`` contains the positions of the grid. Values are not checked.

    Attributes
    ----------
    centre : (3,) centre of the rectangle in the scene [m].
    right, up : (3,) perpendicular unit vectors along the sides of the rectangle, as seen in the
        picture.
    width, height : lengths of the sides along ``right`` and ``up`` [m].
    step : intended distance between neighbouring points [m]. The actual distance along each side
        differs slightly, so that points lie on all borders; each side has at least 2 points.
    """

    centre: Float64[np.ndarray, "3"]
    right: Float64[np.ndarray, "3"]
    up: Float64[np.ndarray, "3"]
    width: float
    height: float
    step: float

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns of points."""
        return max(2, round(self.height / self.step) + 1), max(2, round(self.width / self.step) + 1)

    @property
    def points(self) -> Float64[np.ndarray, "points 3"]:
        """The points [m], row by row from the lower left corner."""
        rows, columns = self.shape
        across = np.linspace(-self.width / 2, self.width / 2, columns)
        along = np.linspace(-self.height / 2, self.height / 2, rows)
        grid = self.centre + across[None, :, None] * self.right + along[:, None, None] * self.up
        return grid.reshape(-1, 3)

    @property
    def normal(self) -> Float64[np.ndarray, "3"]:
        """Unit vector out of the plane, toward the viewer."""
        return np.cross(self.right, self.up)

    @property
    def origin(self) -> Float64[np.ndarray, "3"]:
        """Origin of the picture's axes [m].

        The picture's coordinates are relative to the origin of the frame if the sides of the window
        are parallel to the frame's axes. Otherwise, they are relative to the centre of the window.
        """
        aligned = [axis for axis in (self.right, self.up) if _axis_name(axis)]
        return self.centre - sum((self.centre @ axis * axis for axis in aligned), np.zeros(3))

    @property
    def labels(self) -> tuple[str, str]:
        """Names of the picture's axes."""
        return _axis_name(self.right) or "across [mm]", _axis_name(self.up) or "up [mm]"

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edge of the picture, relative to ``origin`` [mm]."""
        ((across, along),) = self.seen(self.centre[None])
        half_width = 500 * self.width
        half_height = 500 * self.height
        return across - half_width, across + half_width, along - half_height, along + half_height

    def seen(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 2"]:
        """Return positions (P, 2) [mm] of points (P, 3) in the picture, relative to ``origin``."""
        return 1e3 * (points - self.origin) @ np.stack([self.right, self.up], axis=1)

    def height_of(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Return the height [m] of points (P, 3) above the plane, positive toward the viewer."""
        return (points - self.centre) @ self.normal


def _axis_name(direction: Float64[np.ndarray, "3"]) -> str:
    return next((f"{name} [mm]" for name, axis in AXES.items() if direction @ axis > 1 - 1e-9), "")


def plane_through(
    foci: Real[np.ndarray, "foci 3"], bodies: Real[np.ndarray, "vertices 3"], wavelength: float
) -> Window:
    """Return a window in the plane that fits the foci best.

    If the foci define only a line or a point, the plane also passes through the bodies. The window
    extends three wavelengths beyond the outermost foci and contains at most about 20,000 points.
    Its sides are parallel to the axes of the frame if the plane allows this.
    """
    middle = foci.mean(axis=0)
    # Principal directions of the foci, the widest first. A spread below a tenth of a wavelength
    # does not define a direction.
    _, spreads, principal = np.linalg.svd(foci - middle, full_matrices=False)
    candidates = list(principal[: len(spreads)][spreads > wavelength / 10])
    if len(bodies):
        towards = _direction(bodies.mean(axis=0) - middle)
        # Prefer an axis of the frame within 18 degrees, because the picture is easier to read.
        near = [axis for axis in AXES.values() if abs(towards @ axis) > 0.95]
        candidates.append(near[0] if near else towards)
    candidates += [AXES["z"], AXES["x"], AXES["y"]]
    # The first two directions that differ clearly, of which the second is made perpendicular.
    first = next(axis for axis in candidates if np.linalg.norm(axis) > 0.5)
    across = (axis - axis @ first * first for axis in candidates)
    second = _direction(next(axis for axis in across if np.linalg.norm(axis) > 0.3))
    normal = np.cross(first, second)
    # The upward direction is z, or y if z is nearly normal to the plane; right is mostly positive.
    axis = AXES["z"] if abs(normal[2]) < 0.9 else AXES["y"]
    up = _direction(axis - axis @ normal * normal)
    right = np.cross(up, normal)
    right = right * np.sign(right[np.argmax(np.abs(right))])
    # A rounding error would hide that a side is parallel to an axis of the frame.
    right, up = (np.where(np.abs(edge) < 1e-12, 0.0, edge) for edge in (right, up))
    return _round_foci(foci, right, up, wavelength)


def plane_of_scene(scene: Scene, foci: Real[np.ndarray, "foci 3"]) -> Window:
    """Return the window of ``plane_through`` for foci (F, 3) [m] and all bodies of a scene."""
    vertices = np.concatenate(
        [np.empty((0, 3)), *(obstacle.surface.vertices for obstacle in scene.obstacles)]
    )
    return plane_through(foci, vertices, scene.wavelength)


def plane_across(
    foci: Real[np.ndarray, "foci 3"], name: Literal["xy", "xz", "yz"], wavelength: float
) -> Window:
    """Return a window around the foci, in the plane of two axes of the frame such as "xz"."""
    return _round_foci(foci, AXES[name[0]], AXES[name[1]], wavelength)


def _round_foci(foci: np.ndarray, right: np.ndarray, up: np.ndarray, wavelength: float) -> Window:
    middle = foci.mean(axis=0)
    within = (foci - middle) @ np.stack([right, up], axis=1)
    lowest = within.min(axis=0)
    highest = within.max(axis=0)
    width, height = highest - lowest + 6 * wavelength
    centre = middle + (lowest + highest) / 2 @ np.stack([right, up])
    # About 20,000 points, but no fewer than 8 and no more than 18 points per wavelength.
    step = np.clip(np.sqrt(width * height / 20_000), wavelength / 18, wavelength / 8)
    return Window(centre, right, up, float(width), float(height), float(step))


def _direction(vector: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
    length = np.linalg.norm(vector)
    return vector / length if length > 0 else np.zeros(3)


@dataclass(frozen=True, eq=False)
class Box:
    """A grid of points in a cuboid whose edges are parallel to the axes of the scene.

    ``box_around`` and ``Slices.box`` return it for writing the field in this cuboid to a file.
    ``points`` lists all points (P, 3) of the grid [m], with x varying fastest.

    Attributes
    ----------
    origin : (3,) corner with the smallest coordinates [m].
    step : (3,) distance between neighbouring points along each axis [m].
    counts : numbers of points along x, y and z, whose product is P.
    """

    origin: Float64[np.ndarray, "3"]
    step: Float64[np.ndarray, "3"]
    counts: tuple[int, int, int]

    @property
    def points(self) -> Float64[np.ndarray, "points 3"]:
        """The points [m], with x varying fastest and z slowest."""
        # VTK's image data has this order.
        indices = np.stack(np.unravel_index(np.arange(np.prod(self.counts)), self.counts, "F"), 1)
        return self.origin + self.step * indices


def box_around(
    foci: Real[np.ndarray, "foci 3"], wavelength: float, max_points: int = 60_000
) -> Box:
    """Return a box around the foci that extends 1.5 wavelengths beyond them."""
    lowest = foci.min(axis=0) - 1.5 * wavelength
    size = foci.max(axis=0) + 1.5 * wavelength - lowest
    step = float(max(wavelength / 8, np.cbrt(np.prod(size) / max_points)))
    across, along, deep = (max(2, int(length / step) + 1) for length in size)
    return Box(lowest, np.full(3, step), (across, along, deep))
