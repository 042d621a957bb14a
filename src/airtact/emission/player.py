"""Playback of one link in its process: ramp, cap, modulation, sequences, watchdog, silence, log."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.drives.frame import Frame, frame_at, share_under_cap
from airtact.emission.link import Link, LinkFailed


@dataclass(frozen=True)
class Settings:
    """Cap, ramp [s], patience of the watchdog [s], log file, and whether an emission resumes."""

    cap: float
    ramp: float
    patience: float
    log: Path | None
    resumes: bool = False


@dataclass
class Playback:
    """A sequence repeated for a limited time, and its position; ``begun`` is infinite before."""

    frames: Sequence[Frame]
    rate: float
    seconds: float
    begun: float = np.inf
    index: int = 0
    sent: int = 0
    dropped: int = 0

    @property
    def total(self) -> int:
        """Number of frames in the whole time."""
        return max(round(self.seconds * self.rate), 1)

    @property
    def due(self) -> float:
        """Time at which the next frame is due [s]; infinite before the start and after the end."""
        return self.begun + self.index / self.rate if self.index < self.total else np.inf


@dataclass(frozen=True)
class Cycle:
    """Items repeated at a rate [1/s]: factors of a modulation, or drives with their frames."""

    items: np.ndarray | list[Any]
    rate: float
    begun: float

    def at(self, now: float) -> Any:
        """Return the item that is due at a time [s]."""
        return self.items[int((now - self.begun) * self.rate) % len(self.items)]


class Player:
    """Plays one link step by step. Nothing here waits: every command returns at once.

    ``Emission`` calls the methods without an underscore by name. ``step`` does what is due. The
    next command that feeds the watchdog raises the fault of a step.
    """

    def __init__(self, link: Link, settings: Settings) -> None:
        self.link = link
        self.over: str | None = None
        self._settings = settings
        self._failure: LinkFailed | None = None
        self._trouble: Exception | None = None
        self._log: TextIO | None = None
        self._drive: np.ndarray | None = None
        self._full: Frame | None = None
        self._share = 1.0
        self._gain = 0.0
        self._slope = 0.0
        self._pause = 0.0
        self._next_step = 0.0
        self._next_frame = 0.0
        self._modulation: Cycle | None = None
        self._playback: Playback | None = None
        self._round: Cycle | None = None
        self._emitting = False
        self._waiting = False
        self._fed = time.monotonic()
        self._looked = self._fed

    # --- commands ---

    def open(self) -> None:
        """Open the link and the log."""
        if self._settings.log is not None:
            # Append: where this process replaces a lost one, the log goes on.
            self._log = self._settings.log.open("a", buffering=1, encoding="utf-8")
        self.link.open()
        self._write("opened")
        self._fed = time.monotonic()

    def send(
        self, amplitudes: Complex128[np.ndarray, "elements"], wait: bool = True
    ) -> tuple[Frame, float, float]:
        """Play a drive from now on; return its full frame, the rest of the ramp [s], and the gain.

        Without ``wait``, the frame is sent after the answer, and the next command raises a fault.
        """
        self._feed()
        self._playback = None
        self._round = None
        self._drive = amplitudes
        self._share = share_under_cap(amplitudes[None], self.link.levels, self._settings.cap)
        self._full = full = frame_at(amplitudes, self.link.levels, self._share)
        if not self.link.real_time:
            self._transmit(full)
            return full, 0.0, 1.0
        # Silence needs no ramp, and the next drive rises again.
        if full.silent:
            self._gain = 0.0
            self._slope = 0.0
        elif self._gain == 0.0 or self._slope < 0.0:
            self._rise()
        # A modulation sends the drive when its next frame is due; silence cannot wait for that.
        self._waiting = full.silent or self._paced is None
        if wait:
            self._catch_up()
        self._fed = time.monotonic()
        return full, self.left(), self._gain

    def cycle(
        self, drives: Complex128[np.ndarray, "frames elements"], rate: float
    ) -> tuple[float, float]:
        """Play drives in turn from now on; return the rest of the ramp [s] and the gain.

        A modulation ends. A round of the same length and rate as the one before continues at its
        place.
        """
        self._feed()
        link = self.link
        now = time.monotonic()
        self._share = share_under_cap(drives, link.levels, self._settings.cap)
        frames = [frame_at(drive, link.levels, self._share) for drive in drives]
        before = self._round
        begun = now
        if before is not None and len(before.items) == len(frames) and before.rate == rate:
            begun = before.begun
        else:
            self._next_frame = now
        self._round = Cycle(list(zip(drives, frames, strict=True)), rate, begun)
        self._playback = None
        self._modulation = None
        self._waiting = False
        self._drive = drives[np.linalg.norm(drives, axis=1).argmax()]
        self._full = None
        if not link.real_time:
            self._transmit(self._round.at(now)[1])
            return 0.0, 1.0
        if link.modulates_itself:
            link.modulate(None, 0.0)
        if self._gain == 0.0 or self._slope < 0.0:
            self._rise()
        if link.plays_itself and self._gain == 1.0:
            self._upload(frames, rate)
        self._fed = time.monotonic()
        return self.left(), self._gain

    def play(
        self,
        drives: Complex128[np.ndarray, "drives elements"],
        factors: Float64[np.ndarray, "frames"],
        rate: float,
        seconds: float,
    ) -> float:
        """Repeat drives, or one drive at several factors; return how long that takes [s]."""
        self._feed()
        link = self.link
        self._share = share_under_cap(drives, link.levels, self._settings.cap)
        frames = [
            frame_at(drives[index % len(drives)], link.levels, self._share * factor)
            for index, factor in enumerate(factors)
        ]
        self._playback = playback = Playback(frames, rate, seconds)
        self._round = None
        self._waiting = False
        # Frames of a file are counted, not timed: all are written at once.
        if not link.real_time:
            total = playback.total
            link.play([frames[index % len(frames)] for index in range(total)], rate)
            playback.begun = -np.inf
            playback.sent = total
            playback.index = total
            return 0.0
        # Where boards repeat a sequence themselves, only its most powerful frame rises.
        self._drive = drives[np.linalg.norm(drives, axis=1).argmax()]
        self._full = None
        if not self._emitting:
            self._rise()
        if self._gain == 1.0:
            self._begin(playback)
        else:
            self._transmit(self._now())
        self._fed = time.monotonic()
        return self.left()

    def played(self) -> tuple[float, int, int]:
        """Return the rate of a sequence as played, and the numbers of frames sent and dropped."""
        playback = self._playback
        if playback is None or playback.begun == np.inf:
            return 0.0, 0, 0
        if not self.link.real_time:
            return playback.rate, playback.total, 0
        if self.link.plays_itself:
            return playback.rate, round(playback.seconds * playback.rate), 0
        rate = playback.sent / (time.monotonic() - playback.begun)
        return rate, playback.sent, playback.dropped

    def modulate(self, envelope: Float64[np.ndarray, "frames"] | None, rate: float) -> None:
        """Vary the amplitude of all that is sent from now on, or stop that; a round ends."""
        self._feed()
        self._round = None
        if self.link.modulates_itself:
            self.link.modulate(envelope, rate)
        else:
            self._next_frame = time.monotonic()
            self._modulation = None
            if envelope is not None:
                self._modulation = Cycle(envelope, rate, self._next_frame)
        if self._emitting and self._playback is None and self._paced is None:
            self._transmit(self._now())

    def silence(self, fade: float) -> float:
        """Fade to silence; return how long that takes [s]. The next drive rises over the ramp."""
        self._feed()
        self._playback = None
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
        """Silence the boards for good; the first reason is kept."""
        if self.over is None:
            self.over = why
        elif self._failure is None:
            return
        self._failure = None
        self._silence()

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

    # --- what is due ---

    def left(self) -> float:
        """Return how long a ramp, a fade or a sequence still takes [s]; 0 only when it is over."""
        now = time.monotonic()
        playback = self._playback
        if playback is not None and playback.begun < np.inf:
            left = max(playback.begun + playback.seconds - now, 0.0)
            return max(left, 1e-3) if playback.due < np.inf else left
        left = 0.0 if playback is None else playback.seconds
        if self._slope == 0.0:
            return left
        end = 1.0 if self._slope > 0.0 else 0.0
        steps = round((end - self._gain) / self._slope)
        return max(left + self._next_step - now + self._pause * (steps - 1), 1e-3)

    def wait(self) -> float:
        """Return how long nothing is due [s]."""
        if self._waiting:
            return 0.0
        now = time.monotonic()
        # At least 20 times a second, to notice a feeder that is gone.
        due = [now + 0.05]
        if self._slope != 0.0:
            due.append(self._next_step)
        if self._paced is not None and self._gain > 0.0:
            due.append(self._next_frame)
        if self._playback is not None:
            due.append(self._playback.due)
        if self._emitting:
            due.append(self._fed + self._settings.patience)
        return max(min(due) - now, 0.0)

    def step(self) -> None:
        """Do what is due now."""
        if self.over is not None or not self.link.real_time:
            return
        try:
            self._step(time.monotonic())
        except Exception as error:
            self._trouble = error
            self._playback = None
            self._slope = 0.0
            self._waiting = False
            self._looked = time.monotonic()

    def _step(self, now: float) -> None:
        self._catch_up()
        if self._emitting and now - self._fed >= self._settings.patience:
            why = f"no call came for {self._settings.patience:g} s"
            if self._settings.resumes:
                self._write(why)
                self._silence()
            else:
                self.finish(why)
            return
        if self._slope != 0.0 and now >= self._next_step:
            self._ramp_step()
        paced = self._paced
        if self._playback is not None:
            self._pace(self._playback)
        elif paced is not None and self._gain > 0.0 and now >= self._next_frame:
            self._transmit(self._now())
            # Keep the grid of times: a late frame does not delay those after it.
            missed = np.floor((now - self._next_frame) * paced.rate)
            self._next_frame += (1.0 + missed) / paced.rate
        # Boards that play on are asked ten times a second whether they are still connected.
        if self._emitting and self._trouble is None and now - self._looked > 0.1:
            self._looked = now
            self.link.probe()

    def _catch_up(self) -> None:
        if self._waiting:
            self._waiting = False
            self._transmit(self._now())

    @property
    def _paced(self) -> Cycle | None:
        """The modulation or round whose frames must be sent in time."""
        if self._playback is not None or (self._round is not None and self.link.plays_itself):
            return None
        return self._round or self._modulation

    def _pace(self, playback: Playback) -> None:
        """Send the frame that is due; drop frames that would be late by a whole frame."""
        late = time.monotonic() - playback.due
        if late < 0.0:
            return
        if late > 1.0 / playback.rate:
            missed = min(int(late * playback.rate), playback.total - playback.index - 1)
            playback.index += missed
            playback.dropped += missed
        self._transmit(playback.frames[playback.index % len(playback.frames)])
        playback.index += 1
        playback.sent += 1

    def _begin(self, playback: Playback) -> None:
        if self.link.plays_itself:
            self._upload(playback.frames, playback.rate)
            playback.begun = time.monotonic()
            playback.index = playback.total
        else:
            playback.begun = time.monotonic()
            self._pace(playback)

    # --- ramps ---

    def _rise(self) -> None:
        self._slope_over(self._settings.ramp, 1.0)
        self._raise()

    def _slope_over(self, seconds: float, sign: float) -> None:
        # 25 ms: steps short enough to be inaudible, and slow enough for every link.
        steps = max(int(np.ceil(seconds / 0.025)), 1)
        self._slope = sign / steps
        self._pause = seconds / steps

    def _raise(self) -> None:
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
        playback = self._playback
        if playback is not None and playback.begun == np.inf and self._gain == 1.0:
            self._begin(playback)
        elif self._round is not None and self.link.plays_itself and self._gain == 1.0:
            self._upload([frame for _, frame in self._round.items], self._round.rate)
        elif self._paced is None:
            self._transmit(self._now())

    def _fade_step(self) -> None:
        self._gain += self._slope
        self._next_step = time.monotonic() + self._pause
        if self._gain < 1e-6:
            self._gain = 0.0
            self._slope = 0.0
            self._confirm_silence()
        elif self._paced is None:
            self._transmit(self._now())

    def _now(self) -> Frame:
        """Return the newest drive at the present gain and modulation."""
        drive = self._drive
        full = self._full
        factor = 1.0
        paced = self._paced
        if paced is not None and paced is self._round:
            drive, full = paced.at(time.monotonic())
        elif paced is not None:
            factor = float(paced.at(time.monotonic()))
        if full is not None and self._gain * factor == 1.0:
            return full
        assert drive is not None
        return frame_at(drive, self.link.levels, self._share * self._gain * factor)

    # --- the link ---

    def _transmit(self, frame: Frame) -> None:
        audible = self.link.real_time and (
            not frame.silent or (self._modulation is not None and self._gain > 0.0)
        )
        # True before the call: a fault in the middle of it may leave the boards emitting.
        self._emitting = self._emitting or audible
        self.link.send(frame)
        self._emitting = audible
        self._note([frame])

    def _upload(self, frames: Sequence[Frame], rate: float) -> None:
        self._emitting = True
        self.link.play(frames, rate)
        self._emitting = not all(frame.silent for frame in frames)
        self._note(frames)

    def _note(self, frames: Sequence[Frame]) -> None:
        """Log the largest amplitude that was sent; a link that just answered need not be probed."""
        self._looked = time.monotonic()
        largest = max(float(frame.levels.amplitudes[frame.amplitude.max()]) for frame in frames)
        self._write(f"frame {self.link.sent} loudest {largest:.4g}")

    def _feed(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self.over is not None:
            raise self.link.emission_over(self.over)
        self._fed = time.monotonic()
        trouble = self._trouble
        self._trouble = None
        if trouble is not None:
            raise trouble

    def _silence(self) -> None:
        self._playback = None
        self._round = None
        self._waiting = False
        self._slope = 0.0
        self._gain = 0.0
        self._confirm_silence()

    def _confirm_silence(self) -> None:
        before = self.link.last
        sent = self.link.sent
        # A single fault, such as a lost packet, must not leave the boards emitting.
        for tries_left in (2, 1, 0):
            try:
                self.link.stop()
                break
            except BaseException as error:
                if tries_left == 0:
                    sentence = str(error).rstrip(".") or repr(error)
                    self._failure = LinkFailed(
                        f"{sentence}; the boards may still emit: cut their power.",
                        before,
                        sent,
                        code="silence_failed",
                    )
                    raise self._failure from error
        self._emitting = False
        if self.link.real_time:
            self._write("silence confirmed")

    def _write(self, event: str) -> None:
        """Write a line of the log: the system's monotonic clock [s] and the event."""
        if self._log is not None:
            try:
                self._log.write(f"{time.monotonic():.6f} {event}\n")
            except OSError:
                self._log = None  # a full disk is no reason to stop
