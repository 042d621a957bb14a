"""A slice of the field: where its points are, and its picture."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.ndimage import zoom

from airtact.printing import in_short

ACROSS = 0.12
"""Side of a slice [m]."""

PIXELS = 56
"""Points along a side at which the field is computed, a quarter of a wavelength apart at 40 kHz."""

ENLARGED = 2
"""Each of them is so many pixels wide, the field between being interpolated."""

Across = Literal["x", "y", "z"]


@dataclass(frozen=True, eq=False)
class Section:
    """A slice of the field.

    Attributes
    ----------
    foci : (3,) the middle of the foci [m].
    across : the axis across the slice.
    offset : of the slice from there along that axis [m].
    """

    foci: Float64[np.ndarray, "3"]
    across: Across
    offset: float

    __repr__ = in_short

    @property
    def axes(self) -> Float64[np.ndarray, "3 3"]:
        """Axes along the slice, up in it and across it, one a row; together they turn to the right."""
        x, y, z = np.eye(3)
        along, up = {"x": (y, z), "y": (x, z), "z": (x, y)}[self.across]
        return np.stack([along, up, np.cross(along, up)])

    @property
    def middle(self) -> Float64[np.ndarray, "3"]:
        """The middle of the slice [m]."""
        return self.foci + self.offset * np.abs(self.axes[2])

    def points(self) -> Float64[np.ndarray, "points 3"]:
        """Return the points, row by row from the top [m]."""
        along, up, _ = self.axes
        steps = np.linspace(-0.5, 0.5, PIXELS) * ACROSS
        return (self.middle + steps[None, :, None] * along - steps[:, None, None] * up).reshape(
            -1, 3
        )


def enlarged(field: Complex128[np.ndarray, "points"]) -> Float64[np.ndarray, "rows columns"]:
    """Return the magnitude of a slice's field, interpolated by cubic splines to ``ENLARGED`` times as many points."""
    rows = field.reshape(PIXELS, PIXELS)
    return np.abs(np.asarray(zoom(rows, ENLARGED)))
