"""Streams of received frames, which count and skip faulty frames.

Any number of threads may feed a ``HandStream``. It stores only the latest valid frame of each hand,
so even a slow reader always gets the latest frame. If the tracker loses a hand or sends nothing for
a while, the latest frame is a ``lost`` one.

The times of used frames always increase. If a tracker restarts with another clock or counts in
milliseconds, its frames are used again after 20 consistent ones, and their times continue from the
earlier times. Readers therefore do not notice restarts.
"""

import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from threading import Condition
from typing import get_args

import numpy as np

from airtact.errors import counted, positive
from airtact.geometry.pose import Pose
from airtact.hands.hand import Side
from airtact.hands.joints import joints_of, side_evidence
from airtact.hands.tracking.clock import MAX_LATENCY, FrameClock
from airtact.hands.tracking.frame import Fault, FaultyFrame, HandFrame
from airtact.hands.tracking.messages import from_json

# Number of successive rejected frames in order after which the tracker counts as restarted.
MAX_STALE_FRAMES = 20

# Speed of a hand above which a frame is rejected [m/s]; people reach at up to 2 m/s.
MAX_SPEED = 3.0

# Jump of the sequence number above which the tracker counts as restarted.
MAX_JUMP = 1000


@dataclass(frozen=True)
class StreamHealth:
    """Counts of received frames and of their faults, as in ``HandStream.health``.

    A stream returns only the frames counted in ``used``. Frames counted in ``unreadable`` to
    ``second_tracker`` are rejected, each with one of these faults. The frame number is
    ``HandFrame.sequence``.

    Attributes
    ----------
    received : number of received messages, whether or not they are valid frames.
    used : number of valid frames, including those that report a lost hand.
    lost : number of times a hand was lost, as reported by the tracker or inferred from a pause.
    unreadable : number of messages that are not frames.
    half_lost : number of frames with NaN, infinite or missing coordinates.
    unknown_count : number of frames whose number of landmarks is not 21, 25 or 26.
    not_in_metres : number of frames that span more than a metre, probably in millimetres.
    impossible : number of frames with implausible bone lengths.
    mirrored : number of frames with the wrong side, "left" or "right", as inferred from how the
        fingers bend in many frames.
    repeated : number of duplicate frames.
    out_of_order : number of frames whose frame number is lower than that of an earlier frame.
    backwards : number of frames whose frame number is higher than that of the previous frame, but
        whose time is not later.
    time_leap : number of frames whose time is ahead of this computer's clock.
    too_fast : number of frames in which the hand moved faster than 3 m/s.
    second_tracker : number of frames of a hand that is already received from another connection.
    skipped : number of missing frames, counted from gaps in the frame numbers.
    restarted : number of restarts of a tracker or its clock.
    converted : number of frames whose time was converted from milli-, micro- or nanoseconds.
    interrupted : number of connections that ended without being closed.
    """

    received: int = 0
    used: int = 0
    lost: int = 0
    unreadable: int = 0
    half_lost: int = 0
    unknown_count: int = 0
    not_in_metres: int = 0
    impossible: int = 0
    mirrored: int = 0
    repeated: int = 0
    out_of_order: int = 0
    backwards: int = 0
    time_leap: int = 0
    too_fast: int = 0
    second_tracker: int = 0
    skipped: int = 0
    restarted: int = 0
    converted: int = 0
    interrupted: int = 0

    def rejected_since(self, before: "StreamHealth") -> str:
        """Return the number of frames rejected since ``before`` and the main reason, as text."""
        counts = {name: getattr(self, name) - getattr(before, name) for name in get_args(Fault)}
        main = max(counts, key=counts.__getitem__)
        if not counts[main]:
            return ""
        rejected = counted(sum(counts.values()), "frame", "frames")
        return f"{rejected} rejected: {main.replace('_', ' ')}"

    def __str__(self) -> str:
        counts = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return ", ".join(
            f"{count:,} {name.replace('_', ' ')}"
            for name, count in counts.items()
            if count or name == "received"
        )


