"""Recordings of hands: JSON lines, one frame in a line as it comes over a wire, or NumPy's .npz.

Also their replay, and where the pads of the fingers were.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from airtact.checks import counted, fixed, positive
from airtact.errors import LARGEST_DATA, InvalidInput, about
from airtact.files.atomic import whole_file
from airtact.files.bounded import Arrays, arrays_of, check_file
from airtact.hands.hand import Side
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.hands.tracking.messages import from_json, to_json
from airtact.hands.tracking.stream import HandStream, StreamHealth
from airtact.printing import in_short

ENDINGS = (".jsonl", ".npz")
"""Endings of recordings."""

ARRAYS = ("time", "right", "sequence", "landmark_counts", "landmarks", "cloud_counts", "clouds")
"""What .npz holds: for each frame its time [s], whether it is a right hand, its number, how many landmarks and how many
points of a cloud it has; and all landmarks and all points, one after the other (number, 3) [m]."""

VERSION = 1
"""Version of the .npz format, in its array ``format_version``; files of version 0 have none."""

LONGEST_LINE = 2**26
"""Lines of a recording are no longer [bytes]."""


@dataclass(frozen=True, eq=False)
class Recording:
    """What was read from a recording.

    Attributes
    ----------
    frames : in the order of the file.
    health : what was in the file, and what was wrong with it; lateness is not known from a file.
    """

    frames: tuple[HandFrame, ...]
    health: StreamHealth

    __repr__ = in_short


def load_recording(path: Path, leave_out: bool = False) -> Recording:
    """Read a recording.

    Parameters
    ----------
    path : a file of JSON lines, ``.jsonl``, or of NumPy, ``.npz``.
    leave_out : whether faulty frames are left out and counted, as a stream does, instead of
        rejecting the file at the first.

    Raises
    ------
    InvalidInput
        The file cannot be read, or holds no frame, or one that cannot be used: which and why, beginning with the
        file's name.
    """
    if path.suffix not in ENDINGS:
        sentence = f"{path.name}: the ending {path.suffix!r} is not 1 of those of recordings: {', '.join(ENDINGS)}."
        raise InvalidInput(sentence, code="unknown_format")
    check_file(path)
    arrays = arrays_of(path) if path.suffix == ".npz" else None
    with about(path.name):
        now = 0.0
        stream = HandStream(clock=lambda: now)
        frames = []
        for where, frame_in in _lines(path) if arrays is None else _entries(arrays):
            try:
                frame = frame_in()
            except FaultyFrame as unreadable:
                fault = stream.feed(unreadable)
            else:
                now = frame.time
                fault = stream.feed(frame)
                frames += [frame] if fault is None else []
            if fault is not None and not leave_out:
                raise InvalidInput(f"{where}: {fault}", fault.position, code=fault.code)
        if not frames:
            raise InvalidInput(
                f"there are 0 frames of a hand that can be used ({stream.health}).",
                code="empty",
            )
        return Recording(tuple(frames), stream.health)


def save_recording(path: Path, frames: Iterable[HandFrame]) -> None:
    """Write a recording; the file appears only once it is whole.

    Parameters
    ----------
    path : ends in ``.jsonl``, which rounds to micrometres, or ``.npz``, which does not.
    frames : in the order in which they came.

    Raises
    ------
    InvalidInput
        When there are no frames, or the ending is another one.
    """
    kept = tuple(frames)
    if path.suffix not in ENDINGS or not kept:
        raise InvalidInput(
            f"{counted(len(kept), 'frame', 'frames')} cannot be written to {path.name}: give at least 1, and an ending "
            f"of {' or '.join(ENDINGS)}.",
            code="not_writable",
        )
    with whole_file(path) as unfinished, unfinished.open("wb") as file:
        if path.suffix == ".jsonl":
            file.writelines(to_json(frame) + b"\n" for frame in kept)
        else:
            np.savez_compressed(file, allow_pickle=False, **_arrays(kept))


def replay(frames: Iterable[HandFrame], speed: float = 1.0) -> Iterator[HandFrame]:
    """Give frames at the times at which they were taken.

    Parameters
    ----------
    frames : of a recording.
    speed : 2 is twice as fast; infinity does not wait.

    Yields
    ------
    Each frame, not before its time: a reader who is slow gets those that are due at once.

    Raises
    ------
    InvalidInput
        When the speed is not above zero.
    """
    if speed != np.inf:
        positive(speed, "the speed of a replay", "times that of the recording")
    began = start = None
    for frame in frames:
        if began is None or start is None:
            began, start = time.monotonic(), frame.time
        early = (frame.time - start) / speed - (time.monotonic() - began)
        if early > 0.0:
            time.sleep(early)
        yield frame


Entries = Iterator[tuple[str, Callable[[], HandFrame]]]
"""Where in a file each frame stands, and what makes it or raises its fault."""


def _lines(path: Path) -> Entries:
    try:
        with path.open("rb") as file:
            for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), b""), start=1):
                if line.strip():
                    yield f"line {number}", partial(from_json, line)
    except OSError as error:
        raise InvalidInput(
            f"the recording cannot be read: {error.strerror}.", code="file_unreadable"
        ) from None


def _entries(arrays: Arrays) -> Entries:
    _check_arrays(arrays)
    ends = [
        np.cumsum(arrays[name].astype(np.int64)) for name in ("landmark_counts", "cloud_counts")
    ]
    for index, (taken, right, sequence) in enumerate(
        zip(*(arrays[name] for name in ARRAYS[:3]), strict=True)
    ):
        parts = []
        for name, end in zip(("landmarks", "clouds"), ends, strict=True):
            start = end[index - 1] if index else 0
            parts.append(arrays[name][start : end[index]] if end[index] > start else None)
        side = "right" if right else "left"
        yield f"frame {index + 1}", partial(HandFrame, float(taken), side, int(sequence), *parts)


def _check_arrays(arrays: Arrays) -> None:
    version = arrays["format_version"].tolist() if "format_version" in arrays else 0
    if version not in range(VERSION + 1):
        sentence = f"the recording is of version {version}, and versions 0 to {VERSION} are read: update airtact."
        raise InvalidInput(sentence, code="unsupported_version")
    missing = [name for name in ARRAYS if name not in arrays]
    if missing:
        are = counted(len(missing), "array is", "arrays are")
        raise InvalidInput(f"{are} missing, the first is {missing[0]}.", code="data_missing")
    for name in ("landmark_counts", "cloud_counts"):
        counts = arrays[name] if arrays[name].dtype.kind in "iu" else np.zeros(0, dtype=np.int64)
        least, most = int(counts.min(initial=0)), int(counts.max(initial=0))
        if least < 0 or most > LARGEST_DATA:
            wrong = least if least < 0 else most
            raise InvalidInput(
                f"{name} holds a count of {wrong}; write the recording anew.", code="out_of_range"
            )
    count = len(arrays["time"]) if arrays["time"].ndim == 1 else 0
    counts = {"landmarks": "landmark_counts", "clouds": "cloud_counts"}
    for name in ARRAYS:
        one = arrays[name]
        shape = (int(arrays[counts[name]].sum()), 3) if name in counts else (count,)
        if one.shape != shape or one.dtype.kind not in (
            "fiu" if name in counts or name == "time" else "iub"
        ):
            sentence = f"{name} has shape {one.shape} and type {one.dtype}, but {count} frames need {shape}."
            raise InvalidInput(sentence, code="wrong_shape")


def _arrays(
    frames: tuple[HandFrame, ...],
) -> dict[str, Float64[np.ndarray, "..."] | Int64[np.ndarray, "..."]]:
    landmarks = [
        np.empty((0, 3)) if frame.landmarks is None else frame.landmarks for frame in frames
    ]
    clouds = [np.empty((0, 3)) if frame.cloud is None else frame.cloud for frame in frames]
    return {
        "format_version": np.array(VERSION),
        "time": np.array([frame.time for frame in frames], dtype=np.float64),
        "right": np.array([frame.side == "right" for frame in frames], dtype=np.int64),
        "sequence": np.array([frame.sequence for frame in frames], dtype=np.int64),
        "landmark_counts": np.array([len(one) for one in landmarks], dtype=np.int64),
        "landmarks": np.concatenate(landmarks),
        "cloud_counts": np.array([len(one) for one in clouds], dtype=np.int64),
        "clouds": np.concatenate(clouds),
    }


# --- pads over the frames -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PadTrack:
    """Where the pads of one hand were.

    Attributes
    ----------
    side : ``"left"`` or ``"right"``.
    times : (N,) of the frames [s].
    sequences : (N,) their numbers.
    pads : (N, 5, 3) the pads, thumb to little finger [m]; NaN where the hand was lost or had no
        landmarks.
    """

    side: Side
    times: Float64[np.ndarray, "frames"]
    sequences: Float64[np.ndarray, "frames"]
    pads: Float64[np.ndarray, "frames 5 3"]

    __repr__ = in_short

    @property
    def fastest(self) -> float:
        """Largest speed of a pad from one frame to the next [m/s]; 0 where there are no two with landmarks."""
        ways = np.linalg.norm(np.diff(self.pads, axis=0), axis=2)
        speeds = ways / np.diff(self.times)[:, None]
        return float(np.nanmax(speeds)) if np.isfinite(speeds).any() else 0.0

    @property
    def longest_gap(self) -> float:
        """Longest time between two frames that follow each other with landmarks [s]; 0 where there are no two."""
        seen = self.times[np.isfinite(self.pads[:, 0, 0])]
        return float(np.diff(seen).max()) if len(seen) > 1 else 0.0


def pads_over_time(frames: Iterable[HandFrame], side: Side) -> PadTrack:
    """Find the pads of a hand in every frame; the radii of the skin are those of the first frame's hand.

    Raises
    ------
    InvalidInput
        When no frame is of that hand.
    """
    own = [frame for frame in frames if frame.side == side]
    if not own:
        raise InvalidInput(f"0 frames are of a {side} hand; take the other one.", code="empty")
    radii, pads = None, np.full((len(own), 5, 3), np.nan)
    for index, frame in enumerate(own):
        if frame.landmarks is not None:
            hand = frame.hand(radii)
            radii, pads[index] = hand.radii, hand.pads
    times, sequences = [frame.time for frame in own], [float(frame.sequence) for frame in own]
    return PadTrack(side, fixed(np.array(times)), fixed(np.array(sequences)), fixed(pads))
