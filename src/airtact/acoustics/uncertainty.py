"""How sure one is of where the hand is, of the air and of the transducers: standard deviations."""

from dataclasses import dataclass, fields

import numpy as np

from airtact.checks import number, point_of
from airtact.errors import InvalidInput, Vector
from airtact.printing import one_line

SMALLEST_ANGLE = 0.1
"""Angles above zero and below this were probably meant in radians [degree]; they move nothing that counts."""

_LIMITS = {
    "position": (0.1, "m", "is it in millimetres? Give metres."),
    "rotation": (90.0, "degrees", "a hand is known better than that."),
    "own_position": (0.1, "m", "is it in millimetres? Give metres."),
    "own_rotation": (90.0, "degrees", "a hand is known better than that."),
    "along_skin": (0.1, "m", "is it in millimetres? Give metres."),
    "age": (1.0, "s", "is it in milliseconds? Give seconds."),
    "temperature": (10.0, "K", "the air of a room is known better than that."),
    "humidity": (0.5, "parts of 1", "5 per cent is humidity=0.05."),
    "gain": (0.5, "parts of 1", "5 per cent is gain=0.05."),
    "phase": (90.0, "degrees", "a drive is worth nothing then."),
    "dead": (0.9, "parts of 1", "10 per cent is dead=0.1."),
    "board_position": (0.1, "m", "is it in millimetres? Give metres."),
    "board_rotation": (90.0, "degrees", "boards are known better than that."),
}
"""Largest value of each doubt, its unit, and what is said beyond it."""

FASTEST = 20.0
"""Largest speed of a hand [m/s]."""


@dataclass(frozen=True)
class Uncertainty:
    """How sure one is of hand, air and transducers: standard deviations of normal distributions, all zero by default.

    Attributes
    ----------
    position : of the hand as a whole, each of x, y and z [m].
    rotation : of a turn of the hand about a random axis through the middle of the foci [degree].
    own_position, own_rotation : the same of each body by itself, or of the bone that carries a
        focus; a body turns about the middle of its own foci [m, degree].
    along_skin : of each focus on its body, in each of two directions along the surface [m].
    age : of the time for which the pose holds [s]; the hand is then off by that times its velocity.
    velocity : (3,) of the hand in the obstacles' frame [m/s]; not a deviation.
    temperature : of the air [K].
    humidity : relative humidity of the air, in parts of 1.
    gain : of the amplitude of each element, a share of it.
    phase : of each element [degree].
    dead : expected share of the elements that emit nothing.
    board_position, board_rotation : of each board, as those of the hand; it turns about its middle
        [m, degree].

    Raises
    ------
    InvalidInput
        "negative", "not_finite", "not_a_number"; "out_of_range": a number is larger than makes sense in its unit, or an
        angle is between 0 and 0.1 degrees, which was probably meant in radians.

    Examples
    --------
    >>> Uncertainty(position=1e-3, rotation=2.0)
    Uncertainty(position 0.001, rotation 2)
    """

    position: float = 0.0
    rotation: float = 0.0
    own_position: float = 0.0
    own_rotation: float = 0.0
    along_skin: float = 0.0
    age: float = 0.0
    velocity: Vector = (0.0, 0.0, 0.0)
    temperature: float = 0.0
    humidity: float = 0.0
    gain: float = 0.0
    phase: float = 0.0
    dead: float = 0.0
    board_position: float = 0.0
    board_rotation: float = 0.0

    def __repr__(self) -> str:
        given = [(one.name, getattr(self, one.name)) for one in fields(self)]
        shown = [
            f"{name} {value if isinstance(value, tuple) else f'{value:g}'}"
            for name, value in given
            if np.any(value)
        ]
        return one_line(self, *(shown or ["nothing in doubt"]))

    def __post_init__(self) -> None:
        for name, limit in _LIMITS.items():
            object.__setattr__(self, name, _deviation(getattr(self, name), name, *limit))
        velocity = point_of(self.velocity, "the velocity of the hand")
        speed = float(np.linalg.norm(velocity))
        if speed > FASTEST:
            raise InvalidInput(
                f"the velocity of the hand is {speed:g} m/s, more than {FASTEST:g} m/s: is it in mm/s? Give m/s.",
                code="out_of_range",
            )
        object.__setattr__(self, "velocity", tuple(velocity.tolist()))

    @property
    def shift(self) -> float:
        """Standard deviation of a focus along one axis, but for rotations and its place on the skin [m]."""
        late = self.age * np.linalg.norm(self.velocity)
        return float(np.sqrt(self.position**2 + self.own_position**2 + late**2))

    @property
    def none(self) -> bool:
        """Whether nothing is in doubt."""
        return not any(getattr(self, name) for name in _LIMITS)


def _deviation(value: float, name: str, largest: float, unit: str, slip: str) -> float:
    words = name.replace("_", " ")
    given = number(value, f"the uncertainty of {words}", unit)
    if not np.isfinite(given):
        raise InvalidInput(
            f"the uncertainty of {words} is {given:g} {unit}; give a finite number.",
            code="not_finite",
        )
    if given < 0.0:
        raise InvalidInput(
            f"the uncertainty of {words} is {given:g} {unit}, but a standard deviation is not negative.",
            code="out_of_range",
        )
    if given > largest:
        raise InvalidInput(
            f"the uncertainty of {words} is {given:g} {unit}, more than {largest:g}: {slip}",
            code="out_of_range",
        )
    if unit == "degrees" and 0.0 < given < SMALLEST_ANGLE:
        raise InvalidInput(
            f"the uncertainty of {words} is {given:g} degrees: is it in radians? Give degrees, "
            f"np.degrees({given:g}) = {np.degrees(given):.2g}, or 0.",
            code="out_of_range",
        )
    return given
