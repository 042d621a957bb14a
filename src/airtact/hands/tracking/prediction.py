"""Where a hand will be when the sound arrives: noise smoothed, latency made up for.

A Kalman filter keeps the velocity of every coordinate up to white noise of the acceleration. There
are two: one of the middle of all landmarks, and a slower one of where they are about it, since a
hand reaches farther than its fingers bend. All coordinates of a filter are equally noisy and agile,
so they share one covariance (2, 2) of position and velocity.

Times are in seconds, positions (P, 3) in metres; ``noise`` is the standard deviation of each
measured coordinate [m], ``agility`` the spectral density of the acceleration [m²/s³].

Source: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, *Estimation with Applications to Tracking and
Navigation*, Wiley 2001: section 6.2.2, discretised continuous white noise acceleration (equations
6.2.2-4 and 6.2.2-9); section 5.5.3, starting from two measurements.
"""

from collections import deque
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Real

from airtact.acoustics.uncertainty import SMALLEST_ANGLE, Uncertainty
from airtact.checks import number, positive
from airtact.errors import InvalidInput
from airtact.hands.joints import CHAINS
from airtact.hands.tracking.frame import FaultyFrame, HandFrame

NOISE = 1e-3
"""Standard deviation of each coordinate of a landmark unless given [m]."""

AGILITY = 0.3
"""Spectral density of the acceleration of a landmark unless given [m²/s³]: best or nearly for reaching and pinching at
0.5 m/s, at 30 to 90 frames a second and noise of 0.5 to 3 mm (``benchmarks/hand_tracking.py``)."""

BENDING = 0.05
"""Agility of landmarks about their middle over that of the middle: the error that 1 mm of noise leaves between the foci
is 0.6 of that with one filter (motions of ``benchmarks/live.py``), and 0.02 mm larger without
noise."""

COMMON = 0.5
"""Share of the variance of the noise that is taken as common to all landmarks: cameras err by the whole hand too."""

QUIETEST, LOUDEST = 1e-4, 5e-3
"""Least and largest noise that is found from frames [m]."""

UNEVEN, LEARNED = 1.3, 0.05
"""Steps of time that count as even differ by less than this factor; weight of the newest frames in the noise."""

TRACKED_CHAINS = tuple(tuple(range(start, start + 4)) for start in (1, 5, 9, 13, 17))
"""Landmarks of each finger, from the wrist to the tip, where there are 21."""

MOST_IN_DOUBT = 0.1
"""Largest deviation of a position that an uncertainty takes [m]."""

LONGEST_LATENCY = 1.0
"""Longest latency over which a prediction makes sense [s]."""


# --- Kalman filter --------------------------------------------------------------------------------------------------

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

    def at(self, time: float, agility: float) -> "Motion":
        """Carry the points on at their velocities."""
        step = time - self.time
        forward, chance = transition(step), process_noise(step, agility)
        positions = self.positions + step * self.velocities
        return replace(
            self,
            time=time,
            positions=positions,
            covariance=forward @ self.covariance @ forward.T + chance,
        )


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
    return Motion(
        time,
        np.asarray(positions, dtype=np.float64),
        np.zeros(positions.shape),
        covariance,
        seen_once=True,
    )


def measured(
    motion: Motion,
    time: float,
    positions: Real[np.ndarray, "points 3"],
    noise: float,
    agility: float,
) -> Motion:
    """Update the estimate with a measurement."""
    if motion.seen_once:
        step = time - motion.time
        velocities, crossed = (positions - motion.positions) / step, noise**2 / step
        turned = 2.0 * noise**2 / step**2 + agility * step / 3.0
        covariance = np.array([[noise**2, crossed], [crossed, turned]])
        return Motion(time, np.asarray(positions, dtype=np.float64), velocities, covariance)
    expected = motion.at(time, agility)
    gain = expected.covariance[:, 0] / (expected.covariance[0, 0] + noise**2)
    surprise = positions - expected.positions
    keep = np.eye(2) - np.outer(gain, [1.0, 0.0])
    covariance = keep @ expected.covariance @ keep.T + noise**2 * np.outer(
        gain, gain
    )  # Joseph's form stays positive
    return Motion(
        time,
        expected.positions + gain[0] * surprise,
        motion.velocities + gain[1] * surprise,
        covariance,
    )


