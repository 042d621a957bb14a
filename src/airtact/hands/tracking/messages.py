"""Frames as messages: JSON, for websockets and recordings, and OSC, for programs of sound and light.

JSON: one object, such as ``{"time": 1.5, "side": "left", "sequence": 45, "landmarks": [[x, y, z],
...]}``, with a ``cloud`` of points where there is one. Neither landmarks nor cloud, or null for
both, means that the hand is lost; null for a coordinate or a landmark means that this one is.

OSC: address ``/airtact/hand``, arguments time (double), side (string), sequence (integer), then x,
y, z of every landmark (floats; none where the hand is lost), and where there is a cloud a blob of
big-endian floats, x, y, z of every point.
"""

import json
from typing import Annotated, Any

import msgspec
import numpy as np

from airtact.checks import counted
from airtact.errors import extra
from airtact.hands.joints import Side
from airtact.hands.tracking.frame import LAST_SEQUENCE, FaultyFrame, HandFrame

ADDRESS = "/airtact/hand"
"""Address of a hand's frame in OSC."""

OSC_HEAD = b"/airtact/hand\0\0\0,"
"""What a packet of OSC begins with: the address, padded to a multiple of 4 bytes, and the types of the arguments."""

DIGITS = 6
"""Places of a metre that are written: micrometres."""

Coordinates = tuple[float | None, float | None, float | None]


class Message(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """A frame as JSON has it; see ``HandFrame``."""

    time: float
    side: Side
    sequence: Annotated[int, msgspec.Meta(ge=0, le=LAST_SEQUENCE)]
    landmarks: list[Coordinates | None] | None = None
    cloud: list[Coordinates] | None = None


class _Head(msgspec.Struct):
    """Whose frame a message is; all else in it is passed over, which takes a fiftieth of reading and checking it."""

    side: Side


_decoder = msgspec.json.Decoder(Message)
_head_decoder = msgspec.json.Decoder(_Head)


def to_json(frame: HandFrame) -> bytes:
    """Write a frame as a line of JSON, without the line's end; coordinates are rounded to micrometres."""
    landmarks = None if frame.landmarks is None else np.round(frame.landmarks, DIGITS).tolist()
    cloud = None if frame.cloud is None else np.round(frame.cloud, DIGITS).tolist()
    return msgspec.json.encode(Message(frame.time, frame.side, frame.sequence, landmarks, cloud))


def from_json(text: bytes | str) -> HandFrame:
    """Read a frame from JSON.

    Raises
    ------
    InvalidInput
        It is not such JSON, or the frame is faulty: a ``FaultyFrame`` with the kind of fault.
    """
    try:
        raw = text.encode() if isinstance(text, str) else text
        if b"NaN" in raw or b"Infinity" in raw:  # no JSON, but what Python and others write
            message = msgspec.convert(json.loads(raw), Message)
        else:
            message = _decoder.decode(raw)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        reason = "it is nested too deep" if isinstance(error, RecursionError) else str(error)
        raise FaultyFrame("unreadable", f"this is not 1 frame as JSON: {reason}.") from None
    landmarks = [(None,) * 3 if one is None else one for one in message.landmarks or []]
    return _frame(message, landmarks, message.cloud or [])


def side_of(text: bytes | str) -> Side | None:
    """Return whose frame a message in JSON is without reading the frame, or None where that cannot be said."""
    try:
        return _head_decoder.decode(text).side
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return None


def side_of_osc(packet: bytes) -> Side | None:
    """Return whose frame a packet of OSC is, as ``side_of`` does; None for a bundle."""
    first, second = (
        packet[len(OSC_HEAD) : len(OSC_HEAD) + 1],
        packet[len(OSC_HEAD) + 1 : len(OSC_HEAD) + 2],
    )
    if not packet.startswith(OSC_HEAD) or first not in (b"d", b"f") or second != b"s":
        return None
    end = packet.find(b"\0", len(OSC_HEAD))
    begin = (
        end + 4 - end % 4 + (8 if first == b"d" else 4)
    )  # a text ends in 1 to 4 zeros; the time follows
    word = packet[begin : begin + 8].partition(b"\0")[0]
    return "left" if word == b"left" else "right" if word == b"right" else None


def to_osc(frame: HandFrame) -> bytes:
    """Write a frame as an OSC message, coordinates in single precision."""
    with extra("tracking", "hands by OSC need python-osc"):
        from pythonosc.osc_message_builder import OscMessageBuilder

    builder = OscMessageBuilder(ADDRESS)
    builder.add_arg(frame.time, "d")
    builder.add_arg(frame.side, "s")
    builder.add_arg(frame.sequence, "h")
    for coordinate in () if frame.landmarks is None else frame.landmarks.ravel():
        builder.add_arg(float(coordinate), "f")
    if frame.cloud is not None:
        builder.add_arg(frame.cloud.astype(">f4").tobytes(), "b")
    return builder.build().dgram


def from_osc(packet: bytes) -> list[HandFrame]:
    """Read the frames in an OSC packet: one message, or a bundle of several; other addresses are passed over.

    Raises
    ------
    InvalidInput
        It is not OSC, the arguments are not those of a frame, or the frame is faulty.
    """
    with extra("tracking", "hands by OSC need python-osc"):
        from pythonosc.osc_packet import OscPacket

    try:
        messages = [timed.message for timed in OscPacket(packet).messages]
        read = [(message.address, list(message.params)) for message in messages]
    except Exception as error:  # the parser lets errors of struct, str and its own through
        raise FaultyFrame(
            "unreadable", f"these {len(packet)} bytes are not OSC: {error}."
        ) from None
    return [_from_arguments(arguments) for address, arguments in read if address == ADDRESS]


def _from_arguments(arguments: list[Any]) -> HandFrame:
    blob = arguments.pop() if arguments and isinstance(arguments[-1], bytes) else b""
    floats = arguments[3:]
    if len(floats) % 3 or len(blob) % 12 or not all(isinstance(one, float | int) for one in floats):
        are = f"{counted(len(floats), 'argument', 'arguments')} and {len(blob)} bytes are"
        raise FaultyFrame("unreadable", f"{are} not floats x, y, z of each landmark and point.")
    try:
        head = msgspec.convert(
            dict(zip(Message.__struct_fields__, arguments[:3], strict=False)), Message
        )
    except msgspec.ValidationError as error:
        raise FaultyFrame(
            "unreadable", f"the first 3 arguments are not time, side, sequence: {error}."
        ) from None
    landmarks = np.array(floats, dtype=np.float64).reshape(-1, 3)
    return _frame(head, landmarks, np.frombuffer(blob, dtype=">f4").reshape(-1, 3))


def _frame(head: Message, landmarks: Any, cloud: Any) -> HandFrame:
    """Make the frame of lists or arrays of points, empty ones being none."""
    points = [
        np.array(one, dtype=np.float64).reshape(-1, 3) if len(one) else None
        for one in (landmarks, cloud)
    ]
    return HandFrame(head.time, head.side, head.sequence, *points)
