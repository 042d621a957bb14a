"""Frames as JSON messages, for websockets and recordings.

A message is an object such as ``{"time": 1.5, "side": "left", "sequence": 45, "landmarks": [[x, y,
z], ...]}``, optionally with a ``cloud`` of points. A frame without landmarks and cloud, or with
null for both, means that the hand is lost. A coordinate or landmark that is null is lost. Landmarks
may also be the 4 x 4 matrices of joints. Other keys are ignored.
"""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np

from airtact.errors import of_kind
from airtact.files.bounded import json_of
from airtact.hands.tracking.formats import STREAMER_LINE, foreign_format, points_of_matrices
from airtact.hands.tracking.frame import MAX_SEQUENCE, FaultyFrame, HandFrame

Coordinates = tuple[float | None, float | None, float | None]


class Message(msgspec.Struct, omit_defaults=True):
    """A frame in JSON; see ``HandFrame``."""

    time: float
    side: str
    sequence: Annotated[int, msgspec.Meta(ge=0, le=MAX_SEQUENCE)]
    landmarks: list[Coordinates | None] | msgspec.UnsetType | None = msgspec.UNSET
    cloud: list[Coordinates] | msgspec.UnsetType | None = msgspec.UNSET


_decoder = msgspec.json.Decoder(Message)


def to_json(frame: HandFrame) -> bytes:
    """Return a frame as a JSON message, which ``from_json`` and ``HandStream.feed_json`` read.

    Parameters
    ----------
    frame : the frame.

    Returns
    -------
    UTF-8 bytes of a JSON object without line breaks, with the keys ``time`` [s], ``side``,
    ``sequence`` and, if the frame contains them, ``landmarks`` and ``cloud`` (lists of points [m]).
    Coordinates keep their frame of reference and are rounded to micrometres.
    """
    of_kind(frame, HandFrame, "the frame", "HandFrame(time, side, ...)")
    missing = msgspec.UNSET
    landmarks = missing if frame.landmarks is None else np.round(frame.landmarks, 6).tolist()
    cloud = missing if frame.cloud is None else np.round(frame.cloud, 6).tolist()
    return msgspec.json.encode(Message(frame.time, frame.side, frame.sequence, landmarks, cloud))


def from_json(text: bytes | str) -> HandFrame:
    """Read a frame of a tracked hand from a JSON message, the inverse of ``to_json``.

    Parameters
    ----------
    text : a JSON object with the keys of the attributes of ``HandFrame``: ``time`` [s], ``side``
        and ``sequence`` and, optionally, ``landmarks`` and ``cloud``, which are lists of [x, y, z]
        in the tracker's frame [m]. Landmarks may also be 4 x 4 matrices of the joints. Other keys
        are ignored. If both optional keys are missing, null or empty, the hand is lost.

    Returns
    -------
    The ``HandFrame``; its attribute ``lost`` is True for a lost hand.

    Raises
    ------
    InvalidInput
        Raised as the subclass ``FaultyFrame`` if the text is not a frame in JSON, or if
        ``HandFrame`` rejects the values, for example because landmarks are null, NaN or in
        millimetres.
    """
    raw = (
        text.encode()
        if isinstance(text, str)
        else of_kind(text, bytes, "the message", "text or bytes")
    )
    try:
        message = _message(raw)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)
        if STREAMER_LINE.match(raw[:40].decode(errors="replace")):
            reason = "it is a line from hand-tracking-streamer; send it through quest_streamer.py"
        raise FaultyFrame("unreadable", f"the message is not a frame in JSON: {reason}.") from None
    side = message.side.lower()
    if side != "left" and side != "right":
        raise FaultyFrame(
            "unreadable", f"the side of the frame is {message.side!r}; use 'left' or 'right'."
        )
    landmarks = [point or (None, None, None) for point in message.landmarks or []]

    def array(points: Sequence[Coordinates]) -> np.ndarray | None:
        return np.array(points, dtype=np.float64) if points else None

    return HandFrame(
        message.time, side, message.sequence, array(landmarks), array(message.cloud or [])
    )


def _message(raw: bytes) -> Message:
    """Parse a message; raises ``ValueError`` or ``RecursionError``."""
    try:
        message = _decoder.decode(raw)
        keys = 3 + (message.landmarks is not msgspec.UNSET) + (message.cloud is not msgspec.UNSET)
        # Only keys and the side have quotation marks, unless there are further or repeated keys.
        if raw.count(b'"') == 2 * keys + 2:
            return message
    except msgspec.MsgspecError:
        pass  # perhaps NaN, which is invalid JSON that Python writes, or matrices
    values = json_of(raw)
    if name := foreign_format(values):
        raise ValueError(f"it is {name}")
    if isinstance(values, dict):
        if not {"time", "side", "sequence", "landmarks", "cloud"} & values.keys():
            raise ValueError(
                "it has none of the keys time, side, sequence and landmarks; a message from an "
                "application needs the keys type and version"
            )
        points = points_of_matrices(values.get("landmarks"))
        if points is not None:
            values["landmarks"] = points.tolist()
    return msgspec.convert(values, Message)
