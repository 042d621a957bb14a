"""A stream of frames as it comes over a wire: faulty frames are counted and left out.

A ``HandStream`` takes messages, from as many threads as there are, and keeps the newest good frame
of each hand: a slow reader gets the latest, never a queue. A hand that the tracker no longer sees,
or of which nothing has come for a while, is an event: a frame that is ``lost``.
"""

import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from threading import Condition

from airtact.errors import positive
from airtact.hands.hand import Side
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.hands.tracking.messages import from_json, from_osc, side_of

# Successive frames that do not follow the newest one; more mean that the tracker restarted.
MAX_STALE_FRAMES = 20

# Largest jump of the sequence number; a larger one is a new count.
MAX_JUMP = 1000


@dataclass(frozen=True)
class StreamHealth:
    """Counts of received frames, and of what was wrong with them.

    Attributes
    ----------
    received : frames and other messages that came.
    used : frames that were handed on, those of lost hands included.
    lost : times that a hand was lost, reported by the tracker or concluded from its silence.
    unreadable : messages that are no frame.
    half_lost : frames with NaN, infinite or missing coordinates; left out.
    unknown_count : frames with neither 25 nor 21 landmarks; left out.
    not_metres : frames that span more than a metre, as millimetres do; left out.
    impossible : frames with bones longer or shorter than any; left out.
    mirrored : frames labelled as the other hand; left out.
    repeated : frames that had come before; left out.
    out_of_order : frames older than one that had come before; left out.
    backwards : frames with a later number but no later time; left out.
    overtaken : frames that waited while newer ones of the same hand came; left out, not even read.
    skipped : frames missing between those that came.
    restarted : times that a tracker restarted.
    interrupted : connections that ended without being closed, as with a tracker that is killed.
    """

    received: int = 0
    used: int = 0
    lost: int = 0
    unreadable: int = 0
    half_lost: int = 0
    unknown_count: int = 0
    not_metres: int = 0
    impossible: int = 0
    mirrored: int = 0
    repeated: int = 0
    out_of_order: int = 0
    backwards: int = 0
    overtaken: int = 0
    skipped: int = 0
    restarted: int = 0
    interrupted: int = 0

    def __str__(self) -> str:
        counts = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return ", ".join(
            f"{count:,} {name.replace('_', ' ')}"
            for name, count in counts.items()
            if count or name == "received"
        )


@dataclass(eq=False)
class _TrackedHand:
    """State of one hand: its newest frame, when that arrived, and whether a reader has taken it.

    ``recent`` has sequence numbers and times, to distinguish a repeated frame from one out of
    order; ``stale`` counts frames in a row, the last of which is ``last_stale``, that follow each
    other but not the newest one.
    """

    newest: HandFrame | None = None
    arrived: float = 0.0
    taken: bool = True
    silent: bool = False
    recent: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=256))
    last_stale: HandFrame | None = None
    stale: int = 0


