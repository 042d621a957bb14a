"""Prediction of a hand at the time when the sound arrives, with noise reduction.

The motion model is a constant velocity with white noise of the acceleration. One Kalman filter
estimates the centroid of all landmarks, and a slower one the landmarks relative to it, because
reaching is faster than bending fingers. All coordinates of a filter have the same noise and
agility, so they share one covariance (2, 2) of position and velocity.

Times are in seconds, positions (P, 3) in metres; ``noise`` is the standard deviation of each
measured coordinate [m], ``agility`` the spectral density of the acceleration [m²/s³].

Source: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, *Estimation with Applications to Tracking and
Navigation*, Wiley 2001: section 6.2.2, discretised continuous white noise acceleration (equations
6.2.2-4 and 6.2.2-9); section 5.5.3, starting from two measurements.
"""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Real

from airtact.acoustics.uncertainty import SMALLEST_ANGLE, Uncertainty
from airtact.errors import InvalidInput, number, positive
from airtact.hands.joints import Points
from airtact.hands.tracking.frame import FaultyFrame, HandFrame

# Default spectral density of the acceleration of a landmark [m²/s³]. It is nearly optimal for
# reaching and pinching at 0.5 m/s, at 30 to 90 frames a second and noise of 0.5 to 3 mm
# (``benchmarks/hand_tracking.py``).
AGILITY = 0.3

# Ratio of the agility of landmarks about their centroid to that of the centroid. Compared with one
# filter, 1 mm of noise causes 0.6 of the error between the foci (motions of
# ``benchmarks/live.py``); without noise the error is 0.02 mm larger.
BENDING = 0.05

# Share of the variance of the noise that is common to all landmarks.
COMMON = 0.5


# --- Kalman filter ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Motion:
    """Estimated positions and velocities of points.

    Attributes
    ----------
    time : time of the positions [s].
    positions : (P, 3) [m].
    velocities : (P, 3) [m/s].
    covariance : (2, 2) covariance of position and velocity of every coordinate.
    seen_once : whether there was only one measurement, so that the velocity is unknown.
    """

    time: float
    positions: Points
    velocities: Points
    covariance: Float64[np.ndarray, "2 2"]
    seen_once: bool = False

    def at(self, time: float, agility: float) -> "Motion":
        """Extrapolate the points at their velocities."""
        step = time - self.time
        forward = transition(step)
        return replace(
            self,
            time=time,
            positions=self.positions + step * self.velocities,
            covariance=forward @ self.covariance @ forward.T + process_noise(step, agility),
        )


def transition(step: float) -> Float64[np.ndarray, "2 2"]:
    """Return the matrix that advances position and velocity by a step of time [s]."""
    return np.array([[1.0, step], [0.0, 1.0]])


def process_noise(step: float, agility: float) -> Float64[np.ndarray, "2 2"]:
    """Return the covariance that random acceleration adds in a step [s]."""
    size = abs(step)
    return agility * np.array([[size**3 / 3.0, step * size / 2.0], [step * size / 2.0, size]])


def first_seen(time: float, positions: Real[np.ndarray, "points 3"], noise: float) -> Motion:
    """Start from one measurement, with the points at rest."""
    positions = np.asarray(positions, dtype=np.float64)
    # 0.5 m/s is the standard deviation of the velocity of a hand
    covariance = np.diag([noise**2, 0.5**2])
    return Motion(time, positions, np.zeros(positions.shape), covariance, seen_once=True)


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
        # No hand is faster than 3 m/s, but jitter can make the step very short.
        velocities = np.clip((positions - motion.positions) / step, -3.0, 3.0)
        mixed = noise**2 / step
        of_velocity = 2.0 * noise**2 / step**2 + agility * step / 3.0
        covariance = np.array([[noise**2, mixed], [mixed, of_velocity]])
        return Motion(time, np.asarray(positions, dtype=np.float64), velocities, covariance)
    expected = motion.at(time, agility)
    gain = expected.covariance[:, 0] / (expected.covariance[0, 0] + noise**2)
    surprise = positions - expected.positions
    keep = np.eye(2) - np.outer(gain, [1.0, 0.0])
    # Joseph's form stays positive definite
    covariance = keep @ expected.covariance @ keep.T + noise**2 * np.outer(gain, gain)
    return Motion(
        time,
        expected.positions + gain[0] * surprise,
        motion.velocities + gain[1] * surprise,
        covariance,
    )


