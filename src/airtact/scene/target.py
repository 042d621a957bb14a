"""What a person shall feel: points in the obstacles' frame and the pressures wanted there."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Real

from airtact.conventions import InvalidInput
from airtact.scene.guards import counted, fixed, place, points_of, real_numbers, refuse_not_finite
from airtact.scene.printing import in_short
from airtact.scene.sources import Monopoles

FARTHEST = 2.0
"""Farthest that a focus may be from the origin of the obstacles' frame [m], the largest extent of a body."""


@dataclass(frozen=True, eq=False)
class Beacons(Monopoles):
    """The imagined sources of a target, one in each focus, so that a refusal can call them foci."""


@dataclass(frozen=True, eq=False)
class Target:
    """Foci that ride with the hand.

    Attributes
    ----------
    points : (F, 3) foci in the obstacles' frame [m].
    pressures : (F,) peak pressures wanted [Pa], or None for as strong as possible.

    Examples
    --------
    >>> Target(np.array([[0.0, 0, 0], [0, 0, 0.02]]), pressures=1500.0).pressures.tolist()
    [1500.0, 1500.0]
    """

    points: Float64[np.ndarray, "foci 3"]
    pressures: Float64[np.ndarray, "foci"] | None

    __repr__ = in_short

    def __init__(
        self, points: Real[np.ndarray, "foci 3"], pressures: Real[np.ndarray, "foci"] | float | int | None = None
    ) -> None:
        """Check the points and bring the pressures to one per focus.

        Parameters
        ----------
        points : (F, 3) [m].
        pressures : (F,) peak pressures [Pa], one number for all foci, or None.

        Raises
        ------
        InvalidInput
            No points, NaN or infinity, a point over 2 m from the origin, a negative pressure, no pressure above zero,
            or not one pressure per focus.
        """
        object.__setattr__(self, "points", points_of(points, "target points"))
        away = np.linalg.norm(self.points, axis=1)
        worst = int(away.argmax())
        if away[worst] > FARTHEST:
            raise InvalidInput(
                f"focus {worst} at {place(self.points[worst])} is {away[worst]:.4g} m from the origin of "
                f"the obstacles' frame, more than {FARTHEST:g} m: is this in millimetres? Give metres.",
                self.points[worst],
            )
        object.__setattr__(self, "pressures", None if pressures is None else self._wanted(pressures))

    def _wanted(self, pressures: Real[np.ndarray, "..."] | float | int) -> Float64[np.ndarray, "foci"]:
        given = real_numbers(np.asarray(pressures), "target pressures")
        refuse_not_finite(given, "target pressures")
        if given.ndim != 0 and given.shape != (len(self.points),):
            raise InvalidInput(
                f"target pressures have shape {given.shape}, but the target has "
                f"{counted(len(self.points), 'focus', 'foci')}; give one number or ({len(self.points)},)."
            )
        if given.min() < 0.0:
            raise InvalidInput(f"a target pressure is {given.min():g} Pa, but peak pressures are not negative.")
        if given.max() == 0.0:
            raise InvalidInput("every target pressure is 0 Pa; ask at least one focus for more.")
        return fixed(np.broadcast_to(given, (len(self.points),)))

    def beacons(self) -> Monopoles:
        """One imagined source of 1 Pa·m in every focus, each its own sound: strengths are the identity (F, F)."""
        return Beacons(self.points, np.eye(len(self.points), dtype=np.complex128))
