"""The live loop: it computes drives from the newest frame, and fades to silence on faults."""

import gc
import signal
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from threading import Event, current_thread, main_thread
from types import FrameType

import numpy as np
from jaxtyping import Float64
from threadpoolctl import threadpool_limits

from airtact.acoustics.target import Target
from airtact.drives.head_level import HeadLevel
from airtact.drives.transfer import focus_by_distance
from airtact.emission.link import LinkFailed
from airtact.errors import InvalidInput, of_kind
from airtact.hands.hand import Hand, Side
from airtact.hands.tracking.clock import FrameClock, checked_latency
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.stream import StreamHealth
from airtact.live.moment import Controls, DriveMaker, Moment, State
from airtact.live.output import Output
from airtact.live.page.process import PageProcess
from airtact.live.safety import MAX_FRAME_AGE, Gain, Workspace, hand_of
from airtact.live.scene import SIDES, Amplitudes, LiveScene, foci_on
from airtact.live.session import SessionWriter
from airtact.live.sources import HandSource, checked_seconds
from airtact.live.world import World

# Shortest time between the starts of two drives [s].
MIN_INTERVAL = 1.0 / 120.0

# Time between two status reports [s].
REPORT_INTERVAL = 0.5


@dataclass(frozen=True)
class Status:
    """State of the live loop; its numbers refer to the last second.

    The live loop passes a ``Status`` to the function ``report`` of ``run`` twice a second. ``str``
    converts it to one line.

    Attributes
    ----------
    state : state of the live loop in words, such as "playing" or "waiting for a hand", with the
        reasons for silence and for rejected frames.
    processes : text about processes that have ended; empty if all are running.
    rate : number of drives sent to the boards per second, not counting silent drives.
    age : median time from the newest frame to the sound in the air [s]; NaN if there are no drives.
    kept : median of ``Moment.kept``: the pressure expected at the weakest focus, divided by that of
        a drive computed for the exact hand; NaN if unknown.
    unrecorded : data missing from the session, with the reason; None if it is complete or no
        session is recorded.
    rejected : reason for the latest rejection of an application's message; empty if no message was
        rejected in the last 3 s.
    """

    state: str
    processes: str
    rate: float
    age: float
    kept: float
    unrecorded: str | None = None
    rejected: str = ""

    def __str__(self) -> str:
        """Status in one line."""
        parts = [self.state, self.processes] if self.processes else [self.state]
        if self.rate:
            parts += [f"{self.rate:.0f} drives/s", f"latency {1e3 * self.age:.0f} ms"]
        if np.isfinite(self.kept):
            parts.append(f"{self.kept:.0%} of attainable pressure")
        if self.unrecorded is not None:
            parts.append(f"not recorded: {self.unrecorded}")
        if self.rejected:
            parts.append(f"message rejected: {self.rejected}")
        return ", ".join(parts)


