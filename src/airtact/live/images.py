"""Elements and their images in a rigid plane, which sound with them: what the live loop knows of a table or a wall.

The hand scatters what comes from both. What then goes to and fro between the hand and the plane is
left out: its phase turns with every millimetre of height, so that no solution of another pose would
serve.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Complex128, Float64, Int64

from airtact.acoustics.planes import Plane
from airtact.printing import in_short
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import off_plane


@dataclass(frozen=True, eq=False)
class WithImages:
    """An array of E elements and the images of those that are not part of the plane.

    Attributes
    ----------
    array : R elements: those of the array, then images.
    imaged : (R - E,) the element that each image is of.
    strengths : (E,) of the elements themselves: 2 where one is part of the plane, its own image,
        else 1.
    """

    array: PhasedArray
    imaged: Int64[np.ndarray, "images"]
    strengths: Float64[np.ndarray, "elements"]

    __repr__ = in_short

    @classmethod
    def of(cls, array: PhasedArray, planes: Sequence[Plane]) -> "WithImages":
        """Add the images in a plane; without planes there are none."""
        imaged, strengths = np.zeros(0, dtype=np.int64), np.ones(len(array))
        for plane in planes:
            imaged = np.flatnonzero(off_plane(plane, array))
            strengths = np.where(off_plane(plane, array), 1.0, 2.0)
            normals, tangents = (
                one[imaged] - 2.0 * np.outer(one[imaged] @ plane.normal, plane.normal)
                for one in (array.normals, array.tangents)
            )
            array = PhasedArray(
                np.concatenate([array.positions, plane.image(array.positions[imaged])]),
                np.concatenate([array.normals, normals]),
                array.element,
                np.concatenate([array.tangents, tangents]),
                np.concatenate([array.gains, array.gains[imaged]]),
            )
        return cls(array, imaged, strengths)

    def folded(
        self, rows: Complex[np.ndarray, "*any sounding"]
    ) -> Complex[np.ndarray, "*any elements"]:
        """Add what images do to what their elements do: per unit drive of each element."""
        count = len(self.strengths)
        if rows.shape[-1] == count and (self.strengths == 1.0).all():
            return rows
        out = rows[..., :count] * self.strengths
        out[..., self.imaged] += rows[..., count:]
        return out.astype(rows.dtype, copy=False)

    def unfolded(
        self, amplitudes: Complex128[np.ndarray, "elements"]
    ) -> Complex128[np.ndarray, "sounding"]:
        """Return the amplitudes of elements and images for those of the elements."""
        return np.concatenate([amplitudes * self.strengths, amplitudes[self.imaged]])
