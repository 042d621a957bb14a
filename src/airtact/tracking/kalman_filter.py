"""A Kalman filter in which every coordinate keeps its velocity up to white noise of the acceleration.

All coordinates are equally noisy and equally agile, so they share one covariance (2, 2) of position and velocity, and
with it one gain.

Times are in seconds, positions (P, 3) in metres; ``noise`` is the standard deviation of each measured coordinate [m],
``agility`` the spectral density of the acceleration [m²/s³].

Source: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, *Estimation with Applications to Tracking and Navigation*, Wiley 2001:
section 6.2.2, discretised continuous white noise acceleration (equations 6.2.2-4 and 6.2.2-9); section 5.5.3, starting
from two measurements.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Real

from airtact.printing import in_short

USUAL = 0.5
"""Standard deviation of the velocity of a hand of which nothing else is known [m/s]."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Positions and velocities of points, as estimated from measurements.

    Attributes
    ----------
    time : of these positions [s].
    positions : (P, 3) [m].
    velocities : (P, 3) [m/s].
    covariance : (2, 2) of position and velocity, of every coordinate.
    seen_once : whether there was one measurement only, so that the velocity is a guess.
    """

    time: float
    positions: Float64[np.ndarray, "points 3"]
    velocities: Float64[np.ndarray, "points 3"]
    covariance: Float64[np.ndarray, "2 2"]
    seen_once: bool = False

    __repr__ = in_short

    def at(self, time: float, agility: float) -> "Motion":
        """Carry the points on at their velocities."""
        step = time - self.time
        forward, chance = transition(step), process_noise(step, agility)
        positions = self.positions + step * self.velocities
        return replace(self, time=time, positions=positions, covariance=forward @ self.covariance @ forward.T + chance)


def transition(step: float) -> Float64[np.ndarray, "2 2"]:
    """Return the matrix that advances position and velocity by a step of time [s]."""
    return np.array([[1.0, step], [0.0, 1.0]])


def process_noise(step: float, agility: float) -> Float64[np.ndarray, "2 2"]:
    """Return the covariance that random acceleration adds to position and velocity in a step of time."""
    size = abs(step)
    return agility * np.array([[size**3 / 3.0, step * size / 2.0], [step * size / 2.0, size]])


def first_seen(time: float, positions: Real[np.ndarray, "points 3"], noise: float) -> Motion:
    """Start from one measurement, with the points at rest."""
    covariance = np.diag([noise**2, USUAL**2])
    return Motion(time, np.asarray(positions, dtype=np.float64), np.zeros(positions.shape), covariance, seen_once=True)


def measured(
    motion: Motion, time: float, positions: Real[np.ndarray, "points 3"], noise: float, agility: float
) -> Motion:
    """Update the estimate with a measurement."""
    if motion.seen_once:
        return _from_two(motion, time, positions, noise, agility)
    expected = motion.at(time, agility)
    gain = expected.covariance[:, 0] / (expected.covariance[0, 0] + noise**2)
    surprise = positions - expected.positions
    keep = np.eye(2) - np.outer(gain, [1.0, 0.0])
    covariance = keep @ expected.covariance @ keep.T + noise**2 * np.outer(gain, gain)  # Joseph's form stays positive
    return Motion(time, expected.positions + gain[0] * surprise, motion.velocities + gain[1] * surprise, covariance)


def _from_two(
    motion: Motion, time: float, positions: Real[np.ndarray, "points 3"], noise: float, agility: float
) -> Motion:
    step = time - motion.time
    velocities = (positions - motion.positions) / step
    crossed = noise**2 / step
    turned = 2.0 * noise**2 / step**2 + agility * step / 3.0
    covariance = np.array([[noise**2, crossed], [crossed, turned]])
    return Motion(time, np.asarray(positions, dtype=np.float64), velocities, covariance)
