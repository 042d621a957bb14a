"""A stream of frames as it comes over a wire: whatever is wrong with one is counted, and the next one is waited for.

A ``HandStream`` takes messages, from as many threads as there are, and keeps the newest good frame
of each hand: a slow reader gets the latest, never a queue. Frames that cannot be used are left out
and counted by what is wrong with them. A hand that the tracker no longer sees, or of which nothing
has come for a while, is an event: a frame that is ``lost``.
"""

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from threading import Condition
from typing import TypeVar

from airtact.checks import positive
from airtact.hands.hand import Side
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.hands.tracking.messages import from_json, from_osc, side_of, side_of_osc

RESTART = 20
"""So many frames in a row that follow each other, but not the newest one, are a tracker that began anew; after
a silence the first one is."""

FARTHEST = 1000
"""A sequence number may jump so far; farther is a new count."""

REMEMBERED = 256
"""Number of frames remembered, to distinguish a repeated frame from one out of order."""

DRIFT = 1e-3
"""Clocks of trackers may run faster or slower than ours by this share."""

_Message = TypeVar("_Message", bytes | str, bytes)


@dataclass(frozen=True)
class StreamHealth:
    """What came, and what was wrong with it.

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
    late : frames that came later than others after their time, but were used.
    skipped : frames missing between those that came.
    restarted : times that a tracker began anew.
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
    late: int = 0
    skipped: int = 0
    restarted: int = 0
    interrupted: int = 0

    def __str__(self) -> str:
        """List all counts that are not zero."""
        counts = [(one.name.replace("_", " "), getattr(self, one.name)) for one in fields(self)]
        return ", ".join(
            f"{count:,} {name}" for name, count in counts if count or name == "received"
        )


@dataclass(eq=False)
class _Seen:
    """What is known of one hand's frames so far."""

    newest: HandFrame | None = None
    arrived: float = 0.0
    given: bool = True
    silent: bool = False
    places: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    outlier: HandFrame | None = None
    outliers: int = 0


