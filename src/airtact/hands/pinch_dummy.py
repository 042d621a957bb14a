"""The paper's model of a pinching hand: two capsules that represent thumb and index finger.

Source: Inoue, Makino and Shinoda (2014), section 4, with the simplifications that
``docs/architecture.md`` describes.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.errors import InvalidInput, fixed, in_short, number, within
from airtact.geometry.primitives import capsule
from airtact.geometry.surface import Surface

# Radius of a finger [m].
RADIUS = 8e-3

# Length of a finger's axis [m].
LENGTH = 44e-3

# Angle between each finger and the vertical [rad].
SPREAD = math.radians(20.0)


@dataclass(frozen=True, eq=False)
class Pinch:
    """A thumb and a finger whose tips face each other along x.

    Attributes
    ----------
    surfaces : the thumb (at -x) and the finger (at +x).
    pads : (2, 3) point on each skin that is nearest to the other skin [m].
    normals : (2, 3) outward unit normals at the pads.
    gap : distance between the pads [m].
    """

    surfaces: tuple[Surface, Surface]
    pads: Float64[np.ndarray, "2 3"]
    normals: Float64[np.ndarray, "2 3"]
    gap: float

    __repr__ = in_short

    def foci(self, offset: float = 0.5e-3) -> Float64[np.ndarray, "2 3"]:
        """Return one point in front of each pad, as an array (2, 3) [m].

        Parameters
        ----------
        offset : distance from the skin into the gap [m]; 0 for points on the skin.

        Raises
        ------
        InvalidInput
            If the offset is negative or reaches the other finger.
        """
        offset = number(offset, "the offset of the foci", "m")
        if not 0.0 <= offset < self.gap:
            raise InvalidInput(
                f"foci {offset * 1e3:g} mm from the pads do not lie in the gap of "
                f"{self.gap * 1e3:g} mm. Use an offset that is at least 0 and less than the gap.",
                code="out_of_range",
            )
        return self.pads + offset * self.normals


def pinch(gap: float = 0.012, edge: float = 2.5e-3) -> Pinch:
    """Build the thumb and the finger of a pinch.

    The centres of the tips are at (∓(gap/2 + 8 mm), 0, 0). The axes run 44 mm downward (-z), tilted
    outward by 20° from the vertical.

    Parameters
    ----------
    gap : distance between the two skins [m], above zero and at most 0.2.
    edge : largest edge length of the triangles [m].

    Returns
    -------
    Two capsules of 8 mm radius, with their pads and normals.

    Raises
    ------
    InvalidInput
        If a length is not above zero, or the gap is wider than a hand.

    Examples
    --------
    >>> pinch(gap=0.012).pads.tolist()
    [[-0.006, 0.0, 0.0], [0.006, 0.0, 0.0]]
    """
    gap = within(gap, 0.0, 0.2, "gap", "m", "is it in millimetres? Use metres.")
    side = np.array([-1.0, 1.0])
    tips = np.outer(side, [gap / 2.0 + RADIUS, 0.0, 0.0])
    roots = tips + LENGTH * np.stack(
        [side * math.sin(SPREAD), np.zeros(2), np.full(2, -math.cos(SPREAD))], axis=1
    )
    thumb = capsule(roots[0], tips[0], RADIUS, edge)
    finger = capsule(roots[1], tips[1], RADIUS, edge)
    # Adding zero turns -0.0 into 0.0.
    normals = np.outer(-side, [1.0, 0.0, 0.0]) + 0.0
    pads = np.outer(side, [gap / 2.0, 0.0, 0.0]) + 0.0
    return Pinch((thumb, finger), fixed(pads), fixed(normals), gap)