class NoiseEstimate:
    """Estimates the white noise of a tracker from its frames.

    The third difference of four positions at even time steps is insensitive to the motion of a
    hand: at 60 frames/s, a finger that oscillates by 20 mm at 1 Hz contributes 0.02 mm. White noise
    contributes sqrt(1 + 9 + 9 + 1) times its standard deviation. The median over all coordinates
    excludes landmarks that jump. The noise of a tracker that smooths is underestimated.

    Attributes
    ----------
    noise : standard deviation of each coordinate [m]; 1 mm before the fourth frame.
    """

    def __init__(self) -> None:
        self._last: deque[tuple[float, Float64[np.ndarray, "landmarks 3"]]] = deque(maxlen=4)
        self._count = 0
        self.noise: float = 1e-3

    def take(self, time: float, landmarks: Float64[np.ndarray, "landmarks 3"]) -> None:
        """Update the estimate with the landmarks of the next frame [m]."""
        if self._last and len(landmarks) != len(self._last[-1][1]):
            self._last.clear()
        self._last.append((time, landmarks))
        steps = np.diff([taken for taken, _ in self._last])
        if len(self._last) < 4 or steps.max() > 1.3 * steps.min():
            return
        first, second, third, fourth = (positions for _, positions in self._last)
        difference = fourth - 3.0 * third + 3.0 * second - first
        # 1.4826: standard deviation of normal numbers divided by their median magnitude
        deviation = 1.4826 * float(np.median(np.abs(difference))) / np.sqrt(20.0)
        self._count += 1
        share = max(1.0 / self._count, 0.05)
        self.noise = float(np.clip(self.noise + share * (deviation - self.noise), 1e-4, 5e-3))


# --- prediction -------------------------------------------------------------------------------


