"""One frame of a hand as any tracker gives it: when, which hand, and where its joints or the points of its skin are.

The time is that of the tracker's own clock at which the picture was taken, as far as the tracker
knows it; only differences count. Landmarks and cloud are in the tracker's frame, in metres:
``moved`` brings them into that of the scene.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float64, Real

from airtact.checks import fixed, number, points_of
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.hands.hand import Hand, Side, hand_from_joints
from airtact.hands.joints import checked_side, joints_of
from airtact.printing import in_short

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

    def __init__(
        self, fault: Fault, sentence: str, place: Real[np.ndarray, "3"] | None = None
    ) -> None:
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
    landmarks : (25, 3) in the order of WebXR or (21, 3) in that of MediaPipe and Leap [m], or None
        where they are not known.
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
        try:
            object.__setattr__(self, "time", number(self.time, "the time of a frame", "s"))
        except InvalidInput as fault:
            raise FaultyFrame("unreadable", str(fault)) from None
        if not np.isfinite(self.time):
            raise FaultyFrame(
                "unreadable", f"the time of a frame is {self.time:g} s, but it must be finite."
            )
        if self.side not in ("left", "right"):
            raise FaultyFrame(
                "unreadable", f"the side is {self.side!r}, but there are 2: 'left' and 'right'."
            )
        if isinstance(self.sequence, bool) or not isinstance(self.sequence, int | np.integer):
            raise FaultyFrame(
                "unreadable",
                f"the sequence number is {self.sequence!r}, but it must be an integer.",
            )
        if not 0 <= self.sequence <= LAST_SEQUENCE:
            raise FaultyFrame(
                "unreadable", f"the sequence number is {self.sequence}, but it must be 0 to 2^53."
            )
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
        pose : maps the tracker's frame to the one that is wanted; where the tracker stands, seen
            from there.
        """
        landmarks = None if self.landmarks is None else pose.apply(self.landmarks)
        return replace(
            self, landmarks=landmarks, cloud=None if self.cloud is None else pose.apply(self.cloud)
        )

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
            sentence = f"the {self.side} hand of frame {self.sequence} has 0 landmarks; take another frame."
            raise InvalidInput(sentence, code="data_missing")
        return hand_from_joints(self.landmarks, radii, side=self.side)


_FAULTS: dict[str, Fault] = {
    "not_finite": "half_lost",
    "joint_count": "unknown_count",
    "empty": "unknown_count",
    "not_in_metres": "not_metres",
    "bone_length": "impossible",
    "wrong_side": "mirrored",
}
"""Faults by the codes of landmarks; others make a frame unreadable."""


def _checked_landmarks(
    given: Real[np.ndarray, "landmarks 3"], side: str
) -> Float64[np.ndarray, "landmarks 3"]:
    try:
        checked_side(joints_of(given, what="landmark"), side, "landmarks")
    except InvalidInput as fault:
        raise FaultyFrame(
            _FAULTS.get(fault.code, "unreadable"), str(fault), fault.position
        ) from None
    return fixed(given)


def _checked_cloud(given: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
    try:
        cloud = points_of(given, "points of a cloud")
    except InvalidInput as fault:
        raise FaultyFrame("unreadable", str(fault)) from None
    spread = float(np.ptp(cloud, axis=0).max())
    if spread > LARGEST_CLOUD:
        raise FaultyFrame(
            "not_metres", f"the cloud spans {spread:.4g} m: is it in millimetres? Give metres."
        )
    return cloud
