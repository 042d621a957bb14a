"""The live loop: the newest frame in, the newest drive out; nothing queues, and what is not safe fades to silence."""

import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from airtact.conventions import InvalidInput
from airtact.live.clock import FrameClock
from airtact.live.distances import foci_on
from airtact.live.output import Nowhere, Output
from airtact.live.parts import Controls, DriveMaker, LiveScene, Moment
from airtact.live.safety import STALE, Gain, Workspace, hand_of
from airtact.live.session import SessionWriter
from airtact.live.sources import HandSource, checked_seconds
from airtact.tracking.frame import HandFrame
from airtact.tracking.stream import StreamHealth

OFTEN, SELDOM = 1.0 / 120.0, 1.0 / 66.0
"""Shortest and longest time between the beginnings of two drives while the hand is there [s]."""

IDLE = 0.02
"""How long the loop waits for a frame while nothing is emitted [s]."""

REPORTED = 0.5
"""Time between two reports [s]."""

SMOOTHING = 0.1
"""Weight of the newest drive in the running mean of how long one takes."""

REMEMBERED = 4096
"""Number of drives, the newest ones, that medians are taken of."""


@dataclass(frozen=True)
class Status:
    """How the live loop does, over the last half second.

    Attributes
    ----------
    state : what it does, and why where it is silent.
    rate : drives a second.
    age : from the time of the newest frame to the sound in the air, median [s]; NaN without drives.
    kept : expected share of the attainable pressure, median; NaN where it is not known.
    late : what is late, in words; empty where nothing is.
    """

    state: str
    rate: float
    age: float
    kept: float
    late: str = ""

    def __str__(self) -> str:
        """Write it on one line."""
        parts = [self.state]
        if self.rate:
            parts += [f"{self.rate:.0f} drives/s", f"age {1e3 * self.age:.0f} ms"]
        if np.isfinite(self.kept):
            parts.append(f"{self.kept:.0%} of the attainable pressure expected")
        return ", ".join([*parts, *([f"late: {self.late}"] if self.late else [])])


@dataclass(frozen=True)
class Followed:
    """What the live loop did.

    Attributes
    ----------
    seconds : how long it ran.
    frames : good frames of the hand that it took.
    drives : drives that reached the link, silence included.
    rate : drives a second while there was sound; 0 without sound.
    age, oldest : from the time of the newest frame to the sound in the air, median and 95 of 100 [s]; NaN without.
    kept : expected share of the attainable pressure, median; NaN where it is not known.
    faded : times that the sound faded to silence, by the reason.
    dropped : rows that the session lacks because the disk was too slow.
    health : of the stream of frames.
    stopped : whether the emergency stop was pressed.
    """

    seconds: float
    frames: int
    drives: int
    rate: float
    age: float
    oldest: float
    kept: float
    faded: dict[str, int]
    dropped: int
    health: StreamHealth
    stopped: bool = False

    def facts(self) -> list[tuple[str, str]]:
        """Put what was done into words, each fact by its name."""
        facts = [("time", f"{self.seconds:.1f} s, {self.frames} frames of the hand"), ("messages", str(self.health))]
        facts.append(("drives", f"{self.drives:,}, {self.rate:.0f}/s while there was sound"))
        if np.isfinite(self.age):
            facts.append(("age in the air", f"{1e3 * self.age:.1f} ms, 95 of 100 under {1e3 * self.oldest:.1f} ms"))
        if np.isfinite(self.kept):
            facts.append(("pressure expected", f"{self.kept:.0%} of the attainable"))
        if self.faded:
            facts.append(("faded", ", ".join(f"{count} x {why}" for why, count in self.faded.items())))
        if self.dropped:
            facts.append(("not recorded", f"{self.dropped} rows: the disk was too slow"))
        return facts

    def record(self) -> dict[str, Any]:
        """Return all numbers by their names, for JSON; None where one is not known."""
        numbers = {one.name: getattr(self, one.name) for one in fields(self)}
        numbers["health"] = asdict(self.health)
        return {name: None if isinstance(it, float) and not np.isfinite(it) else it for name, it in numbers.items()}