class HandStream:
    """The newest good frame of each hand, out of messages of any quality.

    Parameters
    ----------
    patience : a frame that takes longer on its way than the quickest one by more than this is
        counted as late [s].
    silence : a hand of which nothing came for so long is lost [s].
    on_frame : called with every frame that is used, in order, by the thread that received it; to
        record them.
    every : whether frames that are overtaken while they wait are used too, as for a recording;
        without it those that are used are new even where frames come faster than they can be read.
    clock : what time it is [s]; the computer's own unless given, another one to replay a recording.

    Raises
    ------
    InvalidInput
        When patience or silence are not above zero.
    """

    def __init__(
        self,
        patience: float = 0.1,
        silence: float = 0.3,
        on_frame: Callable[[HandFrame], None] = lambda frame: None,
        clock: Callable[[], float] = time.monotonic,
        every: bool = False,
    ) -> None:
        self._patience = positive(patience, "patience", "s")
        self._silence = positive(silence, "silence", "s")
        self._on_frame, self._clock, self._every = on_frame, clock, every
        self._changed = Condition()
        self._counts = {one.name: 0 for one in fields(StreamHealth)}
        self._hands: dict[Side, _Seen] = {"left": _Seen(), "right": _Seen()}
        self._quickest: tuple[float, float] | None = None

    @property
    def health(self) -> StreamHealth:
        """What came so far, and what was wrong with it."""
        with self._changed:
            self._notice_silence()
            return StreamHealth(**self._counts)

    def feed_json(self, text: bytes | str) -> FaultyFrame | None:
        """Take a message in JSON, whatever it is; return why it was left out, or None where it is used."""
        try:
            return self.feed(from_json(text))
        except FaultyFrame as fault:
            return self.feed(fault)

    def feed_waiting(self, messages: Sequence[bytes | str]) -> None:
        """Take messages in JSON that waited together, oldest first: of each hand the newest that is good is used.

        Those before it are overtaken, unless ``every`` frame is to be used.
        """
        self._feed_newest(messages, self.feed_json, side_of)

    def feed_waiting_osc(self, packets: Sequence[bytes]) -> None:
        """Take packets of OSC that waited together, as ``feed_waiting`` takes messages; bundles are used whole."""
        self._feed_newest(packets, self.feed_osc, side_of_osc)

    def _feed_newest(
        self,
        messages: Sequence[_Message],
        feed: Callable[[_Message], FaultyFrame | None],
        side_of: Callable[[_Message], Side | None],
    ) -> None:
        """Feed of some messages, oldest first, the newest good one of each hand, and those that name no hand."""
        if self._every:
            for message in messages:
                feed(message)
            return
        waiting: dict[Side, list[_Message]] = {"left": [], "right": []}
        for message in messages:
            side = side_of(message)
            if side is None:
                feed(message)
            else:
                waiting[side].append(message)
        for of_hand in waiting.values():
            skipped = self._counts["skipped"]
            while of_hand and feed(of_hand.pop()) is not None:
                pass
            with self._changed:
                self._counts["received"] += len(of_hand)
                self._counts["overtaken"] += len(of_hand)
                self._counts["skipped"] -= min(
                    len(of_hand), max(self._counts["skipped"] - skipped, 0)
                )

    def feed_osc(self, packet: bytes) -> FaultyFrame | None:
        """Take a packet of OSC, whatever it is; return why it, or the last frame in it, was left out, or None."""
        try:
            frames = from_osc(packet)
        except FaultyFrame as fault:
            return self.feed(fault)
        faults = [self.feed(frame) for frame in frames]
        return faults[-1] if faults else None

    def feed(self, frame: HandFrame | FaultyFrame) -> FaultyFrame | None:
        """Take a frame as the tracker gave it, or what is wrong with it.

        Returns
        -------
        Why it was left out, which may be that it is not newer than the last one of its hand, or None where it is used.
        """
        with self._changed:
            self._counts["received"] += 1
            if isinstance(frame, FaultyFrame):
                self._counts[frame.fault] += 1
                return frame
            seen, now = self._hands[frame.side], self._clock()
            fault = self._fault_in_order(frame, seen)
            if fault is not None:
                self._counts[fault.fault] += 1
                return fault
            self._notice_delay(frame, now)
            self._use(frame, seen, now)
            self._on_frame(frame)
            return None

    def interrupt(self) -> None:
        """Count a connection that ended without being closed; the hands it brought are lost when nothing more comes."""
        with self._changed:
            self._counts["interrupted"] += 1

    def latest(self, side: Side) -> HandFrame | None:
        """Give the newest frame of a hand, a lost one where nothing came for a while, or None where none ever came."""
        with self._changed:
            self._notice_silence()
            return self._hands[side].newest

    def wait(self, timeout: float) -> HandFrame | None:
        """Wait for a frame that was not given yet: the newest of its hand, whatever came in between.

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
                waiting = [seen for seen in self._hands.values() if not seen.given]
                if waiting:
                    first = min(waiting, key=lambda seen: seen.arrived)
                    first.given = True
                    return first.newest
                left = end - time.monotonic()
                if left <= 0.0:
                    return None
                self._changed.wait(
                    min(left, self._silence / 4)
                )  # silence makes no noise: look again

    def _fault_in_order(self, frame: HandFrame, seen: _Seen) -> FaultyFrame | None:
        """Return what is wrong with the order of a frame among those before, and notice a tracker that restarted."""
        last = seen.newest
        if last is None:
            return None
        step = frame.sequence - last.sequence
        if step > 0 and frame.time > last.time:
            self._counts["restarted"] += step > FARTHEST
            self._counts["skipped"] += step - 1 if step <= FARTHEST else 0
            return None
        which = f"frame {frame.sequence} of the {frame.side} hand"
        if (frame.sequence, frame.time) in seen.places:
            return FaultyFrame("repeated", f"{which} had come before; leave it out.")
        if seen.silent or self._restarted(frame, seen):
            self._counts["restarted"] += 1
            seen.places.clear()
            self._quickest = None
            return None
        if step <= 0:
            self._counts["skipped"] -= (
                self._counts["skipped"] > 0
            )  # it was missed, and came after all
            return FaultyFrame(
                "out_of_order", f"{which} comes after frame {last.sequence}; put them in order."
            )
        back = f"time goes back from {last.time:g} to {frame.time:g} s"
        return FaultyFrame(
            "backwards", f"{back} at {which}; give each frame a later time than the one before."
        )

    def _restarted(self, frame: HandFrame, seen: _Seen) -> bool:
        before = seen.outlier
        follows = (
            before is not None and frame.sequence > before.sequence and frame.time > before.time
        )
        seen.outliers = seen.outliers + 1 if follows else 1
        seen.outlier = frame
        return seen.outliers >= RESTART

    def _notice_delay(self, frame: HandFrame, now: float) -> None:
        delay = now - frame.time
        if self._quickest is not None:
            quickest, then = self._quickest
            quickest += DRIFT * (now - then)
            if delay > quickest + self._patience:
                self._counts["late"] += 1
            delay = min(delay, quickest)
        self._quickest = delay, now

    def _use(self, frame: HandFrame, seen: _Seen, now: float) -> None:
        if frame.lost and not (seen.newest is not None and seen.newest.lost):
            self._counts["lost"] += 1
        seen.newest, seen.arrived, seen.given, seen.silent = frame, now, False, False
        seen.places.append((frame.sequence, frame.time))
        seen.outlier, seen.outliers = None, 0
        self._counts["used"] += 1
        self._changed.notify_all()

    def _notice_silence(self) -> None:
        now = self._clock()
        for side, seen in self._hands.items():
            last = seen.newest
            if last is None or last.lost or now - seen.arrived < self._silence:
                continue
            seen.newest = HandFrame(last.time, side, last.sequence)
            seen.given, seen.silent = False, True
            self._counts["lost"] += 1
            self._changed.notify_all()
