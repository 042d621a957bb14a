"""The paper's model of thumb and forefinger, with settings for all that the paper leaves open.

Source: Inoue, Makino, Shinoda, SICE 2014, section 4 with Table 1 and Fig. 3, which has no dimensions.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

from airtact.conventions import InvalidInput
from airtact.printing import in_short
from airtact.scene.medium import Medium
from airtact.scene.scene import Scene, filled, sound_hard
from airtact.scene.sources import Monopoles
from airtact.scene.target import Target
from airtact.surfaces.primitives import capsule
from airtact.surfaces.surface import Surface

AIR = Medium(sound_speed=343.1, density=1.293)
"""Of the paper's Table 1."""

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
class Dummies:
    """Two fingers of a pinch with nothing between them, and a focus on the surface of each.

    Attributes
    ----------
    gap, radius : between the surfaces, and of a finger [m].
    tilt : of each finger, outward [degrees].
    entering : side from which they enter the box.
    surfaces : thumb (at -x) and finger (at +x).
    foci : (2, 3) the points of the surfaces that are nearest to each other [m].
    """

    gap: float
    radius: float
    tilt: float
    entering: Entering
    surfaces: tuple[Surface, Surface]
    foci: Float64[np.ndarray, "2 3"]

    __repr__ = in_short

    @property
    def rigid(self) -> Scene:
        """The fingers in the paper's air, sound-hard."""
        return Scene(AIR, [sound_hard(surface) for surface in self.surfaces], frequency=40e3)

    @property
    def watery(self) -> Scene:
        """The fingers filled with water, as the paper has them."""
        return Scene(AIR, [filled(surface, WATER) for surface in self.surfaces], frequency=40e3)

    @property
    def target(self) -> Target:
        """Both foci, as strong as possible."""
        return Target(self.foci)

    @property
    def beacon(self) -> Monopoles:
        """One excitation of both foci in phase, as the paper's symmetry plane makes it."""
        return Monopoles(self.foci, np.ones(2))

    @property
    def middle(self) -> Float64[np.ndarray, "3"]:
        """(3,) direction from the tips to the roots, without the tilt."""
        return WAYS[self.entering]


def dummies(
    gap: float = 12e-3,
    radius: float = 8e-3,
    tilt: float = 20.0,
    entering: Entering = "from below",
    edge: float = EDGE,
) -> Dummies:
    """Build both fingers as capsules, the tips towards each other along x.

    Parameters
    ----------
    gap, radius : [m].
    tilt : [degrees], 0 to 90, which lays both along x.
    entering : side from which they enter the box.
    edge : longest edge of the triangles in pictures [m]; solvers make their own.

    Raises
    ------
    InvalidInput
        If the tilt is outside its range, or a length is not above zero.

    Examples
    --------
    >>> dummies(gap=0.012).foci.tolist()
    [[-0.006, 0.0, 0.0], [0.006, 0.0, 0.0]]
    """
    if not 0.0 <= tilt <= 90.0:
        raise InvalidInput(
            f"a tilt of {tilt:g} degrees turns the fingers into each other; give 0 to 90.", code="out_of_range"
        )
    if not gap > 0.0:
        raise InvalidInput(
            f"a gap of {1e3 * gap:g} mm leaves no room between the fingers; give more than 0.", code="not_positive"
        )
    angle = math.radians(tilt)
    surfaces = []
    for side in (-1.0, 1.0):
        tip = np.array([side * (gap / 2 + radius), 0.0, 0.0])
        along = math.sin(angle) * np.array([side, 0.0, 0.0]) + math.cos(angle) * WAYS[entering]
        surfaces.append(capsule(tip + LENGTH * along, tip, radius, edge))
    foci = np.array([[-gap / 2, 0.0, 0.0], [gap / 2, 0.0, 0.0]])
    return Dummies(gap, radius, tilt, entering, (surfaces[0], surfaces[1]), foci)