class NoiseFromFrames:
    """Finds the noise of a tracker from its frames: white noise, as a tracker that smooths hides its own.

    The third difference of four positions at even steps of time hardly knows the motion of a hand:
    at 60 frames a second a finger that waves by 20 mm once a second leaves 0.02 mm, and white noise
    sqrt(1 + 9 + 9 + 1) times its standard deviation. The median over all coordinates leaves out
    landmarks that jump.

    Attributes
    ----------
    noise : standard deviation of each coordinate [m]; ``NOISE`` before four frames.
    """

    def __init__(self) -> None:
        self._last: deque[tuple[float, Float64[np.ndarray, "landmarks 3"]]] = deque(maxlen=4)
        self._count = 0
        self.noise: float = NOISE

    def take(self, time: float, landmarks: Float64[np.ndarray, "landmarks 3"]) -> None:
        """Take the landmarks of the next frame [m]."""
        if self._last and len(landmarks) != len(self._last[-1][1]):
            self._last.clear()
        self._last.append((time, landmarks))
        if len(self._last) < 4:
            return
        times, places = zip(*self._last, strict=True)
        steps = np.diff(times)
        if steps.max() > UNEVEN * steps.min():
            return
        third = places[3] - 3.0 * places[2] + 3.0 * places[1] - places[0]
        size = (
            1.4826 * float(np.median(np.abs(third))) / np.sqrt(20.0)
        )  # the median magnitude of normal numbers
        self._count += 1
        found = self.noise + max(1.0 / self._count, LEARNED) * (size - self.noise)
        self.noise = float(np.clip(found, QUIETEST, LOUDEST))


# --- prediction -----------------------------------------------------------------------------------------------------