class HandStream:
    """The newest good frame of each hand, out of messages of any quality.

    Parameters
    ----------
    silence : a hand of which nothing came for so long is lost [s].
    on_frame : called with every frame that is used, in order, by the thread that received it; to
        record them.
    every : whether frames that are overtaken while they wait are used too, as for a recording;
        without it those that are used are new even where frames come faster than they can be read.
    clock : returns the time [s]; the computer's own unless given, another one to replay a
        recording.

    Raises
    ------
    InvalidInput
        The silence is not above zero.
    """

    def __init__(
        self,
        silence: float = 0.3,
        on_frame: Callable[[HandFrame], None] = lambda frame: None,
        clock: Callable[[], float] = time.monotonic,
        every: bool = False,
    ) -> None:
        self._silence = positive(silence, "silence", "s")
        self._on_frame = on_frame
        self._clock = clock
        self._every = every
        self._changed = Condition()
        self._counts: Counter[str] = Counter()
        self._hands: dict[Side, _TrackedHand] = {"left": _TrackedHand(), "right": _TrackedHand()}

    @property
    def health(self) -> StreamHealth:
        """Counts of what came so far."""
        with self._changed:
            self._notice_silence()
            return StreamHealth(**self._counts)

    def feed_json(self, text: bytes | str) -> FaultyFrame | None:
        """Take any message in JSON; return why it was left out, or None if used."""
        try:
            return self.feed(from_json(text))
        except FaultyFrame as fault:
            return self.feed(fault)

    def feed_osc(self, packet: bytes) -> FaultyFrame | None:
        """Take any packet of OSC; return why its last frame was left out, or None."""
        try:
            faults = [self.feed(frame) for frame in from_osc(packet)]
        except FaultyFrame as fault:
            return self.feed(fault)
        return faults[-1] if faults else None

    def feed_waiting(self, messages: Sequence[bytes | str]) -> None:
        """Take messages in JSON that waited together, oldest first.

        The newest good frame of each hand is used. Older ones are counted as overtaken, unless
        ``every`` frame is used.
        """
        waiting: dict[Side, list[bytes | str]] = {"left": [], "right": []}
        for message in messages:
            side = None if self._every else side_of(message)
            if side is None:
                self.feed_json(message)
            else:
                waiting[side].append(message)
        for of_hand in waiting.values():
            skipped = self._counts["skipped"]
            # Newest first, until one is good.
            while of_hand and self.feed_json(of_hand.pop()) is not None:
                pass
            with self._changed:
                # Frames that are overtaken were not skipped by the tracker.
                newly_skipped = max(self._counts["skipped"] - skipped, 0)
                self._counts["skipped"] -= min(len(of_hand), newly_skipped)
                self._counts["received"] += len(of_hand)
                self._counts["overtaken"] += len(of_hand)

    def feed(self, frame: HandFrame | FaultyFrame) -> FaultyFrame | None:
        """Take a frame as the tracker gave it, or the fault of one that could not be read.

        Returns
        -------
        Why it was left out, which may be that it is not newer than the last one of its hand, or
        None where it is used.
        """
        with self._changed:
            self._counts["received"] += 1
            if isinstance(frame, FaultyFrame):
                self._counts[frame.fault] += 1
                return frame
            fault = self._fault_in_order(frame, self._hands[frame.side])
            if fault is not None:
                self._counts[fault.fault] += 1
                return fault
            self._use(frame, self._hands[frame.side])
            self._on_frame(frame)
            return None

    def interrupt(self) -> None:
        """Count a connection that ended without being closed."""
        with self._changed:
            self._counts["interrupted"] += 1

    def latest(self, side: Side) -> HandFrame | None:
        """Newest frame of a hand: a lost one after a silence, or None where none ever came."""
        with self._changed:
            self._notice_silence()
            return self._hands[side].newest

    def wait(self, timeout: float) -> HandFrame | None:
        """Wait for a frame that was not taken yet, the newest of its hand.

        Parameters
        ----------
        timeout : the longest wait [s].

        Returns
        -------
        The frame, of the hand that waits longest; lost hands included. None where nothing new came.
        """
        end = time.monotonic() + timeout
        with self._changed:
            while True:
                self._notice_silence()
                waiting = [hand for hand in self._hands.values() if not hand.taken]
                if waiting:
                    first = min(waiting, key=lambda hand: hand.arrived)
                    first.taken = True
                    return first.newest
                left = end - time.monotonic()
                if left <= 0.0:
                    return None
                # Nothing wakes this thread when a hand falls silent.
                self._changed.wait(min(left, self._silence / 4))

    def _fault_in_order(self, frame: HandFrame, hand: _TrackedHand) -> FaultyFrame | None:
        """Fault in the order of a frame among those before; notice a tracker that restarted."""
        newest = hand.newest
        if newest is None:
            return None
        step = frame.sequence - newest.sequence
        # The usual case: a later number and a later time.
        if step > 0 and frame.time > newest.time:
            if step > MAX_JUMP:
                self._counts["restarted"] += 1
            else:
                self._counts["skipped"] += step - 1
            return None
        name = f"frame {frame.sequence} of the {frame.side} hand"
        if (frame.sequence, frame.time) in hand.recent:
            return FaultyFrame("repeated", f"{name} had come before; leave it out.")
        last = hand.last_stale
        follows = last is not None and frame.sequence > last.sequence and frame.time > last.time
        hand.stale = hand.stale + 1 if follows else 1
        hand.last_stale = frame
        # A restarted tracker begins its count and its clock again; stray old frames do not follow
        # each other for long.
        if hand.silent or hand.stale >= MAX_STALE_FRAMES:
            self._counts["restarted"] += 1
            hand.recent.clear()
            return None
        if step <= 0:
            # It was counted as skipped, and came after all.
            self._counts["skipped"] = max(self._counts["skipped"] - 1, 0)
            return FaultyFrame(
                "out_of_order", f"{name} comes after frame {newest.sequence}; put them in order."
            )
        return FaultyFrame(
            "backwards",
            f"time goes back from {newest.time:g} to {frame.time:g} s at {name}; give each frame a "
            "later time than the one before.",
        )

    def _use(self, frame: HandFrame, hand: _TrackedHand) -> None:
        self._counts["lost"] += frame.lost and not (hand.newest is not None and hand.newest.lost)
        self._counts["used"] += 1
        hand.newest = frame
        hand.arrived = self._clock()
        hand.taken = False
        hand.silent = False
        hand.recent.append((frame.sequence, frame.time))
        hand.last_stale = None
        hand.stale = 0
        self._changed.notify_all()

    def _notice_silence(self) -> None:
        now = self._clock()
        for side, hand in self._hands.items():
            newest = hand.newest
            if newest is None or newest.lost or now - hand.arrived < self._silence:
                continue
            # A frame without landmarks and cloud means a lost hand.
            hand.newest = HandFrame(newest.time, side, newest.sequence)
            hand.taken = False
            hand.silent = True
            self._counts["lost"] += 1
            self._changed.notify_all()
