"""Random motions, air and transducers of an uncertainty: quasi-random where few numbers matter, seeded everywhere."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Real
from scipy.special import ndtri

from airtact.acoustics.medium import air
from airtact.acoustics.uncertainty import Uncertainty
from airtact.geometry.pose import Pose
from airtact.printing import in_short

PER_MOTION = 6
"""Uniform numbers of a motion: three of the shift, two of the axis and one of the angle."""

OUTERMOST = 1e-9
"""Uniform numbers are kept this far from 0 and 1, where the normal distribution has no end."""

STILL = Pose.identity()


@dataclass(frozen=True, eq=False)
class Draw:
    """One sample of what is in doubt.

    Attributes
    ----------
    hand : motion of the whole hand in the obstacles' frame.
    own : motion of each group of foci, and of the body that carries it, before that of the whole
        hand.
    skin : (F, 2) shift of each focus along its surface, in two directions [m].
    boards : motion of each board in its array.
    slower : wavenumber over the nominal one.
    """

    hand: Pose
    own: tuple[Pose, ...]
    skin: Float64[np.ndarray, "foci 2"]
    boards: tuple[Pose, ...]
    slower: float

    __repr__ = in_short


def draws(
    uncertainty: Uncertainty,
    samples: int,
    seed: int,
    middle: Real[np.ndarray, "3"],
    groups: Sequence[Real[np.ndarray, "3"]],
    foci: int,
    boards: Sequence[Real[np.ndarray, "3"]],
) -> Iterator[Draw]:
    """Draw samples; the hand turns about ``middle``, groups and boards about points of their own [m].

    The numbers of the hand, the air and the foci do not depend on how foci are grouped.
    """
    motions = 1 + len(boards) + max(foci, len(groups))
    numbers = _uniform(PER_MOTION * motions + 2 * foci + 3, samples, seed)
    normal = ndtri(numbers[:, PER_MOTION * motions :])
    for sample in range(samples):
        parts = np.split(numbers[sample, : PER_MOTION * motions], motions)
        age, warmer, damper = normal[sample, :3]
        hand = _motion(parts[0], uncertainty.position, uncertainty.rotation, middle)
        along = uncertainty.age * age * np.asarray(uncertainty.velocity)
        yield Draw(
            Pose(hand.rotation, hand.translation + along),
            tuple(
                _motion(part, uncertainty.own_position, uncertainty.own_rotation, pivot)
                for part, pivot in zip(parts[1 + len(boards) :], groups, strict=False)
            ),
            uncertainty.along_skin * normal[sample, 3:].reshape(foci, 2),
            tuple(
                _motion(part, uncertainty.board_position, uncertainty.board_rotation, pivot)
                for part, pivot in zip(parts[1:], boards, strict=False)
            ),
            _slower(uncertainty.temperature * warmer, uncertainty.humidity * damper),
        )


def gains(
    uncertainty: Uncertainty, samples: int, seed: int, elements: int
) -> Complex128[np.ndarray, "samples elements"] | None:
    """Draw the factor of each element, each by itself; None where it is 1."""
    if not (uncertainty.gain or uncertainty.phase or uncertainty.dead):
        return None
    random = np.random.default_rng([seed, elements])
    size = 1.0 + uncertainty.gain * random.normal(size=(samples, elements))
    lag = np.radians(uncertainty.phase) * random.normal(size=(samples, elements))
    alive = random.random((samples, elements)) >= uncertainty.dead
    return alive * size * np.exp(1j * lag)


def _uniform(dimensions: int, samples: int, seed: int) -> Float64[np.ndarray, "samples dimensions"]:
    """Draw scrambled Sobol points (A. B. Owen, J. Complexity 14, 466 (1998)) in the open unit cube."""
    from scipy.stats import qmc

    sequence = qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(seed))
    numbers = sequence.random_base2(int(np.ceil(np.log2(samples))))[:samples]
    return np.clip(numbers, OUTERMOST, 1.0 - OUTERMOST)


def _motion(
    numbers: Real[np.ndarray, "6"], position: float, degrees: float, pivot: Real[np.ndarray, "3"]
) -> Pose:
    """Make a shift, and a turn by a normal angle about an axis of any direction through a pivot."""
    if not (position or degrees):
        return STILL
    shift = position * ndtri(numbers[:3])
    height, around = 2.0 * numbers[3] - 1.0, 2.0 * np.pi * numbers[4]
    flat = np.sqrt(1.0 - height**2)
    turn = Pose.turn(
        (flat * np.cos(around), flat * np.sin(around), height),
        np.radians(degrees * ndtri(numbers[5])),
    )
    return Pose(turn.rotation, pivot - turn.rotation @ pivot + shift)


def _slower(kelvin: float, humidity: float) -> float:
    """Wavenumber over that at 20 °C and 50 % where the air is warmer and damper by this."""
    if not (kelvin or humidity):
        return 1.0
    usual = air()
    there = air(
        celsius=float(np.clip(20.0 + kelvin, -20.0, 50.0)),
        humidity=float(np.clip(0.5 + humidity, 0.0, 1.0)),
    )
    return usual.sound_speed / there.sound_speed