@dataclass(frozen=True)
class Followed:
    """Summary of a run of the live loop, as returned by ``follow``.

    Attributes
    ----------
    seconds : duration of the run [s].
    frames : number of valid frames of the hand.
    drives : number of drives that reached the link, including silent ones.
    rate : drives per second while there was sound; 0 if there was none.
    age, oldest : median and 95th percentile of the time from the newest frame until the sound is in
        the air [s]; NaN if there were no drives.
    delay : 95th percentile of the time from the arrival of a frame until the first drive
        computed from it took effect (see ``Session.time_in_air``) [s]; NaN if there were no drives.
    kept : median of ``Moment.kept``, the expected pressure at the weakest focus divided by that of
        a drive computed for the exact hand; NaN if unknown.
    faded : number of fades to silence for each reason, as a dict.
    dropped : number of frames and drives missing from the session because the disk was too slow.
    health : ``StreamHealth`` with the numbers of received frames and of frames with each kind of
        fault.
    stopped : whether the emergency stop was pressed.
    state : state at the end as text: "playing", or another state with the reason for silence.
    processes : text about processes that ended during the run; empty if none did.
    unrecorded : data missing from the session, with the reason; None if it is
        complete.
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
    processes: str = ""
    unrecorded: str | None = None

    def facts(self) -> list[tuple[str, str]]:
        """Return the summary as pairs of name and value, for display in a table."""
        facts = [
            ("time", f"{self.seconds:.1f} s, {self.frames} frames of the hand"),
            ("messages", str(self.health)),
            ("drives", f"{self.drives:,}, {self.rate:.0f}/s while there was sound"),
        ]
        if np.isfinite(self.age):
            oldest = f"95 % under {1e3 * self.oldest:.1f} ms"
            facts.append(("frame to drive", f"95 % within {1e3 * self.delay:.1f} ms"))
            facts.append(("latency to the sound", f"{1e3 * self.age:.1f} ms, {oldest}"))
        if np.isfinite(self.kept):
            facts.append(("pressure expected", f"{self.kept:.0%} of the attainable pressure"))
        if self.faded:
            reasons = [f"{count} x {reason}" for reason, count in self.faded.items()]
            facts.append(("faded", ", ".join(reasons)))
        if self.state != "playing":
            facts.append(("final state", self.state))
        if self.processes:
            facts.append(("processes", self.processes))
        if self.dropped:
            facts.append(
                ("not recorded", f"{self.dropped} frames and drives: the disk was too slow")
            )
        if self.unrecorded is not None:
            facts.append(("not recorded", self.unrecorded))
        return facts

    def record(self) -> dict[str, float | str | dict[str, int] | None]:
        """Return the summary as a dictionary for JSON; unknown numbers become None."""
        # NaN is the only value that differs from itself.
        return {name: value if value == value else None for name, value in asdict(self).items()}


def follow(
    scene: LiveScene,
    hands: HandSource,
    maker: DriveMaker,
    *,
    output: Output | None = None,
    seconds: float | None = None,
    session: SessionWriter | None = None,
    latency: float = 0.0,
    cap: float | None = None,
    controls: Controls | None = None,
    page: PageProcess | None = None,
    report: Callable[[Status], None] = lambda status: None,
    world: World | None = None,
) -> Followed:
    """Make the sound follow a hand until the time is up, the frames end or Ctrl-C is pressed.

    Parameters
    ----------
    scene : the parts of the scene that stay fixed during the run, as returned by ``live_scene``.
    hands : source of the frames in scene coordinates, as returned by ``hands_from``, which this
        function starts and closes.
    maker : object that computes the drives, such as ``HandAware`` or ``TouchAware``; closed by this
        function.
    output : boards that emit the drives; by default, nothing is emitted.
    seconds : duration [s], above zero; by default, the run lasts until the frames end.
    session : writer that records the run; this function closes it.
    latency : shortest time from the camera image to the frame's arrival, for trackers with their
        own clock [s], 0 to 0.5.
    cap : largest amplitude of an element, as a fraction of full scale, above 0 and at most 1. By
        default, the cap limits the level at a head 0.5 m from the array to 110 dB SPL for all
        positions of the foci; without boards, the cap is 1.
    controls : initial settings; if there is a page, the live loop uses the page's settings instead.
    page : page that shows every drive and can change the controls.
    report : function called twice a second with the ``Status``.
    world : objects and foci that applications can change; the loop also records its state here. By
        default, the objects of the scene are used and do not change.

    Returns
    -------
    A ``Followed``, which summarises the run. It is also returned if Ctrl-C is pressed, which
    silences the output at once.

    Raises
    ------
    InvalidInput
        If the duration, latency or cap is outside its range, or the link cannot be opened.
    LinkFailed
        If the boards fail. All boards that still respond are silenced first.
    """
    of_kind(scene, LiveScene, "the scene", "live_scene(setup)")
    of_kind(hands, HandSource, "the hands", "ReceivedHands(port)")
    of_kind(maker, DriveMaker, "the drive maker", "TouchAware(scene)")
    duration = checked_seconds(seconds)
    output = output or Output()
    if cap is not None:
        output.limit(cap)
    clocks: dict[Side, FrameClock] = {side: hands.stream.clock(side) for side in SIDES}
    for clock in clocks.values():
        clock.latency = checked_latency(latency)
    world = world or World(scene.objects)
    with ExitStack() as closing:
        closing.callback(maker.close)
        if session is not None:
            closing.callback(session.close)
        closing.callback(hands.close)
        closing.enter_context(output)
        # Garbage collection omits all objects that exist now, so that it takes about 1 ms.
        gc.freeze()
        closing.callback(gc.unfreeze)
        if session is not None:
            session.begin()
        controls = controls or Controls()
        loop = _Loop(scene, maker, output, clocks, session, cap, controls, page, world)
        done = loop.run(hands, duration, report)
    # Closing the session may reveal another fault.
    return done if session is None else replace(done, unrecorded=session.fault)


@dataclass(eq=False)
class _Loop:
    """State of the loop."""

    scene: LiveScene
    maker: DriveMaker
    output: Output
    clocks: dict[Side, FrameClock]
    session: SessionWriter | None
    given_cap: float | None
    controls: Controls
    page: PageProcess | None
    world: World
    gain: Gain = field(default_factory=Gain)
    modulated: bool = False
    # Pairs of times on the frames' clock and the computer's, used to predict the next frame.
    arrivals: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=16))
    answered: float = -np.inf  # time in the newest frame from which a drive was computed
    fault: str | None = "waiting for a hand"  # reason for silence
    last_good: float = -np.inf  # when the last valid frame was taken
    begun: float = 0.0  # when the computation of the last drive began
    duration: float = MIN_INTERVAL / 2.0  # running mean of the time to compute and send a drive
    # Times from the start of each recent drive to the link, and when the newest drive takes effect.
    durations: deque[float] = field(default_factory=lambda: deque(maxlen=100))
    acts: float = 0.0
    moment: Moment | None = None  # the last safe drive
    hands: dict[Side, Hand] = field(default_factory=dict)
    good: dict[Side, float] = field(default_factory=dict)  # when each hand was last valid
    # Foci for which the cap has already been checked against the level at a head.
    capped: list[Float64[np.ndarray, "3"]] = field(default_factory=list)
    # When each recent drive with sound was sent, its age and its expected share.
    played: deque[dict[str, float]] = field(default_factory=lambda: deque(maxlen=4096))
    delays: deque[float] = field(default_factory=lambda: deque(maxlen=4096))
    frames: int = 0
    drives: int = 0
    faded: Counter[str] = field(default_factory=Counter)
    healthy: StreamHealth = field(default_factory=StreamHealth)  # while sound was last possible

    def __post_init__(self) -> None:
        self.workspace = Workspace(self.scene)
        # If no cap is given, the cap for boards is computed from the foci.
        self.limited = self.given_cap is None and self.output.levels is not None
        self.cap = 1.0 if self.given_cap is None else self.given_cap
        self.clock = self.clocks[self.scene.side]

    @property
    def silent(self) -> bool:
        return self.gain.share == 0.0

    def run(self, hands: HandSource, duration: float, report: Callable[[Status], None]) -> Followed:
        """Run for ``duration`` [s], or until the frames end or Ctrl-C is pressed."""
        begun = time.monotonic()
        reported = begun
        stream = hands.begin(self.arrived)
        # Use a single thread, because more would compete with the solvers for processor cores.
        with threadpool_limits(1), suppress(KeyboardInterrupt), _noticing_ctrl_c() as pressed:
            while (now := time.monotonic()) < begun + duration:
                if pressed.is_set() or (hands.ended and self.silent):
                    break
                self.advance(stream.wait(self.patience(min(now + 0.02, begun + duration))))
                if time.monotonic() - reported >= REPORT_INTERVAL:
                    reported = time.monotonic()
                    status = self.status(stream.health, hands.remark())
                    report(status)
                    if self.page is not None:
                        self.page.tell(status)
                    # Closed connections and rejected messages contain cycles of references, which
                    # Python would only free after an hour.
                    gc.collect()
        seconds = time.monotonic() - begun
        health = stream.health
        status = self.status(health, hands.remark())
        report(status)
        self._fade_out()
        ages = [played["age"] for played in self.played] or [np.nan]
        rate = 0.0
        if len(self.played) > 1:
            rate = (len(self.played) - 1) / (self.played[-1]["sent"] - self.played[0]["sent"])
        return Followed(
            seconds=seconds,
            frames=self.frames,
            drives=self.drives,
            rate=rate,
            age=float(np.median(ages)),
            oldest=float(np.percentile(ages, 95)),
            delay=float(np.percentile(self.delays, 95)) if self.delays else np.nan,
            kept=_median([played["kept"] for played in self.played]),
            faded=dict(self.faded),
            dropped=0 if self.session is None else self.session.dropped,
            health=health,
            stopped=self.output.stopped,
            state=status.state,
            processes=status.processes,
        )

    def arrived(self, frame: HandFrame, now: float) -> None:
        """Record the arrival of a frame; called from the thread that received it."""
        if frame.side != self.scene.side and not self.scene.both:
            return
        self.arrivals.append((frame.time, now))
        if self.session is not None:
            self.session.frame(frame)

    def patience(self, latest: float) -> float:
        """Return the longest time to wait for the next frame [s]."""
        until = latest
        playing = self.fault is None and self.controls.playing
        if playing or not self.silent:
            until = self._next_drive()
        # During a fade this time has already passed, so it cannot pace the drives.
        if playing:
            until = min(until, self.last_good + MAX_FRAME_AGE)
        return max(until - time.monotonic(), 0.0)

    def _next_drive(self) -> float:
        """Return when to start a drive if no frame arrives, so as not to delay the next drive."""
        begin = self.begun + float(np.clip(2.0 * self.duration, MIN_INTERVAL, 1.0 / 66.0))
        if len(self.arrivals) > 1:
            first = self.arrivals[0][1]
            last = self.arrivals[-1][1]
            due = last + (last - first) / (len(self.arrivals) - 1)
            # If a frame is due while the drive would be computed, wait for it, plus 4 ms for
            # jitter, unless the drive would then follow the previous one by more than 22 ms.
            wait_until = due + 4e-3
            overlaps = begin < wait_until and begin + self.duration > due
            if overlaps and wait_until < self.begun + 1.0 / 45.0:
                return wait_until
        return begin

    def advance(self, frame: HandFrame | None) -> None:
        """Process a frame, if there is one, and emit a drive if it is due."""
        if frame is not None:
            self._take(frame)
        if self.output.stopped:
            self._end_for_good("stopped", "stopped: the emergency stop was pressed")
            self.world.show(None, self.fault)
            return
        if self.page is not None:
            self.controls = self.page.controls
        now = time.monotonic()
        if self.fault is None and now - self.last_good >= MAX_FRAME_AGE:
            self.fault = f"stale: no valid frame for {1e3 * MAX_FRAME_AGE:.0f} ms"
        on = self.fault is None and self.controls.playing
        if not on and self.silent:
            self.output.beat()
            self.world.show(None, self.fault)
            return
        try:
            self._emit(now, on)
        except LinkFailed:
            if not self.output.stopped:  # otherwise the emergency stop came in between
                raise

    def _end_for_good(self, state: State, why: str) -> None:
        """Record that the emergency stop or Ctrl-C silenced the output."""
        before = self.gain.share
        self.gain = Gain()
        self.fault = why
        if self.moment is not None and before > 0.0:
            silence = replace(self.moment, amplitudes=0.0 * self.moment.amplitudes, state=state)
            self._note(silence, time.monotonic(), before)

    def _fade_out(self) -> None:
        """Fade to silence, unless a signal has already silenced the boards."""
        self.fault = self.fault or "ended"
        try:
            while not self.silent and not self.output.stopped:
                time.sleep(MIN_INTERVAL)
                self._emit(time.monotonic(), False)
        except LinkFailed as failed:
            if failed.code != "emission_over":
                raise
            self._end_for_good("silent", "ended")

    def _take(self, frame: HandFrame) -> None:
        side = self.scene.side
        if frame.side != side and not self.scene.both:
            if self.fault is not None and self.last_good == -np.inf:
                self.fault = f"waiting for the {side} hand, but the frames show the {frame.side}"
            return
        hand = hand_of(frame, self.scene)
        self.hands.pop(frame.side, None)
        now = time.monotonic()
        try:
            if isinstance(hand, str):
                self.maker.take(HandFrame(frame.time, frame.side, frame.sequence))
                raise InvalidInput(hand, code="data_missing")
            self.maker.take(frame)
        except InvalidInput as fault:
            # A faulty frame silences the sound at once, unless there is a second hand.
            # MAX_FRAME_AGE only applies to missing frames.
            self.good.pop(frame.side, None)
            if all(now - last >= MAX_FRAME_AGE for last in self.good.values()):
                self.fault = str(fault)
            return
        assert isinstance(hand, Hand)
        self.hands[frame.side] = hand
        self.good[frame.side] = now
        # Use the clock of the scene's hand, or the other hand's while only that one is seen.
        if now - self.good.get(side, -np.inf) >= MAX_FRAME_AGE:
            self.clock = self.clocks[frame.side]
        elif frame.side == side:
            self.clock = self.clocks[side]
        self.fault = None
        self.last_good = now
        self.frames += 1

    def _emit(self, now: float, on: bool) -> None:
        """Emit the newest drive if it is safe; otherwise, fade out the last safe one."""
        self.begun = now
        if on:
            moment = self._made(now)
            fault = self._fault_of(moment) or self.clock.fault
            ready = time.monotonic()
            if fault is None and ready > self.acts + 0.05:
                # The computer paused, and the hand has left the place since.
                fault = f"late: the drive took {1e3 * (ready - now):.0f} ms"
                self._took(ready - now)
                now = ready
            if fault is None:
                self.moment = moment
            else:
                on = False
                self.fault = fault
        # The gain scales everything that is sent, so that the sound rises and fades smoothly.
        before = self.gain.share
        share = self.gain.advance(now, on)
        if self.moment is None or (before == 0.0 and not on):
            self.output.beat()
            return
        state = "playing" if on else "silent" if share == 0.0 else "fading"
        if self.limited:
            self._limit(self.moment)
        cap = min(self.cap, self.controls.cap)
        # A drive for weak foci must stay below full scale, so the cap scales every drive.
        amplitudes = share * cap * self.moment.amplitudes
        self._send(amplitudes, share, cap)
        reached = time.monotonic()
        sent = max(reached, self.acts) if self.output.lead else reached
        # The session records what the boards actually emitted, including their own ramp.
        emitted = self.output.share * amplitudes
        moment = replace(self.moment, amplitudes=emitted, state=state, frames=None)
        self._note(moment, sent, before)
        self.world.show(moment, self.fault, share * cap)
        if on:
            self.played.append(
                {
                    "sent": sent,
                    "age": self.clock.time(sent) - moment.frame_time,
                    "kept": np.nan if moment.kept is None else moment.kept,
                }
            )
            self._took(reached - now)

    def _took(self, seconds: float) -> None:
        """Record how long a drive took; later hands are predicted this far ahead."""
        self.durations.append(seconds)
        # One slow drive must not move the prediction so far ahead that the hand counts as lost.
        self.duration += 0.1 * (min(seconds, 0.1) - self.duration)

    def _limit(self, moment: Moment) -> None:
        """Lower the cap if the level at a head would be too high for the current foci."""
        assert self.output.levels is not None
        for focus in [] if moment.foci is None else moment.foci:
            # The level changes little within 30 mm.
            if self.capped and np.linalg.norm(self.capped - focus, axis=1).min() < 0.03:
                continue
            # A single focus at full scale is louder at a head than one of several.
            scene = self.scene
            drive = focus_by_distance(
                scene.array, Target(focus), scene.medium, scene.frequency
            ).amplitudes
            level = HeadLevel(
                drive[None],
                scene.array.positions,
                self.output.levels,
                scene.wavenumber.real,
                scene.array.element.sensitivity,
            )
            self.capped.append(focus)
            self.cap = min(self.cap, level.safe_cap())
            self.output.limit(self.cap)

    def _send(self, amplitudes: Amplitudes, share: float, cap: float) -> None:
        assert self.moment is not None
        frames = self.moment.frames
        if frames is not None and self.controls.modulated and share > 0.0:
            rate = self.moment.rate
            if self.output.cycles(len(frames), rate):
                self.modulated = False  # playing frames ends the modulation
                self.output.cycle(share * cap * frames, rate)
                return
        if self.modulated != self.controls.modulated:
            self.modulated = self.controls.modulated
            self.output.modulate(self.scene.modulation if self.modulated else None)
        self.output.send(amplitudes, self.acts)

    def _made(self, now: float) -> Moment | None:
        self.maker.feel(self.world.objects, self.world.foci(now))
        self.acts = now + self.duration
        if self.output.lead and self.durations:
            # Send drives ahead, so that 9 out of 10 take effect at the time for which they were
            # computed.
            self.acts = now + min(float(np.percentile(self.durations, 90)), self.output.lead)
        try:
            return self.maker.make(self.clock.time(self.acts), self.controls)
        except InvalidInput:
            return None

    def _fault_of(self, moment: Moment | None) -> str | None:
        """Return a short reason for silence; None if sound may be emitted."""
        if moment is not None and moment.foci is not None:
            faults = [
                self.workspace.fault(joints, moment.foci)
                for joints in (moment.joints, moment.other)
                if joints is not None
            ]
            return next((fault for fault in faults if fault is not None), None)
        # Without a prediction, only the newest frame can show whether the hand left the workspace.
        fault = None
        hand = self.hands.get(self.scene.side)
        if hand is not None:
            foci = np.zeros((0, 3)) if self.scene.both else foci_on(hand, self.scene)
            fault = self.workspace.fault(hand.joints, foci)
            # Frames are arriving, but they were captured too long ago.
            if moment is not None and time.monotonic() - self.last_good < MAX_FRAME_AGE / 2.0:
                age = moment.time - moment.frame_time
                fault = fault or f"late: the frames are {1e3 * age:.0f} ms old"
        return fault or "lost"

    def _note(self, moment: Moment, sent: float, before: float) -> None:
        """Record a drive that reached the link; ``before`` is the gain before this drive."""
        self.drives += 1
        if self.session is not None:
            self.session.drive(moment, self.clock.time(sent))
        if self.page is not None:
            self.page.show(moment)
        if moment.state in ("silent", "stopped") and before > 0.0:
            self.faded[(self.fault or "paused").partition(":")[0]] += 1
        if moment.state == "playing" and moment.frame_time > self.answered:
            self.answered = moment.frame_time
            # Copy the deque, because the thread that receives frames appends to it.
            for taken, arrived in reversed(self.arrivals.copy()):
                if taken == moment.frame_time:
                    self.delays.append(sent - arrived)
                    break

    def status(self, health: StreamHealth, remark: str = "") -> Status:
        now = time.monotonic()
        state = self.fault or "playing"
        if self.fault is None and self.moment is not None and not self.moment.amplitudes.any():
            state = "no contact"
        parts = [state, health.rejected_since(self.healthy), remark]
        state = "; ".join(part for part in parts if part)
        # Restart solvers that ended, and report all processes that ended.
        restarts = self.maker.revive()
        ended = [f"solvers ended and restarted: {restarts}"] if restarts else []
        if self.page is not None and self.page.ended:
            ended.append("the page's process ended")
        if self.fault is None:
            self.healthy = health
        span = 2.0 * REPORT_INTERVAL
        recent = [played for played in self.played if now - played["sent"] <= span]
        if self.played:  # the first drive may be less than a second old
            span = min(span, max(now - self.played[0]["sent"], REPORT_INTERVAL))
        return Status(
            state,
            ", ".join(ended),
            len(recent) / span,
            _median([played["age"] for played in recent]),
            _median([played["kept"] for played in recent]),
            None if self.session is None else self.session.fault,
            self.world.rejection,
        )


@contextmanager
def _noticing_ctrl_c() -> Iterator[Event]:
    """Yield an event that is set on Ctrl-C, in addition to its usual effect.

    Python discards a ``KeyboardInterrupt`` that is raised while an object is being deleted.
    """
    pressed = Event()
    if current_thread() is not main_thread():
        yield pressed
        return
    before = signal.getsignal(signal.SIGINT)

    def interrupt(kind: int, frame: FrameType | None) -> None:
        pressed.set()
        if callable(before):
            before(kind, frame)

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, before)


def _median(values: Sequence[float]) -> float:
    finite = [value for value in values if np.isfinite(value)]
    return float(np.median(finite)) if finite else np.nan