class Predictor:
    """Predicts where the landmarks of one hand will be, by a Kalman filter of constant velocity.

    Parameters
    ----------
    latency : from the time of a frame to the moment at which the sound computed from it is in the
        air [s].
    noise : standard deviation of each coordinate of the tracker's landmarks [m], or None to find it
        from the frames.
    agility : how suddenly landmarks change their velocity, as spectral density of the acceleration
        [m²/s³].
    patience : a hand that was not seen for longer is lost, and begins anew when it is back [s].

    Raises
    ------
    InvalidInput
        If the latency is not from 0 to 1 s, or another number is not above zero.
    """

    def __init__(
        self,
        latency: float,
        noise: float | None = NOISE,
        agility: float = AGILITY,
        patience: float = 0.15,
    ) -> None:
        self.latency: float = number(latency, "latency", "s")
        if not 0.0 <= self.latency <= LONGEST_LATENCY:
            raise InvalidInput(
                f"latency is {self.latency:g} s, but it must be 0 to 1 s: is it in milliseconds?",
                code="out_of_range",
            )
        self._given = None if noise is None else positive(noise, "noise", "m")
        self._found = NoiseFromFrames()
        self._agility = positive(agility, "agility", "m²/s³")
        self._patience = positive(patience, "patience", "s")
        self._seen: tuple[HandFrame, Motion, Motion] | None = (
            None  # of the middle, of the landmarks about it
        )

    def take(self, frame: HandFrame) -> None:
        """Take the next frame of the hand; one that is lost changes nothing.

        Parameters
        ----------
        frame : as the tracker gave it.

        Raises
        ------
        InvalidInput
            When it is of the other hand, or not later than the one before; a ``HandStream`` gives no such frames.
        """
        last, whole, bent = self._seen or (frame, None, None)
        if frame.side != last.side:
            sentence = f"frame {frame.sequence} is of the {frame.side} hand; make a second predictor for it."
            raise InvalidInput(sentence, code="does_not_match")
        if whole is not None and frame.time <= last.time:
            sentence = f"time goes back from {last.time:g} to {frame.time:g} s at frame {frame.sequence}; leave it out."
            raise InvalidInput(sentence, code="out_of_range")
        if frame.landmarks is None:
            return
        middle = frame.landmarks.mean(axis=0, keepdims=True)
        about = frame.landmarks - middle
        self._found.take(frame.time, frame.landmarks)
        noises = self.noise * np.sqrt([COMMON, 1.0 - COMMON])
        if (
            whole is None
            or bent is None
            or frame.time - whole.time > self._patience
            or len(bent.positions) != len(about)
        ):
            whole, bent = (
                first_seen(frame.time, middle, noises[0]),
                first_seen(frame.time, about, noises[1]),
            )
        else:
            whole = measured(whole, frame.time, middle, noises[0], self._agility)
            bent = measured(bent, frame.time, about, noises[1], BENDING * self._agility)
        self._seen = frame, whole, bent

    @property
    def noise(self) -> float:
        """Standard deviation of each coordinate of the landmarks, as given or as found from the frames [m]."""
        return self._found.noise if self._given is None else self._given

    def at(self, time: float) -> HandFrame:
        """Predict the hand a latency after a time.

        Parameters
        ----------
        time : of the tracker's clock, the newest frame's or later [s].

        Returns
        -------
        The frame of that later time, with the newest one's number; a lost one where the hand was not seen for longer
        than the patience. Where the predicted landmarks are no possible hand, bones keep their lengths; where that is
        impossible too, the newest landmarks are returned.

        Raises
        ------
        InvalidInput
            When no frame was taken yet.
        """
        last, whole, bent = self._newest()
        then = number(time, "time", "s") + self.latency
        if time - whole.time > self._patience:
            return HandFrame(then, last.side, last.sequence)
        whole_then, bent_then = self._carried(then)
        carried = whole_then.positions + bent_then.positions
        for landmarks in (
            lambda: carried,
            lambda: _with_lengths(carried, whole.positions + bent.positions),
        ):
            try:
                return HandFrame(then, last.side, last.sequence, landmarks())
            except FaultyFrame:
                continue
        return HandFrame(then, last.side, last.sequence, last.landmarks)

    def spread(self, time: float) -> float:
        """Return the standard deviation of each coordinate [m] a latency after a time [s]; raises as ``at``."""
        return float(
            np.sqrt(sum(one.covariance[0, 0] for one in self._carried(time + self.latency)))
        )

    def velocities(self) -> Float64[np.ndarray, "landmarks 3"]:
        """Return the velocities of the landmarks at the time of the newest frame [m/s]; raises as ``at``."""
        _, whole, bent = self._newest()
        return whole.velocities + bent.velocities

    def uncertainty(self, time: float) -> Uncertainty:
        """Return what is in doubt about the hand a latency after a time [s]; raises as ``at``.

        The position is that of ``spread``, at most 0.1 m, and the rotation is the turn that moves
        the landmarks as far (root mean square about their middle).
        """
        off, about = min(self.spread(time), MOST_IN_DOUBT), self._newest()[2].positions
        lever = float(np.sqrt(np.mean(np.sum(about**2, axis=1))))
        degrees = float(np.degrees(off / lever)) if lever > 0.0 else 0.0
        return Uncertainty(
            position=off, rotation=min(degrees, 90.0) if degrees >= SMALLEST_ANGLE else 0.0
        )

    def _carried(self, then: float) -> tuple[Motion, Motion]:
        _, whole, bent = self._newest()
        return whole.at(then, self._agility), bent.at(then, BENDING * self._agility)

    def _newest(self) -> tuple[HandFrame, Motion, Motion]:
        if self._seen is None:
            raise InvalidInput(
                "0 frames with landmarks were taken; take one before a prediction.",
                code="empty",
            )
        return self._seen


def _with_lengths(
    carried: Float64[np.ndarray, "landmarks 3"], now: Float64[np.ndarray, "landmarks 3"]
) -> Float64[np.ndarray, "landmarks 3"]:
    """Give bones that were carried on the lengths that they have now, from the wrist outwards."""
    kept = carried.copy()
    for chain in CHAINS if len(now) == 25 else TRACKED_CHAINS:
        for one, other in pairwise((0, *chain)):
            bone = carried[other] - carried[one]
            size = float(np.linalg.norm(bone))
            if size > 0.0:
                kept[other] = kept[one] + float(np.linalg.norm(now[other] - now[one])) / size * bone
    return kept
