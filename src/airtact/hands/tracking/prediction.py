"""Prediction of a hand at the time when the sound arrives, and reduction of tracker noise.

The filter is ``ArticulatedHand``. The noise of the tracker is estimated from its frames.
"""

from collections import deque
from copy import deepcopy

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.uncertainty import SMALLEST_ANGLE, Uncertainty
from airtact.errors import InvalidInput, number, positive
from airtact.hands.joints import TRACKED, Points, joints_of
from airtact.hands.tracking.articulated import ArticulatedHand
from airtact.hands.tracking.frame import HandFrame

# Default standard deviation of the acceleration of the palm [m/s²]. It is nearly optimal for
# reaching at 0.5 m/s, pinching and waving fingers, at 30 and 60 frames per second and noise of 1 mm
# (``benchmarks/hand_tracking.py``).
AGILITY = 0.5


class NoiseEstimate:
    """Estimate of the white noise of a tracker from its frames; pass their landmarks to ``take``.

    The third difference of four positions, evenly spaced in time, hardly depends on the motion of a
    hand. At 60 frames/s, a finger that oscillates by 20 mm at 1 Hz contributes only 0.02 mm to this
    difference. White noise contributes sqrt(1 + 9 + 9 + 1) times its standard deviation. Medians
    are used, so landmarks that jump have no effect. For a tracker that smooths its data, the noise
    is underestimated.

    Attributes
    ----------
    noise : standard deviation of each coordinate [m]; 1 mm before the fourth frame.
    common : standard deviation of the error common to all landmarks [m].
    """

    def __init__(self) -> None:
        self._last: deque[tuple[float, Points]] = deque(maxlen=4)
        self._count = 0
        self.noise: float = 1e-3
        self.common: float = 0.0

    def take(self, time: float, landmarks: Points) -> None:
        """Update the estimate with the landmarks of the next frame [m]."""
        if self._last and len(landmarks) != len(self._last[-1][1]):
            self._last.clear()
        self._last.append((time, landmarks))
        steps = np.diff([taken for taken, _ in self._last])
        if len(self._last) < 4 or steps.max() > 1.3 * steps.min():
            return
        first, second, third, fourth = (positions for _, positions in self._last)
        differences = (fourth - 3.0 * third + 3.0 * second - first) / np.sqrt(20.0)
        # 1.4826 is the ratio of a normal standard deviation to the median magnitude.
        deviation = 1.4826 * float(np.median(np.abs(differences)))
        shared = float(np.sqrt(np.mean(differences.mean(axis=0) ** 2)))
        self._count += 1
        share = max(1.0 / self._count, 0.05)
        self.noise = float(np.clip(self.noise + share * (deviation - self.noise), 1e-4, 5e-3))
        self.common += share * (shared - self.common)


