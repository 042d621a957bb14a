"""Frames as JSON messages, for websockets and recordings.

A message is one object, such as ``{"time": 1.5, "side": "left", "sequence": 45, "landmarks": [[x,
y, z], ...]}``, optionally with a ``cloud`` of points. A frame without landmarks and cloud, or with
null for both, means that the hand is lost. A coordinate or landmark of null is lost.
"""

import json
from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np

from airtact.hands.joints import Side
from airtact.hands.tracking.frame import MAX_SEQUENCE, FaultyFrame, HandFrame

Coordinates = tuple[float | None, float | None, float | None]


class Message(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """A frame in JSON; see ``HandFrame``."""

    time: float
    side: Side
    sequence: Annotated[int, msgspec.Meta(ge=0, le=MAX_SEQUENCE)]
    landmarks: list[Coordinates | None] | msgspec.UnsetType | None = msgspec.UNSET
    cloud: list[Coordinates] | msgspec.UnsetType | None = msgspec.UNSET


_decoder = msgspec.json.Decoder(Message)


def to_json(frame: HandFrame) -> bytes:
    """Write a frame as one line of JSON; coordinates are rounded to micrometres."""
    missing = msgspec.UNSET
    landmarks = missing if frame.landmarks is None else np.round(frame.landmarks, 6).tolist()
    cloud = missing if frame.cloud is None else np.round(frame.cloud, 6).tolist()
    return msgspec.json.encode(Message(frame.time, frame.side, frame.sequence, landmarks, cloud))


def from_json(text: bytes | str) -> HandFrame:
    """Read a frame from JSON.

    Raises
    ------
    InvalidInput
        A ``FaultyFrame``, if the text is not such JSON or the frame is faulty.
    """
    try:
        raw = text.encode() if isinstance(text, str) else text
        if b"NaN" in raw or b"Infinity" in raw:  # invalid JSON that Python writes
            message = msgspec.convert(json.loads(raw), Message)
        else:
            message = _decoder.decode(raw)
        # Decoders keep the last of two equal keys; only keys and the side have quotation marks.
        keys = 3 + (message.landmarks is not msgspec.UNSET) + (message.cloud is not msgspec.UNSET)
        if raw.count(b'"') != 2 * keys + 2:
            raise ValueError("a key is given twice")
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise FaultyFrame("unreadable", f"it is not a frame in JSON: {reason}.") from None
    landmarks = [point or (None, None, None) for point in message.landmarks or []]

    def array(points: Sequence[Coordinates]) -> np.ndarray | None:
        return np.array(points, dtype=np.float64) if points else None

    cloud = array(message.cloud or [])
    return HandFrame(message.time, message.side, message.sequence, array(landmarks), cloud)
