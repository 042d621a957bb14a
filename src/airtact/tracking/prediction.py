"""Where a hand will be when the sound arrives: noise smoothed, latency made up for."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from airtact.conventions import InvalidInput
from airtact.hand.joints import CHAINS
from airtact.tracking.frame import FaultyFrame, HandFrame
from airtact.tracking.kalman_filter import Motion, first_seen, measured
from airtact.validation import number, positive

NOISE = 1e-3
"""Standard deviation of each coordinate of a landmark unless given [m]."""

AGILITY = 0.3
"""Spectral density of the acceleration of a landmark unless given [m²/s³]: best or nearly for reaching and pinching at
0.5 m/s, at 30 to 90 frames a second and noise of 0.5 to 3 mm (``benchmarks/hand_tracking.py``)."""

TRACKED_CHAINS = tuple(tuple(range(start, start + 4)) for start in (1, 5, 9, 13, 17))
"""Landmarks of each finger, from the wrist to the tip, where there are 21."""

LONGEST_LATENCY = 1.0
"""Longest latency over which a prediction makes sense [s]."""


class Predictor:
    """Predicts where the landmarks of one hand will be, by a Kalman filter of constant velocity.

    Parameters
    ----------
    latency : from the time of a frame to the moment at which the sound computed from it is in the air [s].
    noise : standard deviation of each coordinate of the tracker's landmarks [m].
    agility : how suddenly landmarks change their velocity, as spectral density of the acceleration [m²/s³].
    patience : a hand that was not seen for longer is lost, and begins anew when it is back [s].

    Raises
    ------
    InvalidInput
        If the latency is not from 0 to 1 s, or another number is not above zero.
    """

    def __init__(self, latency: float, noise: float = NOISE, agility: float = AGILITY, patience: float = 0.15) -> None:
        self.latency: float = number(latency, "latency", "s")
        if not 0.0 <= self.latency <= LONGEST_LATENCY:
            raise InvalidInput(
                f"latency is {self.latency:g} s, but it must be 0 to 1 s: is it in milliseconds?", code="out_of_range"
            )
        self._noise = positive(noise, "noise", "m")
        self._agility = positive(agility, "agility", "m²/s³")
        self._patience = positive(patience, "patience", "s")
        self._motion: Motion | None = None
        self._newest: HandFrame | None = None

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
        last = self._newest
        if last is not None and frame.side != last.side:
            raise InvalidInput(
                f"frame {frame.sequence} is of the {frame.side} hand; make a second predictor for it.",
                code="other_hand",
            )
        if last is not None and frame.time <= last.time:
            raise InvalidInput(
                f"time goes back from {last.time:g} to {frame.time:g} s at frame {frame.sequence}; leave it out.",
                code="backwards",
            )
        if frame.landmarks is None:
            return
        motion = self._motion
        if motion is None or frame.time - motion.time > self._patience or len(motion.positions) != len(frame.landmarks):
            self._motion = first_seen(frame.time, frame.landmarks, self._noise)
        else:
            self._motion = measured(motion, frame.time, frame.landmarks, self._noise, self._agility)
        self._newest = frame

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
        last, motion = self._newest, self._motion
        if last is None or motion is None:
            raise InvalidInput("0 frames with landmarks were taken; take one before a prediction.", code="no_frames")
        then = number(time, "time", "s") + self.latency
        if time - motion.time > self._patience:
            return HandFrame(then, last.side, last.sequence)
        carried = motion.at(then, self._agility).positions
        for landmarks in (carried, _with_lengths(carried, motion.positions)):
            try:
                return HandFrame(then, last.side, last.sequence, landmarks)
            except FaultyFrame:
                continue
        return HandFrame(then, last.side, last.sequence, last.landmarks)

    def spread(self, time: float) -> float:
        """Return the standard deviation of each coordinate a latency after a time [m].

        Parameters
        ----------
        time : of the tracker's clock [s].

        Raises
        ------
        InvalidInput
            When no frame was taken yet.
        """
        if self._motion is None:
            raise InvalidInput("0 frames with landmarks were taken; take one before a prediction.", code="no_frames")
        return float(np.sqrt(self._motion.at(time + self.latency, self._agility).covariance[0, 0]))


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
