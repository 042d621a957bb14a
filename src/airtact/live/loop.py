"""The live loop: the newest frame in, the newest drive out; nothing queues, and what is not safe fades to silence."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128
from threadpoolctl import threadpool_limits

from airtact.drives.frame import check_cap
from airtact.emission.link import LinkFailed
from airtact.errors import InvalidInput
from airtact.hands.hand import Hand
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.stream import StreamHealth
from airtact.live.clock import FrameClock
from airtact.live.distances import foci_on
from airtact.live.output import Nowhere, Output
from airtact.live.page.process import PageProcess
from airtact.live.parts import Controls, DriveMaker, LiveScene, Moment, State
from airtact.live.safety import STALE, Gain, Workspace, hand_of
from airtact.live.session import SessionWriter
from airtact.live.sources import HandSource, checked_seconds

OFTEN, SELDOM = 1.0 / 120.0, 1.0 / 66.0
"""Shortest and longest time between the beginnings of two drives while the hand is there [s]."""

JITTER, LATEST = 4e-3, 1.0 / 45.0
"""A frame that is due is waited for so much longer, and so long after the beginning of a drive at most [s]."""

IDLE = 0.02
"""How long the loop waits for a frame while nothing is emitted [s]."""

REPORTED = 0.5
"""Time between two reports [s]."""

SMOOTHING = 0.1
"""Weight of the newest drive in the running mean of how long one takes."""

REMEMBERED = 4096
"""Number of drives, the newest ones, that medians are taken of."""

LATE = {"frames": 0.05, "solver": 0.1, "link": 0.01}
"""What is late where it takes longer in the median: a frame is as old when a drive is begun, the hand that was solved
last is as old when the drive is in the air, the link takes as long to accept a drive [s]."""

IN_WORDS = {
    "frames": "frames {:.0f} ms old",
    "solver": "solver {:.0f} ms behind",
    "link": "link {:.0f} ms a drive",
}
"""How the status states it."""


class _Played(NamedTuple):
    """Times of a drive that played, as ``LATE`` describes them [s], and what it is expected to keep; NaN: not known."""

    sent: float
    age: float
    kept: float
    frames: float
    solver: float
    link: float


@dataclass(frozen=True)
class Status:
    """How the live loop does, over the last second.

    Attributes
    ----------
    state : what it does, and why where it is silent.
    rate : drives a second.
    age : from the time of the newest frame to the sound in the air, median [s]; NaN without drives.
    kept : expected share of the attainable pressure, median; NaN where it is not known.
    late : what takes longer than it should, and how long [s], by its name: "frames", "solver",
        "link".
    """

    state: str
    rate: float
    age: float
    kept: float
    late: dict[str, float]

    def __str__(self) -> str:
        """Write it on one line, of under 80 columns while it plays and nothing is late."""
        parts = [self.state]
        if self.rate:
            parts += [f"{self.rate:.0f} drives/s", f"age {1e3 * self.age:.0f} ms"]
            late = [IN_WORDS[name].format(1e3 * seconds) for name, seconds in self.late.items()]
            parts.append(f"late: {', '.join(late)}" if late else "nothing late")
        if np.isfinite(self.kept):
            parts.append(f"{self.kept:.0%} of attainable expected")
        return ", ".join(parts)


@dataclass(frozen=True)
class Followed:
    """What the live loop did.

    Attributes
    ----------
    seconds : how long it ran.
    frames : good frames of the hand that it took.
    drives : drives that reached the link, silence included.
    rate : drives a second while there was sound; 0 without sound.
    age, oldest : from the time of the newest frame to the sound in the air, median and 95 of 100
        [s]; NaN without.
    delay : from a frame's arrival to the first drive made with it at the link, 95 of 100 [s]; NaN
        without.
    kept : expected share of the attainable pressure, median; NaN where it is not known.
    faded : times that the sound faded to silence, by the reason.
    dropped : rows that the session lacks because the disk was too slow.
    health : of the stream of frames.
    stopped : whether the emergency stop was pressed.
    state : what the loop did at the end, and why where it was silent.
    """

    seconds: float
    frames: int
    drives: int
    rate: float
    age: float
    oldest: float
    delay: float
    kept: float
    faded: dict[str, int]
    dropped: int
    health: StreamHealth
    stopped: bool = False
    state: str = "playing"

    def facts(self) -> list[tuple[str, str]]:
        """Put what was done into words, each fact by its name."""
        facts = [
            ("time", f"{self.seconds:.1f} s, {self.frames} frames of the hand"),
            ("messages", str(self.health)),
        ]
        facts.append(("drives", f"{self.drives:,}, {self.rate:.0f}/s while there was sound"))
        if np.isfinite(self.age):
            facts.append(("frame to drive", f"95 of 100 within {1e3 * self.delay:.1f} ms"))
            facts.append(
                (
                    "age in the air",
                    f"{1e3 * self.age:.1f} ms, 95 of 100 under {1e3 * self.oldest:.1f} ms",
                )
            )
        if np.isfinite(self.kept):
            facts.append(("pressure expected", f"{self.kept:.0%} of the attainable"))
        if self.faded:
            facts.append(
                ("faded", ", ".join(f"{count} x {why}" for why, count in self.faded.items()))
            )
        if self.state != "playing":
            facts.append(("at the end", self.state))
        if self.dropped:
            facts.append(("not recorded", f"{self.dropped} rows: the disk was too slow"))
        return facts

    def record(self) -> dict[str, float | str | dict[str, int] | None]:
        """Return all numbers by their names, for JSON; None where one is not known."""
        numbers = {one.name: getattr(self, one.name) for one in fields(self)}
        numbers["health"] = asdict(self.health)
        return {
            name: None if isinstance(it, float) and not np.isfinite(it) else it
            for name, it in numbers.items()
        }


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
    controls: Controls | None = None,
    page: PageProcess | None = None,
    report: Callable[[Status], None] = lambda status: None,
) -> Followed:
    """Let the sound follow a hand until the time is over, the frames end, or Ctrl-C.

    Parameters
    ----------
    scene : what stays the same.
    hands : where the frames come from; it is begun and closed here, as ``maker`` and ``session``
        are closed.
    maker : makes the drives.
    output : where they go; nowhere unless given.
    seconds : how long; until the frames end unless given.
    session : records what is done.
    latency : least time from the picture to the frame's arrival, of trackers with a clock of their
        own [s].
    cap : largest amplitude of an element, a share of full scale.
    controls : what is set from the start; what is set on the page takes its place.
    page : shows every moment, and sets the controls.
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
    end, cap, clock = checked_seconds(seconds), check_cap(cap), FrameClock(latency)
    with ExitStack() as closing:
        closing.callback(maker.close)
        if session is not None:
            closing.callback(session.close)
        closing.callback(hands.close)
        output = closing.enter_context(output or Nowhere())
        loop = _Loop(scene, maker, output, clock, session, cap, controls or Controls(), page)
        return loop.run(hands, end, report)