def follow(
    scene: LiveScene,
    hands: HandSource,
    maker: DriveMaker,
    *,
    output: Output | None = None,
    seconds: float | None = None,
    session: SessionWriter | None = None,
    latency: float = 0.0,
    cap: float = 1.0,
    report: Callable[[Status], None] = lambda status: None,
) -> Followed:
    """Let the sound follow a hand until the time is over, the frames end, or Ctrl-C.

    Parameters
    ----------
    scene : what stays the same.
    hands : where the frames come from; it is begun and closed here, as ``maker`` and ``session`` are closed.
    maker : makes the drives.
    output : where they go; nowhere unless given.
    seconds : how long; until the frames end unless given.
    session : records what is done.
    latency : least time from the picture to the frame's arrival, of trackers with a clock of their own [s].
    cap : largest amplitude of an element, a share of full scale.
    report : called twice a second with how it does.

    Returns
    -------
    What was done. Ctrl-C ends it early, in silence.

    Raises
    ------
    InvalidInput
        If time, latency or cap are at fault, or the link cannot be opened.
    LinkFailed
        If the boards fail; those that answer are silent.
    """
    end = checked_seconds(seconds)
    with ExitStack() as closing:
        closing.callback(maker.close)
        if session is not None:
            closing.callback(session.close)
        closing.callback(hands.close)
        loop = _Loop(scene, maker, closing.enter_context(output or Nowhere()), FrameClock(latency), session, cap)
        begun = time.monotonic()
        stream = hands.begin(loop.arrived)
        reported = begun
        try:
            while (now := time.monotonic()) < begun + end:
                if hands.ended and loop.silent:
                    break
                frame = stream.wait(loop.patience(min(now + IDLE, begun + end)))
                loop.go_on(frame)
                if time.monotonic() - reported >= REPORTED:
                    reported = time.monotonic()
                    report(loop.status())
        except KeyboardInterrupt:
            pass
        seconds = time.monotonic() - begun
        loop.fade_out()
    return loop.followed(seconds, stream.health)


