"""Where the hands of the live loop come from: a recording at its own times, or trackers by socket."""

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from threading import Event, Lock, Thread

import numpy as np

from airtact.checks import positive
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose, nearest_motion
from airtact.hands.hand import Hand
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.receivers import OscReceiver, WebSocketReceiver
from airtact.hands.tracking.recordings import Recording
from airtact.hands.tracking.stream import HandStream

PALM = (0, 5, 6, 10, 11, 15, 16, 20, 21)
"""Joints that hardly move against each other: the wrist and both ends of the metacarpals."""

EARLY = 1024
"""Frames that came before ``begin`` and are kept for it at most, the newest ones."""


class HandSource(ABC):
    """Feeds a stream with frames, in the frame of the scene, from ``begin`` to ``close``.

    Attributes
    ----------
    words : where the frames come from, in words.
    ended : whether no more frames will come.
    """

    words: str
    ended: bool = False

    @abstractmethod
    def begin(self, on_frame: Callable[[HandFrame, float], None]) -> HandStream:
        """Begin; ``on_frame`` is called with every frame that is used and the computer's time of its arrival [s]."""

    @abstractmethod
    def close(self) -> None:
        """End what runs."""


def _stream(on_frame: Callable[[HandFrame, float], None]) -> HandStream:
    return HandStream(on_frame=lambda frame: on_frame(frame, time.monotonic()))


class RecordedHands(HandSource):
    """A recording, each frame delivered at its own time.

    Parameters
    ----------
    recording : as ``load_recording`` gives it.
    loop : whether it begins again at its end, with times that go on.

    Raises
    ------
    InvalidInput
        If a recording of 1 frame is to be played in a loop.
    """

    def __init__(self, recording: Recording, loop: bool = False) -> None:
        self.frames: tuple[HandFrame, ...] = recording.frames
        self._loop = loop
        if loop and len(self.frames) < 2:
            raise InvalidInput(
                "1 frame cannot be played in a loop: give 2 or more.", code="too_few"
            )
        self.words: str = f"{len(self.frames)} recorded frames{', again and again' if loop else ''}"
        self._closed = Event()
        self._thread: Thread | None = None

    def begin(self, on_frame: Callable[[HandFrame, float], None]) -> HandStream:
        """Begin with the first frame at once."""
        stream = _stream(on_frame)
        self._thread = Thread(
            target=self._play, args=(stream,), name="airtact recording", daemon=True
        )
        self._thread.start()
        return stream

    def close(self) -> None:
        """Stop between two frames."""
        self._closed.set()
        if self._thread is not None:
            self._thread.join()

    def _play(self, stream: HandStream) -> None:
        began = time.monotonic()
        start = self.frames[0].time
        for frame in self._endless() if self._loop else self.frames:
            if self._closed.wait(max(frame.time - start - (time.monotonic() - began), 0.0)):
                return
            stream.feed(frame)
        self.ended = True

    def _endless(self) -> Iterator[HandFrame]:
        frames = self.frames
        times = np.array([frame.time for frame in frames])
        lasts = times[-1] - times[0] + float(np.median(np.diff(times)))
        counts = frames[-1].sequence - min(frame.sequence for frame in frames) + 1
        turn = 0
        while True:
            for frame in frames:
                yield replace(
                    frame, time=frame.time + turn * lasts, sequence=frame.sequence + turn * counts
                )
            turn += 1


class ReceivedHands(HandSource):
    """Trackers that send frames to a socket of this computer.

    Parameters
    ----------
    kind : "websocket" or "osc".
    port : to listen at; 0 takes a free one.
    tracker : where the tracker stands, from its frame to the scene's.
    every : whether frames that are overtaken while they wait are used too, as for a recording.

    Raises
    ------
    InvalidInput
        The port is taken, or the extra is not installed.
    """

    def __init__(
        self, kind: str, port: int, tracker: Pose | None = None, every: bool = False
    ) -> None:
        receivers = {"websocket": WebSocketReceiver, "osc": OscReceiver}
        if kind not in receivers:
            raise InvalidInput(
                f"{kind!r} is not 1 of {len(receivers)} sockets: websocket, osc.",
                code="unknown_name",
            )
        self._early: deque[tuple[HandFrame, float]] = deque(maxlen=EARLY)
        self._on_frame: Callable[[HandFrame, float], None] | None = None
        self._lock = Lock()
        self._stream = _MovedStream(tracker, self._arrived, every)
        self._receiver = receivers[kind](self._stream, port)
        scheme = "ws://" if kind == "websocket" else "OSC at "
        self.words: str = f"{scheme}127.0.0.1:{self._receiver.port}"

    def begin(self, on_frame: Callable[[HandFrame, float], None]) -> HandStream:
        """Hand on the frames that came since this was made, which opened the socket, and all that come."""
        with self._lock:
            self._on_frame = on_frame
            while self._early:
                on_frame(*self._early.popleft())
        return self._stream

    def close(self) -> None:
        """Stop listening."""
        self._receiver.close()

    def _arrived(self, frame: HandFrame) -> None:
        with self._lock:
            if self._on_frame is None:
                self._early.append((frame, time.monotonic()))
            else:
                self._on_frame(frame, time.monotonic())


class PageHands(HandSource):
    """The hand that is dragged on the page.

    Attributes
    ----------
    stream : what the page feeds.
    """

    words: str = "the hand on the page"

    def __init__(self) -> None:
        self._on_frame: Callable[[HandFrame, float], None] = lambda frame, arrived: None
        self.stream: HandStream = _stream(lambda frame, arrived: self._on_frame(frame, arrived))

    def begin(self, on_frame: Callable[[HandFrame, float], None]) -> HandStream:
        """Hand frames on from now."""
        self._on_frame = on_frame
        return self.stream

    def close(self) -> None:
        """End nothing: the page ends by itself."""


class _MovedStream(HandStream):
    """A stream whose frames are moved from the tracker's frame to the scene's."""

    def __init__(
        self, pose: Pose | None, on_frame: Callable[[HandFrame], None], every: bool
    ) -> None:
        super().__init__(on_frame=on_frame, every=every)
        self._pose = pose

    def feed(self, frame):
        if self._pose is not None and isinstance(frame, HandFrame):
            frame = frame.moved(self._pose)
        return super().feed(frame)


def moved_to(recording: Recording, hand: Hand) -> Recording:
    """Move a recorded hand of 25 landmarks so that its palm is where another hand's is, mirrored if needed."""
    seen = [frame for frame in recording.frames if frame.landmarks is not None]
    mirror = np.array([1.0, 1.0, 1.0 if seen[0].side == hand.side else -1.0])
    palm = np.mean(
        [mirror * frame.landmarks[list(PALM)] for frame in seen if frame.landmarks is not None],
        axis=0,
    )
    pose = Pose(*nearest_motion(palm, hand.joints[list(PALM)]))

    def moved(frame: HandFrame) -> HandFrame:
        landmarks = None if frame.landmarks is None else pose.apply(frame.landmarks * mirror)
        return replace(frame, side=hand.side, landmarks=landmarks, cloud=None)

    return replace(recording, frames=tuple(moved(frame) for frame in recording.frames))


def checked_seconds(seconds: float | None) -> float:
    """Return how long to go on [s], infinity where None is given; raise as ``positive``."""
    return np.inf if seconds is None else positive(seconds, "how long to go on", "s")