def capped(
    amplitudes: Complex128[np.ndarray, "*shape"], cap: float
) -> Complex128[np.ndarray, "*shape"]:
    """Bring amplitudes under a cap as a whole."""
    return min(1.0, cap / float(np.abs(amplitudes).max(initial=1e-12))) * amplitudes


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
        controls: Controls,
        page: PageProcess | None,
    ) -> None:
        self._scene, self._maker, self._output, self._clock = scene, maker, output, clock
        self._session, self._cap, self._controls, self._page = session, cap, controls, page
        self._workspace, self._gain = Workspace(scene), Gain()
        self._modulated = False
        self._arrivals: deque[tuple[float, float]] = deque(maxlen=16)
        self._answered = -np.inf
        self._fault: str | None = "waiting for a hand"
        self._good = -np.inf
        self._begun = 0.0
        self._lasts = OFTEN / 2.0
        self._moment: Moment | None = None
        self._hand: Hand | None = None
        self._played: deque[_Played] = deque(maxlen=REMEMBERED)
        self._delays: deque[float] = deque(maxlen=REMEMBERED)
        self._frames = self._drives = 0
        self._faded: dict[str, int] = {}

    @property
    def silent(self) -> bool:
        """Whether nothing is emitted."""
        return self._gain.share == 0.0

    def run(self, hands: HandSource, lasts: float, report: Callable[[Status], None]) -> Followed:
        """Go on for some time [s], until the frames end, or Ctrl-C; return what was done."""
        begun = reported = time.monotonic()
        stream = hands.begin(self.arrived)
        with (
            threadpool_limits(1),
            suppress(KeyboardInterrupt),
        ):  # a second thread would wait for the solvers' cores
            while (now := time.monotonic()) < begun + lasts and not (hands.ended and self.silent):
                self.go_on(stream.wait(self.patience(min(now + IDLE, begun + lasts))))
                if time.monotonic() - reported >= REPORTED:
                    reported = time.monotonic()
                    report(self.status())
        done, status = (time.monotonic() - begun, stream.health), self.status()
        report(status)
        self._fade_out()
        return self.followed(*done, status.state)

    def arrived(self, frame: HandFrame, now: float) -> None:
        """Note a frame as it comes, in the thread that received it."""
        if frame.side != self._scene.side:
            return
        self._clock.saw(frame.time, now)
        self._arrivals.append((frame.time, now))
        if self._session is not None:
            self._session.frame(frame)

    def patience(self, latest: float) -> float:
        """Return how long to wait for a frame at most [s]."""
        now = time.monotonic()
        until = latest
        if not self.silent or self._fault is None:
            until = min(self._next(), self._good + STALE)
        return max(until - now, 0.0)

    def _next(self) -> float:
        """Return when to begin a drive without a new frame: not so that the frame that is due would have to wait."""
        begin = self._begun + float(np.clip(2.0 * self._lasts, OFTEN, SELDOM))
        if len(self._arrivals) > 1:
            (_, first), (_, last) = self._arrivals[0], self._arrivals[-1]
            due = last + (last - first) / (len(self._arrivals) - 1)
            if begin < due + JITTER < self._begun + LATEST and begin + self._lasts > due:
                return due + JITTER
        return begin

    def go_on(self, frame: HandFrame | None) -> None:
        """Take what came, and emit what is right now."""
        if frame is not None:
            self._take(frame)
        if self._output.stopped:
            self._end_for_good("stopped", "stopped: the emergency stop was pressed")
            return
        if self._page is not None:
            self._controls = self._page.controls
        now = time.monotonic()
        if self._fault is None and now - self._good >= STALE:
            self._fault = f"stale: no good frame for {1e3 * STALE:.0f} ms"
        on = self._fault is None and self._controls.playing
        if not on and self.silent:
            self._output.beat()
            return
        try:
            self._emit(now, on)
        except LinkFailed:
            if not self._output.stopped:  # the emergency stop came between
                raise

    def _end_for_good(self, state: State, why: str) -> None:
        """Note that the output is silent already, by the emergency stop or by Ctrl-C."""
        before, self._gain, self._fault = self._gain.share, Gain(), why
        if self._moment is not None and before > 0.0:
            silence = replace(self._moment, amplitudes=0.0 * self._moment.amplitudes, state=state)
            self._note(silence, time.monotonic(), before)

    def _fade_out(self) -> None:
        """Fade to silence, unless the boards are silent because of a signal."""
        self._fault = self._fault or "ended"
        try:
            while not self.silent and not self._output.stopped:
                time.sleep(OFTEN)
                self._emit(time.monotonic(), False)
        except LinkFailed as failed:
            if failed.code != "emission_over":
                raise
            self._end_for_good("silent", "ended")

    def _take(self, frame: HandFrame) -> None:
        if frame.side != self._scene.side:
            if self._fault is not None and self._good == -np.inf:
                self._fault = f"waiting for the {self._scene.side} hand: these are frames of the {frame.side} one"
            return
        hand = hand_of(frame, self._scene)
        fault = hand if isinstance(hand, str) else None
        self._hand = None if isinstance(hand, str) else hand
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
            moment = self._made(now)
            wrong = self._wrong_with(moment)
            if wrong is None:
                self._moment = moment
            else:
                on, self._fault = False, wrong
        before = self._gain.share
        share = self._gain.advance(now, on)
        if self._moment is None or (before == 0.0 and not on):
            self._output.beat()
            return
        state = "playing" if on else "silent" if share == 0.0 else "fading"
        cap = min(self._cap, self._controls.cap)
        amplitudes = share * capped(self._moment.amplitudes, cap)
        moment = replace(self._moment, amplitudes=amplitudes, state=state, frames=None)
        made = time.monotonic()
        self._send(amplitudes, share, cap)
        sent = time.monotonic()
        moment = replace(moment, amplitudes=self._output.share * amplitudes)
        self._note(moment, sent, before)
        if on:
            age, frames = (self._clock.time(then) - moment.frame_time for then in (sent, now))
            kept, solver = (np.nan if one is None else one for one in (moment.kept, moment.behind))
            self._played.append(_Played(sent, age, kept, frames, solver, sent - made))
            self._lasts += SMOOTHING * (sent - now - self._lasts)

    def _send(
        self, amplitudes: Complex128[np.ndarray, "elements"], share: float, cap: float
    ) -> None:
        """Emit the drive of the moment, or its frames where foci move, at a share of their amplitude."""
        moving, frames = self._scene.moving, None if self._moment is None else self._moment.frames
        if moving is not None and frames is not None and self._controls.modulated and share > 0.0:
            self._output.cycle(share * capped(frames, cap), moving.rate)
            return
        if self._modulated != self._controls.modulated:
            self._modulated = self._controls.modulated
            self._output.modulate(self._scene.modulation if self._modulated else None)
        self._output.send(amplitudes)

    def _made(self, now: float) -> Moment | None:
        """Make a drive; None where none can be made for that hand."""
        try:
            return self._maker.make(self._clock.time(now) + self._lasts, self._controls)
        except InvalidInput:
            return None

    def _wrong_with(self, moment: Moment | None) -> str | None:
        """Return why a drive must not be emitted, in a few words, or None."""
        if moment is not None and moment.joints is not None and moment.foci is not None:
            return self._workspace.fault(moment.joints, moment.foci)
        seen = self._hand
        return (seen and self._workspace.fault(seen.joints, foci_on(seen, self._scene))) or "lost"

    def _note(self, moment: Moment, sent: float, before: float) -> None:
        """Record a drive that reached the link."""
        in_air = self._clock.time(sent)
        self._drives += 1
        if self._session is not None:
            self._session.drive(moment, in_air)
        if self._page is not None:
            self._page.show(moment)
        if moment.state in ("silent", "stopped") and before > 0.0:
            reason = (self._fault or "paused").partition(":")[0]
            self._faded[reason] = self._faded.get(reason, 0) + 1
        if moment.state == "playing" and moment.frame_time > self._answered:
            self._answered = moment.frame_time
            came = next(
                (
                    now
                    for taken, now in reversed(self._arrivals.copy())
                    if taken == moment.frame_time
                ),
                None,
            )
            self._delays.extend([] if came is None else [sent - came])

    def status(self) -> Status:
        """Return how it does."""
        now = time.monotonic()
        span = 2.0 * REPORTED
        recent = [one for one in self._played if now - one.sent <= span]
        state = "playing" if self._fault is None else self._fault
        usual = {
            name: _median([getattr(one, name) for one in recent]) for name in ("age", "kept", *LATE)
        }
        late = {name: usual[name] for name, most in LATE.items() if usual[name] > most}
        if self._played:  # the first drive was less than a second ago
            span = min(span, max(now - self._played[0].sent, REPORTED))
        return Status(state, len(recent) / span, usual["age"], usual["kept"], late)

    def followed(self, seconds: float, health: StreamHealth, state: str) -> Followed:
        """Return what was done."""
        ages = [one.age for one in self._played] or [np.nan]
        times = [one.sent for one in self._played]
        rate = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0
        return Followed(
            seconds=seconds,
            frames=self._frames,
            drives=self._drives,
            rate=rate,
            age=float(np.median(ages)),
            oldest=float(np.percentile(ages, 95)),
            delay=float(np.percentile(self._delays, 95)) if self._delays else np.nan,
            kept=_median([one.kept for one in self._played]),
            faded=dict(self._faded),
            dropped=0 if self._session is None else self._session.dropped,
            health=health,
            stopped=self._output.stopped,
            state=state,
        )


def _median(values: Sequence[float]) -> float:
    """Median of the values that are known; NaN without any."""
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else np.nan
