"""Stream of received frames; faulty frames are counted and omitted.

A ``HandStream`` is fed from any number of threads and stores the newest valid frame of each hand,
not a queue, so a slow reader gets the newest frame. If the tracker loses a hand or sends nothing
for a while, the newest frame is a ``lost`` one.
"""

import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from threading import Condition

from airtact.errors import positive
from airtact.hands.hand import Side
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.hands.tracking.messages import from_json

# Number of successive frames older than the newest one after which the tracker has restarted.
MAX_STALE_FRAMES = 20

# Jump of the sequence number above which the tracker has restarted.
MAX_JUMP = 1000


@dataclass(frozen=True)
class StreamHealth:
    """Counts of received frames and of their faults.

    Only frames counted in ``used`` are returned.

    Attributes
    ----------
    received : frames and other messages.
    used : valid frames, including those of lost hands.
    lost : losses of a hand, reported by the tracker or detected by its silence.
    unreadable : messages that are not frames.
    half_lost : frames with NaN, infinite or missing coordinates.
    unknown_count : frames with neither 25 nor 21 landmarks.
    not_metres : frames that span more than a metre, probably in millimetres.
    impossible : frames with implausible bone lengths.
    mirrored : frames labelled as the other hand.
    repeated : duplicate frames.
    out_of_order : frames with a lower number than an earlier frame.
    backwards : frames with a higher number but not a later time.
    skipped : missing frames, by their numbers.
    restarted : restarts of a tracker.
    interrupted : connections that ended without being closed.
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
    """State of one hand: its newest frame, the arrival time, and whether a reader has taken it.

    ``recent`` contains sequence numbers and times, to distinguish duplicate frames from those out
    of order. ``stale`` counts successive frames, up to ``last_stale``, that are in order but older
    than the newest one.
    """

    newest: HandFrame | None = None
    arrived: float = 0.0
    taken: bool = True
    silent: bool = False
    recent: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=256))
    last_stale: HandFrame | None = None
    stale: int = 0


class HandStream:
    """The newest valid frame of each hand.

    Parameters
    ----------
    silence : time without frames after which a hand is lost [s].
    on_frame : called with every used frame, in order, in the thread that received it.
    clock : function that returns the time [s]; the system clock by default.

    Raises
    ------
    InvalidInput
        If the silence is not above zero.
    """

    def __init__(
        self,
        silence: float = 0.3,
        on_frame: Callable[[HandFrame], None] = lambda frame: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._silence = positive(silence, "silence", "s")
        self._on_frame = on_frame
        self._clock = clock
        self._changed = Condition()
        self._counts: Counter[str] = Counter()
        self._hands: dict[Side, _TrackedHand] = {"left": _TrackedHand(), "right": _TrackedHand()}

    @property
    def health(self) -> StreamHealth:
        """Counts up to now."""
        with self._changed:
            self._notice_silence()
            return StreamHealth(**self._counts)

    def feed_json(self, text: bytes | str) -> FaultyFrame | None:
        """Process a message in JSON; return its fault, or None if it is used."""
        try:
            return self.feed(from_json(text))
        except FaultyFrame as fault:
            return self.feed(fault)

    def feed(self, frame: HandFrame | FaultyFrame) -> FaultyFrame | None:
        """Process a frame, or the fault of an unreadable one.

        Returns
        -------
        The fault, for example that it is not newer than the last frame of its hand, or None if the
        frame is used.
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
        """Return the newest frame of a hand: a lost one after silence, None if there was none."""
        with self._changed:
            self._notice_silence()
            return self._hands[side].newest

    def wait(self, timeout: float) -> HandFrame | None:
        """Wait for a new frame, the newest of its hand.

        Parameters
        ----------
        timeout : longest wait [s].

        Returns
        -------
        The frame of the hand that has waited longest, which may be lost. None after the timeout.
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
                # Silence does not wake this thread, so check for it.
                self._changed.wait(min(left, self._silence / 4))

    def _fault_in_order(self, frame: HandFrame, hand: _TrackedHand) -> FaultyFrame | None:
        """Check the order of a frame and detect restarts of the tracker; return a fault or None."""
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
            return FaultyFrame("repeated", f"{name} was already received; send it once.")
        last = hand.last_stale
        follows = last is not None and frame.sequence > last.sequence and frame.time > last.time
        hand.stale = hand.stale + 1 if follows else 1
        hand.last_stale = frame
        # A restarted tracker starts its numbers and times again. Stray old frames are rarely in
        # order.
        if hand.silent or hand.stale >= MAX_STALE_FRAMES:
            self._counts["restarted"] += 1
            hand.recent.clear()
            return None
        if step <= 0:
            # It was already counted as skipped.
            self._counts["skipped"] = max(self._counts["skipped"] - 1, 0)
            return FaultyFrame(
                "out_of_order", f"{name} arrived after frame {newest.sequence}; send them in order."
            )
        return FaultyFrame(
            "backwards",
            f"the time of {name} is {frame.time:g} s, not later than the {newest.time:g} s of the "
            "frame before; use increasing times.",
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
            # A frame without landmarks and cloud is a lost one.
            hand.newest = HandFrame(newest.time, side, newest.sequence)
            hand.taken = False
            hand.silent = True
            self._counts["lost"] += 1
            self._changed.notify_all()
