"""Emitting safely: a ramp, a cap, a watchdog, and silence however it ends."""

import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from types import FrameType, TracebackType
from typing import Any

import numpy as np

from airtact.conventions import InvalidInput
from airtact.hardware.amplitudes import check_cap, faded, modulated, share_under_cap
from airtact.hardware.link import Link, LinkFailed
from airtact.synthesis.quantise import Frame
from airtact.synthesis.sequence import Sequence
from airtact.transducers.modulation import AmplitudeModulation
from airtact.transfer import Drive, check_drive
from airtact.validation import number, of_kind, positive

RAMP = 0.2
"""How long the amplitude rises when sound begins [s]."""

STEP = 0.025
"""How long one step of the ramp lasts [s]."""

PATIENCE = 0.5
"""How long boards emit without a call before they are silenced [s]."""

LOOK = 0.1
"""Time between two checks that the boards are still connected [s]."""

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that end an emission with silence."""

NOHUP = getattr(signal, "SIGHUP", None)
"""The one of them that is left alone where it is ignored."""


@dataclass(frozen=True)
class Played:
    """What was played of a sequence.

    Attributes
    ----------
    rate : frames a second that were played.
    frames : how many were sent, or how often the boards themselves began a frame.
    dropped : how many were left out because they would have been late.
    """

    rate: float
    frames: int
    dropped: int


class Emission:
    """Sound from boards, silenced however it ends.

    Use it as ``with Emission(link) as emission:``. Sound begins with a ramp. It ends with a frame of zeros, which the
    link sees confirmed, when the block is left, in order or by an exception, at SIGINT, SIGTERM or SIGHUP (which then
    raise ``KeyboardInterrupt`` or ``SystemExit``), and when for half a second no ``send``, ``hold``,
    ``play`` or ``beat`` is called. Nothing can be sent after that. A signal that comes while a frame is being sent
    waits until it is sent; outside the main thread Python delivers none.

    A process that is killed, or a computer that stops, sends nothing any more: the how-to of each board describes what
    the boards do then.

    Parameters
    ----------
    link : the way to the boards; it is opened and closed here.
    cap : largest amplitude of an element, a share of full scale; drives above it are reduced as a whole.
    ramp : duration of the ramp [s].
    patience : how long boards emit without a call [s].

    Raises
    ------
    InvalidInput
        If the cap is not above 0 and at most 1, or a time is negative or not finite.
    """

    link: Link

    def __init__(self, link: Link, *, cap: float = 1.0, ramp: float = RAMP, patience: float = PATIENCE) -> None:
        of_kind(link, Link, "the link", "one such as AUTD3Link(poses)")
        if not 0.0 <= number(ramp, "the ramp", "s") < np.inf:
            raise InvalidInput(f"the ramp is {ramp:g} s, but it must be 0 or more.", code="out_of_range")
        self.link = link
        self._cap = check_cap(cap)
        self._ramp, self._patience = ramp, positive(patience, "the patience of the watchdog", "s")
        self._lock = threading.RLock()
        self._inside = 0
        self._signal: int | None = None
        self._emitting = False
        self._over: str | None = "it was not begun"
        self._failure: LinkFailed | None = None
        self._fed = 0.0
        self._handlers: dict[int, Any] = {}
        self._done = threading.Event()

    def __enter__(self) -> "Emission":
        self._shield(1)
        self._listen()
        try:
            self.link.open()
        except BaseException:
            self._unlisten()
            raise
        finally:
            self._shield(-1)
        self._over, self._emitting, self._failure = None, False, None
        self._done.clear()
        threading.Thread(target=self._watch, name="watchdog", daemon=True).start()
        try:
            self._obey()
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._shield(1)
        try:
            self._done.set()
            self._finish("it was ended")
            if self._failure is not None:
                self._failure = None
                self._silence()
        finally:
            # An error on closing adds nothing: silence was confirmed, or its failure is raised from here.
            with suppress(LinkFailed):
                self.link.close()
            self._unlisten()
            self._shield(-1)
        if kind is None:
            self._obey()

    def send(self, drive: Drive) -> Frame:
        """Play a drive from now on; the first one rises over the ramp.

        Parameters
        ----------
        drive : what every element emits.

        Returns
        -------
        The frame that the boards play.

        Raises
        ------
        InvalidInput
            If the drive is for another number of elements.
        LinkFailed
            If the link fails, or the emission was ended before, by whatever.
        """
        check_drive(drive, "what is emitted")
        self.link.check_elements(len(drive))
        share = share_under_cap(drive.amplitudes[None], self.link.levels, self._cap)
        if self.link.real_time and not self._emitting and drive.amplitudes.any():
            self._rise(drive, share)
        return self._transmit(faded(drive, self.link.levels, share))

    def beat(self) -> None:
        """Keep the watchdog from silencing the boards.

        Raises
        ------
        LinkFailed
            If the emission was ended before.
        """
        self._check_over()
        self._fed = time.monotonic()

    def hold(self, seconds: float) -> None:
        """Let the boards play on for some time [s].

        Raises
        ------
        LinkFailed
            If the emission was ended before or meanwhile.
        """
        self.beat()
        if not self.link.real_time:
            return
        begun = looked = time.monotonic()
        while (left := begun + seconds - time.monotonic()) > 0.0:
            self.beat()
            time.sleep(min(left, self._patience / 5.0, 0.05))
            if time.monotonic() - looked > LOOK:
                self._do(self.link.probe, self._emitting)
                looked = time.monotonic()
        self.beat()

    def play(self, sequence: Sequence, seconds: float) -> Played:
        """Play a sequence over and over; its most powerful frame rises over the ramp before.

        Parameters
        ----------
        sequence : drives and their rate.
        seconds : how long.

        Returns
        -------
        What was played. Boards that repeat a sequence by themselves drop nothing; otherwise frames that would be late
        by a whole frame are left out, so that the rate stays what it is.

        Raises
        ------
        InvalidInput
            If the boards or the link cannot play it, with the nearest that they can.
        LinkFailed
            If the link fails, or the emission was ended before or meanwhile.
        """
        of_kind(sequence, Sequence, "what is played", "Sequence(drives, rate)")
        drives, rate = sequence.drives, sequence.rate
        self.link.check_elements(drives.shape[1])
        self.link.check_sequence(len(drives), rate)
        share = share_under_cap(drives, self.link.levels, self._cap)
        frames = [faded(Drive(row), self.link.levels, share) for row in drives]
        strongest = Drive(drives[np.linalg.norm(drives, axis=1).argmax()])
        return self._repeat(frames, rate, seconds, lambda: self._rise(strongest, share))

    def modulate(self, drive: Drive, seconds: float, modulation: AmplitudeModulation | None = None) -> Played:
        """Play a drive for some seconds [s] while its amplitude varies, so that it is felt, at a rate of the boards.

        The force follows a cosine of 200 Hz, or the given modulation. Boards without levels of amplitude vary the
        number of elements that are on. The drive rises over the ramp.

        Returns
        -------
        What was played.

        Raises
        ------
        InvalidInput
            If the drive is for another number of elements, or the modulation is too fast for the boards (the fastest).
        LinkFailed
            As ``play``.
        """
        check_drive(drive, "what is emitted")
        modulation = AmplitudeModulation() if modulation is None else modulation
        of_kind(modulation, AmplitudeModulation, "the modulation", "AmplitudeModulation(frequency, depth)")
        self.link.check_elements(len(drive))
        share = share_under_cap(drive.amplitudes[None], self.link.levels, self._cap)
        frames, rate = modulated(drive, modulation, self.link.levels, self.link.fastest_frames, share)
        self.link.check_sequence(len(frames), rate)
        return self._repeat(frames, rate, seconds, lambda: self._rise(drive, share))

    def _repeat(self, frames: list[Frame], rate: float, seconds: float, rise: Callable[[], None]) -> Played:
        """Play frames over and over, after a ramp."""
        if not self.link.real_time:
            count = max(round(seconds * rate), 1)
            self._do(lambda: self.link.play([frames[index % len(frames)] for index in range(count)], rate))
            return Played(rate, count, 0)
        if not self._emitting:
            rise()
        if self.link.plays_itself:
            self._do(lambda: self.link.play(frames, rate))
            self.hold(seconds)
            return Played(rate, round(seconds * rate), 0)
        return self._pace(frames, rate, seconds)

    def _pace(self, frames: list[Frame], rate: float, seconds: float) -> Played:
        begun, index, sent, dropped = time.monotonic(), 0, 0, 0
        total = max(round(seconds * rate), 1)
        while index < total:
            late = time.monotonic() - begun - index / rate
            if late < 0.0:
                self.hold(-late)
            elif late > 1.0 / rate:
                missed = min(int(late * rate), total - index - 1)
                index, dropped = index + missed, dropped + missed
            self._transmit(frames[index % len(frames)])
            index, sent = index + 1, sent + 1
        self.hold(max(begun + seconds - time.monotonic(), 0.0))
        return Played(sent / (time.monotonic() - begun), sent, dropped)

    def _rise(self, drive: Drive, share: float) -> None:
        steps = int(np.ceil(self._ramp / STEP))
        for step in range(1, steps):
            self._transmit(faded(drive, self.link.levels, share * step / steps))
            self.hold(self._ramp / steps)

    def _transmit(self, frame: Frame) -> Frame:
        self._do(lambda: self.link.send(frame), not frame.silent)
        return frame

    def _do(self, work: Callable[[], None], emitting: bool = True) -> None:
        """Call the link while no signal can interrupt it."""
        self._shield(1)
        try:
            with self._lock:
                self._check_over()
                self._fed = time.monotonic()
                emitting = emitting and self.link.real_time
                self._emitting = self._emitting or emitting
                work()
                self._emitting = emitting
                self._fed = time.monotonic()
        finally:
            self._shield(-1)
        self._obey()

    def _shield(self, step: int) -> None:
        """Count the nested calls of the link in the main thread, which receives the signals."""
        if threading.current_thread() is threading.main_thread():
            self._inside += step

    def _check_over(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self._over is not None:
            raise LinkFailed(
                f"the emission is over because {self._over}, after {self.link.sent} frames, and nothing was sent.",
                self.link.last,
                self.link.sent,
                code="emission_over",
            )

    def _finish(self, why: str) -> None:
        """Silence the boards once; remember why, and whether it failed."""
        self._shield(1)
        try:
            with self._lock:
                if self._over is not None:
                    return
                self._over = why
                self._silence()
        finally:
            self._shield(-1)

    def _silence(self) -> None:
        before, sent = self.link.last, self.link.sent
        for last_try in (False, True):
            try:
                self.link.stop()
            except LinkFailed as error:
                if last_try:
                    self._failure = LinkFailed(
                        f"{str(error).rstrip('.')}; the boards may still emit: cut their power.",
                        before,
                        sent,
                        code="silence_failed",
                    )
                    raise self._failure from error
            else:
                self._emitting = False
                return

    def _watch(self) -> None:
        """Silence the boards when no call came for the patience."""
        while not self._done.wait(self._patience / 10.0):
            if not self._emitting or time.monotonic() - self._fed < self._patience:
                continue
            with self._lock:
                if time.monotonic() - self._fed < self._patience or self._over is not None:
                    continue
                self._over = f"no call came for {self._patience:g} s"
                try:
                    self._silence()
                except LinkFailed:
                    return  # stored in _failure: the next call and the end of the block raise it
                return

    def _listen(self) -> None:
        if threading.current_thread() is threading.main_thread():
            # A process that was started with nohup outlives its terminal.
            kept = [kind for kind in SIGNALS if (kind != NOHUP or signal.getsignal(kind) != signal.SIG_IGN)]
            self._handlers = {kind: signal.signal(kind, self._on_signal) for kind in kept}

    def _unlisten(self) -> None:
        for kind, handler in self._handlers.items():
            signal.signal(kind, handler)
        self._handlers = {}

    def _on_signal(self, kind: int, _frame: FrameType | None) -> None:
        self._signal = kind
        if self._inside == 0:
            self._obey()

    def _obey(self) -> None:
        """Act on a signal, now that nothing is being sent; a signal ends the main thread only."""
        if self._signal is None or threading.current_thread() is not threading.main_thread():
            return
        kind, self._signal = self._signal, None
        self._finish(f"of the signal {signal.Signals(kind).name}")
        if kind == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + kind)
