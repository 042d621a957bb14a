"""The paper's model of thumb and forefinger, with settings for all that the paper leaves open.

Source: Inoue, Makino, Shinoda, SICE 2014, section 4 with Table 1 and Fig. 3, which has no
dimensions.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene, filled
from airtact.acoustics.sources import Monopoles
from airtact.benching.scenes import AIR, FREQUENCY, Bodies
from airtact.errors import InvalidInput
from airtact.geometry.primitives import capsule
from airtact.printing import in_short

WATER = Medium(sound_speed=1481.0, density=999.7)
"""Filling of the paper's fingers (Table 1)."""

LENGTH = 44e-3
"""Length of a finger's axis [m]."""

EDGE = 2.5e-3
"""Longest edge of the triangles where nothing is drawn [m]."""

Entering = Literal["from below", "from above", "from the side"]
"""Direction from which the fingers enter the box: along its open axis z, or across it."""

WAYS = {
    "from below": np.array([0.0, 0.0, -1.0]),
    "from above": np.array([0.0, 0.0, 1.0]),
    "from the side": np.array([0.0, -1.0, 0.0]),
}
"""Direction from the tip to the root of a finger that is not tilted."""


@dataclass(frozen=True, eq=False)
class Dummies(Bodies):
    """Thumb (at -x) and finger of a pinch with nothing between them, and the foci where they are nearest each other.

    ``middle`` is the direction from the tips to the roots, without the tilt.
    """

    middle: Float64[np.ndarray, "3"]

    __repr__ = in_short

    @property
    def watery(self) -> Scene:
        """The fingers filled with water, as the paper has them."""
        return Scene(
            AIR, [filled(surface, WATER) for surface in self.surfaces], frequency=FREQUENCY
        )

    @property
    def beacon(self) -> Monopoles:
        """One excitation of both foci in phase, as the paper's symmetry plane makes it."""
        return Monopoles(self.foci, np.ones(2))


def dummies(
    gap: float = 12e-3,
    radius: float = 8e-3,
    tilt: float = 20.0,
    entering: Entering = "from below",
    edge: float = EDGE,
) -> Dummies:
    """Build both fingers as capsules, the tips towards each other along x.

    Gap, radius and the longest edge of the triangles in pictures (solvers make their own) are in
    metres, the tilt in degrees: 0 to 90, which lays both along x. ``InvalidInput`` is raised for
    another tilt, or a length not above zero.

    >>> dummies(gap=0.012).foci.tolist()
    [[-0.006, 0.0, 0.0], [0.006, 0.0, 0.0]]
    """
    if not 0.0 <= tilt <= 90.0:
        raise InvalidInput(
            f"a tilt of {tilt:g} degrees turns the fingers into each other; give 0 to 90.",
            code="out_of_range",
        )
    if not gap > 0.0:
        raise InvalidInput(
            f"a gap of {1e3 * gap:g} mm leaves no room between the fingers; give more than 0.",
            code="out_of_range",
        )
    angle = math.radians(tilt)
    surfaces = []
    for side in (-1.0, 1.0):
        tip = np.array([side * (gap / 2 + radius), 0.0, 0.0])
        along = math.sin(angle) * np.array([side, 0.0, 0.0]) + math.cos(angle) * WAYS[entering]
        surfaces.append(capsule(tip + LENGTH * along, tip, radius, edge))
    foci = np.array([[-gap / 2, 0.0, 0.0], [gap / 2, 0.0, 0.0]])
    return Dummies(tuple(surfaces), foci, WAYS[entering])
