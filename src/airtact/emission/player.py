"""What a link process does with its link: ramp, cap, modulation, sequences, watchdog, silence, and the log."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.drives.frame import Frame, frame_at, share_under_cap
from airtact.emission.link import Link, LinkFailed
from airtact.errors import InvalidInput

Drives = Complex128[np.ndarray, "elements"]


@dataclass(frozen=True)
class Settings:
    """How a link is played: a cap, a ramp [s], the watchdog's patience [s], the log, whether it resumes."""

    cap: float
    ramp: float
    patience: float
    log: Path | None
    resumes: bool = False


@dataclass
class Repeated:
    """Frames that are played over and over, and how far that has come."""

    frames: Sequence[Frame]
    rate: float
    seconds: float
    begun: float | None = None
    index: int = 0
    sent: int = 0
    dropped: int = 0

    @property
    def total(self) -> int:
        """How many frames the whole time takes."""
        return max(round(self.seconds * self.rate), 1)


@dataclass(frozen=True)
class Swing:
    """A modulation that goes on whatever is sent: factors on the amplitudes, frames a second, and when it began."""

    envelope: Float64[np.ndarray, "frames"]
    rate: float
    begun: float

    def factor(self, now: float) -> float:
        """Return the factor at a time."""
        return float(self.envelope[int((now - self.begun) * self.rate) % len(self.envelope)])


@dataclass(frozen=True)
class Round:
    """Drives that are played in turn, over and over: their frames at full amplitude, so many a second, since when."""

    drives: Complex128[np.ndarray, "frames elements"]
    frames: Sequence[Frame]
    rate: float
    begun: float

    def index(self, now: float) -> int:
        """Return which frame is due at a time."""
        return int((now - self.begun) * self.rate) % len(self.frames)


