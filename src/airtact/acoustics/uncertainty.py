"""Uncertainty of the hand's position, the air and the transducers, and random samples of it.

Motions and air properties are sampled with quasi-random numbers, transducer gains with
pseudo-random numbers. The seed determines both.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Complex128, Float64, Real
from scipy.special import ndtri

from airtact.acoustics.medium import air
from airtact.errors import NOT_METRES, InvalidInput, Vector, between, one_line, point_of
from airtact.geometry.pose import Pose

# Angles above zero and below this are probably in radians [degree].
SMALLEST_ANGLE = 0.1

# Largest value of each deviation, its unit, and the hint in the error for a larger value.
_LIMITS = {
    "position": (0.1, "m", NOT_METRES),
    "rotation": (90.0, "degrees", "hands are located more accurately."),
    "own_position": (0.1, "m", NOT_METRES),
    "own_rotation": (90.0, "degrees", "hands are located more accurately."),
    "along_skin": (0.1, "m", NOT_METRES),
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

    ``ensemble`` draws random samples with these deviations, and ``robust`` computes a drive for the
    samples. All attributes are standard deviations of normally distributed errors with mean 0,
    except ``velocity`` and ``dead``, and are 0 by default.

    Attributes
    ----------
    position : standard deviation of the hand's position along each of x, y and z [m], up to 0.1.
    rotation : standard deviation of the angle by which the hand rotates about a random axis through
        the middle of the foci [degree], up to 90.
    own_position, own_rotation : standard deviations of an additional, independent shift along each
        axis [m] and rotation [degree] of each body. A body rotates about the middle of its foci. A
        single body is treated as a hand in which each focus is on a separate bone that moves
        independently.
    along_skin : standard deviation of the position of each focus on its body, in each of two
        directions along the surface [m], up to 0.1.
    age : standard deviation of the time between the measurement of the pose and the emission [s],
        up to 1. The older the pose, the farther the hand is shifted along ``velocity``.
    velocity : (3,) velocity of the hand in the obstacles' frame [m/s], up to 20 in magnitude. It
        only matters together with ``age``.
    temperature : standard deviation of the air's temperature [K], up to 10.
    humidity : standard deviation of the air's relative humidity, which is a fraction from 0 to 1;
        up to 0.5.
    gain : standard deviation of each element's amplitude, as a fraction of its nominal amplitude;
        up to 0.5.
    phase : standard deviation of each element's phase [degree], up to 90.
    dead : probability that an element emits nothing, independent for each element; up to 0.9.

    Raises
    ------
    InvalidInput
        If a value is not a finite number, is negative or exceeds its limit, or if an angle is
        between 0 and 0.1 degrees and therefore probably in radians.

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
                    f"{words} is {value:g} degrees, which is too small: is it in radians? Use "
                    f"degrees (np.degrees({value:g}) = {np.degrees(value):.2g}), or 0 for no "
                    "uncertainty.",
                    code="out_of_range",
                )
            object.__setattr__(self, name, value)
        velocity = point_of(self.velocity, "the velocity of the hand")
        speed = float(np.linalg.norm(velocity))
        between(speed, 0.0, 20.0, "the speed of the hand", "m/s", "is it in mm/s? Use m/s.")
        object.__setattr__(self, "velocity", tuple(velocity.tolist()))

    @property
    def shift(self) -> float:
        """Standard deviation of a focus's position along one axis, ignoring rotations [m]."""
        # This is how far the hand moves during the deviation of the pose's age.
        late = self.age * np.linalg.norm(self.velocity)
        return float(np.sqrt(self.position**2 + self.own_position**2 + late**2))


@dataclass(frozen=True, eq=False)
class Draw:
    """One random sample of the uncertain quantities.

    Attributes
    ----------
    hand : motion of the whole hand in the obstacles' frame.
    groups : motion of each group of foci, and of the body that carries it, applied before the
        motion of the whole hand.
    skin : (F, 2) shift of each focus along the surface, in two tangential directions [m].
    slower : ratio of the wavenumber to the nominal wavenumber; below 1 in warmer air.
    """

    hand: Pose
    groups: tuple[Pose, ...]
    skin: Float64[np.ndarray, "foci 2"]
    slower: float


