"""One frame of a hand as any tracker gives it: when, which hand, and where its joints or the points of its skin are.

The time is that of the tracker's own clock at which the picture was taken, as far as the tracker knows it; only
differences count. Landmarks and cloud are in the tracker's frame, in metres: ``moved`` brings them into that of the
scene.
"""

from dataclasses import dataclass, replace
from typing import Literal, cast

import numpy as np
from jaxtyping import Float64, Real

from airtact.conventions import InvalidInput
from airtact.hand.hand import Hand, Side, hand_from_joints
from airtact.hand.joints import LARGEST, evidence_of, joints_of, side_of
from airtact.pose import Pose
from airtact.printing import in_short
from airtact.validation import counted, fixed, number

Fault = Literal[
    "unreadable",
    "half_lost",
    "unknown_count",
    "not_metres",
    "impossible",
    "mirrored",
    "repeated",
    "out_of_order",
    "backwards",
]
"""What can be wrong with a frame so that it is left out; ``StreamHealth`` describes each."""

LARGEST_CLOUD = 20.0
"""Points of a cloud farther apart than this cannot be metres [m]."""

LAST_SEQUENCE = 2**53
"""Largest sequence number; JSON's numbers are exact up to here."""


class FaultyFrame(InvalidInput):
    """A frame that cannot be used; the message is one sentence.

    Attributes
    ----------
    fault : what is wrong, one of ``Fault``; it is the code, too.
    """

    def __init__(self, fault: Fault, sentence: str, place: Real[np.ndarray, "3"] | None = None) -> None:
        super().__init__(sentence, place, code=fault)
        self.fault: Fault = fault


@dataclass(frozen=True, eq=False)
class HandFrame:
    """A hand at one moment.

    Attributes
    ----------
    time : of the tracker's clock [s].
    side : ``"left"`` or ``"right"``.
    sequence : number of the frame, which grows by one from frame to frame of the same hand.
    landmarks : (25, 3) in the order of WebXR or (21, 3) in that of MediaPipe and Leap [m], or None where they are not
        known.
    cloud : (P, 3) points of the hand's skin [m], or None.

    Raises
    ------
    InvalidInput
        When time, side or sequence number are none, or the landmarks are not those of such a hand: NaN, millimetres, an
        unknown number, impossible bones, those of the other hand. It is a ``FaultyFrame`` with the kind of ``fault``.
    """

    time: float
    side: Side
    sequence: int
    landmarks: Real[np.ndarray, "landmarks 3"] | None = None
    cloud: Real[np.ndarray, "points 3"] | None = None

    __repr__ = in_short

    def __post_init__(self) -> None:
        """Check everything and keep the arrays read-only."""
        object.__setattr__(self, "time", _checked_time(self.time))
        if self.side not in ("left", "right"):
            raise FaultyFrame("unreadable", f"the side is {self.side!r}, but there are 2: 'left' and 'right'.")
        if isinstance(self.sequence, bool) or not isinstance(self.sequence, int | np.integer):
            raise FaultyFrame("unreadable", f"the sequence number is {self.sequence!r}, but it must be an integer.")
        if not 0 <= self.sequence <= LAST_SEQUENCE:
            raise FaultyFrame("unreadable", f"the sequence number is {self.sequence}, but it must be 0 to 2^53.")
        object.__setattr__(self, "sequence", int(self.sequence))
        if self.landmarks is not None:
            object.__setattr__(self, "landmarks", _checked_landmarks(self.landmarks, self.side))
        if self.cloud is not None:
            object.__setattr__(self, "cloud", _checked_cloud(self.cloud))

    @property
    def lost(self) -> bool:
        """Whether the tracker does not see the hand: neither landmarks nor cloud."""
        return self.landmarks is None and self.cloud is None

    def moved(self, pose: Pose) -> "HandFrame":
        """Bring the frame into another frame of reference.

        Parameters
        ----------
        pose : maps the tracker's frame to the one that is wanted; where the tracker stands, seen from there.
        """
        landmarks = None if self.landmarks is None else pose.apply(self.landmarks)
        return replace(self, landmarks=landmarks, cloud=None if self.cloud is None else pose.apply(self.cloud))

    def hand(self, radii: Real[np.ndarray, "joints"] | None = None) -> Hand:
        """Build the hand.

        Parameters
        ----------
        radii : of the skin round each joint [m]; those of a generic hand of that size unless given.

        Raises
        ------
        InvalidInput
            When there are no landmarks, or as ``hand_from_joints``.
        """
        if self.landmarks is None:
            raise InvalidInput(
                f"the {self.side} hand of frame {self.sequence} has 0 landmarks; take another frame.",
                code="landmarks_missing",
            )
        return hand_from_joints(self.landmarks, radii, side=self.side)


