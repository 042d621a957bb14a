"""Sources of frames: a recording, trackers that send to a socket, or the page."""

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import count
from threading import Event, Lock, Thread

import numpy as np

from airtact.errors import InvalidInput, check_choice, of_kind, positive
from airtact.geometry.pose import Pose, nearest_motion
from airtact.hands.hand import Hand
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.recordings import Recording, load_recording
from airtact.hands.tracking.stream import HandStream, StreamHealth
from airtact.live.applications import ApplicationServer
from airtact.live.osc import OscServer
from airtact.live.world import World
from airtact.setup.examples import example
from airtact.touch.contacts import Contacts

# Callback that receives a frame and the time of its arrival by ``time.monotonic`` [s].
OnFrame = Callable[[HandFrame, float], None]


class HandSource:
    """Base class for sources that pass the frames of tracked hands to ``run`` and ``follow``.

    ``hands_from`` creates the source. ``run`` and ``follow`` call ``begin(on_frame)``, and later
    ``close()``. In between, the source calls ``on_frame(frame, arrival)`` with every valid frame in
    scene coordinates, and its time of arrival on the clock of ``time.monotonic`` [s]. Up to 1024
    frames that arrived before ``begin`` are passed on first.

    A subclass such as ``RecordedHands`` or ``ReceivedHands`` reads frames in the tracker's
    coordinates, passes them to ``stream.feed``, and sets ``ended`` after the last one. It overrides
    ``begin`` to start, ``close`` to stop, and optionally ``remark``. This class itself does not
    read frames. It is used for the hand that the user drags on the page, because the page passes
    the frames to ``stream``.

    Parameters
    ----------
    words : short description of the source, shown to the user.
    tracker : pose that maps the tracker's coordinates to those of the scene; by default, the
        identity.
    world : ``World`` with the objects and foci that applications change with messages; ``run``
        reads them from it. Empty by default.

    Attributes
    ----------
    words, world : the parameters of the same names.
    stream : ``HandStream`` that checks frames and transforms them to scene coordinates. It skips
        faulty frames without an exception, and counts them in ``stream.health``.
    ended : whether the source has delivered its last frame; always False in this class.
    """

    def __init__(self, words: str, tracker: Pose | None = None, world: World | None = None) -> None:
        self.words: str = of_kind(words, str, "the words", "a text")
        self.world: World = World() if world is None else world
        self.stream: HandStream = HandStream(on_frame=self._arrived, tracker=tracker)
        self.ended: bool = False
        # Keep the newest 1024 frames that arrive before ``begin``.
        self._early: deque[tuple[HandFrame, float]] = deque(maxlen=1024)
        self._on_frame: OnFrame | None = None
        self._lock = Lock()

    def begin(self, on_frame: OnFrame) -> HandStream:
        """Call ``on_frame`` with the frames received so far and with each later one.

        Parameters
        ----------
        on_frame : function called with each ``HandFrame``, in scene coordinates, and its time of
            arrival on the clock of ``time.monotonic`` [s]. It is called in the thread that feeds
            ``stream``.

        Returns
        -------
        The ``HandStream``, from which the newest frame can also be read.
        """
        with self._lock:
            self._on_frame = on_frame
            while self._early:
                on_frame(*self._early.popleft())
        return self.stream

    def remark(self) -> str:
        """Return a sentence about faulty or missing frames, or "" if there are none."""
        return self.stream.remark()

    def __enter__(self) -> "HandSource":
        return self

    def __exit__(self, *fault: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop the source."""

    def _arrived(self, frame: HandFrame) -> None:
        now = time.monotonic()
        with self._lock:
            if self._on_frame is None:
                self._early.append((frame, now))
            else:
                self._on_frame(frame, now)


class RecordedHands(HandSource):
    """Source of hands for ``follow`` that plays a recording with its original frame intervals.

    The frames must be in scene coordinates, because they are passed on unchanged.

    Parameters
    ----------
    recording : ``Recording``, as returned by ``load_recording``.
    loop : whether the recording restarts at its end; False by default. The timestamps and numbers
        of its frames then keep increasing.
    world : ``World`` of the objects and foci that applications can change; empty by default.

    Raises
    ------
    InvalidInput
        If ``loop`` is True and the recording has only one frame.
    """

    def __init__(
        self, recording: Recording, loop: bool = False, world: World | None = None
    ) -> None:
        self.frames: tuple[HandFrame, ...] = of_kind(
            recording, Recording, "the recording", "load_recording(path)"
        ).frames
        self._loop = loop
        if loop and len(self.frames) < 2:
            raise InvalidInput(
                "a single frame cannot be played in a loop: use a recording of at least 2 frames.",
                code="too_few",
            )
        words = f"{len(self.frames)} recorded frames{', repeated' if loop else ''}"
        super().__init__(words, world=world)
        self._closed = Event()
        self._thread = Thread(target=self._play, name="airtact recording", daemon=True)

    def begin(self, on_frame: OnFrame) -> HandStream:
        """Start playing the recording; the first frame is delivered at once."""
        stream = super().begin(on_frame)
        self._thread.start()
        return stream

    def close(self) -> None:
        """Stop playing before the next frame."""
        self._closed.set()
        if self._thread.ident is not None:
            # Ctrl-C may have interrupted a wait while it held the lock, so do not wait forever.
            self._thread.join(timeout=2.0)

    def _play(self) -> None:
        begun = time.monotonic()
        start = self.frames[0].time
        for frame in self._repeated() if self._loop else self.frames:
            if self._closed.wait(max(frame.time - start - (time.monotonic() - begun), 0.0)):
                return
            self.stream.feed(frame)
        self.ended = True

    def _repeated(self) -> Iterator[HandFrame]:
        """Yield the frames repeatedly, with continuing times and sequence numbers."""
        frames = self.frames
        times = np.array([frame.time for frame in frames])
        # The first frame of a round follows the last one of the previous round after the median
        # interval.
        duration = times[-1] - times[0] + float(np.median(np.diff(times)))
        numbers = frames[-1].sequence - min(frame.sequence for frame in frames) + 1
        for rounds in count():
            for frame in frames:
                yield replace(
                    frame,
                    time=frame.time + rounds * duration,
                    sequence=frame.sequence + rounds * numbers,
                )


class ReceivedHands(HandSource):
    """Source that receives messages from trackers and applications at a port of this computer.

    The port is opened when the object is created, and closed by ``close``. Pass the source to
    ``follow``, which starts and closes it.

    Parameters
    ----------
    port : port to listen on; 0 selects a free port.
    tracker : pose that maps the tracker's coordinates to those of the scene; by default, the
        identity.
    world : objects and foci that applications can change; empty by default.
    kind : protocol: "websocket", or "osc" for OSC over UDP.

    Attributes
    ----------
    port : port on which the source listens.

    Raises
    ------
    InvalidInput
        If the port is in use, the kind is unknown, or its optional package is not installed.
    """

    def __init__(
        self,
        port: int,
        tracker: Pose | None = None,
        world: World | None = None,
        kind: str = "websocket",
    ) -> None:
        super().__init__(kind, tracker, world)
        check_choice(kind, "the kind of socket", ("websocket", "osc"))
        osc = kind == "osc"
        self._server = (OscServer if osc else ApplicationServer)(self.stream, self.world, port)
        self.port: int = self._server.port
        self.words = f"{'OSC at ' if osc else 'ws://'}127.0.0.1:{self.port}"

    def remark(self) -> str:
        """Return a sentence about faulty frames, or about the lack of frames for 5 s."""
        if self.stream.idle > 5.0:
            return f"no frames at port {self.port}; is the tracker's program running?"
        return super().remark()

    def close(self) -> None:
        """Stop listening."""
        self._server.close()


def moved_to(recording: Recording, hand: Hand) -> Recording:
    """Move a recorded hand so that its palm matches that of another hand; mirror it if needed."""
    # The wrist and the ends of the metacarpals hardly move relative to each other.
    palm = [0, 5, 6, 10, 11, 15, 16, 20, 21]
    seen = [frame for frame in recording.frames if frame.landmarks is not None]
    mirror = np.array([1.0, 1.0, 1.0 if seen[0].side == hand.side else -1.0])
    joints = [mirror * frame.landmarks[palm] for frame in seen if frame.landmarks is not None]
    pose = Pose(*nearest_motion(np.mean(joints, axis=0), hand.joints[palm]))
    frames = [
        replace(
            frame,
            side=hand.side,
            landmarks=None if frame.landmarks is None else pose.apply(frame.landmarks * mirror),
            cloud=None,
        )
        for frame in recording.frames
    ]
    return replace(recording, frames=tuple(frames))


def touching_motion(contacts: Contacts, hands: Sequence[Hand]) -> Recording:
    """Return a recording of a hand that touches an object and moves away by 12 mm every 2 s.

    The recording has 60 frames per second. If no hand is given, the function returns the packaged
    recording of a small hand around the ball of the scene ``touch_ball``.
    """
    if not hands:
        return load_recording(example("grasping.jsonl"))
    skin = contacts.skin
    depths = [thing.depth(skin.points) for thing in contacts.virtual_objects]
    deepest = np.max(depths or [np.zeros(len(skin.points))], axis=0)
    nearest = int(deepest.argmax())
    # If the skin does not touch the object at rest, it moves on until it is 2 mm deep.
    reach = max(2e-3 - float(deepest[nearest]), 0.0)
    frames = []
    for index in range(120):
        away = reach - 6e-3 * (1.0 - np.cos(np.pi * index / 60.0))
        joints = hands[0].joints + away * skin.normals[nearest]
        frames.append(HandFrame(index / 60.0, hands[0].side, index, joints))
    return Recording(tuple(frames), StreamHealth(received=120, used=120))


def checked_seconds(seconds: float | None) -> float:
    """Return a duration [s], or infinity for None; raise ``InvalidInput`` if it is not above 0."""
    return np.inf if seconds is None else positive(seconds, "the duration", "s")
