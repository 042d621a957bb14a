"""Frames as messages: JSON for websockets and recordings, OSC for audio and lighting software.

JSON: one object, such as ``{"time": 1.5, "side": "left", "sequence": 45, "landmarks": [[x, y, z],
...]}``, optionally with a ``cloud`` of points. A frame without landmarks and cloud, or with null
for both, means that the hand is lost. A coordinate or landmark of null is lost.

OSC: address ``/airtact/hand``, arguments time (double), side (string), sequence (integer), then x,
y, z of every landmark (floats; none if the hand is lost), and optionally a blob of big-endian
floats, x, y, z of every point of a cloud.
"""

import json
from typing import Annotated, Any

import msgspec
import numpy as np

from airtact.errors import extra
from airtact.hands.joints import Side
from airtact.hands.tracking.frame import MAX_SEQUENCE, FaultyFrame, HandFrame

# OSC address of frames.
ADDRESS = "/airtact/hand"

Coordinates = tuple[float | None, float | None, float | None]


class Message(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """A frame in JSON; see ``HandFrame``."""

    time: float
    side: Side
    sequence: Annotated[int, msgspec.Meta(ge=0, le=MAX_SEQUENCE)]
    landmarks: list[Coordinates | None] | None = None
    cloud: list[Coordinates] | None = None


class _Head(msgspec.Struct):
    # Decoding only this field takes 2 % of the time of reading a frame.
    side: Side


_decoder = msgspec.json.Decoder(Message)
_head_decoder = msgspec.json.Decoder(_Head)


def to_json(frame: HandFrame) -> bytes:
    """Write a frame as one line of JSON; coordinates are rounded to micrometres."""
    landmarks = None if frame.landmarks is None else np.round(frame.landmarks, 6).tolist()
    cloud = None if frame.cloud is None else np.round(frame.cloud, 6).tolist()
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
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise FaultyFrame("unreadable", f"it is not a frame in JSON: {reason}.") from None
    landmarks = [point or (None,) * 3 for point in message.landmarks or []]
    return _frame(message, landmarks, message.cloud or [])


def side_of(text: bytes | str) -> Side | None:
    """Return the side of a frame in JSON without reading the rest; None if unreadable."""
    try:
        return _head_decoder.decode(text).side
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return None


def to_osc(frame: HandFrame) -> bytes:
    """Write a frame as an OSC message, with coordinates in single precision."""
    with extra("tracking", "OSC messages need python-osc"):
        from pythonosc.osc_message_builder import OscMessageBuilder

    builder = OscMessageBuilder(ADDRESS)
    builder.add_arg(frame.time, "d")
    builder.add_arg(frame.side, "s")
    builder.add_arg(frame.sequence, "h")
    if frame.landmarks is not None:
        for coordinate in frame.landmarks.ravel().tolist():
            builder.add_arg(coordinate, "f")
    if frame.cloud is not None:
        builder.add_arg(frame.cloud.astype(">f4").tobytes(), "b")
    return builder.build().dgram


def from_osc(packet: bytes) -> list[HandFrame]:
    """Read the frames of an OSC message or bundle; other addresses are ignored.

    Raises
    ------
    InvalidInput
        A ``FaultyFrame``, if the packet is not OSC, the arguments are not those of a frame, or the
        frame is faulty.
    """
    with extra("tracking", "OSC messages need python-osc"):
        from pythonosc.osc_packet import OscPacket

    try:
        messages = [timed.message for timed in OscPacket(packet).messages]
        arguments = [list(message.params) for message in messages if message.address == ADDRESS]
    except Exception as error:  # the parser raises errors of struct, str and its own
        raise FaultyFrame(
            "unreadable", f"these {len(packet)} bytes are not OSC: {error}."
        ) from None
    return [_frame_of_osc(values) for values in arguments]


def _frame_of_osc(arguments: list[Any]) -> HandFrame:
    blob = arguments.pop() if arguments and isinstance(arguments[-1], bytes) else b""
    floats = arguments[3:]
    numeric = all(isinstance(value, float | int) for value in floats)
    if len(floats) % 3 or len(blob) % 12 or not numeric:
        raise FaultyFrame(
            "unreadable",
            f"{len(floats)} arguments and {len(blob)} bytes are not x, y, z of landmarks and "
            "points.",
        )
    head = dict(zip(("time", "side", "sequence"), arguments, strict=False))
    try:
        message = msgspec.convert(head, Message)
    except msgspec.ValidationError as error:
        raise FaultyFrame(
            "unreadable", f"the first arguments are not time, side, sequence: {error}."
        ) from None
    landmarks = np.array(floats, dtype=np.float64).reshape(-1, 3)
    return _frame(message, landmarks, np.frombuffer(blob, dtype=">f4").reshape(-1, 3))


def _frame(head: Message, landmarks: Any, cloud: Any) -> HandFrame:
    """Make a frame from lists or arrays of points; empty ones become None."""

    def array(points: Any) -> np.ndarray | None:
        return np.array(points, dtype=np.float64).reshape(-1, 3) if len(points) else None

    return HandFrame(head.time, head.side, head.sequence, array(landmarks), array(cloud))