def _checked_time(time: float) -> float:
    try:
        given = number(time, "the time of a frame", "s")
    except InvalidInput as fault:
        raise FaultyFrame("unreadable", str(fault)) from None
    if not np.isfinite(given):
        raise FaultyFrame("unreadable", f"the time of a frame is {given:g} s, but it must be finite.")
    return given


def _checked_landmarks(given: Real[np.ndarray, "landmarks 3"], side: str) -> Float64[np.ndarray, "landmarks 3"]:
    landmarks = _points(given, "landmarks")
    if len(landmarks) not in (21, 25):
        are = counted(len(landmarks), "landmark is", "landmarks are")
        raise FaultyFrame("unknown_count", f"{are} given, but a hand has 25 (WebXR) or 21 (MediaPipe, Leap).")
    bad = ~np.isfinite(landmarks).all(axis=1)
    if bad.any():
        are = counted(int(bad.sum()), "landmark is", "landmarks are")
        first = int(np.flatnonzero(bad)[0])
        raise FaultyFrame(
            "half_lost",
            f"{are} NaN or infinite, the first is number {first}: the tracker lost it; leave the frame out.",
        )
    if float(np.ptp(landmarks, axis=0).max()) > LARGEST:
        spread = float(np.ptp(landmarks, axis=0).max())
        raise FaultyFrame("not_metres", f"the landmarks span {spread:.4g} m: are they in millimetres? Give metres.")
    try:
        joints = joints_of(landmarks)
    except InvalidInput as fault:
        raise FaultyFrame("impossible", str(fault), fault.position) from None
    if side_of(joints) not in (side, "unknown"):
        raise FaultyFrame(
            "mirrored",
            f"the landmarks are labelled as a {side} hand's, but the fingers bend and the thumb points as those of a "
            f"{side_of(joints)} one ({evidence_of(joints):+.2f}, above 0 being right): are they mirrored?",
        )
    return landmarks


def _checked_cloud(given: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
    cloud = _points(given, "points of a cloud")
    if len(cloud) == 0:
        raise FaultyFrame("unreadable", "the cloud has 0 points; give None where there is no cloud.")
    bad = int((~np.isfinite(cloud).all(axis=1)).sum())
    if bad:
        raise FaultyFrame(
            "unreadable", f"{counted(bad, 'point', 'points')} of the cloud are NaN or infinite; leave them out."
        )
    spread = float(np.ptp(cloud, axis=0).max())
    if spread > LARGEST_CLOUD:
        raise FaultyFrame("not_metres", f"the cloud spans {spread:.4g} m: is it in millimetres? Give metres.")
    return cloud


def _points(given: Real[np.ndarray, "..."], what: str) -> Float64[np.ndarray, "points 3"]:
    array = np.asarray(given)
    if array.dtype.kind not in "iuf" or array.ndim != 2 or array.shape[1] != 3:
        raise FaultyFrame(
            "unreadable",
            f"{what} have shape {array.shape} and type {array.dtype}, but they must be real and (number, 3).",
        )
    return cast("Float64[np.ndarray, 'points 3']", fixed(array))
