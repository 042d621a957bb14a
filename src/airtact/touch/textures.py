"""Textures: the strength of a touch as a function of the position on an object."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Real

from airtact.errors import (
    InvalidInput,
    Vector,
    check_finite,
    direction_of,
    real_numbers,
    within,
)

Points = Real[np.ndarray, "points 3"]


@dataclass(frozen=True, eq=False)
class Grating:
    """Parallel ridges with a sinusoidal profile, as the texture of a ``VirtualObject``.

    The strength of a touch is multiplied by the height ½ + ½ cos(2π x·n / pitch) at its position x,
    where n is the unit vector along ``direction``. Positions are in the coordinates of the object's
    ``shape``, and one ridge passes through their origin.

    Attributes
    ----------
    pitch : distance between neighbouring ridges [m], above zero and at most 0.1.
    direction : (3,) direction across the ridges, a vector of any length above zero, in the
        coordinates of the object's ``shape``.

    Raises
    ------
    InvalidInput
        If the pitch is outside its range or the direction is zero.

    Examples
    --------
    >>> Grating(4e-3).heights(np.array([[0.0, 0, 0], [2e-3, 0, 0]])).round(6).tolist()
    [1.0, 0.0]
    """

    pitch: float
    direction: Vector = (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        pitch = within(self.pitch, 0.0, 0.1, "the pitch of a grating", "m")
        object.__setattr__(self, "pitch", pitch)
        direction = direction_of(self.direction, "the direction of a grating")
        object.__setattr__(self, "direction", direction)

    def heights(self, points: Points) -> Float64[np.ndarray, "points"]:
        """Return the height (P,), from 0 to 1, at points (P, 3) in the object's frame [m]."""
        turns = points @ np.asarray(self.direction) / self.pitch
        return 0.5 + 0.5 * np.cos(2.0 * np.pi * turns)


@dataclass(frozen=True, eq=False)
class HeightMap:
    """An image of heights, as the texture of a ``VirtualObject``.

    The image lies in the xy plane of the coordinates of the object's ``shape``, is centred at their
    origin, and applies to all z. The strength of a touch is multiplied by the height at its
    position, so 0 is silent. Between the values, heights are interpolated linearly; beyond the
    image, the values at its border continue.

    Attributes
    ----------
    values : (R, C) heights from 0 to 1, with at least 2 rows and columns. Columns follow each other
        along +x, and rows along +y, so the first row has the smallest y.
    width : distance along x from the first to the last column [m], above 0 and at most 2. Rows are
        as far apart as columns.

    Raises
    ------
    InvalidInput
        If the values have another shape or are not between 0 and 1, or if the width is outside its
        range.

    Examples
    --------
    >>> steps = HeightMap(np.array([[0.0, 1.0], [0.0, 1.0]]), width=0.02)
    >>> steps.heights(np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])).tolist()
    [0.5, 1.0]
    """

    values: Real[np.ndarray, "rows columns"]
    width: float

    def __post_init__(self) -> None:
        values = real_numbers(self.values, "the heights of a texture")
        if values.ndim != 2 or min(values.shape) < 2:
            raise InvalidInput(
                f"the heights of a texture have shape {values.shape}, but at least 2 rows and 2 "
                "columns are required.",
                code="wrong_shape",
            )
        check_finite(values, "the heights of a texture")
        if values.min() < 0.0 or values.max() > 1.0:
            raise InvalidInput(
                f"the heights of a texture range from {values.min():g} to {values.max():g}, but "
                "they must lie between 0 and 1; scale them to this range.",
                code="out_of_range",
            )
        width = within(self.width, 0.0, 2.0, "the width of a texture", "m")
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "width", width)

    def heights(self, points: Points) -> Float64[np.ndarray, "points"]:
        """Return the height (P,), from 0 to 1, at points (P, 3) in the object's frame [m]."""
        from scipy.ndimage import map_coordinates

        rows, columns = self.values.shape
        step = self.width / (columns - 1)
        cells = points[:, [1, 0]] / step + 0.5 * (np.array([rows, columns]) - 1.0)
        # Outside the image, the heights at its border continue.
        return map_coordinates(self.values, cells.T, order=1, mode="nearest")