def draws(
    uncertainty: Uncertainty,
    samples: int,
    seed: int,
    middle: Real[np.ndarray, "3"],
    groups: Sequence[Real[np.ndarray, "3"]],
    foci: int,
) -> Iterator[Draw]:
    """Yield random samples of the uncertain quantities, one ``Draw`` at a time.

    The hand rotates about ``middle`` [m], and each group of foci about its pivot in ``groups`` [m].
    The random numbers for the hand, the air and the foci do not depend on how the foci are grouped.
    """
    from scipy.stats import qmc

    motions = 1 + max(foci, len(groups))
    # Each motion uses six numbers: three for the shift, two for the axis and one for the angle.
    count = 6 * motions + 3 + 2 * foci
    # Scrambled Sobol points (A. B. Owen, J. Complexity 14, 466 (1998)), a power of 2 of them.
    sequence = qmc.Sobol(count, scramble=True, rng=np.random.default_rng(seed))
    numbers = sequence.random_base2(int(np.ceil(np.log2(samples))))[:samples]
    # The normal quantile is infinite at 0 and 1.
    numbers = np.clip(numbers, 1e-9, 1.0 - 1e-9)
    normal = ndtri(numbers[:, 6 * motions :])
    for sample in range(samples):
        hand, *parts = np.split(numbers[sample, : 6 * motions], motions)
        age, warmer, damper = normal[sample, :3]
        # If a frame is older than expected, the hand has moved farther along its velocity.
        pose = _motion(hand, uncertainty.position, uncertainty.rotation, middle)
        drift = uncertainty.age * age * np.asarray(uncertainty.velocity)
        yield Draw(
            hand=Pose(pose.rotation, pose.translation + drift),
            groups=tuple(
                _motion(part, uncertainty.own_position, uncertainty.own_rotation, pivot)
                for part, pivot in zip(parts, groups, strict=False)
            ),
            skin=uncertainty.along_skin * normal[sample, 3:].reshape(foci, 2),
            slower=_slower(uncertainty.temperature * warmer, uncertainty.humidity * damper),
        )


def gains(
    uncertainty: Uncertainty, samples: int, seed: int, elements: int
) -> Complex128[np.ndarray, "samples elements"] | None:
    """Draw a random gain for every element of every sample, or return None if all are 1."""
    if not (uncertainty.gain or uncertainty.phase or uncertainty.dead):
        return None
    # Quasi-random points lose their advantage in hundreds of dimensions.
    random = np.random.default_rng([seed, elements])
    size = 1.0 + uncertainty.gain * random.normal(size=(samples, elements))
    lag = np.radians(uncertainty.phase) * random.normal(size=(samples, elements))
    alive = random.random((samples, elements)) >= uncertainty.dead
    return alive * size * np.exp(1j * lag)


def _motion(
    numbers: Real[np.ndarray, "6"], position: float, degrees: float, pivot: Real[np.ndarray, "3"]
) -> Pose:
    """Return a normally distributed shift and rotation about a pivot."""
    if not (position or degrees):
        return Pose.identity()
    shift = position * ndtri(numbers[:3])
    # An axis is uniform on the sphere if its height and azimuth are uniform (Archimedes).
    height = 2.0 * numbers[3] - 1.0
    around = 2.0 * np.pi * numbers[4]
    flat = np.sqrt(1.0 - height**2)
    turn = Pose.turn(
        (flat * np.cos(around), flat * np.sin(around), height),
        np.radians(degrees * ndtri(numbers[5])),
    )
    return Pose(turn.rotation, pivot - turn.rotation @ pivot + shift)


def _slower(kelvin: float, humidity: float) -> float:
    """Return the ratio of the wavenumber in warmer, more humid air to that at 20 °C and 50 %."""
    if not (kelvin or humidity):
        return 1.0
    # ``air`` is valid from −20 to 50 °C, so the rare draws outside this range are clipped.
    warmer = air(
        celsius=float(np.clip(20.0 + kelvin, -20.0, 50.0)),
        humidity=float(np.clip(0.5 + humidity, 0.0, 1.0)),
    )
    return air().sound_speed / warmer.sound_speed
