"""Uncertainty of the hand's position, the air and the transducers, as standard deviations."""

from dataclasses import dataclass, fields

import numpy as np

from airtact.errors import InvalidInput, Vector, between, one_line, point_of

# Angles above zero and below this are probably in radians [degree].
SMALLEST_ANGLE = 0.1

_MILLIMETRES = "is it in millimetres? Use metres."

# Largest value of each deviation, its unit, and the hint in the error for a larger value.
_LIMITS = {
    "position": (0.1, "m", _MILLIMETRES),
    "rotation": (90.0, "degrees", "hands are located more accurately."),
    "own_position": (0.1, "m", _MILLIMETRES),
    "own_rotation": (90.0, "degrees", "hands are located more accurately."),
    "along_skin": (0.1, "m", _MILLIMETRES),
    "age": (1.0, "s", "is it in milliseconds? Use seconds."),
    "temperature": (10.0, "K", "the temperature of a room is known more precisely."),
    "humidity": (0.5, "", "5 per cent is humidity=0.05."),
    "gain": (0.5, "", "5 per cent is gain=0.05."),
    "phase": (90.0, "degrees", "no drive can focus with such phase errors."),
    "dead": (0.9, "", "10 per cent is dead=0.1."),
}


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of the hand's pose, the air and the transducers.

    All attributes are standard deviations, except ``velocity`` and ``dead``, and are 0 by
    default.

    Attributes
    ----------
    position : standard deviation of the hand's position along each of x, y and z [m].
    rotation : standard deviation of the angle by which the hand rotates about a random axis through
        the middle of the foci [degree].
    own_position, own_rotation : standard deviations of an additional shift along each axis [m] and
        an additional rotation [degree] of each body, or of each bone with a focus. A body rotates
        about the middle of its foci.
    along_skin : standard deviation of the position of each focus on its body, in each of two
        directions along the surface [m].
    age : standard deviation of the time between the measurement of the pose and the emission [s].
        An older pose shifts the hand farther along ``velocity``.
    velocity : (3,) velocity of the hand in the obstacles' frame [m/s].
    temperature : standard deviation of the air's temperature [K].
    humidity : standard deviation of the air's relative humidity, which is a fraction from 0 to 1.
    gain : standard deviation of each element's amplitude, as a fraction of its nominal amplitude.
    phase : standard deviation of each element's phase [degree].
    dead : expected fraction of the elements that emit nothing.

    Raises
    ------
    InvalidInput
        If a value is not a number, is not finite, is negative or is implausibly large in its unit,
        or if an angle is between 0 and 0.1 degrees and therefore probably in radians.

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

    def __repr__(self) -> str:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        shown = [
            f"{name} {value if isinstance(value, tuple) else f'{value:g}'}"
            for name, value in values.items()
            if np.any(value)
        ]
        return one_line(self, *(shown or ["none"]))

    def __post_init__(self) -> None:
        for name, (largest, unit, slip) in _LIMITS.items():
            words = f"the uncertainty of {name.replace('_', ' ')}"
            value = between(getattr(self, name), 0.0, largest, words, unit, slip)
            if unit == "degrees" and 0.0 < value < SMALLEST_ANGLE:
                raise InvalidInput(
                    f"{words} is {value:g} degrees: is it in radians? Use degrees, "
                    f"np.degrees({value:g}) = {np.degrees(value):.2g}, or 0.",
                    code="out_of_range",
                )
            object.__setattr__(self, name, value)
        velocity = point_of(self.velocity, "the velocity of the hand")
        speed = float(np.linalg.norm(velocity))
        between(speed, 0.0, 20.0, "the speed of the hand", "m/s", "is it in mm/s? Use m/s.")
        object.__setattr__(self, "velocity", tuple(velocity.tolist()))

    @property
    def shift(self) -> float:
        """Standard deviation of a focus's position along one axis, without rotations [m]."""
        # This is how far the hand moves during the deviation of the pose's age.
        late = self.age * np.linalg.norm(self.velocity)
        return float(np.sqrt(self.position**2 + self.own_position**2 + late**2))