@dataclass(eq=False)
class _TrackedHand:
    """State of one hand.

    Attributes
    ----------
    clock : estimate of the clock to which the times of used frames refer.
    source : connection that sends the frames.
    newest : latest frame, the time of its arrival, and whether a reader has fetched it.
    seen : latest frame with landmarks.
    silent : whether frames have stopped arriving.
    unit, shift : the time of a used frame is the tracker's time multiplied by the unit [s], plus
        the shift [s].
    recent : numbers and tracker times of used frames, to distinguish duplicates from frames out of
        order.
    stale : numbers, tracker times and arrivals of successive rejected frames that are in order.
    given : number and tracker time of the newest frame, whether it was used or not.
    disorder : running fraction of frames that have a higher number than the previous frame, but not
        a later time. Frames are rejected while it is above 0.4; a new stream starts just below this
        limit.
    evidence : running mean of the evidence for the side (``side_evidence``); negative if mirrored.
    together : whether each of the latest frames arrived together with the previous one.
    at_origin : whether the wrist is exactly at the tracker's origin.
    """

    clock: FrameClock = field(default_factory=FrameClock)
    source: str = ""
    newest: HandFrame | None = None
    arrived: float = 0.0
    taken: bool = True
    seen: HandFrame | None = None
    silent: bool = False
    unit: float = 1.0
    shift: float = 0.0
    recent: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=256))
    stale: list[tuple[int, float, float]] = field(default_factory=list)
    given: tuple[int, float] = (0, -np.inf)
    disorder: float = 0.36
    evidence: float = 0.0
    together: deque[bool] = field(default_factory=lambda: deque(maxlen=16))
    at_origin: bool = False


