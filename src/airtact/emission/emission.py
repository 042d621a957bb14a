"""Emitting safely: a ramp, a cap, a watchdog, and silence however it ends."""

import atexit
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

import numpy as np

from airtact.checks import number, of_kind, positive
from airtact.drives.drive import Drive, check_drive
from airtact.drives.frame import Frame, check_cap
from airtact.drives.sequence import Sequence
from airtact.emission.amplitudes import frames_of_period
from airtact.emission.feeding import LinkProcess
from airtact.emission.link import Link, LinkFailed
from airtact.emission.player import Settings
from airtact.errors import InvalidInput
from airtact.transducers.modulation import AmplitudeModulation

RAMP = 0.2
"""How long the amplitude rises when sound begins [s]."""

FADE = 0.1
"""How long the amplitude falls when sound is silenced for a while [s]."""

PATIENCE = 0.5
"""How long boards emit without a call before they are silenced [s]."""

SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that end an emission and then the block that it is in."""

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

    Use it as ``with Emission(link) as emission:``. The link is opened in a process of its own,
    which raises the sound over a ramp and sends a frame of zeros, which the link sees confirmed,
    when the block is left, and by itself when this process is gone, whatever ended it, or when for
    half a second no ``send``, ``hold``, ``play``, ``cycle``, ``modulate``, ``set_modulation``,
    ``silence`` or ``beat`` is called. Nothing can be sent after that, unless calls that came too
    late are the reason and it ``resumes``. SIGINT, SIGTERM and SIGHUP in the main thread leave the
    block by ``KeyboardInterrupt`` or ``SystemExit``.

    If the link process itself is killed, the next call raises ``LinkFailed``, and another process
    opens the link and silences the boards. A link whose class is defined in the script itself, or
    on a system without POSIX, is open in this process, and a warning says so: the boards go on
    emitting then if this process is killed.

    Parameters
    ----------
    link : the way to the boards; it is opened and closed here.
    cap : largest amplitude of an element, a share of full scale; drives above it are reduced as a
        whole.
    ramp : duration of the ramp [s].
    patience : how long boards emit without a call [s].
    log : file for one line on each event, written by the link process: when, in seconds of the
        system's monotonic clock (``time.monotonic``), and what.
    resumes : whether boards that were silenced because no call came take the next drive, over the
        ramp.

    Attributes
    ----------
    process : number of the process that holds the link; None where it is this one, or before it is
        open.
    share : of the amplitude of the newest drive that the boards played when it was sent; less than
        1 on a ramp.

    Raises
    ------
    InvalidInput
        If the cap is not above 0 and at most 1, or a time is negative or not finite.
    """

    link: Link

    def __init__(
        self,
        link: Link,
        *,
        cap: float = 1.0,
        ramp: float = RAMP,
        patience: float = PATIENCE,
        log: str | Path | None = None,
        resumes: bool = False,
    ) -> None:
        of_kind(link, Link, "the link", "one such as AUTD3Link(poses)")
        if not 0.0 <= number(ramp, "the ramp", "s") < np.inf:
            raise InvalidInput(
                f"the ramp is {ramp:g} s, but it must be 0 or more.", code="out_of_range"
            )
        self.link = link
        file = (
            None if log is None else Path(of_kind(log, str | Path, "the log", "a path")).absolute()
        )
        patience = positive(patience, "the patience of the watchdog", "s")
        self._settings = Settings(check_cap(cap), float(ramp), patience, file, resumes)
        self.share: float = 1.0
        self._inside = 0
        self._signal: int | None = None
        # "it was not begun": why nothing can be sent before an emission begins.
        self._over = "it was not begun"
        self._played: LinkProcess | None = None
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> "Emission":
        self._shield(1)
        self._listen()
        try:
            if self._settings.log is not None:
                _begin_log(self._settings.log)
            self._played = LinkProcess(self.link, self._settings)
        except BaseException:
            self._unlisten()
            raise
        finally:
            self._shield(-1)
        if self._played.process is None:
            atexit.register(self._end)
        else:
            self.link._elsewhere = lambda name, *arguments: self._ask("ask", name, *arguments)
        try:
            self._obey()
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._shield(1)
        try:
            self._end()
        finally:
            self._unlisten()
            self._shield(-1)
        if kind is None:
            self._obey()

    def _end(self) -> None:
        """Silence the boards and close the link; an emission that has ended stays so."""
        played = self._played
        if played is None:
            return
        atexit.unregister(self._end)
        failed: LinkFailed | None = None
        try:
            played.ask("finish", "it was ended")
            self.link.collect()
        except LinkFailed as error:
            failed = error
        finally:
            self._played = None
            self.link._elsewhere = None
            try:
                self._over = played.close() or "it was ended"
            except LinkFailed as error:
                # An error on closing adds nothing where silence was confirmed, unless the link
                # process was lost.
                self._over = "the link process was lost"
                if error.code != "link_failed":
                    failed = (
                        failed if failed is not None and failed.code == "silence_failed" else error
                    )
        if failed is not None:
            raise failed

    @property
    def process(self) -> int | None:
        """Number of the process that holds the link; None where it is this one, or before it is open."""
        return None if self._played is None else self._played.process

    def send(self, drive: Drive, wait: bool = True, outlast: bool = True) -> Frame:
        """Play a drive from now on; the first one rises over the ramp, and so does one after silence.

        Parameters
        ----------
        drive : what every element emits.
        wait : whether to return when the ramp is over and the boards have the frame. Otherwise the
            newest drive rises meanwhile, and what fails on the way is raised by the next call.
        outlast : whether to wait for the end of the ramp, too; otherwise ``share`` says how far it
            is.

        Returns
        -------
        The frame that the boards play, at the end of the ramp and at the full amplitude of a modulation.

        Raises
        ------
        InvalidInput
            If the drive is for another number of elements.
        LinkFailed
            If the link fails, or the emission was ended before, by whatever.
        """
        check_drive(drive, "what is emitted")
        self.link.check_elements(len(drive))
        frame, left, self.share = self._ask("send", drive.amplitudes, wait)
        self.link.last = frame
        if wait and outlast:
            self._outlast(left)
        return frame

    def set_modulation(self, modulation: AmplitudeModulation | None) -> None:
        """Vary the amplitude of whatever ``send`` plays from now on, or stop that; drives follow without a jump in it.

        AUTD3 boards play the modulation themselves. Other boards are sent the newest drive at each
        of its times.

        Raises
        ------
        InvalidInput
            If the modulation is too fast for the boards (the fastest).
        LinkFailed
            If the link fails, or the emission was ended before.
        """
        if modulation is None:
            self._ask("modulate", None, 0.0)
            return
        of_kind(
            modulation,
            AmplitudeModulation,
            "the modulation",
            "AmplitudeModulation(frequency, depth)",
        )
        count, rate = frames_of_period(modulation.frequency, self.link.fastest_frames)
        self._ask("modulate", modulation.envelope(count), rate)

    def cycle(self, sequence: Sequence, outlast: bool = True) -> None:
        """Play the frames of a sequence over and over from now on, and take the place of the one before in its round.

        While sequences of one length and rate follow each other, the place in the round goes on:
        the frame that is due is the newest sequence's. A modulation ends. The first sequence rises
        over the ramp, its most powerful frame alone where boards repeat it by themselves; a file
        gets the frame that is due. ``outlast`` is that of ``send``.

        Raises
        ------
        InvalidInput
            As ``play``.
        LinkFailed
            If the link fails, or the emission was ended before.
        """
        of_kind(sequence, Sequence, "what is played", "Sequence(drives, rate)")
        self.link.check_elements(sequence.drives.shape[1])
        self.link.check_sequence(len(sequence), sequence.rate)
        left, self.share = self._ask("cycle", sequence.drives, sequence.rate)
        if outlast:
            self._outlast(left)

    def silence(self, fade: float = FADE, wait: bool = True) -> None:
        """Let the sound fade to silence; the next drive rises over the ramp.

        Parameters
        ----------
        fade : how long it takes [s].
        wait : whether to return when it is over.

        Raises
        ------
        LinkFailed
            If the link fails, or the emission was ended before.
        """
        left = self._ask("silence", positive(fade, "the fade", "s"))
        if wait:
            self._outlast(left)

    def stop(self) -> None:
        """Silence the boards at once, for good.

        Raises
        ------
        LinkFailed
            If that fails: the boards may still emit.
        """
        self._ask("finish", "it was stopped")

    def beat(self) -> None:
        """Keep the watchdog from silencing the boards.

        Raises
        ------
        LinkFailed
            If the emission was ended before, or the link has failed.
        """
        self._ask("beat")

    def hold(self, seconds: float) -> None:
        """Let the boards play on for some time [s].

        Raises
        ------
        LinkFailed
            If the emission was ended before or meanwhile, or the link fails.
        """
        self.beat()
        if not self.link.real_time:
            return
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            time.sleep(min(left, self._pause))
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
        self.link.check_elements(sequence.drives.shape[1])
        self.link.check_sequence(len(sequence), sequence.rate)
        self._outlast(
            self._ask("play", sequence.drives, np.ones(len(sequence)), sequence.rate, seconds)
        )
        return Played(*self._ask("played"))

    def modulate(
        self, drive: Drive, seconds: float, modulation: AmplitudeModulation | None = None
    ) -> Played:
        """Play a drive for some seconds [s] while its amplitude varies, so that it is felt, at a rate of the boards.

        The force follows a cosine of 200 Hz, or the given modulation. Boards without levels of
        amplitude vary the number of elements that are on. The drive rises over the ramp.

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
        of_kind(
            modulation,
            AmplitudeModulation,
            "the modulation",
            "AmplitudeModulation(frequency, depth)",
        )
        self.link.check_elements(len(drive))
        count, rate = frames_of_period(modulation.frequency, self.link.fastest_frames)
        self.link.check_sequence(count, rate)
        self._outlast(
            self._ask("play", drive.amplitudes[None], modulation.envelope(count), rate, seconds)
        )
        return Played(*self._ask("played"))

    def _outlast(self, left: float) -> None:
        """Wait until a ramp or a sequence is over, which takes some time yet [s]."""
        while left > 0.0:
            time.sleep(min(left, self._pause))
            left = self._ask("beat")

    @property
    def _pause(self) -> float:
        """How long to sleep between two beats [s]."""
        return min(self._settings.patience / 5.0, 0.05)

    def _ask(self, name: str, *arguments: Any) -> Any:
        """Have the link's player do something while no signal can interrupt it."""
        self._shield(1)
        try:
            if self._played is None:
                raise LinkFailed(
                    f"the emission is over because {self._over}, after {self.link.sent} frames, and nothing was sent.",
                    self.link.last,
                    self.link.sent,
                    code="emission_over",
                )
            answer = self._played.ask(name, *arguments)
        finally:
            self._shield(-1)
        self._obey()
        return answer

    def _shield(self, step: int) -> None:
        """Count the nested calls of the link in the main thread, which receives the signals."""
        if threading.current_thread() is threading.main_thread():
            self._inside += step

    def _listen(self) -> None:
        if threading.current_thread() is threading.main_thread():
            # A process that was started with nohup outlives its terminal.
            kept = [
                kind
                for kind in SIGNALS
                if (kind != NOHUP or signal.getsignal(kind) != signal.SIG_IGN)
            ]
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
        kind = self._signal
        self._signal = None
        if self._played is not None:
            self._shield(1)
            try:
                self._played.ask("finish", f"of the signal {signal.Signals(kind).name}")
            finally:
                self._shield(-1)
        if kind == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + kind)


def _begin_log(path: Path) -> None:
    """Empty the log, so that it holds one emission."""
    try:
        path.write_text("")
    except OSError as error:
        raise InvalidInput(
            f"the log {path} cannot be written (error {error.errno}): {error.strerror}.",
            code="not_writable",
        ) from None
