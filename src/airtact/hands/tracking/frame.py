"""One frame of a tracked hand: its time, its side, and landmarks or points of its skin.

The time is the reading of the tracker's clock when the image was taken; only differences matter.
Landmarks and cloud are in the tracker's frame of reference, in metres; ``moved`` transforms them to
the scene.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Real

from airtact.errors import InvalidInput, fixed, in_short, points_of
from airtact.geometry.pose import Pose
from airtact.hands.hand import Hand, Side, hand_from_joints
from airtact.hands.joints import joints_of

# Faults of rejected frames; ``StreamHealth`` describes each.
Fault = Literal[
    "unreadable",
    "half_lost",
    "unknown_count",
    "not_in_metres",
    "impossible",
    "mirrored",
    "repeated",
    "out_of_order",
    "backwards",
    "time_leap",
    "too_fast",
    "second_tracker",
]

# Largest sequence number; numbers in JSON are exact up to this value.
MAX_SEQUENCE = 2**53


class FaultyFrame(InvalidInput):
    """Error raised for a tracker frame that cannot be used.

    ``HandFrame`` and ``from_json`` raise it. ``HandStream.feed`` returns it instead, and skips the
    frame. It also has the attributes of ``InvalidInput``.

    Attributes
    ----------
    fault : reason for the rejection, such as "unreadable" or "mirrored", which is also the ``code``
        of the error. ``StreamHealth`` explains each reason, and counts the frames rejected for it
        in an attribute of the same name, such as ``StreamHealth.mirrored``.
    """

    def __init__(
        self, fault: Fault, sentence: str, place: Real[np.ndarray, "3"] | None = None
    ) -> None:
        super().__init__(sentence, place, code=fault)
        self.fault: Fault = fault


@dataclass(frozen=True, eq=False)
class HandFrame:
    """A tracked hand at one instant, in the frame of reference of the tracker.

    A frame with neither landmarks nor cloud means that the tracker lost the hand (see ``lost``).

    Attributes
    ----------
    time : time at which the image was taken, on the tracker's clock [s]; only differences matter.
    side : ``"left"`` or ``"right"``; upper case is converted to lower case.
    sequence : number of the frame, 0 to 2^53, which increases by one for each frame of the same
        hand.
    landmarks : (25, 3) joints in WebXR order, (26, 3) in OpenXR order, of which the palm is
        dropped, or (21, 3) in MediaPipe and Leap order [m]; None if unknown.
    cloud : (P, 3) points of the hand's skin [m]; None if there are none.

    Raises
    ------
    InvalidInput
        Raised as the subclass ``FaultyFrame`` if the time, side or sequence number is invalid, if
        landmarks are NaN, in millimetres, too few or too many, or have implausible bone lengths, or
        if the cloud contains NaN or spans more than 20 m. Landmarks of the other hand raise no
        error, because ``HandStream`` needs many frames to recognise them.
    """

    time: float
    side: Side
    sequence: int
    landmarks: Real[np.ndarray, "landmarks 3"] | None = None
    cloud: Real[np.ndarray, "points 3"] | None = None

    __repr__ = in_short

    def __post_init__(self) -> None:
        integer = isinstance(self.sequence, int | np.integer) and self.sequence is not True
        real = isinstance(self.time, int | float | np.integer | np.floating)
        if isinstance(self.side, str):
            object.__setattr__(self, "side", self.side.lower())
        if not (
            # Nanoseconds since 1970 are below 1e19, and larger numbers would overflow later.
            (real and abs(self.time) < 1e19)
            and self.side in ("left", "right")
            and (integer and 0 <= self.sequence <= MAX_SEQUENCE)
        ):
            raise FaultyFrame(
                "unreadable",
                f"time {self.time!r}, side {self.side!r} or sequence number {self.sequence!r} is "
                "invalid. Use a time below 1e19, the side 'left' or 'right', and a whole sequence "
                "number from 0 to 2^53.",
            )
        # ``vars`` bypasses the frozen dataclass.
        vars(self).update(time=float(self.time), sequence=int(self.sequence))
        if self.landmarks is not None:
            with _as_faulty_frame(
                {
                    "not_finite": "half_lost",
                    "joint_count": "unknown_count",
                    "empty": "unknown_count",
                    "not_in_metres": "not_in_metres",
                    "bone_length": "impossible",
                }
            ):
                joints_of(self.landmarks, word="landmark")
            count = len(self.landmarks)
            object.__setattr__(self, "landmarks", fixed(self.landmarks[1 if count == 26 else 0 :]))
        if self.cloud is not None:
            with _as_faulty_frame({}):
                cloud = points_of(self.cloud, "points of a cloud")
            span = float(np.ptp(cloud, axis=0).max())
            if span > 20.0:
                raise FaultyFrame(
                    "not_in_metres",
                    f"the cloud spans {span:.4g} m: is it in millimetres? Use metres.",
                )
            object.__setattr__(self, "cloud", cloud)

    @property
    def lost(self) -> bool:
        """Whether the tracker lost the hand, so that the frame has neither landmarks nor cloud."""
        return self.landmarks is None and self.cloud is None

    def moved(self, pose: Pose) -> "HandFrame":
        """Return the frame transformed to another frame of reference.

        Parameters
        ----------
        pose : pose of the tracker in the new frame of reference.
        """
        return replace(
            self,
            landmarks=None if self.landmarks is None else pose.apply(self.landmarks),
            cloud=None if self.cloud is None else pose.apply(self.cloud),
        )

    def hand(self, radii: Real[np.ndarray, "joints"] | None = None) -> Hand:
        """Build the hand from the landmarks.

        Parameters
        ----------
        radii : radius of the skin around each joint [m]; by default those of a generic hand of the
            same size.

        Returns
        -------
        The hand in the pose of the landmarks.

        Raises
        ------
        InvalidInput
            If there are no landmarks, if they do not form a plausible hand of this side, or if the
            radii are implausible.
        """
        if self.landmarks is None:
            raise InvalidInput(
                f"the {self.side} hand of frame {self.sequence} has no landmarks; use another "
                "frame.",
                code="data_missing",
            )
        return hand_from_joints(self.landmarks, radii, side=self.side)


@contextmanager
def _as_faulty_frame(faults: Mapping[str, Fault]) -> Iterator[None]:
    """Convert errors to faults with the same code; unknown codes become "unreadable"."""
    try:
        yield
    except InvalidInput as error:
        raise FaultyFrame(
            faults.get(error.code, "unreadable"), str(error), error.position
        ) from None