class _Loop:
    """The state of the loop between two passes."""

    def __init__(
        self,
        scene: LiveScene,
        maker: DriveMaker,
        output: Output,
        clock: FrameClock,
        session: SessionWriter | None,
        cap: float,
    ) -> None:
        self._scene, self._maker, self._output, self._clock = scene, maker, output, clock
        self._session, self._cap = session, cap
        self._workspace, self._gain, self.controls = Workspace(scene), Gain(), Controls()
        self._fault: str | None = "waiting for a hand"
        self._good = -np.inf
        self._begun = 0.0
        self._lasts = OFTEN / 2.0
        self._moment: Moment | None = None
        self._recent: deque[tuple[float, float, float]] = deque(maxlen=REMEMBERED)
        self._kept: deque[float] = deque(maxlen=REMEMBERED)
        self._ages: deque[float] = deque(maxlen=REMEMBERED)
        self._frames = self._drives = 0
        self._faded: dict[str, int] = {}

    @property
    def silent(self) -> bool:
        """Whether nothing is emitted."""
        return self._gain.share == 0.0

    def arrived(self, frame: HandFrame, now: float) -> None:
        """Note a frame as it comes, in the thread that received it."""
        if frame.side != self._scene.side:
            return
        self._clock.saw(frame.time, now)
        if self._session is not None:
            self._session.frame(frame)

    def patience(self, latest: float) -> float:
        """Return how long to wait for a frame at most [s]."""
        now = time.monotonic()
        until = latest
        if not self.silent or self._fault is None:
            until = min(self._begun + float(np.clip(2.0 * self._lasts, OFTEN, SELDOM)), self._good + STALE)
        return max(until - now, 0.0)

    def go_on(self, frame: HandFrame | None) -> None:
        """Take what came, and emit what is right now."""
        if frame is not None:
            self._take(frame)
        now = time.monotonic()
        if self._fault is None and now - self._good >= STALE:
            self._fault = f"stale: no good frame for {1e3 * STALE:.0f} ms"
        on = self._fault is None and self.controls.playing
        if not on and self.silent:
            self._output.beat()
            return
        self._emit(now, on)

    def fade_out(self) -> None:
        """Fade to silence."""
        self._fault = self._fault or "ended"
        while not self.silent:
            time.sleep(OFTEN)
            self._emit(time.monotonic(), False)

    def _take(self, frame: HandFrame) -> None:
        if frame.side != self._scene.side:
            if self._fault is not None and self._good == -np.inf:
                self._fault = f"waiting for the {self._scene.side} hand: these are frames of the {frame.side} one"
            return
        hand = hand_of(frame, self._scene)
        fault = hand if isinstance(hand, str) else self._workspace.fault(hand, foci_on(hand, self._scene))
        if fault is None:
            try:
                self._maker.take(frame)
            except InvalidInput as wrong:
                fault = str(wrong)
        if fault is None:
            self._good = time.monotonic()
            self._frames += 1
        self._fault = fault

    def _emit(self, now: float, on: bool) -> None:
        self._begun = now
        if on:
            moment = self._maker.make(self._clock.time(now) + self._lasts, self.controls)
            if moment.joints is None:
                on, self._fault = False, "lost"
            else:
                self._moment = moment
        before = self._gain.share
        share = self._gain.advance(now, on)
        if self._moment is None:
            return
        largest = float(np.abs(self._moment.amplitudes).max(initial=1e-12))
        scale = share * min(1.0, min(self._cap, self.controls.cap) / largest)
        state = "playing" if on else "silent" if share == 0.0 else "fading"
        moment = replace(self._moment, amplitudes=scale * self._moment.amplitudes, state=state)
        self._output.send(moment.amplitudes)
        sent = time.monotonic()
        self._note(moment, sent, before)
        if on:
            self._lasts += SMOOTHING * (sent - now - self._lasts)

    def _note(self, moment: Moment, sent: float, before: float) -> None:
        """Record a drive that reached the link."""
        in_air = self._clock.time(sent)
        self._drives += 1
        if self._session is not None:
            self._session.drive(moment, in_air)
        if moment.state == "silent" and before > 0.0:
            reason = (self._fault or "paused").partition(":")[0]
            self._faded[reason] = self._faded.get(reason, 0) + 1
        if moment.state == "playing":
            age = in_air - moment.frame_time
            self._recent.append((sent, age, np.nan if moment.kept is None else moment.kept))
            self._ages.append(age)
            if moment.kept is not None:
                self._kept.append(moment.kept)

    def status(self) -> Status:
        """Return how it does."""
        now = time.monotonic()
        recent = np.array([row for row in self._recent if now - row[0] <= 2.0 * REPORTED]).reshape(-1, 3)
        state = "playing" if self._fault is None else self._fault
        if not len(recent):
            return Status(state, 0.0, np.nan, np.nan)
        known = recent[np.isfinite(recent[:, 2]), 2]
        span = 2.0 * REPORTED
        return Status(
            state, len(recent) / span, float(np.median(recent[:, 1])), float(np.median(known)) if len(known) else np.nan
        )

    def followed(self, seconds: float, health: StreamHealth) -> Followed:
        """Return what was done."""
        ages = np.array(self._ages) if self._ages else np.array([np.nan])
        median, oldest = np.percentile(ages, [50, 95])
        times = [row[0] for row in self._recent]
        rate = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0
        return Followed(
            seconds=seconds,
            frames=self._frames,
            drives=self._drives,
            rate=rate,
            age=float(median),
            oldest=float(oldest),
            kept=float(np.median(self._kept)) if self._kept else np.nan,
            faded=dict(self._faded),
            dropped=0 if self._session is None else self._session.dropped,
            health=health,
        )