class HandStream:
    """The latest valid frame of each hand, from the frames that a tracker sends.

    Pass frames to ``feed`` or ``feed_json``. Read them with ``wait``, which waits for the next new
    frame, or ``latest``, which returns the newest frame of one hand. Several threads may do so at
    the same time. Faulty frames are skipped and counted in ``health``; for such a frame, ``feed``
    and ``feed_json`` return the exception that describes the fault, instead of raising it.

    Parameters
    ----------
    silence : time without valid frames of a hand after which it is treated as lost [s], above zero.
        ``wait`` and ``latest`` then return a frame of this hand without landmarks and cloud.
    on_frame : function called with every valid ``HandFrame``, in order, in the thread that calls
        ``feed``; by default, nothing is called.
    clock : function that returns the time at which a frame arrives, to which ``silence`` refers
        [s]; by default ``time.monotonic``.
    tracker : pose that maps the tracker's coordinates to those of the frames that are read, such as
        the scene's; by default, coordinates are not changed.

    Raises
    ------
    InvalidInput
        If ``silence`` is not above zero.
    """

    def __init__(
        self,
        silence: float = 0.3,
        on_frame: Callable[[HandFrame], None] = lambda frame: None,
        clock: Callable[[], float] = time.monotonic,
        tracker: Pose | None = None,
    ) -> None:
        self._silence = positive(silence, "silence", "s")
        self._on_frame = on_frame
        self._clock = clock
        self._tracker = tracker
        self._received = clock()
        self._changed = Condition()
        self._counts: Counter[str] = Counter()
        self._hands: dict[Side, _TrackedHand] = {"left": _TrackedHand(), "right": _TrackedHand()}

    @property
    def health(self) -> StreamHealth:
        """Counts of received frames and of their faults."""
        with self._changed:
            self._notice_silence()
            return StreamHealth(**self._counts)

    def clock(self, side: Side) -> FrameClock:
        """Return the clock of the frames of the "left" or "right" hand."""
        return self._hands[side].clock

    @property
    def idle(self) -> float:
        """Time [s] since the last message, valid or not, or since construction if there is none."""
        return self._clock() - self._received

    def remark(self) -> str:
        """Return a description of anything unusual in the frames that were used, or ""."""
        with self._changed:
            hands = [hand for hand in self._hands.values() if not hand.silent]
        if any(hand.at_origin for hand in hands):
            return "the wrist stays at the tracker's origin: are the joints relative to the wrist?"
        if any(sum(hand.together) > 8 for hand in hands):
            return "frames come in bursts: does the network save power?"
        return ""

    def feed_json(self, text: bytes | str, source: str = "") -> FaultyFrame | None:
        """Process a frame in JSON; return an exception if it is faulty, or None if it is used."""
        try:
            return self.feed(from_json(text), source)
        except FaultyFrame as fault:
            return self.feed(fault, source)

    def feed(self, frame: HandFrame | FaultyFrame, source: str = "") -> FaultyFrame | None:
        """Process a frame, or the exception that was raised when reading it.

        Parameters
        ----------
        frame : a frame, or the exception for an unreadable frame.
        source : connection that sent the frame. Other connections cannot send the same hand until
            this one ends, or until ``silence`` has passed since its last used frame.

        Returns
        -------
        The exception if the frame is faulty, for example if it is not later than the previous frame
        of its hand; None if the frame is used.
        """
        with self._changed:
            self._counts["received"] += 1
            self._received = self._clock()
            try:
                if isinstance(frame, FaultyFrame):
                    raise frame
                used, skipped = self._continued(frame, source)
                self._check_side(used)
                at_origin = used.landmarks is not None and not used.landmarks[0].any()
                if self._tracker is not None:
                    used = used.moved(self._tracker)
                self._check_speed(used)
            except FaultyFrame as fault:
                self._counts[fault.fault] += 1
                return fault
            hand = self._hands[used.side]
            self._counts["lost"] += used.lost and not (hand.newest is not None and hand.newest.lost)
            self._counts["used"] += 1
            self._counts["skipped"] += skipped
            self._counts["converted"] += hand.unit != 1.0
            now = self._clock()
            if hand.newest is not None:
                hand.together.append(now - hand.arrived < 0.2 * (used.time - hand.newest.time))
            hand.newest = used
            hand.arrived = now
            hand.clock.saw(used.time, now)
            hand.taken = False
            hand.silent = False
            hand.at_origin = at_origin
            hand.recent.append((frame.sequence, frame.time))
            hand.stale.clear()
            if used.landmarks is not None:
                hand.seen = used
            self._changed.notify_all()
            self._on_frame(used)
            return None

    def disconnect(self, source: str, interrupted: bool) -> None:
        """Release the hands of a connection that ended, and count interrupted connections."""
        with self._changed:
            self._counts["interrupted"] += interrupted
            for hand in self._hands.values():
                if hand.source == source:
                    hand.source = ""
                    hand.silent = True

    def latest(self, side: Side) -> HandFrame | None:
        """Return the latest frame of a hand, or None before the first frame.

        After the time ``silence`` without frames, the latest frame marks the hand as lost.
        """
        with self._changed:
            self._notice_silence()
            return self._hands[side].newest

    def wait(self, timeout: float) -> HandFrame | None:
        """Wait for a new frame of either hand; older frames of the same hand are skipped.

        Parameters
        ----------
        timeout : longest time to wait [s].

        Returns
        -------
        The latest frame of a hand, which may mark this hand as lost; None after the timeout. If
        both hands have a new frame, the one that arrived first is returned.
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
                # Silence does not wake this thread, so the thread checks for it regularly.
                self._changed.wait(min(left, self._silence / 4))

    def _continued(self, frame: HandFrame, source: str) -> tuple[HandFrame, int]:
        """Return a frame whose time continues from earlier frames, and the number of skipped ones.

        The method raises the frame's fault, if it has one.
        """
        hand = self._hands[frame.side]
        newest = hand.newest
        now = self._clock()
        name = f"frame {frame.sequence} of the {frame.side} hand"
        gone = newest is None or hand.silent or now - hand.arrived >= self._silence
        if source != hand.source:
            if not gone:
                raise FaultyFrame(
                    "second_tracker",
                    f"{name} comes from a second tracker; stop the first one to use this one.",
                )
            hand.source = source
            hand.unit = 1.0
            hand.recent.clear()  # it may replay the same recording
        number, taken = hand.given
        if frame.sequence > number or newest is None:
            # One in ten, as from a network that reorders, leads to 0.32 at most.
            back = frame.time <= taken
            hand.disorder += (0.1 if back else 0.03) * (back - hand.disorder)
            hand.given = (frame.sequence, frame.time)
        if newest is None:
            return frame, 0
        # Speeds from times with so much jitter would be wrong.
        if hand.disorder > 0.4:
            raise FaultyFrame(
                "backwards",
                f"the frame times of the {frame.side} hand repeatedly go backwards; send "
                "all times in seconds, from a single steady clock.",
            )
        time = hand.unit * frame.time + hand.shift
        later = time > newest.time
        step = frame.sequence - newest.sequence
        # Difference from the expected time. Late frames are in order, unless the clock stopped
        # while no frames came. Frames that waited in a network arrive faster than they were taken.
        ahead = time - hand.clock.time(now)
        waited = bool(hand.stale) and now - hand.stale[-1][2] < 0.5 * (
            frame.time - hand.stale[-1][1]
        )
        stopped = gone and ahead < -MAX_LATENCY and not waited
        # A fast clock is ahead as well, but it does not leap.
        leap = min(ahead, time - newest.time - (now - hand.arrived))
        plausible = later and leap <= hand.clock.margin and not stopped
        if step > 0 and plausible:
            if step > MAX_JUMP:
                self._counts["restarted"] += 1
            skipped = step - 1 if step <= MAX_JUMP else 0
            return frame if time == frame.time else replace(frame, time=time), skipped
        if (frame.sequence, frame.time) in hand.recent:
            raise FaultyFrame("repeated", f"{name} was already received; send each frame once.")
        # A restarted tracker restarts its numbers and times. Stray old frames are rarely in order.
        if hand.stale:
            number, taken, _ = hand.stale[-1]
            if frame.sequence <= number or frame.time <= taken:
                hand.stale.clear()
        hand.stale.append((frame.sequence, frame.time, now))
        if len(hand.stale) >= (2 if gone else MAX_STALE_FRAMES):
            self._counts["restarted"] += 1
            hand.recent.clear()
            hand.disorder = 0.0
            hand.given = (frame.sequence, frame.time)
            if not plausible:
                _, begun, arrived = hand.stale[0]
                if now - arrived > 0.15:  # long enough to measure its pace
                    # A clock in milliseconds advances by 1000 per second.
                    pace = float(np.log10((frame.time - begun) / (now - arrived)))
                    power = min(max(round(pace / 3.0), 0), 3)
                    if abs(pace - 3.0 * power) < 0.3:
                        hand.unit = 10.0 ** (-3.0 * power)
                time = max(hand.clock.restart(now), newest.time + 1e-3)
                hand.shift = time - hand.unit * frame.time
            return replace(frame, time=time), 0
        if step <= 0:
            # The frame was already counted as skipped.
            self._counts["skipped"] = max(self._counts["skipped"] - 1, 0)
            raise FaultyFrame(
                "out_of_order",
                f"{name} arrived after frame {newest.sequence}; send frames in order.",
            )
        if later:
            raise FaultyFrame(
                "time_leap",
                f"the time of {name} is {ahead:.3g} s ahead of this computer's clock; send "
                "all times in seconds, from a single steady clock.",
            )
        raise FaultyFrame(
            "backwards",
            f"the time of {name} is {frame.time:g} s, not later than that of the previous frame; "
            "use increasing times.",
        )

    def _check_side(self, frame: HandFrame) -> None:
        """Reject a frame if this hand bends like the other hand, in this frame or on average."""
        if frame.landmarks is None:
            return
        hand = self._hands[frame.side]
        evidence = side_evidence(joints_of(frame.landmarks))
        if frame.side == "left":
            evidence = -evidence
        # Straight fingers provide no evidence, so a judgement lasts until fingers bend again. The
        # limit of 2 lets the judgement change within about 20 frames.
        if abs(evidence) > 0.1:
            hand.evidence += 0.1 * (float(np.clip(evidence, -2.0, 2.0)) - hand.evidence)
        if hand.evidence < -0.15 or evidence < -1.0:
            raise FaultyFrame(
                "mirrored",
                f"the landmarks are labelled as a {frame.side} hand, but fingers and thumb bend "
                f"like those of the other hand: the sum of bends is {evidence:+z.2f} in this "
                f"frame, but should be positive for a {frame.side} hand. Swap left and right, or "
                "negate z if the axes are left-handed, as in Unity.",
            )

    def _check_speed(self, frame: HandFrame) -> None:
        seen = self._hands[frame.side].seen
        if seen is None or seen.landmarks is None or frame.landmarks is None:
            return
        moved = np.linalg.norm(frame.landmarks.mean(axis=0) - seen.landmarks.mean(axis=0))
        # Noise and jitter of the times can add 20 mm.
        if moved > MAX_SPEED * (frame.time - seen.time) + 0.02:
            raise FaultyFrame(
                "too_fast",
                f"the hand moved by {1e3 * moved:.0f} mm in {1e3 * (frame.time - seen.time):.0f} "
                f"ms, faster than {MAX_SPEED:g} m/s; skip this frame.",
            )

    def _notice_silence(self) -> None:
        now = self._clock()
        for side, hand in self._hands.items():
            newest = hand.newest
            if newest is None or newest.lost or now - hand.arrived < self._silence:
                continue
            # A frame without landmarks and cloud means that the hand is lost.
            hand.newest = HandFrame(newest.time, side, newest.sequence)
            hand.taken = False
            hand.silent = True
            self._counts["lost"] += 1
            self._changed.notify_all()
