"""Playback in the link process: ramp, cap, modulation, sequences, watchdog, silence and log."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.drives.frame import Frame, frame_at, share_under_cap
from airtact.emission.link import Link, LinkFailed

# Time that a call of a link may take before its process is replaced [s]. The slowest serial board
# needs 0.5 s to answer a frame.
STALL = 0.6


def suspended() -> float:
    """Return a lower bound on the time for which the computer was suspended [s], or 0 if unknown.

    ``time.monotonic`` stops while the computer is suspended.
    """
    if not hasattr(time, "CLOCK_BOOTTIME"):
        return 0.0
    # The calls are in this order so that a pause between them cannot look like a suspend.
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()


@dataclass(frozen=True)
class Settings:
    """Playback settings: durations [s], log file, and whether a late call resumes playback."""

    ramp: float
    patience: float
    log: Path | None
    resumes: bool = False
    silencing: float = 5.0


@dataclass(frozen=True)
class Cycle:
    """Items that are repeated at a rate [1/s]: modulation factors, or frames with their drives."""

    items: Sequence[Any]
    rate: float
    begun: float

    def at(self, now: float) -> Any:
        """Return the item that is due at the time ``now`` [s]."""
        # 1e-6 is added so that rounding does not select the previous frame.
        return self.items[int((now - self.begun) * self.rate + 1e-6) % len(self.items)]


class Player:
    """Playback of drives on a link, in small steps. Every command returns at once.

    The link process calls the public methods by name. ``step`` does the work that is due. If a
    step fails, its error is raised by the next command that resets the watchdog.

    Parameters
    ----------
    link, settings : a link that is not open yet, and the settings of the playback.
    alive : function called before each piece of work, with the longest time that the work may take
        [s].
    """

    def __init__(
        self, link: Link, settings: Settings, alive: Callable[[float], None] = lambda seconds: None
    ) -> None:
        self.link = link
        self.alive = alive
        self.over: str | None = None
        self._settings = settings
        self._failure: LinkFailed | None = None  # the boards could not be silenced
        self._give_up: float | None = None  # when to stop trying to silence them
        self._trouble: Exception | None = None  # error of a step
        self._log: TextIO | None = None
        # (drive, factor, frame) of each frame played; a single drive is one frame.
        self._sound: Cycle | None = None
        self._strongest: tuple[np.ndarray, float, Frame] | None = None
        self._modulation: Cycle | None = None
        self._share = 1.0
        self._gain = 0.0
        self._slope = 0.0  # change of the gain per step of a ramp
        self._pause = 0.0  # pause between two steps [s]
        self._next_step = 0.0
        self._next_frame = 0.0
        self._dropped = 0
        self._emitting = False
        self._fed = time.monotonic()
        self._looked = self._fed
        self._suspended = suspended()

    # --- commands ---

    def open(self) -> None:
        """Open the link and the log."""
        if self._settings.log is not None:
            # The log is appended to, so that it continues if this process replaces a lost one.
            self._log = self._settings.log.open("a", buffering=1, encoding="utf-8")
        self.link.open()
        self._write("opened")
        self._fed = time.monotonic()

    def play(
        self,
        drives: Complex128[np.ndarray, "drives elements"],
        factors: Float64[np.ndarray, "frames"],
        rate: float,
        cap: float,
        at: float | None = None,
    ) -> tuple[Frame, float, float]:
        """Start to repeat several drives, or one drive multiplied by several factors.

        If ``rate`` is above 0, the current modulation ends. If the number of frames stays the same,
        playback continues at the same position.

        Parameters
        ----------
        drives, factors : drives (D, E), and the amplitude factors (N,) of the N frames. A frame is
            a drive times its factor; D is 1 or N.
        rate : frames per second; 0 for a single drive.
        cap : largest amplitude of an element, as a fraction of full scale.
        at : time at which a single drive takes effect, as in ``Link.send``; during a ramp it takes
            effect at once.

        Returns
        -------
        The strongest frame, the remaining time of the ramp [s], and the current factor of the ramp.
        """
        self._feed()
        link = self.link
        self._share = share_under_cap(drives, link.levels, cap)
        items = []
        for index, factor in enumerate(factors.tolist()):
            drive = drives[index % len(drives)]
            items.append((drive, factor, frame_at(drive, link.levels, self._share * factor)))
        now = time.monotonic()
        before = self._sound
        if before is not None and (len(before.items), before.rate) == (len(items), rate):
            self._sound = Cycle(items, rate, before.begun)
        else:
            begun = now
            if before is not None and rate and len(before.items) == len(items):
                begun -= (now - before.begun) * before.rate % len(items) / rate
            self._sound = Cycle(items, rate, begun)
            self._next_frame = now
        # If boards repeat frames themselves, only the most powerful frame rises and fades.
        powers = factors * np.linalg.norm(drives, axis=1)
        self._strongest = strongest = items[int(powers.argmax())]
        full = strongest[2]
        if rate:
            self._modulation = None
            if link.plays_itself:
                link.modulate(None, 0.0)
        # Silence needs no ramp, but the next drive rises over one.
        if full.silent:
            self._gain = 0.0
            self._slope = 0.0
        elif self._gain == 0.0 or self._slope < 0.0:
            self._begin_ramp(self._settings.ramp, 1.0)
            self._change_gain()
        # Paced frames are sent when they are due, but silence must not wait until then.
        if full.silent or self._paced is None:
            self._show(at if self._slope == 0.0 and not full.silent else None)
        self._fed = time.monotonic()
        return full, self.left(), self._gain

    def dropped(self) -> int:
        """Return the number of frames dropped so far because they would have been late."""
        return self._dropped

    def modulate(self, envelope: Float64[np.ndarray, "frames"] | None, rate: float) -> None:
        """Start to modulate the amplitude; None ends the modulation."""
        self._feed()
        if self.link.plays_itself:
            self.link.modulate(envelope, rate)
        else:
            self._next_frame = time.monotonic()
            self._modulation = (
                None if envelope is None else Cycle(envelope.tolist(), rate, self._next_frame)
            )
        if self._emitting and self._paced is None:
            self._transmit(self._now())

    def silence(self, fade: float) -> float:
        """Fade to silence and return the duration [s]. The next drive is ramped up."""
        self._feed()
        if self._emitting:
            self._begin_ramp(fade, -1.0)
            self._ramp_step()
        return self.left()

    def beat(self) -> float:
        """Reset the watchdog, and return the remaining time of a ramp [s]."""
        self._feed()
        return self.left()

    def finish(self, why: str) -> None:
        """Silence the boards permanently, and store the reason unless one is already stored."""
        if self.over is None:
            self.over = why
        elif self._failure is None:
            return
        self._failure = None
        self._silence()

    def ask(self, name: str, *arguments: object) -> object:
        """Call a method of the link that does not affect the playback, such as ``recorded``."""
        return getattr(self.link, name)(*arguments)

    def close(self) -> str | None:
        """Close the link; return the reason why the emission ended, or None if it had not."""
        try:
            self.link.close()
        finally:
            self._write("closed")
            if self._log is not None:
                self._log.close()
                self._log = None
        return self.over

    # --- steps ---

    def left(self) -> float:
        """Return the remaining time of a ramp or fade [s]; it is 0 only after the last step."""
        if self._slope == 0.0:
            return 0.0
        end = 1.0 if self._slope > 0.0 else 0.0
        steps = round((end - self._gain) / self._slope)
        return max(self._next_step - time.monotonic() + self._pause * (steps - 1), 1e-3)

    def wait(self) -> float:
        """Return the time until the next step is due [s]."""
        now = time.monotonic()
        # A step is due at least 20 times a second, so that the end of the owner is noticed.
        due = [now + 0.05]
        if self._emitting:
            due.append(self._fed + self._settings.patience)
        if self._trouble is None:
            if self._slope != 0.0:
                due.append(self._next_step)
            if self._paced is not None and self._gain > 0.0:
                due.append(self._next_frame)
        return max(min(due) - now, 0.0)

    def step(self) -> None:
        """Do the work that is due now."""
        if self.over is not None:
            return
        try:
            self._step(time.monotonic())
        except Exception as error:
            self._trouble = error
            self._slope = 0.0
            self._looked = time.monotonic()

    def _step(self, now: float) -> None:
        self._check_suspend()
        if self._emitting and now - self._fed >= self._settings.patience:
            self._starve(f"no call arrived for {self._settings.patience:g} s")
            return
        if self._trouble is not None:
            return
        if self._slope != 0.0 and now >= self._next_step:
            self._ramp_step()
        paced = self._paced
        if paced is not None and self._gain > 0.0 and now >= self._next_frame:
            # Keep the time grid, so that a late frame does not delay the following ones.
            missed = int((now - self._next_frame) * paced.rate)
            self._dropped += missed
            self._next_frame += (1 + missed) / paced.rate
            self._transmit(self._now())
        # Ten times a second, check the connection to boards that play on their own.
        if self._emitting and now - self._looked > 0.1:
            self._looked = now
            self.link.probe()

    def _starve(self, why: str) -> None:
        """Silence the boards, permanently unless the emission resumes."""
        if self._settings.resumes:
            self._write(why)
            self._silence()
        else:
            self.finish(why)

    def _check_suspend(self) -> None:
        """Silence the boards if the computer was suspended, because they kept playing meanwhile."""
        now = suspended()
        if self._emitting and now - self._suspended > 0.1:
            self._starve("the computer was suspended")
        self._suspended = max(now, self._suspended)

    @property
    def _paced(self) -> Cycle | None:
        """Frames or modulation that must be sent on time."""
        if self.link.plays_itself or self._sound is None:
            return None
        return self._sound if self._sound.rate else self._modulation

    # --- ramps ---

    def _begin_ramp(self, seconds: float, sign: float) -> None:
        # Steps of 25 ms are short enough to be inaudible and long enough for every link.
        steps = max(int(np.ceil(seconds / 0.025)), 1)
        self._slope = sign / steps
        self._pause = seconds / steps

    def _change_gain(self) -> None:
        self._gain = min(max(self._gain + self._slope, 0.0), 1.0)
        self._next_step = time.monotonic() + self._pause
        # The steps add up to 1 only to within rounding.
        if min(self._gain, 1.0 - self._gain) < 1e-6:
            self._gain = float(round(self._gain))
            self._slope = 0.0

    def _ramp_step(self) -> None:
        self._change_gain()
        if self._gain == 0.0:
            self._confirm_silence()
        elif self._paced is None:
            self._show()

    def _show(self, at: float | None = None) -> None:
        """Send the sound at the present gain, to take effect at once or at the time ``at``."""
        sound = self._sound
        if sound is not None and sound.rate and self.link.plays_itself and self._gain == 1.0:
            self._upload([item[2] for item in sound.items], sound.rate)
        else:
            self._transmit(self._now(), at)

    def _now(self) -> Frame:
        assert self._sound is not None
        assert self._strongest is not None
        now = time.monotonic()
        drive, factor, full = self._strongest if self.link.plays_itself else self._sound.at(now)
        gain = self._gain
        if self._modulation is not None:
            gain *= self._modulation.at(now)
        return (
            full if gain == 1.0 else frame_at(drive, self.link.levels, self._share * factor * gain)
        )

    # --- the link ---

    def _transmit(self, frame: Frame, at: float | None = None) -> None:
        audible = not frame.silent or (self._paced is not None and self._gain > 0.0)
        # Set before the call, because an error during it may leave the boards emitting.
        self._emitting = self._emitting or audible
        self.link.send(frame, at)
        self._emitting = audible
        self._note([frame])

    def _upload(self, frames: Sequence[Frame], rate: float) -> None:
        self._emitting = True
        self.alive(STALL + 5e-3 * len(frames))  # boards take up to 5 ms for a frame
        self.link.play(frames, rate)
        self._emitting = not all(frame.silent for frame in frames)
        self._note(frames)

    def _note(self, frames: Sequence[Frame]) -> None:
        """Log the largest amplitude, and postpone the next check of the connection."""
        self._looked = time.monotonic()
        largest = max(float(frame.levels.amplitudes[frame.amplitude.max()]) for frame in frames)
        self._write(f"frame {self.link.sent} loudest {largest:.4g}")

    def _feed(self) -> None:
        if self._failure is not None:
            raise self._failure
        self._check_suspend()
        if self.over is not None:
            raise self.link.emission_over(self.over)
        self._fed = time.monotonic()
        trouble = self._trouble
        self._trouble = None
        if trouble is not None:
            raise trouble

    def _silence(self) -> None:
        self._slope = 0.0
        self._gain = 0.0
        self._confirm_silence()

    def _confirm_silence(self) -> None:
        # Transient faults such as lost packets must not leave the boards emitting.
        while True:
            self.alive(STALL)
            try:
                self.link.stop()
                break
            except BaseException as error:
                self._give_up = self._give_up or time.monotonic() + self._settings.silencing
                if time.monotonic() >= self._give_up:
                    sentence = str(error).rstrip(".") or repr(error)
                    self._failure = LinkFailed(
                        f"{sentence}; the boards may still emit: cut their power.",
                        code="silence_failed",
                    )
                    raise self._failure from error
                time.sleep(0.1)
        self._emitting = False
        self._write("silence confirmed")

    def _write(self, event: str) -> None:
        if self._log is not None:
            try:
                self._log.write(f"{time.monotonic():.6f} {event}\n")
            except OSError:
                self._log = None  # do not stop because of a full disk