class Predictor:
    """Prediction of the landmarks of one hand by a Kalman filter of constant velocity.

    Parameters
    ----------
    latency : time from a frame to the arrival of the sound computed from it [s].
    noise : standard deviation of each coordinate of the tracker's landmarks [m], or None to
        estimate it from the frames.
    agility : spectral density of the acceleration of landmarks [m²/s³].
    patience : time without frames after which the hand counts as lost and the filter restarts [s].

    Raises
    ------
    InvalidInput
        If the latency is not from 0 to 1 s, or another number is not above zero.
    """

    def __init__(
        self,
        latency: float,
        noise: float | None = 1e-3,
        agility: float = AGILITY,
        patience: float = 0.15,
    ) -> None:
        self.latency: float = number(latency, "latency", "s")
        if not 0.0 <= self.latency <= 1.0:
            raise InvalidInput(
                f"latency is {self.latency:g} s, but it must be 0 to 1 s: is it in milliseconds?",
                code="out_of_range",
            )
        self._given_noise = None if noise is None else positive(noise, "noise", "m")
        self._estimate = NoiseEstimate()
        self._agility = positive(agility, "agility", "m²/s³")
        self._patience = positive(patience, "patience", "s")
        # Newest frame, motion of the landmarks' centroid, and motion of the landmarks about it.
        self._newest: tuple[HandFrame, Motion, Motion] | None = None

    def take(self, frame: HandFrame) -> None:
        """Update the estimate with the next frame of the hand; a lost one is ignored.

        Parameters
        ----------
        frame : frame of the tracker.

        Raises
        ------
        InvalidInput
            If the frame shows the other hand, or is not later than the previous frame. A
            ``HandStream`` does not return such frames.
        """
        if self._newest is not None:
            newest = self._newest[0]
            if frame.side != newest.side:
                raise InvalidInput(
                    f"frame {frame.sequence} shows the {frame.side} hand; use a second predictor "
                    "for that hand.",
                    code="does_not_match",
                )
            if frame.time <= newest.time:
                raise InvalidInput(
                    f"frame {frame.sequence} at {frame.time:g} s is not later than the last one "
                    f"at {newest.time:g} s; omit it.",
                    code="out_of_range",
                )
        if frame.landmarks is None:
            return
        self._estimate.take(frame.time, frame.landmarks)
        middle = frame.landmarks.mean(axis=0, keepdims=True)
        about = frame.landmarks - middle
        middle_noise = self.noise * np.sqrt(COMMON)
        about_noise = self.noise * np.sqrt(1.0 - COMMON)
        reach = bend = None
        if self._newest is not None:
            _, reach, bend = self._newest
        if (
            reach is None
            or bend is None
            or frame.time - reach.time > self._patience
            or len(bend.positions) != len(about)
        ):
            reach = first_seen(frame.time, middle, middle_noise)
            bend = first_seen(frame.time, about, about_noise)
        else:
            reach = measured(reach, frame.time, middle, middle_noise, self._agility)
            bend = measured(bend, frame.time, about, about_noise, BENDING * self._agility)
        self._newest = (frame, reach, bend)

    @property
    def noise(self) -> float:
        """Standard deviation of each coordinate, given or estimated from the frames [m]."""
        return self._estimate.noise if self._given_noise is None else self._given_noise

    def at(self, time: float) -> HandFrame:
        """Predict the hand at ``latency`` after a time.

        Parameters
        ----------
        time : time of the tracker's clock, not before the newest frame [s].

        Returns
        -------
        The frame at that time, with the number of the newest frame; a lost frame if the hand has
        not been seen for longer than the patience. If the predicted landmarks are not a plausible
        hand, the newest landmarks are moved with their centroid.

        Raises
        ------
        InvalidInput
            If no frame with landmarks was taken yet.
        """
        frame, reach, _ = self._state()
        then = number(time, "time", "s") + self.latency
        if time - reach.time > self._patience:
            return HandFrame(then, frame.side, frame.sequence)
        reach_then, bend_then = self._carried(then)
        try:
            joints = reach_then.positions + bend_then.positions
            return HandFrame(then, frame.side, frame.sequence, joints)
        except FaultyFrame:
            joints = frame.landmarks + reach_then.positions - reach.positions
            return HandFrame(then, frame.side, frame.sequence, joints)

    def spread(self, time: float) -> float:
        """Return the standard deviation of each coordinate [m] at ``latency`` after a time [s]."""
        reach, bend = self._carried(time + self.latency)
        return float(np.sqrt(reach.covariance[0, 0] + bend.covariance[0, 0]))

    def velocities(self) -> Float64[np.ndarray, "landmarks 3"]:
        """Return the velocities of the landmarks at the time of the newest frame [m/s]."""
        _, reach, bend = self._state()
        return reach.velocities + bend.velocities

    def uncertainty(self, time: float) -> Uncertainty:
        """Return the uncertainty of the hand at ``latency`` after a time [s]; errors as for ``at``.

        The position is ``spread``, limited to 0.1 m. The rotation moves the landmarks by the same
        distance (root mean square about their centroid).
        """
        _, _, bend = self._state()
        off = min(self.spread(time), 0.1)
        lever = float(np.sqrt(np.mean(np.sum(bend.positions**2, axis=1))))
        degrees = float(np.degrees(off / lever)) if lever > 0.0 else 0.0
        if degrees < SMALLEST_ANGLE:
            degrees = 0.0
        return Uncertainty(position=off, rotation=min(degrees, 90.0))

    def _carried(self, then: float) -> tuple[Motion, Motion]:
        _, reach, bend = self._state()
        return reach.at(then, self._agility), bend.at(then, BENDING * self._agility)

    def _state(self) -> tuple[HandFrame, Motion, Motion]:
        if self._newest is None:
            raise InvalidInput(
                "no frame with landmarks was taken yet; call take() before a prediction.",
                code="empty",
            )
        return self._newest