class Predictor:
    """Prediction of the landmarks of one hand by a Kalman filter of an articulated hand.

    The filter also reduces the noise of the tracker. Call ``take`` with each frame, then ``at``
    with the time of that frame (or a later time on the tracker's clock). ``at`` returns the
    ``HandFrame`` expected ``latency`` after that time. Use a separate predictor for each hand.

    Parameters
    ----------
    latency : time from a frame to the arrival of the sound computed from it [s], 0 to 1.
    noise : standard deviation of each coordinate of the tracker's landmarks [m], above 0, or None
        to estimate it from the frames.
    agility : standard deviation of the palm's acceleration [m/s²], above 0; 0.5 by default. Larger
        values follow fast motions better and smooth less. The standard deviations of the joints'
        accelerations are proportional to it. The filter increases all of them while the hand
        accelerates more strongly than they allow for.
    patience : time without frames after which the hand is treated as lost and the filter restarts
        with the next frame [s], above 0.

    Raises
    ------
    InvalidInput
        If a parameter is outside its range.
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
                f"latency is {self.latency:g} s, but it must be between 0 and 1 s: is it in "
                "milliseconds?",
                code="out_of_range",
            )
        self._given_noise = None if noise is None else positive(noise, "noise", "m")
        self._estimate = NoiseEstimate()
        self._agility = positive(agility, "agility", "m/s²")
        self._patience = positive(patience, "patience", "s")
        # Latest frame with landmarks, these landmarks, and the hand estimated at its time.
        self._newest: tuple[HandFrame, Points, ArticulatedHand] | None = None
        # Mean square distance of a coordinate of the last landmarks from the estimate [m²].
        self._misfit = 0.0

    def take(self, frame: HandFrame) -> None:
        """Update the estimate with the next frame of the hand; lost frames are ignored.

        Parameters
        ----------
        frame : next frame from the tracker.

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
                    f"at {newest.time:g} s; omit this frame.",
                    code="out_of_range",
                )
        if frame.landmarks is None:
            return
        landmarks = np.asarray(frame.landmarks, dtype=np.float64)
        self._estimate.take(frame.time, landmarks)
        seen = TRACKED if len(landmarks) == 21 else np.arange(25)
        # The mean of independent errors is not a common error.
        common = 0.0
        if self._given_noise is None:
            common = np.sqrt(max(self._estimate.common**2 - self.noise**2 / len(seen), 0.0))
        independent = max(np.sqrt(max(self.noise**2 - common**2, 0.0)), 0.3 * self.noise)
        if self._newest is not None:
            _, _, hand = self._newest
            if frame.time - hand.time <= self._patience:
                hand.advance(frame.time)
                hand.update(landmarks, seen, independent, common, self._agility)
                # Bones that do not fit for some frames belong to another hand. A shift of the whole
                # hand does not count, because a wrong time causes one.
                misfit = float(np.mean((hand.joints[seen] - landmarks).var(axis=0)))
                self._misfit += 0.2 * (misfit - self._misfit)
                if self._misfit < (2e-3 + 3.0 * self.noise) ** 2:
                    self._newest = (frame, landmarks, hand)
                    return
        self._misfit = 0.0
        hand = ArticulatedHand(
            frame.time, joints_of(landmarks), frame.side, self.noise, self._agility
        )
        self._newest = (frame, landmarks, hand)

    @property
    def noise(self) -> float:
        """Standard deviation of each coordinate [m], either set or estimated from the frames."""
        return self._estimate.noise if self._given_noise is None else self._given_noise

    def at(self, time: float) -> HandFrame:
        """Predict the hand at a time ``latency`` after ``time``.

        Parameters
        ----------
        time : time on the tracker's clock [s]. Any time before the latest frame is replaced by the
            time of that frame.

        Returns
        -------
        The predicted frame, which has the number of the latest frame. It marks the hand as lost if
        the hand has not been seen for longer than ``patience``.

        Raises
        ------
        InvalidInput
            If no frame with landmarks has been processed yet, or if the bones are impossible.
        """
        frame, newest, hand = self._state()
        then = max(number(time, "time", "s"), hand.time) + self.latency
        if time - hand.time > self._patience:
            return HandFrame(then, frame.side, frame.sequence)
        joints = hand.joints_at(then)
        landmarks = joints[TRACKED] if len(newest) == 21 else joints
        return HandFrame(then, frame.side, frame.sequence, landmarks)

    def spread(self, time: float) -> float:
        """Return the standard deviation [m] of the coordinates that ``at(time)`` predicts.

        The result is the root mean square over all joints.
        """
        covariance = self._advanced(time + self.latency).joint_covariance()
        return float(np.sqrt(np.diag(covariance).mean()))

    def velocities(self, time: float, span: float = 0.05) -> Float64[np.ndarray, "landmarks 3"]:
        """Return the landmarks' mean velocities [m/s] during ``span`` [s] from ``at(time)`` on.

        They include the accelerations of the hand and of its joints.

        Raises
        ------
        InvalidInput
            If no frame with landmarks has been processed yet, ``time`` is not a number, or ``span``
            is not above zero.
        """
        _, newest, hand = self._state()
        span = positive(span, "span", "s")
        then = max(number(time, "time", "s"), hand.time) + self.latency
        velocities = (hand.joints_at(then + span) - hand.joints_at(then)) / span
        return velocities[TRACKED] if len(newest) == 21 else velocities

    def uncertainty(self, time: float) -> Uncertainty:
        """Return the uncertainty of the hand that ``at(time)`` predicts.

        The covariance of the joints is divided into three parts: the position of the whole hand,
        the rotation of the whole hand, and the positions of the bones relative to the hand
        (``own_position``). The standard deviations of positions are limited to 0.1 m.
        """
        hand = self._advanced(time + self.latency)
        covariance = hand.joint_covariance()
        about = hand.joints - hand.joints.mean(axis=0)
        # Shift and turn (6,) of the whole hand that best fit the errors of all coordinates (75,).
        moves = np.tile(np.eye(3), 25)
        turns = np.cross(np.eye(3)[:, None], about).reshape(3, 75)
        rigid = np.vstack([moves, turns])
        fit = np.linalg.solve(rigid @ rigid.T, rigid)
        variances = np.diag(fit @ covariance @ fit.T)
        # The rest of the covariance is due to motions of the bones.
        own = max(np.trace(covariance) - np.trace(rigid.T @ fit @ covariance), 0.0)
        degrees = float(np.degrees(np.sqrt(variances[3:].mean())))
        return Uncertainty(
            position=min(float(np.sqrt(variances[:3].mean())), 0.1),
            rotation=min(degrees, 90.0) if degrees >= SMALLEST_ANGLE else 0.0,
            own_position=min(float(np.sqrt(own / 75.0)), 0.1),
        )

    def _advanced(self, then: float) -> ArticulatedHand:
        _, _, hand = self._state()
        hand = deepcopy(hand)
        hand.advance(then)
        return hand

    def _state(self) -> tuple[HandFrame, Points, ArticulatedHand]:
        if self._newest is None:
            raise InvalidInput(
                "no frame with landmarks has been processed yet; call take() first.",
                code="empty",
            )
        return self._newest