class Player:
    """Plays one link step by step; nothing here waits, and every command returns at once.

    Commands are the methods without an underscore that ``Emission`` calls by name; ``step`` does
    what is due. Faults of a step are raised by the next command that feeds the watchdog.
    """

    def __init__(self, link: Link, settings: Settings) -> None:
        self.link = link
        self._set = settings
        self.over: str | None = None
        self._failure: LinkFailed | None = None
        self._trouble: Exception | None = None
        self._log: TextIO | None = None
        self._drive: Drives | None = None
        self._full: Frame | None = None
        self._share = 1.0
        self._gain = 0.0
        self._slope = 0.0
        self._pause = 0.0
        self._next_step = 0.0
        self._swing: Swing | None = None
        self._next_frame = 0.0
        self._repeated: Repeated | None = None
        self._round: Round | None = None
        self._emitting = self._waiting = False
        self._fed = self._looked = time.monotonic()

    # --- commands -----------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Open the link and the log."""
        if self._set.log is not None:
            try:
                self._log = self._set.log.open("a", buffering=1, encoding="utf-8")
            except OSError as error:
                raise InvalidInput(
                    f"the log {self._set.log} cannot be written (error {error.errno}): {error.strerror}.",
                    code="not_writable",
                ) from None
        self.link.open()
        self._write("opened")
        self._fed = time.monotonic()

    def send(
        self, amplitudes: Complex128[np.ndarray, "elements"], wait: bool = True
    ) -> tuple[Frame, float, float]:
        """Play a drive from now on; return its frame at full amplitude, how long the ramp still takes [s], its gain.

        Without waiting, the frame is on its way after the answer, and a fault is raised by the next
        command.
        """
        self._feed()
        self._repeated = self._round = None
        self._drive = amplitudes
        self._share = share_under_cap(amplitudes[None], self.link.levels, self._set.cap)
        self._full = full = frame_at(amplitudes, self.link.levels, self._share)
        if not self.link.real_time:
            self._transmit(full)
            return full, 0.0, 1.0
        if full.silent:
            self._gain = self._slope = 0.0
        elif self._gain == 0.0 or self._slope < 0.0:
            self._rise()
        self._waiting = full.silent or not self._paced
        if wait:
            self._catch_up()
        self._fed = time.monotonic()
        return full, self.left(), self._gain

    def cycle(
        self, drives: Complex128[np.ndarray, "frames elements"], rate: float
    ) -> tuple[float, float]:
        """Play drives in turn from now on, at the place in the round where those before are.

        A round of another length or rate begins anew. A modulation ends. Return how long the ramp
        still takes [s], and its gain.
        """
        self._feed()
        link = self.link
        now = time.monotonic()
        before = self._round
        self._share = share_under_cap(drives, link.levels, self._set.cap)
        frames = [frame_at(drive, link.levels, self._share) for drive in drives]
        goes_on = before is not None and len(before.frames) == len(frames) and before.rate == rate
        self._round = one = Round(
            drives, frames, rate, before.begun if goes_on and before is not None else now
        )
        self._repeated = None
        self._swing = None
        self._waiting = False
        self._drive = drives[np.linalg.norm(drives, axis=1).argmax()]
        self._full = None
        if not link.real_time:
            self._transmit(frames[one.index(now)])
            return 0.0, 1.0
        if link.modulates_itself:
            link.modulate(None, 0.0)
        if self._gain == 0.0 or self._slope < 0.0:
            self._rise()
        if not goes_on:
            self._next_frame = now
        if link.plays_itself and self._gain == 1.0:
            self._turn(one)
        self._fed = time.monotonic()
        return self.left(), self._gain

    def play(
        self,
        drives: Complex128[np.ndarray, "drives elements"],
        factors: Float64[np.ndarray, "frames"],
        rate: float,
        seconds: float,
    ) -> float:
        """Play drives, or one drive at several factors, over and over; return how long that takes [s]."""
        self._feed()
        link = self.link
        self._share = share_under_cap(drives, link.levels, self._set.cap)
        rows = np.arange(len(factors)) % len(drives)
        frames = [
            frame_at(drives[row], link.levels, self._share * f)
            for row, f in zip(rows, factors, strict=True)
        ]
        repeated = Repeated(frames, rate, seconds)
        self._repeated = repeated
        self._round = None
        self._waiting = False
        if not link.real_time:
            link.play([frames[index % len(frames)] for index in range(repeated.total)], rate)
            repeated.begun, repeated.sent, repeated.index = -np.inf, repeated.total, repeated.total
            return 0.0
        self._drive = drives[np.linalg.norm(drives, axis=1).argmax()]
        self._full = None
        if not self._emitting:
            self._rise()
        if self._gain == 1.0:
            self._begin(repeated)
        else:
            self._transmit(self._now())
        self._fed = time.monotonic()
        return self.left()

    def played(self) -> tuple[float, int, int]:
        """Return the rate that a sequence was played at, and how many of its frames were sent and dropped."""
        one = self._repeated
        if one is None or one.begun is None:
            return 0.0, 0, 0
        if self.link.plays_itself:
            return (
                one.rate,
                one.total if not self.link.real_time else round(one.seconds * one.rate),
                0,
            )
        return one.sent / (time.monotonic() - one.begun), one.sent, one.dropped

    def modulate(self, envelope: Float64[np.ndarray, "frames"] | None, rate: float) -> None:
        """Vary the amplitude of whatever is sent from now on, or stop that; a round ends."""
        self._feed()
        self._round = None
        if self.link.modulates_itself:
            self.link.modulate(envelope, rate)
        else:
            now = time.monotonic()
            self._swing = None if envelope is None else Swing(envelope, rate, now)
            self._next_frame = now
        if self._emitting and self._repeated is None and not self._paced:
            self._transmit(self._now())

    def silence(self, fade: float) -> float:
        """Let the sound fade; the next drive rises over the ramp. Return how long that takes [s]."""
        self._feed()
        self._repeated = None
        self._waiting = False
        if self._emitting:
            self._slope_over(fade, -1.0)
            self._fade_step()
        return self.left()

    def beat(self) -> float:
        """Feed the watchdog; return how long a ramp or a sequence still takes [s]."""
        self._feed()
        return self.left()

    def finish(self, why: str) -> None:
        """Silence the boards for good; remember why."""
        if self.over is None:
            self.over = why
        elif self._failure is None:
            return
        self._failure = None
        self._silence_for_good()

    def ask(self, name: str, *arguments: object) -> object:
        """Call a method of the link that does not change what it plays."""
        return getattr(self.link, name)(*arguments)

    def close(self) -> tuple[str | None, Frame | None]:
        """Close the link; return why the emission was over, and the last frame."""
        try:
            self.link.close()
        finally:
            self._write("closed")
            if self._log is not None:
                self._log.close()
                self._log = None
        return self.over, self.link.last

    # --- what is due --------------------------------------------------------------------------------------------

    def left(self) -> float:
        """Return how long a ramp, a fade or a sequence still takes [s]; 0 only when it is over."""
        now = time.monotonic()
        one = self._repeated
        left = 0.0
        if self._slope > 0.0:
            left = (
                self._next_step - now + self._pause * (round((1.0 - self._gain) / self._slope) - 1)
            )
        elif self._slope < 0.0:
            left = self._next_step - now + self._pause * (round(self._gain / -self._slope) - 1)
        if one is not None and one.begun is None:
            left += one.seconds
        elif one is not None and one.begun is not None:
            left = max(one.begun + one.seconds - now, 0.0)
            if not self.link.plays_itself and one.index < one.total:
                return max(left, 1e-3)
            return left
        return left if self._slope == 0.0 else max(left, 1e-3)

    def wait(self) -> float:
        """Return how long nothing is due [s]."""
        if self._waiting:
            return 0.0
        # 0.05: time between two looks around where nothing is due [s].
        due = [0.05]
        now = time.monotonic()
        if self._slope != 0.0:
            due.append(self._next_step - now)
        if self._paced and self._gain > 0.0:
            due.append(self._next_frame - now)
        one = self._repeated
        if (
            one is not None
            and one.begun is not None
            and not self.link.plays_itself
            and one.index < one.total
        ):
            due.append(one.begun + one.index / one.rate - now)
        if self._emitting:
            due.append(self._fed + self._set.patience - now)
        return max(min(due), 0.0)

    def step(self) -> None:
        """Do what is due now."""
        if self.over is not None or not self.link.real_time:
            return
        try:
            self._step(time.monotonic())
        except Exception as error:
            self._trouble = error
            self._repeated = None
            self._slope = 0.0
            self._waiting = False
            self._looked = time.monotonic()

    def _catch_up(self) -> None:
        """Transmit the newest drive, if it was not yet."""
        if self._waiting:
            self._waiting = False
            self._transmit(self._now())

    def _step(self, now: float) -> None:
        self._catch_up()
        if self._emitting and now - self._fed >= self._set.patience:
            self._starved(f"no call came for {self._set.patience:g} s")
            return
        if self._slope != 0.0 and now >= self._next_step:
            self._ramp_step()
        one = self._repeated
        if one is not None and one.begun is not None and not self.link.plays_itself:
            self._pace(one)
        elif self._paced and self._gain > 0.0 and now >= self._next_frame:
            self._transmit(self._now())
            self._next_frame += (1.0 + np.floor((now - self._next_frame) * self._rate)) / self._rate
        # 0.1: time between two checks that the boards are still connected [s].
        if self._emitting and self._trouble is None and now - self._looked > 0.1:
            self._looked = now
            self.link.probe()

    def _starved(self, why: str) -> None:
        """Silence the boards because no call came: for good, or until the next drive."""
        if not self._set.resumes:
            self.finish(why)
            return
        self._write(why)
        self._repeated = None
        self._round = None
        self._waiting = False
        self._slope = self._gain = 0.0
        self._silence()

    @property
    def _paced(self) -> bool:
        """Whether frames of a modulation or of a round must be sent in time."""
        by_boards = self._round is not None and self.link.plays_itself
        return (
            (self._swing is not None or self._round is not None)
            and self._repeated is None
            and not by_boards
        )

    @property
    def _rate(self) -> float:
        """Frames a second that must be sent in time."""
        one = self._round or self._swing
        return 1.0 if one is None else one.rate

    def _pace(self, one: Repeated) -> None:
        """Send the frame of a sequence that is due; leave out those that would be late by a whole frame."""
        if one.index >= one.total or one.begun is None:
            return
        late = time.monotonic() - one.begun - one.index / one.rate
        if late < 0.0:
            return
        if late > 1.0 / one.rate:
            missed = min(int(late * one.rate), one.total - one.index - 1)
            one.index, one.dropped = one.index + missed, one.dropped + missed
        self._transmit(one.frames[one.index % len(one.frames)])
        one.index, one.sent = one.index + 1, one.sent + 1

    def _begin(self, one: Repeated) -> None:
        if self.link.plays_itself:
            self._emitting = True
            self.link.play(one.frames, one.rate)
            self._noted(max(float(self._largest(frame)) for frame in one.frames))
            one.begun, one.index = time.monotonic(), one.total
        else:
            one.begun = time.monotonic()
            self._pace(one)

    def _turn(self, one: Round) -> None:
        """Have the boards play a round by themselves."""
        self._emitting = True
        self.link.play(one.frames, one.rate)
        self._emitting = not all(frame.silent for frame in one.frames)
        self._looked = time.monotonic()
        self._noted(max(self._largest(frame) for frame in one.frames))

    # --- ramps --------------------------------------------------------------------------------------------------

    def _rise(self) -> None:
        self._slope_over(self._set.ramp, 1.0)
        self._raise()

    def _slope_over(self, seconds: float, sign: float) -> None:
        # 0.025: how long one step of a ramp lasts [s].
        steps = max(int(np.ceil(seconds / 0.025)), 1)
        self._slope = sign / steps
        self._pause = seconds / steps

    def _raise(self) -> None:
        """Raise the gain by a step; at 1 the ramp is over."""
        self._gain += self._slope
        self._next_step = time.monotonic() + self._pause
        if self._gain > 1.0 - 1e-6:
            self._gain = 1.0
            self._slope = 0.0

    def _ramp_step(self) -> None:
        if self._slope < 0.0:
            self._fade_step()
            return
        self._raise()
        one = self._repeated
        if one is not None and one.begun is None and self._gain == 1.0:
            self._begin(one)
        elif self._round is not None and self.link.plays_itself and self._gain == 1.0:
            self._turn(self._round)
        elif not self._paced:
            self._transmit(self._now())

    def _fade_step(self) -> None:
        self._gain += self._slope
        self._next_step = time.monotonic() + self._pause
        if self._gain < 1e-6:
            self._gain = self._slope = 0.0
            self._silence()
        elif not self._paced:
            self._transmit(self._now())

    def _now(self) -> Frame:
        """Return the newest drive at the gain and the modulation of now."""
        assert self._drive is not None
        one = self._round
        if one is not None and self._repeated is None and not self.link.plays_itself:
            index = one.index(time.monotonic())
            return one.frames[index] if self._gain == 1.0 else self._rounded(one.drives[index])
        factor = (
            1.0
            if self._swing is None or self._repeated is not None
            else self._swing.factor(time.monotonic())
        )
        if self._full is not None and self._gain * factor == 1.0:
            return self._full
        return self._rounded(self._drive, factor)

    def _rounded(self, drive: Drives, factor: float = 1.0) -> Frame:
        return frame_at(drive, self.link.levels, self._share * self._gain * factor)

    # --- the link -----------------------------------------------------------------------------------------------

    def _transmit(self, frame: Frame) -> None:
        audible = self.link.real_time and (
            not frame.silent or (self._swing is not None and self._gain > 0.0)
        )
        self._emitting = self._emitting or audible
        self.link.send(frame)
        self._emitting = audible
        self._looked = time.monotonic()
        self._noted(self._largest(frame))

    def _feed(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self.over is not None:
            raise LinkFailed(
                f"the emission is over because {self.over}, after {self.link.sent} frames, and nothing was sent.",
                self.link.last,
                self.link.sent,
                code="emission_over",
            )
        self._fed = time.monotonic()
        trouble = self._trouble
        self._trouble = None
        if trouble is not None:
            raise trouble

    def _silence_for_good(self) -> None:
        self._repeated = self._swing = self._round = None
        self._waiting = False
        self._slope = self._gain = 0.0
        self._silence()

    def _silence(self) -> None:
        before = self.link.last
        sent = self.link.sent
        # 3: how often silence is sent until it is confirmed.
        for last_try in [False] * (3 - 1) + [True]:
            try:
                self.link.stop()
            except BaseException as error:
                if last_try:
                    sentence = str(error).rstrip(".") or repr(error)
                    self._failure = LinkFailed(
                        f"{sentence}; the boards may still emit: cut their power.",
                        before,
                        sent,
                        code="silence_failed",
                    )
                    raise self._failure from error
            else:
                self._emitting = False
                if self.link.real_time:
                    self._write("silence confirmed")
                return

    def _largest(self, frame: Frame) -> float:
        return float(frame.levels.amplitudes[frame.amplitude.max()])

    def _noted(self, largest: float) -> None:
        self._write(f"frame {self.link.sent} loudest {largest:.4g}")

    def _write(self, event: str) -> None:
        """Write a line of the log: when, by the system's monotonic clock, and what."""
        if self._log is not None:
            try:
                self._log.write(f"{time.monotonic():.6f} {event}\n")
            except OSError:
                self._log = None  # a full disk is no reason to stop
