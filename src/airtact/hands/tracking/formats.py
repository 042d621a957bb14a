"""Conversion of messages and recordings from other programs to frames.

Sources
-------
- Meta Platforms, Immersive Web Emulation Runtime (IWER), ``ActionRecorder``: action recordings.
- ``hand-tracking-streamer`` for Meta Quest, ``CONNECTIONS.md``: lines of text over UDP or TCP.
- vuer, ``HAND_MOVE``, and VisionProTeleop: matrices of joints.
- *OpenXR* (Khronos Group), section ``XR_EXT_hand_tracking``: 26 joints.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from airtact.hands.joints import NAMES
from airtact.hands.tracking.frame import FaultyFrame, HandFrame

Points = Float64[np.ndarray, "landmarks 3"]

# Place of a frame in its file, and a function that creates it or raises ``FaultyFrame``.
Item = tuple[str, Callable[[], HandFrame]]

# A line of hand-tracking-streamer, such as "Right wrist:, 0.1, 1.0, 0.3, 0, 0, 0, 1".
STREAMER_LINE = re.compile(r"\s*(left|right) (wrist|landmarks):,?(.*)", re.IGNORECASE)


def foreign_format(values: Any) -> str:
    """Return advice if parsed JSON has the format of another program; otherwise return ""."""
    keys = set(values) if isinstance(values, dict) else set()
    if {"schema", "frames"} <= keys:
        return "an action recording from IWER: load it as a file"
    if keys & {"left", "right", "left_fingers", "right_fingers"} and "side" not in keys:
        return (
            "a message with the matrices of both hands, as sent by vuer or VisionProTeleop: send "
            "one message per hand, with time, side, sequence, and its matrices as landmarks"
        )
    if keys & {"worldLandmarks", "world_landmarks", "multiHandWorldLandmarks"}:
        return (
            "a result from MediaPipe: send time, side, sequence, and its world landmarks, [x, y, "
            "z] in metres, as landmarks"
        )
    if "landmarks" in keys or "cloud" in keys:
        return ""
    for key, value in values.items() if isinstance(values, dict) else ():
        # Without this check, a misspelt key would look like a frame of a lost hand.
        if isinstance(value, list) and (len(value) > 60 or isinstance((value or [0])[0], list)):
            return f"a message with {key!r}, but without landmarks: rename the key to landmarks"
    return ""


def points_of_matrices(values: Any) -> Points | None:
    """Return the positions (J, 3) [m] in the 4 x 4 matrices of joints, or None for other data.

    The matrices may be nested or a single list of numbers, row by row (NumPy, Swift) or column by
    column (three.js, vuer).
    """
    matrices = _matrices(values)
    return None if matrices is None else matrices[:, :3, 3]


def _matrices(values: Any) -> Float64[np.ndarray, "joints 4 4"] | None:
    """Return homogeneous matrices whose positions are in the last column."""
    try:
        numbers = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    if numbers.size == 0 or numbers.size % 16 or numbers.shape[1:] == (3,):
        return None
    matrices = numbers.reshape(-1, 4, 4)
    # The last row of a homogeneous matrix is 0, 0, 0, 1.
    by_columns = np.abs(matrices[:, :3, 3]).max() < 1e-6
    return matrices.transpose(0, 2, 1) if by_columns else matrices


def frames_of_matrices(messages: Iterable[dict[str, Any]]) -> Iterator[Item]:
    """Read messages with the matrices of both hands, from vuer or VisionProTeleop.

    In messages from VisionProTeleop, the joints are relative to the matrix of the wrist. Messages
    without the key ``time`` are assumed to be 1/60 s apart, beginning at time 0.
    """
    for index, message in enumerate(messages):
        for side in ("left", "right"):
            points = points_of_matrices(message.get(side, message.get(f"{side}_fingers")))
            wrist = _matrices(message.get(f"{side}_wrist"))
            if points is not None and wrist is not None and not points[0].any():
                points = points @ wrist[0, :3, :3].T + wrist[0, :3, 3]
            if points is not None:
                yield (
                    f"message {index}",
                    partial(HandFrame, message.get("time", index / 60.0), side, index, points),
                )


def frames_of_actions(recording: dict[str, Any]) -> Iterator[Item]:
    """Read an action recording written by IWER, with times in milliseconds.

    A frame is a list with its time, 7 numbers for the pose of the head, and the inputs. An input
    is a list with its index, 7 numbers for the pose of its pointing ray, and further lists. The
    list for a hand contains 8 numbers per joint, relative to the ray: position, quaternion and
    radius.
    """
    schemas = dict(recording["schema"])
    for number, frame in enumerate(recording["frames"]):
        for entry in frame[8:]:
            schema = schemas[entry[0]]
            sequence = schema.get("jointSequence") or ()
            lists = [item for item in entry[8:] if isinstance(item, list)]
            values = next((item for item in lists if len(item) == 8 * len(sequence)), None)
            if not schema.get("hasHand") or set(sequence) != set(NAMES):
                continue
            points = None  # without the list, the hand is lost
            if values is not None:
                order = [sequence.index(name) for name in NAMES]
                relative = np.array(values, dtype=np.float64).reshape(-1, 8)[order, :3]
                points = Rotation.from_quat(entry[4:8]).apply(relative) + entry[1:4]
            yield (
                f"frame {number}",
                partial(HandFrame, 1e-3 * frame[0], schema["handedness"], number, points),
            )


def frames_of_streamer(lines: Iterable[str]) -> Iterator[Item]:
    """Read lines from hand-tracking-streamer; they contain no times, so 70 frames/s is assumed.

    The line of a wrist contains the position and the quaternion of the wrist. The line of the
    landmarks contains 21 positions relative to the wrist, in the left-handed axes of Unity.
    """
    wrists: dict[str, list[float]] = {}
    counts = {"left": 0, "right": 0}
    for number, line in enumerate(lines, 1):
        found = STREAMER_LINE.match(line)
        if found is None:
            continue
        side = found[1].lower()
        try:
            values = [float(value) for value in found[3].split(",")]
        except ValueError:
            values = []
        if found[2].lower() == "wrist":
            wrists[side] = values
            continue
        counts[side] += 1
        yield (
            f"line {number}",
            partial(_streamed, side, counts[side] - 1, wrists.get(side, []), values),
        )


def _streamed(side: Any, index: int, wrist: list[float], values: list[float]) -> HandFrame:
    if len(wrist) != 7 or len(values) % 3 or not np.any(wrist[3:]):
        raise FaultyFrame(
            "unreadable",
            "the wrist or the landmarks are missing or incomplete. Remove this line.",
        )
    points = Rotation.from_quat(wrist[3:]).apply(np.reshape(values, (-1, 3))) + wrist[:3]
    # Unity's z axis points the opposite way to that of right-handed axes.
    return HandFrame(index / 70.0, side, index, points * [1.0, 1.0, -1.0])
