"""Recordings of hands, as JSON lines or in other programs' formats, and their replay."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from airtact.errors import InvalidInput, about, file_fault, in_short, of_kind, path_of, positive
from airtact.files.atomic import whole_file
from airtact.files.bounded import check_file, json_of, text_of
from airtact.hands.tracking.formats import (
    Item,
    frames_of_actions,
    frames_of_matrices,
    frames_of_streamer,
)
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.hands.tracking.messages import from_json, to_json
from airtact.hands.tracking.stream import HandStream, StreamHealth

# File name extension of recordings, and extensions of recordings of other programs.
ENDING = ".jsonl"
OTHER_ENDINGS = (".json", ".txt")


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of a recording, as returned by ``load_recording``, for example for ``RecordedHands``.

    Attributes
    ----------
    frames : valid frames as ``HandFrame`` objects in the order of the file, in the tracker's
        coordinates.
    health : ``StreamHealth`` with the counts of the frames in the file and of their faults.
    note : remark on data that the file's format lacks, or on anything unusual in the frames; "" if
        there is none.
    """

    frames: tuple[HandFrame, ...]
    health: StreamHealth
    note: str = ""

    __repr__ = in_short


def load_recording(path: str | Path, leave_out: bool = False) -> Recording:
    """Read a recording of tracked hands.

    Parameters
    ----------
    path : a file of one of these formats, which may contain frames of one hand or of both:
        one frame per line as JSON (``.jsonl``; see ``to_json``), as written by ``save_recording``
        and ``live.record``; an action recording by IWER (``.json``); messages of vuer or
        VisionProTeleop with the matrices of joints, in a JSON list (``.json``); or lines of text
        from hand-tracking-streamer (``.txt``).
    leave_out : whether faulty frames are omitted and counted, as by a ``HandStream``. By default,
        a single faulty frame makes the file invalid.

    Returns
    -------
    A ``Recording`` with the valid frames in the order of the file and in the tracker's coordinates,
    the counts of faulty frames, and a note on data that the format lacks. If messages have no
    times, 60 frames per second are assumed, and 70 for ``.txt``. ``replay`` plays the frames.

    Raises
    ------
    InvalidInput
        If the file is unreadable, has another format or ending, or has no valid frame, or if a
        frame is faulty and ``leave_out`` is False. The message begins with the name of the file and
        states the line or frame.
    """
    path = path_of(path, "the path of a recording")
    if path.suffix not in (ENDING, *OTHER_ENDINGS):
        raise InvalidInput(
            f"{path.name}: the name of a recording must end in {ENDING} (or in .json or .txt if "
            f"another program wrote it), not in {path.suffix!r}.",
            code="unknown_format",
        )
    check_file(path)
    now = 0.0
    frames: list[HandFrame] = []
    stream = HandStream(on_frame=frames.append, clock=lambda: now)
    note = ""
    with about(path.name):
        if path.suffix == ENDING:
            items = _lines(path)
        else:
            items, note = _of_other_program(path)
        for place, frame_of in items:
            # The stream counts faults as it does live.
            try:
                frame = frame_of()
            except FaultyFrame as unreadable:
                fault = stream.feed(unreadable)
            else:
                now = frame.time
                fault = stream.feed(frame)
            if fault is not None and not leave_out:
                raise InvalidInput(f"{place}: {fault}", fault.position, code=fault.code)
        if not frames:
            raise InvalidInput(f"the file has no valid frame ({stream.health}).", code="empty")
        return Recording(tuple(frames), stream.health, note or stream.remark())


def is_recording(path: Path) -> bool:
    """Return whether a file is a recording; ``.json`` files are read, because they may be poses."""
    if path.suffix != ".json":
        return path.suffix in (ENDING, *OTHER_ENDINGS)
    try:
        values = json_of(text_of(path))
    except (ValueError, RecursionError):  # the reader of poses explains the fault
        return False
    return isinstance(values, dict) and "positions_m" not in values and bool(values)


def _of_other_program(path: Path) -> tuple[list[Item], str]:
    """Read another program's recording; also return a note on data that its format lacks."""
    text = text_of(path)
    try:
        if path.suffix == ".txt":
            return (
                list(frames_of_streamer(text.splitlines())),
                "no times: 70 frames per second are assumed",
            )
        values = json_of(text)
        if "frames" in values:
            return list(frames_of_actions(values)), "rounded to 1 mm, which reduces the pressure"
        items = list(frames_of_matrices(values if isinstance(values, list) else [values]))
        if items:
            return items, ""
        problem = "it has neither frames nor matrices"
    except (AttributeError, IndexError, KeyError, RecursionError, TypeError, ValueError) as error:
        problem = repr(error)
    raise InvalidInput(
        f"the file is not a recording from IWER, vuer or VisionProTeleop: {problem}.",
        code="unknown_format",
    )


def save_recording(path: str | Path, frames: Iterable[HandFrame]) -> None:
    """Write frames of tracked hands to a file, which ``load_recording`` reads.

    The file has one line per frame, as written by ``to_json``. An existing file is replaced once
    the new one is complete.

    Parameters
    ----------
    path : file name that ends in ``.jsonl``.
    frames : frames in the order of their arrival; those of both hands may alternate. They are
        not changed, except that coordinates are rounded to micrometres.

    Raises
    ------
    InvalidInput
        If there are no frames, the file name does not end in ``.jsonl``, or the file cannot be
        written.
    """
    path = path_of(path, "the path of a recording")
    frames = tuple(of_kind(frames, Iterable, "the frames", "a list of HandFrame"))
    if path.suffix != ENDING or not frames:
        raise InvalidInput(
            f"{len(frames)} frames cannot be written to {path.name}: use at least one frame, and "
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
    """Yield the frames of a recording at the intervals at which they were recorded.

    Parameters
    ----------
    frames : frames in chronological order, such as ``load_recording(path).frames``.
    speed : playback speed above 0; 2 is twice as fast, and infinity plays without pauses. 1 by
        default.
    clock : function that returns the time [s]; by default ``time.monotonic``.
    sleep : function that waits for a number of seconds; by default ``time.sleep``.

    Yields
    ------
    The unchanged ``HandFrame`` objects: the first immediately, and each later one when its time has
    come. Overdue frames are yielded immediately.

    Raises
    ------
    InvalidInput
        When the first frame is requested, if the speed is not above zero.
    """
    if speed != np.inf:
        positive(speed, "the speed of a replay", "times that of the recording")
    begun = start = None
    for frame in of_kind(frames, Iterable, "the frames", "a list of HandFrame"):
        if begun is None or start is None:
            begun = clock()
            start = frame.time
        # Times count from the first frame, so that errors of the waits do not accumulate.
        early = (frame.time - start) / speed - (clock() - begun)
        if early > 0.0:
            sleep(early)
        yield frame


def _lines(path: Path) -> Iterator[Item]:
    try:
        with path.open("rb") as file:
            # The line length is limited because a file without line breaks would fill the memory.
            lines = iter(lambda: file.readline(2**26), b"")
            for number, line in enumerate(lines, 1):
                if line.strip():
                    yield f"line {number}", partial(from_json, line)
    except OSError as error:
        raise file_fault(path, error) from None
