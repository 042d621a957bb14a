"""Recordings of hands as JSON lines, and their replay."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airtact.errors import InvalidInput, about, file_fault, in_short, positive
from airtact.files.atomic import whole_file
from airtact.files.bounded import check_file
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.hands.tracking.messages import from_json, to_json
from airtact.hands.tracking.stream import HandStream, StreamHealth

# File name extension of recordings.
ENDING = ".jsonl"


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of a recording.

    Attributes
    ----------
    frames : frames in the order of the file.
    health : counts of frames and of faults in the file.
    """

    frames: tuple[HandFrame, ...]
    health: StreamHealth

    __repr__ = in_short


def load_recording(path: Path, leave_out: bool = False) -> Recording:
    """Read a recording.

    Parameters
    ----------
    path : a file of JSON lines, ``.jsonl``.
    leave_out : whether faulty frames are omitted and counted, as in a stream. Otherwise one faulty
        frame makes the file invalid.

    Raises
    ------
    InvalidInput
        If the file is unreadable, has no frames, or contains a faulty frame. The message begins
        with the name of the file and states the line.
    """
    if path.suffix != ENDING:
        raise InvalidInput(
            f"{path.name}: the name of a recording must end in {ENDING}, not in {path.suffix!r}.",
            code="unknown_format",
        )
    check_file(path)
    now = 0.0
    frames: list[HandFrame] = []
    stream = HandStream(on_frame=frames.append, clock=lambda: now)
    with about(path.name):
        for number, line in _lines(path):
            # The stream counts faults like in a live run.
            try:
                frame = from_json(line)
            except FaultyFrame as unreadable:
                fault = stream.feed(unreadable)
            else:
                now = frame.time
                fault = stream.feed(frame)
            if fault is not None and not leave_out:
                raise InvalidInput(f"line {number}: {fault}", fault.position, code=fault.code)
        if not frames:
            raise InvalidInput(f"it has no valid frame ({stream.health}).", code="empty")
        return Recording(tuple(frames), stream.health)


def save_recording(path: Path, frames: Iterable[HandFrame]) -> None:
    """Write a recording; the file appears only when it is complete.

    Parameters
    ----------
    path : a name that ends in ``.jsonl``; coordinates are rounded to micrometres.
    frames : frames in the order of their arrival.

    Raises
    ------
    InvalidInput
        If there are no frames, or the name has another ending.
    """
    frames = tuple(frames)
    if path.suffix != ENDING or not frames:
        raise InvalidInput(
            f"{len(frames)} frames cannot be written to {path.name}: give at least one frame, and "
            f"a name that ends in {ENDING}.",
            code="not_writable",
        )
    with whole_file(path) as unfinished, unfinished.open("wb") as file:
        file.writelines(to_json(frame) + b"\n" for frame in frames)


def replay(
    frames: Iterable[HandFrame],
    speed: float = 1.0,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[HandFrame]:
    """Yield frames at the times of their recording.

    Parameters
    ----------
    frames : frames of a recording.
    speed : playback speed; 2 is twice as fast, and infinity does not wait.
    clock : function that returns the time [s]; by default that of the system.
    sleep : function that waits for a time [s]; by default that of the system.

    Yields
    ------
    Each frame, not before its time. Overdue frames are yielded immediately.

    Raises
    ------
    InvalidInput
        If the speed is not above zero.
    """
    if speed != np.inf:
        positive(speed, "the speed of a replay", "times that of the recording")
    begun = start = None
    for frame in frames:
        if begun is None or start is None:
            begun = clock()
            start = frame.time
        # Times count from the first frame, so that errors of sleeping do not accumulate.
        early = (frame.time - start) / speed - (clock() - begun)
        if early > 0.0:
            sleep(early)
        yield frame


def _lines(path: Path) -> Iterator[tuple[int, bytes]]:
    try:
        with path.open("rb") as file:
            # Limit the line length: a file without line breaks would fill the memory.
            lines = iter(lambda: file.readline(2**26), b"")
            yield from ((number, line) for number, line in enumerate(lines, 1) if line.strip())
    except OSError as error:
        raise file_fault(path, error) from None
