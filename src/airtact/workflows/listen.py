"""From trackers on this computer to a recording of hands. Prints nothing."""

import time
from contextlib import ExitStack
from pathlib import Path

from airtact.checks import within
from airtact.errors import InvalidInput
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.receivers import OscReceiver, WebSocketReceiver
from airtact.hands.tracking.recordings import ENDINGS, save_recording
from airtact.hands.tracking.stream import HandStream, StreamHealth
from airtact.timing import Progress, no_progress

LONGEST = 86_400.0
"""Longest time to listen [s], a day."""


def listen(
    file: Path,
    seconds: float,
    websocket: int = 8765,
    osc: int | None = None,
    report_step: Progress = no_progress,
) -> StreamHealth:
    """Record the frames that trackers send, until the time is over or Ctrl-C ends it early.

    Port 0 takes a free one, and None for ``osc`` listens to none; the first step that is reported
    names the ports.

    Raises
    ------
    InvalidInput
        The time or the file's ending is at fault, a port is taken, or no frame came.
    """
    within(seconds, 1e-3, LONGEST, "the time to listen", "s", "Ctrl-C ends it early.")
    if file.suffix not in ENDINGS:
        raise InvalidInput(
            f"the ending {file.suffix!r} is not 1 of those of recordings: {', '.join(ENDINGS)}.",
            code="unknown_format",
        )
    frames: list[HandFrame] = []
    stream = HandStream(on_frame=frames.append, every=True)
    with ExitStack() as sockets:
        ports = [
            f"ws://127.0.0.1:{sockets.enter_context(WebSocketReceiver(stream, websocket)).port}"
        ]
        if osc is not None:
            ports.append(f"OSC at 127.0.0.1:{sockets.enter_context(OscReceiver(stream, osc)).port}")
        begun = time.monotonic()
        try:
            report_step(f"listening for {seconds:g} s: {', '.join(ports)}")
            time.sleep(seconds)
        except KeyboardInterrupt:
            report_step("interrupted; the frames received so far are recorded")
        listened = time.monotonic() - begun
    if not frames:
        raise InvalidInput(
            f"0 frames were received in {listened:.3g} s ({', '.join(ports)}; {stream.health}): does the tracker send "
            "there?",
            code="empty",
        )
    save_recording(file, frames)
    return stream.health
