"""Random samples drawn from an uncertainty: motions, air and transducer gains.

Motions and air properties are sampled with quasi-random numbers, transducer gains with
pseudo-random numbers. The seed determines both.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Real
from scipy.special import ndtri

from airtact.acoustics.medium import air
from airtact.acoustics.uncertainty import Uncertainty
from airtact.errors import in_short
from airtact.geometry.pose import Pose


@dataclass(frozen=True, eq=False)
class Draw:
    """One random sample of the uncertain quantities.

    Attributes
    ----------
    hand : motion of the whole hand in the obstacles' frame.
    groups : motion of each group of foci, and of the body that carries it, applied before the
        motion of the whole hand.
    skin : (F, 2) shift of each focus along its surface, in two tangential directions [m].
    slower : ratio of the wavenumber to the nominal wavenumber; below 1 in warmer air.
    """

    hand: Pose
    groups: tuple[Pose, ...]
    skin: Float64[np.ndarray, "foci 2"]
    slower: float

    __repr__ = in_short


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
    """Draw a random gain factor for every element of every sample; return None if all are 1."""
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
